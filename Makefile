# dpbench: make targets. Every target makes its own environment first; nothing but Python 3.11
# (or later) with venv is needed on the machine.

PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
STAMP  := $(VENV)/.dpbench-installed
KERNELS := $(VENV)/.dpbench-kernels
OUT    ?= results/standard
CASADI := build/casadi
ACADOS := build/acados
CORE   := build/core
LOWEST := build/lowest
TEST_TOOLS := hypothesis markdown-it-py packaging pytest pytest-xdist
LOWEST_TESTS := tests/solvers tests/scenario tests/mpc tests/report/page/test_recommendation.py
# Seconds of rounds of each benchmark.
BENCH_S := 1.0
# Of the mutants of `make soak`; all of them take some hours.
SHARE := 1.0
# Tests beside each other, one a core; `alone` are those that need the machine to themselves, looked
# for only in files that name that mark.
SIDE_BY_SIDE := -n 2 --dist worksteal
ALONE := $(shell grep -rl --include='test_*.py' 'mark\.alone' tests)

# One thread for every numerical library: two cores are two benchmark slots, not one fast one.
export OMP_NUM_THREADS := 1
export OPENBLAS_NUM_THREADS := 1
export MKL_NUM_THREADS := 1
# Each of many processes would compile all sources again where the shell forbids to keep that.
export PYTHONDONTWRITEBYTECODE :=

.DEFAULT_GOAL := help
.PHONY: setup environments bench full test test-fast test-core test-lowest test-casadi outdated mutants chaos soak lint docs keys tutorial bench-ci bench-compare vendored report clean clean-results help

setup: $(KERNELS) ## make .venv with all solvers and the development tools

# A third of the modules is ever imported, in any of the environments, and compiled then.
$(STAMP): pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip
	$(BIN)/python -m pip install --quiet --no-compile --constraint constraints.txt --editable '.[solvers,cluster,embedded,fmi,matplotlib,peers,dev,docs]'
	$(BIN)/python hatch_build.py
	touch $(STAMP)

$(KERNELS): $(STAMP)
	$(BIN)/python -m dpbench.cli.compiling
	touch $(KERNELS)

environments: setup $(CORE)/.installed $(LOWEST)/.installed ## make those of test-core and test-lowest too

bench: setup ## run the standard suite (five to twelve minutes) and write its report
	$(BIN)/dpbench run standard --out $(OUT)

full: setup ## run everything at full length with twenty rounds (hours)
	$(BIN)/dpbench run full

test: setup ## run the tests: on both cores, then those that need a quiet machine
	$(BIN)/python -m pytest $(SIDE_BY_SIDE) -m "not alone"
	$(BIN)/python -m pytest -m alone $(ALONE)

test-fast: setup ## run the quick tests, in about a minute
	$(BIN)/python -m pytest $(SIDE_BY_SIDE) -m "not slow and not alone" --hypothesis-profile=quick

test-core: $(CORE)/.installed ## run the quick tests without the extras, in an environment of their own
	$(CORE)/bin/python -m pytest $(SIDE_BY_SIDE) -m "not slow and not alone" --without-extras $(CORE_TESTS)
	$(CORE)/bin/dpbench run smoke --out build/smoke-core --fresh

$(CORE)/.installed: pyproject.toml constraints.txt
	$(PYTHON) -m venv --clear $(CORE)
	$(CORE)/bin/python -m pip install --quiet --no-compile --constraint constraints.txt --editable . $(TEST_TOOLS)
	touch $@

# Old libraries warn of new ones, which is not ours to mend; another Numba has another cache.
test-lowest: $(LOWEST)/.installed ## run the contract and a smoke run with the lowest versions declared
	NUMBA_CACHE_DIR=$(LOWEST)/numba $(LOWEST)/bin/python -m pytest $(SIDE_BY_SIDE) --override-ini filterwarnings= \
	    -m "not slow and not alone" $(LOWEST_TESTS)
	NUMBA_CACHE_DIR=$(LOWEST)/numba $(LOWEST)/bin/dpbench run smoke --out build/smoke-lowest --fresh

