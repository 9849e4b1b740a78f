# Two commands need nothing but Python >= 3.11 and make:
#   make reproduce    the paper's comparison, into report/
#   make test         formatting, lint, types, tests and doctests
PYTHON ?= python3
BIN := .venv/bin
export PIP_CONSTRAINT := $(CURDIR)/constraints.txt
export PIP_DISABLE_PIP_VERSION_CHECK := 1

# What tells in minutes whether an installation works: each dependency is used by one of them.
FAST := $(addprefix tests/,plant/test_plant.py gains problems/test_problem_file.py \
	simulation/test_trajectory.py controller/test_interop.py controller/test_export_fmu.py \
	cli/test_cli_export.py app/test_app_server.py)
# What old libraries and new ones warn of each other is not ours.
QUIET := -W ignore::DeprecationWarning -W ignore::PendingDeprecationWarning
TOOLS := pytest pytest-xdist hypothesis beartype mpmath

.PHONY: reproduce study test lint types pytest long as-users fuzz browser bench examples schema docs clean
.PHONY: lowest pythons wheel cortex-m

reproduce: .venv/installed
	$(BIN)/deadtime reproduce --out report

# Which law, when: maps and answers, two minutes on two cores.
study: .venv/installed
	$(BIN)/deadtime study studies/paper.toml --out study-report

# Types are checked by one process, beside which the tests begin.
test: lint
	@$(MAKE) --no-print-directory --jobs 2 types pytest

lint: .venv/installed-test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: .venv/installed-test
	$(BIN)/basedpyright

# A process per core, so that one more thread of linear algebra in each would only wait; bytecode is
# kept, whatever the caller says, because many tests start processes that import everything again.
TESTED := env -u PYTHONDONTWRITEBYTECODE OPENBLAS_NUM_THREADS=1
PARALLEL := --numprocesses auto --dist worksteal

# The tests compile as much as they run: one level of optimisation takes less than three, and what
# one target has compiled the other finds.
COMPILED := $(TESTED) NUMBA_OPT=1 NUMBA_CACHE_DIR=$(CURDIR)/.venv/numba
pytest: .venv/installed-test
	$(COMPILED) $(BIN)/pytest $(PARALLEL)

# What is too long for every change: the whole report, certificates of N = 100 put back, and the
# other cases of claims of which `make pytest` tries a few; those of engines as users have them.
long: as-users .venv/installed-test
	$(COMPILED) $(BIN)/pytest -m long $(addprefix --ignore=,$(ENGINES)) $(PARALLEL)

# Every engine against its second method, all cases, compiled as users compile it, into a cache of
# its own: Numba's does not tell levels apart.
ENGINES := $(addprefix tests/,simulation/test_digital_loop.py simulation/test_ideal_loop.py \
	scenarios/test_engines.py certificates/test_falsify_search.py)
as-users: .venv/installed-test
	$(TESTED) NUMBA_OPT=3 NUMBA_CACHE_DIR=$(CURDIR)/.venv/numba-users $(BIN)/pytest -m "not browser" $(PARALLEL) $(ENGINES)

# Mutants of every kind of file that the package reads: make fuzz FUZZ="--kind log --count 100000".
FUZZ ?= --count 2000 --seconds 120
fuzz: .venv/installed-test
	PYTHONPATH=tests $(BIN)/python -m fuzzing $(FUZZ)

# The explorer in Chromium; pictures into screenshots/.
browser: .venv/installed-browser
	@command -v chromium >/dev/null || command -v chromium-browser >/dev/null || \
		{ echo "no Chromium: install your system's (Debian: apt-get install chromium)"; exit 1; }
	$(BIN)/pytest -m browser -s tests/browser

# The lowest versions that pyproject.toml allows, in an environment of their own.
lowest:
	$(PYTHON) -m venv --clear build/lowest
	$(PYTHON) scripts/lowest.py > build/lowest/constraints.txt
	PIP_CONSTRAINT=build/lowest/constraints.txt build/lowest/bin/python -m pip install --quiet \
		--editable ".[app,control,fmi,sweep]" $(TOOLS)
	NUMBA_OPT=1 NUMBA_CACHE_DIR=$(CURDIR)/build/lowest/numba \
		build/lowest/bin/python -m pytest $(QUIET) $(FAST)

