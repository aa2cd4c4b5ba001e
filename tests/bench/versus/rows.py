"""The benchmarks of this folder: one for each data set, and the limits over all of them."""

from __future__ import annotations

import functools
import json
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tests.acceptance.framework import Skip
from tests.bench.framework import Benchmark, Outcome, machine
from tests.bench.setting import BenchSetting
from tests.bench.versus import data, summary, systems, table
from tests.bench.versus.data import DataSet, Scans
from tests.bench.versus.summary import Entry, Round
from tests.bench.versus.systems import ALOAM, OURS, Taken
from tests.bench.versus.table import number

#: limits of issue 7
ATE_TO_BEST, DRIFT_TO_BEST, ROUGH_ATE_TO_BEST = 0.33, 0.5, 0.7
ROUGH = ("sim-field-1", "sim-park-1")
CPU_TO_ALOAM, CPU_TO_KISS = 1 / 3, 1.0
WHOLE_RATIO, WHOLE_MORE_MS = 1.3, 4.0


@dataclass(frozen=True)
class Options:
    """Options of the benchmarks versus-*."""

    data: str = "small"
    runs: int = 3
    #: keep the rounds of an earlier call if they were measured with the same programs
    add: bool = False
    #: take the peers' errors from the cache instead of running them
    kept_peers: bool = False
    systems: tuple[str, ...] = systems.SYSTEMS


@dataclass
class Session:
    """Results of all data sets of one call."""

    setting: BenchSetting
    options: Options
    found: dict[str, dict[str, Entry]] = field(default_factory=dict)
    ratios: dict[str, dict[str, Any]] = field(default_factory=dict)

    @property
    def out(self) -> Path:
        return self.setting.out / "versus"

    def write(self) -> None:
        where = machine()
        said = (
            f"{where['cpu']}, {where['cores']} of its cores, load {where['load_1min']:.1f}; "
            f"{time.strftime('%Y-%m-%d')}, commit {systems.commit()}"
        )
        self.out.mkdir(parents=True, exist_ok=True)
        text = table.document(self.found, self.ratios, said)
        (self.setting.out / "versus.md").write_text(text)


def benchmarks(setting: BenchSetting, options: Options) -> list[Benchmark]:
    """The data sets, then the rows over all of them."""
    session = Session(setting, options)
    rows = [
        Benchmark(
            f"versus-{d.name}",
            "ours, A-LOAM, kiss-icp, genz-icp, small-gicp, mad-icp on the same scans",
            functools.partial(_measure, session, d),
        )
        for d in data.chosen(data.all_sets(setting), options.data)
    ]
    return rows + [
        Benchmark(f"versus-{name}", what, functools.partial(judge, session), limit)
        for name, what, judge, limit in _LINES
    ]


def _measure(session: Session, chosen: DataSet) -> Outcome:
    scans = chosen.get()
    out = session.out / chosen.name
    out.mkdir(parents=True, exist_ok=True)
    programs = systems.programs(session.setting.build)
    rounds = _earlier(out, programs) if session.options.add else []
    for _ in range(session.options.runs):
        rounds.append({})
        for _ in _round(session, chosen.name, scans, rounds[-1]):
            # Written after each system, so that an interrupted round keeps its results.
            text = json.dumps({"programs": programs, "rounds": rounds}, indent=1)
            (out / "rounds.json").write_text(text + "\n")
    if not rounds:
        raise Skip("no rounds: none asked for, none kept of these programs")
    found = summary.systems_of(rounds)
    ratios = summary.ratios_of(found, rounds)
    session.found[chosen.name], session.ratios[chosen.name] = found, ratios
    session.write()
    paths = systems.last_trajectories(scans, out)
    table.picture(session.setting.out / f"versus-{chosen.name}.png", chosen.name, scans, paths)
    return Outcome(
        _figure(found, ratios),
        {"rounds": len(rounds)},
        report={chosen.name: found, "ratio": {chosen.name: ratios}},
    )


