#!/usr/bin/env bash
# Builds the three images for arm64 (tag :arm64) on this machine with the distribution's cross compilers. Before
# that, the decoder's tests and every program's --help run on an emulated processor, with the contents of the
# image. `docker save zenoh-loam:arm64 | ssh robot docker load` copies an image to a robot.
# Settings: the build variables of .env (ZLOAM_BASE, ZLOAM_BUILD_NETWORK, ZLOAM_CA_BUNDLE, ZLOAM_JOBS).
set -euo pipefail
cd "$(dirname "$0")/../.."
# shellcheck source=deploy/docker/base.sh
source deploy/docker/base.sh
build() {
  docker buildx build --platform linux/arm64 --file deploy/docker/Dockerfile --target "$1" \
    --network "${ZLOAM_BUILD_NETWORK:-default}" --build-arg "BASE=$base" --build-arg "JOBS=${ZLOAM_JOBS:-2}" \
    --secret "id=ca,src=${ZLOAM_CA_BUNDLE:-deploy/docker/no-ca.crt}" "${@:2}" .
}
build check-emulated --output type=cacheonly
for image in zenoh-loam zenoh-loam-router zenoh-loam-monitor; do
  build "$image" --tag "$image:arm64"
done
docker image inspect --format '{{index .RepoTags 0}} {{.Architecture}} {{.Size}} bytes' \
  zenoh-loam:arm64 zenoh-loam-router:arm64 zenoh-loam-monitor:arm64
