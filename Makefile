# `make sim` is the whole project on a bare machine with Python 3.11 to 3.13; `make help` lists the rest.

SHELL := /bin/sh
.DEFAULT_GOAL := help
.PHONY: help setup lock sim sim-secure check test figures docs package release bench fuzz protocol mutants clean

# Passed through to `ltv-mpc sim`; empty: the scenario's own value.
SCENARIO =
SPEED =
SEED =
DURATION =
OUT =
FILES =
# Not empty: the live page opens in a browser.
OPEN =
# Of `make release`: 0.1.0
VERSION =

SIM_OPTIONS = $(if $(SCENARIO),'$(SCENARIO)') $(if $(SPEED),--speed '$(SPEED)') $(if $(SEED),--seed '$(SEED)') \
	$(if $(DURATION),--duration-s '$(DURATION)') $(if $(OUT),--out '$(OUT)') $(if $(OPEN),--open)

BIN := .venv/bin
# `ensurepip` is left out of Python by some distributions: a venv without it has no pip.
FITS := import sys, venv, ensurepip; sys.exit(not (3, 11) <= sys.version_info < (3, 14))
CANDIDATES := python3 python3.11 python3.12 python3.13 python
KERNELS := $(shell grep -rl --include=*.py '@jit' ltv_mpc sim)

help:  ## list the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  make %-10s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)
	@echo "  make sim takes SCENARIO= SPEED= SEED= DURATION= OUT= OPEN=, as in: make sim SPEED=1 SEED=7"

setup: .venv/compiled  ## make .venv with everything in it; quick when nothing changed

# Compiling is left to the run: the live page's address comes first. A run needs none of what the tests need.
sim: .venv/runnable  ## run the paper's descent as processes over Zenoh
	@$(BIN)/ltv-mpc sim --dashboard $(SIM_OPTIONS)

sim-secure: .venv/installed  ## the same under mTLS and access control, with certificates made for this run
	@certs=$$(mktemp -d) && trap 'rm -rf "$$certs"' EXIT INT TERM && $(BIN)/ltv-mpc certs new "$$certs" >/dev/null \
		&& $(BIN)/ltv-mpc sim $(SIM_OPTIONS) --certs "$$certs"

# Types beside the tests: each leaves a core idle for a while.
check: .venv/installed  ## the inner loop, a minute: lint, types, import contracts, the tests nearest to what changed
	@set -e; $(BIN)/ruff check .; $(BIN)/ruff format --check .; $(BIN)/codespell; \
	$(BIN)/lint-imports >/dev/null || $(BIN)/lint-imports; \
	$(BIN)/mypy & types=$$!; trap 'kill $$types 2>/dev/null' EXIT; \
	$(BIN)/python -P -m tests.nearest; wait $$types; trap - EXIT

# Where Python is told to keep no bytecode, each worker and each process of a test would compile its modules again.
# Types are checked beside the tests, some of which wait.
test: setup  ## lint, spelling, types, import contracts, all tests
	@export PYTHONDONTWRITEBYTECODE=; $(BIN)/python -P -m tests.warm & warm=$$!; $(BIN)/mypy & types=$$!; \
	trap 'kill $$warm $$types 2>/dev/null' EXIT; set -ex; \
	$(BIN)/ruff check .; \
	$(BIN)/ruff format --check .; \
	$(BIN)/codespell; \
	$(BIN)/lint-imports; \
	wait $$warm; \
	$(BIN)/pytest -q -n 3 --dist loadfile --no-loadscope-reorder --durations=15; \
	wait $$types; trap - EXIT

figures: setup  ## the paper's figures and tables: docs/figures/, docs/paper.md; README's picture
	$(BIN)/python -m benchmarks.paper

bench: setup .venv/bench  ## tables of the README: errors over 20 seeds, latency of a cycle, other tools beside it
	$(BIN)/python -m benchmarks.descents
	$(BIN)/ltv-mpc profile
	$(BIN)/python -m benchmarks.peers

fuzz: setup  ## a million damaged frames and files at every decoder and reader
	$(BIN)/python -m benchmarks.fuzz --frames 1000000

docs: .venv/docs  ## the site in build/docs, from docs/ and the docstrings; every warning an error
	rm -rf build/docs
	$(BIN)/python -P -m sphinx -W --keep-going -E -q -b html -d build/doctrees docs build/docs
	@echo build/docs/index.html

package: .venv/installed  ## the wheel in dist/, tried in empty environments, a bare Debian and for arm64
	$(BIN)/python -m tests.package.trial
	BARE_DEBIAN=1 $(BIN)/pytest -q tests/package/test_containerfile.py

# The wheel gets its version before the tag exists; the tag comes last, when everything has passed.
release: setup  ## check VERSION and changelog, run test, docs and package, and tag; nothing is uploaded
	$(BIN)/python -P .ci/release.py check '$(VERSION)'
	$(MAKE) test docs
	rm -rf dist
	SETUPTOOLS_SCM_PRETEND_VERSION='$(VERSION)' $(MAKE) package
	$(BIN)/python -P .ci/release.py tag '$(VERSION)'

lock: .venv/made  ## requirements.lock: the newest versions that pyproject.toml allows, with the hashes of their files
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check 'uv>=0.9'
	@$(BIN)/python .ci/install.py --lock

protocol: setup  ## docs/protocol.md, docs/schemas/ and the drawings of docs/architecture.md, from the code
	PYTHONPATH=. $(BIN)/python -P docs/extensions/protocol_page.py
	PYTHONPATH=. $(BIN)/python -P docs/extensions/drawings.py

mutants: setup .venv/mutation  ## flip the sign of every term, one at a time: a test must fail for each; FILES= for some
	@$(BIN)/python -m tests.mutation.run $(FILES)

clean:  ## remove .venv and caches; runs/ stays
	rm -rf .venv .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache build dist *.egg-info
	find ltv_mpc sim services tests -type d -name __pycache__ -prune -exec rm -rf {} +

.venv/made:
	@for python in $(CANDIDATES); do \
		if $$python -c '$(FITS)' >/dev/null 2>&1; then \
			echo "making .venv with $$($$python --version)"; \
			rm -rf .venv && $$python -m venv .venv && touch $@ && exit 0; \
			echo "$$python -m venv .venv failed"; exit 1; \
		fi; \
	done; \
	echo "No usable Python: version 3.11, 3.12 or 3.13 with venv and ensurepip is needed." >&2; \
	for python in $(CANDIDATES); do \
		if $$python --version >/dev/null 2>&1 && ! $$python -c 'import ensurepip' >/dev/null 2>&1; then \
			echo "$$python is here but lacks ensurepip. On Debian and Ubuntu: apt-get install python3-venv" >&2; exit 1; \
		fi; \
	done; \
	echo "On Debian and Ubuntu: apt-get install python3 python3-venv" >&2; exit 1

.venv/runnable: .venv/made pyproject.toml requirements.lock
	@$(BIN)/python .ci/install.py viz
	@touch $@

.venv/installed: .venv/runnable
	@$(BIN)/python .ci/install.py viz dev
	@touch $@

# Into .venv itself: what is compared has the same Python, numpy and solvers, and the kernels are compiled already.
.venv/bench: .venv/installed
	@$(BIN)/python .ci/install.py bench
	@touch $@

.venv/docs: .venv/installed
	@$(BIN)/python .ci/install.py docs
	@touch $@

.venv/mutation: .venv/installed
	@$(BIN)/python .ci/install.py mutation
	@touch $@

.venv/compiled: .venv/installed $(KERNELS)
	@$(BIN)/python -P -m services.tools.compile_cache descent
	@touch $@
