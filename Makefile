# Every target makes .venv by itself: a machine with Python 3.11+, make and git is enough.
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
COMPILED := $(VENV)/.compiled
KERNELS := $(wildcard planner/*.py planner/*/*.py)
# Which files have tests that run the whole product; importing all the others takes each worker longer than some of these.
FLIGHTS := $(shell grep -rlE "mark\.(e2e|browser)" tests --include "test_*.py")
# Tests that need no compiled kernel.
LIGHT := tests/sim tests/mavlink_bridge tests/recordings
ARGS ?=
# Tests start a hundred processes: none of them compiles again what another has.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: test-sitl demo test serve bench lint light kernels packages quick flights format clean
.DEFAULT_GOAL := demo

$(READY): pyproject.toml constraints.txt scripts/setup.sh
	sh scripts/setup.sh $(VENV)
	@touch $@

# Compiles the optimiser once, for a minute or two, so that nobody waits for it later.
$(COMPILED): $(READY) $(KERNELS)
	$(BIN)/skyfolio warm-up
	@touch $@

demo: $(COMPILED)
	$(BIN)/skyfolio demo $(ARGS)

# What is compiled takes one core; lint, and then the tests that need nothing of it, the other. Flights mostly wait: what
# they leave of two cores is given to all the other tests, which give way to them.
test: $(READY)
	$(MAKE) --jobs 3 kernels packages $(if $(ARGS),lint,light)
	$(MAKE) --jobs 2 --output-sync quick flights

kernels: $(COMPILED)

light: lint
	$(BIN)/python -m pytest $(LIGHT)

quick: $(COMPILED)
	nice -n 3 $(BIN)/python -m pytest --numprocesses 2 --dist loadfile --no-loadscope-reorder --durations 10 \
		$(or $(ARGS),$(addprefix --ignore ,$(LIGHT)))

flights: $(COMPILED)
	$(BIN)/python -m pytest --numprocesses 4 --dist loadscope --durations 20 -m "e2e or browser" $(or $(ARGS),$(FLIGHTS)) \
		|| [ $$? -eq 5 ] # pytest's exit status where ARGS choose none of these

packages:
	sh scripts/postgres.sh
	sh scripts/browser.sh

test-sitl: $(COMPILED)
	$(BIN)/python -m pytest tests/sitl $(ARGS)

serve: $(COMPILED)
	$(BIN)/skyfolio serve $(ARGS)

bench: $(COMPILED)
	$(BIN)/skyfolio bench planner --out docs/benchmarks/planner.json $(ARGS)
	$(BIN)/skyfolio bench report docs/benchmarks/planner.json --out docs/benchmarks/planner.md
	$(BIN)/skyfolio bench report docs/benchmarks/planner.json --page quality --out docs/benchmarks/quality.md

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/python scripts/prose.py
	$(BIN)/mypy

format: $(READY)
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

clean:
	rm -rf $(VENV) out .mypy_cache .pytest_cache .ruff_cache .hypothesis
	rm -rf planner/__pycache__/kernels-*
	find planner tests -name "*.nb[ci]" -delete
