# Sourced by the scripts that build images: sets the base image ($base). If the image, Compose or buildx is missing,
# base-image.sh makes it; the exit code is 3 if that fails. Uses the CA bundle of this machine's pip or OpenSSL, which
# the build of the images needs too, and the build variables of .env.
bundle=${PIP_CERT:-${SSL_CERT_FILE:-}}
if [ -z "${ZLOAM_CA_BUNDLE:-}" ] && [ -r "$bundle" ] && grep -qx 'ZLOAM_CA_BUNDLE=deploy/docker/no-ca.crt' .env; then
  export ZLOAM_CA_BUNDLE=$bundle
fi
# As for Compose, a variable of the shell wins over .env.
for setting in ZLOAM_BASE ZLOAM_BUILD_NETWORK ZLOAM_CA_BUNDLE ZLOAM_JOBS; do
  value=$(sed -nE "s/^$setting=[\"']?([^\"']*)[\"']?\$/\1/p" .env | tail -n 1)
  [ -n "${!setting:-}" ] || [ -z "$value" ] || export "$setting=$value"
done
base=${ZLOAM_BASE:-debian:trixie-slim}
have_base() { docker image inspect "$base" || docker pull -q "$base"; }
if ! docker compose version >/dev/null 2>&1 || ! docker buildx version >/dev/null 2>&1 || ! have_base >/dev/null 2>&1; then
  suite=${base#debian:}
  deploy/docker/base-image.sh "${suite%-slim}" || exit 3
fi
