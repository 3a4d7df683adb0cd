#!/bin/sh
# Checks and tests the whole project. CALIB_DATASETS names a folder of real measurements; without it those tests skip.
. "$(dirname "$0")/environment.sh"
install '.[dev]'
# One BLAS thread for each worker: the matrices are small, and more threads only wait for each other.
export OPENBLAS_NUM_THREADS=1
# Compiled modules are kept, whatever the environment says: the workers, and some hundred processes that tests start,
# load calib, and to compile it is half of what that costs.
unset PYTHONDONTWRITEBYTECODE
.venv/bin/ruff check .
.venv/bin/ruff format --check .
.venv/bin/mypy
.venv/bin/lint-imports
# The tests of one module stay on one worker: what they share is made once.
exec .venv/bin/python -m pytest -n auto --dist loadscope "$@"
