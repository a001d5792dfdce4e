# Two commands on a fresh machine with Python 3.11+ and make: `make demo`, `make test`.
# Everything is installed into .venv from requirements.lock; nothing outside this folder is touched,
# except that `make test` installs Debian's chromium and postgresql when it runs as root and they are
# missing (the page is tested in a real browser, the store on a real PostgreSQL).

PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
STAMP  := $(VENV)/.stamp-installed
export OMP_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1

.PHONY: demo test check bench bench-page docs pictures serve system-packages lock sbom clean

demo: $(STAMP)
	$(BIN)/invid demo --out invid-demo

# Three workers on two cores: tests of the service and the bus wait for real time more than they compute.
test: $(STAMP) system-packages
	$(BIN)/python -m pytest -n 3 --dist loadgroup --timeout 600

check: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python scripts/check_docs.py

bench: $(STAMP)
	$(BIN)/python benchmarks/run_all.py

# Short settings, about eight processor minutes; without --quick hours.
bench-page: $(STAMP)
	$(BIN)/python benchmarks/run_all.py --page docs/reference/benchmarks.md --quick

# The documentation site, offline, warnings are errors: build/docs/index.html.
docs: $(STAMP)
	$(BIN)/python -m sphinx -W --keep-going -q -b html docs build/docs

pictures: demo
	$(BIN)/python docs/pictures.py invid-demo docs/images
	$(BIN)/python docs/gallery.py

serve: $(STAMP)
	$(BIN)/invid serve

$(STAMP): pyproject.toml requirements.lock
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "invid needs Python 3.11 or newer; $(PYTHON) is $$($(PYTHON) --version 2>&1). Set PYTHON=…"; exit 2; }
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -r requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps -e .
	@touch $@

# A test that cannot run for want of these says so in pytest's summary.
system-packages:
	@sh .ci/system-packages

lock: $(STAMP)
	$(BIN)/python -m pip install --quiet uv
	$(BIN)/uv pip compile pyproject.toml --universal --extra dev --extra postgres --extra parquet \
	  --extra slcan --extra gs-usb --python-version 3.11 --no-annotate -q -o requirements.lock
	$(BIN)/uv pip compile pyproject.toml --universal --extra postgres --extra parquet --extra slcan \
	  --extra gs-usb --python-version 3.11 --no-annotate -q -c requirements.lock -o requirements-runtime.lock

# Bill of materials (CycloneDX) and licences of what requirements-runtime.lock pins.
sbom: $(STAMP)
	$(BIN)/python scripts/bill-of-materials.py build

clean:
	rm -rf $(VENV) .pytest_cache .mypy_cache .ruff_cache .hypothesis invid-demo
