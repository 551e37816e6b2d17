# Two commands on a fresh machine with Python 3.11+ and make:
#   make demo   sets up, scans the tetrapod, says where the report is
#   make test   sets up, runs every check
# and make quick, the checks that take less than a minute; make docs, which builds the docs site into
# build/docs; make coverage; make bench
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready

.PHONY: setup warm demo test quick lint types check coverage docs bench clean

setup: $(READY)

$(READY): pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; sys.exit(0 if sys.version_info >= (3, 11) else "insonify needs Python 3.11 or later; choose one with: make PYTHON=python3.12")'
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev]'
	touch $@

warm: setup
	$(BIN)/insonify warm-up --quiet

demo: warm
	$(BIN)/insonify scan tetrapod

test: lint types check

quick: lint warm
	$(BIN)/pytest --quiet -n logical -m "not slow"

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: setup
	$(BIN)/mypy

check: warm
	$(BIN)/pytest -n logical

# Kernels run compiled, where no line is seen to run, so they are left out of the count.
coverage: export COVERAGE_FILE = $(CURDIR)/build/coverage/data
coverage: setup
	$(BIN)/coverage erase
	$(BIN)/coverage run -m pytest -n logical
	$(BIN)/coverage combine --quiet
	$(BIN)/coverage html --quiet
	$(BIN)/coverage report
	@echo "Lines not run: build/coverage/html/index.html"

docs: setup
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict
	@echo "Docs: build/docs/index.html"

bench: setup
	$(BIN)/python -m benchmarks
	$(BIN)/python -m benchmarks.simulator

clean:
	rm -rf $(VENV) build insonify-runs
