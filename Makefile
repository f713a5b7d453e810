# The commands a developer runs, and the ones CI runs. Each makes its own environment from a bare Python.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
LOCKER := .venv-lock
CONTAINER := .venv-container
MUTATOR := .venv-mutants
DISTRIBUTOR := .venv-dist
# Real recordings and networks, if available; tests that need them skip otherwise.
ifneq ($(wildcard ../shared/data),)
export E3POSE_SHARED ?= $(abspath ../shared)
endif
export PIP_DISABLE_PIP_VERSION_CHECK := 1
# Python compiles each module where it is first imported: pip would take a minute for all of them.
INSTALL := -m pip install --quiet --no-compile

.PHONY: help demo test kernels test-computing test-sites test-fast coverage nightly check types docs lint reproduce-quick bench budget claims claims-all mutants soak attack dist release-dry-run lock sbom licences test-all clean
help:  ## list the targets
	@echo 'make TARGET; each needs only Python 3.10 to 3.13 ($(PYTHON), or PYTHON=...):'
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:[^#]*## /\t/; s/^/  /' | expand -t 12

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(None if (3, 10) <= sys.version_info < (3, 14) else \
	  "$(PYTHON) is %d.%d, expected 3.10 to 3.13: name another with make PYTHON=..." % sys.version_info[:2])'
	$(PYTHON) -m venv $(VENV) || { rm -rf $(VENV); exit 1; }

# Product, hub and lab are distributions, of one version; here all are this folder's.
DISTRIBUTIONS := . hub lab
PROJECTS := $(DISTRIBUTIONS:%=%/pyproject.toml)
EDITABLE := $(DISTRIBUTIONS:%=--editable %)
$(VENV)/.all: $(PROJECTS) | $(BIN)/python
	$(BIN)/python $(INSTALL) --editable '.[all,hub,lab]' $(EDITABLE)
	@touch $@

# Pinned versions with hashes; `make lock` renews them.
$(VENV)/.dev: $(PROJECTS) requirements/dev.txt | $(BIN)/python
	$(BIN)/python $(INSTALL) --require-hashes --requirement requirements/dev.txt
	$(BIN)/python $(INSTALL) --no-deps --no-build-isolation $(EDITABLE)
	@touch $@ $(VENV)/.all

demo: $(VENV)/.all  ## run a live site on real videos; results in demo-output/
	$(BIN)/e3pose demo demo-output --overwrite

# What computes runs in three processes at a low priority, and takes what sites leave of the cores:
# these mostly wait, three at a time; what is timed runs after the other sites, two at a time. Other
# programs may take the machine: tests of sites get a second try, whatever fails one more at the end
# of its part, in a new process, and the run names both.
PYTEST := $(BIN)/python -m pytest -q
COVERAGE := .coverage-data
COVERED = $(and $(TRACED),--cov --cov-append --cov-report= --cov-fail-under=0)
SITES := --reruns 1 --rerun-show-tracebacks --dist loadfile --no-loadscope-reorder
# Of what the machine's cores do, a process at 7 gets a fifth of one at 0.
COMPUTING_NICE ?= 7
COMPUTING_WORKERS ?= 3
export RERUNS := $(CURDIR)/.reruns
# Run tests: the name of their part, what pytest runs under, its options, which marks. `@FILE` has
# more options. A part may have no tests to run (5) where little differs.
define tests
@rm -f .failed-$(1)
@echo 'tests: $(1)'
@export COVERAGE_FILE=$(COVERAGE)/.coverage.$(1) FAILED=$(CURDIR)/.failed-$(1); \
  $(2) $(PYTEST) $(COVERED) $(3) -m '$(4) $(DAILY)' @.left-out || [ $$? = 5 ] || { [ -s .failed-$(1) ] && \
  mv .failed-$(1) .again-$(1) && echo 'once more:' && cat .again-$(1) && \
  cat .again-$(1) >> $(RERUNS) && $(2) $(PYTEST) $(COVERED) @.again-$(1); }
endef
# The rewritten assertions are kept for the next run.
export PYTHONDONTWRITEBYTECODE :=
DAILY = and not nightly

test: $(VENV)/.dev  ## run the tests that what differs from main reaches, but for the longest (BASE=COMMIT)
	@rm -f $(RERUNS)
	$(if $(TRACED),rm -rf $(COVERAGE) && mkdir $(COVERAGE))
	@$(BIN)/python -m tests.prepare .left-out $(EVERYTHING)
	@echo 'computing beside sites; each shows its results at its end, after some minutes'
	@$(MAKE) --no-print-directory --keep-going --jobs 2 --output-sync=target test-sites test-computing; \
	  ended=$$?; [ ! -s $(RERUNS) ] || { echo 'needed another try:'; sort -u $(RERUNS); }; exit $$ended
	$(if $(TRACED),$(BIN)/coverage combine --quiet $(COVERAGE))
	$(if $(TRACED),$(BIN)/coverage report)

kernels: $(VENV)/.dev  ## compile the kernels, which `make test` does first
	@$(BIN)/python -m tests.prepare .left-out

coverage:  ## run the tests of all rooms with coverage, which takes a third longer; fails below the floor
	@$(MAKE) --no-print-directory test TRACED=yes EVERYTHING=--all

nightly: check types  ## all that takes long: every test with coverage, types of other systems, all claims, the paper's tables
	@$(MAKE) --no-print-directory coverage DAILY=
	@$(MAKE) --no-print-directory budget
	@$(MAKE) --no-print-directory claims-all
	@$(MAKE) --no-print-directory reproduce-quick

test-computing: $(VENV)/.dev
	$(call tests,computing,nice -n $(COMPUTING_NICE),-n $(COMPUTING_WORKERS) --dist loadfile --ignore tests/live,not live and not timed)

test-sites: $(VENV)/.dev
	$(call tests,sites,,$(SITES) -n 3 tests/live,live and not timed)
	$(call tests,timed,,$(SITES) -n 2 tests/live tests/edge,timed)

test-fast: $(VENV)/.dev  ## run the quick tests, in about a minute
	$(PYTEST) -n 2 --dist loadfile -m 'not slow and not live and not timed and not nightly and not shared and not network'

check: $(VENV)/.dev docs  ## check formatting, lint, types and documentation
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy

types: $(VENV)/.dev  ## check the types of the product for other systems
	for system in win32 darwin; do $(BIN)/mypy --platform $$system --cache-dir .mypy_cache/$$system src hub || exit 1; done

docs: $(VENV)/.dev  ## build the documentation into site/; warnings are errors
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet

lint: $(VENV)/.dev  ## fix formatting and simple lint findings
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

# Items whose recordings are not there are skipped, and the report says why.
reproduce-quick: $(VENV)/.dev  ## redo the paper's tables and figures with few seeds; fails outside their margins
	$(BIN)/e3pose reproduce reproduced --quick $(if $(E3POSE_SHARED),--data $(E3POSE_SHARED)/data)

bench: $(VENV)/.all  ## run the speed benchmarks, and calibration beside other programs (OTHERS=their python)
	$(BIN)/python lab/benchmarks/bench_fuse.py
	$(BIN)/python lab/benchmarks/bench_step.py
	$(BIN)/python lab/benchmarks/bench_store.py
	$(BIN)/python lab/benchmarks/bench_batteries.py
	$(BIN)/python lab/benchmarks/bench_live.py
	$(BIN)/python lab/benchmarks/bench_floor.py
	$(BIN)/python lab/benchmarks/bench_view.py
	$(BIN)/python lab/benchmarks/bench_calibration.py --cases "ring, one person;operating-room" \
	  $(if $(OTHERS),--others $(OTHERS))

budget: $(VENV)/.dev  ## what programs and verbs cost; fails over a limit of lab/benchmarks/budget.toml
	$(BIN)/python lab/benchmarks/budget.py

# Those that need recordings which are not there are left out, and named.
claims: $(VENV)/.dev  ## repeat the quick figures of README and research pages; fails outside their spread
	$(BIN)/python lab/benchmarks/claims.py

claims-all: $(VENV)/.dev  ## repeat all marked figures, in 45 minutes, and write the day; CLAIMS="shelf ring": those
	$(BIN)/python lab/benchmarks/claims.py $(or $(CLAIMS),--all) --write

# cosmic-ray makes the mutants in an environment of its own. The tests run in the usual one, on a copy.
# `make mutants PACKAGES=wire MUTANTS=40 SEED=2 MINUTES=20`
PACKAGES ?= pipeline select wire estimate
MUTANTS ?= 150
SEED ?= 1
MINUTES ?= 120
mutants: $(VENV)/.dev $(MUTATOR)/.installed  ## change the source at random and see whether a test fails
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 nice -n 15 $(BIN)/python lab/benchmarks/mutants.py \
	  $(MUTATOR)/bin/python $(PACKAGES) --count $(MUTANTS) --seed $(SEED) --minutes $(MINUTES)

$(MUTATOR)/.installed: | $(BIN)/python
	$(PYTHON) -m venv --clear $(MUTATOR)
	$(MUTATOR)/bin/python -m pip install --quiet 'cosmic-ray==8.7.0'
	@touch $@

soak: $(VENV)/.all  ## run a live site for half an hour and check for leaks
	$(BIN)/python lab/benchmarks/soak.py --minutes 30

attack: $(VENV)/.dev  ## fuzz decoders and files, attack a live site on loopback, in 40 minutes (ATTACK="--write")
	$(BIN)/python lab/benchmarks/attack.py $(ATTACK)

# Uploading is a person's: RELEASING.md.
DIST ?= dist
dist: $(DISTRIBUTOR)/.installed  ## build wheels and sdists of all distributions into dist/, and check them as an index does
	rm -rf $(DIST)
	for part in $(DISTRIBUTIONS); do $(DISTRIBUTOR)/bin/python -m build --outdir $(DIST) $$part > /dev/null || exit 1; done
	$(DISTRIBUTOR)/bin/twine check --strict $(DIST)/*

# `make release-dry-run PYTHONS="3.10 3.13"`
PYTHONS ?= 3.10 3.11 3.12 3.13
release-dry-run: dist $(VENV)/.dev  ## install what `dist` built by name, use it in empty folders, and resolve it for other systems
	PATH="$(CURDIR)/$(BIN):$$PATH" $(BIN)/nox -s platforms $(PYTHONS:%="release(version='%')")

$(DISTRIBUTOR)/.installed: | $(BIN)/python
	$(PYTHON) -m venv --clear $(DISTRIBUTOR)
	$(DISTRIBUTOR)/bin/python -m pip install --quiet 'build==1.6.1' 'twine==7.0.0'
	@touch $@

test-all: $(VENV)/.dev  ## run the tests under Python 3.10 to 3.13
	$(BIN)/nox

# For Python 3.10 to 3.13 on any Linux. Extras stay named: pip 23 prefers a newer release where one entry names an extra
# and the pinned one does not. `make lock LOCK=--upgrade` takes the newest versions, otherwise
# those that still fit stay. The container has those of the tests.
COMPILE := $(LOCKER)/bin/uv pip compile pyproject.toml --universal --python-version 3.10 --generate-hashes \
  --no-emit-index-url --no-emit-find-links --no-annotate --no-header --no-strip-extras --quiet \
  --no-emit-package e3pose --no-emit-package e3pose-hub --no-emit-package e3pose-lab
lock:  ## renew the pinned versions and hashes in requirements/
	[ -x $(LOCKER)/bin/uv ] || { $(PYTHON) -m venv $(LOCKER) && $(LOCKER)/bin/pip install --quiet uv; }
	$(COMPILE) $(LOCK) --extra dev --output-file requirements/dev.txt
	$(COMPILE) $(LOCK) --extra edge --extra camera --extra models --extra build \
	  --constraints requirements/dev.txt --output-file requirements/container.txt

$(CONTAINER)/.installed: requirements/container.txt | $(VENV)/.dev
	$(PYTHON) -m venv --clear $(CONTAINER)
	$(CONTAINER)/bin/python -m pip install --quiet --require-hashes --requirement requirements/container.txt
	@touch $@

sbom: $(CONTAINER)/.installed  ## list what the container has, as CycloneDX in sbom.json
	$(BIN)/cyclonedx-py environment --output-reproducible --pyproject pyproject.toml \
	  --output-file sbom.json $(CONTAINER)/bin/python

licences: $(VENV)/.dev  ## list the licences of everything installed; fails on AGPL, GPL, non-commercial
	$(BIN)/cyclonedx-py environment --output-file $(VENV)/sbom.json $(BIN)/python
	$(BIN)/python requirements/licences.py $(VENV)/sbom.json

clean:  ## remove everything these targets created
	rm -rf $(VENV) .reruns .left-out .nox .mypy_cache .ruff_cache .pytest_cache .hypothesis .coverage* demo-output reproduced site dist $(DISTRIBUTOR) $(LOCKER) $(CONTAINER) $(MUTATOR) .mutants sbom.json
