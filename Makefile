# make demo: from a bare machine to three scored trials. make test: lint, the documentation, colcon build, colcon test
# and the tests of the repository.
# CONTRIBUTING.md says what the other targets do.
PYTHON ?= python3
PACKAGES := barn_worlds barn_sim barn_planners barn_metrics barn_eval
VENV := .venv
LOWEST := build/lowest
BIN := $(CURDIR)/$(VENV)/bin
WHEELS := wheels/$(shell $(PYTHON) -c 'import sys; print("cp%d%d" % sys.version_info[:2])')
MESSAGES := wheels/messages/$(notdir $(WHEELS))
MESSAGE_PACKAGES := tf2_msgs simulation_interfaces
OUT ?= out/demo
BENCH ?= out/bench.json
# extras stay in the lock: an older pip refuses `coverage[toml]` once a release newer than the locked one is out
COMPILE := uv pip compile --universal --no-strip-extras --python-version 3.10 --no-header --no-emit-index-url --no-emit-find-links --quiet
export RCUTILS_LOGGING_BUFFERED_STREAM ?= 1
export ROS_AUTOMATIC_DISCOVERY_RANGE ?= LOCALHOST

.PHONY: demo test lint lowest bench-check generated docs figures animation mutation coverage audit install extras wheels lock clean
.DELETE_ON_ERROR:
# all targets install into one environment
.NOTPARALLEL:

demo: $(VENV)/installed
	$(BIN)/barn demo --out $(OUT)
	$(BIN)/barn report $(OUT)

test: extras lint docs
	PATH=$(BIN):$$PATH ./qa/checks/colcon_test.sh $(PACKAGES)

lint: install $(VENV)/tools
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy $(PACKAGES) qa
	$(BIN)/bandit -q -ll -r $(PACKAGES) qa -x '*/test/*'

# the packages' tests with the oldest releases that pyproject.toml allows; needs uv. Only tests of optional parts are
# left out, since those parts are not installed.
lowest:
	$(PYTHON) -m venv --clear $(LOWEST)
	uv pip compile --quiet --resolution lowest-direct --python $(LOWEST)/bin/python pyproject.toml -o $(LOWEST)/lowest.txt
	$(LOWEST)/bin/python -m pip install --quiet --disable-pip-version-check -r $(LOWEST)/lowest.txt -r requirements/tests.in
	$(LOWEST)/bin/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation .
	$(LOWEST)/bin/python -m pytest $(PACKAGES)

# tables of parameters in the READMEs, parameter files and the results in notebooks, from the code
generated: extras
	$(BIN)/python qa/release/regenerate.py

# pages that link to what is not there, and names that do not exist, are errors
docs: $(VENV)/docs
	$(BIN)/python qa/release/site_pages.py build/pages
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

# the README's first picture, of a trial that every machine repeats; takes some minutes
animation: install
	$(BIN)/barn run --worlds 270 --planner eband --protocol challenge --mode direct --seed 5 --bags all --overwrite \
		--out out/animation
	$(BIN)/barn replay out/animation/bags/eband_w0270_r00 --camera chase --out docs/figures/trial.gif --fps 8 --speed 3

# the figures of the documentation but for those of trials and training, which it names
figures: install
	$(BIN)/python qa/studies/figures.py docs

# the check of the unit tests in docs/mutation.md; takes about 10 minutes
mutation: install $(VENV)/tools
	$(BIN)/python qa/checks/mutate --page docs/mutation.md

# the branches that tests reach without ROS, and those that they do not, with the reason; takes about an hour
coverage: extras
	PATH=$(BIN):$$PATH ./qa/checks/coverage.sh

# how fast the suite is; fails for a figure that is 10% slower than last time, else this result replaces that one; about
# four minutes, on a machine with nothing else to do
bench-check: extras
	mkdir -p $(dir $(BENCH))
	$(BIN)/barn bench --set ros=false --set repeats=5 $(addprefix --against ,$(wildcard $(BENCH))) --json > $(BENCH).new
	$(BIN)/python qa/checks/slower.py $(BENCH).new
	mv $(BENCH).new $(BENCH)

