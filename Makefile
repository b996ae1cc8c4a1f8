# The whole set-up in two commands: `make demo` and `make test`.
# Both make .venv, build the C++ core, and do the job.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# Modules are compiled when they are first imported: of 140 MB of sources most never are.
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile
TOOLS := $(VENV)/.tools
STAMP := $(VENV)/.installed
# What builds the wheel, as in pyproject.toml and as the C++ tests need it.
BUILD_TOOLS := 'scikit-build-core>=1.0,<2' 'pybind11>=3.0,<4' 'cmake>=3.25,<5' 'ninja>=1.11,<2'
# Programs of the tools, which run from a checkout alone.
TOOL := PYTHONPATH=tools $(BIN)/python -m
CPP_SOURCES := $(shell find cpp -name '*.cpp' -o -name '*.hpp' -o -name 'CMakeLists.txt' -o -name 'CMakePresets.json')

# Programs and tests start hundreds of Pythons, which must not compile every module again.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo test test-all bench sim-bench sim-check localization-bench localization-dives localization-certainty second-pass localization-soak soak store-soak map-size crash-soak power-cuts chaos stream-study mutations accuracy-cost elevation-study drift-study numerical-growth survey-dives survey-study from-clone fuzz docs check tidy cpp-test cpp-test-asan cpp-test-tsan cpp-test-aarch64 python-test install lock sdist wheels prerequisites test-prerequisites clean

demo: $(STAMP)
	$(TOOL) demo --out out/demo

# What decides whether a change lands, in about ten minutes of two cores: static checks,
# the C++ tests, and all Python tests but the slow ones, with a short series of kills. The Python tests
# run alone: some of them have time limits.
test: test-prerequisites $(STAMP)
	@echo "Static checks and C++ tests run side by side; each prints its output when it ends."
	+$(MAKE) -j 2 --output-sync=target cpp-test check
	CRASH_KILLS=10 POWER_CUTS=8 STORE_KILLS=2 $(BIN)/python -m pytest tests -m "not slow" -n 3

# All tests: also the sanitizers, the demo, the slow tests and the long series of kills. The demo fails
# if its map is worse than promised. The sanitizers are built first: they need no installation.
test-all: test-prerequisites
	@echo "Two stages run side by side; each prints its output when it ends, the first after minutes."
	+$(MAKE) -j 2 --output-sync=target cpp-test-asan cpp-test-tsan demo cpp-test check
	+$(MAKE) python-test

# Compares the integrators with OctoMap, OpenVDB and, given BONXAI_PATH=<checkout>, with Bonxai;
# writes docs/reports/performance.md. Some minutes.
bench: $(STAMP)
	$(TOOL) bench integrators

# Times the simulator's pings in the harbour; writes docs/reports/performance.md. A minute or two.
sim-bench: $(STAMP)
	$(TOOL) bench simulator-speed --write

# Compares what the simulator's rules leave out and compute with everything, on all its scenes;
# writes the figures into docs/reports/simulator.md. Some minutes.
sim-check: $(STAMP)
	$(TOOL) studies sim-check --write

# Times the particle filter beside the reference's plain loops. A minute.
localization-bench: $(STAMP)
	$(TOOL) bench localization

# Follows simulated dives, starts anywhere, is carried off; with pictures. Half an hour of one core.
localization-dives: $(STAMP)
	$(TOOL) studies localization-dives --scenes harbour --runs 100 --carried-off 100
	$(TOOL) studies localization-dives --scenes pile_field --runs 100
	$(TOOL) studies localization-dives --scenes tank

# How far the reports of certainty can be trusted, on seeds on which nothing was chosen: one dive from
# anywhere and one carried off in each of ten scenes. Hours.
localization-certainty: $(STAMP)
	$(TOOL) studies localization-dives --minutes 0 --certainty 1 --seed 13

# Maps a place twice, the second time at poses that localization corrects; with a picture. Minutes.
second-pass: $(STAMP)
	$(TOOL) studies second-pass

# Ten million updates of the particle filter. A minute or two.
localization-soak: $(STAMP)
	MAPPERD_LONG_UPDATES=10000000 scripts/cpp-test release

# A night at sea: 200 000 pings through cuts, stalls, flipped bits and restarts. Some minutes.
soak: $(STAMP)
	NIGHT_LOOPS=400 $(BIN)/python -X dev -m pytest -o timeout=1800 tests/oculus_driver/test_night_at_sea.py

