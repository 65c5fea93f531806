# make serve: everything a machine with Python 3.11+ needs, then the page.   make test: all checks, as CI runs them.
PYTHON ?= python3
BIN := .venv/bin
SCENE ?=
ISOGI_SHARED_DATA ?= ../shared/data
TESTS ?=
PYTHONS ?=

# What README and docs use, and what files of other fields need: all of it is in the environment.
EXTRAS := --extra formats --extra report --extra s3 --extra client --extra film --extra fits

# Every process would compile all modules anew: a server with two workers starts three times as fast without it.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: install serve shell test-fast test test-all test-long kernels bytecode test-bounds test-python check lock format schemas pictures \
  measurements release reports wheel-check clean

install: $(BIN)/.installed

$(BIN)/.installed: requirements.lock pyproject.toml
	$(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet --disable-pip-version-check --no-compile --require-hashes -r requirements.lock
	$(BIN)/pip install --quiet --disable-pip-version-check --no-deps --editable .
	touch $@

$(BIN)/.tools: requirements-dev.lock $(BIN)/.installed
	$(BIN)/pip install --quiet --disable-pip-version-check --no-compile --require-hashes -r requirements-dev.lock
	touch $@

# What checks the page's modules; where there is no npm, those checks are skipped.
NODE_TOOLS := tests/web/node_modules/.installed

$(NODE_TOOLS): tests/web/package.json tests/web/package-lock.json
	if command -v npm >/dev/null; then cd tests/web && npm ci --silent && touch node_modules/.installed; fi

serve: install
	$(BIN)/isogi serve $(SCENE)

shell: install
	@echo "isogi and its Python are at hand here; exit leaves."
	@PATH="$(CURDIR)/$(BIN):$$PATH" VIRTUAL_ENV="$(CURDIR)/.venv" "$${SHELL:-sh}" || true

check: $(BIN)/.tools
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

# Tests in tiers, by what they need (the markers of pyproject.toml): `test-fast` while you work, `test` before each
# commit, `test-all` before a landing. `test-all` runs `test` first, and then only what that leaves out.
LATE := benchmark or browser or cluster or kill or long or s3 or slow or stability
SOON := journey or not ($(LATE))
RUN := $(BIN)/python -m tests.run --durations 20
TOGETHER := -n auto --dist worksteal
# Late tests wait for browsers, servers and workers most of the time: three for two cores take three quarters of it.
# Each file stays in one process, which opens its browsers and bakes its stores once.
MORE := -n $(shell echo $$(( $$(nproc 2>/dev/null || echo 2) * 3 / 2 ))) --dist loadfile --no-loadscope-reorder

# Threads of BLAS would spin on the cores that the processes share.
test-fast test test-all: export OPENBLAS_NUM_THREADS = 1

test-fast:
	$(MAKE) --no-print-directory --jobs 3 check kernels $(NODE_TOOLS)
	rm -f test-results/passed-alone.txt
	$(RUN) $(TOGETHER) -m "smoke or not ($(LATE) or light or live)"

# Kernels and modules compile while the tools install and the checks run.
test:
	$(MAKE) --no-print-directory --jobs 3 check kernels $(NODE_TOOLS) bytecode
	rm -f test-results/passed-alone.txt
	$(RUN) $(TOGETHER) -m "$(SOON)"

test-all: test
	$(RUN) $(MORE) -m "not ($(SOON) or long)"

# What takes minutes each: every line of README and docs as it stands, films, kills, slow kinds of pictures, and a
# thousand changes of the page. An hour and a half.
test-long: $(BIN)/.tools
	$(BIN)/python -m pytest -m long $(TESTS)

kernels: $(BIN)/.installed
	$(BIN)/python -m tests.compile_kernels

# Each process of pytest would rewrite and compile all modules of tests, and what they import, by itself. The tests
# say what cannot be imported.
bytecode: $(BIN)/.tools
	$(BIN)/python -m pytest --collect-only --quiet >/dev/null || true

# The tests of kernels with every index of an array checked (slow: all is compiled anew), and with Python in Numba's place.
test-bounds: $(BIN)/.tools
	NUMBA_BOUNDSCHECK=1 $(BIN)/python -m pytest $(TESTS)

test-python: $(BIN)/.tools
	NUMBA_DISABLE_JIT=1 $(BIN)/python -m pytest tests/kernels

# Every picture in the README and in docs/, but for those in docs/measurements, which the suites draw.
pictures: $(BIN)/.tools
	if $(BIN)/python -c "import vtk" 2>/dev/null; then $(BIN)/python docs/draw_front.py; fi
	$(BIN)/isogi render docs/lamp.toml -o docs/lamp.png \
	  --width 960 --height 600 --target-error 0.03
	$(BIN)/isogi render docs/glow.toml -o docs/glow.png --width 640 --height 480 --target-error 0.03
	$(BIN)/isogi render docs/cornell.toml -o docs/cornell.png --width 300 --height 300 --target-error 0.03
	for kind in window cut; do $(BIN)/isogi render demo:casting -o docs/$$kind.png --$$kind "y>32" --azimuth 60 \
	  --elevation 30 --width 640 --height 480 --target-error 0.05; done
	$(BIN)/isogi render docs/colours.toml -o docs/colours.webp --width 480 --height 360 --target-error 0.03
	$(BIN)/isogi render docs/surfaces.toml -o docs/surfaces.webp --width 480 --height 360 --target-error 0.03
	$(BIN)/python docs/draw_concepts.py
	$(BIN)/python docs/draw_labels.py
	for albedo in 0.3 0.9; do $(BIN)/isogi render docs/albedo.toml -o docs/albedo-$$albedo.png --albedo $$albedo \
	  --width 480 --height 360 --target-error 0.03; done
	$(BIN)/isogi inspect $(ISOGI_SHARED_DATA)/engine_256x256x128_uint8.nhdr --picture docs/stiffness.png
	$(BIN)/python docs/draw_gallery.py
	$(BIN)/python docs/draw_scenes.py
	$(BIN)/python docs/draw_film.py
	$(BIN)/python -m benchmarks.service page

# The pages of docs/measurements that README and guides quote: one night on two cores. NAMES="speed-frames" writes some.
measurements: $(BIN)/.tools
	$(BIN)/python -m benchmarks.release measure $(NAMES)

# A commit and a tag of VERSION: refused while a quoted figure is older than the code that it measures.
release: $(BIN)/.tools
	$(BIN)/python -m benchmarks.release tag $(VERSION)

# docs/measurements/accuracy-reports.md, from reports of the shared volumes; goes on where it was stopped.
reports: $(BIN)/.tools
	$(BIN)/python -m benchmarks.accuracy reports -o reports --write

# A wheel of this tree in empty environments, with the lowest and with the highest versions of what it needs, on each
# Python that it names: what `pip install isogi` gives. PYTHONS="3.12" checks some.
wheel-check: $(BIN)/.tools
	$(BIN)/python -m tests.package.check_wheel $(PYTHONS)

# The tools ask for older versions of some packages: what both lock is chosen with them, so that one environment has both.
lock: $(BIN)/.tools
	$(BIN)/uv pip compile --quiet --universal --generate-hashes --no-emit-index-url --python-version 3.11 \
	  $(EXTRAS) --extra dev pyproject.toml -o requirements-dev.lock
	$(BIN)/uv pip compile --quiet --universal --generate-hashes --no-emit-index-url --python-version 3.11 \
	  --constraints requirements-dev.lock $(EXTRAS) pyproject.toml -o requirements.lock

format: $(BIN)/.tools
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

# The page's types of the server's documents.
schemas: $(BIN)/.tools
	$(BIN)/python -m tests.web.write_schemas

clean:
	rm -rf .venv tests/web/node_modules test-results .pytest_cache .mypy_cache .ruff_cache .import_linter_cache
