# hpac_gym: 'make' or 'make help' lists the targets.

VENV := .venv
BIN := $(VENV)/$(if $(filter Windows_NT,$(OS)),Scripts,bin)
# The virtual environment keeps its Python until another one is named; PyBullet has wheels for 3.11 alone.
PYTHON ?= $(or $(wildcard $(BIN)/python),python3.11)
PIP := $(BIN)/python -m pip install -qq --disable-pip-version-check --no-input --constraint constraints.txt
# One process a core, but no more than four: some tests start processes of their own.
PYTEST_ARGS ?= --numprocesses auto --maxprocesses 4 --dist worksteal
DEMO_ARGS ?=
RELEASE_ARGS ?=

# One name for everything that decides what set-up installs, so that set-up runs again exactly when that changes.
SETUP_ID := $(shell { $(PYTHON) --version; cat pyproject.toml constraints.txt; grep PIP Makefile; } 2>&1 | cksum | tr ' ' '-')
STAMP := $(VENV)/.setup-$(SETUP_ID)

# Each expands to nothing, or ends make with one line and exit status 2.
need-python = $(if $(shell $(PYTHON) -c 'import sys, venv; print((3, 11) <= sys.version_info[:2] <= (3, 14))' 2>/dev/null | grep True),,$(error \
	hpac_gym needs Python 3.11 to 3.14 with venv and '$(PYTHON)' is none: install it, or name one with PYTHON=))
need-compiler = $(if $(shell command -v $(firstword $(CC))),,$(error \
	no C compiler '$(firstword $(CC))' found: install one such as gcc, or name one with CC=))

.DEFAULT_GOAL := help
.PHONY: help setup compiler firmware test test-all test-lerobot demo bench generate docs wheel release lint size clean
MAKEFLAGS += --no-print-directory
# Some two hundred processes of the tests share compiled modules, even where the user has none written.
unexport PYTHONDONTWRITEBYTECODE

help: ## list the targets
	@sed -n 's/^\([a-z-]*\):.*## \(.*\)/\1|\2/p' Makefile | while IFS='|' read -r name text; do printf '  %-10s %s\n' "$$name" "$$text"; done

setup: $(STAMP) ## make .venv and install every pinned dependency and the project

$(STAMP):
	$(need-python)
	@test "$$($(BIN)/python --version 2>&1)" = "$$($(PYTHON) --version)" || \
		{ echo "Set-up: virtual environment in $(VENV)"; $(PYTHON) -m venv --clear $(VENV); }
	@echo "Set-up: PyTorch (the first time takes some minutes)"
	@$(PIP) torch==2.13.0
	@echo "Set-up: the other dependencies and the project"
	@$(PIP) hatchling
	@$(PIP) --no-build-isolation --editable '.[train,sbx,study,camera,grasps,objects,video,onnx,data,nodes,docs,test]'
	@rm -f $(VENV)/.setup-* && touch $@

compiler:
	$(need-compiler)
	@:

firmware: compiler ## build the firmware core and its host board
	@$(MAKE) -C firmware CC='$(CC)'

test: compiler setup firmware ## pass all the tests but the slow ones
	@echo "The firmware's checks run beside the other tests; their verdict, or all that they say if they fail, stands at the end."
	@$(MAKE) -C firmware CC='$(CC)' check >firmware/build/check.log 2>&1 & checks=$$!; \
	$(BIN)/python -m pytest $(PYTEST_ARGS); tested=$$?; \
	wait $$checks; checked=$$?; log=firmware/build/check.log; \
	if [ $$checked = 0 ]; then tail -n 1 $$log; else cat $$log; fi; \
	exit $$((tested || checked))

test-all: compiler setup firmware ## pass all the tests, slow ones and firmware mutants too
	@$(MAKE) -C firmware CC='$(CC)' check-all
	@$(BIN)/python -m pytest -m '' $(PYTEST_ARGS)

test-lerobot: compiler firmware ## pass the tests that need lerobot, in .venv-lerobot with Python 3.12 (gigabytes of PyTorch)
	@python3.12 -c 'import venv' 2>/dev/null || { echo "lerobot needs Python 3.12, and 'python3.12' does not run here: install it"; exit 2; }
	@test -d .venv-lerobot || python3.12 -m venv .venv-lerobot
	@.venv-lerobot/bin/python -m pip install -qq --disable-pip-version-check --no-input --editable '.[lerobot,test]' --editable integrations/lerobot
	@.venv-lerobot/bin/python -m pytest tests/evaluation/lerobot_round_trip.py
	@cd integrations/lerobot && ../../.venv-lerobot/bin/python -m pytest --rootdir=. tests

demo: compiler setup firmware ## train, evaluate and replay over the wire into runs/demo (under 20 minutes)
	@$(BIN)/python -m agents.demo --out runs/demo $(DEMO_ARGS)

bench: setup ## measure the speed of the environments, of the model and of the command line
	@$(BIN)/python -m tools.env_bench
	@$(BIN)/python -m tools.bench

generate: setup ## rewrite every generated file from its data
	@$(BIN)/python -m tools.generate

wheel: setup ## build dist/*.whl
	@$(BIN)/python -m pip wheel . --quiet --disable-pip-version-check --no-deps --no-build-isolation --wheel-dir dist
	@ls dist/*.whl

release: compiler setup ## test, build and try a release, and tag it if all of that passed
	@$(BIN)/python -m tools.release $(RELEASE_ARGS)

docs: setup ## build the site in docs/_build/html; a warning is an error
	@$(BIN)/python -m sphinx --fail-on-warning --keep-going -q docs docs/_build/html
	@echo "docs/_build/html/index.html"

lint: setup ## check the format, the style and the types of the Python code
	@$(BIN)/ruff format --check --quiet . || { echo "not formatted: run 'ruff format' ($(BIN)/ruff)"; exit 1; }
	@$(BIN)/ruff check --quiet .
	@$(BIN)/python -m tools.style $$(git ls-files '*.py')
	@$(BIN)/mypy --no-error-summary

size: setup ## count files, statements and lines by folder
	@$(BIN)/python -m tools.size

clean: ## remove what was built, but neither .venv nor runs
	@rm -rf build dist docs/_build docs/_reference docs/measured.md .pytest_cache .hypothesis .ruff_cache .mypy_cache
	@find . -name __pycache__ -not -path './$(VENV)/*' -prune -exec rm -rf {} +
	@$(MAKE) -C firmware clean
