#!/usr/bin/env bash
# lint.sh format | python | tidy BUILD_DIR | sizes
set -euo pipefail
cd "$(dirname "$0")/../.."
cpp_files() { git ls-files '*.cpp' '*.hpp'; }

case "$1" in
  format)
    cpp_files | xargs clang-format --dry-run --Werror
    for crate in services/common/zenoh/bridge services/router tests/mcap_reader; do
      cargo fmt --check --manifest-path "$crate/Cargo.toml" -- --config-path services/common/zenoh/bridge
    done
    ;;
  python)
    .venv/bin/ruff format --check -q .
    .venv/bin/ruff check -q .
    .venv/bin/mypy services/monitor/{src,tests,examples} deploy/build/{tidy,wheel,documents}.py tests
    ;;
  tidy)
    deploy/build/tidy.py "$2"
    ;;
  sizes)  # sed, not head: with head, the writer would fail at the closed pipe
    echo "ten largest files (lines):"
    git ls-files '*.cpp' '*.hpp' '*.rs' '*.py' | xargs wc -l | grep -v ' total$' | sort -rn | sed -n 1,10p
    echo "ten largest functions (code lines, complexity, place):"
    .venv/bin/python -m lizard -l cpp -l python -l rust --csv services tests 2>/dev/null |
      sort -t, -k1 -rn | sed -n 1,10p | awk -F, '{gsub(/"/, ""); print $1, $2, $6}'
    ;;
  *)
    echo "usage: lint.sh format | python | tidy BUILD_DIR | sizes" >&2
    exit 2
    ;;
esac
