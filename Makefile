# Each target makes what it needs in this folder and can be run again. With another Python, beside
# what is there: make test PYTHON=python3.13 VENV=.venv-3.13
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# Processes that run the tests, file by file. One after another: make test WORKERS=0
WORKERS := logical

.PHONY: demo test docs bench notebooks reference bars rates study campaigns clean

demo: $(VENV)/.installed
	@echo "== four estimators on a simulated park and on the recorded Victoria Park =="
	$(BIN)/ekfslam compare park victoria-park --seed 1 --out results/compare
	@echo "== the ladder: is the filter right to round-off? =="
	$(BIN)/ekfslam check ekf
	@echo "== done: tables and figures are in results/compare =="

test: $(VENV)/.tools
	@echo "== lint, format, types, tests =="
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/python -m pytest -n $(WORKERS) --maxprocesses 4 --dist loadfile

# A warning is an error. The first page is docs/_build/html/index.html.
docs: $(VENV)/.tools
	$(BIN)/python -m sphinx -W --keep-going -q -c docs -d docs/_build/trees . docs/_build/html
	@echo "== done: docs/_build/html/index.html =="

# All parts, or some: make bench PART="map-size start-up". Peers that cannot be had have empty rows.
bench: $(VENV)/.peers
	@echo "== benchmarks: ratios measured side by side in one run =="
	$(BIN)/python benchmarks/run.py $(PART)

# Runs the notebooks and rewrites the outputs that are kept in them.
notebooks: $(VENV)/.tools
	$(BIN)/python tests/executed.py

# Rewrites the stored tables that the accuracy tests compare with.
reference: $(VENV)/.tools
	$(BIN)/python tests/reference.py

# Rewrites results/association-bars.csv and results/far-starts.csv: what association without
# identities reaches, and who comes back from a wrong start.
bars: $(VENV)/.tools
	$(BIN)/python tests/bars.py
	$(BIN)/python tests/far_starts.py

# Rewrites results/plugin-rates.csv: how often the assertions of ekfslam.testing fail, rightly and
# not; a quarter of an hour.
rates: $(VENV)/.tools
	$(BIN)/python tests/plugin_rates.py

# Rewrites results/study-association.
study: $(VENV)/.installed
	$(BIN)/ekfslam study association

# Runs the campaigns of docs/consistency.md, fastslam.md and localization.md, or what is left of them: half an
# hour on two cores.
campaigns: $(VENV)/.installed
	for campaign in hard-loop loop-15 car-loop heading-sweep circle loop-15-rb \
	    particles particles-or-not known-map; do \
	  $(BIN)/ekfslam campaign experiments/$$campaign.toml --out results/$$campaign --workers 2 || exit 1; \
	done

$(VENV)/.installed: pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "ekfslam needs Python 3.11 or newer; try: make PYTHON=python3.12 $(MAKECMDGOALS)"; exit 1; }
	@echo "== setting up $(VENV) =="
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable .
	@touch $@

# What the tests and the docs need: a browser driver, Sphinx, Jupyter and the like.
$(VENV)/.tools: $(VENV)/.installed
	@echo "== adding what the tests need =="
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[test]'
	@touch $@

$(VENV)/.peers: $(VENV)/.installed
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[bench]' || \
	  echo "== the peers of the benchmark cannot be installed: their rows say so =="
	@touch $@

clean:
	rm -rf $(VENV) .pytest_cache .mypy_cache .ruff_cache
