# Two commands: `make demo` shows the whole chain on a virtual rig, `make test` runs every test.
# Each sets itself up in .venv; only Python 3.10 or later is needed.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# Python compiles a module at its first import; most installed modules are never imported.
PIP := $(BIN)/python -m pip --disable-pip-version-check install --quiet --no-compile --constraint .ci/constraints.txt
# The tests start hundreds of programs: each must not compile the imported modules again.
unexport PYTHONDONTWRITEBYTECODE
# Extras of the first set-up; CI installs all of them at once.
EXTRAS ?= ros

.PHONY: demo test coverage lint docs benchmark faults criteria reproduce sample-bag clean

demo: $(VENV)/.ros
	$(BIN)/pendubot demo

# Three processes, each of one thread: tests of live programs wait while others compute. A test that fails,
# because a live program waited for seconds, is run once more by itself. The fault trials run alone; each process takes
# the next one when it has ended one.
PYTEST := PENDUBOT_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest
PARALLEL := $(PYTEST) --numprocesses 3
AGAIN := --last-failed --last-failed-no-failures none
TRIALS := test/test_fault_trials.py
PACKAGE := pendubot_identification
test: $(VENV)/.test
	$(PARALLEL) --dist worksteal --ignore $(TRIALS) || $(PYTEST) $(AGAIN) --ignore $(TRIALS)
	$(PARALLEL) --dist load --maxschedchunk 1 $(TRIALS) || $(PYTEST) $(AGAIN) $(TRIALS)

# The lines that no test reaches; takes 1.5 times as long.
coverage: $(VENV)/.test
	$(PARALLEL) --dist worksteal --ignore $(TRIALS) --cov=$(PACKAGE) --cov-report=term-missing:skip-covered

lint: $(VENV)/.test
	$(BIN)/ruff check . && $(BIN)/ruff format --check . && $(BIN)/mypy && $(BIN)/lint-imports

# The pages and the Python interface as HTML, in build/docs.
docs: $(VENV)/.docs
	$(BIN)/sphinx-build --quiet --fail-on-warning --keep-going docs build/docs

# Half an hour, and 1 GB in the temporary folder; the speeds of docs/benchmarks.md.
benchmark: $(VENV)/.benchmark
	$(BIN)/python -m benchmarks.speed

# Needs a quiet machine; about half an hour.
faults: $(VENV)/.test
	$(BIN)/python -m benchmarks.faults

# The real rigs of docs/benchmarks.md; long.
criteria: $(VENV)/.test
	$(BIN)/python -m benchmarks.estimator real

# The paper's tables and figures, in build/reproduction: read index.md there.
reproduce: $(VENV)/.ros
	$(BIN)/pendubot reproduce --output build/reproduction --force

# Records bags/paper_experiment again, live, by the complete chain.
sample-bag: $(VENV)/.ros
	rm -rf build/sample
	$(BIN)/pendubot demo --output build/sample
	rm -rf bags/paper_experiment
	cp -r build/sample/paper_experiment bags/

$(VENV)/.ros: setup.py .ci/constraints.txt $(wildcard pendubot_identification/*/*.[ch])
	@echo "Setting up $(VENV) (once, about a minute) ..."
	@$(PYTHON) -m venv $(VENV)
	@$(PIP) --editable '.[$(EXTRAS)]'
	@echo $(EXTRAS) > $@

# The action's Python module, which colcon builds in a ROS workspace: here compiled, if there is a C++ compiler.
$(VENV)/.interfaces: $(VENV)/.ros .ci/interfaces.txt .ci/wheels.cmake $(shell find pendubot_interfaces -type f)
	@export PATH="$(abspath $(BIN)):$$PATH" AMENT_PREFIX_PATH=$(abspath $(VENV)) && { \
		$(PIP) --requirement .ci/interfaces.txt && \
		cmake -S pendubot_interfaces -B $(VENV)/interfaces -DCMAKE_INSTALL_MESSAGE=NEVER \
			-DCMAKE_PREFIX_PATH=$(abspath $(VENV)) -DCMAKE_INSTALL_PREFIX=$(abspath $(VENV)) -DBUILD_TESTING=OFF \
			-DPython3_EXECUTABLE=$(abspath $(BIN))/python -DCMAKE_PROJECT_INCLUDE=$(abspath .ci/wheels.cmake) && \
		cmake --build $(VENV)/interfaces --parallel --target install; } > $(VENV)/interfaces.log 2>&1 \
		|| echo 'no interface of the action was built, see $(VENV)/interfaces.log: its tests are skipped'
	@touch $@

$(VENV)/.test: $(VENV)/.ros $(VENV)/.interfaces
	@grep --quiet test $(VENV)/.ros || $(PIP) --editable '.[ros,test]'
	@touch $@

$(VENV)/.docs: $(VENV)/.test
	@grep --quiet docs $(VENV)/.ros || $(PIP) --editable '.[ros,test,docs]'
	@touch $@

$(VENV)/.benchmark: $(VENV)/.test
	@$(PIP) --editable '.[ros,test,benchmark]'
	@touch $@

clean:
	rm -rf $(VENV) build install log *.egg-info pendubot_identification/_kernel*.so
