"""All checks of the acceptance. To add one, append a Check; out/accept.md follows."""

from __future__ import annotations

import functools
import json
import shutil
import subprocess

from tests.acceptance import (
    accuracy,
    aloam,
    bags,
    benches,
    consistency,
    decoded,
    determinism,
    disturbed,
    doctor,
    faults,
    flags,
    hard,
    inputs,
    laps,
    live,
    ringless,
    scanner,
    udp_rate,
    views,
    worlds,
)
from tests.acceptance.framework import Check, Measured, Skip
from tests.acceptance.runs import ROOT, Demo, Setting
from tests.acceptance.seen import Seen

CITY_ATE_M, KITTI_ATE_M, SYNTH_ATE_M = 0.5, 0.15, 0.35
KITTI_SWEEPS = 80
LIVE_P99_MS, FUSED_P99_MS, MAPPED_P99_MS = 100.0, 50.0, 150.0
REPLAY_FACTOR = 3.0
ALGORITHMS = ("registration", "odometry", "mapping")


def all_checks(setting: Setting) -> list[Check]:
    """All checks, in the order of the issue."""
    return [
        *_city(setting),
        *_kitti(setting),
        *_synth(setting),
        *accuracy.checks(setting),
        *aloam.checks(setting),
        *worlds.checks(setting),
        *flags.checks(setting),
        *consistency.checks(setting),
        *laps.checks(setting),
        *hard.checks(setting),
        *ringless.checks(setting),
        *scanner.checks(setting),
        *_decoding(setting),
        *bags.checks(setting),
        *faults.checks(setting),
        *inputs.checks(setting),
        *disturbed.checks(setting),
        *doctor.checks(setting),
        *views.checks(setting),
        *udp_rate.checks(setting),
        *determinism.checks(setting),
        *_live(setting),
        *benches.checks(setting),
        *_robustness(setting),
        *_structure(),
    ]


def _ended(demo: Demo) -> Measured:
    ok = demo.code == 0
    return Measured("exit code 0" if ok else f"exit code {demo.code}: {demo.last_words()}", ok)


def _all_sweeps(demo: Demo, expected: int | None = None) -> Measured:
    sweeps = demo.report["sweeps"]
    wanted = expected if expected is not None else sweeps["driver"]["in"]
    counts = {stage: (s["in"], s["out"]) for stage, s in sweeps.items()}
    held = wanted > 0 and all(pair == (wanted, wanted) for pair in counts.values())
    figure = f"{wanted} in and out of each stage" if held else str(counts)
    return Measured(figure, held)


def _identities(demo: Demo) -> Measured:
    found = demo.report["identities"]
    held = found["inputs_balanced"] and found["sweeps_accounted"]
    return Measured("both hold" if held else "; ".join(found["complaints"]), held)


def _below(figure: float | None, limit: float, unit: str) -> Measured:
    if figure is None:
        return Measured("no figure", False)
    return Measured(f"{figure:.3f} {unit}", figure <= limit)


def _ate(demo: Demo, reference: str, limit: float) -> Measured:
    return _below(demo.pose_errors(reference)["ate_rmse_m"], limit, "m")


def _city(s: Setting) -> list[Check]:
    truth = "simulated_truth.tum"
    command = "make demo"
    return [
        Check(
            "city-ends",
            "make demo ends with 0 on the simulated city loop",
            "exit code 0",
            command,
            lambda: _ended(s.city()),
        ),
        Check(
            "city-sweeps",
            "city loop: sweeps in = sweeps out",
            "equal at every stage",
            command,
            lambda: _all_sweeps(s.city()),
        ),
        Check(
            "city-identities",
            "city loop: both identities of the accounts",
            "both hold",
            command,
            lambda: _identities(s.city()),
        ),
        Check(
            "city-ate",
            "city loop: ATE of the fused pose",
            f"≤ {CITY_ATE_M} m",
            command,
            lambda: _ate(s.city(), truth, CITY_ATE_M),
        ),
    ]


