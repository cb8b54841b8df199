# `make run` and `make test` do everything on a machine with python3, make and a package index.
PYTHON ?= python3
BIN := .venv/bin

ifneq ($(wildcard ../shared/data/rle),)
export EGOLANE_DATA ?= $(abspath ../shared/data)
endif

.PHONY: run test check docs bench coverage dist notebooks paper graphs beyond camera tuned maps benchmark clean

run: .venv/.run
	$(BIN)/egolane run experiments/quickstart.yaml
	@echo
	-$(BIN)/egolane reproduce
	@echo
	@echo "The belief over lanes of the simulated drive: results/quickstart/figures/strips.png"

# A file's tests share what they make, so one process runs all of them; tests/conftest.py orders
# the files.
test: .venv/.dev
	$(BIN)/python -m pytest --numprocesses auto --dist loadfile --no-loadscope-reorder

check: .venv/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python .ci/budget

# The kernels as plain Python, so that their lines are seen too; then, compiled, what would take
# minutes so.
COMPILED := $(addsuffix .py,$(addprefix tests/,test_comparing studies/test_study \
	studies/test_learning vision/detectors/test_detectors vision/detectors/test_runner))
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
paper: .venv/.run
	$(BIN)/egolane reproduce --out $(RUNS)/reproduced > results/paper/reproduction.md
	$(BIN)/python -m makers.pages paper
	$(BIN)/egolane plot $(RUNS)/reproduced/run01_italy_ml --frames 1880 2700 --out $(RUNS)/figures
	$(BIN)/egolane plot $(RUNS)/reproduced/* --out $(RUNS)/figures
	cp $(addprefix $(RUNS)/figures/,$(addsuffix .png,strips confusion reliability dispersion)) results/paper/
	$(BIN)/egolane show sensor_failure --out results/paper/network.png

# What results/graphs/ holds: fits, which edge helps, and whether models look like the data (half an hour
# of one core). Structures whose fits are in results/runs are not fitted again.
graphs: .venv/.run
	$(BIN)/python -m makers.graphs fits edges checks
	$(BIN)/egolane tune experiments/paper/run01_italy_ml.yaml --trials 600 --folds 0 \
		$(addprefix --profile ,sigma1 sigma2 p1 p2 p3 p4) --out $(RUNS)/profiled
	cp $(RUNS)/profiled/figures/profile.png results/graphs/

# results/tuning/runs.md: the paper's parameters searched for each run (three minutes of
# two cores).
tuned: .venv/.run
	$(BIN)/python -m makers.pages tuned

# What results/beyond/ holds of the ten recordings, of recordings by other detectors and of ramps
# (half an hour of one core).
beyond: .venv/.dev
	$(BIN)/python -m makers.pages beyond
	$(BIN)/python -m makers.beyond strangers > results/beyond/strangers.md
	$(BIN)/python -m makers.beyond sensors > results/beyond/sensors.md
	$(BIN)/python -m makers.beyond ramps > results/beyond/ramps.md

# results/benchmark/: the public board (some minutes of two cores). Needs the paper's
# recordings; the tracks of UAH-DriveSet are scored where EGOLANE_DATA/bench has them.
benchmark: .venv/.dev
	$(BIN)/python -m makers.benchmark

# What results/camera/ holds of real pictures, made from those in EGOLANE_DATA.
camera: .venv/.dev
	$(BIN)/python -m makers.camera --out results/camera > results/camera/pictures.md

# The table of docs/maps.md about matching (some minutes).
maps: .venv/.dev
	$(BIN)/python -m makers.maps

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
