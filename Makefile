# `make run` and `make test` are all a new clone needs: both make and fill .venv by themselves.

PYTHON ?= python3
VENV ?= .venv
CONSTRAINTS ?= constraints.txt
ARGS ?=
JOBS ?= 2

BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check -qq
PYTEST := $(BIN)/python -m pytest
NO_TESTS_SELECTED = [ $$? -eq 5 ] # pytest's status

# One stamp for each level of installation: it is older than these files when they have changed.
REQUIREMENTS := pyproject.toml $(CONSTRAINTS)
CREATED := $(VENV)/.created
BASE := $(VENV)/.base
ROBOT := $(VENV)/.robot
VIEW := $(VENV)/.view
TEST := $(VENV)/.test
NIGHTLY := $(VENV)/.nightly
DEV := $(VENV)/.dev
BENCH := $(VENV)/.bench

# Tests start many processes; without byte code on disk, each compiles hundreds of modules anew.
unexport PYTHONDONTWRITEBYTECODE

.DEFAULT_GOAL := help
.PHONY: help run view robot test test-all check lint style types tests quick-tests kernels wheel format dev bench clean
.DELETE_ON_ERROR:

help: ## show this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "  make %-8s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

run: $(BASE) ## bring the gaze to a point and triangulate it (options: make run ARGS="--help")
	@$(BIN)/vergence gaze $(ARGS)

view: $(VIEW) ## a simulated head in the browser: drag its target (options: make view ARGS="--help")
	@$(BIN)/vergence view $(ARGS)

robot: $(ROBOT) ## a robot's functions on an emulated head: checks, gazes, a fault, a replayed log
	@$(BIN)/python -m benchmarks.tour

test: $(TEST) ## lint, types, and all tests but the nightly ones (options: make test ARGS="-k triangulation")
	@$(MAKE) -j2 types tests

tests: style kernels
	@$(PYTEST) -n $(JOBS) --dist worksteal -m "not real_time and not nightly" $(ARGS) || $(NO_TESTS_SELECTED)
	@$(PYTEST) -m "real_time and not nightly" $(or $(ARGS),tests/hardware) || $(NO_TESTS_SELECTED)

test-all: $(NIGHTLY) test ## what `make test` does, and the nightly tests
	@$(PYTEST) -n $(JOBS) --dist worksteal -m "nightly and not real_time" $(ARGS) || $(NO_TESTS_SELECTED)
	@$(PYTEST) -m "nightly and real_time" $(or $(ARGS),tests/hardware) || $(NO_TESTS_SELECTED)

check: $(TEST) ## lint and the quick tests of what differs from main, or of rooms (ROOM="models eval")
	@$(MAKE) -j2 types quick-tests

quick-tests: style
	@$(BIN)/python -m tests.kernels --once
	@places=$$($(BIN)/python -m tests.rooms $(ROOM)) && \
	  { $(PYTEST) -n $(JOBS) --dist worksteal -m "not slow and not nightly" $(ARGS) $$places || $(NO_TESTS_SELECTED); }

lint: style types ## ruff and mypy

style: $(TEST)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(TEST) # takes the time that others leave, and is told of at once
	@echo "$(BIN)/mypy"; told=$$(nice $(BIN)/mypy 2>&1); failed=$$?; echo "$$told"; exit $$failed

kernels: $(TEST) ## compile what the tests call
	@$(BIN)/python -m tests.kernels

wheel: $(TEST) ## build a wheel in dist/ that carries compiled kernels for this kind of machine
	@$(BIN)/python -m tests.kernels --ship
	@$(BIN)/python -m build --no-isolation --wheel

format: $(TEST) ## let ruff rewrite what it can
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

dev: $(DEV) ## install everything for working on the code, and the pre-commit hooks
	$(BIN)/pre-commit install

bench: $(BENCH) ## measure speed against other simulators
	$(BIN)/python -m benchmarks $(ARGS)

clean: ## remove the environment, caches and built files
	rm -rf $(VENV) build dist .hypothesis .mypy_cache .pytest_cache .ruff_cache
	find vergence tests benchmarks -name __pycache__ -type d -prune -exec rm -rf {} + 2>/dev/null || true

$(CREATED):
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
	  echo "vergence needs Python 3.11 or newer, and '$(PYTHON)' is not: make PYTHON=python3.12 ..." >&2; \
	  exit 1; }
	@$(PYTHON) -m venv $(VENV) || { \
	  echo "cannot make $(VENV): on Debian and Ubuntu, install the package python3-venv" >&2; \
	  exit 1; }
	@touch $@

# $(call install,extras): pip checks every requirement, but fetches only what is not there yet.
# Python compiles what it imports, which is far less than what is installed.
define install
	@echo "Installing vergence$(1) into $(VENV) (a few minutes the first time)"
	@$(PIP) install --no-compile -c $(CONSTRAINTS) -e '.$(1)'
	@touch $@
endef

$(BASE): $(CREATED) $(REQUIREMENTS)
	$(call install,)

$(ROBOT): $(CREATED) $(REQUIREMENTS)
	$(call install,[robot])
	@touch $(BASE)

$(VIEW): $(CREATED) $(REQUIREMENTS)
	$(call install,[view])
	@touch $(BASE)

$(TEST): $(CREATED) $(REQUIREMENTS)
	$(call install,[test])
	@touch $(BASE)

$(NIGHTLY): $(CREATED) $(REQUIREMENTS)
	$(call install,[nightly])
	@touch $(BASE) $(TEST)

$(DEV): $(CREATED) $(REQUIREMENTS)
	$(call install,[dev$(comma)train$(comma)render$(comma)view])
	@touch $(BASE) $(TEST) $(NIGHTLY)

$(BENCH): $(CREATED) $(REQUIREMENTS)
	$(call install,[bench])
	@touch $(BASE)

comma := ,
