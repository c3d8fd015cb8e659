# Everything runs in a virtual environment of its own, made on first use.
#
#   make demo ARGS='--duration 2'       arguments for the launcher
#   make test ARGS='test/bag -k writer' arguments for pytest, instead of all tests
#   make test WORKERS=                  one test at a time, its output as it comes with ARGS=-s
#   make demo PYTHON=python3.12         another Python, 3.10 to 3.13
#   make test ROS=kilted                another distribution of ROS 2, in .venv-kilted
#   make venv ROS=kilted UPON=.venv     the same, but what is not of ROS comes from .venv
#   make demo TORCH_INDEX=https://download.pytorch.org/whl/cu130   another build of torch

ROS ?= jazzy
VENV := .venv$(if $(filter-out jazzy,$(ROS)),-$(ROS))
BIN := $(VENV)/bin
ARGS ?=
WORKERS ?= --numprocesses 2
UPON ?=
TORCH_INDEX ?= https://download.pytorch.org/whl/cpu

# The nodes of this machine only; the default of ROS announces them to the subnet.
export ROS_AUTOMATIC_DISCOVERY_RANGE ?= LOCALHOST

FITS := import sys; sys.exit(not (3, 10) <= sys.version_info < (3, 14))
PYTHON ?= $(shell for python in python3.11 python3.12 python3.13 python3 python3.10; do \
	if $$python -c '$(FITS)' 2>/dev/null; then echo $$python; break; fi; done)

VENV_OPTIONS :=
CONSTRAINTS_FILES := constraints.txt constraints-$(ROS).txt
CONSTRAINTS := $(CONSTRAINTS_FILES:%=-c %)
ROS_EXTRA := ros$(if $(filter-out jazzy,$(ROS)),-$(ROS))
DEMO_EXTRAS := [$(ROS_EXTRA),viewer]
TEST_EXTRAS := [$(ROS_EXTRA),test]

# With a sourced ROS installation rclpy comes from there, and so do the numpy and the Python that it
# was built with: no wheels of ROS then, and no constraints, which name another numpy.
ifneq ($(ROS_DISTRO),)
ifeq ($(shell python3 -c 'import rclpy' 2>/dev/null && echo found),found)
PYTHON := python3
VENV_OPTIONS := --system-site-packages
CONSTRAINTS :=
DEMO_EXTRAS := [viewer]
TEST_EXTRAS := [test]
endif
endif

# Only ROS and this package are installed upon another environment, in which pip sees another ROS.
ifneq ($(UPON),)
$(if $(filter $(abspath $(UPON)),$(abspath $(VENV))),$(error UPON: expected another one than $(VENV)))
$(if $(wildcard $(UPON)/bin/python),,$(error UPON: there is no environment in $(UPON)))
PYTHON := $(UPON)/bin/python
UPON_OPTIONS := --no-warn-conflicts
endif

APT_INSTALL := apt-get install --yes --quiet --no-install-recommends
BROWSER_LOG := $(VENV)-browser.log

PIP_INSTALL := $(BIN)/python -m pip --disable-pip-version-check install --quiet $(CONSTRAINTS)
# Without --use-pep517 an older pip calls setup.py, which puts the scripts where colcon wants them.
# In compat mode Python finds the package on its path, also where it starts beside a clone called
# dpc_ros, as ssh does in a home: there it would take that folder for the package.
INSTALL := $(PIP_INSTALL) $(UPON_OPTIONS) --use-pep517 --no-build-isolation \
	--config-settings editable_mode=compat --editable

.PHONY: help demo live test test-long bench venv browser clean
.DEFAULT_GOAL := help

help:
	@echo 'make demo   run the three nodes, record, and show how the body converged'
	@echo 'make live   run the nodes until Ctrl-C, with a web page on which to see and steer the body'
	@echo 'make test   run linters, type checks and all tests'
	@echo 'make test-long   run the tests that are too long for every change, for hours; write docs/results/faults.json and hosts.json'
	@echo 'make bench  measure everything beside its peers; write docs/results/benchmarks.json'
	@echo 'make browser   install Chromium for the tests of pages (Debian and Ubuntu, as root)'
	@echo 'make venv   only install, into $(VENV)'
	@echo 'make clean  remove .venv* and what the tools left (runs/ stays)'

