# `make demo`: install into .venv and run the shipped specs to reports and figures.
# `make test`: style, types, import contracts, tests.
# `make docs`: the site, links checked, into build/docs.
# `make bench`: a table of what commands and methods take. `make growth`: a figure of how it grows.
# `make pages`: pictures of every kind of page, and what html-validate and axe say of them.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
JOBS ?= 2

# Threads make small matrices slower.
export OPENBLAS_NUM_THREADS := 1
export OMP_NUM_THREADS := 1
export RAYON_NUM_THREADS := 1
export PIP_DISABLE_PIP_VERSION_CHECK := 1

.PHONY: demo test lint docs bench growth pages lowest clean

demo: $(VENV)/installed
	$(BIN)/cdobs run specs --out results --jobs $(JOBS)
	@echo "Open results/index.html, or results/<spec>/report.html."

test: lint
	$(BIN)/python -m pytest -n $(JOBS)

lint: $(VENV)/installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports --no-cache

docs: $(VENV)/installed-docs
	$(BIN)/python docs/build.py build/docs
	@echo "Open build/docs/index.html."

bench: $(VENV)/installed-dev
	$(BIN)/python tests/benchmarks/table.py

# How CPU and memory grow with states, corners and runs: build/growth.csv and build/growth.svg.
growth: $(VENV)/installed-dev
	$(BIN)/python tests/benchmarks/growth.py

# Every kind of page at two widths, light, dark and in print: build/pages/pictures. Not a part of `make test`.
pages: $(VENV)/installed-dev
	$(BIN)/python tests/pages/pages.py

# The lowest versions that pyproject.toml allows.
lowest:
	PYTHON=$(PYTHON) tests/lowest_versions.sh

$(VENV)/bin/python:
	$(PYTHON) -c 'import sys; sys.exit("Python 3.11 or newer is needed, this is " + sys.version) if sys.version_info < (3, 11) else 0'
	$(PYTHON) -m venv $(VENV)

$(VENV)/installed: requirements.lock pyproject.toml $(shell find cdobs_cli -type f -not -name '*.pyc') | $(VENV)/bin/python
	$(BIN)/python -m pip install --quiet --requirement requirements.lock
	$(BIN)/python -m pip install --quiet --no-deps .
	@touch $@

# The package itself is installed in place, so that tests see the files that are edited.
$(VENV)/installed-dev: requirements.lock requirements-dev.lock pyproject.toml | $(VENV)/bin/python
	$(BIN)/python -m pip install --quiet --requirement requirements.lock --requirement requirements-dev.lock
	$(BIN)/python -m pip install --quiet --no-deps --editable .
	@touch $@ $(VENV)/installed

$(VENV)/installed-docs: requirements-docs.lock $(VENV)/installed-dev
	$(BIN)/python -m pip install --quiet --requirement requirements.lock --requirement requirements-dev.lock --requirement requirements-docs.lock
	@touch $@

clean:
	rm -rf $(VENV) .lowest results build *.egg-info .mypy_cache .ruff_cache .pytest_cache
