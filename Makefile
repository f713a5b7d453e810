# The commands a developer runs, and the ones CI runs. Each makes its own environment from a bare Python.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# Real recordings and networks, if available; tests that need them skip otherwise.
ifneq ($(wildcard ../shared/data),)
export E3POSE_SHARED ?= $(abspath ../shared)
endif
export PIP_DISABLE_PIP_VERSION_CHECK := 1

.PHONY: help demo test test-fast check docs lint reproduce-quick bench soak attack test-all clean
help:  ## list the targets
	@echo 'make TARGET; each needs only Python 3.10 to 3.13 ($(PYTHON), or PYTHON=...):'
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

demo: $(VENV)/.all  ## run a live site on real videos; results in demo-output/
	$(BIN)/e3pose demo demo-output --overwrite

# What computes shares the cores; sites run beside each other; what is timed runs beside nothing.
# The page of four cameras waits for most of its two minutes, so it starts first beside what computes.
# Sites get a second try, which the summary counts: other programs may take the machine for seconds.
PYTEST := $(BIN)/python -m pytest -q --dist loadscope --no-loadscope-reorder
LONGEST := tests/live/test_four_cameras.py
COVERED := --cov --cov-append --cov-report= --cov-fail-under=0
test: $(VENV)/.dev  ## run the tests with coverage
	$(BIN)/coverage erase
	$(PYTEST) $(COVERED) -n 4 -m 'not live and not timed' $(LONGEST) tests
	$(PYTEST) $(COVERED) -n 3 --reruns 1 -m 'live and not timed' tests/live
	$(PYTEST) $(COVERED) --reruns 1 -m timed
	$(BIN)/coverage report

test-fast: $(VENV)/.dev  ## run the tests that take less than a minute in total
	$(PYTEST) -n 2 -m 'not slow and not live and not timed and not shared and not network'

check: $(VENV)/.dev docs  ## check formatting, lint, types, layers and documentation
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/python -m pytest -q tests/test_imports.py

docs: $(VENV)/.dev  ## build the documentation into site/; warnings are errors
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet

lint: $(VENV)/.dev  ## fix formatting and simple lint findings
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

# Items whose recordings are not there are skipped, and the report says why.
reproduce-quick: $(VENV)/.dev  ## redo the paper's tables and figures with few seeds; fails outside their margins
	$(BIN)/e3pose reproduce reproduced --quick $(if $(E3POSE_SHARED),--data $(E3POSE_SHARED)/data)

bench: $(VENV)/.all  ## run the speed benchmarks
	$(BIN)/python benchmarks/bench_fuse.py
	$(BIN)/python benchmarks/bench_filter.py
	$(BIN)/python benchmarks/bench_predict.py
	$(BIN)/python benchmarks/bench_step.py
	$(BIN)/python benchmarks/bench_choose.py
	$(BIN)/python benchmarks/bench_import.py
	$(BIN)/python benchmarks/bench_store.py
	$(BIN)/python benchmarks/bench_batteries.py
	$(BIN)/python benchmarks/bench_live.py
	$(BIN)/python benchmarks/bench_view.py

soak: $(VENV)/.all  ## run a live site for half an hour and check for leaks
	$(BIN)/python benchmarks/soak.py --minutes 30

attack: $(VENV)/.all  ## fuzz decoders and files, attack a live site on loopback (ATTACK_SECONDS=300)
	$(BIN)/python benchmarks/attack.py

test-all: $(VENV)/.dev  ## run the tests under Python 3.10 to 3.13
	$(BIN)/nox

clean:  ## remove everything these targets created
	rm -rf $(VENV) .nox .mypy_cache .ruff_cache .pytest_cache .hypothesis .coverage* demo-output reproduced site
