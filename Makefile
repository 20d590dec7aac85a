# Run `make` alone for the list of targets.
.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.PHONY: help venv test lint types docs pytest reproduce studies bench scenario lock clean

VENV ?= .venv
JOBS ?= 2
# First interpreter on the path that is new enough; override with `make PYTHON=...`.
PYTHON ?= $(firstword $(foreach name,python3.11 python3 python3.12 python3.13,$(shell \
  $(name) -c 'import sys; sys.version_info >= (3, 11) and print("$(name)")' 2>/dev/null)))
BIN = $(VENV)/bin
STAMP = $(VENV)/.installed

# Tests and studies run in several processes: one thread each.
export OMP_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1
export MKL_NUM_THREADS ?= 1

help:  ## print this list
	@grep -hE '^[a-z]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/^([a-z]+):.*## /  make \1\t/' | expand -t 18

venv: $(STAMP)  ## create the environment with the pinned versions

$(STAMP): requirements.lock pyproject.toml
	$(if $(PYTHON),,$(error No Python >= 3.11 on the path; give one with PYTHON=...))
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -r requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps \
	  --no-build-isolation -e .
	touch $@

test: lint types docs pytest  ## lint, types, documentation, doctests and tests

lint: $(STAMP)  ## style of all Python files (ruff)
	$(BIN)/ruff check .

types: $(STAMP)  ## types of the package (mypy, strict)
	$(BIN)/mypy

docs: $(STAMP)  ## build the documentation into docs/_build; warnings are errors
	$(BIN)/sphinx-build -q -b html -W --keep-going -n docs docs/_build/html

pytest: $(STAMP)  ## doctests and tests alone, in JOBS=2 processes
	$(BIN)/pytest -n $(JOBS)

reproduce: $(STAMP)  ## run all experiments of the paper and write results/report.html
	$(BIN)/python -m experiments --results results

studies: $(STAMP)  ## 500 days of faults, 500 without, alarms, garbage, 50 beside the baselines, 200 islands: results/studies
	$(BIN)/python -m experiments.campaign --results results/studies
	$(BIN)/python -m experiments.quiet_days --results results/studies
	$(BIN)/python -m experiments.alarms --results results/studies
	$(BIN)/python -m experiments.garbage --results results/studies
	$(BIN)/python -m experiments.baselines --results results/studies
	$(BIN)/python -m experiments.islands --out results/studies/islands

bench: $(STAMP)  ## measure the solving methods into results/bench (up to 45 min)
	$(BIN)/python -m benchmarks

scenario: $(STAMP)  ## rebuild the packaged scenarios
	$(BIN)/python -m data.uk_heatwave_2022.build
	$(BIN)/python -m data.two_outages_cigre_mv.build

lock: $(STAMP)  ## write requirements.lock anew, keeping pins that still fit (fetches uv)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check uv
	$(BIN)/uv pip compile pyproject.toml --extra dev --universal --python-version 3.11 \
	  --no-emit-index-url --no-emit-find-links --no-annotate --quiet \
	  --custom-compile-command 'make lock' --output-file requirements.lock

clean:  ## remove what the other targets built, the environment and results excepted
	rm -rf build dist docs/_build docs/generated .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -path ./$(VENV) -prune -o -name __pycache__ -type d -print | xargs rm -rf
