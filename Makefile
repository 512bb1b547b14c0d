# Needs Python 3.11 (or later) and make; everything else goes into .venv.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
BENCHES ?= case phantom meshers compression
PORT ?= 8080
OUT ?= out
DATA ?= data

.PHONY: help install install-dev demo serve test coverage test-production lint format bench soak validate docs lock clean

help:
	@echo "make demo      install, run the paper's cup C case through the service, files in $(OUT)/"
	@echo "make serve     install, start the service on http://127.0.0.1:$(PORT)/"
	@echo "make test      install what tests need, lint, type-check, run all tests; those of Debian packages that"
	@echo "               are not there are skipped, or fail where CI is set"
	@echo "make coverage  which lines the tests run: a page in $(OUT)/coverage, and the total"
	@echo "make test-production  those of the service again, on PostgreSQL, redis-server and S3 (ten minutes)"
	@echo "make bench     compare with named peers (minutes)"
	@echo "make soak      200 small cases while processes are killed at random: nothing may be lost (ten minutes)"
	@echo "make validate  verification of the compression, robustness, the paper's cups and figures (an hour)"

install: $(VENV)/.compiled
install-dev: $(VENV)/.installed-dev

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(0 if sys.version_info >= (3, 11) else "tomosim needs Python 3.11 or later; found " + sys.version.split()[0] + ". Name another one: make PYTHON=python3.12 ...")'
	$(PYTHON) -m venv $(VENV)

$(VENV)/.installed: $(BIN)/python requirements.lock pyproject.toml
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
	@touch $@

# Compiled kernels stay beside the sources; what is compiled already takes no time.
$(VENV)/.compiled: $(VENV)/.installed
	$(BIN)/tomosim warm-up
	@touch $@

$(VENV)/.installed-dev: $(VENV)/.installed requirements-dev.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements-dev.lock
	@touch $@

demo: install
	$(BIN)/python -m tomosim.demo --out $(OUT) --data $(DATA) --port $(PORT)

serve: install
	$(BIN)/tomosim serve --data $(DATA) --port $(PORT)

lint: install-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

format: install-dev
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

# What of the production set has no time to wait for make validate: rows, keys, stages and files of whole studies.
PRODUCTION_IN_SHORT := $(addprefix tests/,api/test_api_studies.py api/test_api_idempotency.py api/test_api_retention.py \
	worker/compute/test_supervisor.py)

# Files of tests share the cores: many wait for services most of their time.
PYTEST_OPTIONS := -n auto --maxprocesses 4 --dist loadfile --durations 20 $(if $(CI),--require-services)
PYTEST := $(BIN)/python -m pytest $(PYTEST_OPTIONS)

test: lint
	$(PYTEST) $(PYTEST_ARGS)
	$(if $(PYTEST_ARGS),,$(PYTEST) --production $(PRODUCTION_IN_SHORT))

# Processes that tests start count as well (pyproject.toml).
coverage: install-dev
	$(BIN)/coverage erase
	$(BIN)/coverage run -m pytest $(PYTEST_OPTIONS) $(PYTEST_ARGS)
	$(BIN)/coverage combine --quiet
	$(BIN)/coverage html --quiet --directory $(OUT)/coverage
	$(BIN)/coverage report --sort miss --skip-covered

# The same tests of the service on PostgreSQL, redis-server and S3: all that can tell the difference (tests/conftest.py).
test-production: install-dev
	$(PYTEST) --production $(PYTEST_ARGS) tests/api tests/worker tests/tomosim

$(VENV)/.installed-bench: $(VENV)/.installed-dev requirements-bench.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements-bench.lock
	@touch $@

bench: $(VENV)/.installed-bench
	for name in $(BENCHES); do $(BIN)/python -m bench.$$name || exit 1; done

soak: install-dev
	$(BIN)/python -m bench.soak

validate: install-dev test-production
	cd tests/viewer && npm ci --ignore-scripts --no-audit --no-fund
	$(BIN)/python -m bench.platforms
	$(BIN)/python -m pytest -m sweep tests/test_package.py
	$(BIN)/python -m pytest -m sweep tests/api/dicomweb
	$(BIN)/python -m pytest -m sweep tests/simcore/dicom tests/test_deploy.py tests/worker/compute/test_shared_stages.py
	$(BIN)/python -m bench.verification
	$(BIN)/python -m bench.figure4
	$(BIN)/python -m bench.sweep --runs 200
	$(BIN)/python -m bench.percents
	$(BIN)/python -m bench.paper_cups --data $(DATA)
	$(BIN)/python -m bench.figures --data $(DATA)
	$(BIN)/python -m bench.projection

# Needs uv. Versions and hashes for every platform; no address of any registry.
UV ?= uv
COMPILE = $(UV) pip compile pyproject.toml --universal --python-version 3.11 --generate-hashes \
	--no-header --no-annotate --quiet --all-extras --group build
lock:
	$(COMPILE) --group dev --output-file requirements-dev.lock
	sed -nE 's/^([A-Za-z0-9_.-]+)(\[[^]]*\])?(==[^\\]*)\\$$/\1\3/p' requirements-dev.lock > constraints.tmp
	$(COMPILE) --constraint constraints.tmp --output-file requirements.lock
	$(COMPILE) --group dev --group bench --constraint constraints.tmp --output-file requirements-bench.lock
	rm constraints.tmp

clean:
	rm -rf $(VENV) .mypy_cache .ruff_cache .pytest_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
