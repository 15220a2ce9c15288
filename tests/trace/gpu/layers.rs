//! Shadows through glass whose triangles are in several leaves are as dark as through glass whose triangles are in one
//! leaf each.

use ropewalk::accel::{Blas, BlasBuildParams};
use ropewalk::device::DeviceArrays;
use ropewalk::device::Needs;
use ropewalk::device::layout::{InstanceFlags, InstanceRecord, LIGHT_DIRECTIONAL, LightRecord, MaterialFlags};
use ropewalk::glam::Vec3;
use ropewalk::graph::{BlasKind, Geometry};
use ropewalk::image::Image;
use ropewalk::trace::{Cpu, Emulated, FrameRequest, Tracer, Traversal};

use super::soup::{params, soup};
use ropewalk_testkit::Random;
use ropewalk_testkit::gpu::tracer;

const COUNT: u32 = 60;

/// Large panes that go through each other, in the light.
fn panes(structure: BlasKind, flags: InstanceFlags) -> DeviceArrays {
    let mut random = Random::new(9);
    let positions: Vec<Vec3> = (0..3 * COUNT).map(|_| Vec3::from(random.in_cube().to_array()) * 4.0).collect();
    let indices: Vec<[u32; 3]> = (0..COUNT).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
    let blas = Blas::build(&Geometry::new(positions, indices), &BlasBuildParams::new(structure)).unwrap();
    assert_eq!(blas.has_duplicates, structure == BlasKind::KdTree);

    let mut arrays = soup(1, &mut random);
    let instance = InstanceRecord { flags: flags.bits(), ..arrays.instances[0] };
    arrays.instances.replace(&[instance]);
    arrays.blas_nodes.replace(&blas.nodes);
    arrays.wide_nodes.replace(&blas.wide_nodes);
    let mut streams = arrays.geometries[0];
    streams.first_wide_node = 0;
    arrays.geometries.replace(&[streams]);
    arrays.triangles.replace(&blas.triangles);
    let mut leaf = arrays.tlas_nodes[0];
    (leaf.min, leaf.max) = ([-3.0; 3], [3.0; 3]);
    arrays.tlas_nodes.replace(&[leaf]);
    let mut material = arrays.materials[0];
    material.base_color = [0.9, 0.8, 0.7, 0.1];
    material.flags = MaterialFlags::BLEND.bits();
    arrays.materials.replace(&[material]);
    let mut light: LightRecord = bytemuck::Zeroable::zeroed();
    (light.kind, light.direction, light.color) = (LIGHT_DIRECTIONAL, [0.0, -0.6, -0.8], [5.0; 3]);
    light.range = f32::MAX;
    arrays.lights.replace(&[light]);
    arrays
}

fn draw(tracer: &mut dyn Tracer, arrays: &mut DeviceArrays) -> Image {
    let mut params = params(48, 48);
    (params.light_count, params.max_depth) = (1, 2);
    tracer.upload(arrays).unwrap();
    tracer.render(arrays, &FrameRequest::new(params, Needs::BLEND | Needs::LIGHTS)).unwrap();
    tracer.read_image().unwrap()
}

/// How many pixels differ by more than rounding.
fn differences(a: &Image, b: &Image) -> usize {
    let differs = |(a, b): &(&[f32; 4], &[f32; 4])| (0..3).any(|i| (a[i] - b[i]).abs() > 1e-4 * b[i].abs().max(1.0));
    a.color.iter().zip(&b.color).filter(differs).count()
}

#[test]
fn a_pane_in_several_leaves_darkens_once() {
    let once = InstanceFlags::TRANSLUCENT;
    let expected = draw(&mut Emulated::default(), &mut panes(BlasKind::default(), once));
    let emulated = |layout| -> Box<dyn Tracer> { Box::new(Emulated::default().with_traversal(layout)) };
    for mut tracer in [emulated(Traversal::Rope), emulated(Traversal::Wide), Box::new(Cpu::default())] {
        let layered = draw(&mut *tracer, &mut panes(BlasKind::KdTree, once | InstanceFlags::HAS_DUPLICATES));
        assert_eq!(differences(&layered, &expected), 0, "{:?}", tracer.device());
        // Without the flag for duplicate triangles the shadow is too dark.
        let count = differences(&draw(&mut *tracer, &mut panes(BlasKind::KdTree, once)), &expected);
        assert!(count > 20, "{count} pixels, {:?}", tracer.device());
    }
}

#[test]
fn the_gpu_sees_the_same_layers() {
    let Some(mut gpu) = tracer() else { return };
    let flags = InstanceFlags::TRANSLUCENT | InstanceFlags::HAS_DUPLICATES;
    let expected = draw(&mut Emulated::default(), &mut panes(BlasKind::KdTree, flags));
    let found = draw(&mut gpu, &mut panes(BlasKind::KdTree, flags));
    let count = differences(&found, &expected);
    assert!(count * 200 < expected.color.len(), "{count} of {} pixels differ", expected.color.len());
}
