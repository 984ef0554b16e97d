# `make demo` and `make test` are all the set-up a fresh machine needs: Python 3.10 or newer, PYTHON=python3.12 picks one.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
OUT ?= demo_out
# The demo needs the simulator and the viewer; the tests need every extra and the programs that read our exports.
DEMO := $(VENV)/.installed-demo
STAMP := $(VENV)/.installed
PIP = $(BIN)/python -m pip --disable-pip-version-check install --upgrade-strategy only-if-needed -c constraints.txt

.PHONY: demo test test-slow lint format clean environment system-libraries

demo: $(DEMO)
	$(BIN)/contramap demo --out $(OUT)

# A worker for each core; the tests of one file stay together, since they share costly fixtures.
test: $(STAMP)
	$(BIN)/pytest -n auto --maxprocesses 8 --dist loadfile --durations 15

test-slow: $(STAMP)
	$(BIN)/pytest -m slow

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

format: $(STAMP)
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

$(DEMO): pyproject.toml constraints.txt
	@$(MAKE) --no-print-directory environment
	@echo "Installing ContraMap with its simulator and viewer into $(VENV): about 7 GB on Linux, most of it torch's CUDA libraries, 4 GB where torch comes without them. pip lists each download; it takes minutes."
	$(PIP) -e '.[sim,viz]'
	@$(BIN)/python -m tools.compile_loops
	@touch $@

$(STAMP): pyproject.toml constraints.txt
	@$(MAKE) --no-print-directory environment
	@echo "Installing ContraMap with all that its tests need into $(VENV): about 8 GB on Linux, most of it torch's CUDA libraries, 5 GB where torch comes without them. pip lists each download; it takes minutes."
	$(PIP) -e '.[dev]'
	@$(BIN)/python -m tools.compile_loops
	@touch $(DEMO) $@

environment:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 10))' || \
	  { echo "ContraMap needs Python 3.10 or newer, $(PYTHON) is older or absent; choose one: make demo PYTHON=python3.12"; exit 1; }
	@$(MAKE) --no-print-directory system-libraries
	@test -x $(BIN)/pip || $(PYTHON) -m venv $(VENV)

# open3d links against these two; bare images lack them.
system-libraries:
	@if command -v ldconfig >/dev/null && ! (ldconfig -p | grep -q libusb-1.0 && ldconfig -p | grep -q 'libGL\.so'); then \
	  if [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null; then \
	    apt-get -qq update && apt-get -qq install -y libusb-1.0-0 libgl1 libgomp1 >/dev/null; \
	  else \
	    echo "open3d needs two system libraries; please run: sudo apt-get install -y libusb-1.0-0 libgl1 libgomp1"; \
	  fi; \
	fi

clean:
	rm -rf $(VENV) build *.egg-info $(OUT)