def _earlier(out: Path, programs: str) -> list[Round]:
    file = out / "rounds.json"
    if not file.exists():
        return []
    kept = json.loads(file.read_text())
    return list(kept["rounds"]) if kept["programs"] == programs else []


def _round(session: Session, name: str, scans: Scans, done: Round) -> Iterator[None]:
    """Runs every system once, one after the other."""
    for system in session.options.systems:
        try:
            taken = _run(session, system, scans, session.out / name)
        except Skip as skip:
            done[system] = {"skipped": str(skip)}
        except RuntimeError as error:
            if system == OURS:
                raise
            done[system] = {"failed": str(error)}
        else:
            done[system] = _entry(system, taken, scans)
        print(f"  {system}: {_words(done[system])}", flush=True)
        yield


def _run(session: Session, system: str, scans: Scans, out: Path) -> Taken:
    if system in systems.CHAINS:
        return systems.run_chain(system, session.setting, scans, out)
    if session.options.kept_peers:
        return systems.kept_peer(system, scans)
    return systems.run_peer(system, scans, out)


def _entry(system: str, taken: Taken, scans: Scans) -> Entry:
    scores = taken.scored.scores.as_dict()
    known = {} if system in scans.truth_of else {n: scores[n] for n in scores if n != "poses"}
    return {
        **known,
        "lost": taken.scored.lost,
        "instant": taken.scored.instant,
        "sweeps": taken.sweeps,
        "cpu_ms_per_sweep": taken.cpu_ms_per_sweep,
        "rss_mib": taken.rss_mib,
        "version": taken.version,
        **taken.more,
    }


def _words(entry: Entry) -> str:
    if "sweeps" not in entry:
        return ", ".join(f"{kind}: {why}" for kind, why in entry.items())
    return (
        f"ATE {number(entry.get('ate_rmse_m'))} m, drift {number(entry.get('drift_percent'))} %, "
        f"{number(entry['cpu_ms_per_sweep'])} ms CPU a sweep, {number(entry['rss_mib'])} MiB, "
        f"instant {entry['instant']}"
    )


def _figure(found: dict[str, Entry], ratios: dict[str, Any]) -> str:
    ours = found.get(OURS, {})
    return (
        f"ATE {number(ours.get('ate_rmse_m'))} m "
        f"({number(ratios.get('ate_rmse_m_to_best_peer'))} × "
        f"{ratios.get('ate_rmse_m_best_peer', 'no peer')}), "
        f"drift {number(ratios.get('drift_percent_to_best_peer'))} ×, "
        f"CPU {number(ours.get('cpu_ms_per_sweep'))} ms "
        f"({number(ratios.get('cpu_to_kiss-icp'))} × kiss-icp)"
    )


def _over_sets(session: Session) -> dict[str, Any]:
    if not session.found:
        raise Skip("no data set was measured in this call")
    return summary.over_sets(session.found, session.ratios, data.scene_of)


def _accuracy(session: Session) -> Outcome:
    over = _over_sets(session)
    words, good = [], []
    for scene, r in over["scene"].items():
        ate, drift = r["ate_rmse_m_to_best_peer"], r["drift_percent_to_best_peer"]
        without = f", without {', '.join(r['without'])}" if r["without"] else ""
        words.append(f"{scene} {number(ate)}, {number(drift)} ({r['seeds']} seeds{without})")
        good += [not r["lost"], _within(ate, ATE_TO_BEST), _within(drift, DRIFT_TO_BEST)]
    for name in (n for n in ROUGH if n in session.ratios):
        ate = session.ratios[name].get("ate_rmse_m_to_best_peer")
        words.append(f"{name} {number(ate)}")
        good.append(_within(ate, ROUGH_ATE_TO_BEST))
    if not words:
        raise Skip("no data set with a limit on its error was measured")
    held: bool | None = all(good)
    if held and _never_tried(session):
        # The best peer may be among the missing ones.
        held = None
    return Outcome("; ".join(words), over, held, report={"ratio": {"over_sets": over}})


