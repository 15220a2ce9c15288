//! Matrices that flatten space: what of it they leave, and the nearest matrix that can be inverted.

use glam::{DMat3, DVec3};

/// What a linear map makes of space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum MappedSpace {
    /// Space itself: the matrix can be inverted.
    Space,
    /// A plane: one direction is scaled to zero. `normal` is that of the plane (in the space mapped to), `axis` the
    /// direction that is lost (in the space mapped from). Both have length 1.
    Plane { normal: DVec3, axis: DVec3 },
    /// A line or a point, in which no surface can be seen.
    Line,
}

/// A scale this small, relative to the others, is the rounding error of one that is zero.
const ZERO_SCALE: f64 = 1.0 / (1_u64 << 40) as f64;

impl MappedSpace {
    /// What the matrix makes of space. A scale that is zero but for rounding, below a rotation, counts as zero.
    pub(crate) fn of(matrix: &DMat3) -> Self {
        let size = largest_column(matrix);
        if size == 0.0 || !size.is_finite() {
            return Self::Line;
        }
        // Most matrices are far from flat: neither the columns nor the area between them are longer than `size`.
        if matrix.determinant().abs() > ZERO_SCALE * size.powi(3) {
            return Self::Space;
        }
        // 1. The cofactors of the matrix, scaled to columns of at most length 1, so that no product overflows. Of a
        //    matrix that maps to a plane, each column is the plane's normal times a component of the lost axis.
        let unit = *matrix * (1.0 / size);
        let (x, y, z) = (unit.x_axis, unit.y_axis, unit.z_axis);
        let cofactors = DMat3::from_cols(y.cross(z), z.cross(x), x.cross(y));
        // 2. The largest of them: twice the area of a triangle between two columns.
        let area = largest_column(&cofactors);
        if area <= ZERO_SCALE {
            return Self::Line;
        }
        // 3. The volume over the area is the height of the third column above the other two.
        if unit.determinant().abs() > ZERO_SCALE * area {
            return Self::Space;
        }
        let columns = [cofactors.x_axis, cofactors.y_axis, cofactors.z_axis];
        let largest = columns.into_iter().max_by(|a, b| a.length_squared().total_cmp(&b.length_squared()));
        let normal = largest.unwrap_or(DVec3::Z).normalize();
        Self::Plane { normal, axis: (cofactors.transpose() * normal).normalize() }
    }
}

/// The thickness of what is flattened, relative to the largest scale: 2^-11. Rays are traced in local space, where they
/// are longer along the lost axis by the inverse of this. Both the rows of the inverse matrix, rounded to f32, and the
/// tolerance of the triangle test, which grows with the depth along the ray, then move points within the plane by up to
/// 2^-22 of the distance over the thickness: this thickness makes that error equal to itself.
const THICKNESS: f64 = 1.0 / (1 << 11) as f64;

/// The matrix itself if it can be inverted. One that flattens space to a plane gets a least thickness along the axis
/// that it has lost, so that what lies in the plane can be traced as any other surface. `None` for a line or a point.
///
/// The plane keeps the orientation of a matrix whose determinant is positive, as for a rasterizer, to which 0 is not
/// negative.
pub(crate) fn with_least_thickness(matrix: &DMat3) -> Option<DMat3> {
    match MappedSpace::of(matrix) {
        MappedSpace::Space => Some(*matrix),
        MappedSpace::Plane { normal, axis } => {
            let height = normal * (largest_column(matrix) * THICKNESS);
            Some(*matrix + DMat3::from_cols(height * axis.x, height * axis.y, height * axis.z))
        }
        MappedSpace::Line => None,
    }
}

/// The length of the longest column.
fn largest_column(matrix: &DMat3) -> f64 {
    matrix.x_axis.length().max(matrix.y_axis.length()).max(matrix.z_axis.length())
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DQuat;

    /// The scale, its zeros at every place, below and above rotations.
    fn scaled(scale: DVec3, turn: f64) -> DMat3 {
        let rotation = DMat3::from_quat(DQuat::from_axis_angle(DVec3::new(1.0, 2.0, 3.0).normalize(), turn));
        rotation * DMat3::from_diagonal(scale) * rotation.transpose()
    }

    #[test]
    fn the_dimensions_that_are_left_are_counted_in_spite_of_rounding() {
        for size in [1e-30, 1.0, 1e30] {
            for turn in [0.0, 0.7, 2.0] {
                let of = |x, y, z| MappedSpace::of(&scaled(DVec3::new(x, y, z) * size, turn));
                assert_eq!(of(1.0, -2.0, 3.0), MappedSpace::Space);
                assert_eq!(of(1.0, 1e-6, 1.0), MappedSpace::Space);
                assert_eq!(of(0.0, 0.0, 3.0), MappedSpace::Line);
                assert_eq!(of(0.0, 0.0, 0.0), MappedSpace::Line);
                for (x, y, z) in [(0.0, 1.0, 2.0), (-1.0, 0.0, 2.0), (1.0, 1.0, 0.0)] {
                    assert!(matches!(of(x, y, z), MappedSpace::Plane { .. }), "{size} {turn} {x} {y} {z}");
                }
            }
        }
    }

    #[test]
    fn a_flat_matrix_becomes_invertible_and_moves_points_by_less_than_it_says() {
        for turn in [0.0, 0.7, 2.0] {
            let flat = scaled(DVec3::new(-2.0, 0.0, 3.0), turn);
            let solid = with_least_thickness(&flat).unwrap();
            assert!(solid.determinant() > 0.0);
            for point in [DVec3::X, DVec3::Y, DVec3::Z, DVec3::ONE] {
                let moved = (solid * point - flat * point).length();
                assert!(moved <= 3.001 * THICKNESS * point.length(), "{turn}: {point} moved by {moved}");
            }
            assert!((solid.inverse() * solid).abs_diff_eq(DMat3::IDENTITY, 1e-9));
        }
    }
}
