# The commands of the project. `make help` lists them.
SHELL := /bin/bash
PRESET ?= release
BUILD := build/$(PRESET)
JOBS ?= $(shell nproc)
# Number of integration tests that run in parallel. They mostly wait, for a sensor's pace or a stage's deadline.
TEST_JOBS ?= 2
STEP := deploy/build/step.sh
PY := .venv/bin/python
ZLOAM := bin/zloam
# Nothing stands behind a last colon: Python would take it for the folder in which it is called.
export PYTHONPATH := $(CURDIR)/services/monitor/src$(addprefix :,$(PYTHONPATH))
export ZLOAM_BUILD := $(CURDIR)/$(BUILD)
export ZLOAM_SHARED ?= $(abspath ../shared)
# All checkouts share one compiler cache, whatever their paths.
export CCACHE_BASEDIR := $(CURDIR)
export CCACHE_NOHASHDIR := 1

.PHONY: help deps test-deps tools venv view-tools test-venv configure-tests build build-all aloam graph unit-tests demo run test test-full slow-tests accept bench bench-peers packages reference sanitize system arm64 fuzz fmt lint clean

help: ## this list
	@grep -hE '^[a-z0-9-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 14

# Light by default: each command installs and builds only what it needs itself.
deps: ## install what building and running needs from the distribution (prints the list first)
	@$(STEP) "system packages" deploy/build/deps.sh

test-deps: # deps, and the packages for unit tests, benchmarks and fuzzing
	@$(STEP) "system packages, for tests too" deploy/build/deps.sh --tests

tools: ## deps, and the tools for testing, formatting, linting and fuzzing
	@$(STEP) "system packages and tools" deploy/build/deps.sh --tools

venv: deps
	@$(STEP) "python packages" deploy/build/venv.sh

view-tools: deps ## Python packages for zloam view and zloam foxglove
	@$(STEP) "python packages, to look at robots" deploy/build/venv.sh --view

test-venv: test-deps
	@$(STEP) "python packages, for tests too" deploy/build/venv.sh --tests

# If the build folder has been configured with the tests before, they stay enabled.
$(BUILD)/build.ninja: CMakeLists.txt CMakePresets.json cmake/options.cmake | deps
	@$(STEP) "configure $(PRESET)" cmake --preset $(PRESET) $(if $(wildcard $(BUILD)/CMakeCache.txt),,-DZLOAM_TESTS=OFF -DZLOAM_ALOAM=OFF -DZLOAM_GRAPH=OFF)

configure-tests: test-deps
	@{ [ -f $(BUILD)/build.ninja ] && grep -qs '^ZLOAM_TESTS:BOOL=ON' $(BUILD)/CMakeCache.txt; } || \
	  $(STEP) "configure $(PRESET) with tests" cmake --preset $(PRESET) -DZLOAM_TESTS=ON -DZLOAM_ALOAM=ON -DZLOAM_GRAPH=ON

build: venv $(BUILD)/build.ninja ## build the programs and the command bin/zloam (PRESET=release|debug|asan-ubsan|tsan)
	@$(STEP) "build $(PRESET)" cmake --build $(BUILD) -j $(JOBS) --target programs

aloam: build # A-LOAM's programs; installs PCL and Ceres
	@$(STEP) "system packages, for A-LOAM" deploy/build/deps.sh --aloam
	@grep -qs '^ZLOAM_ALOAM:BOOL=ON' $(BUILD)/CMakeCache.txt || \
	  $(STEP) "configure $(PRESET) with A-LOAM" cmake --preset $(PRESET) -DZLOAM_ALOAM=ON
	@$(STEP) "build A-LOAM's programs" cmake --build $(BUILD) -j $(JOBS) --target aloam_programs

graph: build # the graph of loops; installs OpenCV and Ceres
	@$(STEP) "system packages, for the graph of loops" deploy/build/deps.sh --graph
	@grep -qs '^ZLOAM_GRAPH:BOOL=ON' $(BUILD)/CMakeCache.txt || \
	  $(STEP) "configure $(PRESET) with the graph of loops" cmake --preset $(PRESET) -DZLOAM_GRAPH=ON
	@$(STEP) "build the graph of loops" cmake --build $(BUILD) -j $(JOBS) --target zloam-graph zloam-sessions zloam-calibrate

build-all: configure-tests ## build unit tests and benchmarks too
	@$(STEP) "build $(PRESET) with tests" cmake --build $(BUILD) -j $(JOBS)

unit-tests: configure-tests # only the tests' programs
	@$(STEP) "build unit tests, $(PRESET)" cmake --build $(BUILD) -j $(JOBS) --target unit_tests

