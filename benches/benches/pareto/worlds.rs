//! Distance from the world's origin against how far things are displaced: a world in f32, and ours, which is relative
//! to the camera.
//!
//! A cube of two metres stands ten metres from the camera, both far away from the world's origin. Displaced is a corner
//! by the distance between where it is drawn and where the scene's f64 transform puts it, relative to the camera.

use glam::{DAffine3, DMat3, DQuat, DVec3, Mat3, Vec3};
use ropewalk::compile::Compiler;
use ropewalk::{Core, Material, Scene, Transform};
use ropewalk_bench::columns::soup;
use ropewalk_bench::meshes::cube;
use ropewalk_bench::{Report, Result, Target};

use crate::Run;
use crate::chart::{Axis, Chart, Curve, Panel, Point, Scale};

/// What is promised where nothing is sheared, as a share of the distance to the render origin.
const TURNED: f64 = 1.0 / (1 << 22) as f64;
/// Above this share an instance counts as displaced, and the compiler reports by how much.
const REPORTED: f64 = 1.0 / (1 << 20) as f64;

pub fn measure(run: &Run, report: &mut Report) -> Result<Chart> {
    let poses = if run.is_quick { 8 } else { 64 };
    let mut panels = Vec::new();
    for (title, shear) in [("Turned", 1.0), ("Sheared, 1 to 1,000", 1e3)] {
        let [mut in_f32, mut drawn, mut bounds] = [const { Vec::new() }; 3];
        for exponent in 0..=9 {
            let distance = 10f64.powi(exponent);
            let mut worst = [0.0_f64; 3];
            for pose in 0..poses {
                let errors = displacements(distance, f64::from(pose), shear)?;
                worst = [0, 1, 2].map(|i: usize| worst[i].max(errors[i]));
            }
            let points = [&mut in_f32, &mut drawn, &mut bounds].into_iter().zip(worst);
            points.for_each(|(points, y)| points.push(Point { x: distance, y, ..Point::default() }));
            if exponent >= 4 {
                let name = format!("worlds_{}_camera_relative_by_f32_1e{exponent}", title[..6].to_lowercase());
                report.goal(name, worst[1] / worst[0], Target::AtMost(1.0), "x");
            }
            let name = format!("worlds_{}_drawn_by_bound_1e{exponent}", title[..6].to_lowercase());
            report.goal(name, worst[1] / worst[2], Target::AtMost(1.0), "x");
        }
        drawn.iter_mut().for_each(|point| point.is_default = true);
        let curve = |name: &str, points| Curve { name: name.to_owned(), is_joined: true, points };
        panels.push(Panel {
            title,
            x: Axis { name: "distance from the world's origin, metres", scale: Scale::Log },
            y: Axis { name: "greatest displacement ten metres from the camera, metres", scale: Scale::Log },
            front: None,
            curves: vec![
                curve("f32 world", in_f32),
                curve("relative to the camera", drawn),
                curve("the bound that is promised or reported", bounds),
            ],
        });
        run.progress(&format!("worlds, {title}"));
    }
    Ok(Chart { name: "worlds", panels })
}

/// The greatest displacement of a corner in a world in f32, in ours, and the bound for ours, in metres.
fn displacements(distance: f64, pose: f64, shear: f64) -> Result<[f64; 3]> {
    let turn = |angle: f64| DMat3::from_quat(DQuat::from_axis_angle(DVec3::new(0.3, -0.5, 0.8).normalize(), angle));
    let scale = DMat3::from_diagonal(DVec3::new(1.0 / shear, 1.0 / shear.sqrt(), 1.0));
    let linear = turn(pose * 2.3 + 1.0) * scale * turn(pose);
    let camera = DVec3::new(0.8, 0.36, -0.48) * distance;
    let away = turn(pose * 1.7) * DVec3::X * 10.0;
    let place = DAffine3::from_mat3_translation(linear, camera + away);
    let triangles = cube(1);

    // 1. The compiler's matrix, from which rays are drawn, and the bound for it.
    let mut scene = Scene::new();
    let geometry = scene.add_geometry(soup(&triangles))?;
    let material = scene.add_material(Material::default())?;
    let node = scene.add(scene.root(), Transform::Matrix(place))?;
    scene.add(node, Core::Geometry { geometry, material })?;
    let mut compiler = Compiler::new();
    let report = compiler.compile(&mut scene, camera)?;
    let rows = compiler.arrays().instances[0].local_from_world.map(|row| row.map(f64::from));
    let local_linear = DMat3::from_cols_array_2d(&rows.map(|[x, y, z, _]| [x, y, z])).transpose();
    let local_from_world = DAffine3::from_mat3_translation(local_linear, DVec3::from_array(rows.map(|row| row[3])));
    let drawn = local_from_world.inverse();
    let relative = place.translation - compiler.origin();
    let share = match report.displaced_instances {
        0 if shear == 1.0 => TURNED,
        0 => REPORTED,
        _ => report.greatest_displacement,
    };

    // 2. The same with everything rounded to f32 where it is in the world.
    let (world, translation): (Mat3, Vec3) = (linear.as_mat3(), place.translation.as_vec3());

    let mut worst = [0.0_f64; 3];
    for corner in triangles.iter().flatten() {
        // From the camera, so that f64 itself displaces by nothing.
        let offset = linear * corner.as_dvec3();
        let exact = offset + relative;
        let ours = (drawn.transform_point3(corner.as_dvec3()) - exact).length();
        let in_f32 = (world * *corner + translation).as_dvec3() - place.translation - offset;
        let coordinates = exact.abs().max_element() + relative.abs().max_element();
        let bound = share * coordinates * 3f64.sqrt();
        worst = [worst[0].max(in_f32.length()), worst[1].max(ours), worst[2].max(bound)];
    }
    Ok(worst)
}
