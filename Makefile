# yamsim: `make help` lists the targets. All of them work without a terminal, and set up what they need.

# pytest's further options, for example: make test PYTEST_ARGS="-k overlay"
PYTEST_ARGS ?=
# uv's further options, for example: make lock LOCK_ARGS=--upgrade
LOCK_ARGS ?=
UV ?= uv

VENV := .venv
PYTHON_BIN := $(VENV)/bin/python
YAMSIM := $(VENV)/bin/yamsim
READY := $(VENV)/.ready
READY_DEV := $(VENV)/.ready-dev
PIP := $(PYTHON_BIN) -m pip install -q --disable-pip-version-check
DEMO := out/demo
# Two workers more than cores, because tests wait for processes, files and time limits for a quarter of their time.
TEST_WORKERS := $(shell expr $$(getconf _NPROCESSORS_ONLN) + 2)

# Where bytecode is not kept, every process of the tests compiles the package again: a second each.
unexport PYTHONDONTWRITEBYTECODE

.DEFAULT_GOAL := help
.PHONY: help setup setup-dev gl meshes test-programs demo test test-slow test-long test-clients test-clients-heavy test-all golden-update pictures lint type bench bench-fiducials docs build lock clean

help: ## list the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  make %-18s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

setup: $(READY) ## make .venv with the locked versions and this checkout in it (needs Python 3.11+)

# Made anew when the lock or the project's metadata changes. Wheels alone: an sdist would run code that no hash covers.
$(READY): pyproject.toml requirements.lock
	tools/bootstrap.sh $(VENV)
	$(PIP) --require-hashes --only-binary :all: -r requirements.lock
	$(PIP) --no-deps --no-build-isolation --editable .
	@touch $@

# Tests also need the rarer extras, Ray among them, which take longer to install than all the rest.
$(READY_DEV): $(READY) requirements-dev.lock
	$(PIP) --require-hashes --only-binary :all: -r requirements-dev.lock
	@touch $@

setup-dev: $(READY_DEV) ## add what tests and the rarer extras need

gl: setup
	@tools/ensure_gl.sh $(PYTHON_BIN)

# Without meshes everything runs on primitives, so "not to be had" (4) and "not all of them" (6) are no reason to stop.
meshes: setup
	@$(YAMSIM) assets fetch || case $$? in \
	    4|6) echo "The real meshes are not all here: primitives stand in for them." >&2 ;; \
	    *) exit 1 ;; \
	esac

# A test whose program is not to be had says so and is skipped.
test-programs:
	@tools/ensure_test_programs.sh || test $$? -eq 4

demo: gl meshes ## record four episodes into out/demo and summarize them
	$(YAMSIM) record --n 4 --workers 2 --out $(DEMO) --seed 0 $(if $(wildcard $(DEMO)),--resume)
	$(YAMSIM) summarize $(DEMO)
	@echo "Look at $$(find $(DEMO) -name '*.jpg' | LC_ALL=C sort | head -n 1), or all of $(DEMO)/"

test: setup-dev gl meshes ## run the tests, without the slow ones and those that need the internet
	$(PYTHON_BIN) -m pytest -n $(TEST_WORKERS) --dist worksteal -m "not slow and not network and not client and not client_heavy" $(PYTEST_ARGS)

test-slow: setup-dev gl meshes test-programs ## run the rest: the slow ones, and those that need the internet or other programs
	$(PYTHON_BIN) -m pytest -n $(TEST_WORKERS) --dist worksteal -m "(slow or network) and not long and not client and not client_heavy" $(PYTEST_ARGS)

test-long: setup-dev gl meshes test-programs ## run those slow tests that continuous integration leaves out
	$(PYTHON_BIN) -m pytest -n $(TEST_WORKERS) --dist worksteal -m long $(PYTEST_ARGS)

