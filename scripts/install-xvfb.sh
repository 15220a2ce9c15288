#!/usr/bin/env bash
# Installs an X server without a monitor, and what windows need of X, on Debian, Ubuntu and their kin: the viewer is
# tested in it.
set -euo pipefail

say() { printf 'install-xvfb: %s\n' "$*" >&2; }

# shellcheck disable=SC1091
[ -r /etc/os-release ] && . /etc/os-release
case " ${ID:-} ${ID_LIKE:-} " in
*" debian "* | *" ubuntu "*) ;;
*)
    say "install Xvfb, then run this again:"
    say "  Fedora: dnf install xorg-x11-server-Xvfb    Arch: pacman -S xorg-server-xvfb    Alpine: apk add xvfb"
    exit 1
    ;;
esac

as_root=()
if [ "$(id -u)" -ne 0 ]; then
    if ! command -v sudo >/dev/null; then
        say "run as root: apt-get install xvfb"
        exit 1
    fi
    as_root=(sudo)
fi

apt=("${as_root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get -q)
"${apt[@]}" update
"${apt[@]}" install -y --no-install-recommends xvfb xkb-data libx11-6 libx11-xcb1 libxcursor1 libxi6 libxkbcommon-x11-0
