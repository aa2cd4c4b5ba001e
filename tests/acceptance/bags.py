"""A bag in any format gives results as good as the capture from which it was made."""

from __future__ import annotations

import hashlib
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from tests.acceptance.framework import Check, Measured
from tests.acceptance.runs import Demo, Setting, is_newer
from tests.recordings import variants
from tests.recordings.variants import CONTAINERS, PLAIN, READABLE, REFUSED, Scan
from zloam_monitor import trajectory

SECONDS = 12
LIMIT_M = 0.001
#: Sizes by container: some GB show whether memory grows; one container is as large as a long
#: drive's bag.
LARGE_GB = {"rosbag1": 4, "sqlite3": 4, "mcap": 20}
LARGE_LIMIT_MB = 400
#: wide records, as from drivers that publish all they know about a point: 8 MB per cloud
WIDE = replace(PLAIN, padding=40)


def checks(setting: Setting) -> list[Check]:
    command = "make demo BAG=out/accept/bags/..."
    return [
        Check(
            "bags-layouts",
            "layouts of PointCloud2: trajectory beside the capture's",
            f"{len(READABLE)} within {1000 * LIMIT_M:.0f} mm",
            command,
            lambda: _layouts(setting),
        ),
        Check(
            "bags-ambiguous",
            "ambiguous layouts: refused with the field and the key that settles it",
            f"{len(REFUSED)} of {len(REFUSED)}",
            command,
            lambda: _refused(setting),
        ),
        Check(
            "bags-files",
            "rosbag 1, SQLite, MCAP, compressed or not: trajectories",
            "same bytes",
            command,
            lambda: _files(setting),
        ),
        Check(
            "bags-large",
            f"bags of {', '.join(f'{gb} GB ({name})' for name, gb in LARGE_GB.items())}: memory of "
            "the reader at most",
            f"{LARGE_LIMIT_MB} MB, all clouds",
            "zloam recording BAG --stream",
            lambda: _large(setting),
        ),
    ]


def _folder(s: Setting) -> Path:
    folder = s.out / "accept" / "bags"
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def _capture(s: Setting) -> Path:
    path = _folder(s) / "capture.pcap"
    program = s.build / "bin" / "zloam-simulator"
    if not is_newer(path, program):
        words = ["--world", "city", "--seed", "3", "--duration", str(SECONDS), "--quiet"]
        files = ["--out", str(path), "--truth", str(path.with_suffix(".tum"))]
        subprocess.run([program, *files, *words], check=True)
    return path


def _scans(s: Setting) -> list[Scan]:
    return variants.decoded(s.build, _capture(s), _folder(s))


def _written(s: Setting, name: str, scans: list[Scan], **how: object) -> Path:
    """Writes a bag, removing an older one first, since the writer does not overwrite."""
    path = _folder(s) / name
    if path.is_dir():
        shutil.rmtree(path)
    path.unlink(missing_ok=True)
    return variants.write(path, scans, **how)  # type: ignore[arg-type]


def _trajectory(demo: Demo) -> Path:
    return demo.results / "trajectory.tum"


def _apart_m(a: Path, b: Path) -> float:
    first, second = trajectory.read(a).transforms, trajectory.read(b).transforms
    if len(first) != len(second):
        raise RuntimeError(f"{len(first)} poses beside {len(second)}")
    return float(np.linalg.norm(first[:, :3, 3] - second[:, :3, 3], axis=1).max())


def _layouts(s: Setting) -> Measured:
    direct = _trajectory(s.demo("bags-direct", "--pcap", _capture(s)))
    scans = _scans(s)
    apart_m = []
    for number, (layout, _) in enumerate(READABLE.values()):
        bag = _written(s, f"layout{number}", scans, layout=layout)
        apart_m.append(_apart_m(direct, _trajectory(s.demo(f"bags-layout{number}", "--bag", bag))))
    within = sum(each <= LIMIT_M for each in apart_m)
    return Measured(
        f"{within} of {len(apart_m)}, at most {1000 * max(apart_m):.2f} mm", within == len(apart_m)
    )


def _refused(s: Setting) -> Measured:
    scans = _scans(s)[:20]
    named = 0
    for number, (layout, words) in enumerate(REFUSED.values()):
        bag = _written(s, f"refused{number}", scans, layout=layout)
        demo = s.demo(f"bags-refused{number}", "--bag", bag)
        named += demo.code == 3 and all(word in demo.said for word in words)
    return Measured(f"{named} of {len(REFUSED)}", named == len(REFUSED))


def _digests(s: Setting) -> Iterator[str]:
    scans = _scans(s)
    for container in CONTAINERS:
        name = f"{container.name}{'.bag' if container.version == 1 else ''}"
        bag = _written(s, name, scans, layout=PLAIN, container=container)
        demo = s.demo(f"bags-{container.name}", "--bag", bag)
        yield hashlib.sha256(_trajectory(demo).read_bytes()).hexdigest()


def _files(s: Setting) -> Measured:
    digests = list(_digests(s))
    different = len(set(digests))
    return Measured(f"{len(digests)} files, {different} results", different == 1)


def _large_bag(s: Setting, container: variants.Container, gigabytes: float) -> tuple[Path, int]:
    """A large bag: the same revolutions repeatedly with later stamps; and the number of clouds."""
    scans = _scans(s)[1:-1]
    name = f"large-{container.name}{'.bag' if container.version == 1 else ''}"
    path = _folder(s) / name
    _remove(path)
    clouds, written = 0, 0.0
    with variants.Recorder(container, path) as bag:
        while written < gigabytes * 1e9:
            scan = scans[clouds % len(scans)]
            later_ns = clouds * variants.PERIOD_NS - scan.stamp_ns + scans[0].stamp_ns
            bag.put_cloud("/points", replace(scan, stamp_ns=scan.stamp_ns + later_ns), WIDE)
            written += len(scan.xyz) * (22 + 6 * WIDE.padding)
            clouds += 1
    return path, clouds


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path)
    path.unlink(missing_ok=True)


def _read(bag: Path) -> tuple[int, int]:
    """Bytes that the reader produced, and its peak memory in bytes."""
    command = [sys.executable, "-m", "zloam_monitor", "recording", str(bag), "--stream"]
    given, peak = 0, 0
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as reader:
        assert reader.stdout is not None
        while block := reader.stdout.read(1 << 24):
            given += len(block)
            peak = max(peak, _peak_bytes(reader.pid))
    if reader.returncode != 0:
        raise RuntimeError(f"the reader ended with {reader.returncode}")
    return given, peak


def _peak_bytes(pid: int) -> int:
    try:
        status = Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return 0
    found = [line.split() for line in status.splitlines() if line.startswith("VmHWM:")]
    return 1024 * int(found[0][1]) if found else 0


def _large(s: Setting) -> Measured:
    figures, holds = [], True
    for container in CONTAINERS:
        if container.name not in LARGE_GB:
            continue
        bag, clouds = _large_bag(s, container, LARGE_GB[container.name])
        try:
            given, peak = _read(bag)
        finally:
            _remove(bag)
        least = sum(24 * len(scan.xyz) for scan in _scans(s)[1:-1]) / len(_scans(s)[1:-1]) * clouds
        holds &= peak <= LARGE_LIMIT_MB * 1e6 and given >= 0.99 * least
        figures.append(
            f"{container.name} {peak / 1e6:.0f} MB ({clouds} clouds, {given / 1e9:.1f} GB)"
        )
    return Measured(", ".join(figures), holds)