def _kitti(s: Setting) -> list[Check]:
    command = "make demo KITTI=../shared/data/hdl64e_drive"
    references = ("reference_kiss.kitti.txt", "reference_small_gicp.kitti.txt")
    return [
        Check(
            "kitti-sweeps",
            "real HDL-64E drive: all sweeps, accounted for",
            f"{KITTI_SWEEPS} at every stage",
            command,
            lambda: _all_sweeps(s.kitti(), KITTI_SWEEPS),
        ),
        *(
            Check(
                f"kitti-ate-{r.split('.')[0][10:]}",
                f"real HDL-64E drive: ATE against {r}",
                f"≤ {KITTI_ATE_M} m",
                command,
                functools.partial(lambda r: _ate(s.kitti(), r, KITTI_ATE_M), r),
            )
            for r in references
        ),
    ]


def _cpu_beside_kiss(s: Setting) -> Measured:
    ours = sum(s.synth().report["cpu_ms_per_sweep"][stage] for stage in ALGORITHMS)
    kiss = float(s.kiss(s.synth_folder())["cpu_ms_per_sweep"])
    ratio = ours / kiss
    return Measured(
        f"{ours:.0f} ms, KISS-ICP {kiss:.0f} ms: {ratio:.1f} ×",
        ours > 0 and kiss > 0,
    )


def _synth(s: Setting) -> list[Check]:
    command = "make demo SCANS=~/.cache/zenoh-loam/synth/city-7"
    return [
        Check(
            "synth-sweeps",
            "synthetic city (seed 7): sweeps in = sweeps out",
            "equal at every stage",
            command,
            lambda: _all_sweeps(s.synth()),
        ),
        Check(
            "synth-ate",
            "synthetic city (seed 7): ATE (A-LOAM, every sweep mapped: 0.327 m)",
            f"≤ {SYNTH_ATE_M} m",
            command,
            lambda: _ate(s.synth(), "gt_dense.tum", SYNTH_ATE_M),
        ),
        Check(
            "synth-cpu",
            "synthetic city: CPU per sweep of the three algorithms, beside KISS-ICP",
            "reported",
            "make accept ONLY=synth-cpu",
            lambda: _cpu_beside_kiss(s),
        ),
    ]


def _compared(s: Setting, name: str) -> Measured:
    source, theirs = decoded.source_of(s, name)
    sweeps = decoded.through_the_chain(s, source, name)
    if not sweeps.published == sweeps.received == sweeps.poses:
        return Measured(
            f"{sweeps.published} sweeps published, {sweeps.received} received, "
            f"{sweeps.poses} poses",
            False,
        )
    worst, excess = decoded.worst_excess_m(sweeps.points, theirs)
    return Measured(
        f"{sweeps.published} sweeps, {len(theirs)} points, worst {worst * 1e3:.2f} mm, "
        f"{excess * 1e3:.2f} mm beyond the azimuth's rounding",
        excess <= decoded.LIMIT_M,
    )


def _decoding(s: Setting) -> list[Check]:
    return [
        Check(
            f"decode-{name[6:]}",
            f"{name}: every sweep arrives, positions as velodyne-decoder's",
            "2 mm + azimuth rounding",
            f"make demo {kind}=../shared/data/{name}/{file}",
            functools.partial(_compared, s, name),
        )
        for name, kind, file in (
            ("vlp16_mislabelled", "PCAP", "capture.pcap"),
            ("vlp16_single", "BIN", "packets.bin"),
            ("vlp16_dual", "BIN", "packets.bin"),
        )
    ]


def _replay_factor(s: Setting) -> Measured:
    factor = s.city().report["realtime_factor"]
    return Measured(f"{factor:.1f} × real time", factor >= REPLAY_FACTOR)


