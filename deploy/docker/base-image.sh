#!/usr/bin/env bash
# For machines without an image registry: makes the base image, Compose v2 and buildx from Debian packages.
#   base-image.sh [SUITE]      SUITE: trixie (default) or bookworm; imports debian:SUITE-slim
# Makes only what is missing. Needs root, mmdebstrap and a running Docker Engine.
set -euo pipefail
case ${1:-trixie} in
  trixie | bookworm) suite=${1:-trixie} ;;
  -h | --help) sed -n '2,4s/^# //p' "$0"; exit 0 ;;
  *) echo "base-image: $1: trixie or bookworm is expected" >&2; exit 2 ;;
esac
image=debian:$suite-slim
plugins=${DOCKER_CONFIG:-$HOME/.docker}/cli-plugins
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

fail() { echo "base-image: $*" >&2; exit 1; }
command -v docker >/dev/null ||
  fail "Docker is not installed: apt install docker.io (on Debian 13 also docker-cli docker-compose docker-buildx)"
said=$(docker info 2>&1 >/dev/null) || fail "the Docker Engine does not answer: ${said:-docker info failed}"

# What Docker has is kept: a user's Compose may be newer.
missing=()
for plugin in compose buildx; do
  docker "$plugin" version >/dev/null 2>&1 || missing+=("docker-$plugin")
done
docker image inspect "$image" >/dev/null 2>&1 || missing+=("$image")
[ ${#missing[@]} -eq 0 ] || command -v mmdebstrap >/dev/null ||
  fail "${missing[*]} can't be made without mmdebstrap: apt install mmdebstrap"

for name in "${missing[@]}"; do
  [ "$name" != "$image" ] || continue
  echo "base-image: $name into $plugins"
  mmdebstrap --quiet --variant=extract --include="$name" trixie "$work/$name"
  mkdir -p "$plugins"
  cp "$work/$name/usr/libexec/docker/cli-plugins/$name" "$plugins/"
done
if ! docker image inspect "$image" >/dev/null 2>&1; then
  echo "base-image: $image"
  # As in the official slim images: manuals and translations are left out, and dpkg does not sync
  # each file.
  mmdebstrap --quiet --variant=minbase --include=ca-certificates \
    --dpkgopt=force-unsafe-io --dpkgopt='path-exclude=/usr/share/man/*' \
    --dpkgopt='path-exclude=/usr/share/locale/*' --dpkgopt='path-exclude=/usr/share/doc/*' \
    --dpkgopt='path-include=/usr/share/doc/*/copyright' "$suite" "$work/base.tar"
  docker import "$work/base.tar" "$image" >/dev/null
fi
docker compose version
docker buildx version
docker image inspect --format '{{index .RepoTags 0}} {{.Size}} bytes' "$image"
