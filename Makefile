# Two commands are all that a fresh machine needs: `make demo` and `make test`.

PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin

.PHONY: demo test lint types format results clean

demo: $(VENV)/.installed
	$(BIN)/fullturn demo --out demo_output

test: lint types
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n auto

lint: $(VENV)/.installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(VENV)/.installed
	$(BIN)/mypy

format: $(VENV)/.installed
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

# Everything in results/ and the numbers of the README and docs/limits.md, again. Needs
# `pip install ".[baselines,data]"` and DATA, the folder of the data packs; goes on where it was
# interrupted.
MVP_RG ?= runs/mvp-rg
METHODS := consensus consensus-histogram icp gicp ransac fgr kiss
RUNS := modelnet scans mvp-rg mvp-rg-blind calibration ransac-4m
results: $(VENV)/.installed
	$(BIN)/fullturn build mvp-rg --train 0 --out $(MVP_RG) \
		--shapes $(DATA)/meshes_open.npz $(DATA)/meshes_research.npz
	$(BIN)/fullturn evaluate --out results/modelnet --method $(METHODS) \
		--protocol all --shapes $(DATA)/modelnet40_subset.npz:dev_eval
	$(BIN)/fullturn evaluate --out results/scans --method $(METHODS) \
		--pairs $(DATA)/stanford_scans
	$(BIN)/fullturn evaluate --out results/mvp-rg --method $(METHODS) --pairs $(MVP_RG)
	$(BIN)/fullturn evaluate --out results/mvp-rg-blind --method consensus --blind \
		--pairs $(MVP_RG)
	$(BIN)/fullturn evaluate --out results/calibration --method consensus \
		--protocol mixture --shapes procedural:100000:1000 --count 600 --seed 1000
	$(BIN)/fullturn evaluate --out results/ransac-4m --method ransac-4m \
		--protocol modelnet40/clean/180 modelnet40/noisy/180 geotransformer/180 \
		--shapes $(DATA)/modelnet40_subset.npz:dev_eval
	for run in $(RUNS); do \
		$(BIN)/fullturn table results/$$run --out results/$$run || exit 1; done
	$(BIN)/python benchmarks/speed.py
	$(BIN)/python benchmarks/covariance.py --data $(DATA)
	$(BIN)/python benchmarks/locate.py --data $(DATA) --out results/locate.jsonl --page docs/locate.md
	$(BIN)/python benchmarks/fuse.py stanford --data $(DATA) --out results/fuse-stanford.jsonl \
		--page docs/fuse.md
	$(BIN)/python benchmarks/fuse.py views --data $(DATA) --out results/fuse-views.jsonl \
		--page docs/fuse.md
	$(BIN)/python benchmarks/limits.py $(RUNS:%=results/%) --data $(DATA) $(dir $(MVP_RG))
	$(BIN)/python benchmarks/readme.py

# The file marks a finished installation, so that the second run is quick and a broken one repeats.
$(VENV)/.installed: pyproject.toml constraints.txt
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip
	$(BIN)/python -m pip install --quiet -c constraints.txt -e ".[dev,viz]"
	touch $@

clean:
	rm -rf build dist demo_output .pytest_cache .mypy_cache .ruff_cache .hypothesis
