# Run `make` alone for the list of targets.
.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.PHONY: help venv test quick nightly lint types docs pages doctests pytest durations mutants reproduce \
  studies bench ablation scenario lock newest clean

VENV ?= .venv
# What is installed: the pinned versions, each file with its hash.
PACKAGES = -r requirements.lock
JOBS ?= 2
# First interpreter on the path that is new enough; override with `make PYTHON=...`.
PYTHON ?= $(firstword $(foreach name,python3.11 python3 python3.12 python3.13,$(shell \
  $(name) -c 'import sys; sys.version_info >= (3, 11) and print("$(name)")' 2>/dev/null)))
BIN = $(VENV)/bin
STAMP = $(VENV)/.installed

# uv installs the lock file in seconds; where it does not run, pip does the same in a minute. Neither
# compiles files, since most are never imported; the last step compiles what a run imports. A start
# is quick then, also where no bytecode may be written, as in many containers.
UV ?= $(shell uv --version >/dev/null 2>&1 && echo uv)
MAKE_VENV = $(if $(UV),$(UV) venv --quiet --seed --python $(PYTHON),$(PYTHON) -m venv) $(VENV)
INSTALL = $(if $(UV),$(UV) pip install --quiet --python $(BIN)/python,\
  $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile)

# Tests and studies run in several processes: one thread each.
export OMP_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1
export MKL_NUM_THREADS ?= 1
# Sums are rounded in the same order on every x86 machine: those of AVX-512 kernels tell two equally
# good sets of the ideal day at H = 2 apart the other way (docs/reproduction.md).
export OPENBLAS_CORETYPE ?= Haswell
# Several processes import the same files: one compiles, the others read what it wrote.
export PYTHONDONTWRITEBYTECODE =

SPHINX = $(BIN)/sphinx-build -q -W --keep-going

# Each process takes a contiguous part, so that what the tests of a file share is made only once.
PYTEST = $(BIN)/pytest -n $(JOBS) --dist worksteal

help:  ## print this list
	@grep -hE '^[a-z]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/^([a-z]+):.*## /  make \1\t/' | expand -t 18

venv: $(STAMP)  ## create the environment with the pinned versions

$(STAMP): requirements.lock pyproject.toml
	$(if $(PYTHON),,$(error No Python >= 3.11 on the path; give one with PYTHON=...))
	test -x $(BIN)/python || $(MAKE_VENV)
	$(INSTALL) $(PACKAGES)
	$(INSTALL) --no-deps --no-build-isolation -e .
	$(BIN)/python -c "import vppres.cli.commands, vppres.day.simulate, vppres.explain.day, vppres.report.run_folder"
	touch $@

# pytest's last line comes last.
test: $(STAMP)  ## lint, types, documentation, doctests and tests
	@$(MAKE) --no-print-directory -j $(JOBS) -O lint types
	@$(MAKE) --no-print-directory -j $(JOBS) -O pages doctests
	@$(MAKE) --no-print-directory pytest

quick: $(STAMP)  ## lint, types, layers and the quick tests, within a minute
	@$(MAKE) --no-print-directory -j $(JOBS) -O lint types
	$(PYTEST) --quick

nightly: $(STAMP)  ## everything: all cases of all tests, the whole documentation
	@$(MAKE) --no-print-directory -j $(JOBS) -O lint types docs doctests
	$(PYTEST) --nightly --fuzz 1000

lint: $(STAMP)  ## style of all Python files (ruff)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check --quiet .

types: $(STAMP)  ## types of the package (mypy, strict)
	$(BIN)/mypy --num-workers $(JOBS)

docs: $(STAMP)  ## build the documentation into docs/_build; warnings are errors
	$(SPHINX) -b html -n docs docs/_build/html

pages: $(STAMP)  ## check the pages and their links, without the reference of all modules
	$(SPHINX) -b dummy -t pages docs docs/_build/pages

doctests: $(STAMP)  ## the examples of docstrings
	$(BIN)/pytest -q --doctest-modules vppres

pytest: $(STAMP)  ## the tests alone, in JOBS=2 processes
	$(PYTEST)

