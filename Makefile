# flightstack: `make fly` flies, `make test` tests; both set up all they need in .venv.
PYTHON ?= python3
VENV   ?= .venv
BIN    := $(VENV)/bin
RECORDED := $(wildcard ../shared/data)
ifneq ($(RECORDED),)
export FLIGHTSTACK_TEST_DATA ?= $(abspath $(RECORDED))
endif

# As `flightstack` sets it: a second BLAS thread turns idly beside a busy core, which took two thirds more processor time.
export OPENBLAS_NUM_THREADS ?= 1
# Kept whatever the environment says: without bytecode each of the many processes that tests start compiles 300 modules.
export PYTHONDONTWRITEBYTECODE :=

# What is never imported is not compiled to bytecode: half of the time that installing takes.  What is, is imported once:
# who has PYTHONDONTWRITEBYTECODE set and runs the program by itself would compile it at every start.
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile

.DEFAULT_GOAL := help
.PHONY: attack bench bench-barrier bench-flight bench-gap bench-gp bench-log bench-plant campaign campaign-barrier campaign-barrier-filters campaign-barrier-filters-quick campaign-barrier-quick campaign-fence campaign-learning campaign-learning-quick clean close-gap client-20 client-dronekit crosscheck decoder docs faults fly format fuzz gap-blind gap-blind-quick gap-frozen gap-recorded gap-rotorpy gap-rough gap-sensitivity help house mutants paper px4 replay same screenshots soak test thorough tune

help:
	@echo "make fly          set up, fly the paper's tracking scenario, write log and report"
	@echo "make test         set up, then format, lint, types, import rules and tests"
	@echo "make format       rewrite the sources in the house format"
	@echo "make campaign     64 flights from one file, some five minutes: docs/campaigns.md"
	@echo "make bench        what every part costs, as multiples of a reference kernel: docs/benchmarks.md (CHECK=1 compares)"
	@echo "make bench-plant  the plant's speed beside its peers"
	@echo "make bench-flight lockstep speed, tracking accuracy and real-time lateness"
	@echo "make soak         an hour at 250 Hz in real time beside two busy loops, a quarter of one at normal priority"
	@echo "make bench-gap    what flightstack gap takes on a minute at 125 Hz and on long logs: docs/gap-measured.md"
	@echo "make bench-log    what logs cost: in a tick, live, to read ten minutes: docs/logs.md"
	@echo "make bench-gp     the recursive Gaussian process beside its peers"
	@echo "make crosscheck   the native and the JSBSim plant on the same commands and flights: the tables of docs/physics.md"
	@echo "make paper        every figure and number of the paper beside ours, into runs/paper (a quarter of an hour)"
	@echo "make px4          everything that is to be seen on a real PX4, which PX4_HOME names: docs/px4.md"
	@echo "make client-20    MAVSDK-Python flies the simulator twenty times"
	@echo "make client-dronekit    DroneKit connects, arms, changes modes, lands"
	@echo "make decoder      tshark (to be installed beforehand) decodes every frame that the simulator sends"
	@echo "make fuzz         a million hostile datagrams against both ends (the tests take 100,000)"
	@echo "make replay       the reference flights' inputs through today's stack: what a change does to them (UPDATE=1 keeps it)"
	@echo "make same BASE=COMMIT   flights by two commits, which must write the same bytes"
	@echo "make faults       every fault flown: the table of docs/safety.md"
	@echo "make mutants      put small faults into the safety-relevant code, one at a time; lists what the tests do not notice (an hour)"
	@echo "make house        code lines, long files and functions, parameters, subscripts, names used twice"
	@echo "make docs         build the documentation into site/; a broken link fails"
	@echo "make screenshots  the pictures of docs/screenshots, flown and taken anew"
	@echo "make tune         find every controller's gains anew (half an hour)"
	@echo "make campaign-learning  some 500 flights that learn: docs/learning.md (campaign-learning-quick: one seed)"
	@echo "make thorough     every test with all of its cases (an hour and a half)"
	@echo "make attack       every attack on a certificate that is known, every case of them, as tests"
	@echo "make campaign-barrier   5,000 flights against an adversary that searches: the table in docs/barrier.md; goes on where it was cut off, MINUTES=60 bounds it (campaign-barrier-quick: a block of each kind)"
	@echo "make campaign-barrier-filters   some 1,600 flights with, without and as the published filter: docs/barrier.md (campaign-barrier-filters-quick: a few)"
	@echo "make gap-rough          200 blind cases with a rough vehicle file, plain and with ranges: docs/gap-measured.md"
	@echo "make campaign-fence     flights in random sites against adversaries: docs/site.md; goes on where it was cut off, MINUTES=60 bounds it"
	@echo "make close-gap          fly a hidden load, gap on the log, fly again with the corrected file: docs/gap-measured.md"
	@echo "make gap-recorded       the gap workflow on recorded flights whose answer is known: docs/gap-measured.md"
	@echo "make gap-frozen         24 drawn flights whose verdicts no commit may change unsaid: docs/gap-method.md"
	@echo "make gap-sensitivity    every decision of the gap workflow at half and one and a half times its value (an hour): docs/gap-method.md"
	@echo "make gap-rotorpy        the gap workflow on flights of RotorPy, another simulator: docs/gap-measured.md"
	@echo "make gap-blind          some 650 blind cases of the gap workflow: docs/gap-measured.md; runs accumulate (gap-blind-quick: one of each)"
	@echo "make clean        remove the environment and all caches"

