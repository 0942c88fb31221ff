#!/bin/sh
# Make sure that the slow tests have the programs they run: a browser that takes orders and a screen without hardware for
# the viewers, something else than yamsim to read a PDF with, and a Vulkan driver for `--quality photo`.
#
#   tools/ensure_test_programs.sh
#
# What is missing is installed where that takes no question.
# Exit codes: 0 all there, 4 something is missing, with the command that installs it.
set -eu

# shellcheck source=tools/apt.sh
. "$(dirname "$0")/apt.sh"

set --
if ! [ -x /usr/bin/chromium ] || ! [ -x /usr/bin/chromedriver ]; then
    set -- "$@" chromium chromium-driver
fi
command -v Xvfb >/dev/null || set -- "$@" xvfb
command -v pdftoppm >/dev/null || set -- "$@" poppler-utils
ls /usr/share/vulkan/icd.d/*.json /etc/vulkan/icd.d/*.json 2>/dev/null | grep -q . ||
    set -- "$@" libvulkan1 mesa-vulkan-drivers
[ $# -eq 0 ] || apt_install "The slow tests need programs that are not here: $*" "$@"
echo "Test programs: all here"
