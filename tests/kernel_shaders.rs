//! Every kernel is valid WGSL, and its structs have the layout of the Rust types.

#![allow(clippy::panic, reason = "a test fails by panicking")]

use naga::valid::{Capabilities, ValidationFlags, Validator};
use ropewalk::compile::Needs;
use ropewalk::trace::shader::EntryPoint;

fn parse(entry: EntryPoint, needs: Needs) -> naga::Module {
    let source = entry.source(needs);
    let module = naga::front::wgsl::parse_str(&source)
        .unwrap_or_else(|e| panic!("{entry:?} with {needs:?}: {}", e.emit_to_string(&source)));
    Validator::new(ValidationFlags::all(), Capabilities::empty())
        .validate(&module)
        .unwrap_or_else(|e| panic!("{entry:?} with {needs:?}: {}", e.emit_to_string(&source)));
    module
}

#[test]
fn every_kernel_is_valid_whatever_is_needed() {
    let all = Needs::all();
    let one_more_or_less = all.iter().flat_map(|flag| [flag, all - flag]);
    for needs in [Needs::empty(), all].into_iter().chain(one_more_or_less) {
        for entry in EntryPoint::ALL {
            let module = parse(entry, needs);
            assert!(module.entry_points.iter().any(|e| e.name == entry.name()), "{entry:?} is in its module");
        }
    }
}