def _within(value: float | None, limit: float) -> bool:
    return value is not None and value <= limit


def _never_tried(session: Session) -> bool:
    """Whether a peer was never run; a peer that cannot be installed has its reason in the report
    instead."""
    return any(p not in of for of in session.found.values() for p in systems.PEERS)


def _cpu(session: Session) -> Outcome:
    over = _over_sets(session)
    mean = over["cpu_to_kiss_icp_geometric_mean"]
    if mean is None:
        raise Skip("no peer was run in this call")
    other = {
        name: r[f"cpu_to_{ALOAM}"]
        for name, r in session.ratios.items()
        if r.get(f"cpu_to_{ALOAM}") is not None
    }
    worst = max(other, key=lambda name: other[name], default=None)
    words = f"{number(mean)} × kiss-icp"
    words += f", worst {number(other[worst])} × a-loam ({worst})" if worst else ""
    held: bool | None = mean <= CPU_TO_KISS and all(r <= CPU_TO_ALOAM for r in other.values())
    if held and not other:
        held, words = None, f"{words}; not judged: a-loam was not run"
    if not set(data.SCENES) <= set(over["scene"]):
        # The mean is defined over all scenes.
        held, words = None, f"{words}; not judged: {', '.join(over['scene']) or 'no scene'} only"
    return Outcome(words, {"to_kiss_icp": mean, "to_a_loam": other}, held)


def _beaten(session: Session) -> Outcome:
    _over_sets(session)
    by = {name: r["beaten_by"] for name, r in session.ratios.items() if r["beaten_by"]}
    words = "; ".join(f"{name}: {', '.join(peers)}" for name, peers in by.items())
    alone = [name for name, of in session.found.items() if not summary.comparable(of)]
    held: bool | None = not by
    if held and alone:
        # With errors only, as kept ones, or without a peer, nobody can be better in both.
        held, words = None, f"on none; not judged: no peer's error and CPU on {', '.join(alone)}"
    return Outcome(words or "on none", {"beaten_by": by, "alone": alone}, held)


def _whole(session: Session) -> Outcome:
    _over_sets(session)
    words, held = [], True
    for name, of in session.found.items():
        if "sweeps" not in of.get(OURS, {}):
            continue
        three = of[OURS]["cpu_ms_per_sweep"]
        whole = of[OURS]["cpu_all_processes_ms_per_sweep"]
        words.append(f"{name} {number(whole)} of {number(three)} ms")
        held &= whole <= max(WHOLE_RATIO * three, three + WHOLE_MORE_MS)
    if not words:
        raise Skip("ours was not run in this call")
    return Outcome("; ".join(words), {}, held)


_LINES: tuple[tuple[str, str, Callable[[Session], Outcome], str], ...] = (
    (
        "accuracy",
        "ATE and drift over the best peer's, median over a scene's seeds",
        _accuracy,
        f"ATE ≤ {ATE_TO_BEST} ×, drift ≤ {DRIFT_TO_BEST} ×, none lost; "
        f"ATE on field and park ≤ {ROUGH_ATE_TO_BEST} ×",
    ),
    (
        "cpu",
        "CPU a sweep of the three algorithms: geometric mean to kiss-icp, worst to a-loam",
        _cpu,
        f"≤ {CPU_TO_KISS:.0f} × kiss-icp, ≤ 1/3 a-loam",
    ),
    ("beaten", "data sets on which a peer is better in error and CPU both", _beaten, "none"),
    (
        "processes",
        "CPU a sweep of all five processes and of the three algorithms",
        _whole,
        f"≤ {WHOLE_RATIO} × or + {WHOLE_MORE_MS:.0f} ms",
    ),
)
