# Everything runs in a virtual environment of its own; `make run` and `make test` do all the set-up on a fresh machine.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed

.PHONY: setup run test quick long-forms check lint types contracts dead-code bench nights sensors fortnight plans bad-plans aborts resumes warming foreign instruments joined-instruments linuxcnc grbl faults endurance crash-points power-cuts requests fuzz fuzz-guided http-interface gcode part-programs schema reference figures audit wheel deb deb-test sbom reproducible release clean

setup: $(STAMP)

$(STAMP): pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[dev]'
	touch $(STAMP)

run: setup
	$(BIN)/volcal demo

# Without compiled modules each of the some hundred processes of the tests would compile them anew.
test quick: export PYTHONDONTWRITEBYTECODE :=

# One process more than cores: some tests wait for a peer in real time.
test: setup
	$(BIN)/python -m pytest --numprocesses $$(( $$(nproc) + 1 )) --dist loadfile --no-loadscope-reorder --durations=20

# What tells most in a minute: unit, contract, property and golden tests without those of tests/slow.txt, few examples of
# each property.
quick: setup
	$(BIN)/python -m pytest -m "not slow and not long" --hypothesis-profile=quick --numprocesses auto --dist loadfile \
		tests/unit tests/contract tests/property tests/golden

# Property and statistical tests with many more examples and machines than the check tries, and the tests marked `long`.
# An hour of CPU time.
long-forms: setup
	$(BIN)/python -m pytest -m "long or not long" --hypothesis-profile=long --numprocesses auto --dist loadfile \
		tests/property/test_small_machines.py tests/property/test_design_minutes.py tests/truth/test_verified_steps.py \
		tests/system/test_demo_cases.py
	$(BIN)/python -m pytest -m long --numprocesses auto --dist loadfile tests

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: setup
	$(BIN)/mypy

contracts: setup
	$(BIN)/lint-imports

# Definitions that nothing uses, tests included; the exceptions are in pyproject.toml.
dead-code: setup
	$(BIN)/vulture

# Each installed package is pinned, each pin is needed, each licence is allowed (release/licences.toml).
audit: setup
	$(BIN)/python -m release.audit

# The first five beside the tests; fails if any of them fails.
check: setup
	MAKE="$(MAKE)" .ci/check

bench: setup
	$(BIN)/python -m benchmarks

# Machines in halls that share no code with the program: which temperature sensors explain their drift, and the machine by
# day. A quarter of an hour of CPU time; each ends with one line of JSON.
sensors: setup
	$(BIN)/python -m campaigns.sensors --machines 50
	$(BIN)/python -m campaigns.sensors.measured_season --seasons 16

# A season of nights on a simulated machine that drifts and is hit once; ends with one line of JSON.
NIGHTS ?= 30
nights: setup
	$(BIN)/python -m campaigns.nights --nights $(NIGHTS)

# A fortnight of the service with everything that goes wrong, in virtual time; ends with one line of JSON.
fortnight: setup
	$(BIN)/python -m campaigns.fortnight

# Random valid plans rehearsed, run with errors and broken off; bad plans, each refused for the right reason; one run
# broken off at each step. Each ends with one line of JSON.
COUNT ?= 10000
SEED ?= 1
plans: setup
	$(BIN)/python -m campaigns.plans --count $(COUNT) --seed $(SEED) --workers 2

# Mutated inputs for every decoder; SECONDS bounds each decoder in s of wall time. `python -m campaigns.sum FILE...` sums the
# outputs of calls with different seeds, and so it does those of plans and crash-points with different seeds, of faults and
# requests with different seeds or FIRST, and of endurance.
SECONDS ?= 10
fuzz: setup
	$(BIN)/python -m campaigns.fuzz 1000000 $(SEED) $(SECONDS) --workers 2

# Inputs developed along the branches of each decoder, as long as it has SECONDS.
fuzz-guided: setup
	$(BIN)/python -m campaigns.fuzz.guided --inputs 1000000 --seed $(SEED) --seconds $(SECONDS)

# Requests that are generated from the OpenAPI document of the service, at a service with a simulated machine.
http-interface: setup
	$(BIN)/python -m campaigns.http_interface --seed $(SEED)

bad-plans: setup
	$(BIN)/python -m campaigns.bad_plans

aborts: setup
	$(BIN)/python -m campaigns.aborts --workers 2

# One run broken off and gone on with, at one step in seventeen; a machine and a bar that warm by 3 K.
resumes: setup
	$(BIN)/python -m campaigns.resume --every 17

warming: setup
	$(BIN)/python -m campaigns.warming --seeds 4

# Machines that share no code with the program, identified from their ball centres: how often the stated limits contain the
# truth, in three trials (S3, a designed set, nights). A quarter of an hour on two cores; ends with one line of JSON.
MACHINES ?= 500
foreign: setup
	$(BIN)/python -m campaigns.foreign --machines $(MACHINES)

# Predictions against a virtual laser interferometer and ballbar, on machines that share no code with the program. A few
# minutes of CPU time; ends with one line of JSON.
instruments: setup
	$(BIN)/python -m campaigns.instruments

