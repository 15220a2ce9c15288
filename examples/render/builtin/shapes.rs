//! Triangle meshes made in code. All have normals; those with a natural unwrapping have texture coordinates.

use std::f32::consts::{PI, TAU};

use glam::{Vec2, Vec3, vec2, vec3};
use ropewalk::graph::Geometry;

/// A mesh under construction.
#[derive(Default)]
struct Mesh {
    positions: Vec<Vec3>,
    normals: Vec<Vec3>,
    tex_coords: Vec<Vec2>,
    indices: Vec<[u32; 3]>,
}

impl Mesh {
    fn vertex(&mut self, position: Vec3, normal: Vec3, tex_coord: Vec2) -> u32 {
        self.positions.push(position);
        self.normals.push(normal);
        self.tex_coords.push(tex_coord);
        self.positions.len() as u32 - 1
    }

    /// Adds two triangles; the corners are counter-clockwise seen from the front.
    fn quad(&mut self, [a, b, c, d]: [u32; 4]) {
        self.indices.extend([[a, b, c], [a, c, d]]);
    }

    fn finish(self) -> Geometry {
        Geometry {
            normals: Some(self.normals.into()),
            tex_coords: [Some(self.tex_coords.into()), None],
            ..Geometry::new(self.positions, self.indices)
        }
    }
}

/// A sphere of radius 1 with `20 * 4^subdivisions` triangles: an icosahedron, each triangle cut in four.
pub(crate) fn sphere(subdivisions: u32) -> Geometry {
    const GOLDEN: f32 = 1.618_034;
    let mut positions: Vec<Vec3> = [(1.0, GOLDEN), (-1.0, GOLDEN), (1.0, -GOLDEN), (-1.0, -GOLDEN)]
        .into_iter()
        .flat_map(|(a, b)| [vec3(0.0, a, b), vec3(a, b, 0.0), vec3(b, 0.0, a)])
        .map(Vec3::normalize)
        .collect();
    let mut triangles = icosahedron_faces(&positions);

    for _ in 0..subdivisions {
        let mut middles = std::collections::HashMap::new();
        let mut middle = |a: u32, b: u32| {
            *middles.entry((a.min(b), a.max(b))).or_insert_with(|| {
                positions.push((positions[a as usize] + positions[b as usize]).normalize());
                positions.len() as u32 - 1
            })
        };
        triangles = triangles
            .into_iter()
            .flat_map(|[a, b, c]| {
                let (ab, bc, ca) = (middle(a, b), middle(b, c), middle(c, a));
                [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
            })
            .collect();
    }
    Geometry { normals: Some(positions.clone().into()), ..Geometry::new(positions, triangles) }
}

/// Every three vertices that are mutual neighbours, counter-clockwise seen from outside.
fn icosahedron_faces(positions: &[Vec3]) -> Vec<[u32; 3]> {
    let edge = positions.iter().skip(1).map(|p| p.distance(positions[0])).fold(f32::MAX, f32::min) * 1.01;
    let near = |a: usize, b: usize| positions[a].distance(positions[b]) < edge;
    let mut faces = Vec::new();
    for a in 0..positions.len() {
        for b in a + 1..positions.len() {
            for c in b + 1..positions.len() {
                if near(a, b) && near(b, c) && near(c, a) {
                    let outward = (positions[b] - positions[a]).cross(positions[c] - positions[a]).dot(positions[a]);
                    let face = if outward > 0.0 { [a, b, c] } else { [a, c, b] };
                    faces.push(face.map(|i| i as u32));
                }
            }
        }
    }
    faces
}

/// A box of these half extents; each face shows the whole texture, upright on the four sides.
pub(crate) fn cuboid(half: Vec3) -> Geometry {
    let mut mesh = Mesh::default();
    for (normal, up) in [
        (Vec3::X, Vec3::Y),
        (Vec3::NEG_X, Vec3::Y),
        (Vec3::Z, Vec3::Y),
        (Vec3::NEG_Z, Vec3::Y),
        (Vec3::Y, Vec3::NEG_Z),
        (Vec3::NEG_Y, Vec3::Z),
    ] {
        let right = up.cross(normal);
        let corners = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)].map(|(x, y)| {
            mesh.vertex((normal + right * x + up * y) * half, normal, vec2(x * 0.5 + 0.5, 0.5 - y * 0.5))
        });
        mesh.quad(corners);
    }
    mesh.finish()
}

/// A disk in the xz plane that faces up, its texture repeated every `period` units.
pub(crate) fn disk(radius: f32, segments: u32, period: f32) -> Geometry {
    let mut mesh = Mesh::default();
    let mut vertex = |x: f32, z: f32| mesh.vertex(vec3(x, 0.0, z) * radius, Vec3::Y, vec2(x, z) * radius / period);
    vertex(0.0, 0.0);
    for s in 0..segments {
        let (sin, cos) = (s as f32 / segments as f32 * TAU).sin_cos();
        vertex(cos, -sin);
    }
    mesh.indices = (0..segments).map(|s| [0, 1 + s, 1 + (s + 1) % segments]).collect();
    mesh.finish()
}

/// A square in the xz plane that faces up with sides of `2 * half`; it shows the texture once.
pub(crate) fn square(half: f32) -> Geometry {
    let mut mesh = Mesh::default();
    let corners = [(-1.0, 1.0), (1.0, 1.0), (1.0, -1.0), (-1.0, -1.0)]
        .map(|(x, z)| mesh.vertex(vec3(x, 0.0, z) * half, Vec3::Y, vec2(x, z) * 0.5 + 0.5));
    mesh.quad(corners);
    mesh.finish()
}