durations: $(STAMP)  ## measure new tests into tests/durations.csv, from which the choices follow
	$(BIN)/pytest -q --measure

MUTANTS ?= *
mutants: $(STAMP)  ## change the code and see tests fail; MUTANTS='vppres.plant.*' for one room
	$(BIN)/python -m pip install --quiet --disable-pip-version-check "mutmut>=3.8"
	$(BIN)/mutmut run --max-children $(JOBS) "$(MUTANTS)"
	$(BIN)/mutmut export-cicd-stats

reproduce: $(STAMP)  ## run all experiments of the paper and write results/report.html
	$(BIN)/python -m experiments --results results

# `make studies SMALL=1` takes a few days of each: whether all of it runs, in minutes.
SMALL ?=
COUNT = $(if $(SMALL),$(1))

studies: $(STAMP)  ## 500 days of faults, alarms, 50 days beside the baselines, 240 uncertain outages, 200 islands: results/studies
	$(BIN)/python -m experiments.studies.campaign --results results/studies $(call COUNT,--days 4)
	$(BIN)/python -m experiments.studies.alarms --results results/studies $(call COUNT,--days 3)
	$(BIN)/python -m experiments.studies.baselines --results results/studies $(call COUNT,--days 2)
	$(BIN)/python -m experiments.studies.uncertain --results results/studies $(call COUNT,--days 2)
	$(BIN)/python -m experiments.studies.uncertain --part cigre --results results/studies $(call COUNT,--days 2)
	$(BIN)/python -m experiments.studies.uncertain --part wrong --results results/studies $(call COUNT,--days 2)
	$(BIN)/python -m experiments.studies.outage_ceiling --results results/studies $(call COUNT,--days 2)
	$(BIN)/python -m experiments.studies.uncertain --part names --results results/studies $(call COUNT,--days 2)
	$(BIN)/python -m experiments.studies.fairness --results results/studies/fairness $(call COUNT,--weeks 1)
	$(BIN)/python -m experiments.studies.homes --results results/studies $(call COUNT,--days 2)
	$(BIN)/python -m experiments.studies.islands --out results/studies/islands $(call COUNT,--days 2)
	$(BIN)/python -m experiments.studies.precision --results results/studies $(call COUNT,--quick)
	$(BIN)/python -m experiments.studies.answers $(call COUNT,--horizon 0) > results/studies/answers.json
	$(BIN)/python -m experiments.studies.live_days $(call COUNT,--days 1 --fault-days 1 --horizon 0 --sites uk-heatwave-2022) > results/studies/live_days.json

bench: $(STAMP)  ## measure the solving methods into results/bench (up to 45 min)
	$(BIN)/python -m benchmarks

ablation: $(STAMP)  ## what each mechanism of the solver is worth, into docs/_static/benchmarks (hours)
	$(BIN)/python -m benchmarks.ablation --publish

scenario: $(STAMP)  ## rebuild the packaged scenarios
	$(BIN)/python -m data.uk_heatwave_2022.build
	$(BIN)/python -m data.two_outages_cigre_mv.build
	$(BIN)/python -m data.village_hot_week.build

lock: $(STAMP)  ## write requirements.lock anew, keeping pins that still fit (fetches uv)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check uv
	$(BIN)/uv pip compile pyproject.toml --extra dev --universal --python-version 3.11 \
	  --no-emit-index-url --no-emit-find-links --no-annotate --quiet --generate-hashes \
	  --custom-compile-command 'make lock' --output-file requirements.lock

NEWEST = .venv-newest
newest:  ## the tests with the newest versions that pyproject.toml allows, in .venv-newest (at night)
	rm -rf $(NEWEST)
	$(MAKE) --no-print-directory pytest VENV=$(NEWEST) PACKAGES="-e '.[dev]'"

clean:  ## remove what the other targets built, the environment and results excepted
	rm -rf build dist mutants docs/_build docs/generated .pytest_cache .mypy_cache .ruff_cache .hypothesis $(NEWEST)
	find . -path ./$(VENV) -prune -o -name __pycache__ -type d -print | xargs rm -rf