# Readings of a laser and a ballbar in one estimate with the ball centres, right and wrong ones, on machines that share no
# code with the program; and what a laser is worth beside few positions. Ten minutes of CPU time.
joined-instruments: setup
	$(BIN)/python -m campaigns.instruments.joined --machines 24 --generator mixed
	$(BIN)/python -m campaigns.instruments.joined --machines 24 --generator mixed --worse-laser
	$(BIN)/python -m campaigns.instruments.worth

# A whole calibration over a serial line with a simulated GRBL and grblHAL, disturbed at random instants: holds, resets,
# alarms, cables unplugged and replugged. Half an hour on two busy cores; ends with one line of JSON.
EVENTS ?= 600
grbl: setup
	$(BIN)/python -m campaigns.grbl --events $(EVENTS)

# Short calibrations, each with one or two faults of the controller, the cell, the computer or the wire at random instants;
# unfinished runs are resumed. Three hours of CPU time, in parts with FIRST and COUNT, multiples of 50; ends with one line
# of JSON.
FIRST ?= 0
faults: setup
	$(BIN)/python -m campaigns.faults --first $(FIRST) --count $(COUNT) --seed $(SEED) --workers 2

# Many runs in one service with clients: memory, handles, threads and disk space per run. 1,000 runs take two hours of CPU
# time; with MINUTES no run begins later; ends with one line of JSON.
RUNS ?= 1000
MINUTES ?= inf
endurance: setup
	$(BIN)/python -m campaigns.endurance --runs $(RUNS) --minutes $(MINUTES)

# Two runs with write-back whose process is killed at some 700 points: at commits of the journal, around commands, in
# motions. Half an hour of CPU time; ends with one line of JSON. EVERY=1: each point, half a day. KIND=processes: the service
# and the simulated machine, as real processes, at KILLS points.
EVERY ?= 30
EVERY_OTHER ?= 1
KIND ?= run
KILLS ?= 500
crash-points: setup
	$(BIN)/python -m campaigns.crash_points --kind $(KIND) --kills $(KILLS) --every $(EVERY) --every-other $(EVERY_OTHER) \
		--seed $(SEED) --workers 2

# Power cuts at each system call of a process that writes a journal, replayed on a disk that loses what was not synchronised.
power-cuts: setup
	.ci/install strace
	$(BIN)/python -m campaigns.power_cuts --seed $(SEED)

# Random requests to the owner of the machine at all moments of real runs in virtual time, with a link that fails, a
# controller that refuses and a service that is killed. In parts with FIRST, the number of the first trial of 500 steps;
# ends with one line of JSON.
STEPS ?= 100000
requests: setup
	$(BIN)/python -m campaigns.requests --steps $(STEPS) --first $(FIRST) --seed $(SEED) --workers 2

# A million lines of a part program corrected: seconds, memory, and the ratio to one block at a time.
gcode: setup
	$(BIN)/python -m benchmarks.gcode

# Random part programs, corrected and executed by the interpreter of LinuxCNC beside the original. Half an hour on two
# cores; ends with one line of JSON.
part-programs: setup
	.ci/install linuxcnc-uspace
	$(BIN)/python -m campaigns.part_programs --count 20000 --workers 2

# A stock LinuxCNC, accelerated, in namespaces of its own, calibrated end to end by the real command; ends with one line
# of JSON. SHORT=--short: one station, few positions.
SPEED ?= 10
SHORT ?=
linuxcnc: setup
	.ci/install linuxcnc-uspace linuxcnc-uspace-dev faketime iproute2
	$(BIN)/python -m campaigns.linuxcnc --speed $(SPEED) $(SHORT)

schema: setup
	mkdir -p config/schema
	$(BIN)/volcal config schema > config/schema/settings.json

# The reference page of the Python library, from its docstrings.
reference: setup
	$(BIN)/python -m volcal.reference > docs/reference/python-api.md

# Figures in the tutorial and the guides, from the runs that they describe; a test compares them.
figures: setup
	$(BIN)/python -m campaigns.page_figures

# The Debian package, for the Debian and the Python that this computer has: dist/volcal_*.deb
deb: setup
	$(BIN)/python -m release.deb

# Installs, starts, hangs, upgrades, removes it in a container that boots systemd. Needs root, debootstrap,
# systemd-container, and some minutes; ends with one line of JSON.
deb-test: deb
	$(BIN)/python systemd/deb/check.py $$(ls -t dist/volcal_*.deb | head -1)

# The wheel: dist/volcal-*.whl
wheel: setup
	$(BIN)/python -m release.wheel

# What the package is made of, with versions and licences, in CycloneDX: dist/volcal-*.cdx.json
sbom: setup
	$(BIN)/python -m release.sbom

# Wheel and Debian package of the last commit, built twice in different places, have the same bytes. Some minutes.
reproducible: setup
	$(BIN)/python -m release.reproduce

# All release files with their sums, signed with a private SSH key outside the checkout: make release KEY=PATH
KEY ?=
release: setup
	$(BIN)/python -m release --key "$(KEY)"

clean:
	rm -rf $(VENV) build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
