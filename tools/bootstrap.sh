#!/bin/sh
# Make an empty virtual environment with Python 3.11 or newer, replacing what is there.
#
#   tools/bootstrap.sh DIRECTORY
#
# Uses $PYTHON where it is set, else the first that will do of python3, python3.11 ... python3.14. Debian and Ubuntu
# keep venv in a package of its own, which is installed where that takes no question.
# Exit codes: 0 made, 2 usage or a link in its place, 4 something is missing, with the command that installs it.
set -eu

# shellcheck source=tools/apt.sh
. "$(dirname "$0")/apt.sh"

[ $# -eq 1 ] || { echo "usage: $0 DIRECTORY" >&2; exit 2; }
directory=$1
if [ -L "$directory" ]; then
    echo "$directory is a link to $(readlink "$directory"), which would be emptied; remove the link" >&2
    exit 2
fi
if [ -n "${PYTHON:-}" ]; then
    set -- "$PYTHON"
else
    set -- python3 python3.11 python3.12 python3.13 python3.14
fi

new_enough() { "$1" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; }
has_venv() { "$1" -c 'import ensurepip, venv' 2>/dev/null; }

# A Python that lacks venv is second choice: it needs a package.
python=
for candidate in "$@"; do
    new_enough "$candidate" || continue
    if has_venv "$candidate"; then
        python=$candidate
        break
    fi
    python=${python:-$candidate}
done
[ -n "$python" ] || fail "Python 3.11 or newer is needed; none of these is: $*" \
    "Install one (Ubuntu 22.04: apt-get install python3.11 python3.11-venv), or set PYTHON to its path."

if ! has_venv "$python"; then
    version=$("$python" -c 'import sys; print("{}.{}".format(*sys.version_info))')
    apt_install "$python ($version) cannot make virtual environments: its venv package is missing." \
        "python$version-venv"
    has_venv "$python" || fail "$python still lacks ensurepip: set PYTHON to a complete Python."
fi

"$python" -m venv --clear "$directory"