# A daemon for ten minutes among a sonar, odometry, broker, clock and disk that fail at random.
chaos: $(STAMP) out/chaos/tank.mcap
	$(TOOL) studies chaos out/chaos/tank.mcap

out/chaos/tank.mcap: | $(STAMP)
	mkdir -p out/chaos
	$(BIN)/sonar-sim capture tank --out $@

# The map stream on a bad link, with a hundred clients, and what twenty cost; writes the figures into
# docs/reports/map-stream.md. A quarter of an hour; wants the right to make network namespaces for
# a real link.
stream-study: $(STAMP) out/demo/capture.bin
	$(TOOL) studies stream --write

# Measures what accuracy costs in time, and how errors grow, from nothing; draws every figure of
# docs/reports/accuracy-cost.md and docs/reports/numerical-stability.md. Less than an hour of two
# cores; after a stop the same command goes on.
accuracy-cost: $(STAMP)
	$(TOOL) studies accuracy-cost run --write
	$(TOOL) studies accuracy-cost plot --write
	$(MAKE) numerical-growth

# Both mapping rules on 13 simulated dives, three seeds, true and noisy poses, 5 and 10 cm; writes figures and
# tables into docs/reports/accuracy-cost.md. An hour of one core; what is finished is kept.
elevation-study: $(STAMP)
	$(TOOL) studies elevation simulate
	$(TOOL) studies elevation run
	$(TOOL) studies elevation run --contenders iwlo arc "arc, refined" --pose-noise
	$(TOOL) studies elevation run --contenders iwlo arc "arc, refined" --dives depth_pitch roll ship_hull --voxel 0.05
	$(TOOL) studies elevation report --contenders iwlo arc "arc, refined" --write

# Simulates dives whose odometry drifts, aligns each with five odometries of every kind, and prints the
# table of docs/reports/odometry.md. An hour of two cores; what is finished is kept.
drift-study: $(STAMP)
	$(TOOL) studies drift simulate
	$(TOOL) studies drift run --jobs 2
	$(TOOL) studies drift report

# Errors of rounding over a million updates, and what single precision costs; writes the figure and
# the tables of docs/reports/numerical-stability.md. One minute of one core.
numerical-growth: $(STAMP)
	$(TOOL) studies numerical-growth --write

out/demo/capture.bin: | $(STAMP)
	$(TOOL) demo --out out/demo

# The map's file: 500 deaths at any instant, and half a million pings through a tiny cache. Hours.
store-soak: $(STAMP)
	STORE_KILLS=500 STORE_PINGS=500000 $(BIN)/python -m pytest -s -o timeout=0 tests/mapperd/store/test_kill.py tests/mapperd/store/test_soak.py

# Peak memory of all that is done with a map of 2 GB on disk, and of a daemon that maps into it with one
# tile in memory; fails above 400 MB. Half an hour and 3 GB of disk.
map-size: $(STAMP)
	$(TOOL) bench map-size --megabytes 2000 --most 400

# The daemon: 500 deaths at any instant, live and replayed, 1000 changed bytes, half a million pings. Hours.
crash-soak: $(STAMP)
	CRASH_KILLS=500 CRASH_CORRUPTIONS=1000 SOAK_PINGS=500000 $(BIN)/python -m pytest -s -o timeout=0 tests/mapperd/session/crash

# The daemon: 500 power cuts that lose, tear and reorder what was not synced. A quarter of an hour.
power-cuts: $(STAMP)
	POWER_CUTS=500 $(BIN)/python -m pytest -s -o timeout=0 tests/mapperd/session/crash/test_power_cut.py

# Ten minutes of the coverage-guided fuzzer on the driver's parser, and ten on both ends of the map
# stream. The corpora in out/fuzz grow and are kept.
fuzz: $(STAMP)
	$(PIP) --no-build-isolation -e '.[fuzz]'
	$(BIN)/python -m tests.fuzz.fuzz_stream out/fuzz/stream -max_total_time=600 -max_len=8192
	$(BIN)/python -m tests.fuzz.fuzz_map_stream out/fuzz/map-stream -max_total_time=600 -max_len=4096

