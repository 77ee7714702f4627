# `make demo` and `make test` do all their own set-up in .venv; everything else is for those who work on slidectl.

PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
STAMP  := $(VENV)/.installed

.PHONY: docs help demo test quick units most fuzz soak lint types bench pictures examples wheel clean
.DEFAULT_GOAL := help

help:  ## this list
	@grep -hE '^[a-z]+:.*##' $(MAKEFILE_LIST) | sed -E 's/^([a-z]+):.*## /\1|/' | awk -F'|' '{printf "make %-9s %s\n", $$1, $$2}'

$(STAMP): pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "slidectl needs Python 3.11 or newer; give one with: make PYTHON=/path/to/python3.11 $(MAKECMDGOALS)" >&2; exit 1; }
	@$(PYTHON) -m venv --clear $(VENV) || { echo "python's venv module does not work (on Debian: apt install python3-venv)" >&2; exit 1; }
	@echo "installing slidectl into $(VENV): downloads about 300 MB, takes 1.1 GB of disk and some minutes"
	@$(BIN)/python -m pip install --disable-pip-version-check --editable '.[dev]'
	@$(BIN)/python -m compileall -q slidectl
	@touch $@

demo: $(STAMP)  ## start a daemon, slide up, to the middle and down, show it moving, stop
	@$(BIN)/python examples/demo.py

test: $(STAMP)  ## all tests, four at a time: most wait for processes
	@$(BIN)/python -m pytest -n 4 --dist loadfile $(ARGS)

quick: lint types units  ## lint, types, and the tests that are not slow and start no processes, in a minute

units: $(STAMP)  ## the tests of quick alone; with another Python: PYTHON=python3.13 VENV=.venv-3.13
	@$(BIN)/python -m pytest -n 2 --dist loadfile --hypothesis-profile quick -m "not slow and not process" $(ARGS)

most: $(STAMP)  ## the tests that are not slow
	@$(BIN)/python -m pytest -n 4 --dist loadfile -m "not slow" $(ARGS)

fuzz: $(STAMP)  ## attack a daemon and the readers of files for 2 to 3 minutes, with another seed each time
	@$(BIN)/python tests/fuzz/fuzz.py $(ARGS)

soak: $(STAMP)  ## five simulated hours with all gateways, page, recorder and readers; ARGS='--hours H --factor F'
	@$(BIN)/python tests/fuzz/soak.py $(ARGS)

lint: $(STAMP)  ## ruff: rules and formatting; vulture: what only tests call
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@found="$$($(BIN)/vulture)" || [ $$? -eq 3 ] || exit 1; \
	! printf '%s' "$$found" | grep -v "unused attribute" || { \
	  echo "remove what nothing calls; scripts/called_from_outside.py names what others call" >&2; exit 1; \
	}  # attributes that are set are read by libraries

types: $(STAMP)  ## mypy, strict
	@$(BIN)/mypy

bench: $(STAMP)  ## measure; prints a table and writes benchmarks/results/*.json
	@$(BIN)/python -m benchmarks $(ARGS)

pictures: $(STAMP)  ## make the pictures of README.md and docs/ anew; needs Chromium
	@$(BIN)/python scripts/pictures.py

examples: $(STAMP)  ## run every script and every scenario of examples/
	@PATH="$(CURDIR)/$(BIN):$$PATH" bash examples/run_all.sh
	@$(BIN)/slidectl test examples/scenarios

docs: $(STAMP)  ## the documentation as a site, in build/site; checks its links and anchors
	@$(BIN)/python scripts/build_site.py

wheel: $(STAMP)  ## build the wheel and try it in a bare environment
	@bash scripts/try_wheel.sh

clean:  ## remove what the other targets made
	rm -rf $(VENV) .venv-3* .cache build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