# Every Python that is supported and found: make pythons PYTHONS="/path/to/python3.12 ..." for others.
PYTHONS ?= $(foreach minor,11 12 13,$(shell command -v python3.$(minor)))
pythons:
	@test -n "$(PYTHONS)" || { echo "no Python 3.11, 3.12 or 3.13 was found: give PYTHONS=..."; exit 1; }
	for python in $(PYTHONS); do \
		place=build/$$($$python -c 'import sys; print("python3.%d" % sys.version_info[1])'); \
		echo "== $$($$python --version)" && $$python -m venv --clear $$place && \
		$$place/bin/python -m pip install --quiet --editable ".[app,control,fmi,sweep]" $(TOOLS) && \
		NUMBA_OPT=1 NUMBA_CACHE_DIR=$(CURDIR)/$$place/numba $$place/bin/python -m pytest $(FAST) || exit 1; \
	done

# What users install: a wheel, made from the sdist, that has nothing but its dependencies beside it
# runs the tutorial from an empty folder; so does the sdist itself.
wheel:
	rm -rf build/wheel dist && mkdir -p build/wheel
	$(PYTHON) -m venv build/wheel/tools
	build/wheel/tools/bin/python -m pip install --quiet build
	build/wheel/tools/bin/python -m build --outdir dist . > build/wheel/log || { cat build/wheel/log; exit 1; }
	for file in dist/*.whl dist/*.tar.gz; do \
		place=build/wheel/$$(basename $$file) && $(PYTHON) -m venv $$place && mkdir $$place/empty && \
		$$place/bin/python -m pip install --quiet $$file && \
		env -u PYTHONPATH $$place/bin/python scripts/tutorial.py $$place/empty || exit 1; \
	done

# The exported C on an emulated Cortex-M.
cortex-m: .venv/installed-test
	@command -v arm-none-eabi-gcc >/dev/null && command -v qemu-system-arm >/dev/null || \
		{ echo "missing (Debian): gcc-arm-none-eabi libnewlib-arm-none-eabi qemu-system-arm"; exit 1; }
	$(BIN)/pytest tests/controller/test_cortex_m.py

bench: .venv/installed
	$(BIN)/python benchmarks/single_run.py
	$(BIN)/python benchmarks/batch.py
	$(BIN)/python benchmarks/sweep.py

examples: .venv/installed
	for script in examples/walkthroughs/*.py examples/gallery/*.py examples/howto/*.py; do $(BIN)/python $$script || exit 1; done

schema: .venv/installed
	$(BIN)/deadtime schema > docs/problem.schema.json

# Strict, and the gallery's scripts are run; tests/documents/test_docs_site.py does the same without them.
docs: .venv/installed-docs
	rm -rf docs/api/names
	$(BIN)/python -m sphinx -n -W --keep-going -q -b html docs docs/_build/html
	@echo "The site: docs/_build/html/index.html"

.venv/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "deadtime needs Python >= 3.11: run make PYTHON=/path/to/python3.11 ..."; exit 1; }
	@$(PYTHON) -m venv .venv || \
		{ echo "python -m venv failed: install your system's venv package (Debian: python3-venv)"; rm -rf .venv; exit 1; }

.venv/installed: pyproject.toml constraints.txt | .venv/bin/python
	$(BIN)/python -m pip install --quiet --no-compile --editable ".[sweep]"
	@touch $@

.venv/installed-test: pyproject.toml constraints.txt | .venv/bin/python
	$(BIN)/python -m pip install --quiet --no-compile --editable ".[docs,test]"
	@touch .venv/installed .venv/installed-docs $@

.venv/installed-docs: pyproject.toml constraints.txt | .venv/bin/python
	$(BIN)/python -m pip install --quiet --no-compile --editable ".[docs]"
	@touch $@

.venv/installed-browser: pyproject.toml constraints.txt | .venv/bin/python
	$(BIN)/python -m pip install --quiet --no-compile --editable ".[browser]"
	@touch $@

clean:
	rm -rf .venv report study-report build dist docs/_build docs/api/names docs/walkthroughs docs/gallery docs/howto/scripts .pytest_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -exec rm -rf {} +
