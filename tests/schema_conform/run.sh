#!/usr/bin/env bash
# The schemas against the last release (schemas/.released): a reader of either must understand the other.
# And the check against itself: a change that would break readers must be refused.
set -euo pipefail
cd "$(dirname "$0")/../.."
released=schemas/.released
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT

conforms() { # new schema, its includes
  flatc --conform "$released/$(basename "$1")" --conform-includes "$released" -I "$2" "$1" > "$scratch/out" 2>&1
}

count=0
for old in "$released"/*.fbs; do
  new=schemas/$(basename "$old")
  [ -f "$new" ] || { echo "$new was removed"; exit 1; }
  conforms "$new" schemas || { echo "$new breaks $old:"; cat "$scratch/out"; exit 1; }
  count=$((count + 1))
done
[ "$count" -gt 0 ] || { echo "$released is empty"; exit 1; }

refused() { # what, sed expression, file
  cp schemas/*.fbs "$scratch/"
  sed -i "$2" "$scratch/$3"
  cmp -s "schemas/$3" "$scratch/$3" && { echo "the probe '$1' changed nothing"; exit 1; }
  if conforms "$scratch/$3" "$scratch"; then echo "not refused: $1"; exit 1; fi
}
refused "a field's type" 's/period_ns:uint32 (id: 3)/period_ns:uint64 (id: 3)/' sweep.fbs
refused "a field's number" 's/health:Health (id: 13)/health:Health (id: 14)/; s/prev_sweep:uint64 (id: 14)/prev_sweep:uint64 (id: 13)/' odometry.fbs
echo "schema_conform: $count schemas conform"
