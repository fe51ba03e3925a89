# mrtask: `make help` lists the targets. The environment in .venv is made when it is missing or when
# pyproject.toml or constraints.txt changed, and left alone otherwise.

EXPERIMENT ?= paper
ARGS ?=
PYTHON ?= $(shell for p in python3.11 python3.12 python3.13 python3; do \
	$$p -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && { echo $$p; break; }; done)

VENV := .venv
BIN := $(VENV)/bin
# Written last: an interrupted installation leaves it out and the next `make` installs again.
STAMP := $(VENV)/.installed
LOG := $(VENV)/install.log
PIP_INSTALL := $(BIN)/python -m pip install --constraint constraints.txt $(PIP_OPTIONS)

.DEFAULT_GOAL := help
.PHONY: help install doctor reproduce test lint bench docs dashboard clean-cache

help:  ## list the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## /{printf "  make %-12s %s\n", $$1, $$2}' $(MAKEFILE_LIST)
	@echo "Variables: EXPERIMENT=paper|smoke, ARGS=\"hydra overrides\", PYTHON=python3.11 (or newer)"

install: $(STAMP)  ## make .venv with the tested versions (3.4 GB)

$(STAMP): pyproject.toml constraints.txt
	@"$(PYTHON)" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || { \
		echo "error: mrtask needs Python 3.11 or newer; found: $$("$(PYTHON)" --version 2>&1 | head -n 1 || echo none)." \
		"Install one and say where: make $(MAKECMDGOALS) PYTHON=/path/to/python3.11" >&2; exit 1; }
	@echo "Installing into $(VENV), once, a few minutes (log: $(LOG))"
	@$(BIN)/python -m pip --version >/dev/null 2>&1 || "$(PYTHON)" -m venv --clear $(VENV)
	@rm -f $(STAMP)
	@{ $(PIP_INSTALL) --upgrade pip setuptools && \
		$(PIP_INSTALL) --no-build-isolation --editable '.[dev,pipeline,ros,s3,sim]'; \
	} >$(LOG) 2>&1 || { tail -n 20 $(LOG) >&2; echo "error: the installation failed; the whole log is in $(LOG)" >&2; exit 1; }
	@touch $(STAMP)

doctor:  ## check this machine and say what to do
	@if [ -x $(BIN)/python ]; then $(BIN)/python -m mrtask.doctor; else "$(PYTHON)" -m mrtask.doctor; fi

reproduce: $(STAMP)  ## run the whole experiment: homes, dataset, training, evaluation, report
	@$(BIN)/python -m pipeline.reproduce experiment=$(EXPERIMENT) $(ARGS)

test: $(STAMP)  ## run the tests, in two processes
	@$(BIN)/python -m pytest --numprocesses 2 --dist loadgroup --no-loadscope-reorder $(ARGS)

lint: $(STAMP)  ## formatting, style, types and layers
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/mypy
	@$(BIN)/lint-imports

bench: $(STAMP)  ## speed and memory of planners, maps and experiments (about ten minutes)
	@for name in planners maps scale; do $(BIN)/python benchmarks/bench_$$name.py || exit 1; done

docs: $(STAMP)  ## build the documentation site into build/site
	@$(BIN)/mkdocs build --strict --quiet $(ARGS)

dashboard: $(STAMP)  ## open MLflow on the runs and the registered models (http://127.0.0.1:5000)
	@MLFLOW_SERVER_ENABLE_JOB_EXECUTION=false $(BIN)/mlflow ui --workers 1 \
		--backend-store-uri sqlite:///$(CURDIR)/outputs/mlflow.db $(ARGS)

clean-cache:  ## remove cached maps, embeddings and compiled kernels
	@$(BIN)/python -m pipeline.store.cache
