# `make demo` and `make test` set themselves up in .venv first; the second call finds that done.

VENV := .venv
BIN := $(VENV)/bin
UV := $(BIN)/uv
READY := $(VENV)/.ready
LOCK := .requirements/uv.txt .requirements/main+test.txt
COMPILE = $(UV) pip compile --quiet --universal --python-version 3.12 --python $(BIN)/python \
	--generate-hashes --no-header --no-emit-index-url $(UPGRADE)
# Bytecode is made at once: where the user's settings forbid Python to write it, every start would compile everything anew.
INSTALL = $(UV) pip install --quiet --compile-bytecode --python $(BIN)/python

export UV_PYTHON_DOWNLOADS := never
# Whatever the user's settings: compiling the package and its tests anew takes longer than most commands and tests.
export PYTHONDONTWRITEBYTECODE :=

.PHONY: help setup demo archive-demo test types tests test-fast laws study release-check bench docs data lock clean
.DEFAULT_GOAL := help

help:
	@echo "make demo    fit, sample, diagnose and compare a shipped campaign with a hidden effect"
	@echo "make archive-demo  fit the shipped archive of units and ask what no single unit can answer"
	@echo "make test    style, types and tests"
	@echo "make test-fast  tests that compile no model and search no set-up, below a minute"
	@echo "make laws    the laws over all registered effects and noise components (EFFECT=name: over one)"
	@echo "make study   the long statistical studies (coverage, simulation-based calibration)"
	@echo "make bench   benchmarks"
	@echo "make docs    the documentation site, results/docs/index.html"
	@echo "make release-check  build dist, check it, install the wheel alone and run it"
	@echo "make data    regenerate the shipped synthetic campaigns"
	@echo "make lock    resolve the requirements anew (UPGRADE=--upgrade for the newest)"

setup: $(READY)

demo: $(READY)
	$(BIN)/imubayes demo --out . --replace

# An effect is missing in the shipped archive: diagnose names it.
archive-demo: $(READY)
	$(BIN)/imubayes batch data/unit-archive --model models/accel-channel.toml --out results/unit-archive
	$(BIN)/imubayes batch population results/unit-archive --picture results/unit-archive/population.png
	$(BIN)/imubayes batch drift results/unit-archive --picture results/unit-archive/drift.png
	$(BIN)/imubayes batch diagnose results/unit-archive --picture results/unit-archive/evidence.png

# Types are checked beside the tests: pyright keeps only one core busy.
test: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	@$(MAKE) --no-print-directory -j 2 types tests

types: $(READY)
	$(BIN)/pyright

tests: $(READY)
	$(BIN)/pytest -n 2 --dist loadfile --no-loadscope-reorder

test-fast: $(READY)
	$(BIN)/pytest -n 2 --dist loadfile --no-loadscope-reorder -m "not slow and not compiled"

laws: $(READY)
	$(BIN)/pytest -n 2 -m "slow or not slow" $(if $(EFFECT),-k "$(EFFECT)") tests/conformance

# What the studies print, shares with their binomial intervals, is shown at the end, with those that took longest.
study: $(READY)
	$(BIN)/pytest -n 2 --dist loadfile --no-loadscope-reorder -m slow -rP --durations=40

# What is tested stays in dist.  The long tests as well: the demonstration and the commands of the README, by the wheel.
release-check: $(READY)
	rm -rf dist
	mkdir dist
	BUILT=dist $(BIN)/pytest -m "slow or not slow" tests/release

bench: $(VENV)/.ready-bench
	$(BIN)/python benchmarks/run.py

# Most programs run once: compiling them takes most of the time.
docs: $(VENV)/.ready-docs
	JAX_DISABLE_MOST_OPTIMIZATIONS=1 $(BIN)/python src/docs/build.py

data: $(READY)
	$(BIN)/python data/generators/make_all.py

lock: | $(UV)
	$(COMPILE) .requirements/uv.in -o .requirements/uv.txt
	$(COMPILE) pyproject.toml --extra pdf --extra gradient --extra cluster --extra notebook --extra explore --extra recordings --extra test .requirements/build.in -o .requirements/main+test.txt
	$(COMPILE) pyproject.toml --extra bench -c .requirements/main+test.txt -o .requirements/bench.txt
	$(COMPILE) pyproject.toml --extra docs -c .requirements/main+test.txt -o .requirements/docs.txt

clean:
	rm -rf $(VENV) .cache .pytest_cache .ruff_cache results

# The first interpreter that is new enough and can make an environment.  A name may be there and still not run: pyenv's
# shims fail where the version a folder asks for is not installed.
$(BIN)/python:
	@for python in python3 python3.13 python3.14 python3.12 "$${PYENV_ROOT:-$$HOME/.pyenv}"/versions/*/bin/python; do \
		if "$$python" -c 'import sys; sys.exit(sys.version_info < (3, 12))' 2>/dev/null; then \
			echo "setting up $(VENV) with $$("$$python" --version)"; \
			"$$python" -m venv $(VENV) && exit 0; \
		fi; \
	done; \
	echo "imubayes needs Python 3.12 or newer, and none was found: install one (as python3.13, or with pyenv) and repeat." >&2; \
	exit 2

$(UV): | $(BIN)/python
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r .requirements/uv.txt

$(READY): $(LOCK) pyproject.toml | $(UV)
	@$(UV) pip sync --quiet --compile-bytecode --python $(BIN)/python --require-hashes $(LOCK)
	@$(INSTALL) --no-deps --no-build-isolation --editable .
	@$(BIN)/python -m compileall -q src
	@touch $@

$(VENV)/.ready-bench: .requirements/bench.txt $(READY)
	@$(INSTALL) --require-hashes -r .requirements/bench.txt
	@touch $@

$(VENV)/.ready-docs: .requirements/docs.txt $(READY)
	@$(INSTALL) --require-hashes -r .requirements/docs.txt
	@touch $@
