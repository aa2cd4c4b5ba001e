"""Checks that each document named by a source, a script or another document is in the repository.

A name with a folder is looked up from the repository's root and from the file that has it; a bare
name may also be that of any document of the tree. Links in Markdown are resolved from their file,
whatever they lead to.
"""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
NAMED = re.compile(r"(?<![\w/.-])((?:[\w.-]+/|\.\./)*[\w.-]+\.md)\b")
LINK = re.compile(r"\]\(([^)#\s]+)(?:#[^)\s]*)?\)")
#: documents that programs generate
MADE = {"report.md", "accept.md", "versus.md"}
#: kept as released, so their names may be outdated
FROZEN = "schemas/.released/"


def tracked() -> list[Path]:
    """Files of the project. Without Git, as in an exported tree, all files outside hidden folders
    and the build."""
    listed = subprocess.run(
        ["git", "ls-files", "-co", "--exclude-standard"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    if listed.returncode == 0:
        names = listed.stdout.splitlines()
    else:
        files = (path.relative_to(ROOT) for path in ROOT.rglob("*") if path.is_file())
        names = [
            str(path)
            for path in files
            if path.parts[0] not in ("build", "out") and not path.parts[0].startswith(".")
        ]
    return [ROOT / name for name in names if not name.startswith(FROZEN)]


def missing(path: Path, documents: set[str]) -> Iterator[tuple[int, str]]:
    """(line, name) of each document or link target that does not exist."""
    for number, line in enumerate(path.read_text().splitlines(), start=1):
        for name in NAMED.findall(line):
            there = (ROOT / name).exists() or (path.parent / name).exists()
            if not there and name not in documents and Path(name).name not in MADE:
                yield number, name
        for target in LINK.findall(line) if path.suffix == ".md" else ():
            if "://" not in target and not (path.parent / target).exists():
                yield number, target


def main() -> int:
    files = [path for path in tracked() if path.is_file() and not path.is_symlink()]
    documents = {path.name for path in files if path.suffix == ".md"}
    found = 0
    for path in files:
        try:
            for number, name in missing(path, documents):
                print(
                    f"checks: {path.relative_to(ROOT)}:{number}: no such document: {name}",
                    file=sys.stderr,
                )
                found += 1
        except UnicodeDecodeError:
            continue
    return min(found, 1)


if __name__ == "__main__":
    sys.exit(main())
