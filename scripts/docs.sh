#!/bin/sh
# Builds the documentation into docs/_build/html. A warning, a broken link or a name that does not exist is an error.
. "$(dirname "$0")/environment.sh"
install '.[docs]'
rm -rf docs/_build
.venv/bin/python -m sphinx -b html -c docs -W --keep-going -n -q . docs/_build/html
if grep -rlE '(src|<link[^>]* href)="(https?:)?//' docs/_build/html --include='*.html'; then
    echo "These pages load something from another host." >&2
    exit 1
fi
echo "The documentation is docs/_build/html/index.html."
