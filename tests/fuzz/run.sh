#!/usr/bin/env bash
# libFuzzer with AddressSanitizer and UBSan on everything that reads foreign bytes.
# usage: tests/fuzz/run.sh [--if-there] [seconds for each target]
#   --if-there: without the compiler or its libraries say so and leave with 0
set -euo pipefail
cd "$(dirname "$0")/../.."
missing=1
if [ "${1:-}" = --if-there ]; then
  missing=0
  shift
fi
seconds=${1:-60}
out=build/fuzz
compiler=${FUZZ_CXX:-clang++}
flags=(-std=c++20 -g -O1 -fsanitize=fuzzer,address,undefined -fno-sanitize-recover=all
  -Iservices -isystem /usr/include/eigen3)
mkdir -p "$out"
# The sanitizers' libraries are a package of their own (libclang-rt-*-dev).
probe='extern "C" int LLVMFuzzerTestOneInput(const unsigned char*, unsigned long) { return 0; }'
if ! command -v "$compiler" >/dev/null ||
  ! "$compiler" "${flags[@]}" -x c++ - -o "$out/probe" <<<"$probe" 2>/dev/null; then
  echo "fuzz: skipped: $compiler with its fuzzing libraries is missing (make tools installs it)" >&2
  exit "$missing"
fi
driver=services/driver
algorithms=("$driver"/velodyne/{model,beams,block_points,motor,decoder,mask,position}.cpp
  "$driver"/sweep/{clock,assembler,assembler_order}.cpp)
build() { # target, sources and libraries
  local target=$1
  shift
  if [ -x "$out/$target" ] &&
    [ -z "$(find services/driver services/common/geometry tests/fuzz -newer "$out/$target" -name '*.[ch]pp' -print -quit)" ]; then
    return
  fi
  "$compiler" "${flags[@]}" tests/fuzz/"$target"_fuzz.cpp "$@" -o "$out/$target"
}
build packets "${algorithms[@]}"
build position "${algorithms[@]}"
build nmea "${algorithms[@]}"
build pcap "$driver"/io/{link_layer,pcap_source}.cpp -lpcap
python3 tests/fuzz/seeds.py "$out/seeds"
for target in packets position nmea pcap; do
  mkdir -p "$out/corpus/$target" "$out/found"
  echo "fuzz: $target for $seconds s"
  if ! "$out/$target" -max_total_time="$seconds" -max_len=8192 -timeout=10 -rss_limit_mb=2048 \
    -print_final_stats=1 -artifact_prefix="$out/found/$target-" "$out/corpus/$target" \
    "$out/seeds/$target" >"$out/$target.log" 2>&1; then
    tail -n 40 "$out/$target.log" >&2
    echo "fuzz: $target failed; the input is in $out/found, the log is $out/$target.log" >&2
    exit 1
  fi
  grep -E '^(stat::number_of_executed_units|Done)' "$out/$target.log" || true
done
