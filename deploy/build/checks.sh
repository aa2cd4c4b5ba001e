#!/usr/bin/env bash
# Checks the rules of the structure that a program can check (CONTRIBUTING.md describes them):
#  - an algorithm library includes no Zenoh, FlatBuffers, logger, clock or thread;
#  - no stage includes anything from another stage;
#  - a program that connects to endpoints does not scout;
#  - schemas have explicit ids and conform to the last release;
#  - each document that a file names exists;
#  - the subject of a commit has at most 72 characters.
set -euo pipefail
cd "$(dirname "$0")/../.."
fail=0
complain() { printf 'checks: %s\n' "$1" >&2; fail=1; }

# Headers that an algorithm may not include. The shells around it (main.cpp, *_stage.*, *_parameters.*, io/) may.
forbidden='(common/zenoh|common/runtime|common/messages|flatbuffers|_generated\.h|spdlog|<chrono>|<thread>|<mutex>|<atomic>|<condition_variable>|<future>|<ctime>|<sys/time\.h>)'
stages=$(python3 -c 'import json; print(*(row["name"] for row in json.load(open("services/stages.json"))))')
for stage in $stages aloam/core common/containers common/geometry common/plane_map; do
  [ -d "services/$stage" ] || continue
  while IFS= read -r file; do
    hits=$(grep -nE "^\s*#\s*include.*$forbidden" "$file" || true)
    [ -z "$hits" ] || complain "$file is an algorithm and may not include: $hits"
  done < <(find "services/$stage" \( -name '*.hpp' -o -name '*.cpp' \) \
             ! -name main.cpp ! -name '*_stage.*' ! -name '*_parameters.*' ! -name '*_test.cpp' \
             ! -path '*/io/*' ! -path '*/tools/*' ! -path '*/tests/*')
done
stages="$stages aloam"
for stage in $stages; do
  for other in $stages; do
    [ "$stage" = "$other" ] && continue
    hits=$(grep -rnE "^\s*#\s*include\s+\"$other/" "services/$stage" --include='*.hpp' --include='*.cpp' || true)
    [ -z "$hits" ] || complain "services/$stage includes of services/$other: $hits"
  done
done
hits=$(grep -rnE "^\s*#\s*include\s+\"($(echo $stages | tr ' ' '|'))/" services/common --include='*.hpp' --include='*.cpp' || true)
[ -z "$hits" ] || complain "services/common includes of a stage: $hits"
hits=$(grep -rnE '^[^#]*(pcl_io|vtk)' --include=CMakeLists.txt services tests CMakeLists.txt || true)
[ -z "$hits" ] || complain "pcl_io pulls VTK in: $hits"
# With scouting on, a program would connect all robots that it finds on the network.
while IFS= read -r file; do
  grep -q 'multicast' "$file" || complain "$file connects to endpoints, and does not turn multicast scouting off"
done < <(grep -rlE '["{ ]connect(/|: ?\{+ ?)endpoints' services examples tests --include='*.py' --include='*.cpp' --include='*.rs')
for entry in services/*; do
  case " common monitor router sessions README.md stages.json $stages " in
    *" $(basename "$entry") "*) ;;
    *) complain "unexpected $entry: it is not in services/stages.json" ;;
  esac
done

released=schemas/.released
if [ -d "$released" ]; then
  for schema in schemas/*.fbs; do
    old=$released/$(basename "$schema")
    [ -f "$old" ] || continue
    flatc --conform "$old" --conform-includes "$released" -I schemas "$schema" || complain "$schema breaks $old"
  done
else
  complain "$released is missing"
fi
python3 deploy/build/documents.py || fail=1
# The rule applies to commits after this one. In a clone without it (shallow, exported) only the tip is checked.
rule_begins=a7b444ca52a48b2708a3c4b0d839604adc16f841
longest_subject=72
if git rev-parse -q --verify HEAD >/dev/null 2>&1; then
  range=HEAD~1..HEAD
  ! git merge-base --is-ancestor "$rule_begins" HEAD 2>/dev/null || range=$rule_begins..HEAD
  while IFS= read -r line; do
    subject=${line#* }
    [ "${#subject}" -le $longest_subject ] ||
      complain "commit ${line%% *}: its subject has ${#subject} characters, $longest_subject are allowed: $subject"
  done < <(git log --no-merges --format='%h %s' "$range" 2>/dev/null)
fi
[ $fail -eq 0 ] && echo "checks: layers, schemas and documents hold"
exit $fail
