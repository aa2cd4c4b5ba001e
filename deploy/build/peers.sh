#!/usr/bin/env bash
# Creates the virtual environment of the benchmark's peers, unless it exists, and prints the path of
# its Python. All checkouts share it; it is below ~/.cache/zenoh-loam/peers, named by a hash of its
# contents. mad-icp has no wheels and an old build system: if it cannot be built, the reason is in
# mad-icp.log there, and the benchmark skips it.
set -euo pipefail
cd "$(dirname "$0")/../.."
requirements=tests/bench/versus/requirements.txt
mad_icp=mad-icp==0.0.10
python=$(python3 -c 'import sys; print("py%d.%d" % sys.version_info[:2])')
key=$( (cat "$requirements" && echo "$mad_icp") | sha256sum | cut -c1-12)
place=${XDG_CACHE_HOME:-$HOME/.cache}/zenoh-loam/peers/venv-$python-$key
if [ ! -f "$place/complete" ]; then
  mkdir -p "$place"
  exec 9> "$place.lock"
  flock 9
fi
if [ ! -f "$place/complete" ]; then
  echo "peers: installing into $place" >&2
  python3 -m venv "$place"
  pip() { "$place/bin/pip" --quiet --disable-pip-version-check "$@"; }
  pip install -r "$requirements" >&2
  # mad-icp's build files only work with these versions of the tools; Eigen 3.4 is a system package
  if ! { pip install 'scikit-build-core<0.10' pybind11 ninja 'cmake<4' &&
    PATH="$place/bin:$PATH" pip install --no-build-isolation --no-deps --no-binary mad-icp \
      --config-settings=cmake.define.pybind11_DIR="$("$place/bin/python" -m pybind11 --cmakedir)" \
      "$mad_icp"; } > "$place/mad-icp.log" 2>&1; then
    echo "peers: mad-icp can't be built here ($place/mad-icp.log)" >&2
  fi
  touch "$place/complete"
fi
echo "$place/bin/python"
