#!/usr/bin/env python3
"""Writes the bill of materials of a build as CycloneDX 1.6.

usage: sbom.py BUILD_DIR OUT_FILE

Crates by the lock files of bridge and router, Python packages by the monitor's requirements, and
the Debian packages of the shared libraries that the built programs load.
"""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

from cyclonedx.model.bom import Bom
from cyclonedx.model.component import Component, ComponentType
from cyclonedx.output.json import JsonV1Dot6
from packageurl import PackageURL

# wheel.py in this folder
from wheel import PROGRAMS, version

ROOT = Path(__file__).resolve().parents[2]
LOCKS = ("services/common/zenoh/bridge/Cargo.lock", "services/router/Cargo.lock")
REQUIREMENTS = "services/monitor/requirements.txt"

Named = tuple[str, str, str | None, str]


def crates() -> Iterator[Named]:
    for lock in LOCKS:
        for package in tomllib.loads((ROOT / lock).read_text())["package"]:
            # a package without a source is a crate of this project
            if "source" in package:
                yield "cargo", package["name"], None, package["version"]


def python_packages() -> Iterator[Named]:
    text = (ROOT / REQUIREMENTS).read_text()
    for name, pinned in re.findall(r"^([\w.-]+)==(\S+)$", text, re.M):
        yield "pypi", name.lower(), None, pinned


def libraries(build: Path) -> set[str]:
    """Paths of the libraries outside the build that the packages' programs load."""
    binaries = [*(build / "bin" / f"zloam-{name}" for name in PROGRAMS), *build.glob("lib/*.so")]
    missing = [path for path in binaries if not path.exists()]
    if missing:
        sys.exit(f"sbom: {missing[0]} is not built: make build")
    said = subprocess.run(["ldd", *binaries], capture_output=True, text=True, check=True).stdout
    found = set(re.findall(r"=> (/\S+)", said))
    return {path for path in found if not path.startswith(str(build))}


def debian_packages(build: Path) -> Iterator[Named]:
    release = dict(re.findall(r'^(\w+)="?([^"\n]*)"?$', Path("/etc/os-release").read_text(), re.M))
    for library in sorted(libraries(build)):
        # dpkg may list a file by its path before or after the merge of /lib into /usr/lib
        names = [library, library.removeprefix("/usr"), str(Path(library).resolve())]
        for name in names:
            owner = subprocess.run(["dpkg", "-S", name], capture_output=True, text=True)
            if owner.returncode == 0:
                break
        else:
            sys.exit(f"sbom: no Debian package has {library}")
        package = owner.stdout.split(": ")[0]
        form = "-f=${Package} ${Version}"
        shown = subprocess.run(
            ["dpkg-query", "-W", form, package], capture_output=True, text=True, check=True
        ).stdout
        yield "deb", shown.split()[0], release.get("ID", "debian"), shown.split()[1]


def component(named: Named) -> Component:
    kind, name, namespace, version = named
    url = PackageURL(type=kind, namespace=namespace, name=name, version=version)
    return Component(
        name=name, version=version, type=ComponentType.LIBRARY, purl=url, bom_ref=str(url)
    )


def main() -> int:
    if len(sys.argv) != 3:
        print(__doc__, file=sys.stderr)
        return 2
    build, out = Path(sys.argv[1]).resolve(), Path(sys.argv[2])
    named = {*crates(), *python_packages(), *debian_packages(build)}
    bom = Bom(components=[component(each) for each in sorted(named, key=str)])
    product = Component(
        name="zenoh-loam", version=version(), type=ComponentType.APPLICATION, bom_ref="zenoh-loam"
    )
    bom.metadata.component = product
    bom.register_dependency(product, bom.components)
    out.write_text(JsonV1Dot6(bom).output_as_string(indent=2) + "\n")
    kinds = [kind for kind, *_ in named]
    counts = ", ".join(f"{kinds.count(kind)} {kind}" for kind in ("cargo", "pypi", "deb"))
    print(f"{out}: {counts}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
