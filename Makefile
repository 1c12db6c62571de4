# Every target makes .venv by itself: a machine with Python 3.11+, make and git is enough.
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
ARGS ?=

.PHONY: test-sitl demo test serve bench lint format clean
.DEFAULT_GOAL := demo

$(READY): pyproject.toml constraints.txt scripts/setup.sh
	sh scripts/setup.sh $(VENV)
	@touch $@

demo: $(READY)
	$(BIN)/skyfolio demo $(ARGS)

test: lint
	sh scripts/postgres.sh
	sh scripts/browser.sh
	$(BIN)/python -m pytest --numprocesses 2 --dist loadfile --durations 10 $(ARGS)
	$(BIN)/python -m pytest --numprocesses 2 --dist loadfile --durations 20 -m "e2e or browser" $(ARGS) \
		|| [ $$? -eq 5 ] # pytest's exit status where ARGS choose none of these

test-sitl: $(READY)
	$(BIN)/python -m pytest tests/sitl $(ARGS)

serve: $(READY)
	$(BIN)/skyfolio serve $(ARGS)

bench: $(READY)
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
