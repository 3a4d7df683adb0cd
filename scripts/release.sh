#!/bin/sh
# Builds the wheel and the source distribution into dist/, and tries both in an environment that has nothing else.
. "$(dirname "$0")/environment.sh"
install '.[release]'
rm -rf dist
# Without isolation: the build tools are the pinned ones of this environment.
.venv/bin/python -m build --no-isolation .
.venv/bin/python -m twine check --strict dist/*

scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
version=$(.venv/bin/python -c 'import calib; print(calib.__version__)')
"$PYTHON" -m venv "$scratch/clean"
put() {
    "$scratch/clean/bin/python" -m pip install --quiet --disable-pip-version-check --no-compile -c constraints.txt "$@"
}
# From another folder, so that nothing of this one is imported. $1: a new folder of the example.
try() (
    cd "$scratch"
    [ "$(clean/bin/calib --version)" = "$version" ]
    clean/bin/python -W error -c 'import calib'
    clean/bin/calib demo "$1" >/dev/null
    [ -s "$1/out/report.html" ]
)
put dist/*.whl
try wheel
put --no-deps --force-reinstall dist/*.tar.gz
try source
echo "dist/ holds version $version; both files install, import and calibrate the example."
