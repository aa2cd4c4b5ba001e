#!/usr/bin/env bash
# Installs what building and running needs from the distribution (Debian 12 or 13), and nothing that is
# there already. Prints the list before it asks for root. Python goes into ./.venv (see venv.sh).
#   deps.sh            build and run
#   deps.sh --tests    also fuzzing
#   deps.sh --tools    also formatting and linting
# Where a Docker Engine answers, also what makes base images without a registry.
set -euo pipefail

packages=(build-essential cmake ninja-build ccache pkg-config git ca-certificates
  libeigen3-dev libceres-dev libpcl-dev libflatbuffers-dev flatbuffers-compiler libyaml-cpp-dev
  libspdlog-dev libfmt-dev libpcap-dev libcli11-dev nlohmann-json3-dev libssl-dev libxxhash-dev libgtest-dev
  libgmock-dev python3 python3-venv)
case "${1:-}" in
  --tests) packages+=(clang libclang-rt-dev) ;;
  --tools) packages+=(clang libclang-rt-dev clang-format clang-tidy) ;;
esac
docker info >/dev/null 2>&1 && packages+=(mmdebstrap)

# Zenoh's crates need a recent compiler; one that is in PATH (rustup) is used as it is.
rust_minimum=1.85
have_rust() {
  command -v cargo >/dev/null && command -v rustc >/dev/null || return 1
  local version
  version=$(rustc --version | sed -E 's/^rustc ([0-9]+\.[0-9]+).*/\1/')
  [ "$(printf '%s\n%s\n' "$rust_minimum" "$version" | sort -V | head -n 1)" = "$rust_minimum" ]
}
have_rust || packages+=(cargo-web rustc-web)

missing=()
for package in "${packages[@]}"; do
  [ "$(dpkg-query -W -f='${Status}' "$package" 2>/dev/null)" = "install ok installed" ] || missing+=("$package")
done
if [ ${#missing[@]} -eq 0 ]; then
  echo "deps: everything is installed"
  exit 0
fi

if [ ! -r /etc/debian_version ]; then
  echo "deps: this is not Debian. Install the equivalents of: ${packages[*]}" >&2
  exit 1
fi
echo "deps: to be installed from the distribution (as root, without recommended packages):"
printf '  %s\n' "${missing[@]}"
as_root=()
if [ "$(id -u)" -ne 0 ]; then
  command -v sudo >/dev/null || { echo "deps: run as root, or install sudo" >&2; exit 1; }
  as_root=(sudo)
fi
# Slim images have no folder for manuals, without which Java, which PCL's VTK brings along, can't be set up.
"${as_root[@]}" mkdir -p /usr/share/man/man1
"${as_root[@]}" apt-get update -q
"${as_root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get install -y -q --no-install-recommends "${missing[@]}"
have_rust || { echo "deps: rustc >= $rust_minimum is needed and was not found after installation" >&2; exit 1; }
