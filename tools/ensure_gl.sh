#!/bin/sh
# Make sure that MuJoCo can render without a display.
#
#   tools/ensure_gl.sh [PYTHON]        PYTHON has yamsim installed; default .venv/bin/python
#
# Renders one small picture with each backend in turn, with $MUJOCO_GL alone where that is set. Only if none works,
# Mesa's software renderer is installed, where that takes no question.
# Exit codes: 0 a backend works, 4 none does, with the command that installs one.
set -eu

# shellcheck source=tools/apt.sh
. "$(dirname "$0")/apt.sh"

python=${1:-.venv/bin/python}
backends=${MUJOCO_GL:-egl osmesa}

if [ "$(uname)" = Darwin ]; then
    echo "OpenGL: macOS brings its own"
    exit 0
fi
"$python" -c 'import importlib.util, sys; sys.exit(importlib.util.find_spec("yamsim_cli") is None)' ||
    fail "$python has no yamsim: run 'make setup' first."

report=$(mktemp)
trap 'rm -f "$report"' EXIT

# renders BACKEND: whether it draws; what went wrong is added to $report. The same trial that yamsim makes before it draws.
renders() {
    MUJOCO_GL=$1 "$python" - >>"$report" 2>&1 <<'END'
import os

from yamsim_cli.core.errors import ResourceError
from yamsim_cli.gl import find_backend

try:
    find_backend(os.environ)
except ResourceError as error:
    raise SystemExit(str(error)) from None
END
}

# Print the first backend that renders and exit; come back if there is none.
stop_if_one_works() {
    : >"$report"
    for backend in $backends; do
        if renders "$backend"; then
            echo "OpenGL: $backend works"
            exit 0
        fi
    done
}

stop_if_one_works
for backend in $backends; do
    # What a bare system lacks. EGL finds Mesa's drivers in a package of their own, and PyOpenGL loads the GL functions
    # from libOpenGL; libOSMesa holds everything itself, but Mesa 25 and later no longer ship it.
    case $backend in
    egl) set -- libegl1 libegl-mesa0 libgl1-mesa-dri libopengl0 ;;
    osmesa) set -- libosmesa6 ;;
    *) fail "MUJOCO_GL=$backend does not work here: $(tail -n 1 "$report")" "Unset it, or choose egl or osmesa." ;;
    esac
    apt_install "No OpenGL backend works (tried: $backends)." "$@"
    stop_if_one_works
done
fail "No OpenGL backend works (tried: $backends):" "$(cat "$report")"
