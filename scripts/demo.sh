#!/bin/sh
# Calibrates the shipped arm CMM: prints its errors before and after, and writes the results to out/.
. "$(dirname "$0")/environment.sh"
install .
exec .venv/bin/calib calibrate robots/arm_cmm/calibration.toml -o out
