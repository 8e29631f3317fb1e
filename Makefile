# Two commands matter: `make demo` runs the whole robot on a simulated bench, `make test` tests it.
# Both set up what they need. PYTHON=python3.12 chooses another interpreter.
SHELL := /bin/bash
PYTHON ?= python3
export PYTHON
# Else each worker and each process of the graph compiles all modules again at its start.
unexport PYTHONDONTWRITEBYTECODE
VENV := .venv/bin
INSTALL := ros2_ws/install

.PHONY: help demo test test-quick test-all test-rest test-long check bench campaign damage matrix noise effects golden interfaces soak story docs setup clean picture animation figures release-check cover mutants

help: ## this list
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 12

demo: ## set up and run the whole robot on the simulated bench; Ctrl-C ends it, VERBOSE=1 prints everything
	@scripts/setup.sh
	@exec $(INSTALL)/icu_bringup/lib/icu_bringup/bring_up --profile bench --prepare $(if $(VERBOSE),--verbose)

# Three tiers, each with all of the one before: test-quick, test, test-all. A test's folder and marker (pyproject.toml)
# say to which it belongs. Three at a time on two cores: the tests of nodes wait for much of their time. Tests that
# measure times, or use the whole graph, run alone.
PYTEST := $(VENV)/python -m pytest
BESIDE := OPENBLAS_NUM_THREADS=1 $(PYTEST) -n 3 --dist loadfile --durations 12

test-quick: ## what is pure, without nodes and without a graph, in two minutes: for each edit
	@scripts/setup.sh dev
	@$(BESIDE) -q tests/unit -m "not slow and not long"

test: ## set up, run all checks, and the tests that show that the robot works, with a graph that is really started
	@scripts/setup.sh dev
	@$(MAKE) --no-print-directory check
	@$(BESIDE) tests -m "not long and not alone"; beside=$$?; \
		$(PYTEST) --durations 12 tests/system -m "not long and alone" && exit $$beside

test-all: test test-rest ## test, and long tests, the page's story, coverage, campaigns, some mutants, a short soak

test-rest: test-long cover ## what test-all has and test has not
	@$(MAKE) --no-print-directory mutants MUTANTS_OPTIONS="--only silence.py"
	@$(MAKE) --no-print-directory campaign
	@$(MAKE) --no-print-directory damage DAMAGE_SEEDS=1000
	@$(MAKE) --no-print-directory soak SOAK_MINUTES=5 SOAK_OPTIONS=--simulated

test-long:
	@scripts/setup.sh dev
	@$(BESIDE) tests -m "long and not alone"; beside=$$?; \
		$(PYTEST) --durations 12 tests -m "long and alone" && exit $$beside

check: ## lint, formatting, types, import contracts, plain English and spelling
	@scripts/setup.sh dev
	@$(VENV)/ruff check src tests benchmarks scripts && $(VENV)/ruff format --check --quiet src tests benchmarks scripts || \
		{ echo "formatting differs; mend it with: .venv/bin/ruff format src tests benchmarks scripts"; exit 1; }
	@if [ "$${ROS_DISTRO:-}" = jazzy ]; then echo "types: checked without Jazzy only, Ubuntu's OpenCV and numpy 1 have no such stubs"; \
		else $(VENV)/mypy -n 2 || { echo "once more in one process (on a busy computer workers start too late)"; $(VENV)/mypy; }; fi
	@PYTHONPATH=$$(echo src/*/ | tr ' ' ':') $(VENV)/lint-imports --no-cache
	@$(VENV)/python scripts/checks/commit_subjects.py
	@PYTHONPATH=tests $(VENV)/python -m prose.check

bench: ## measure every speed claim against a peer; results in benchmarks/out/
	@scripts/setup.sh dev
	@for file in $(filter-out benchmarks/bench_effects.py,$(wildcard benchmarks/bench_*.py benchmarks/*/bench_*.py)); do \
		echo "== $$file"; $(VENV)/python $$file || exit 1; done

# Without the tests of the mock board and the controller, which the guard does not run.
COVER_TESTS := tests/unit/gantry_driver $(addprefix --ignore=tests/unit/gantry_driver/,acceptance mock goals motion sight contact)
cover: ## branch coverage of the guard by its tests without ROS: fails below 100 %
	@scripts/setup.sh dev
	@mkdir -p artifacts/coverage && $(VENV)/coverage erase
	@OPENBLAS_NUM_THREADS=1 $(VENV)/coverage run -m pytest -q -p no:xdist $(COVER_TESTS)
	@$(VENV)/coverage combine -q && $(VENV)/coverage report

MUTANTS_OPTIONS ?=
mutants: ## small changes of the guard's pure rooms: each must fail a test, or be explained in docs/decisions/guard-mutants.md
	@scripts/setup.sh dev
	@OPENBLAS_NUM_THREADS=1 PYTHONPATH=tests:$$PYTHONPATH $(VENV)/python -m mutants.run $(MUTANTS_OPTIONS)

