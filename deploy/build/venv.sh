#!/usr/bin/env bash
# Makes ./.venv with the pinned Python packages; does nothing when it already has them.
#   venv.sh            what the programs need to run
#   venv.sh --view     also what shows a robot in Rerun and Foxglove
#   venv.sh --tests    also that, and what tests and lint need
set -euo pipefail
cd "$(dirname "$0")/../.."
run=services/monitor/requirements.txt
view=services/monitor/requirements-view.txt
tests=services/monitor/requirements-tests.txt
peers=services/monitor/requirements-peers.txt
stamp=.venv/requirements.sha256
hash_of() { cat "$@" | sha256sum | cut -d' ' -f1; }
has=$(cat "$stamp" 2>/dev/null || true)
[ "$has" != "$(hash_of $run $view $tests $peers)" ] || exit 0
case "${1:-}" in
  "")
    [ "$has" != "$(hash_of $run)" ] && [ "$has" != "$(hash_of $run $view)" ] || exit 0
    wanted=$run made=$(hash_of $run)
    ;;
  --view)
    [ "$has" != "$(hash_of $run $view)" ] || exit 0
    wanted=$view made=$(hash_of $run $view)
    ;;
  --tests) wanted=$tests made=$(hash_of $run $view $tests $peers) ;;
  *) echo "usage: venv.sh [--view | --tests]" >&2; exit 2 ;;
esac
echo "venv: installing $(cat $run $([ "$wanted" = $run ] || echo $view) "$wanted" | grep -E '^[^#-].*==' | sort -u | wc -l) Python packages into .venv"
[ -x .venv/bin/python ] || python3 -m venv .venv
# Python compiles what is imported, a third of it, at its first start.
.venv/bin/pip install --quiet --disable-pip-version-check --no-compile -r "$wanted"
if [ "$wanted" = $tests ]; then
  .venv/bin/pip install --quiet --disable-pip-version-check --no-compile \
    --no-deps --no-warn-conflicts -r $peers ||
    echo "venv: $peers has nothing for this system: what compares with it is skipped" >&2
fi
echo "$made" > "$stamp"
