#!/usr/bin/env bash
# libFuzzer with AddressSanitizer and UBSan on everything that reads foreign bytes.
# usage: tests/fuzz/run.sh [--if-there] [--readers] [seconds for each target] [target ...]
#   --if-there: without the compiler or its libraries say so and leave with 0
#   --readers: all targets but messages, which drives whole stages: their compilation takes most of the time, and with a
#     few runs in a second it needs more than a minute
set -euo pipefail
cd "$(dirname "$0")/../.."
readers=(packets position nmea pcap scip tables settings ros)
targets=("${readers[@]}" messages)
missing=1
while [ $# -gt 0 ]; do
  case "$1" in
    --if-there) missing=0 ;;
    --readers) targets=("${readers[@]}") ;;
    *) break ;;
  esac
  shift
done
seconds=${1:-60}
shift || true
out=build/fuzz
compiler=${FUZZ_CXX:-clang++}
flags=(-std=c++20 -g -O2 -fsanitize=fuzzer,address,undefined,float-cast-overflow
  -fno-sanitize-recover=all -Iservices -isystem "$out/generated" -isystem /usr/include/eigen3
  '-DZLOAM_VERSION="fuzz"')
mkdir -p "$out"
# The sanitizers' libraries are a package of their own (libclang-rt-*-dev).
probe='extern "C" int LLVMFuzzerTestOneInput(const unsigned char*, unsigned long) { return 0; }'
if ! command -v "$compiler" >/dev/null ||
  ! "$compiler" "${flags[@]}" -x c++ - -o "$out/probe" <<<"$probe" 2>/dev/null; then
  echo "fuzz: skipped: $compiler with its fuzzing libraries is missing (make tools installs it)" >&2
  exit "$missing"
fi
if [ $# -gt 0 ]; then targets=("$@"); fi
sources=()
for target in "${targets[@]}"; do sources+=("tests/fuzz/${target}_fuzz.cpp"); done
folders=(services/common/geometry services/driver/{decoder,hesai,io,scip,spinning,sweep,velodyne})
if [[ " ${targets[*]} " == *" messages "* ]]; then
  folders=(services/{common,driver,registration,odometry,mapping,integration,store})
  sources+=(tests/fuzz/{messages,network}.cpp "$out/generated/stage_list.cpp")
else
  sources+=(services/common/runtime/{parameter_file,parameter_text,parameter_types,parameters,json_guard}.cpp)
fi
# Everything but the programs themselves, what needs more libraries, and the tests.
mapfile -t parts < <(find "${folders[@]}" -name '*.cpp' \
  ! -name '*_test.cpp' ! -name main.cpp ! -path '*/tests/*' ! -path '*/tools/*' ! -path '*/calibration/*' | sort)
sources+=("${parts[@]}" services/ros/{cdr,graph}.cpp)
libraries="-lpcap -lyaml-cpp -lpugixml -lflatbuffers -lspdlog -lfmt -lcrypto -lxxhash"
each() { # function, arguments: as many at a time as there are processors
  printf '%s\n' "${@:2}" | xargs -P "$(nproc)" -I{} bash -euo pipefail -c "$1 {}"
}

command="$(command -v ccache || true) $compiler ${flags[*]}"
compile() { $command -c "$1" -o "$out/objects/${1//\//_}.o"; }
link() { $command "$out/objects/tests_fuzz_$1_fuzz.cpp.o" "$out/objects/all.a" $libraries -o "$out/$1"; }
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
export command out seconds libraries

rm -rf "$out/objects" "$out/generated" "$out/schemas"
mkdir -p "$out/objects" "$out/generated/schemas" "$out/schemas"
flatc --cpp --cpp-std c++17 --scoped-enums --reflect-names -I schemas -o "$out/generated/schemas" schemas/*.fbs
flatc --schema -b -I schemas -o "$out/schemas" schemas/*.fbs
cmake -DZLOAM_GENERATED="$out/generated" -P cmake/stages.cmake
each compile "${sources[@]}"
find "$out/objects" -name '*.o' ! -name '*_fuzz.cpp.o' -print0 | xargs -0 ar rcs "$out/objects/all.a"
each link "${targets[@]}"
python3 tests/fuzz/seeds.py "$out/seeds"
each fuzz "${targets[@]}"
if [ $# -eq 0 ] && [ -x .venv/bin/python ]; then .venv/bin/python tests/fuzz/readers.py "$seconds"; fi
