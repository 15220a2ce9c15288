#!/usr/bin/env bash
# Installs Mesa's software Vulkan driver on Debian, Ubuntu and their kin: GPU tests run on it where there is no GPU.
# Prefers the distribution's backports, since Mesa before 23 ends long shader loops early, without an error.
# The system's list of package sources stays as it is: backports are looked up in a copy of it.
set -euo pipefail

say() { printf 'install-vulkan: %s\n' "$*" >&2; }

# shellcheck disable=SC1091
[ -r /etc/os-release ] && . /etc/os-release
case " ${ID:-} ${ID_LIKE:-} " in
*" debian "* | *" ubuntu "*) ;;
*)
    say "install a Vulkan driver and its loader, then run this again:"
    say "  Fedora: dnf install mesa-vulkan-drivers vulkan-loader"
    say "  Arch: pacman -S vulkan-swrast vulkan-icd-loader    Alpine: apk add mesa-vulkan-swrast vulkan-loader"
    say "  elsewhere: the driver of your GPU's maker (macOS and Windows bring Metal and Direct3D 12)"
    exit 1
    ;;
esac

as_root=()
if [ "$(id -u)" -ne 0 ]; then
    if ! command -v sudo >/dev/null; then
        say "run as root: apt-get install mesa-vulkan-drivers libvulkan1"
        exit 1
    fi
    as_root=(sudo)
fi

work=$(mktemp -d)
trap '"${as_root[@]}" rm -rf "$work"' EXIT
chmod 755 "$work"
mkdir -p "$work/sources.list.d" "$work/lists/partial"
cp /etc/apt/sources.list.d/*.list /etc/apt/sources.list.d/*.sources "$work/sources.list.d/" 2>/dev/null || true
backports=${VERSION_CODENAME:-none}-backports

# The sources of the release itself, with the release's name replaced: the same mirror, the same key.
# Both formats: lines ("deb URI bookworm main") and stanzas ("Suites: bookworm bookworm-updates").
backports_lines() {
    cat /etc/apt/sources.list /etc/apt/sources.list.d/*.list 2>/dev/null |
        grep -E "^deb(-src)? .*[[:space:]]${VERSION_CODENAME}[[:space:]]" | grep -E '^deb ' |
        sed -E "s/([[:space:]])${VERSION_CODENAME}([[:space:]])/\1${backports}\2/" | head -n 1
}
backports_stanzas() {
    awk -v release="$VERSION_CODENAME" -v backports="$backports" '
        function flush() { if (serves && !found) { printf "%s", stanza; found = 1 } stanza = ""; serves = 0 }
        /^[[:space:]]*$/ { flush(); next }
        /^Suites:/ { for (i = 2; i <= NF; i++) if ($i == release) serves = 1; $0 = "Suites: " backports }
        { stanza = stanza $0 "\n" }
        END { flush() }
    ' <(for file in /etc/apt/sources.list.d/*.sources; do
        [ -e "$file" ] && cat "$file" && echo
    done)
}

apt=("${as_root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get -q
    -o "Dir::Etc::SourceParts=$work/sources.list.d" -o "Dir::State::Lists=$work/lists")
packages=(mesa-vulkan-drivers libvulkan1)

if [ "${ID:-}" = debian ] && [ -n "${VERSION_CODENAME:-}" ]; then
    backports_lines >"$work/sources.list.d/backports.list" || true
    [ -s "$work/sources.list.d/backports.list" ] || backports_stanzas >"$work/sources.list.d/backports.sources"
    if "${apt[@]}" update && "${apt[@]}" install -y --no-install-recommends -t "$backports" "${packages[@]}"; then
        exit 0
    fi
    say "$backports cannot be had from this mirror; taking the release's own driver"
    rm -f "$work/sources.list.d/backports.list" "$work/sources.list.d/backports.sources"
fi
"${apt[@]}" update
"${apt[@]}" install -y --no-install-recommends "${packages[@]}"
