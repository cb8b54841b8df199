# `make run` and `make test` do everything on a machine with python3, make and a package index.
PYTHON ?= python3
BIN := .venv/bin

ifneq ($(wildcard ../shared/data/rle),)
export EGOLANE_DATA ?= $(abspath ../shared/data)
endif

.PHONY: run test check bench coverage figures clean

run: .venv/.run
	$(BIN)/egolane run experiments/quickstart.yaml
	@echo
	$(BIN)/egolane reproduce --if-available

test: .venv/.dev
	$(BIN)/python -m pytest

check: .venv/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

# The kernels as plain Python, so that their lines are seen too.
coverage: .venv/.dev
	NUMBA_DISABLE_JIT=1 $(BIN)/python -m coverage run -m pytest -q
	$(BIN)/python -m coverage report

bench: .venv/.bench
	$(BIN)/python -m tests.benchmarks

# What the README shows: the table and the figures of the paper's runs, from the recordings.
figures: .venv/.run
	$(BIN)/python results/paper/make.py

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
