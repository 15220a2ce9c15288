#!/usr/bin/env bash
# Fetches Embree 4, which the benchmarks compare with, from the PyPI wheel `embreex` (Linux, x86-64; Embree is
# Apache-2.0). Unpacks it to the folder given, by default target/embree, where the benchmarks look for it; for another
# folder set ROPEWALK_EMBREE to it. Nothing else of Ropewalk needs it.
set -euo pipefail

cd "$(dirname "$0")/.."
folder=${1:-target/embree}
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

python3 -m pip download --quiet --no-deps --only-binary=:all: --dest "$work" embreex
mkdir -p "$folder"
python3 -m zipfile -e "$work"/embreex-*.whl "$work/wheel"
cp "$work"/wheel/embreex.libs/*.so* "$folder"
ls -l "$folder"
