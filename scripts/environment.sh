# Sourced by the other scripts of this folder: makes .venv beside this folder, with the exact versions of constraints.txt.
set -eu
cd "$(dirname "$0")/.."
PYTHON=${PYTHON:-python3}
"$PYTHON" -c 'import sys; sys.exit(sys.version_info < (3, 11))' || {
    echo "This needs Python 3.11 or newer; set PYTHON to one." >&2
    exit 1
}
[ -x .venv/bin/python ] || "$PYTHON" -m venv .venv
# $1: what to install, "." or ".[dev]".
install() {
    .venv/bin/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e "$1"
}
