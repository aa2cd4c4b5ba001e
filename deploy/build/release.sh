#!/usr/bin/env bash
# release.sh [--dry-run] BUILD_DIR OUT_DIR: makes a release of the commit that is checked out: packages, a bill of
# materials (CycloneDX), their sums, and the tag vX.Y.Z. --dry-run checks and builds, and sets no tag.
# It refuses while anything is uncommitted, the version is not the same in CMakeLists.txt, Dockerfile, the router's
# Cargo.toml and CHANGELOG, or schemas/.released is not what is released. What it packs is built from the commit that it tags:
# BUILD_DIR must be of this checkout, and is brought up to date first.
set -euo pipefail
cd "$(dirname "$0")/../.."
tag_it=true
if [ "${1:-}" = --dry-run ]; then
  tag_it=false
  shift
fi
[ $# -eq 2 ] || { sed -n '2,6s/^# //p' "$0" >&2; exit 2; }
build=$1 out=$2

refuse() { echo "release: $1" >&2; exit 1; }

version=$(sed -nE 's/^project\(\S+ VERSION (\S+).*/\1/p' CMakeLists.txt)
[ -z "$(git status --porcelain)" ] || refuse "there are uncommitted changes: commit or stash them"
others=$(sed -nE 's/^ARG VERSION=(.*)/\1/p' deploy/docker/Dockerfile | grep -vxF "$version" || true)
[ -z "$others" ] || refuse "deploy/docker/Dockerfile has ARG VERSION=$(echo $others), CMakeLists.txt has $version"
router=$(sed -nE 's/^version = "(.*)"/\1/p' services/router/Cargo.toml)
[ "$router" = "$version" ] ||
  refuse "services/router/Cargo.toml has version $router, CMakeLists.txt has $version: set it there and in its Cargo.lock"
heading=$(grep -F "## [$version]" CHANGELOG.md || true)
[ -n "$heading" ] || refuse "CHANGELOG.md has no heading '## [$version] - YYYY-MM-DD'"
if $tag_it; then
  grep -qE "^## \[$version\] - [0-9]{4}-[0-9]{2}-[0-9]{2}$" <<< "$heading" ||
    refuse "CHANGELOG.md: '$heading' has no date"
  for schema in schemas/*.fbs; do
    cmp -s "$schema" "schemas/.released/${schema#schemas/}" ||
      refuse "schemas/.released has not this ${schema#schemas/}: cp schemas/*.fbs schemas/.released/, and commit"
  done
  ! git rev-parse -q --verify "refs/tags/v$version" >/dev/null || refuse "the tag v$version is there already"
fi

commit=$(git rev-parse HEAD)
built_from=$(sed -n 's/^CMAKE_HOME_DIRECTORY:INTERNAL=//p' "$build/CMakeCache.txt" 2>/dev/null || true)
[ "$(realpath -m -- "${built_from:-/}")" = "$(pwd -P)" ] ||
  refuse "$build is a build of ${built_from:-nothing}, not of this checkout: make packages builds it"
cmake --build "$build" -j "$(nproc)" --target programs zloam-graph zloam-sessions zloam-calibrate
deploy/build/packages.sh "$build" "$out"
build/packaging/bin/pip install --quiet --disable-pip-version-check cyclonedx-python-lib==11.12.0
build/packaging/bin/python deploy/build/sbom.py "$build" "$out/zenoh-loam-$version.cdx.json"
(cd "$out" && sha256sum -- *.whl *.deb *.cdx.json > SHA256SUMS && sha256sum --check --quiet SHA256SUMS)
if $tag_it; then
  [ "$(git rev-parse HEAD)" = "$commit" ] && [ -z "$(git status --porcelain)" ] ||
    refuse "the checkout has changed since its build began: nothing was tagged; begin again"
  git tag --annotate "v$version" --message "zenoh-loam $version" "$commit"
  echo "release: tagged v$version; push the tag, and publish what is in $out"
else
  echo "release: $out is complete; no tag was set (--dry-run)"
fi
