//! Billboards: rotate their children to face the viewpoint.

use glam::{DAffine3, DMat3, DVec3};
use serde::{Deserialize, Serialize};

/// Rotates its children about the node's origin so that +Z points at the camera. Evaluated per renderer; reflections
/// show the orientation chosen for the camera.
///
/// As OpenSG's `Billboard`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub enum Billboard {
    /// About any axis, with +Y as close to the camera's up direction as possible: labels, sprites.
    #[default]
    Spherical,
    /// Only about this axis in local space, of any length but 0: trees.
    Cylindrical(DVec3),
}

impl Billboard {
    /// The rotation `local_from_turned` for an eye and an up direction in the node's local space. The identity if the
    /// direction is undefined: the eye is at the origin, or on the axis.
    pub fn rotation(&self, eye: DVec3, up: DVec3) -> DMat3 {
        self.try_rotation(eye, up).unwrap_or(DMat3::IDENTITY)
    }

    fn try_rotation(&self, eye: DVec3, up: DVec3) -> Option<DMat3> {
        match *self {
            Self::Spherical => {
                // An orthonormal basis with +Z towards the eye; any X if up is parallel to that.
                let z = eye.try_normalize()?;
                let x = up.cross(z).try_normalize().unwrap_or_else(|| z.any_orthonormal_vector());
                Some(DMat3::from_cols(x, z.cross(x), z))
            }
            Self::Cylindrical(axis) => {
                // The angle about the axis from +Z to the eye, both projected onto the plane perpendicular to the axis.
                let axis = axis.try_normalize()?;
                let from = DVec3::Z.reject_from_normalized(axis).try_normalize()?;
                let to = eye.reject_from_normalized(axis).try_normalize()?;
                let angle = axis.dot(from.cross(to)).atan2(from.dot(to));
                Some(DMat3::from_axis_angle(axis, angle))
            }
        }
    }

    /// The rotation in the local space of a node with this world matrix, for an eye and an up direction in world space.
    pub(crate) fn local(&self, world_from_local: &DAffine3, eye: DVec3, up: DVec3) -> DAffine3 {
        let local_from_world = world_from_local.inverse();
        // A world matrix without an inverse has no local view direction: nothing is rotated.
        let rotation = if local_from_world.is_finite() {
            self.rotation(local_from_world.transform_point3(eye), local_from_world.transform_vector3(up))
        } else {
            DMat3::IDENTITY
        };
        DAffine3::from_mat3(rotation)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn is_rotation(m: DMat3) -> bool {
        (m.transpose() * m).abs_diff_eq(DMat3::IDENTITY, 1e-12) && (m.determinant() - 1.0).abs() < 1e-12
    }

    #[test]
    fn the_front_looks_at_the_eye() {
        let eye = DVec3::new(3.0, -2.0, 5.0);
        let free = Billboard::Spherical.rotation(eye, DVec3::Y);
        assert!(is_rotation(free));
        assert!(free.z_axis.abs_diff_eq(eye.normalize(), 1e-12));
        assert!(free.y_axis.y > 0.0 && free.x_axis.y.abs() < 1e-12);

        let tree = Billboard::Cylindrical(DVec3::Y * 7.0).rotation(eye, DVec3::Y);
        assert!(is_rotation(tree));
        assert!(tree.y_axis.abs_diff_eq(DVec3::Y, 1e-12));
        assert!(tree.z_axis.abs_diff_eq(DVec3::new(3.0, 0.0, 5.0).normalize(), 1e-12));
    }

    #[test]
    fn without_a_direction_nothing_turns() {
        assert_eq!(Billboard::Spherical.rotation(DVec3::ZERO, DVec3::Y), DMat3::IDENTITY);
        assert_eq!(Billboard::Cylindrical(DVec3::Y).rotation(DVec3::Y, DVec3::Y), DMat3::IDENTITY);
        assert_eq!(Billboard::Cylindrical(DVec3::Z).rotation(DVec3::X, DVec3::Y), DMat3::IDENTITY);
        assert!(is_rotation(Billboard::Spherical.rotation(DVec3::Y, DVec3::Y)));
    }
}
