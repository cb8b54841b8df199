# `make run` and `make test` do everything on a machine with python3, make and a package index.
PYTHON ?= python3
BIN := .venv/bin

ifneq ($(wildcard ../shared/data/rle),)
export EGOLANE_DATA ?= $(abspath ../shared/data)
endif

.PHONY: run test check docs bench coverage dist notebooks paper graphs beyond delay events camera searched tuned rendered compared maps benchmark cluster-demo clean

run: .venv/.run
	$(BIN)/egolane run experiments/quickstart.yaml
	@echo
	$(BIN)/egolane reproduce --if-available

# A file's tests share what they make, so one process runs all of them; tests/conftest.py orders
# the files.
test: .venv/.dev
	$(BIN)/python -m pytest --numprocesses auto --dist loadfile --no-loadscope-reorder

check: .venv/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

# The kernels as plain Python, so that their lines are seen too; then, compiled, what would take
# minutes so.
COMPILED := $(addsuffix .py,$(addprefix tests/,comparing/test_compared test_held_out \
	learning/test_held_out vision/detectors/test_detectors vision/detectors/test_runner))
coverage: .venv/.dev
	NUMBA_DISABLE_JIT=1 $(BIN)/python -m coverage run -m pytest -q $(addprefix --ignore=,$(COMPILED))
	$(BIN)/python -m coverage run --append -m pytest -q $(COMPILED)
	$(BIN)/python -m coverage report

bench: .venv/.bench
	$(BIN)/python -m tests.benchmarks

# The documentation site, in site/: its pages load nothing from a network.
docs: .venv/.dev
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict --quiet

