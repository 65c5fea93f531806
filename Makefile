# make serve: everything a machine with Python 3.11+ needs, then the page.   make test: all checks, as CI runs them.
PYTHON ?= python3
BIN := .venv/bin
SCENE ?=

.PHONY: install serve test check lock format pictures figures reports clean

install: $(BIN)/.installed

$(BIN)/.installed: requirements.lock pyproject.toml
	$(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet --disable-pip-version-check --require-hashes -r requirements.lock
	$(BIN)/pip install --quiet --disable-pip-version-check --no-deps --editable .
	touch $@

$(BIN)/.tools: requirements-dev.lock $(BIN)/.installed
	$(BIN)/pip install --quiet --disable-pip-version-check --require-hashes -r requirements-dev.lock
	touch $@

serve: install
	$(BIN)/isogi serve $(SCENE)

check: $(BIN)/.tools
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

test: check
	$(BIN)/python -m pytest

# Every picture in the README and in docs/ is made by this.
pictures: install
	$(BIN)/isogi render demo:casting -o docs/casting.png --azimuth 35 --elevation 28 --distance 3 \
	  --width 960 --height 600 --target-error 0.03
	$(BIN)/isogi render docs/lamp.toml -o docs/lamp.png --azimuth 35 --elevation 28 --distance 3 \
	  --width 960 --height 600 --target-error 0.03

# The figures that the README and the notes state.
figures: $(BIN)/.tools
	$(BIN)/python -m benchmarks.frames
	$(BIN)/python -m benchmarks.first_view

# docs/error.md, from reports of the shared volumes; goes on where it was stopped.
reports: $(BIN)/.tools
	$(BIN)/python -m benchmarks.reports -o reports

lock: $(BIN)/.tools
	$(BIN)/uv pip compile --quiet --universal --generate-hashes --no-emit-index-url --python-version 3.11 \
	  --extra report pyproject.toml -o requirements.lock
	$(BIN)/uv pip compile --quiet --universal --generate-hashes --no-emit-index-url --python-version 3.11 \
	  --extra report --extra dev pyproject.toml -o requirements-dev.lock

format: $(BIN)/.tools
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

clean:
	rm -rf .venv test-results .pytest_cache .mypy_cache .ruff_cache .import_linter_cache