$(BIN)/.installed: pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] < (3, 14))' \
	  || { echo "error: Python 3.11 to 3.13 is needed; say which: make PYTHON=python3.11 ..." >&2; exit 2; }
	$(PYTHON) -m venv $(VENV)
	$(PIP) --editable .
	@$(BIN)/python -c 'import flightstack.cli.flight, flightstack.cli.gap'
	@touch $@

$(BIN)/.installed-dev: $(BIN)/.installed
	$(PIP) --editable '.[dev]'
	@touch $@

$(BIN)/.installed-campaign: $(BIN)/.installed
	$(PIP) --editable '.[campaign,cluster,search]'
	@touch $@

$(BIN)/.installed-client: $(BIN)/.installed-dev
	$(PIP) --editable '.[client]'
	@touch $@

$(BIN)/.installed-bench: $(BIN)/.installed
	$(PIP) --editable '.[bench]'
	@touch $@

fly: $(BIN)/.installed
	$(BIN)/flightstack fly

test: $(BIN)/.installed
	@$(BIN)/python -m flightstack.cli.compiled flight jsbsim site certify gap >/dev/null 2>&1 & compiling=$$!; \
	  $(MAKE) --no-print-directory $(BIN)/.installed-dev && \
	  $(BIN)/ruff format --check . && $(BIN)/ruff check . && $(BIN)/lint-imports; checked=$$?; \
	  [ $$checked != 0 ] || $(BIN)/python -m tests.compiled_ahead >/dev/null 2>&1; \
	  [ $$checked != 0 ] || $(BIN)/python -m pytest --collect-only -q >/dev/null 2>&1; \
	  wait $$compiling; exit $$checked
	@# Collected once before: each process of the tests would compile all of them to bytecode.  Three for two processors:
	@# what flies in real time waits for a tenth of its time.  Types are checked meanwhile, with a small share.
	nice -n 5 $(BIN)/mypy > $(VENV)/types.txt 2>&1 & typed=$$!; \
	  $(BIN)/python -m pytest -n 3 --dist loadfile --no-loadscope-reorder; tested=$$?; \
	  wait $$typed; typed=$$?; cat $(VENV)/types.txt; [ $$typed = 0 ] && exit $$tested
	$(BIN)/python -m benchmarks.bench --check

format: $(BIN)/.installed-dev
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

campaign: $(BIN)/.installed-campaign
	$(BIN)/flightstack campaign campaigns/small.toml --out runs/campaign-small-$$(date +%Y%m%d-%H%M%S)

bench: $(BIN)/.installed
	$(BIN)/python -m benchmarks.bench $(if $(CHECK),--check)

bench-plant: $(BIN)/.installed-bench
	$(BIN)/python benchmarks/plant.py

bench-flight: $(BIN)/.installed
	$(BIN)/python -m benchmarks.flight

soak: $(BIN)/.installed
	$(BIN)/python -m benchmarks.soak

bench-gap: $(BIN)/.installed
	$(BIN)/python -m benchmarks.gap_timing

bench-log: $(BIN)/.installed
	$(BIN)/python -m benchmarks.log

bench-gp: $(BIN)/.installed-bench
	$(BIN)/python benchmarks/gp.py

bench-barrier: $(BIN)/.installed-bench
	$(BIN)/python benchmarks/filter.py
	$(BIN)/python -m benchmarks.barrier

paper: $(BIN)/.installed
	$(BIN)/flightstack reproduce --out runs/paper

house: $(BIN)/.installed
	$(BIN)/python -m benchmarks.house

mutants: $(BIN)/.installed-dev
	$(BIN)/python -m benchmarks.mutants

$(BIN)/.installed-docs: $(BIN)/.installed
	$(PIP) --editable '.[docs]'
	@touch $@

screenshots: $(BIN)/.installed
	$(BIN)/python -m benchmarks.screenshots

docs: $(BIN)/.installed-docs
	$(BIN)/mkdocs build --strict --quiet

crosscheck: $(BIN)/.installed
	$(BIN)/python -m benchmarks.plants_crosscheck

px4: $(BIN)/.installed-dev
	$(BIN)/python -m benchmarks.px4

client-20: $(BIN)/.installed-dev
	@for run in $$(seq 20); do \
	  echo "run $$run of 20"; $(BIN)/python -m pytest -q -m client --durations=0 tests/client || exit 1; \
	done

client-dronekit: $(BIN)/.installed-client
	$(BIN)/python -m pytest -q -m client tests/client/test_dronekit.py

decoder: $(BIN)/.installed-dev
	FLIGHTSTACK_DECODER=1 $(BIN)/python -m pytest -q -s -m client tests/client/test_tshark.py

