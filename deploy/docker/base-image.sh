#!/usr/bin/env bash
# For machines without an image registry: makes the base image, Compose v2 and buildx from Debian packages.
#   base-image.sh [SUITE]      SUITE: trixie (default) or bookworm; imports debian:SUITE-slim
# Does nothing that is done already. Needs root, mmdebstrap and a running Docker Engine.
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

command -v mmdebstrap >/dev/null || { echo "base-image: install mmdebstrap (make tools)" >&2; exit 1; }
docker info >/dev/null 2>&1 || { echo "base-image: the Docker Engine does not answer" >&2; exit 1; }

if [ ! -x "$plugins/docker-compose" ] || [ ! -x "$plugins/docker-buildx" ]; then
  echo "base-image: Compose and buildx into $plugins"
  mmdebstrap --quiet --variant=extract --include=docker-compose,docker-buildx trixie "$work/plugins"
  mkdir -p "$plugins"
  cp "$work"/plugins/usr/libexec/docker/cli-plugins/docker-* "$plugins/"
fi
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
