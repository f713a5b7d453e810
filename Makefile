# The commands a developer runs, and the ones CI runs. Each makes its own environment from a bare Python.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# Real recordings and networks, where somebody has them; tests that need them skip elsewhere.
ifneq ($(wildcard ../shared/data),)
export E3POSE_SHARED ?= $(abspath ../shared)
endif
export PIP_DISABLE_PIP_VERSION_CHECK := 1

.PHONY: help demo test check lint bench test-all clean
help:  ## say what there is
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:[^#]*## /\t/' | expand -t 12

$(BIN)/python:
	$(PYTHON) -m venv $(VENV)

$(VENV)/.all: pyproject.toml | $(BIN)/python
	$(BIN)/python -m pip install --quiet --editable '.[all]'
	@touch $@

$(VENV)/.dev: pyproject.toml | $(BIN)/python
	$(BIN)/python -m pip install --quiet --editable '.[dev]'
	@touch $@ $(VENV)/.all

demo: $(VENV)/.all  ## real videos in, scored 3D poses and a report out (demo-output/)
	$(BIN)/e3pose demo demo-output --overwrite

test: $(VENV)/.dev  ## run the tests and print the coverage
	$(BIN)/coverage erase
	$(BIN)/coverage run -m pytest -q
	$(BIN)/coverage combine --quiet
	$(BIN)/coverage report

check: $(VENV)/.dev  ## formatting, lint, types
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy

lint: $(VENV)/.dev  ## put formatting and simple findings right
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

bench: $(VENV)/.all  ## speed and memory as ratios to a reference in the same run
	$(BIN)/python benchmarks/bench_fuse.py

test-all: $(VENV)/.dev  ## the tests under every supported Python (3.10 to 3.13)
	$(BIN)/nox

clean:  ## remove what these commands made
	rm -rf $(VENV) .nox .mypy_cache .ruff_cache .pytest_cache .hypothesis .coverage* demo-output
