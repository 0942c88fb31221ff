#!/bin/sh
# Make sure that the viewers can be tested: a browser that takes orders, and a screen that needs no hardware.
#
#   tools/ensure_viewers.sh
#
# What is missing is installed where that takes no question.
# Exit codes: 0 all there, 4 something is missing, with the command that installs it.
set -eu

# shellcheck source=tools/apt.sh
. "$(dirname "$0")/apt.sh"

missing=
if ! [ -x /usr/bin/chromium ] || ! [ -x /usr/bin/chromedriver ]; then
    missing="chromium chromium-driver"
fi
command -v Xvfb >/dev/null || missing="$missing xvfb"
if [ -n "$missing" ]; then
    # shellcheck disable=SC2086 # one word a package
    apt_install "The tests of \`yamsim view\` need more than is here." $missing
fi
echo "Viewers: chromium and Xvfb are here"