/// The surface of revolution of `profile`, pairs of radius and height from the bottom up, about the y axis. Normals are
/// smooth except where the profile bends by more than 40 degrees. Each of `flutes` grooves is `flute_depth` of the
/// radius deep. The texture repeats about every two units of length, a whole number of times around.
pub(crate) fn lathe(profile: &[Vec2], segments: u32, flutes: u32, flute_depth: f32) -> Geometry {
    let mut mesh = Mesh::default();
    let repeats = (0.5 * TAU * profile.iter().map(|point| point.x).fold(0.0, f32::max)).round().max(1.0);
    let outward = |i: usize| (profile[i + 1] - profile[i]).perp().normalize_or_zero() * -1.0;
    let mut along = 0.0;
    for i in 0..profile.len() - 1 {
        let smooth = |other: Option<usize>| match other {
            Some(j) if outward(j).dot(outward(i)) > 40.0_f32.to_radians().cos() => {
                (outward(i) + outward(j)).normalize_or_zero()
            }
            _ => outward(i),
        };
        let lower = smooth(i.checked_sub(1));
        let upper = smooth(Some(i + 1).filter(|&j| j + 1 < profile.len()));
        let next = along + profile[i].distance(profile[i + 1]);
        let rings = [(profile[i], lower, along), (profile[i + 1], upper, next)].map(|(point, normal, along)| {
            (0..=segments)
                .map(|s| {
                    let around = s as f32 / segments as f32;
                    let groove = 1.0 - flute_depth * (around * flutes as f32 * PI).sin().abs();
                    let (sin, cos) = (around * TAU).sin_cos();
                    let radial = vec3(cos, 0.0, -sin);
                    // d(radius)/d(angle), for the tilt of the normal in a groove.
                    let phase = around * flutes as f32 * PI;
                    let slope = -flute_depth * flutes as f32 * 0.5 * phase.cos() * phase.sin().signum();
                    let normal = (radial - vec3(-sin, 0.0, -cos) * slope / groove) * normal.x + Vec3::Y * normal.y;
                    let position = radial * point.x * groove + Vec3::Y * point.y;
                    mesh.vertex(position, normal.normalize_or_zero(), vec2(around * repeats, -0.5 * along))
                })
                .collect::<Vec<u32>>()
        });
        for s in 0..segments as usize {
            mesh.quad([rings[0][s], rings[0][s + 1], rings[1][s + 1], rings[1][s]]);
        }
        along = next;
    }
    mesh.finish()
}

/// A closed tube of this radius around a closed curve, `curve(t)` with t from 0 to 1. `side(t)` is a closed curve of
/// directions, never parallel to the tangent; it determines the position of the tube's seam.
pub(crate) fn closed_tube(
    curve: impl Fn(f32) -> Vec3,
    side: impl Fn(f32) -> Vec3,
    radius: f32,
    steps: u32,
    segments: u32,
) -> Geometry {
    let mut mesh = Mesh::default();
    let step = 1.0 / steps as f32;
    for i in 0..=steps {
        // The last ring repeats the first, exactly.
        let t = (i % steps) as f32 * step;
        let tangent = (curve(t + 0.1 * step) - curve(t - 0.1 * step)).normalize();
        let across = side(t).reject_from(tangent).normalize();
        let other = tangent.cross(across);
        for s in 0..=segments {
            let (sin, cos) = ((s % segments) as f32 / segments as f32 * TAU).sin_cos();
            let normal = across * cos + other * sin;
            let tex_coord = vec2(i as f32 * step, s as f32 / segments as f32);
            mesh.vertex(curve(t) + normal * radius, normal, tex_coord);
        }
    }
    let ring = segments + 1;
    for i in 0..steps {
        for s in 0..segments {
            let (a, b) = (i * ring + s, (i + 1) * ring + s);
            mesh.quad([a, a + 1, b + 1, b]);
        }
    }
    mesh.finish()
}

/// One of the three strands of a rope that is tied into a trefoil knot about the z axis; the others are this one
/// rotated by thirds of a turn about that axis. The knot is about 3 units wide and 1 thick.
pub(crate) fn trefoil_strand(rope_radius: f32) -> Geometry {
    /// How often a strand winds around the rope along the whole knot: a whole number, so that the strand closes, but
    /// not a multiple of three, so that rotating the knot by a third maps the strand to another one.
    const LAY: f32 = 17.0;

    // A torus knot winds three times around a tube while it goes twice around.
    let knot = |t: f32| {
        let (around, through) = (2.0 * TAU * t, 3.0 * TAU * t);
        let ring = vec3(around.cos(), around.sin(), 0.0);
        let outward = ring * through.cos() + Vec3::Z * through.sin();
        (ring + outward * 0.42, outward)
    };
    let lay = move |t: f32| {
        let (center, outward) = knot(t);
        let tangent = (knot(t + 1e-3).0 - knot(t - 1e-3).0).normalize();
        let across = outward.reject_from(tangent).normalize();
        let (sin, cos) = (TAU * LAY * t).sin_cos();
        (center, across * cos + tangent.cross(across) * sin)
    };
    // With this fraction of the rope's radius, the strands touch each other.
    let touching = (PI / 3.0).sin();
    let to_strand = rope_radius / (1.0 + touching);
    let strand = move |t: f32| lay(t).0 + lay(t).1 * to_strand;
    closed_tube(strand, move |t| lay(t).1, to_strand * touching, 1200, 16)
}
