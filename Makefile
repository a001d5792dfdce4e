# On a fresh machine with Python 3.11+ and make: `make demo`, `make test`. Everything is installed into .venv, in
# the versions of requirements.lock: `make demo` what the product needs, the rest what the tests need as well.
# Nothing outside this folder is touched, except that tests install Debian's chromium, postgresql and nginx when they
# run as root and these are missing (the page is tested in a real browser, the store on a real PostgreSQL).

PYTHON   ?= python3
VENV     := .venv
BIN      := $(VENV)/bin
PRODUCT  := $(VENV)/.stamp-product
DEV      := $(VENV)/.stamp-dev
COMPILED := $(VENV)/.stamp-compiled
GENERATOR := $(VENV)/generator/bin/openapi-python-client
INSTALL   = $(BIN)/python -m pip install --quiet --disable-pip-version-check -c requirements.lock -e
# Three workers on two cores: tests of the service and the bus wait for real time more than they compute.
# The last line says what the run took: the wall clock, and the processor with all processes that ended in it.
PYTEST    = bash -c 'TIMEFORMAT="%R s of wall clock, %U + %S s of processor time"; time "$$@"' timed \
            $(BIN)/python -m pytest -n 3 --dist loadgroup --timeout 600
export OMP_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1
# Containers set it; every process of the tests would then compile every module again.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo test test-panel campaign check check-page bench bench-page docs pictures serve system-packages lock sbom clean

demo: $(PRODUCT)
	$(BIN)/invid demo --out invid-demo

# Promises to people (stop, kill, limits, nothing lost, keys), and what only these tests caught: before every commit.
test: $(COMPILED) system-packages
	$(PYTEST) -m "not campaign"

# A dozen of the campaign, always the same ones: CI, after `make test`.
test-panel: $(COMPILED) system-packages
	$(PYTEST) -m panel

# What `make test` leaves out, by night: hidden draws, real machines, tutorial and cookbook in full, tours of the page.
campaign: $(COMPILED) system-packages $(GENERATOR)
	$(PYTEST) -m campaign

check: $(DEV) check-page
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python scripts/check_docs.py
	$(BIN)/python scripts/check_house.py

# Types of the page's modules against the interface (service/page): for development only, nothing is built or shipped.
check-page:
	@if command -v npm >/dev/null; then cd service/page && npm ci --silent --ignore-scripts && npm run --silent check; \
	  else echo "npm is missing: the types of the page are not checked"; fi

bench: $(DEV)
	$(INSTALL) ".[dev,bench]"
	$(BIN)/python benchmarks/run_all.py

# Short settings, about eight processor minutes; without --quick hours.
bench-page: $(DEV)
	$(INSTALL) ".[dev,bench]"
	$(BIN)/python benchmarks/run_all.py --page docs/reference/benchmarks.md --quick

# The documentation site, offline, warnings are errors: build/docs/index.html.
docs: $(DEV)
	$(BIN)/python -m sphinx -W --keep-going -q -b html docs build/docs

pictures: demo
	$(BIN)/python docs/pictures.py invid-demo docs/images
	$(BIN)/python docs/screenshot.py docs/images/page.png
	$(BIN)/python docs/gallery.py

serve: $(PRODUCT)
	$(BIN)/invid serve

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "invid needs Python 3.11 or newer; $(PYTHON) is $$($(PYTHON) --version 2>&1). Set PYTHON=…"; exit 2; }
	$(PYTHON) -m venv $(VENV)

$(PRODUCT): pyproject.toml requirements.lock | $(BIN)/python
	$(INSTALL) .
	@touch $@

$(DEV): pyproject.toml requirements.lock | $(BIN)/python
	$(INSTALL) ".[dev]"
	@touch $(PRODUCT) $@

# Compiled functions are kept on disk. Two tests that use nearly all of them run first: else each worker compiles.
KERNELS := $(shell grep -rlE "^@(compiled|inlined)" invid drivers --include=*.py)
$(COMPILED): $(DEV) $(KERNELS)
	-$(BIN)/python -m pytest -n 2 \
	  tests/unit/test_api.py::test_the_job_from_a_file_to_the_named_cause_and_back_to_files \
	  tests/contract/test_stopping.py::test_a_run_keeps_the_speed_that_was_permitted
	@touch $@

# The generator of clients asks for other versions than the product does; its test says so where it is missing.
$(GENERATOR): | $(BIN)/python
	-$(BIN)/python -m venv $(VENV)/generator && \
	  $(VENV)/generator/bin/python -m pip install --quiet --disable-pip-version-check "openapi-python-client>=0.28,<1"

# A test that cannot run for want of these says so in pytest's summary.
system-packages:
	@sh .ci/system-packages

lock: $(DEV)
	$(BIN)/python -m pip install --quiet uv
	$(BIN)/uv pip compile pyproject.toml --universal --extra dev --extra bench --extra slcan --extra gs-usb \
	  --python-version 3.11 --no-annotate -q -o requirements.lock

# Bill of materials (CycloneDX) and licences of what the image holds.
sbom: $(DEV)
	$(BIN)/python scripts/bill-of-materials.py build

clean:
	rm -rf $(VENV) .pytest_cache .mypy_cache .ruff_cache .hypothesis invid-demo
