#!/usr/bin/env bash
# Runs the benchmarks `trace`, `table1` and `scaling` with the cargo feature `gpu`, and writes device, driver, backend,
# features, commit and all tables to one JSON file. Where there is no GPU it says so, and so does the file: then it
# holds no figure of a GPU.
#
#   scripts/gpu-bench.sh [FILE [OPTION...]]
#
# FILE: target/gpu-bench.json by default. OPTIONs go to the benchmarks: --quick, say.
#
# For a machine without network or cargo: build elsewhere (cargo bench -p ropewalk-bench --features gpu --no-run), take
# the executables along (cargo prints where they are; `trace-0123456789abcdef` may keep its name) and set
# ROPEWALK_BENCH_BIN to their folder. Scenes are looked for in ROPEWALK_SCENES.
set -euo pipefail
cd "$(dirname "$0")/.."

file=${1:-target/gpu-bench.json}
shift || true
benches=(trace table1 scaling)
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
mkdir -p "$(dirname "$file")"

# The newest executable of that name, with cargo's suffix or without.
find_bench() {
    # shellcheck disable=SC2012
    ls -t "$ROPEWALK_BENCH_BIN/$1" "$ROPEWALK_BENCH_BIN/$1"-* 2>/dev/null | grep -v '\.d$' | head -n 1 || true
}

run_bench() {
    local name=$1
    shift
    if [ -z "${ROPEWALK_BENCH_BIN:-}" ]; then
        cargo bench --locked -p ropewalk-bench --features gpu --bench "$name" -- "$@"
        return
    fi
    local program
    program=$(find_bench "$name")
    if [ -z "$program" ]; then
        echo "gpu-bench: no $name in $ROPEWALK_BENCH_BIN" >&2
        return 1
    fi
    "$program" "$@"
}

failed=()
for name in "${benches[@]}"; do
    echo "== $name"
    run_bench "$name" --json "$work/$name.json" "$@" || failed+=("$name")
    # A missed goal or a missing scene is no reason to lose the other tables.
    [ -s "$work/$name.json" ] || echo null >"$work/$name.json"
done

if grep -qs '"software": false' "$work"/*.json; then
    device=GPU
    about="Measured on the adapter that each table names."
elif grep -qs '"software": true' "$work"/*.json; then
    device=software
    about="There was no GPU: the adapter is a software renderer, its rows are left out, and nothing here is a figure of a GPU."
else
    device=none
    about="There was no adapter at all: nothing here is a figure of a GPU."
fi

{
    printf '{\n"device": "%s",\n"about": "%s",\n' "$device" "$about"
    printf '"commit": "%s",\n' "$(git describe --always --dirty 2>/dev/null || echo unknown)"
    printf '"date": "%s",\n"cargo_features": ["gpu"],\n"options": "%s",\n"tables": {\n' "$(date -u +%FT%TZ)" "$*"
    separator=""
    for name in "${benches[@]}"; do
        printf '%s"%s": ' "$separator" "$name"
        cat "$work/$name.json"
        separator=","
    done
    printf '}\n}\n'
} >"$file"

echo "gpu-bench: $about Written to $file."
if [ ${#failed[@]} -gt 0 ]; then
    echo "gpu-bench: failed: ${failed[*]}" >&2
    exit 1
fi
