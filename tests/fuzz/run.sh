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
sources=("$driver"/velodyne/{model,beams,motor,decoder,mask,position}.cpp
  "$driver"/velodyne/block_points{,_avx2,_avx512}.cpp
  "$driver"/sweep/{clock,assembler,assembler_order}.cpp "$driver"/io/{link_layer,ip_fragments,pcapng_reader,pcap_source,imu_file,scan_list}.cpp
  services/common/runtime/{json_guard,parameter{_file,_text,_types,s}}.cpp)
targets=(packets position nmea pcap tables settings)
each() { # function, arguments: as many at a time as there are processors
  printf '%s\n' "${@:2}" | xargs -P "$(nproc)" -I{} bash -euo pipefail -c "$1 {}"
}

command="$(command -v ccache || true) $compiler ${flags[*]}"
compile() { $command -c "$1" -o "$out/objects/${1//\//_}.o"; }
link() { $command "$out/objects/tests_fuzz_$1_fuzz.cpp.o" "$out"/objects/services_*.o -lpcap -lyaml-cpp -o "$out/$1"; }
fuzz() {
  mkdir -p "$out/corpus/$1" "$out/found"
  echo "fuzz: $1 for $seconds s"
  if ! "$out/$1" -max_total_time="$seconds" -max_len=8192 -timeout=10 -rss_limit_mb=2048 \
    -print_final_stats=1 -artifact_prefix="$out/found/$1-" "$out/corpus/$1" \
    "$out/seeds/$1" >"$out/$1.log" 2>&1; then
    tail -n 40 "$out/$1.log" >&2
    echo "fuzz: $1 failed; the input is in $out/found, the log is $out/$1.log" >&2
    return 1
  fi
  grep -E '^(stat::number_of_executed_units|Done)' "$out/$1.log" | sed "s/^/fuzz: $1: /"
}
export -f compile link fuzz
export command out seconds

rm -rf "$out/objects"
mkdir -p "$out/objects"
each compile "${sources[@]}" tests/fuzz/*_fuzz.cpp
each link "${targets[@]}"
python3 tests/fuzz/seeds.py "$out/seeds"
each fuzz "${targets[@]}"
if [ -x .venv/bin/python ]; then .venv/bin/python tests/fuzz/readers.py "$seconds"; fi