# PCAP=file, BAG=file, BIN=file, KITTI=dir or SCANS=dir replays a recording; TRUTH=files compares with a reference;
# SESSION=file: recording of a Hokuyo scanner on a motor, with the angles in the .csv beside it; SENSOR=hokuyo simulates one;
# IMU=file adds the IMU readings of the same time (without a recording: IMU=simulated);
# CONFIG=deploy/robots/...yaml, SET="key=value ..." and SET_AT="sweep:key=value ..." configure; RATE=max|realtime|factor;
# METHOD=aloam replaces registration, odometry and mapping by A-LOAM's programs, METHOD=mapping=aloam mapping alone;
# GRAPH=1 closes loops (trajectory_world.tum, map_world.pcd); MAP=folder stores the map there; with it, LOCALIZE=1 localizes
# the robot in that map and EXTEND=1 continues the map; VIEW=1 shows the run on a page; RECORD=file.mcap records all that is
# published; LISTEN=0.0.0.0 lets other machines connect (demo and run).
# The values are passed through the environment, so that no shell interprets blanks, quotes or dollars in them.
PASSED := MAP PCAP SESSION BAG TOPIC BIN KITTI SCANS IMU TRUTH CONFIG METHOD RATE OUT RECORD LISTEN SET SET_AT
$(foreach v,$(PASSED),$(eval export ZLOAM_ARG_$(v) = $$($(v))))
passed = $(if $($(1)),$(2) "$$ZLOAM_ARG_$(1)")
CHAIN_ARGS = $(call passed,METHOD,--method) $(if $(GRAPH),--graph) $(call passed,MAP,--map) $(if $(LOCALIZE),--localize) $(if $(EXTEND),--extend) $(call passed,OUT,--out) $(call passed,RECORD,--record) $(call passed,LISTEN,--listen) $(call passed,SET,--settings)
DEMO_ARGS = $(call passed,PCAP,--pcap) $(call passed,BAG,--bag) $(call passed,TOPIC,--topic) $(call passed,BIN,--bin) $(call passed,KITTI,--kitti) \
  $(call passed,SCANS,--scans) $(call passed,IMU,--imu) $(call passed,TRUTH,--truths) \
  $(if $(filter hokuyo,$(SENSOR)),--hokuyo) $(call passed,SESSION,--session) \
  $(call passed,CONFIG,--config) $(call passed,RATE,--rate) $(call passed,SET_AT,--settings-at) $(if $(VIEW),--view) $(CHAIN_ARGS)

# A mistyped variable would run something else: with demo and run, each variable of the command line must be one of
# theirs, and a switch is 1 or not given.
SWITCHES := GRAPH LOCALIZE EXTEND VIEW STANDBY
OF_BOTH := METHOD GRAPH MAP LOCALIZE EXTEND OUT RECORD LISTEN SET CONFIG
OF_demo := PCAP BAG TOPIC BIN KITTI SCANS SESSION IMU TRUTH SENSOR RATE SET_AT VIEW
OF_run := STANDBY
OF_GOALS := $(OF_BOTH) $(foreach goal,$(MAKECMDGOALS),$(OF_$(goal)))
OF_BUILD := PRESET BUILD JOBS STEP PY ZLOAM ZLOAM_SHARED
GIVEN := $(foreach v,$(.VARIABLES),$(if $(findstring command line,$(origin $(v))),$(v)))
ifneq ($(filter demo run,$(MAKECMDGOALS)),)
ifeq ($(filter-out build demo run,$(MAKECMDGOALS)),)
$(foreach v,$(filter-out $(OF_GOALS) $(OF_BUILD),$(GIVEN)),$(error $(v)=: make $(MAKECMDGOALS) has no such variable; it has $(OF_GOALS)))
endif
$(foreach v,$(filter $(OF_GOALS),$(SWITCHES)),$(if $(filter-out 1,$($(v))),$(error $(v)=$($(v)): 1 switches it on; leave it out otherwise)))
$(if $(MAP),,$(foreach v,$(filter LOCALIZE EXTEND,$(OF_GOALS)),$(if $($(v)),$(error $(v)=1 needs the map of an earlier run: MAP=out/town, the folder that MAP= of that run named))))
$(if $(filter-out vlp16 hokuyo,$(SENSOR)),$(error SENSOR=$(SENSOR): vlp16 (the default) or hokuyo is simulated))
endif

demo: build $(if $(METHOD),aloam) $(if $(GRAPH),graph) ## simulate a city loop (or replay PCAP=, BAG=, BIN=, KITTI=, SCANS=) and map it: out/demo
	@$(ZLOAM) demo $(DEMO_ARGS)

run: build $(if $(METHOD),aloam) $(if $(GRAPH),graph) ## run live on a sensor: CONFIG=deploy/robots/vlp16-outdoor.yaml
	@$(ZLOAM) run $(call passed,CONFIG,--config) $(if $(STANDBY),--standby) $(CHAIN_ARGS)

test: build-all test-venv ## unit and integration tests, layers, schemas
	@$(STEP) "layers and schemas" deploy/build/checks.sh
	@$(STEP) "unit tests" ctest --test-dir $(BUILD) --output-on-failure -j $(JOBS) --no-tests=error
	@$(STEP) "integration tests" $(PY) -m pytest -q -m "not slow" -n $(TEST_JOBS) --dist loadscope
	@$(STEP) "a minute of fuzzing" tests/fuzz/run.sh --if-there --readers 15
	@$(STEP) "container smoke" $(PY) -m pytest -q -rs -m smoke tests/system

