#!/usr/bin/env bash
# Creates ./.venv with the pinned Python packages; does nothing if it already has them.
#   venv.sh            packages that the programs need to run
#   venv.sh --view     also those to show a robot in Rerun and Foxglove
#   venv.sh --tests    also all of these, and those for tests and lint
set -euo pipefail
cd "$(dirname "$0")/../.."
run=services/monitor/requirements.txt
view=services/monitor/requirements-view.txt
tests=services/monitor/requirements-tests.txt
peers=services/monitor/requirements-peers.txt
stamp=.venv/requirements.sha256
# The packages belong to one Python: after an upgrade of the distribution they are of no use to the next.
python=$(python3 -c 'import sys; print(sys.version, sys.base_prefix)')
hash_of() { { echo "$python"; cat "$@"; } | sha256sum | cut -d' ' -f1; }
has=$(cat "$stamp" 2>/dev/null || true)
# What an interrupted run left, or a Python that has gone, is replaced.
if [ -d .venv ] && ! .venv/bin/python -m pip --version >/dev/null 2>&1; then
  echo "venv: .venv has no working Python with pip: it is replaced"
  rm -rf .venv
  has=
fi
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
# Without --no-compile pip would compile all modules; Python compiles the third that is imported at its first start.
.venv/bin/pip install --quiet --disable-pip-version-check --no-compile -r "$wanted"
if [ "$wanted" = $tests ]; then
  said=$(.venv/bin/pip install --quiet --disable-pip-version-check --no-compile \
    --no-deps --no-warn-conflicts -r $peers 2>&1) || {
    printf '%s\n' "$said" >&2
    case $said in
      *"No matching distribution"*)
        echo "venv: $peers has nothing for this system: what compares with it is skipped" >&2 ;;
      *)
        echo "venv: $peers could not be installed: what compares with it is skipped, and the next run tries again" >&2
        made=$(hash_of $run $view) ;;
    esac
  }
fi
echo "$made" > "$stamp"
