# The verbs of the project. `make demo` and `make test` set up everything they need, in either order.
PYTHON ?= python3
BIN := .venv/bin
export OPENBLAS_NUM_THREADS ?= 1

.PHONY: browser extras peers screenshots paper-tables demo test test-slow test-all studies check format bench bench-compare laboratory stories docs pictures lock clean

demo: .venv/run.stamp
	$(BIN)/concord run --driver processes

# A worker for each processor; the tests of a file stay together, in the order of tests/conftest.py.
# The long tests often wait for processes and clocks, so three workers share two processors.
# A worker that dies (pyproject.toml: faulthandler) ends the suite; else its test would be run again.
# Compiled code is kept: else each process of a test would compile concord again, in 0.3 s.
PYTEST := env -u PYTHONDONTWRITEBYTECODE PYTHONPYCACHEPREFIX=$(CURDIR)/build/pycache \
	$(BIN)/python -m pytest --dist loadfile --no-loadscope-reorder --max-worker-restart 0
LONG_WORKERS := $(shell echo $$(( ($$(getconf _NPROCESSORS_ONLN) * 3 + 1) / 2 )))
LONG := slow or zenoh or browser or study

test: .venv/dev.stamp
	$(PYTEST) -n auto -m "not ($(LONG))"
	@echo "make test-slow runs the others: processes, pages, studies, and the dashboard in a browser"

# What the tests of the dashboard need; without it they are skipped, and say so.
browser:
	@command -v chromium >/dev/null || { [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null && \
		{ apt-get update -qq; DEBIAN_FRONTEND=noninteractive \
		apt-get install -y -qq --no-install-recommends chromium fonts-dejavu-core; } \
		>/dev/null 2>&1; } || echo "no browser: the dashboard is not tested in one"

screenshots: .venv/dev.stamp browser
	$(BIN)/python -m docs.screenshots

paper-tables: .venv/dev.stamp
	for paper in meng2025 liu2021 adlukf wac; do $(BIN)/concord reproduce $$paper --out build/papers/$$paper; done
	$(BIN)/python -m docs.paper_tables build/papers/*

test-slow: .venv/dev.stamp
	$(PYTEST) -n $(LONG_WORKERS) -m "($(LONG)) and not study"

# The longest tests: statistics of many runs, whole papers, fits of a car to its drives.
studies: .venv/dev.stamp
	$(PYTEST) -n auto -m study

# The optional parts of concord, and the tools of its developers.
extras: .venv/dev.stamp

# Libraries on JAX beside which `make bench` times many filters: 1 GB, one of them a nightly build.
peers: .venv/dev.stamp
	$(BIN)/pip install --quiet --disable-pip-version-check --require-hashes -r requirements-peers.lock

# Every test but the studies: `make test` first, then the slow ones.
test-all: test test-slow

check: .venv/dev.stamp
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/codespell
	$(BIN)/pyright

format: .venv/dev.stamp
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

bench: .venv/dev.stamp
	$(BIN)/python -m benchmarks --picture docs/performance.png

# What became slower since `make bench` kept BASE (a copy of runs/bench.json).
bench-compare: .venv/dev.stamp
	$(BIN)/python -m benchmarks.compare $(BASE) runs/bench.json

# The developers' laboratory: drawn and killed networks, overload, malformed messages, break-ins.
# One part: `make laboratory PART=mutants ARGS="filters --seed 1"`; docs/simulation_testing.md.
PART ?= drawn lives kills overload fuzz security
laboratory: .venv/dev.stamp
	set -e; for part in $(PART); do $(BIN)/python -m tests.laboratory $$part $(ARGS); done

# Golden transcripts of faults and phases; read the difference before you commit it.
stories: .venv/dev.stamp
	CONCORD_REWRITE=1 $(BIN)/python -m pytest tests/nodes/test_stories.py

# The documentation site, in build/site/index.html; it loads nothing from other addresses.
docs: .venv/dev.stamp
	$(BIN)/python -m sphinx -b html -q -W docs build/site

pictures: .venv/run.stamp
	$(BIN)/python -m docs.picture
	$(BIN)/python -m docs.animation
	$(BIN)/python -m docs.gallery
	$(BIN)/python -m docs.labelled_picture
	$(BIN)/python -m docs.state_diagram

lock:
	uv pip compile pyproject.toml --universal --python-version 3.11 --generate-hashes \
		--no-emit-index-url --no-header --quiet --group build \
		--output-file requirements.lock
	uv pip compile pyproject.toml --universal --python-version 3.11 --generate-hashes \
		--no-emit-index-url --no-header --quiet --group dev \
		--extra convex --extra dask --extra logs --extra secure --extra vehicle \
		--output-file requirements-dev.lock
	uv pip compile pyproject.toml --universal --python-version 3.11 --generate-hashes \
		--no-emit-index-url --no-header --quiet --group peers --constraint requirements-dev.lock \
		--output-file requirements-peers.lock

clean:
	rm -rf .venv build runs

.venv/pyvenv.cfg:
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "concord needs Python 3.11 or newer; set PYTHON=...")'
	$(PYTHON) -m venv .venv

.venv/run.stamp: .venv/pyvenv.cfg requirements.lock pyproject.toml
	$(BIN)/pip install --quiet --disable-pip-version-check --require-hashes -r requirements.lock
	$(BIN)/pip install --quiet --disable-pip-version-check --no-build-isolation --no-deps --editable .
	touch $@

.venv/dev.stamp: .venv/run.stamp requirements-dev.lock
	$(BIN)/pip install --quiet --disable-pip-version-check --require-hashes -r requirements-dev.lock
	touch $@
