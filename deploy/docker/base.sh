# Sourced by the scripts that build images: names the base image ($base) and has it made where there is none,
# Compose and buildx too; ends with 3 where that can't be. Takes the CA bundle of this machine's own pip and
# OpenSSL, which the images' build needs too.
base=${ZLOAM_BASE:-debian:trixie-slim}
bundle=${PIP_CERT:-${SSL_CERT_FILE:-}}
if [ -z "${ZLOAM_CA_BUNDLE:-}" ] && [ -r "$bundle" ] && grep -qx 'ZLOAM_CA_BUNDLE=deploy/docker/no-ca.crt' .env; then
  export ZLOAM_CA_BUNDLE=$bundle
fi
have_base() { docker image inspect "$base" || docker pull -q "$base"; }
if ! docker compose version >/dev/null 2>&1 || ! docker buildx version >/dev/null 2>&1 || ! have_base >/dev/null 2>&1; then
  suite=${base#debian:}
  deploy/docker/base-image.sh "${suite%-slim}" || exit 3
fi
