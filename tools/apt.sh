# shellcheck shell=sh
# Debian packages, installed only where that takes no question. Read by the other scripts in this folder.

# fail LINE...: print the lines and exit with yamsim's code for a missing resource.
fail() {
    printf '%s\n' "$@" >&2
    exit 4
}

# apt_install WHY PACKAGE...: install as root, or through a sudo that asks for no password. Where neither may be used,
# or NO_APT is set, print the exact command and exit 4.
apt_install() {
    why=$1
    shift
    command -v apt-get >/dev/null || fail "$why" "Install your system's counterparts of these Debian packages: $*"

    # `;`, not `&&`: a third party's broken package list must not stop a package of Debian's own.
    command="apt-get update; apt-get install -y --no-install-recommends $*"
    if [ "$(id -u)" -eq 0 ]; then
        by_hand=$command
        as_root=
    elif command -v sudo >/dev/null; then
        by_hand="sudo sh -c '$command'"
        as_root="sudo -n"
    else
        by_hand="su - -c '$command'"
        as_root=false
    fi
    if [ -n "${NO_APT:-}" ] || ! $as_root true 2>/dev/null; then
        fail "$why" "Run this, then try again:" "    $by_hand"
    fi

    printf '%s\n' "$why" "Installing it: $command" >&2
    $as_root env DEBIAN_FRONTEND=noninteractive sh -c "$command" >&2 </dev/null || fail "apt-get could not install $*"
}
