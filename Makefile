# `make sitl` flies, `make test` tests; both do all the set-up that they need.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
SCENARIO ?= docking
SEED ?= 1
ARGS ?=
KERNELS := $(shell grep -rlE "njit|@kernel" companion sim_bridge --include=*.py)

.PHONY: help setup sitl fly view study faults consistency accuracy integrity test test-slow check bench figures clean

help:
	@echo "make sitl     fly a docking: simulator and companion as two processes on the wall clock (about two minutes)"
	@echo "make fly      the same flight in lockstep, faster than real time, the same bits for the same SEED"
	@echo "make view     open the newest recording in the Rerun viewer"
	@echo "make study    chapter 7 of the thesis again: a report in runs (minutes; ARGS='--quick' for a look)"
	@echo "make test     the tests        make check    style, types, imports"
	@echo "make bench    speed and accuracy figures"
	@echo "make consistency, accuracy, integrity   many flights: tables and pictures in docs (10 to 25 minutes each)"
	@echo "make faults   every fault there is, flown: what came of each, in docs/faults.md (three minutes)"
	@echo "make figures  the pictures of the README"
	@echo "SCENARIO=docking|thesis|moderate|turning|night|...|FILE SEED=1 ARGS='--pose glsdc'"

# A half-made environment is made again: the stamp is the last thing to be written.
$(VENV)/.python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "Python 3.11 or newer is needed; $(PYTHON) is older. Name another: make PYTHON=python3.12 ..."; exit 2; }
	@$(PYTHON) -c 'import venv, ensurepip' 2>/dev/null || \
	  { echo "Python's venv module is missing. On Debian or Ubuntu: apt install python3-venv"; exit 2; }
	@echo "making $(VENV) ..."
	@rm -rf $(VENV) && $(PYTHON) -m venv $(VENV)
	@touch $@

$(VENV)/.run: $(VENV)/.python pyproject.toml constraints.txt
	@echo "installing packages (once) ..."
	@$(BIN)/pip install --quiet --disable-pip-version-check -c constraints.txt -e .
	@touch $@

# numba keeps compiled kernels beside the source and does not see that another file's kernel, compiled in, has changed.
$(VENV)/.kernels: $(VENV)/.run $(KERNELS)
	@echo "compiling kernels (once, about a minute) ..."
	@find companion sim_bridge -name '*.nb[ci]' -delete
	@$(BIN)/companion warm-up firmware_configs/sitl/docking.toml
	@touch $@

$(VENV)/.dev: $(VENV)/.run
	@echo "installing packages for tests (once) ..."
	@$(BIN)/pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev]'
	@touch $@

setup: $(VENV)/.dev

sitl: $(VENV)/.kernels
	@$(BIN)/sim-bridge sitl $(SCENARIO) --seed $(SEED) $(ARGS)

fly: $(VENV)/.kernels
	@$(BIN)/sim-bridge fly $(SCENARIO) --seed $(SEED) $(ARGS)

view: $(VENV)/.run
	@$(BIN)/companion view $(ARGS)

study: $(VENV)/.kernels
	@$(BIN)/sim-bridge study --seed $(SEED) $(ARGS)

faults: $(VENV)/.kernels
	@$(BIN)/sim-bridge faults --seed $(SEED) --out docs/faults.md $(ARGS)

consistency: $(VENV)/.kernels
	@$(BIN)/sim-bridge consistency --out docs $(ARGS)

accuracy: $(VENV)/.kernels
	@$(BIN)/sim-bridge accuracy --out docs $(ARGS)

integrity: $(VENV)/.kernels
	@$(BIN)/sim-bridge integrity --out docs $(ARGS)

test: $(VENV)/.dev $(VENV)/.kernels
	@$(BIN)/python -m pytest -q $(ARGS)

test-slow: $(VENV)/.dev $(VENV)/.kernels
	@$(BIN)/python -m pytest -q -m slow $(ARGS)

check: $(VENV)/.dev
	@$(BIN)/ruff check .
	@$(BIN)/mypy
	@$(BIN)/lint-imports

bench: $(VENV)/.dev $(VENV)/.kernels
	@$(BIN)/python -m pytest -q -m bench -s $(ARGS)

figures: $(VENV)/.dev $(VENV)/.kernels
	@$(BIN)/python -m sim_bridge.figures --out docs

clean:
	rm -rf $(VENV) build *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
