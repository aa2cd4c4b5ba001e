"""Other methods: programs that replace stages and use the same keys."""

from __future__ import annotations

from zloam_monitor.failures import Misuse

#: Stages that a method may replace, in the order of the data flow.
REPLACEABLE = ("registration", "odometry", "mapping")
#: Method -> stages that it replaces.
METHODS = {"aloam": REPLACEABLE}


class MethodError(Misuse):
    """No such method, or not for this stage; the text lists the possible ones."""


def programs(text: str) -> dict[str, str]:
    """Stage -> program. `aloam`: all stages of the method; `mapping=aloam,odometry=aloam`: these
    stages alone."""
    chosen: dict[str, str] = {}
    for part in filter(None, (each.strip() for each in text.split(","))):
        stage, _, name = part.rpartition("=")
        method = name.strip()
        if method not in METHODS:
            raise MethodError(f"no method {method!r}; there is: {', '.join(METHODS)}")
        stages = (stage.strip(),) if stage else METHODS[method]
        for each in stages:
            if each not in METHODS[method]:
                known = ", ".join(METHODS[method])
                raise MethodError(f"{method} has no stage {each!r}; it has: {known}")
            chosen[each] = f"{method}-{each}"
    return chosen
