#!/usr/bin/env bash
# Builds the three images, and those of the layers in COMPOSE_FILE (.env), such as zenoh-loam-aloam. On machines without
# an image registry, the base image is made from the distribution's packages.
#   images.sh               Rust is compiled in the image's build
#   images.sh --prebuilt    Rust is taken from this machine's cache (deploy/build/rust.sh), for machines that
#                           have compiled it anyway; their C library must not be newer than the image's
# The exit code is 3 if there is neither a base image nor a way to make one.
# Settings: the build variables of .env (ZLOAM_BASE, ZLOAM_BUILD_NETWORK, ZLOAM_CA_BUNDLE, ZLOAM_JOBS).
set -euo pipefail
case "$#:${1:-}" in
  0: | 1:--prebuilt) ;;
  *) sed -n '2,8s/^# \{0,1\}//p' "$0" >&2; exit 2 ;;
esac
cd "$(dirname "$0")/../.."
# shellcheck source=deploy/docker/base.sh
source deploy/docker/base.sh
if [ "${1:-}" = --prebuilt ]; then
  export ZLOAM_RUST=prebuilt
  ZLOAM_KEEP_CARGO=1 deploy/build/rust.sh deploy/docker/prebuilt/libzloam_zenoh.so
  deploy/build/rust.sh --router deploy/docker/prebuilt/zloam-router
fi
# Under this profile compose/live.yml has the services of a replay, and so the monitor's image.
# replay.yml and imu.yml require a file to replay, which no image holds.
ZLOAM_PCAP=. ZLOAM_IMU=. docker compose --profile replay build
docker image inspect --format '{{index .RepoTags 0}} {{.Size}} bytes' zenoh-loam zenoh-loam-router zenoh-loam-monitor
