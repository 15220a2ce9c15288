#!/usr/bin/env bash
# Runs every test, the GPU tests too: where no usable adapter is found, a software Vulkan driver is installed first.
set -euo pipefail
cd "$(dirname "$0")/.."

# GPU tests fail, not skip, without an adapter.
export ROPEWALK_REQUIRE_GPU=1

if ! cargo test --locked --quiet --test tracers -- --exact trace::gpu::device::an_adapter_serves; then
    echo "No usable GPU adapter (see above): installing a software Vulkan driver."
    bash scripts/install-vulkan.sh
fi
if [ -z "${ROPEWALK_SCENES:-}" ]; then
    echo "skipped: tests that need sample scenes (ROPEWALK_SCENES names no folder)"
fi

cargo test --locked --quiet --doc
if cargo nextest --version >/dev/null 2>&1; then
    cargo nextest run --locked --no-fail-fast -p ropewalk -p ropewalk-fuzz -p ropewalk-testkit
else
    cargo test --locked --no-fail-fast -p ropewalk -p ropewalk-fuzz -p ropewalk-testkit --lib --bins --tests --examples
fi

# The viewer is tested in a window. Where there is no X server without a monitor, one is installed first.
if [ "$(uname -s)" = Linux ]; then
    export ROPEWALK_REQUIRE_WINDOW=1
    if ! command -v Xvfb >/dev/null; then
        bash scripts/install-xvfb.sh
    fi
fi
cargo test --locked --no-fail-fast -p ropewalk-viewer
