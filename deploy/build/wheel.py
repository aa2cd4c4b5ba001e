#!/usr/bin/env python3
"""Packs the monitor and the built programs into a wheel `zloam`.

usage: wheel.py BUILD_DIR OUT_DIR

The wheel contains the programs in zloam_monitor/bundled/bin, the Zenoh library in bundled/lib, the
robots' files and the generated message code. `auditwheel repair` adds the shared libraries and tags
the wheel with the oldest C library that it runs on (packages.sh).
"""

from __future__ import annotations

import base64
import hashlib
import json
import platform
import re
import shutil
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
STAGE_FILE = ROOT / "services/stages.json"
#: programs that need OpenCV, whose libraries need X11: a wheel cannot contain them, nor does every
#: system have them
NEED_OPENCV = {"graph"}
STAGES = [row["name"] for row in json.loads(STAGE_FILE.read_text())]
PROGRAMS = (*(name for name in STAGES if name not in NEED_OPENCV), "decode", "calibrate")
#: lower bounds; services/monitor/requirements.txt pins the newest tested versions
REQUIRES = (
    "numpy>=1.23",
    "matplotlib>=3.6",
    "flatbuffers>=24,<26",
    "PyYAML>=6",
    "typer>=0.15",
    "rich>=13",
    "rosbags>=0.11",
    "pypcd4>=1.4",
    "laspy[lazrs]>=2.5",
    "prometheus_client>=0.19",
    "mcap>=1.6",
    "foxglove-schemas-flatbuffer>=0.3",
)
#: extra requirements, larger than all others together: pip install 'zloam[view]'
VIEW_REQUIRES = ("rerun-sdk>=0.40", "foxglove-sdk>=0.20")
#: must have the same version as the programs' Zenoh, with which it communicates
EXACT = "eclipse-zenoh"


def version() -> str:
    found = re.search(r"^project\(\S+ VERSION (\S+)", (ROOT / "CMakeLists.txt").read_text(), re.M)
    assert found is not None
    return found[1]


def pinned(package: str) -> str:
    text = (ROOT / "services/monitor/requirements.txt").read_text()
    found = re.search(rf"^{package}==\S+$", text, re.M)
    assert found is not None
    return found[0]


def metadata() -> str:
    requires = "".join(f"Requires-Dist: {each}\n" for each in (*REQUIRES, pinned(EXACT)))
    requires += "Provides-Extra: view\n"
    requires += "".join(f'Requires-Dist: {each}; extra == "view"\n' for each in VIEW_REQUIRES)
    return (
        f"Metadata-Version: 2.1\nName: zloam\nVersion: {version()}\n"
        "Summary: LiDAR odometry and mapping over Eclipse Zenoh\n"
        f"License: Apache-2.0\nRequires-Python: >=3.10\n{requires}"
        "Description-Content-Type: text/markdown\n\n" + (ROOT / "README.md").read_text()
    )


def gather(build: Path, tree: Path) -> None:
    """Collects the package below `tree` as it is to be installed."""
    package = tree / "zloam_monitor"
    shutil.copytree(
        ROOT / "services/monitor/src/zloam_monitor",
        package,
        ignore=shutil.ignore_patterns("__pycache__"),
    )
    shutil.copy(STAGE_FILE, package)
    bundled = package / "bundled"
    for folder in ("bin", "lib", "robots"):
        (bundled / folder).mkdir(parents=True)
    for name in PROGRAMS:
        program = bundled / "bin" / f"zloam-{name}"
        shutil.copy(build / "bin" / program.name, program)
        stripped(program, "$ORIGIN/../lib")
    library = bundled / "lib" / "libzloam_zenoh.so"
    shutil.copy(build / "lib" / library.name, library)
    stripped(library, "$ORIGIN")
    shutil.copytree(build / "generated/python/zloam", bundled / "python/zloam")
    for path in (ROOT / "deploy/robots").glob("*.*"):
        shutil.copy(path, bundled / "robots")
    shutil.copy(ROOT / "LICENSE", package)
    shutil.copy(ROOT / "THIRD_PARTY.md", package)


def stripped(binary: Path, rpath: str) -> None:
    """Strips symbols, and makes the program find its libraries by `rpath`."""
    binary.chmod(0o755)
    subprocess.run(["strip", "--strip-unneeded", binary], check=True)
    subprocess.run(["patchelf", "--set-rpath", rpath, binary], check=True)


def record_line(name: str, data: bytes) -> str:
    digest = base64.urlsafe_b64encode(hashlib.sha256(data).digest()).rstrip(b"=").decode()
    return f"{name},sha256={digest},{len(data)}\n"


def pack(tree: Path, out: Path) -> Path:
    """Packs the tree; the same tree gives the same bytes."""
    tag = f"py3-none-linux_{platform.machine()}"
    info = f"zloam-{version()}.dist-info"
    (tree / info).mkdir()
    (tree / info / "METADATA").write_text(metadata())
    (tree / info / "WHEEL").write_text(
        f"Wheel-Version: 1.0\nGenerator: zenoh-loam\nRoot-Is-Purelib: false\nTag: {tag}\n"
    )
    (tree / info / "entry_points.txt").write_text(
        "[console_scripts]\nzloam = zloam_monitor.cli:entry\n"
    )
    out.mkdir(parents=True, exist_ok=True)
    wheel = out / f"zloam-{version()}-{tag}.whl"
    record = ""
    with zipfile.ZipFile(wheel, "w", zipfile.ZIP_DEFLATED) as archive:
        for path in sorted(p for p in tree.rglob("*") if p.is_file()):
            name, data = path.relative_to(tree).as_posix(), path.read_bytes()
            entry = zipfile.ZipInfo(name)
            entry.external_attr = (0o755 if path.stat().st_mode & 0o100 else 0o644) << 16
            entry.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(entry, data)
            record += record_line(name, data)
        archive.writestr(f"{info}/RECORD", record + f"{info}/RECORD,,\n")
    return wheel


def main() -> int:
    if len(sys.argv) != 3:
        print(__doc__, file=sys.stderr)
        return 2
    with tempfile.TemporaryDirectory() as folder:
        gather(Path(sys.argv[1]), Path(folder))
        print(pack(Path(folder), Path(sys.argv[2])))
    return 0


if __name__ == "__main__":
    sys.exit(main())
