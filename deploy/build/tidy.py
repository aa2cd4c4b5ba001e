#!/usr/bin/env python3
"""Runs clang-tidy over the sources of a build folder that changed since they were last clean.

usage: tidy.py BUILD_DIR [-j N] [PATTERN...]

A file without findings is remembered in ~/.cache/zenoh-loam/tidy (ZLOAM_CACHE names another place)
by a hash of the file, of all headers of this project that it includes, its compile command, the
checks and the tool's version. Findings are printed file by file; the exit code is 1 if there are
any.
"""

from __future__ import annotations

import argparse
import concurrent.futures
import hashlib
import json
import os
import re
import shlex
import subprocess
import sys
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
CACHE_HOME = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "zenoh-loam"
CACHE = Path(os.environ.get("ZLOAM_CACHE", CACHE_HOME)) / "tidy"
INCLUDE = re.compile(rb'^\s*#\s*include\s+"([^"]+)"', re.MULTILINE)
EXTRA = (
    # clang does not know some of GCC's warning flags (cmake/options.cmake)
    "--extra-arg=-Wno-unknown-warning-option",
    # The analyzer gives up on a function earlier than by default (225000 nodes): a file full of
    # FlatBuffers takes 10 s of CPU instead of more than 36 s. Deep paths may be missed.
    *(f"--extra-arg={a}" for a in ("-Xclang", "-analyzer-config", "-Xclang", "max-nodes=20000")),
)
#: parts of the compile database that are not checked
OTHERS = ("/generated/", "/_deps/")


@cache
def included(path: Path) -> frozenset[Path]:
    """Headers that this file includes and that are in the repository or the generated folder."""
    found = set()
    for name in INCLUDE.findall(path.read_bytes()):
        text = name.decode()
        for folder in (path.parent, ROOT / "services", ROOT / "schemas"):
            header = (folder / text).resolve()
            if header.is_file():
                found.add(header)
                break
        if text.endswith("_generated.h"):
            found.add(ROOT / "schemas" / (Path(text).name.removesuffix("_generated.h") + ".fbs"))
    return frozenset(p for p in found if p.is_file())


def closure(path: Path) -> list[Path]:
    """The file and all headers of this project that it includes, directly or not."""
    seen, todo = {path}, [path]
    while todo:
        for header in included(todo.pop()):
            if header not in seen:
                seen.add(header)
                todo.append(header)
    return sorted(seen)


def fingerprint(path: Path, command: str, common: str) -> str:
    """A hash that changes with anything that could change the findings."""
    digest = hashlib.sha256(common.encode())
    # without the checkout's path, so that all checkouts share the results
    digest.update(command.replace(str(ROOT), "").encode())
    for each in closure(path):
        digest.update(str(each.relative_to(ROOT)).encode())
        digest.update(each.read_bytes())
    return digest.hexdigest()[:32]


def sources(build: Path, patterns: list[str]) -> dict[Path, str]:
    """Source -> compile command; without the tests, whose macros cause only noise."""
    found = {}
    for entry in json.loads((build / "compile_commands.json").read_text()):
        path = Path(entry["directory"], entry["file"]).resolve()
        text = str(path)
        if not text.startswith(str(ROOT)) or any(part in text for part in OTHERS):
            continue
        if path.name.endswith("_test.cpp"):
            continue
        if patterns and not any(pattern in text for pattern in patterns):
            continue
        command = entry.get("command") or shlex.join(entry["arguments"])
        found[path] = " ".join(w for w in shlex.split(command) if not w.endswith((".o", ".d")))
    return found


def tidy(build: Path, path: Path) -> tuple[bool, str]:
    """(clean, output)."""
    command = ["clang-tidy", "-p", str(build), "--quiet", *EXTRA, str(path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    errors = [line for line in done.stderr.splitlines() if "error:" in line]
    return done.returncode == 0, done.stdout.strip() + "\n".join(errors)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("build", type=Path)
    parser.add_argument("patterns", nargs="*", help="only paths that contain one of these")
    parser.add_argument("-j", type=int, default=len(os.sched_getaffinity(0)))
    args = parser.parse_intermixed_args()
    version = subprocess.run(
        ["clang-tidy", "--version"], capture_output=True, text=True, check=True
    )
    common = version.stdout + (ROOT / ".clang-tidy").read_text() + " ".join(EXTRA)
    known = sources(args.build, args.patterns)
    marks = {path: CACHE / fingerprint(path, command, common) for path, command in known.items()}
    todo = sorted(path for path, mark in marks.items() if not mark.exists())
    print(f"clang-tidy: {len(known)} files, {len(todo)} changed since they were clean", flush=True)
    CACHE.mkdir(parents=True, exist_ok=True)
    bad = 0
    with concurrent.futures.ThreadPoolExecutor(args.j) as pool:
        runs = {pool.submit(tidy, args.build, path): path for path in todo}
        for run in concurrent.futures.as_completed(runs):
            clean, said = run.result()
            if clean:
                marks[runs[run]].touch()
            else:
                bad += 1
                print(f"{runs[run].relative_to(ROOT)}:\n{said}", flush=True)
    print(f"clang-tidy: {bad} of {len(known)} files have findings")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
