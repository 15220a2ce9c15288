// Start-up test for drivers that silently stop long shader loops: llvmpipe of Mesa 22 ends a loop once an invocation
// has done 65,535 iterations in total, without an error, so pixels of a deep scene would be silently wrong. Each
// invocation runs the planned iterations in one loop, nested loops or loops in sequence, and writes their count and a
// value that depends on each. Twin of src/trace/gpu/probe.rs.

struct LoopCounts {
    outer: u32,
    inner: u32,
    after: u32,
    _pad: u32,
}

struct Outcome {
    iterations: u32,
    value: u32,
}

@group(0) @binding(0) var<storage, read> iterations: array<LoopCounts>;
@group(0) @binding(1) var<storage, read_write> outcomes: array<Outcome>;

fn step(value: u32) -> u32 {
    return value * 1664525u + 1013904223u;
}

@compute @workgroup_size(1)
fn probe(@builtin(global_invocation_id) id: vec3<u32>) {
    let planned = iterations[id.x];
    var outcome = Outcome(0u, id.x);
    for (var i = 0u; i < planned.outer; i++) {
        for (var j = 0u; j < planned.inner; j++) {
            outcome = Outcome(outcome.iterations + 1u, step(outcome.value));
        }
    }
    for (var i = 0u; i < planned.after; i++) {
        outcome = Outcome(outcome.iterations + 1u, step(outcome.value));
    }
    outcomes[id.x] = outcome;
}