# The source archive and the wheel from it, tried in an empty environment (needs a package index).
dist: .venv/.dev
	rm -rf dist
	$(BIN)/python -m build
	PYTHON=$(PYTHON) .ci/installed dist/*.whl

# Executes the notebooks and stores them with what they put out; needs the paper's recordings.
notebooks: .venv/.dev
	$(BIN)/python -m tests.kits.notebooks

# What results/paper/ holds: tables and figures of the paper's runs, made from the recordings.
RUNS := results/runs
NO_BONUS := --set parameters.bonus_value=0 --set name=run03_no_bonus
paper: .venv/.run
	$(BIN)/egolane reproduce --wide --out $(RUNS) > results/paper/reproduction.md
	$(BIN)/egolane compare --wide > results/paper/graphs.md
	$(BIN)/egolane run experiments/paper/run03_italy_mc.yaml --no-figures --out $(RUNS)/run03_bonus
	$(BIN)/egolane run experiments/paper/run03_italy_mc.yaml --no-figures $(NO_BONUS) --out $(RUNS)/run03_no_bonus
	$(BIN)/egolane plot $(RUNS)/run01_italy_ml --frames 1880 2700 --out results/paper
	$(BIN)/egolane plot $(RUNS)/run*_italy_* $(RUNS)/run*_spain_* --out $(RUNS)/figures
	cp $(RUNS)/figures/dispersion.png results/paper/
	$(BIN)/egolane plot $(RUNS)/run03_bonus $(RUNS)/run03_no_bonus --out $(RUNS)/ablation
	cp $(RUNS)/ablation/bonus_ablation.png results/paper/
	$(BIN)/egolane network sensor_failure results/paper/network.png

# What results/graphs/ holds: other graphs and learned tables on frames that they have not seen
# (three quarters of an hour of two cores).
GRAPHS := sensor_failure,wor_on_lane,wor_on_edge,autoregressive,failure_duration,no_wor,lane_only
GRAPHS := $(GRAPHS),sensor_dynamics,three_sensor_states,biased_sensor,wor_direct
SEARCH := --seeds 5 --trials-per-number 60 --jobs 2
EM := $(addprefix experiments/graphs/,em.yaml em_autoregressive.yaml em_autoregressive_wor.yaml)
OTHERS := experiments/graphs/start.yaml $(EM)
graphs: .venv/.run
	mkdir -p results/graphs
	$(BIN)/egolane compare --graphs $(GRAPHS) --wide --set fit=tune --set filter=exact $(SEARCH) --figures $(RUNS)/graphs > results/graphs/graphs.md
	cp $(RUNS)/graphs/differences.png results/graphs/graphs.png
	$(BIN)/egolane compare $(EM) experiments/graphs/start.yaml --runs 1-10 --jobs 2 --wide > results/graphs/learned.md
	$(BIN)/egolane compare experiments/graphs/searched.yaml $(OTHERS) --runs 1-10 --wide $(SEARCH) > results/graphs/learned_or_searched.md

# results/tuning/tables.md and its figure: the paper's parameters searched for each run, detector and
# road (a quarter of an hour of two cores; repeated, it goes on where it stopped).
tuned: .venv/.dev
	$(BIN)/python -m makers.tuned --out results/tuning

# What results/beyond/ holds of recordings by other detectors (a quarter of an hour of one core).
beyond: .venv/.dev
	$(BIN)/python -m makers.beyond strangers > results/beyond/strangers.md
	$(BIN)/python -m makers.beyond sensors > results/beyond/sensors.md
	$(BIN)/python -m makers.beyond labels --out results/beyond > results/beyond/labels.md
	$(BIN)/python -m makers.beyond failures --out results/beyond > /dev/null
	$(BIN)/python -m makers.beyond lanes --runs 1,5,8,10 > results/beyond/lanes.md
	$(BIN)/python -m makers.beyond ramps > results/beyond/ramps.md
	$(BIN)/python -m makers.beyond drawn > results/beyond/drawn.md
	$(BIN)/python -m makers.beyond calibration --out results/beyond > results/beyond/calibration.md

# results/beyond/delay.md and its figure: how right an answer is that waits (a minute).
DELAY := egolane compare experiments/zero_label.yaml --runs 1-10 \
	--lags 0,0.2,0.5,1,1.5,2,3,4,5 --wide --figures results/runs/delay
define DELAY_HEAD
# How right an answer is that waits

Made by `make delay`, which runs

    $(DELAY)

No label is used; the constants are one set for all detectors and were chosen with these ten
recordings in sight. Nothing but the delay looks ahead.

![Accuracy over the delay of the answer](delay.png)

endef
export DELAY_HEAD
delay: .venv/.run
	echo "$$DELAY_HEAD" > results/beyond/delay.md
	$(BIN)/$(DELAY) >> results/beyond/delay.md
	cp $(RUNS)/delay/lags.png results/beyond/delay.png

# The table in results/beyond/events.md: how right lane changes are told (half a minute).
EVENTS := egolane compare experiments/zero_label.yaml --runs 1-10 --with-paper --events --wide
events: .venv/.run
	sed -i '/^<!-- the table/q' results/beyond/events.md
	$(BIN)/$(EVENTS) >> results/beyond/events.md

# results/benchmark/: the public board (a quarter of an hour of two cores). Needs the paper's
# recordings; the tracks of UAH-DriveSet are scored where EGOLANE_DATA/bench has them.
benchmark: .venv/.dev
	$(BIN)/python -m makers.benchmark --out results/benchmark

# 400 simulated drives on one process, on two, and on a Dask cluster on this machine, one of whose
# four workers is killed and one added; the summary is the same (some minutes).
cluster-demo: .venv/.dev
	$(BIN)/python -m tests.cluster_demo

# What results/camera/ holds of real pictures, made from those in EGOLANE_DATA.
camera: .venv/.dev
	$(BIN)/python -m makers.camera carnd tusimple phantom clips aly lane_change labels lstr --out results/camera > results/camera/pictures.md

# What a search of the detectors' parameters gains on labelled stills (ten minutes of two cores).
searched: .venv/.dev
	$(BIN)/python -m makers.camera searched > results/camera/searched.md

# What results/camera/ holds of rendered motorways: tables (25 minutes of one core), a frame.
rendered: .venv/.dev
	mkdir -p results/camera
	$(BIN)/python -m makers.camera rendered --out results/camera > results/camera/rendered.md

# All detectors on one rendered drive through the paper's graph: a table and a figure (7 minutes).
compared: .venv/.dev
	mkdir -p results/camera
	$(BIN)/python -m makers.camera compared --out results/camera > results/camera/detectors.md

# The tables of docs/maps.md about positions, matching and lanes (a quarter of an hour of one core).
maps: .venv/.dev
	$(BIN)/python -m makers.maps matched located outages recorded

.venv/.venv:
	$(PYTHON) -m venv .venv
	@touch $@

.venv/.run: .venv/.venv pyproject.toml constraints.txt
	$(BIN)/python -m pip install -q --disable-pip-version-check -c constraints.txt -e .
	@touch $@

.venv/.dev: .venv/.venv pyproject.toml constraints.txt
	$(BIN)/python -m pip install -q --disable-pip-version-check -c constraints.txt -e '.[dev]'
	@touch $@ .venv/.run

.venv/.bench: .venv/.dev
	$(BIN)/python -m pip install -q --disable-pip-version-check -c constraints.txt -e '.[bench]'
	@touch $@

clean:
	rm -rf .venv .pytest_cache .mypy_cache .ruff_cache .hypothesis .coverage
