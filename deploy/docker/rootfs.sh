#!/bin/sh
# rootfs.sh ARCH FOLDER PACKAGE...: unpacks packages of another architecture and their dependencies into a
# folder that becomes the root of an image. No program of them is run, because this machine may have no
# emulation.
set -eu
arch=$1 root=$2
shift 2
debs=$(mktemp -d)
mkdir -p "$debs/partial" "$root"
: > "$debs/status"
apt-get install -q -y --download-only --no-install-recommends -o "APT::Architecture=$arch" \
  -o "APT::Architectures::=$arch" -o "Dir::State::status=$debs/status" -o "Dir::Cache::archives=$debs" \
  base-files base-passwd libc-bin dash coreutils grep sed util-linux "$@"
dpkg-deb -x "$(ls "$debs"/base-files_*.deb)" "$root"
for deb in "$debs"/*.deb; do dpkg-deb -x "$deb" "$root"; done
rm -rf "$debs" "$root/usr/share/doc" "$root/usr/share/man" "$root/usr/share/locale"
printf 'root:x:0:0:root:/root:/bin/sh\nzloam:x:1000:1000::/nonexistent:/usr/sbin/nologin\n' > "$root/etc/passwd"
printf 'root:x:0:\nzloam:x:1000:\n' > "$root/etc/group"
mkdir -p "$root/out" "$root/data" "$root/tmp"
chown 1000:1000 "$root/out" "$root/data"
chmod 1777 "$root/tmp"
