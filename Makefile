# Each target makes .venv first, and updates it only if pyproject.toml, setup.py, the part in C or constraints.txt has
# changed.
#   PYTHON=/path/to/python3.11     the Python that makes .venv
#   PIP_FLAGS="--index-url URL"    further options for every pip install
PYTHON ?= python3.11 python3.10 python3.12 python3.13 python3.14 python3 python
PIP_FLAGS ?=

PY := .venv/bin/python
PIP := $(PY) -m pip --disable-pip-version-check install -qq --constraint constraints.txt $(PIP_FLAGS)
FITS := import ensurepip, sys, venv; sys.exit(sys.version_info < (3, 10))

.PHONY: help setup demo test clean

help:
	@echo "make setup   make .venv with dgrasp and its pinned dependencies"
	@echo "make demo    PD control and the shipped policy on the free set, a short training, replays (about ten minutes)"
	@echo "make test    ruff, mypy and pytest"
	@echo "make clean   remove .venv, builds and caches; keep runs/ and results/"

setup: .venv/.installed

demo: .venv/.installed
	@$(PY) -m dgrasp demo

# One thread per process, because torch's threads in two pytest workers would compete for the cores. The tests of a file
# stay in one worker, because they share slow fixtures. The files run in the order of tests/conftest.py: long ones first.
# Bytecode is kept whatever the environment says, because the tests start many interpreters.
test: .venv/.installed-dev
	$(PY) -m ruff check .
	$(PY) -m mypy
	PYTHONDONTWRITEBYTECODE= OMP_NUM_THREADS=1 $(PY) -m pytest -q -n 2 --dist loadfile --no-loadscope-reorder

clean:
	rm -rf .venv build dist dgrasp.egg-info raisim_like/engines/mujoco/_sliding.* .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -prune -exec rm -rf {} +

.venv/.installed: pyproject.toml setup.py raisim_like/engines/mujoco/sliding.c constraints.txt
	@$(PY) -c 'import pip; $(FITS)' 2>/dev/null || { \
	  for python in $(PYTHON); do \
	    if "$$python" -c '$(FITS)' >/dev/null 2>&1; then \
	      echo "setup: .venv with $$("$$python" --version)"; exec "$$python" -m venv --clear .venv; \
	    fi; \
	  done; \
	  echo "No Python 3.10 or newer with its venv module found (looked at: $(PYTHON)). Install one, or name yours:" \
	       "make $(or $(MAKECMDGOALS),setup) PYTHON=/path/to/python3.11" >&2; \
	  exit 2; }
	@torch=$$(sed -n 's/^torch==//p' constraints.txt); echo "setup: torch $$torch"; \
	if [ "$$(uname -s)" = Linux ] && ! nvidia-smi >/dev/null 2>&1; then \
	  $(PIP) "torch==$$torch+cpu" 2>/dev/null || \
	    echo "setup: no CPU build of torch found; the default build may download gigabytes of CUDA (see PIP_FLAGS)"; \
	fi; \
	$(PIP) torch setuptools mujoco
	@echo "setup: dgrasp and its other dependencies"
	@$(PIP) --no-build-isolation --editable .
	@touch $@

.venv/.installed-dev: .venv/.installed
	@echo "setup: ruff, mypy, pytest and other development tools"
	@$(PIP) --no-build-isolation --editable '.[dev]'
	@touch $@
