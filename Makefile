# `make demo` and `make test` are all the set-up a fresh machine needs.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
OUT ?= demo_out

.PHONY: demo test test-slow lint format clean system-libraries

demo: $(STAMP)
	$(BIN)/contramap demo --out $(OUT)

test: $(STAMP)
	$(BIN)/pytest

test-slow: $(STAMP)
	$(BIN)/pytest -m slow

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

format: $(STAMP)
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

$(STAMP): pyproject.toml constraints.txt
	@$(MAKE) --no-print-directory system-libraries
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --upgrade-strategy only-if-needed -c constraints.txt -e '.[dev]'
	@touch $@

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