# The dives of the survey study: two hours in ten recordings, 7 GB; damaged copies of two. Half an
# hour of one core; what was finished is kept.
survey-dives: $(STAMP)
	$(TOOL) studies survey-dives --out out/survey --damage

# The survey study: the dives mapped with one and two workers, with workers killed, on damaged
# recordings, and in one process; the maps compared, and how the survey scales. An hour or two of two
# cores that have nothing else to do; after a stop the same command goes on.
survey-study: survey-dives
	$(TOOL) studies survey --out out/survey

# Installs from a clone as the pages say, and follows the first dive there. A quarter of an hour.
from-clone: $(STAMP)
	MAPPERD_FROM_CLONE=1 $(BIN)/python -m pytest -n 0 tests/test_install.py

# Breaks each guarded formula once and has a test notice; writes docs/reports/mutations.md. An hour
# of one core; what is as it was when it was measured is not measured again.
mutations: $(STAMP)
	$(TOOL) studies mutations --write

install: $(STAMP)

# Newest versions within the bounds of pyproject.toml, with hashes, for Python 3.11 and newer.
LOCK := $(BIN)/uv pip compile --quiet --no-config --upgrade --universal --python-version 3.11 \
	--generate-hashes --custom-compile-command 'make lock'

# Renews requirements/*.lock.
lock: $(TOOLS)
	$(PIP) 'uv>=0.9,<1'
	$(LOCK) pyproject.toml $(foreach extra,filters mavlink mqtt nmea serial,--extra $(extra)) \
		--output-file requirements/vehicle.lock
	printf '%s\n' $(BUILD_TOOLS) | $(LOCK) - --output-file requirements/build.lock

# The source package into out/dist: the same bytes for the same commit.
sdist: $(TOOLS)
	SOURCE_DATE_EPOCH=$$(git log -1 --format=%ct) $(BIN)/python -c \
		'from scikit_build_core.build import build_sdist; build_sdist("out/dist")'

# Wheels of the source package for this architecture, into out/dist: wants Docker.
wheels: sdist
	$(PIP) 'cibuildwheel==4.3.3'
	$(BIN)/cibuildwheel out/dist/mapperd-*.tar.gz --platform linux --output-dir out/dist

# The site of docs/, into out/site; warnings and broken links are errors.
docs: $(STAMP)
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

check: $(STAMP)
	scripts/check

# clang-tidy on the C++ libraries, with the checks of .clang-tidy. Some minutes.
tidy: $(STAMP)
	$(PIP) 'clang-tidy==23.1.4'
	find cpp/*/src -name '*.cpp' | xargs -P 2 -n 4 $(BIN)/clang-tidy -p build/release --quiet --warnings-as-errors='*'

cpp-test: $(STAMP)
	scripts/cpp-test release

cpp-test-asan: $(TOOLS)
	scripts/cpp-test asan-ubsan

cpp-test-tsan: $(TOOLS)
	scripts/cpp-test tsan

# The map core's golden tests as NEON code, on any machine: wants g++-aarch64-linux-gnu and qemu-user.
cpp-test-aarch64: $(TOOLS)
	scripts/cpp-test aarch64

# More workers than cores: many tests wait for a save or a timeout. A browser without a GPU needs
# both cores, so its tests run alone afterwards.
python-test: $(STAMP)
	$(BIN)/python -m pytest tests -m "not browser" -n 3
	$(BIN)/python -m pytest tests -m browser -n 0

prerequisites:
	@PYTHON="$(PYTHON)" scripts/prerequisites

test-prerequisites:
	@PYTHON="$(PYTHON)" scripts/prerequisites tests

# What compiles: all that the sanitizers' builds need.
$(TOOLS): pyproject.toml | prerequisites
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(PIP) $(BUILD_TOOLS) 'cmeel-octomap>=1.9,<2'
	touch $@

# Installed again when the build's inputs change; Python sources are used from the tree. The build's
# own tools are installed before and stay: in a new environment for every build, as pip makes them,
# the compiler would start from scratch too, and the C++ tests could not share the tree.
$(STAMP): pyproject.toml $(CPP_SOURCES) $(TOOLS)
	env -u MAKEFLAGS $(PIP) --no-build-isolation -e '.[dev,docs,octomap,render,sim,topside]'
	touch $@

clean:
	rm -rf $(VENV) build out
