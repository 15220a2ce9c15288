//! Normalization of vertex normals, with a fallback for those of length zero.

use glam::{DVec3, Vec3};

/// Upper bound of the bytes that [`normalize`] allocates for a normal.
pub(super) const BYTES_PER_NORMAL: usize = size_of::<DVec3>();

/// Scales every normal to length one. A normal of length zero (exporters write such at collapsed corners) becomes the
/// area-weighted mean of the adjacent triangles' normals, or +Z if these have no area either. O(vertices + triangles).
pub(super) fn normalize(normals: &mut [Vec3], positions: &[Vec3], triangles: &[[u32; 3]]) {
    // 1. Normalize, and mark the normals of length zero.
    let mut any_zero = false;
    for normal in normals.iter_mut() {
        *normal = try_unit_vector(normal.as_dvec3()).unwrap_or_else(|| {
            any_zero = true;
            Vec3::ZERO
        });
    }
    if !any_zero {
        return;
    }

    // 2. Sum the normals of the triangles at each vertex, weighted by area.
    let mut sums = vec![DVec3::ZERO; normals.len()];
    for triangle in triangles {
        let [a, b, c] = triangle.map(|vertex| positions[vertex as usize].as_dvec3());
        for vertex in triangle {
            // The length of the cross product is twice the area: this is the weight.
            sums[*vertex as usize] += (b - a).cross(c - a);
        }
    }

    // 3. Replace the normals of length zero.
    for (normal, sum) in normals.iter_mut().zip(sums).filter(|(normal, _)| **normal == Vec3::ZERO) {
        *normal = try_unit_vector(sum).unwrap_or(Vec3::Z);
    }
}

/// The vector scaled to length 1; `None` for the zero vector. It is f64, in which the squared length of a vector of f32
/// neither overflows nor underflows.
pub(super) fn try_unit_vector(v: DVec3) -> Option<Vec3> {
    v.try_normalize().map(DVec3::as_vec3)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn any_length_but_zero_is_kept_in_direction() {
        let positions = [Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::Z];
        let mut normals = [Vec3::X * 1e-30, Vec3::Y * 1e30, Vec3::ZERO, Vec3::ZERO];
        normalize(&mut normals, &positions, &[[0, 2, 1]]);
        // The third is the triangle's own, the fourth is in no triangle.
        assert_eq!(normals, [Vec3::X, Vec3::Y, Vec3::NEG_Z, Vec3::Z]);
    }
}
