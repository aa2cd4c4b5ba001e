#!/usr/bin/env bash
# apt.sh [sudo] -- PACKAGE...: installs packages with one progress line (on a terminal; elsewhere with one line
# at the end); the output of apt is shown only if it fails.
set -euo pipefail
as_root=()
while [ "$1" != -- ]; do as_root+=("$1"); shift; done
shift
log=$(mktemp)
trap 'rm -f "$log"' EXIT

# apt reports its progress as kind:package:percent:text. The pipe carries nothing else: apt writes to it without
# blocking, and a package's script that shared it would fail whenever it is full.
progress() {
  local kind percent text shown=""
  while IFS=: read -r kind _ percent text; do
    [ -t 1 ] || continue
    case $kind in
      dlstatus) shown="downloading" ;;
      pmstatus) shown="installing" ;;
      *) continue ;;
    esac
    printf '\r\033[Kdeps: %s, %.0f %%: %.60s' "$shown" "$percent" "$text"
  done
  [ -z "$shown" ] || printf '\r\033[K'
}

apt() {
  "${as_root[@]}" env DEBIAN_FRONTEND=noninteractive sh -c 'exec apt-get "$@" 3>&1 1>&2' apt-get \
    -o APT::Status-Fd=3 -o Dpkg::Use-Pty=0 -o APT::Keep-Downloaded-Packages=false "$@" 2>>"$log" | progress
}

fail() {
  echo "deps: apt failed:" >&2
  tail -n 30 "$log" >&2
  exit 1
}

# Slim images have no folder for manuals. Java, a dependency of PCL's VTK, cannot be set up without it.
"${as_root[@]}" mkdir -p /usr/share/man/man1
apt update -q || fail
apt install -y -q --no-install-recommends "$@" || fail
echo "deps: $(grep -E '^(Need to get|After this operation)' "$log" | paste -sd ' ')"
