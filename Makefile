# The commands a developer runs, and the ones CI runs. Each makes its own environment from a bare Python.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# Real recordings and networks, where somebody has them; tests that need them skip elsewhere.
ifneq ($(wildcard ../shared/data),)
export E3POSE_SHARED ?= $(abspath ../shared)
endif
export PIP_DISABLE_PIP_VERSION_CHECK := 1

.PHONY: help demo test test-fast check lint bench soak attack test-all clean
help:  ## say what there is
	@echo 'make WHAT, each from a bare Python 3.10 to 3.13 ($(PYTHON), or PYTHON=...):'
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:[^#]*## /\t/; s/^/  /' | expand -t 12

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(None if (3, 10) <= sys.version_info < (3, 14) else \
	  "$(PYTHON) is %d.%d, expected 3.10 to 3.13: name another with make PYTHON=..." % sys.version_info[:2])'
	$(PYTHON) -m venv $(VENV) || { rm -rf $(VENV); exit 1; }

$(VENV)/.all: pyproject.toml | $(BIN)/python
	$(BIN)/python -m pip install --quiet --editable '.[all]'
	@touch $@

$(VENV)/.dev: pyproject.toml | $(BIN)/python
	$(BIN)/python -m pip install --quiet --editable '.[dev]'
	@touch $@ $(VENV)/.all

demo: $(VENV)/.all  ## a live site on real videos; poses and a report out (demo-output/)
	$(BIN)/e3pose demo demo-output --overwrite

# What computes shares the cores; sites run beside each other; what is timed runs beside nothing.
PYTEST := $(BIN)/python -m pytest -q --dist loadscope --no-loadscope-reorder
COVERED := --cov --cov-append --cov-report= --cov-fail-under=0
test: $(VENV)/.dev  ## run the tests and print the coverage
	$(BIN)/coverage erase
	$(PYTEST) $(COVERED) -n 2 -m 'not live and not timed'
	$(PYTEST) $(COVERED) -n 3 -m 'live and not timed' tests/live
	$(PYTEST) $(COVERED) -m timed
	$(BIN)/coverage report

test-fast: $(VENV)/.dev  ## run what takes less than a minute in all, for while you work
	$(PYTEST) -n 2 -m 'not slow and not live and not timed and not shared and not network'

check: $(VENV)/.dev  ## formatting, lint, types, and who may import whom
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/python -m pytest -q tests/test_imports.py

lint: $(VENV)/.dev  ## put formatting and simple findings right
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

bench: $(VENV)/.all  ## how long things take: fusing, filtering, predicting, choosing, keeping, a live site
	$(BIN)/python benchmarks/bench_fuse.py
	$(BIN)/python benchmarks/bench_filter.py
	$(BIN)/python benchmarks/bench_predict.py
	$(BIN)/python benchmarks/bench_choose.py
	$(BIN)/python benchmarks/bench_import.py
	$(BIN)/python benchmarks/bench_store.py
	$(BIN)/python benchmarks/bench_batteries.py
	$(BIN)/python benchmarks/bench_timeline.py
	$(BIN)/python benchmarks/bench_live.py

soak: $(VENV)/.all  ## a live site for half an hour: does anything grow?
	$(BIN)/python benchmarks/soak.py --minutes 30

attack: $(VENV)/.all  ## fuzzed decoders, damaged files and a live site under attack, on loopback (ATTACK_SECONDS=300)
	$(BIN)/python benchmarks/attack.py

test-all: $(VENV)/.dev  ## the tests under every supported Python (3.10 to 3.13)
	$(BIN)/nox

clean:  ## remove what these commands made
	rm -rf $(VENV) .nox .mypy_cache .ruff_cache .pytest_cache .hypothesis .coverage* demo-output