CAMPAIGN_SEEDS ?= 1000
campaign: ## seeded faults against the mock board; CAMPAIGN_SEEDS=5000, or FIRST:LAST to repeat some
	@scripts/setup.sh dev
	@PYTHONPATH=tests:$$PYTHONPATH $(VENV)/python -m campaign.run --seeds $(CAMPAIGN_SEEDS)

DAMAGE_SEEDS ?= 20000
DAMAGE_DIRECTION ?= both
DAMAGE_KINDS ?= bytes
damage: ## damaged bytes between driver and mock board; DAMAGE_SEEDS=FIRST:LAST and DAMAGE_DIRECTION=to_board repeat some
	@scripts/setup.sh dev
	@PYTHONPATH=tests:$$PYTHONPATH $(VENV)/python -m campaign.damage --seeds $(DAMAGE_SEEDS) \
		--direction $(DAMAGE_DIRECTION) --kinds $(DAMAGE_KINDS) --out artifacts/damage

MATRIX_RUNS ?= 200
MATRIX_SEED ?= 1
MATRIX_OPTIONS ?= --real-time
matrix: ## seeded faults of each program in each phase, on the whole graph in real time; goes on where it was broken off
	@scripts/setup.sh dev
	@PYTHONPATH=tests:$$PYTHONPATH $(VENV)/python -m matrix.run --runs $(MATRIX_RUNS) --seed $(MATRIX_SEED) \
		--out artifacts/matrix $(MATRIX_OPTIONS)

NOISE_MINUTES ?= 10
noise: ## presses on the whole graph for NOISE_MINUTES=10 while one byte in 500 is damaged on the wire
	@scripts/setup.sh dev
	@NOISE_MINUTES=$(NOISE_MINUTES) $(VENV)/python -m pytest -s tests/system/graph/test_noise_on_the_wire.py

SOAK_MINUTES ?= 30
soak: ## the whole graph at full rate for SOAK_MINUTES=30: memory, files, threads and delay must stay flat
	@scripts/setup.sh dev
	@$(VENV)/python benchmarks/robot/soak.py --minutes $(SOAK_MINUTES) $(SOAK_OPTIONS)

EFFECTS_PRESSES ?= 50
EFFECTS_ROOM ?= ideal
effects: ## presses under each effect of the simulated bench and its double; EFFECTS_PRESSES=50, EFFECTS_ROOM=ideal
	@scripts/setup.sh dev
	@$(VENV)/python benchmarks/bench_effects.py --presses $(EFFECTS_PRESSES) --room $(EFFECTS_ROOM) --workers 2

golden: ## make the golden bag (simulated bench, fixed seed) and the results that tests compare with it
	@scripts/setup.sh dev
	@PYTHONPATH=tests:$$PYTHONPATH $(VENV)/python -m golden.make_bag

interfaces: ## write topics, services and parameters of every node anew, with which a test compares the graph
	@scripts/setup.sh dev
	@RENEW_INTERFACES=1 $(VENV)/python -m pytest -q tests/system/graph/test_interfaces.py

docs: ## the site of the documents with the API pages in artifacts/site; a broken link or a missing page is an error
	@scripts/setup.sh docs
	@set -o pipefail; NO_MKDOCS_2_WARNING=1 $(VENV)/mkdocs build --strict 2>&1 | { grep -v ^INFO || true; }
	@echo "open artifacts/site/index.html"

story: ## a new user's whole way at the page on the whole graph; pictures in artifacts/story
	@scripts/setup.sh dev
	@$(VENV)/python -m pytest -s tests/system/page/test_a_whole_story.py

picture: story ## make the picture of the operator page again
	@cp artifacts/story/06_moving.png docs/operator_page.png

animation: ## record the README's press from a running demo, ADDRESS='http://127.0.0.1:8080/?token=...'
	@PYTHONPATH=tests:$$(echo src/*/ | tr ' ' ':') $(VENV)/python -m system.page.press_picture '$(ADDRESS)' -o docs/press.webp

figures: ## draw the figures of the documents from the configuration and the detector
	@scripts/setup.sh dev
	@for file in scripts/figures/*.py; do PYTHONPATH=$$(echo src/*/ | tr ' ' ':') $(VENV)/python $$file || exit 1; done

release-check: ## build the packages, install them into an empty environment, check programs, metadata and licences
	@scripts/setup.sh release
	@$(VENV)/python scripts/release/check.py

setup: ## only set up
	@scripts/setup.sh dev

clean: ## remove everything that setup made
	rm -rf .venv ros2_ws/build ros2_ws/install ros2_ws/log benchmarks/out artifacts
