# Two commands matter: `make figures` and `make test`; each sets up .venv by itself. `make help` lists the rest.
SHELL := /bin/bash

PYTHON ?= python3
PY := .venv/bin/python
PYTEST_JOBS := -n logical --maxprocesses 4 --dist worksteal
export PYTHONHASHSEED := 0
# What decides the last digits: threads, kernels of NumPy and linear algebra.
$(foreach variable,$(shell $(PYTHON) -IS railrepro/numerics.py),$(eval export $(variable)))
export SOURCE_DATE_EPOCH := 1700000000
export JUPYTER_CONFIG_DIR := $(CURDIR)/build/jupyter/config
export JUPYTER_DATA_DIR := $(CURDIR)/build/jupyter/data
# Without stored byte code each of some hundred processes would compile the libraries that it imports, for seconds.
unexport JUPYTER_PATH PYTHONPATH PYTHONDONTWRITEBYTECODE
# A user's settings of pip and uv say where packages come from; how other packages are installed does not reach .venv.
SOURCES := %_INDEX %_INDEX_URL %_CACHE_DIR %_CERT %_CERTS %_TLS %_PROXY %_HOST %_OFFLINE %_TIMEOUT %_RETRIES \
  %_FIND_LINKS %_CONFIG_FILE %_KEYRING_PROVIDER %_LINK_MODE UV_INDEX_% UV_CONCURRENT_%
unexport $(filter-out $(SOURCES),$(filter PIP_% UV_%,$(.VARIABLES)))
export PIP_USER := 0
# uv's cache, where the home cannot be written, as that of a user of a container or of a laboratory.
ifndef UV_CACHE_DIR
  ifneq ($(shell d="$${XDG_CACHE_HOME:-$$HOME/.cache}/uv"; mkdir -p "$$d" 2>/dev/null; test -w "$$d" && echo yes),yes)
    export UV_CACHE_DIR := $(CURDIR)/build/uv
  endif
endif

# What make starts ends with it, also when only make is killed.
ifndef RAILREPRO_LEADER
  export RAILREPRO_LEADER := $(shell echo $$PPID)
endif

# The folder is part of it: a moved or copied clone installs itself again.
LOCK_HASH := $(shell (pwd; cat environment.lock pyproject.toml) | cksum | tr -cd 0-9)
VENV := .venv/ready-$(LOCK_HASH)
# Other groups of the lock come on top, where they are needed.
READY = .venv/ready-$(1)-$(LOCK_HASH)
GROUP = awk '/^\# group:/ {on = $$3 ~ "^($(1))$$"} on' environment.lock
INSTALL = $(call GROUP,$(1)) | .venv/bin/uv pip install -q --python $(PY) --require-hashes --no-deps -r -
.PHONY: help setup figures check test test-slow test-extras faults sanitize lab score leaderboard tune report verify bench study release html live lock strip clean distclean

help:  ## list the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "%-12s%s\n", $$1, $$2}' Makefile | sort
	@echo "figNN       one figure with what it needs: fig06 is that of the paper, fig0601 the first other one of chapter 06"

setup: $(VENV)  ## set up the environment in .venv

figures: $(VENV)  ## run the notebooks whose inputs changed; writes data/ and figures/; VEHICLE=mine.toml tries 00 to 09 on your own car
	@$(PY) -m railrepro $(if $(VEHICLE),drive "$(VEHICLE)",figures)

fig%: $(VENV)
	@$(PY) -m railrepro figures $@

check: $(VENV)  ## lint, format, types, order of imports
	$(PY) -m ruff check
	$(PY) -m ruff format --check
	$(PY) -m mypy
	.venv/bin/lint-imports --no-logo --no-cache

test: $(VENV)  ## run the tests, the notebooks with small parameters among them
	$(PY) -m pytest -m "not slow" $(PYTEST_JOBS)

test-slow: $(VENV)  ## run the tests that take minutes
	$(PY) -m pytest -m slow $(PYTEST_JOBS)

test-extras: $(call READY,bench) $(call READY,compiler)  ## install two groups and run their tests: Exudyn, live page, FMUs of other platforms
	$(PY) -m pytest -m "not slow" $(PYTEST_JOBS) tests/validation tests/export/test_live.py tests/export/test_fmu.py

# Without optimisation compilers are fast and leave no access out. PYTHONMALLOC: all memory is that of the sanitizer.
SANITIZERS := -O0 -g -ffp-contract=off -fsanitize=address,undefined,bounds-strict,float-cast-overflow -fno-sanitize-recover=all
sanitize: $(VENV)  ## public calls under the address and undefined-behaviour sanitizers of gcc
	CC=gcc RAILREPRO_CFLAGS="$(SANITIZERS)" PYTHONMALLOC=malloc ASAN_OPTIONS=detect_leaks=0 \
	  LD_PRELOAD="$$(gcc -print-file-name=libasan.so) $$(gcc -print-file-name=libstdc++.so)" $(PY) tests/sanitize.py