demo: $(VENV)/demo.stamp
	$(BIN)/launcher --config config/demo.yaml $(ARGS)

live: $(VENV)/demo.stamp
	$(BIN)/launcher --config config/live.yaml --viewer --no-record $(ARGS)

test: $(VENV)/test.stamp browser
	$(BIN)/python -m ruff check .
	$(BIN)/python -m ruff format --check .
	$(BIN)/python -m mypy
	$(BIN)/python -m pytest $(WORKERS) $(ARGS)

test-long: $(VENV)/test.stamp
	$(BIN)/python -m pytest -m 'long or faults' --repetitions=50 --ignore=test/integration/hosts \
		--fault-results=docs/results/faults.json $(ARGS)
	$(BIN)/python -m pytest -m 'long or faults' --repetitions=5 test/integration/hosts \
		--fault-results=docs/results/hosts.json $(ARGS)
	$(BIN)/dpc paper tables

bench: $(VENV)/test.stamp
	$(BIN)/python test/benchmarks/run.py $(or $(ARGS),--results docs/results/benchmarks.json)
	$(BIN)/dpc paper tables

venv: $(VENV)/test.stamp

# In which the tests look at pages; where it can't be installed they are skipped, and say so.
browser:
	@command -v chromium chromium-browser google-chrome >/dev/null || { \
		echo 'Installing Chromium …'; \
		test "$$(id -u)" = 0 && export DEBIAN_FRONTEND=noninteractive && \
		{ $(APT_INSTALL) chromium || { apt-get update && $(APT_INSTALL) chromium; }; } \
		>$(BROWSER_LOG) 2>&1; } || echo 'no Chromium: the tests of pages will be skipped'

clean:
	rm -rf .venv .venv-* build dist install log *.egg-info .mypy_cache .pytest_cache .ruff_cache .hypothesis
	find dpc_ros test -name __pycache__ -prune -exec rm -rf {} +

$(VENV)/pyvenv.cfg:
	@test -n '$(PYTHON)' || { echo 'error: expected Python 3.10 to 3.13, found none: install' \
		'python3.11 or name one with PYTHON=' >&2; exit 1; }
	@$(PYTHON) -c '$(FITS)' || { echo 'error: $(PYTHON) is no Python 3.10 to 3.13' >&2; exit 1; }
	@echo 'Making $(VENV) with $(PYTHON) …'
	@$(PYTHON) -m venv --clear $(VENV_OPTIONS) $(VENV) >$(VENV).log 2>&1 || { \
		cat $(VENV).log >&2; rm -rf $(VENV) $(VENV).log; \
		echo 'error: $(PYTHON) cannot make a virtual environment; on Debian and Ubuntu install' \
		'its venv module (apt install python3-venv)' >&2; exit 1; }
	@rm -f $(VENV).log

# The build backend, and torch's CPU build where its index can be reached; else torch comes with the
# rest, from wherever pip finds it.
$(VENV)/base.stamp: $(VENV)/pyvenv.cfg $(CONSTRAINTS_FILES)
	@$(PIP_INSTALL) 'setuptools<80'
ifeq ($(UPON),)
	@echo 'Installing torch …'
	@$(PIP_INSTALL) --no-deps --retries 0 --extra-index-url $(TORCH_INDEX) torch || true
else
	@echo 'Installing ROS 2 $(ROS) upon $(UPON) …'
	@ls -d $(abspath $(UPON))/lib/python3*/site-packages >$(VENV)/upon.pth
	@mv $(VENV)/upon.pth $(VENV)/lib/python3*/site-packages/
	@$(PIP_INSTALL) --no-deps --ignore-installed -r constraints-$(ROS).txt
endif
	@touch $@

$(VENV)/demo.stamp: $(VENV)/base.stamp setup.py setup.cfg
	@echo 'Installing dpc_ros$(DEMO_EXTRAS) …'
	@$(INSTALL) '.$(DEMO_EXTRAS)'
	@touch $@

$(VENV)/test.stamp: $(VENV)/base.stamp setup.py setup.cfg
	@echo 'Installing dpc_ros$(TEST_EXTRAS) …'
	@$(INSTALL) '.$(TEST_EXTRAS)'
	@touch $(VENV)/demo.stamp $@
