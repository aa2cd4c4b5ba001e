#!/usr/bin/env bash
# Installs missing packages from the distribution (Debian 12 or 13). Prints the list before it asks for root.
# Python packages go into ./.venv (see venv.sh).
#   deps.sh            build and run the programs
#   deps.sh --aloam    also A-LOAM's programs
#   deps.sh --graph    also the graph of loops
#   deps.sh --tests    also both of the above, unit tests, benchmarks and fuzzing
#   deps.sh --tools    also those of --tests, formatting and linting
#   deps.sh --packages also those of --graph, and what makes the wheel and the Debian packages
# If a Docker Engine answers, all but the first also install mmdebstrap, which makes base images without a registry.
# The log of the installation is shown only if it fails.
set -euo pipefail
cd "$(dirname "$0")"

packages=(g++ make cmake ninja-build ccache ca-certificates libeigen3-dev libflatbuffers-dev flatbuffers-compiler
  libyaml-cpp-dev libpugixml-dev libspdlog-dev libfmt-dev libpcap-dev libcli11-dev nlohmann-json3-dev libssl-dev libxxhash-dev
  python3 python3-venv)
graph=(libceres-dev libopencv-features2d-dev)
tests=("${graph[@]}" git libgtest-dev libgmock-dev libpcl-dev clang libclang-rt-dev chromium)
case "${1:-}" in
  "") ;;
  --aloam) packages+=(libceres-dev libpcl-dev) ;;
  --graph) packages+=("${graph[@]}") ;;
  --packages) packages+=("${graph[@]}" binutils dpkg-dev) ;;
  --tests) packages+=("${tests[@]}") ;;
  --tools) packages+=("${tests[@]}" clang-format clang-tidy) ;;
  *) echo "usage: deps.sh [--aloam | --graph | --packages | --tests | --tools]" >&2; exit 2 ;;
esac
[ -z "${1:-}" ] || ! docker info >/dev/null 2>&1 || packages+=(mmdebstrap)

# Zenoh's crates need a recent compiler. One that is in PATH (rustup) is used if it is recent enough.
rust_minimum=1.85
have_rust() {
  command -v cargo >/dev/null && command -v rustc >/dev/null || return 1
  local version
  version=$(rustc --version | sed -E 's/^rustc ([0-9]+\.[0-9]+).*/\1/')
  [ "$(printf '%s\n%s\n' "$rust_minimum" "$version" | sort -V | head -n 1)" = "$rust_minimum" ]
}
have_rust || packages+=(cargo-web rustc-web)

rust_or_fail() {
  have_rust && return
  echo "deps: rustc >= $rust_minimum is needed, and $(command -v rustc || echo "no rustc") comes first in PATH:" \
    "rustup update, or put /usr/bin before it in PATH" >&2
  exit 1
}

missing=()
for package in "${packages[@]}"; do
  [ "$(dpkg-query -W -f='${Status}' "$package" 2>/dev/null)" = "install ok installed" ] || missing+=("$package")
done
if [ ${#missing[@]} -eq 0 ]; then
  rust_or_fail
  echo "deps: everything is installed"
  exit 0
fi

if [ ! -r /etc/debian_version ]; then
  echo "deps: this is not Debian. Install the equivalents of: ${packages[*]}" >&2
  exit 1
fi
echo "deps: to be installed from the distribution (as root, without recommended packages):"
printf '%s\n' "${missing[*]}" | fold -s -w 100 | sed 's/^/  /'
as_root=()
if [ "$(id -u)" -ne 0 ]; then
  command -v sudo >/dev/null || { echo "deps: run as root, or install sudo" >&2; exit 1; }
  as_root=(sudo)
  sudo -v
fi
./apt.sh "${as_root[@]}" -- "${missing[@]}"
rust_or_fail