faults: $(VENV)  ## fault injection in a chain of one notebook: kills and Ctrl-C
	$(PY) -m pytest -m slow tests/evidence/test_faults.py

lab: $(VENV)  ## open the chapters in JupyterLab; LAB="--no-browser --ip=0.0.0.0" passes options on, as in a container
	@mkdir -p $(JUPYTER_CONFIG_DIR)/labconfig
	@cp .binder/lab.json $(JUPYTER_CONFIG_DIR)/labconfig/default_setting_overrides.json
	$(PY) -m jupyterlab --notebook-dir=. --LabApp.default_url="/lab/tree/notebooks/00_first_run.ipynb?file-browser-path=/" \
	  --LanguageServerManager.autodetect=False $(if $(filter 0,$(shell id -u)),--allow-root) $(LAB)

score: $(VENV)  ## score a controller: CONTROLLER=path/to/mine.py or a registered name, SEED=n another random seed, RANKED=1 its entry for the leaderboard
	$(PY) -m railrepro score "$(or $(CONTROLLER),examples/pid.py)" $(if $(SEED),--seed $(SEED)) $(if $(RANKED),--ranked)

# Commands of the library under their own names.
leaderboard: $(VENV)  ## score all registered controllers and those of examples/ (long)
tune: $(VENV)  ## tune all controllers in all settings by particle swarm (long, resumes); figures follow
verify: $(VENV)  ## rerun everything and compare with the committed numbers
report: figures  ## write REPLICATION.md from the measured results
release: figures  ## the committed state and the runs of Figs. 6 to 9 as data for other programs: build/railrepro-VERSION.tar.gz
html: $(call READY,book)  ## the book in build/html: executed notebooks (runs those that are missing), report, library reference
live: $(call READY,compiler)  ## the car in a browser: build/live/index.html, one file that needs no network
leaderboard tune verify report release html live:
	$(PY) -m railrepro $@

bench: $(VENV)  ## measure speed, as ratios in one run; with the group `bench` also the car in Exudyn (half an hour)
	$(PY) -m railrepro bench
	$(PY) tests/validation/peers.py
	$(PY) tests/validation/quadratic_problems.py
	$(PY) tests/validation/published.py
	@if $(PY) -c "import exudyn" 2>/dev/null; then $(PY) tests/validation/second_opinion.py && \
	  $(PY) tests/validation/second_plant.py; else echo "no second car: \`make test-extras\` installs Exudyn"; fi

study: $(VENV)  ## nominal probes, robustness, margins, loop (long, resumes)
	for name in probe calibrated robustness margins loop; do $(PY) -m railrepro $$name || exit 1; done

strip: $(VENV)  ## remove outputs from the notebooks
	.venv/bin/nbstripout --keep-id --extra-keys "metadata.vscode metadata.widgets metadata.language_info.version" notebooks/*.ipynb

lock:  ## renew environment.lock from pyproject.toml; pins stay, but for those of NEWER="numpy scipy" or NEWER=--upgrade
	@.ci/lock $(NEWER)

clean:  ## remove executed notebooks, stamps and reports of runs
	rm -rf build/stamps build/notebooks build/book build/html build/verify

distclean: clean  ## also remove the environment, compiled code and stored results
	rm -rf build .venv

$(VENV): environment.lock pyproject.toml
	@$(PYTHON) -c 'import sys; (3,11) <= sys.version_info[:2] < (3,15) or sys.exit("Python 3.11 to 3.14 is needed, $(PYTHON) is " + sys.version.split()[0])'
	@echo "setting up .venv (once, about a minute)"
	@rm -f .venv/ready-*
	@test -x .venv/bin/uv || $(PYTHON) -m venv --clear .venv
	@$(call GROUP,environment) | awk '/^uv==/{f=1} f{print} f&&!/\\$$/{exit}' > .venv/uv.txt
	@$(PY) -m pip install -q --disable-pip-version-check --require-hashes --no-deps -r .venv/uv.txt
	@$(call GROUP,notebooks|environment) | .venv/bin/uv pip sync -q --python $(PY) --require-hashes -
	@.venv/bin/uv pip install -q --python $(PY) --no-deps --no-build-isolation --no-index -e .
	@command -v "$${CC:-cc}" >/dev/null || command -v gcc >/dev/null || { \
	  echo "there is no C compiler (CC, cc, gcc): installing that of the package ziglang, 400 MB"; $(call INSTALL,compiler); } \
	  || { echo "it cannot be had, and without a C compiler nothing runs"; exit 1; }
	@touch $@

$(call READY,%): | $(VENV)
	@$(call INSTALL,$*)
	@touch $@