FULL := test slow-tests lint sanitize fuzz system arm64 accept bench
test-full: ## everything: tests, lint, sanitizers, a longer fuzz, containers, acceptance, benchmarks
	@failed=""; for part in $(FULL); do \
	  $(STEP) "make $$part" $(MAKE) --no-print-directory $$part || failed="$$failed $$part"; \
	done; echo "test-full: of $(FULL) failed:$${failed:- none}"; [ -z "$$failed" ]

slow-tests: build-all test-venv # the integration tests that `make test` omits
	@$(STEP) "slow integration tests" $(PY) -m pytest -q -m slow

system: build-all test-venv ## the deployment in containers; skipped with the reason where Docker is not there
	@$(STEP) "system tests" $(PY) -m pytest -q -m "not arm64" tests/system

arm64: build-all test-venv ## the images for arm64, by cross compilers (minutes: Rust once more, for that processor)
	@$(STEP) "arm64" $(PY) -m pytest -q -rs -m arm64 tests/system

accept: build-all test-venv ## every acceptance line a program can judge: out/accept.md (ONLY=pattern)
	@$(PY) -m tests.acceptance --preset-dir $(BUILD) $(if $(ONLY),--only "$(ONLY)")

# ONLY=pattern selects benchmarks by name; DATA=city-7,sim-* and RUNS=n: data sets and rounds of versus-*;
# DRIVES=n and SEED=n: random drives of search-*.
BENCH_ARGS = --preset-dir $(BUILD) $(if $(DATA),--data "$(DATA)") $(if $(RUNS),--runs $(RUNS)) \
  $(if $(DRIVES),--drives $(DRIVES)) $(if $(SEED),--seed $(SEED))

bench: build-all test-venv ## speed, as ratios in one run: out/bench (ONLY=pattern)
	@$(PY) -m tests.bench $(BENCH_ARGS) $(if $(ONLY),--only "$(ONLY)")

bench-peers: DATA ?= all
bench-peers: build-all test-venv ## ours and the peers of PyPI on the same scans: out/bench/versus.md (DATA=, RUNS=; hours)
	@$(PY) -m tests.bench $(BENCH_ARGS) --only 'versus-*'

packages: graph ## wheel and Debian packages with the programs inside: out/packages
	@$(STEP) "system packages, for packages" deploy/build/deps.sh --packages
	@$(STEP) "packages" deploy/build/packages.sh $(BUILD) out/packages

reference: graph ## deploy/robots: REFERENCE.md and schema.json from what the programs say
	@bin/zloam robot-files

# The unit tests of code that uses threads, to be run under TSan.
THREADED := zenoh_test runtime_unit_test runtime_stage_test runtime_program_test simulator_zenoh_test
sanitize: ## the unit tests under AddressSanitizer and UBSan, those with threads under ThreadSanitizer
	@$(MAKE) PRESET=asan-ubsan unit-tests
	@$(STEP) "unit tests (asan-ubsan)" ctest --test-dir build/asan-ubsan --output-on-failure -j $(JOBS) --no-tests=error
	@$(STEP) "configure tsan" cmake --preset tsan
	@$(STEP) "build tests with threads, tsan" cmake --build build/tsan -j $(JOBS) --target $(THREADED)
	@$(STEP) "tests with threads (tsan)" ctest --test-dir build/tsan -E _NOT_BUILT --output-on-failure --no-tests=error

FUZZ_SECONDS ?= 60
fuzz: tools ## libFuzzer on all that reads foreign bytes: packets, captures, tables, texts, messages (FUZZ_SECONDS= each, ONLY="scip ros")
	@$(STEP) "fuzz" tests/fuzz/run.sh $(FUZZ_SECONDS) $(ONLY)

fmt: tools test-venv ## format C++, Rust and Python
	@git ls-files '*.cpp' '*.hpp' | xargs clang-format -i
	@for crate in services/common/zenoh/bridge services/router tests/mcap_reader; do \
	  cargo fmt --manifest-path $$crate/Cargo.toml -- --config-path services/common/zenoh/bridge || exit 1; done
	@.venv/bin/ruff format -q . && .venv/bin/ruff check -q --fix .

lint: tools build-all test-venv ## formatting, clang-tidy, ruff, types, layers, the ten largest functions and files
	@$(STEP) "format" deploy/build/lint.sh format
	@$(STEP) "python" deploy/build/lint.sh python
	@$(STEP) "layers and schemas" deploy/build/checks.sh
	@$(STEP) "clang-tidy" deploy/build/lint.sh tidy $(BUILD)
	@$(STEP) "sizes" deploy/build/lint.sh sizes

# Never out/: it holds what users keep, such as maps, recordings and the keys of certificates.
clean: ## remove build/ (results in out/ and caches under ~/.cache stay)
	rm -rf build
