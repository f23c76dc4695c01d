# make demo: from a bare machine to three scored trials. make test: colcon build and colcon test. make extras: what the
# difficulty model's training, the Gymnasium environment and clusters need. See README.md.
PYTHON ?= python3
PACKAGES := barn_worlds barn_sim barn_planners barn_metrics barn_eval
VENV := .venv
BIN := $(CURDIR)/$(VENV)/bin
OUT ?= out/demo
export RCUTILS_LOGGING_BUFFERED_STREAM ?= 1
export ROS_AUTOMATIC_DISCOVERY_RANGE ?= LOCALHOST

.PHONY: demo test lint generated install extras lock clean
.DELETE_ON_ERROR:

demo: install
	$(BIN)/barn demo --out $(OUT)

test: extras lint
	PATH=$(BIN):$$PATH ./tools/colcon_test.sh $(PACKAGES)

lint: install
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy $(PACKAGES)

# tables of parameters in the READMEs and parameter files, from the code
generated: install
	$(BIN)/python tools/regenerate.py

install: $(VENV)/installed

$(VENV)/requirements: requirements.lock
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -r requirements.lock
	touch $@

$(VENV)/installed: $(VENV)/requirements $(PACKAGES:%=%/setup.py) $(PACKAGES:%=%/package.xml)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-build-isolation --use-pep517 \
		--config-settings editable_mode=compat --no-deps $(PACKAGES:%=-e ./%)
	touch $@

extras: $(VENV)/extras

$(VENV)/extras: requirements-extra.lock $(VENV)/installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -r requirements-extra.lock
	touch $@

# torch names the CUDA libraries that it needs itself, and only in its builds that use them
lock:
	uv pip compile --universal --python-version 3.10 --no-header --no-emit-index-url --no-emit-find-links \
		--quiet requirements.in -o requirements.lock
	uv pip compile --universal --python-version 3.10 --no-header --no-emit-index-url --no-emit-find-links \
		--no-annotate --quiet requirements-extra.in | grep -vE '^(cuda|nvidia|triton)' > requirements-extra.lock

clean:
	rm -rf build install log $(VENV)