fuzz: $(BIN)/.installed-dev
	FLIGHTSTACK_FUZZ=1000000 $(BIN)/python -m pytest -q tests/property/test_fuzz.py

replay: $(BIN)/.installed
	$(BIN)/python -m benchmarks.reference_flights $(if $(UPDATE),--update)

same: $(BIN)/.installed
	@[ -n "$(BASE)" ] || { echo "error: say which commit: make same BASE=COMMIT" >&2; exit 2; }
	$(BIN)/python -m benchmarks.same $(BASE)

faults: $(BIN)/.installed
	$(BIN)/python -m benchmarks.faults

tune: $(BIN)/.installed
	$(BIN)/python benchmarks/tune.py

MINUTES ?= 600
COMMIT = $(shell git rev-parse --short=7 HEAD)
RUN = nice -n 10 $(BIN)/flightstack campaign
QUICK = $(if $(findstring quick,$@),--quick)
define LEARNING
	mkdir -p runs && $(BIN)/python -m benchmarks.learning file $(QUICK) > runs/$@.toml
	$(RUN) runs/$@.toml --out runs/$@-$(COMMIT) --resume --minutes $(MINUTES)
	$(BIN)/python -m benchmarks.learning page runs/$@-$(COMMIT) $(QUICK)
endef
campaign-learning: $(BIN)/.installed-campaign
	$(LEARNING)

campaign-learning-quick: $(BIN)/.installed-campaign
	$(LEARNING)

thorough: $(BIN)/.installed-dev
	FLIGHTSTACK_THOROUGH=1 $(BIN)/python -m pytest -q -n 2 --dist loadfile --no-loadscope-reorder

attack: $(BIN)/.installed-dev
	FLIGHTSTACK_THOROUGH=1 $(BIN)/python -m pytest -q tests/attack tests/loopback/test_dead_companion.py tests/loopback/test_early_certificate.py tests/loopback/test_gps_provenance.py tests/unit/test_fence_baselines.py tests/unit/test_shield_interrupted.py
	FLIGHTSTACK_THOROUGH=1 FLIGHTSTACK_FORGERIES=200 $(BIN)/python -m pytest -q tests/loopback/test_provenance.py tests/unit/test_certificate_check.py

campaign-barrier: $(BIN)/.installed-campaign
	$(RUN) campaigns/barrier.toml --out runs/$@-$(COMMIT) --resume --minutes $(MINUTES) --set seeds.from=$$((0x$(COMMIT)000)); \
	status=$$?; $(BIN)/python -m benchmarks.campaign docs/barrier.md barrier runs/$@-$(COMMIT) && exit $$status

campaign-barrier-quick: $(BIN)/.installed-campaign
	$(RUN) campaigns/barrier.toml --out runs/$@-$$(date +%Y%m%d-%H%M%S) --set 'design="grid"' --set seeds.count=1 --set count=5 --set vary.attacks=4

campaign-fence: $(BIN)/.installed-dev
	$(BIN)/python -m benchmarks.fence $(if $(MINUTES),--minutes $(MINUTES))

campaign-barrier-filters: $(BIN)/.installed-campaign
	$(RUN) campaigns/barrier-filters.toml --out runs/$@-$(COMMIT) --resume --minutes $(MINUTES)

campaign-barrier-filters-quick: $(BIN)/.installed-campaign
	$(RUN) campaigns/barrier-filters.toml --out runs/$@-$$(date +%Y%m%d-%H%M%S) --set count=16

gap-blind: $(BIN)/.installed-campaign
	$(RUN) campaigns/gap-blind.toml --out runs/$@-$(COMMIT) --resume --minutes $(MINUTES)
	$(BIN)/python -m benchmarks.gap_tables runs/$@-*

gap-rough: $(BIN)/.installed-campaign
	$(RUN) campaigns/gap-rough.toml --out runs/$@-$(COMMIT) --resume --minutes $(MINUTES)
	$(BIN)/python -m benchmarks.gap_rough runs/$@-*

close-gap: $(BIN)/.installed
	$(BIN)/python -m benchmarks.close_gap

gap-recorded: $(BIN)/.installed
	$(BIN)/python -m benchmarks.gap_recorded

gap-frozen: $(BIN)/.installed
	$(BIN)/python -m benchmarks.gap_frozen

gap-sensitivity: $(BIN)/.installed
	$(BIN)/python -m benchmarks.gap_sensitivity trace 60
	$(BIN)/python -m benchmarks.gap_sensitivity run 120
	$(BIN)/python -m benchmarks.gap_sensitivity keep

gap-rotorpy: $(BIN)/.installed-bench
	$(BIN)/python -m benchmarks.gap_rotorpy

gap-blind-quick: $(BIN)/.installed-campaign
	$(RUN) campaigns/gap-blind.toml --out runs/quick-$@ --resume --set 'design="grid"' --set seeds.count=1 --set count=37 --set 'vary.plant="native"' --set 'vary.form="csv"'

clean:
	rm -rf $(VENV) .mypy_cache .ruff_cache .pytest_cache .import_linter_cache .hypothesis
