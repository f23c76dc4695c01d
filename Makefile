# make demo: from a bare machine to three scored trials. make test: colcon build and colcon test. See README.md.
PYTHON ?= python3
PACKAGES := barn_worlds barn_sim barn_planners barn_metrics barn_eval
VENV := .venv
BIN := $(CURDIR)/$(VENV)/bin
OUT ?= out/demo
export RCUTILS_LOGGING_BUFFERED_STREAM ?= 1
export ROS_AUTOMATIC_DISCOVERY_RANGE ?= LOCALHOST

.PHONY: demo test lint install lock clean
.DELETE_ON_ERROR:

demo: install
	$(BIN)/barn demo --out $(OUT)

test: install lint
	PATH=$(BIN):$$PATH ./tools/colcon_test.sh $(PACKAGES)

lint: install
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy $(PACKAGES)

install: $(VENV)/installed

$(VENV)/requirements: requirements.lock
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -r requirements.lock
	touch $@

$(VENV)/installed: $(VENV)/requirements $(PACKAGES:%=%/setup.py)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-build-isolation --use-pep517 \
		--config-settings editable_mode=compat --no-deps $(PACKAGES:%=-e ./%)
	touch $@

lock:
	uv pip compile --universal --python-version 3.10 --no-header --no-emit-index-url --no-emit-find-links \
		--quiet requirements.in -o requirements.lock

clean:
	rm -rf build install log $(VENV)
