#!/bin/sh
# Make a virtual environment with everything the product and its tests need.
# usage: setup.sh VENV_DIR      (PYTHON=... chooses another interpreter)
set -eu
venv=$1
python=${PYTHON:-python3}

"$python" - <<'PY' || exit 1
import sys
if sys.version_info < (3, 11):
    sys.exit(f"skyfolio needs Python 3.11 or newer; {sys.executable} is {sys.version.split()[0]} (set PYTHON=...)")
PY

make_venv() { "$python" -m venv --clear "$venv"; }

if ! make_venv 2>/dev/null; then
    # Debian ships venv apart from Python; as root it can be had here, otherwise say what is missing.
    if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
        apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq python3-venv
        make_venv
    else
        echo "python venv is missing: install it first (Debian: apt-get install python3-venv)" >&2
        exit 1
    fi
fi
"$venv/bin/python" -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev]'
# the folders as one package, for tools that read sources and follow no import hook (mypy, editors)
mkdir -p "$venv/typing/skyfolio"
for part in planner mavlink_bridge sim api; do ln -sfn "$PWD/$part" "$venv/typing/skyfolio/$part"; done
for part in __init__.py __main__.py sweep.py py.typed; do ln -sfn "$PWD/api/skyfolio/$part" "$venv/typing/skyfolio/$part"; done
