# What a stranger types: make demo, make test. Needs Python 3.11+, pip and make; uses uv where it is on the PATH.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
# Half of their time tests wait, for disks, processes and instruments that answer late: four at a time fill two cores.
JOBS ?= 4
export CBSR_QA_VAR ?= var
# Hundreds of commands are started: modules are compiled once. Without that every worker of the tests needs 17 s more.
unexport PYTHONDONTWRITEBYTECODE
PYTEST := $(BIN)/python -m pytest -n $(JOBS) --dist worksteal -q

.DEFAULT_GOAL := help
.PHONY: help demo fleet-demo serve test test-rest test-all check lint types imports site bench faults soak clean

help: ## Say what can be made
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 12

# An added entry point or dependency needs a reinstall, hence the stamps.
$(BIN)/python:
	@if command -v uv >/dev/null 2>&1; then uv venv --quiet --seed --python $(PYTHON) $(VENV); else $(PYTHON) -m venv $(VENV); fi

$(VENV)/.run-stamp: pyproject.toml constraints.txt | $(BIN)/python
	@echo "installing cbsr-qa and what it needs into $(VENV) (a minute or two, once)"
	@if command -v uv >/dev/null 2>&1; then uv pip install --quiet --python $(BIN)/python -c constraints.txt -e .; \
	else $(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e .; fi
	@touch $@

$(VENV)/.dev-stamp: $(VENV)/.run-stamp
	@echo "installing what the tests need"
	@if command -v uv >/dev/null 2>&1; then uv pip install --quiet --python $(BIN)/python -c constraints.txt -e '.[dev]'; \
	else $(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev]'; fi
	@touch $@

$(VENV)/.web-stamp: $(VENV)/.run-stamp
	@echo "installing what the page needs"
	@if command -v uv >/dev/null 2>&1; then uv pip install --quiet --python $(BIN)/python -c constraints.txt -e '.[web]'; \
	else $(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[web]'; fi
	@touch $@

demo: $(VENV)/.run-stamp ## Test a simulated sensor: run, verdict, report, calibration file (in var/)
	@$(BIN)/cbsr-qa run --station simulated --recipe nine-locations --serial DEMO-001 --batch demo --operator demo

fleet-demo: $(VENV)/.run-stamp ## Build a fleet, compare its batches, learn how alike one is; pages in var/
	@$(BIN)/python -m cbsr_qa.cli.studies.fleet_demo
	@for design in each-on-one-station a-third-on-all-stations; do \
		printf '\n%s\n' "$$design"; \
		page="$$CBSR_QA_VAR/fleet-demo-$$design.html"; \
		$(BIN)/cbsr-qa compare --by batch --recipe $$design --database "$$CBSR_QA_VAR/fleet-demo.db" --output "$$page" || exit; \
		if [ "$$(uname)" = Darwin ] || [ -n "$$DISPLAY$$WAYLAND_DISPLAY" ]; then \
			$(BIN)/python -m webbrowser "file://$$(cd "$$CBSR_QA_VAR" && pwd -P)/$${page##*/}" >/dev/null 2>&1 || :; \
		fi; \
	done
	@printf '\nbatch 41\n'
	@$(BIN)/cbsr-qa batch model --batch 41 --database "$$CBSR_QA_VAR/fleet-demo-batch/runs.db" --output "$$CBSR_QA_VAR/fleet-demo-batch.html"

serve: $(VENV)/.web-stamp ## Open the page of a simulated line of two stations; Ctrl-C ends it
	@$(BIN)/cbsr-qa serve --station line-1 --station line-2 --recipe nine-locations --open

test: $(VENV)/.dev-stamp ## Run the tests that take minutes; names the slowest, which may be for test-rest
	@CBSR_QA_TIER=test $(PYTEST) -m "not rest" --durations=10 --durations-min=4 $(PYTEST_ARGS)

test-rest: $(VENV)/.dev-stamp ## Run all other tests, and properties on more examples
	@CBSR_QA_TIER=rest $(PYTEST) -m "rest or hypothesis" $(PYTEST_ARGS)

test-all: ## Run every test: both
	@$(MAKE) test && $(MAKE) test-rest

lint: $(VENV)/.dev-stamp ## Style
	@$(BIN)/ruff check . && $(BIN)/ruff format --check .

types: $(VENV)/.dev-stamp ## Types, strictly
	@$(BIN)/mypy

imports: $(VENV)/.dev-stamp ## The import contract
	@PYTHONPATH=. $(BIN)/lint-imports

check: lint types imports ## Style, types and import contract

site: $(VENV)/.dev-stamp ## Build the documentation as a site, to read in a browser: site/index.html
	@NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict  # --quiet would hide warnings, and let them pass

bench: $(VENV)/.dev-stamp ## Time what matters, as ratios (see benchmarks/)
	@$(BIN)/python -m benchmarks

faults: $(VENV)/.dev-stamp ## Strike every step of a run with every fault; writes docs/reference/faults.md (an hour)
	@$(BIN)/python tests/faults/campaign.py docs/reference/faults.md

soak: $(VENV)/.dev-stamp ## What takes too long for make test: see docs/reference/soak.md (an hour or more)
	@CBSR_QA_TIER=soak $(PYTEST) tests/soak $(PYTEST_ARGS)

clean: ## Remove what was made, but not var/
	rm -rf $(VENV) build dist site *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis
