//! Rays, aimed.

use fastrand::Rng;
use glam::Vec3;
use ropewalk::device::layout::RayRecord;

/// Coordinates that are multiples of this have so few bits that the difference of two is exact in f32, and so is a ray
/// from one to the other.
const STEP: f32 = 1.0 / (1 << 12) as f32;

/// The nearest point whose coordinates have so few bits.
pub fn quantised(point: Vec3) -> Vec3 {
    (point / STEP).round() * STEP
}

/// From 0 to any distance.
pub fn ray(origin: Vec3, direction: Vec3) -> RayRecord {
    RayRecord { origin: origin.to_array(), t_min: 0.0, direction: direction.to_array(), t_max: f32::MAX }
}

/// A number between -1 and 1.
pub fn signed(random: &mut Rng) -> f32 {
    2.0 * random.f32() - 1.0
}

/// A point of the cube from -1 to 1.
pub fn point(random: &mut Rng) -> Vec3 {
    Vec3::new(signed(random), signed(random), signed(random))
}

/// A unit vector.
pub fn direction(random: &mut Rng) -> Vec3 {
    loop {
        let direction = point(random);
        if (0.01..=1.0).contains(&direction.length_squared()) {
            return direction.normalize();
        }
    }
}

/// One of the triangles.
pub fn any(random: &mut Rng, triangles: &[[Vec3; 3]]) -> [Vec3; 3] {
    triangles[random.usize(0..triangles.len())]
}

/// A point within a triangle, rounded.
pub fn inside(random: &mut Rng, [a, b, c]: [Vec3; 3]) -> Vec3 {
    let (u, v) = (random.f32(), random.f32());
    let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
    a + (b - a) * u + (c - a) * v
}

/// A corner.
pub fn corner(random: &mut Rng, corners: [Vec3; 3]) -> Vec3 {
    corners[random.usize(0..3)]
}

/// A point of an edge: sixteenths of it, so that it has few bits if the corners have.
pub fn on_edge(random: &mut Rng, corners: [Vec3; 3]) -> Vec3 {
    let first = random.usize(0..3);
    let [from, to] = [corners[first], corners[(first + 1) % 3]];
    from + (to - from) * (random.u32(1..16) as f32 / 16.0)
}

/// From each origin to a point of a triangle: half of the rays to a point within, a quarter each through a corner and
/// through an edge, exactly so if corners and origins are [quantised].
pub fn at_all_parts(
    random: &mut Rng,
    count: usize,
    triangles: &[[Vec3; 3]],
    mut origin: impl FnMut(&mut Rng) -> Vec3,
) -> Vec<RayRecord> {
    let aimed = |i: usize| {
        let corners = any(random, triangles);
        let target = match i % 4 {
            0 => corner(random, corners),
            1 => on_edge(random, corners),
            _ => inside(random, corners),
        };
        let origin = origin(random);
        (target != origin).then(|| ray(origin, target - origin))
    };
    (0..count).filter_map(aimed).collect()
}
