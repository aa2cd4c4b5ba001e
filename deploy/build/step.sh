#!/usr/bin/env bash
# step.sh NAME COMMAND...: runs the command and prints how long it took; the exit code is the command's.
set -uo pipefail
name=$1
shift
printf '==> %s\n' "$name"
begin=$(date +%s)
"$@"
code=$?
printf '==> %s: %s in %d s\n' "$name" "$([ $code -eq 0 ] && echo done || echo "FAILED ($code)")" $(($(date +%s) - begin))
exit $code
