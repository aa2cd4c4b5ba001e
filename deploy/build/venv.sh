#!/usr/bin/env bash
# Makes ./.venv with the pinned Python packages; does nothing when it already has just these.
set -euo pipefail
cd "$(dirname "$0")/../.."
requirements=services/monitor/requirements.txt
stamp=.venv/requirements.sha256
wanted=$(sha256sum "$requirements" | cut -d' ' -f1)
[ -f "$stamp" ] && [ "$(cat "$stamp")" = "$wanted" ] && exit 0
echo "venv: installing Python packages into .venv"
[ -x .venv/bin/python ] || python3 -m venv .venv
.venv/bin/pip install --quiet --disable-pip-version-check -r "$requirements"
echo "$wanted" > "$stamp"
