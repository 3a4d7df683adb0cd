#!/bin/sh
# Checks and tests the whole project. CALIB_DATASETS names a folder of real measurements; without it those tests skip.
. "$(dirname "$0")/environment.sh"
install '.[dev]'
# One BLAS thread for each worker: the matrices are small, and more threads only wait for each other.
export OPENBLAS_NUM_THREADS=1
.venv/bin/ruff check .
.venv/bin/ruff format --check .
.venv/bin/mypy
.venv/bin/lint-imports
exec .venv/bin/python -m pytest -n auto "$@"
