# Set-up is part of every target: a fresh machine needs Python 3.11 to 3.13 and make, nothing else.
PYTHON ?= $(firstword $(foreach p,python3.13 python3.12 python3.11 python3,$(shell \
	$(p) -c 'import sys; (3, 11) <= sys.version_info < (3, 14) and print("$(p)")' 2>/dev/null)))
BIN := .venv/bin
READY := .venv/.ready
TEST_READY := .venv/.test-ready
BENCH_READY := .venv-bench/.ready
JOBS ?= 2
unexport PYTHONDONTWRITEBYTECODE  # else every program that a test starts compiles the package anew
KERNELS ?= Haswell SkylakeX Zen Sandybridge
PIP := python -m pip install --quiet --disable-pip-version-check
COMPILE := $(BIN)/uv pip compile pyproject.toml --universal --generate-hashes --quiet --upgrade --no-emit-index-url --no-annotate

.PHONY: demo test types tests test-blas test-slow test-rerun docs bench benchmarks coverage scoreboard samples lock clean regularization

demo: $(READY)  ## fit and validate the sample leg
	$(BIN)/idtool inspect sample_logs/leg_train.mcap
	$(BIN)/idtool fit sample_logs/leg.urdf sample_logs/leg_train.mcap --validate sample_logs/leg_validate.mcap
	$(BIN)/idtool validate leg_idtool/identified.urdf sample_logs/leg_validate.csv --prior sample_logs/leg.urdf --out leg_idtool

test: $(TEST_READY)  ## style, types and tests
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(MAKE) --no-print-directory --jobs 2 types tests

types: $(TEST_READY)
	$(BIN)/mypy

# By file, so that what its tests share is made once.
tests: $(TEST_READY)
	OPENBLAS_NUM_THREADS=1 $(BIN)/pytest -n $(JOBS) --dist loadfile -m "not slow"

test-blas: $(TEST_READY)  ## the tests with OpenBLAS kernels for other CPUs, which round differently
	$(BIN)/python tests/blas_kernels.py --jobs $(JOBS) $(KERNELS)

test-slow: $(TEST_READY)  ## the tests that are too slow for CI
	OPENBLAS_NUM_THREADS=1 $(BIN)/pytest -n $(JOBS) --dist worksteal -m slow

docs: $(TEST_READY)  ## build the documentation as a site in site/; broken links are errors
	$(BIN)/mkdocs build --strict --config-file docs/mkdocs.yml

test-rerun: $(TEST_READY)  ## the tests of recordings for the rerun viewer, an optional dependency of 170 MB
	$(BIN)/$(PIP) --require-hashes -r .ci/requirements-rerun.txt
	OPENBLAS_NUM_THREADS=1 $(BIN)/pytest tests/reporting/test_rerun.py

bench: $(BENCH_READY)  ## ratios to other programs, and growth of time and memory, also as a page of the docs; FULL=1: larger sizes
	OPENBLAS_NUM_THREADS=1 .venv-bench/bin/python -W ignore benchmarks/bench.py $(if $(FULL),--full)
	.venv-bench/bin/python benchmarks/bench_page.py

benchmarks: $(TEST_READY)  ## speed and memory; each speed is a ratio of two times measured in one run
	for script in lmi mcap_reading memory parameter_ranges reduced_solve regressor simulate startup; do \
		OPENBLAS_NUM_THREADS=1 $(BIN)/python benchmarks/$$script.py || exit 1; done

coverage: $(TEST_READY)  ## how often the 95 % intervals contain the true value, on 260 simulated logs; takes minutes
	OPENBLAS_NUM_THREADS=1 $(BIN)/python benchmarks/coverage.py --jobs $(JOBS)

regularization: $(TEST_READY)  ## errors of the identified parameters for every weight of the prior, on simulated robots; takes an hour
	OPENBLAS_NUM_THREADS=1 $(BIN)/python benchmarks/regularization.py --jobs $(JOBS)

scoreboard: $(TEST_READY)  ## fraction of the effects hidden in simulated robots that `idtool diagnose` identifies; takes hours
	OPENBLAS_NUM_THREADS=1 $(BIN)/python benchmarks/scoreboard.py --jobs $(JOBS)

samples: $(TEST_READY)  ## regenerate the sample logs in MuJoCo
	$(BIN)/python sample_logs/make.py

lock: $(READY)  ## update the pinned dependencies to the newest compatible versions, for all supported Pythons
	$(BIN)/pip install --quiet uv
	$(COMPILE) --group build --output-file .ci/requirements.txt
	$(COMPILE) --extra dev --constraint .ci/requirements.txt --output-file .ci/requirements-test.txt
	$(COMPILE) --extra rerun --constraint .ci/requirements-test.txt --output-file .ci/requirements-rerun.txt
	$(COMPILE) --extra dev --group build --group bench --constraint .ci/requirements-test.txt \
		--output-file .ci/requirements-bench.txt

$(READY): .ci/requirements.txt pyproject.toml
	@test -n "$(PYTHON)" || { echo "error: Python 3.11 to 3.13 is needed; set PYTHON=/path/to/python" >&2; exit 2; }
	$(PYTHON) -m venv --clear .venv
	$(BIN)/$(PIP) --require-hashes -r .ci/requirements.txt
	$(BIN)/$(PIP) --no-deps --no-build-isolation --editable .
	touch $@

# What the tests need beyond what idtool needs, into the same environment.
$(TEST_READY): $(READY) .ci/requirements-test.txt
	$(BIN)/$(PIP) --require-hashes -r .ci/requirements-test.txt
	touch $@

# The programs that idtool is compared with take another 700 MB, and are kept out of .venv.
$(BENCH_READY): .ci/requirements-bench.txt pyproject.toml
	@test -n "$(PYTHON)" || { echo "error: Python 3.11 to 3.13 is needed; set PYTHON=/path/to/python" >&2; exit 2; }
	$(PYTHON) -m venv --clear .venv-bench
	.venv-bench/bin/$(PIP) --require-hashes -r .ci/requirements-bench.txt
	.venv-bench/bin/$(PIP) --no-deps --no-build-isolation --editable .
	touch $@

clean:
	rm -rf .venv .venv-bench *_idtool site
