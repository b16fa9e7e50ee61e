# Needs Python 3.11 or newer, make, and the packages that pip downloads.

PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
INSTALLED := $(VENV)/.installed
LSNET_PIPE := $(BIN)/lsnet-pipe
DEMO_STORE := --store demo/store

SEED ?= 1

.PHONY: attacks help demo test lint types contracts wheel slow reliability reliability-short bench bench-tracks bench-inspection clean

help:
	@echo "make demo       simulate a flight, process it, ask three questions, draw a picture"
	@echo "make test       the fast tests"
	@echo "make lint       ruff"
	@echo "make types      mypy, strict"
	@echo "make contracts  who may import what"
	@echo "make wheel      build the wheel, use it in a new environment"
	@echo "make slow       the tests that take minutes, npm or much disk"
	@echo "make bench      speed and memory against what else does the same, some minutes"
	@echo "make bench-tracks         lines followed over simulated flights, beside the nearest neighbour"
	@echo "make bench-inspection     anomalies, coverage and queries against simulated flights, half an hour"
	@echo "make reliability-short    kills, stops and repeats of batches, a few minutes"
	@echo "make reliability          the same with 500 kills and 10,000 recordings, hours"
	@echo "make attacks SEED=1       500 hostile inputs, some minutes; exit 1 for a traceback, hang or loss"
	@echo "make clean      remove what was built, but not $(VENV)"

$(INSTALLED): pyproject.toml constraints.txt
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet -c constraints.txt -e '.[dev,int8]'
	touch $@

demo: $(INSTALLED)
	rm -rf demo
	mkdir demo
	$(LSNET_PIPE) simulate demo/demo.mcap --seconds 30 --fps 3 --fault conductor_gap --spans demo/spans.geojson
	$(LSNET_PIPE) process demo/demo.mcap $(DEMO_STORE)
	$(LSNET_PIPE) spans import demo/spans.geojson $(DEMO_STORE)
	$(LSNET_PIPE) query "SELECT n_frames, n_bad_frames, n_lines, duration_s, frame_coverage FROM flight_summary" $(DEMO_STORE)
	$(LSNET_PIPE) query "SELECT frame_idx, n_lines, sharpness::INTEGER AS sharpness, infer_ms::INTEGER AS infer_ms FROM frames ORDER BY n_lines DESC, frame_idx LIMIT 5" $(DEMO_STORE)
	$(LSNET_PIPE) query "SELECT floor(angle_deg / 30)::INTEGER * 30 AS angle_from_deg, count(*) AS n_lines, avg(length_px)::INTEGER AS mean_length_px FROM lines GROUP BY ALL ORDER BY ALL" $(DEMO_STORE)
	$(LSNET_PIPE) overlay last -o demo/overlay.png $(DEMO_STORE)
	@echo
	@echo "recording      demo/demo.mcap, its truth demo/demo.truth.json"
	@echo "annotated copy $$(ls demo/store/flights/*/annotated.mcap); in Lichtblick or Foxglove: $(LSNET_PIPE) view last $(DEMO_STORE)"
	@echo "index          demo/store/index.duckdb, for $(LSNET_PIPE) query \"...\" $(DEMO_STORE)"
	@echo "picture        demo/overlay.png"
	@echo "report         $(LSNET_PIPE) report last --open $(DEMO_STORE)"
	@echo "               a gap was planted in a conductor; decide about it by $(LSNET_PIPE) review last --open $(DEMO_STORE)"

# Without what some environments set: both workers would compile all modules, and so would every command.
test: export PYTHONDONTWRITEBYTECODE =
test: $(INSTALLED)
	$(BIN)/python -m pytest -q -n auto --dist loadfile

attacks: $(INSTALLED)
	$(BIN)/python tests/attacks/run.py --seed $(SEED)

lint: $(INSTALLED)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(INSTALLED)
	$(BIN)/mypy

contracts: $(INSTALLED)
	$(BIN)/lint-imports

wheel: $(INSTALLED)
	$(BIN)/python -m pytest -q -m slow tests/test_packaging.py

slow: $(INSTALLED)
	$(BIN)/python -m pytest -q -m 'slow and not reliability'

reliability: $(INSTALLED)
	$(BIN)/python -m pytest -q -m reliability

reliability-short: $(INSTALLED)
	$(BIN)/python -m pytest -q -n auto -m 'reliability and not slow'

# RIVAL=M-LSD_512_tiny_fp32.tflite of github.com/navervision/mlsd
# SETS="DIR..." of evaluation sets, to hold the precisions against each other
bench: $(INSTALLED)
	$(BIN)/python benchmarks/bench_speed.py $(if $(RIVAL),--rival $(RIVAL))
	PYTHONPATH=. $(BIN)/python benchmarks/bench_frame.py
	PYTHONPATH=. $(BIN)/python benchmarks/bench_process.py
	$(if $(SETS),$(BIN)/python benchmarks/bench_precision.py $(SETS))
	$(BIN)/python benchmarks/bench_help.py
	$(BIN)/python benchmarks/bench_encode.py
	$(BIN)/python benchmarks/bench_append.py
	$(BIN)/python benchmarks/bench_store.py
	$(BIN)/python benchmarks/bench_report.py

bench-tracks: $(INSTALLED)
	$(BIN)/python benchmarks/bench_tracks.py
	PYTHONPATH=. $(BIN)/python benchmarks/bench_track_support.py $(if $(GROUND),--ground $(GROUND)) \
	  $(if $(WIRE_FREE),--wire-free $(WIRE_FREE))

# MATRIX=full for harder flights; SHORT=1 for a look of some minutes
SEEDS ?= 20
DRAWN ?= 2
CLEAN ?= 60
MATRIX ?= basic
FLIGHTS ?= 1000
bench-inspection: $(INSTALLED)
	$(BIN)/python benchmarks/bench_inspection.py --matrix $(MATRIX) $(if $(SHORT),--short) --seeds $(SEEDS) --clean $(CLEAN) \
	  --drawn $(DRAWN) --drawn-clean $(DRAWN) --flights $(FLIGHTS)

clean:
	rm -rf build dist demo *.egg-info .pytest_cache .hypothesis .mypy_cache .ruff_cache .import_linter_cache
	find . -name __pycache__ -not -path './$(VENV)/*' -prune -exec rm -rf {} +