$(LOWEST)/.installed: pyproject.toml constraints-lowest.txt
	$(PYTHON) -m venv --clear $(LOWEST)
	$(LOWEST)/bin/python -m pip install --quiet --no-compile --only-binary :all: \
	    --requirement constraints-lowest.txt $(TEST_TOOLS)
	$(LOWEST)/bin/python -m pip install --quiet --no-deps --editable .
	touch $@

# The wheel with the faster BLASFEO brings a reduced casadi of its own, so it stays out of casadi's
# folder and behind it on the path. The second run is HPIPM on the BLASFEO of casadi.
test-casadi: setup ## run the tests of the solvers whose library is an extra (HPIPM, qpOASES)
	$(BIN)/python -m pip install --quiet --no-deps --upgrade --target $(CASADI) 'casadi>=3.7'
	$(BIN)/python -m pip install --quiet --no-deps --upgrade --target $(ACADOS) 'comma-deps-acados>=0.2.2.post92'
	PYTHONPATH=$(CASADI):$(ACADOS) $(BIN)/python -m pytest $(SIDE_BY_SIDE) tests/solvers \
	    tests/bench/run/test_formulations.py::test_exact_solvers -k "hpipm or qpoases"
	DPBENCH_BLASFEO=casadi PYTHONPATH=$(CASADI) $(BIN)/python -m pytest $(SIDE_BY_SIDE) tests/solvers \
	    -k hpipm -m "not slow"

outdated: setup ## list newer releases of the solvers and run the conformance tests with each, OUTDATED=--list to list them alone
	$(BIN)/python -m tests.outdated $(OUTDATED)

# Which file and how many: MUTANTS='dpbench/qp/residuals.py --all'.
mutants: setup ## plant a sample of faults and check that the quick tests find 90 % (some ten minutes)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[mutants]'
	$(BIN)/python -m tests.mutants $(MUTANTS)

# Which: CHAOS='--quick', or names of scenarios.
chaos: setup ## run a small suite under accidents and check its rows (some ten minutes)
	$(BIN)/python -m tests.chaos $(CHAOS)

# How many of 100 000 mutants of each kind, and which kinds: SHARE=0.01 SOAK='--only toml,hulls'.
soak: setup ## read seeded mutants of all files that others may send, SHARE=0.01 for 1 % of them (a minute)
	$(BIN)/python -m tests.soak.run --share $(SHARE) $(SOAK)

# Side by side with the kernels, which it does not need.
lint: $(STAMP) ## ruff, mypy --strict, import layers
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

# What the theme says of its own future is no warning of ours.
docs: setup ## the documentation in build/site; a warning or a dead link is an error
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

keys: setup ## write the pages docs/reference/*.md on the keys of vessels, scenarios and suites
	PYTHONPATH=docs $(BIN)/python -m sitegen.toml_keys

tutorial: setup ## run docs/tutorial.ipynb and store it with its outputs
	PYTHONPATH=docs $(BIN)/python -m sitegen.notebook

bench-ci: setup ## pytest-benchmark of the parts; writes results/bench-ci.json
	mkdir -p results
	$(BIN)/python -m pytest benchmarks --override-ini addopts='--import-mode=importlib' \
	    --benchmark-max-time=$(BENCH_S) \
	    --benchmark-json=results/bench-ci.json --benchmark-columns=min,median,max,rounds

bench-compare: setup ## compare it with this machine's baseline, RENEW=--renew to replace that
	test -s results/bench-ci.json || $(MAKE) bench-ci
	$(BIN)/python -m dpbench.ci.gate results/bench-ci.json results/baseline $(RENEW)

vendored: setup ## fetch the scripts of others that the page carries, by vendor/vendored.json (npm)
	$(BIN)/python -m dpbench.report.page.vendored

report: setup ## write the report of the last standard run again
	$(BIN)/dpbench report $(OUT)

clean: ## remove the environment and all caches; results stay
	rm -rf $(VENV) build dist *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis \
	    .benchmarks .import_linter_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

clean-results: ## remove all results but those of the repository and the baselines
	find results -mindepth 1 -maxdepth 1 ! -name reference ! -name community ! -name baseline -exec rm -rf {} +

help: ## show this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "  %-14s %s\n", $$1, $$2}' $(MAKEFILE_LIST)