def _live(s: Setting) -> list[Check]:
    @functools.cache
    def report() -> str:
        return json.dumps(live.run(s))

    def no_loss() -> Measured:
        found = json.loads(report())
        lost = {
            stage: {**v["dropped"], **({"lost": v["lost"]} if v["lost"] else {})}
            for stage, v in found["sweeps"].items()
            if stage != "mapping" and (v["dropped"] or v["lost"])
        }
        sweeps, poses = found["identities"]["sweeps"], found["identities"]["poses"]
        held = not lost and sweeps == poses and sweeps >= live.SECONDS * 9
        return Measured(f"{sweeps} sweeps, {poses} poses" + (f", {lost}" if lost else ""), held)

    def latency(which: str, limit_ms: float) -> Measured:
        found = json.loads(report())["latency_ms"][which]
        if not found:
            return Measured("no figure", False)
        return Measured(
            f"p50 {found['p50']:.0f}, p95 {found['p95']:.0f}, p99 {found['p99']:.0f} ms",
            found["p99"] <= limit_ms,
        )

    command = "make accept ONLY=live"
    return [
        Check(
            "live-loss",
            "live at 10 Hz over UDP: no sweep lost on the pose path",
            "none lost",
            command,
            no_loss,
        ),
        Check(
            "replay-factor",
            "replay of the city loop, as fast as the chain acknowledges",
            f"≥ {REPLAY_FACTOR:.0f} × real time",
            "make demo",
            lambda: _replay_factor(s),
        ),
        *(
            Check(
                name,
                f"live at 10 Hz over UDP: last packet to {what}",
                f"p99 ≤ {limit_ms:.0f} ms",
                command,
                functools.partial(latency, which, limit_ms),
            )
            for name, what, which, limit_ms in (
                ("live-latency", "fused pose", "end_to_end", LIVE_P99_MS),
                ("live-fused", "fused pose, the method's own line", "end_to_end", FUSED_P99_MS),
                ("live-mapped", "mapped pose", "mapped_pose", MAPPED_P99_MS),
            )
        ),
    ]


def _pytest(s: Setting, *files: str) -> Measured:
    seen = Seen()
    seen.read_pytest(s, *files)
    return seen.judged(seen.words())


def _robustness(s: Setting) -> list[Check]:
    rows = (
        (
            "refusals",
            "wrong configuration, truncated pcap, missing file, port in use: clear errors",
            "test_refusals.py",
        ),
        ("garbage", "garbage on each key: counted, no crash, poses go on", "test_garbage.py"),
        (
            "odd-sweeps",
            "empty, NaN, one point, one ring, all equal into every stage",
            "test_odd_sweeps.py",
        ),
        (
            "third-party",
            "a stranger with eclipse-zenoh and generated code sees every pose",
            "test_third_party.py",
        ),
        (
            "hokuyo-tests",
            "scanner on a motor: real sessions byte by byte, same bytes twice and after a kill, "
            "live over TCP and a serial line with faults",
            "test_hokuyo.py",
        ),
    )
    return [
        Check(
            name,
            line,
            "all tests pass",
            f".venv/bin/python -m pytest tests/integration/{file}",
            functools.partial(_pytest, s, f"tests/integration/{file}"),
        )
        for name, line, file in rows
    ]


def _structure() -> list[Check]:
    def layers() -> Measured:
        if shutil.which("flatc") is None:
            raise Skip("flatc is not installed")
        done = subprocess.run(
            ["deploy/build/checks.sh"], cwd=ROOT, capture_output=True, text=True, check=False
        )
        said = (done.stdout + done.stderr).strip().splitlines() or ["silent"]
        return Measured(said[0][:160], done.returncode == 0)

    def clean_clone() -> Measured:
        raise Skip("needs a clean machine: .ci/run prints the time of each step there")

    return [
        Check(
            "layers",
            "no algorithm sees Zenoh, FlatBuffers, logs, clocks, threads, other stages",
            "holds",
            "deploy/build/checks.sh",
            layers,
        ),
        Check(
            "clean-clone",
            "make test from a clean clone",
            "≤ 35 min, ≤ 12 min warm",
            ".ci/run",
            clean_clone,
        ),
    ]
