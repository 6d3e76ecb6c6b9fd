# Everything here starts from a bare clone: Python 3.11 to 3.13 (with venv) and make are enough.
#   make demo        train on a small task with a scripted judge, and show the result
#   make test        all tests but the slow ones
#   make test-slow   the slow ones
#   make check       ruff, basedpyright, lint-imports: pass or fail
#   make format      let ruff mend what it can
#   make clean       remove what the targets above made; your runs/ stay

.DEFAULT_GOAL := help
.PHONY: help demo test test-slow check format clean
.DELETE_ON_ERROR:

PYTHON ?= python3
BIN := .venv/bin
INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-input -c constraints.txt

# Of all that is installed a fifth is ever imported: that alone is compiled, in a third of the time.
USED = import hiprl.cli.training, hiprl.cli.showing, hiprl.report.figures, gymnasium.envs.mujoco

PARALLEL = -n auto --maxprocesses 4 --dist loadfile

DEMO = $(BIN)/hiprl train InvertedPendulum-v5 --comparisons 12 --store runs/demo.db \
    && $(BIN)/hiprl show --store runs/demo.db

help:
	@sed -n '2,8s/^# *//p' Makefile

demo: .venv/.installed
	@mkdir -p runs
	$(DEMO)
	@echo "Next: $(BIN)/hiprl train HalfCheetah-v5   (learns to run from 30 comparisons; 4 to 15 minutes)"
	@echo "  or: $(BIN)/hiprl teach HalfCheetah-v5   (you compare clips in the browser, and it learns what you want)"

test: .venv/.installed-dev
	$(BIN)/python -m pytest -m "not slow" $(PARALLEL)

test-slow: .venv/.installed-dev
	$(BIN)/python -m pytest -m slow

check: .venv/.installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/basedpyright --pythonpath $(BIN)/python
	$(BIN)/lint-imports --cache-dir .cache/import-linter

format: .venv/.installed-dev
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

clean:
	rm -rf .venv .cache build dist MUJOCO_LOG.TXT
	find src tests -name __pycache__ -prune -exec rm -rf {} +

# Half a .venv is worse than none: it would pass for a whole one the next time.
.venv/.made:
	@for python in $(PYTHON) python3.13 python3.12 python3.11; do \
	    if "$$python" -c 'import sys; sys.exit(not (3, 11) <= sys.version_info < (3, 14))' 2>/dev/null; then \
	        echo "Making .venv with $$("$$python" --version)"; \
	        "$$python" -m venv .venv && touch $@ && exit 0; \
	        rm -rf .venv; \
	        echo "Could not make a virtual environment; on Debian: apt-get install python3-venv" >&2; \
	        exit 1; \
	    fi; \
	done; \
	echo "hiprl needs Python 3.11, 3.12 or 3.13; '$(PYTHON)' says: $$($(PYTHON) --version 2>&1)." >&2; \
	echo "Install one of them, or say where it is: make PYTHON=/path/to/python3.13 $(MAKECMDGOALS)" >&2; \
	exit 1

.venv/.installed: .venv/.made pyproject.toml constraints.txt
	@echo "Installing hiprl into .venv (about 750 MB; a minute or two)"
	@$(INSTALL) --no-compile -e .
	@env -u PYTHONDONTWRITEBYTECODE $(BIN)/python -c '$(USED)'
	@touch $@

.venv/.installed-dev: .venv/.made pyproject.toml constraints.txt
	@echo "Installing hiprl and what its tests and checks need into .venv (about 1 GB; a minute or two)"
	@$(INSTALL) -e '.[dev]'
	@touch .venv/.installed $@
