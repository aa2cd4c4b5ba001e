#!/usr/bin/env bash
# rust.sh [--router | --mcap-reader] OUTPUT: copies libzloam_zenoh.so, built from services/common/zenoh/bridge, to
# OUTPUT; with --router zloam-router, built from services/router; with --mcap-reader zloam-mcap-reader, built from
# tests/mcap_reader. They share the crates that their lock files have in common.
# A product is built once for each (sources, lock file, compiler, flags) and kept in
# ~/.cache/zenoh-loam/rust/<hash>/ (ZLOAM_CACHE names another place), so that all build directories and
# presets share it. Without a change this only computes a hash; the first build takes some minutes. Cargo's
# intermediate files (700 MB), and the crates' sources if cargo had none before, are removed, unless
# ZLOAM_KEEP_CARGO is set: for work on the crate, or for several products in a row.
set -euo pipefail
case "${1:-}" in
  --router) folder=services/router name=zloam-router; shift ;;
  --mcap-reader) folder=tests/mcap_reader name=zloam-mcap-reader; shift ;;
  *) folder=services/common/zenoh/bridge name=libzloam_zenoh.so ;;
esac
[ $# -eq 1 ] || { echo "usage: rust.sh [--router | --mcap-reader] OUTPUT" >&2; exit 2; }
output=$1
crate=$(cd "$(dirname "$0")/../../$folder" && pwd)
cache=${ZLOAM_CACHE:-${XDG_CACHE_HOME:-$HOME/.cache}/zenoh-loam}
for tool in cargo rustc; do
  command -v "$tool" >/dev/null || { echo "rust.sh: $tool is not in PATH (see deploy/build/deps.sh)" >&2; exit 1; }
done

# Cargo.toml contains the build profile, so the hash covers it.
hash=$(cd "$crate" && {
  find Cargo.toml Cargo.lock build.rs src -type f -print0 2>/dev/null | LC_ALL=C sort -z | xargs -0 sha256sum
  rustc -vV
  printf '%s' "${CARGO_BUILD_TARGET:-}"
  printf '%s\n' "${RUSTFLAGS:-}" "${CARGO_ENCODED_RUSTFLAGS:-}"
} | sha256sum | cut -c1-16)
built=$cache/rust/$hash/$name

build() {
  echo "rust.sh: building $name ($hash); later builds take it from $cache/rust"
  local target=$cache/cargo-target registry=${CARGO_HOME:-$HOME/.cargo}/registry
  local own=$registry
  [ ! -e "$registry" ] || own=""
  # Other checkouts build into the same file, and cargo would take their product for this one.
  local made=$target/${CARGO_BUILD_TARGET:+$CARGO_BUILD_TARGET/}release
  rm -f "$made/$name" "$made/deps/$name"
  (cd "$crate" && CARGO_TARGET_DIR=$target cargo build --release --locked)
  mkdir -p "$(dirname "$built")"
  cp "$made/$name" "$built.$$"
  mv "$built.$$" "$built"
  [ -n "${ZLOAM_KEEP_CARGO:-}" ] || rm -rf "$target" ${own:+"$own"}
}

if [ ! -f "$built" ]; then
  mkdir -p "$cache"
  exec 9>"$cache/rust.lock"
  flock 9
  [ -f "$built" ] || build # another process may have built it during the wait for the lock
  exec 9>&-
fi
# A copy, not a link, so that it can be stripped or packed and outlives the cache.
mkdir -p "$(dirname "$output")"
cp "$built" "$output.$$"
mv "$output.$$" "$output"
