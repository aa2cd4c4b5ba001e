# Sourced in the images' build: the names of the target (TARGETARCH of BuildKit) in the distribution and
# the compilers. If the target is not the building machine, `cross` is true and `of` is the suffix of its
# packages.
case "$TARGETARCH" in
  amd64) gnu=x86_64-linux-gnu cpu=x86_64 rust_target=x86_64-unknown-linux-gnu ;;
  arm64) gnu=aarch64-linux-gnu cpu=aarch64 rust_target=aarch64-unknown-linux-gnu ;;
  *) echo "target.sh: no rules for $TARGETARCH" >&2; exit 1 ;;
esac
cross=false of=
if [ "$TARGETARCH" != "$(dpkg --print-architecture)" ]; then
  cross=true of=:$TARGETARCH
  dpkg --add-architecture "$TARGETARCH"
fi
