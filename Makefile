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
PIP := $(BIN)/python -m pip
EVERYTHING := --constraint constraints.txt --editable '.[dev,pipeline,ros,s3,sim]'
# uv takes a fifth of the time that pip takes. Told nothing itself, it looks where pip is told to; where it fails, pip tries.
told = UV_$(1)="$${UV_$(1):-$${PIP_$(1):-$$($(PIP) config get global.$(2) 2>/dev/null)}}"
UV := $(call told,INDEX_URL,index-url) $(call told,EXTRA_INDEX_URL,extra-index-url) $(call told,FIND_LINKS,find-links) \
	UV_INDEX_STRATEGY=unsafe-best-match \
	$(BIN)/python -m uv pip install --python $(BIN)/python

.DEFAULT_GOAL := help
.PHONY: help install doctor reproduce test lint bench docs dashboard clean-cache

help:  ## list the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## /{printf "  make %-12s %s\n", $$1, $$2}' $(MAKEFILE_LIST)
	@echo "Variables: EXPERIMENT=paper|smoke, ARGS=\"hydra overrides\", PYTHON=python3.11 (or newer)"

install: $(STAMP)  ## make .venv with the tested versions (3 GB)

$(STAMP): pyproject.toml constraints.txt
	@"$(PYTHON)" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || { \
		echo "error: mrtask needs Python 3.11 or newer; found: $$("$(PYTHON)" --version 2>&1 | head -n 1 || echo none)." \
		"Install one and say where: make $(MAKECMDGOALS) PYTHON=/path/to/python3.11" >&2; exit 1; }
	@echo "Installing into $(VENV), once; a minute, or what the download takes (log: $(LOG))"
	@$(BIN)/python -m pip --version >/dev/null 2>&1 || "$(PYTHON)" -m venv --clear $(VENV)
	@rm -f $(STAMP)
	@{ $(PIP) install --constraint constraints.txt --upgrade pip setuptools uv && \
		{ $(UV) $(EVERYTHING) || $(PIP) install --no-build-isolation $(EVERYTHING); }; \
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
	@echo "runs:   http://127.0.0.1:$(PORT)/#/experiments/1/runs?workflowType=machine_learning"
	@echo "models: http://127.0.0.1:$(PORT)/#/models?workflowType=machine_learning"
	@MLFLOW_SERVER_ENABLE_JOB_EXECUTION=false $(BIN)/mlflow ui --workers 1 \
		--backend-store-uri sqlite:///$(CURDIR)/outputs/mlflow.db $(ARGS)

PORT = $(or $(shell echo '$(ARGS)' | sed -n 's/.*--port[= ]*\([0-9]*\).*/\1/p'),5000)

clean-cache:  ## remove the cache, and logs and locks of runs that have ended
	@$(BIN)/python -m pipeline.clean really=true