# Each client has an environment of its own in .venv-clients, made once. What was found lies in out/clients.jsonl, from which
# `python -m tests.clients.table` brings the table in docs/clients.md up to date.
test-clients: setup-dev gl meshes ## run programs of others on what yamsim writes: those that install in a minute; some from checkouts, whose variables are in tests/clients/rows.py
	rm -f out/clients.jsonl
	$(PYTHON_BIN) -m pytest -n $(TEST_WORKERS) --dist worksteal -m client $(PYTEST_ARGS)

test-clients-heavy: setup-dev gl meshes ## the same with LeRobot and torch, and with checkouts in $YAMSIM_RAIDEN and $YAMSIM_CHIRAL (gigabytes)
	rm -f out/clients.jsonl
	$(PYTHON_BIN) -m pytest -m client_heavy $(PYTEST_ARGS)

test-all: setup-dev gl meshes test-programs ## run all tests but those of heavy clients
	$(PYTHON_BIN) -m pytest -n $(TEST_WORKERS) --dist worksteal -m "not client_heavy" $(PYTEST_ARGS)

golden-update: setup-dev gl ## make today's pictures the golden ones: look at each before committing
	$(PYTHON_BIN) -m tests.golden.update

# Needed after a change of light, colours or meshes. Pictures of a trained policy and of measurements are made elsewhere.
pictures: setup-dev gl meshes ## draw the rendered pictures of README and docs again: look at each before committing
	$(PYTHON_BIN) -m tools.page_pictures
	$(PYTHON_BIN) -m tools.task_pictures
	$(PYTHON_BIN) -m tools.camera_pictures
	$(PYTHON_BIN) -m tools.kitchen_sheet

lint: setup-dev ## check style and format
	$(PYTHON_BIN) -m ruff check
	$(PYTHON_BIN) -m ruff format --check

type: setup-dev ## check types
	$(PYTHON_BIN) -m mypy

bench: setup-dev gl meshes ## measure speed
	$(PYTHON_BIN) -m tools.bench

bench-fiducials: setup-dev gl ## measure how well boards are located, in photos whose truth is known
	OMP_NUM_THREADS=1 $(PYTHON_BIN) -m tools.bench.fiducials
	OMP_NUM_THREADS=1 $(PYTHON_BIN) -m tools.bench.strangers
	OMP_NUM_THREADS=1 $(PYTHON_BIN) -m tools.bench.intervals

# Every warning is an error: a link to a page, a heading or a file that is not there among them.
docs: setup-dev ## make the documentation's site in out/docs, with all its links checked
	$(PYTHON_BIN) -m tools.reference
	$(PYTHON_BIN) -m sphinx --fail-on-warning --keep-going --nitpicky -q -b html docs out/docs
	@echo "out/docs/index.html"

build: setup ## build wheel and sdist into dist/
	rm -rf dist
	$(PYTHON_BIN) -m hatchling build

# uv reads no configuration and no UV_* index here, so the hashes are those of the public index, for all platforms.
# The rest is compiled under the first lock's versions, so that one environment holds both.
COMPILE = env -u UV_INDEX -u UV_DEFAULT_INDEX -u UV_INDEX_URL -u UV_EXTRA_INDEX_URL -u UV_FIND_LINKS \
    $(UV) pip compile --universal --fork-strategy fewest \
    --generate-hashes --no-config --no-header --no-annotate --no-emit-index-url --no-emit-find-links --quiet $(LOCK_ARGS)

lock: ## renew requirements.lock, requirements-dev.lock and those of clients (needs uv)
	$(COMPILE) pyproject.toml --group build --extra print --extra video --extra view --output-file requirements.lock
	$(COMPILE) pyproject.toml --group dev --all-extras --constraint requirements.lock --output-file requirements-dev.lock
	for file in tests/clients/requirements/*.in; do $(COMPILE) "$$file" --output-file "$${file%.in}.txt" || exit; done

clean: ## remove what make made: .venv, .venv-clients, dist, caches and out/demo, never a dataset of yours
	rm -rf $(VENV) .venv-clients dist build $(DEMO) .hypothesis .mypy_cache .pytest_cache .ruff_cache
	find yamsim_cli tests -name __pycache__ -type d -prune -exec rm -rf {} +
