# make watch | table1 | test | lint | notebooks | docs | clean | help
# Everything is installed into .venv, once; the stamp files there say what has been done.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin

# The one command behind `make table1`: evaluates the shipped weights, trains nothing.
# Add flags on the make line: make table1 FLAGS="--episodes 16"
TABLE1 = agility-ref table1 $(FLAGS)
FLAGS ?=

# The policies are small: more threads than one only wait for each other, and for the simulation's.
export OPENBLAS_NUM_THREADS ?= 1
export OMP_NUM_THREADS ?= 1

.DEFAULT_GOAL := help
.PHONY: help watch table1 test lint notebooks docs clean

help:  ## print this list
	@awk -F ':.*## ' '/^[a-z0-9]+:.*## / {printf "  make %-9s %s\n", $$1, $$2}' Makefile

watch: $(VENV)/.installed-viewer  ## let a robot climb in the browser
	$(BIN)/agility-ref watch climb

table1: $(VENV)/.installed  ## evaluate the shipped policies and print Table 1 beside the paper's
	$(BIN)/$(TABLE1)

test: $(VENV)/.installed-test  ## run the tests
	$(BIN)/python -m pytest

lint: $(VENV)/.installed-lint  ## check the style with ruff
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

NOTEBOOKS = $(patsubst tutorials/%.py,notebooks/%.ipynb,$(wildcard tutorials/[0-9]*.py))

notebooks: $(VENV)/.installed-notebooks $(NOTEBOOKS)  ## run the tutorials and write them as notebooks, with their figures

notebooks/%.ipynb: tutorials/%.py | $(VENV)/.installed-notebooks
	mkdir -p $(@D)
	$(BIN)/jupytext --quiet --to ipynb --output $(@D)/.$(@F) $<
	$(BIN)/jupyter nbconvert --log-level WARN --to notebook --execute --inplace --ExecutePreprocessor.timeout=-1 $(@D)/.$(@F)
	mv $(@D)/.$(@F) $@

docs: $(VENV)/.installed-docs  ## build the site in docs/_build/html, warnings as errors, and check its links
	$(BIN)/python -m sphinx --fail-on-warning --keep-going --quiet docs docs/_build/html
	$(BIN)/python docs/links.py docs/_build/html

clean:  ## remove the environment and what tools left behind; keeps runs/ and results/
	rm -rf $(VENV) build dist docs/_build docs/api docs/tutorials *.egg-info .pytest_cache .ruff_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

$(VENV)/bin/python:
	$(PYTHON) -m venv $(VENV)

$(VENV)/.installed: setup.cfg pyproject.toml constraints.txt | $(VENV)/bin/python
	$(BIN)/python -m pip install --quiet -c constraints.txt -e .
	touch $@

$(VENV)/.installed-%: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet -c constraints.txt -e '.[$*]'
	touch $@