install: $(VENV)/compiled $(VENV)/stand_ins

# what planners of others import and PyPI does not have: ros_stand_ins/README.md. Types of messages are compiled once for
# each Python.
$(VENV)/stand_ins: $(VENV)/installed $(wildcard ros_stand_ins/*.py ros_stand_ins/*/*.py ros_stand_ins/*/*/*/*)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-build-isolation --no-deps ./ros_stand_ins
	for package in $(MESSAGE_PACKAGES); do \
		ls $(MESSAGES)/barn_$$package-*.whl > /dev/null 2>&1 \
			|| $(BIN)/python ros_stand_ins/build_messages.py $(MESSAGES) $$package > /dev/null 2>&1 \
			|| echo "$$package needs a C++ compiler and the headers of Python: what barn info says of it is off"; \
	done
	test ! -d $(MESSAGES) || $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-index --no-deps \
		$(MESSAGES)/*.whl
	touch $@

# numba keeps the suite's kernels once they have been compiled for trials of each planner and for a robot among obstacles
$(VENV)/compiled: $(VENV)/installed
	PATH=$(BIN):$$PATH ./docker/compile_kernels.sh out/compiled
	touch $@

# PyBullet has no wheel for Python 3.12: this compiles it, from the source that the lock names, for all environments to
# come, which takes about ten minutes
wheels: $(BIN)/python
	mkdir -p $(WHEELS)
	sed -n '/^pybullet/,/[^\\]$$/p' requirements/base.lock > $(WHEELS)/pybullet.lock
	$(BIN)/python -m pip wheel --no-deps --disable-pip-version-check --wheel-dir $(WHEELS) -r $(WHEELS)/pybullet.lock

$(BIN)/python:
	$(PYTHON) -m venv $(VENV)

$(VENV)/requirements: requirements/users.lock | $(BIN)/python
	test ! -d $(WHEELS) || $(BIN)/python -m pip install --quiet --no-index --no-deps --find-links $(WHEELS) pybullet
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -r requirements/users.lock
	touch $@

$(VENV)/installed: $(VENV)/requirements $(PACKAGES:%=%/setup.cfg) $(PACKAGES:%=%/package.xml)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-build-isolation --use-pep517 \
		--config-settings editable_mode=compat --no-deps $(PACKAGES:%=-e ./%)
	touch $@

# what builds, tests and lints the suite; users need none of it
$(VENV)/tools: requirements/base.lock $(VENV)/installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -r requirements/base.lock
	touch $@

extras: $(VENV)/extras install

# the lock has all that its packages need but torch, whose file, with CUDA or without, is left to the machine
$(VENV)/extras: requirements/extra.lock requirements/torch.in $(VENV)/tools
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps -r requirements/extra.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -r requirements/torch.in
	touch $@

$(VENV)/docs: requirements/docs.lock | $(BIN)/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -r requirements/docs.lock
	touch $@

# known vulnerabilities of what is locked; asks a service on the internet, and says so where it cannot
audit: install
	$(BIN)/python qa/release/audit.py

# torch names the CUDA libraries that it needs itself, and only in its builds that use them
lock:
	$(COMPILE) --generate-hashes requirements/base.in -o requirements/base.lock
	$(COMPILE) --generate-hashes -c requirements/base.lock requirements/users.in -o requirements/users.lock
	$(COMPILE) --generate-hashes -c requirements/base.lock requirements/python.in -o requirements/python.lock
	$(COMPILE) --no-annotate --generate-hashes requirements/extra.in \
		| sed -E '/^(cuda|nvidia|torch|triton)/,/[^\\]$$/d' > requirements/extra.lock
	$(COMPILE) --no-annotate --generate-hashes requirements/cluster.in -o requirements/cluster.lock
	$(COMPILE) --no-annotate --generate-hashes requirements/docs.in > requirements/docs.lock

clean:
	rm -rf build install log site $(VENV)
