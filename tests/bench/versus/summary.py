"""From rounds to figures: medians, spread, and ratios of figures measured in the same round."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from tests.bench.versus.score import geometric_mean, median, ratio
from tests.bench.versus.systems import ALOAM, OURS, PEERS

#: results of one system in one round, or {"skipped": reason}, {"failed": reason}
Entry = dict[str, Any]
#: name of the system -> its results
Round = dict[str, Entry]

MEDIANS = (
    *("ate_rmse_m", "ate_max_m", "drift_percent", "drift_deg_per_m", "rpe_1m_m"),
    *("cpu_ms_per_sweep", "rss_mib", "cpu_all_processes_ms_per_sweep", "rss_all_processes_mib"),
    *("realtime_factor", "instant", "sweeps"),
)
#: the peer to which all CPU times are related
KISS = "kiss-icp"
SPREAD = ("ate_rmse_m", "cpu_ms_per_sweep")


def _values(rounds: Iterable[Round], system: str, name: str) -> list[float]:
    found = (r.get(system, {}).get(name) for r in rounds)
    return [float(v) for v in found if v is not None]


def systems_of(rounds: list[Round]) -> dict[str, Entry]:
    """Each system's medians over the rounds."""
    found = {name: _of_system(rounds, name) for name in (OURS, ALOAM, *PEERS)}
    return {name: entry for name, entry in found.items() if entry}


def _of_system(rounds: list[Round], system: str) -> Entry:
    entries = [r[system] for r in rounds if system in r]
    good = [e for e in entries if "sweeps" in e]
    if not good:
        return dict(entries[-1]) if entries else {}
    out: Entry = {}
    for name in MEDIANS:
        values = _values(rounds, system, name)
        if values:
            out[name] = median(values)
    out["spread"] = {
        name: [min(values), max(values)]
        for name in SPREAD
        if (values := _values(rounds, system, name))
    }
    out["lost"] = any(e["lost"] for e in good)
    out["rounds"] = len(good)
    for name in ("version", "cpu_ms_by_stage", "settings", "kept"):
        if name in good[-1]:
            out[name] = good[-1][name]
    return out


def ratios_of(systems: dict[str, Entry], rounds: list[Round]) -> dict[str, Any]:
    """Ratios of ours to the peers'. CPU: the median of the ratios within each round."""
    ours = systems.get(OURS, {})
    out: dict[str, Any] = {}
    for name in ("ate_rmse_m", "drift_percent"):
        best = best_peer(systems, name)
        if best:
            value = ratio(ours.get(name), systems[best][name])
            out[f"{name}_to_best_peer"], out[f"{name}_best_peer"] = value, best
    for peer in (ALOAM, *PEERS):
        each = [_cpu_ratio(r, peer) for r in rounds]
        known = [v for v in each if v is not None]
        if known:
            out[f"cpu_to_{peer}"] = median(known)
            out[f"cpu_to_{peer}_spread"] = [min(known), max(known)]
    out["all_processes_to_algorithms"] = ratio(
        ours.get("cpu_all_processes_ms_per_sweep"), ours.get("cpu_ms_per_sweep")
    )
    out["without"] = [p for p in PEERS if "sweeps" not in systems.get(p, {})]
    out["beaten_by"] = [name for name in systems if _beats(systems[name], ours)]
    return out


def _cpu_ratio(one: Round, peer: str) -> float | None:
    cpu = "cpu_ms_per_sweep"
    return ratio(one.get(OURS, {}).get(cpu), one.get(peer, {}).get(cpu))


def best_peer(systems: dict[str, Entry], name: str) -> str | None:
    """The peer with the smallest error."""
    known = {s: e[name] for s, e in systems.items() if s != OURS and e.get(name) is not None}
    return min(known, key=lambda s: known[s]) if known else None


def comparable(systems: dict[str, Entry]) -> list[str]:
    """The peers of which both error and CPU time are known beside ours."""
    both = ("ate_rmse_m", "cpu_ms_per_sweep")
    known = [s for s, e in systems.items() if all(e.get(name) is not None for name in both)]
    return [s for s in known if s != OURS] if OURS in known else []


def _beats(theirs: Entry, ours: Entry) -> bool:
    """Whether a peer is better than ours in both error and CPU time."""
    pairs = [(theirs.get(n), ours.get(n)) for n in ("ate_rmse_m", "cpu_ms_per_sweep")]
    return all(t is not None and o is not None and t < o for t, o in pairs)


def over_sets(
    found: dict[str, dict[str, Entry]],
    ratios: dict[str, dict[str, Any]],
    scene_of: Callable[[str], str],
) -> dict[str, Any]:
    """Figures over several data sets: per scene over its seeds, CPU time over all."""
    scenes: dict[str, list[str]] = {}
    for data in found:
        if scene_of(data):
            scenes.setdefault(scene_of(data), []).append(data)
    kiss = [r[f"cpu_to_{KISS}"] for r in ratios.values() if f"cpu_to_{KISS}" in r]
    return {
        "scene": {
            scene: {
                "seeds": len(sets),
                "without": sorted({p for d in sets for p in ratios[d].get("without", [])}),
                "lost": [d for d in sets if found[d].get(OURS, {}).get("lost", True)],
                **{
                    name: median(ratios[d].get(name) for d in sets)
                    for name in ("ate_rmse_m_to_best_peer", "drift_percent_to_best_peer")
                },
            }
            for scene, sets in scenes.items()
        },
        "cpu_to_kiss_icp_geometric_mean": geometric_mean(kiss),
    }
