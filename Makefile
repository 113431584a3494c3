# hallsym: `make` lists what there is. Needs GNU make, a POSIX shell and Python 3.11 or newer.

PYTHON ?= python3
VENV   ?= .venv

BIN       := $(VENV)/bin
PLAIN     := $(VENV)/.installed-plain
INSTALLED := $(VENV)/.installed
BENCHABLE := $(VENV)/.installed-bench
PIP       := $(BIN)/python -m pip --disable-pip-version-check install --quiet

# What compiles, runs and proves the generated C; the tests that need them are skipped, with their name, without.
FIRMWARE := gcc-arm-none-eabi libnewlib-arm-none-eabi qemu-system-arm cppcheck clang frama-c-base cmake

# Continuous integration (CI=true) runs the slow tests too, in the same run.
SLOW := $(if $(filter true,$(CI)),-m "slow or not slow")

# Another apt that runs holds a lock: wait for it, up to five minutes, and say so. What else fails is shown.
APT := said() { for n in $$(seq 30); do \
	told=$$(apt-get -o DPkg::Lock::Timeout=300 "$$@" 2>&1) && return 0; echo "$$told" >&2; \
	case "$$told" in *[Ll]ock*) sleep 10 ;; *) return 1 ;; esac; done; return 1; }; said

.DEFAULT_GOAL := help
.PHONY: help install tools demo test bench docs lint clean browser

help: ## list the targets
	@awk -F ':.*## ' '/^[a-z]+:.*## / { printf "  make %-8s %s\n", $$1, $$2 }' $(firstword $(MAKEFILE_LIST))
	@echo
	@echo "  PYTHON=$(PYTHON) makes the environment VENV=$(VENV); name others with make PYTHON=... VENV=..."

install: $(INSTALLED) ## environment with hallsym, its tests and linters (again only if pyproject.toml changed)

demo: $(PLAIN) ## the guided demonstration; installs what it needs, not the tests
	$(BIN)/python -m hallsym demo
	@echo "next: '. $(BIN)/activate' puts hallsym on the path; then: hallsym fit data/campaign -o calib.json"

tools: ## compilers, QEMU and provers that the tests of generated C use (as root on Debian, Ubuntu)
	@command -v apt-get >/dev/null && [ "$$(id -u)" = 0 ] || exit 0; \
	missing=$$(for name in $(FIRMWARE); do \
	    dpkg-query -W -f '$${Status}' $$name 2>/dev/null | grep -q '^install ok installed' || echo $$name; done); \
	[ -z "$$missing" ] || { echo "installing" $$missing; \
	    export DEBIAN_FRONTEND=noninteractive; \
	    { $(APT) update -qq && said install -y -qq --no-install-recommends $$missing; } || \
	    echo "apt could not install them, as it says above; the tests that need them say so"; }

# Tests start many interpreters; those read each other's bytecode, whatever the environment says.
test: install tools lint browser ## lint, then pytest on all cores (with the slow tests when CI=true)
	OPENBLAS_NUM_THREADS=1 PYTHONDONTWRITEBYTECODE= $(BIN)/python -m pytest -n auto --dist worksteal $(SLOW)

# Tests look at HTML pages in Chromium. Debian's root installs it; others run without it, or with their own.
browser:
	@command -v chromium >/dev/null 2>&1 || [ "$$(id -u)" != 0 ] || ! command -v apt-get >/dev/null 2>&1 || { \
	    echo "installing chromium, which the tests of HTML pages use"; \
	    export DEBIAN_FRONTEND=noninteractive; \
	    { $(APT) update -qq && said install --yes -qq --no-install-recommends chromium; } || \
	    echo "chromium could not be installed, as apt says above: tests that need it are skipped" >&2; }

bench: $(BENCHABLE) ## the benchmarks in tests/benchmarks
	@set -e; for script in tests/benchmarks/*.py; do \
	    case "$${script##*/}" in '*.py'|_*|test_*|conftest.py) continue ;; esac; \
	    echo "== $$script"; $(BIN)/python "$$script"; \
	done

docs: install ## the documentation site, in build/site (warnings are errors)
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m sphinx -b html -q -W --keep-going docs build/site
	@echo "open build/site/index.html"

lint: install ## ruff and mypy
	$(BIN)/python -m ruff check
	$(BIN)/python -m ruff format --check
	$(BIN)/python -m mypy

clean: ## remove caches, builds and the output of demo and bench (the environment stays)
	rm -rf build dist demo bench docs/examples docs/reference/generated docs/sg_execution_times.rst *.egg-info .pytest_cache .ruff_cache .mypy_cache .hypothesis
	find . -path ./$(VENV) -prune -o -name __pycache__ -type d -prune -exec rm -rf {} +

# Debian and Ubuntu ship Python without ensurepip: there pip is put into the environment from outside.
$(PLAIN): pyproject.toml
	@$(BIN)/python -m pip --version >/dev/null 2>&1 || { \
	    $(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || { \
	        echo "hallsym needs Python 3.11 or newer; $(PYTHON) is" \
	            "$$($(PYTHON) --version 2>/dev/null || echo missing)." \
	            "Name another one: make PYTHON=python3.12" >&2; exit 1; }; \
	    echo "making $(VENV) with $$($(PYTHON) --version)"; \
	    $(PYTHON) -m venv $(VENV) >/dev/null 2>&1 || { \
	        $(PYTHON) -m venv --clear --without-pip $(VENV) && \
	        $(PYTHON) -m pip --python $(BIN)/python install --quiet pip; } || { \
	        echo "$(PYTHON) cannot make the environment $(VENV): install its venv module" \
	            "(Debian, Ubuntu: apt install python3-venv) and try again." >&2; exit 1; }; }
	@echo "installing hallsym and what it needs into $(VENV)"
	@$(PIP) -e .
	@touch $@

$(INSTALLED): $(PLAIN)
	@echo "installing extras, tests and linters into $(VENV)"
	@$(PIP) -e '.[all,test,lint,docs]'
	@touch $@

$(BENCHABLE): $(INSTALLED)
	@echo "installing what the benchmarks compare with into $(VENV)"
	@$(PIP) -e '.[bench]'
	@touch $@
