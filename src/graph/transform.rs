//! Local transforms, in f64.

use glam::{DAffine3, DMat3, DQuat, DVec3};
use serde::{Deserialize, Serialize};

/// Local transform: `parent_from_local`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Transform {
    /// Scale, then rotate, then translate.
    Trs {
        /// Translation, in the parent's space.
        translation: DVec3,
        /// Unit quaternion.
        rotation: DQuat,
        /// Scale along the local axes; negative mirrors.
        scale: DVec3,
    },
    /// Scale and rotate about a pivot, then translate: OpenSG's `ComponentTransform`. A point p goes to
    /// `translation + pivot + rotation * scale_rotation * scale * scale_rotation^-1 * (p - pivot)`.
    Pivoted {
        /// Translation, in the parent's space.
        translation: DVec3,
        /// Unit quaternion.
        rotation: DQuat,
        /// Scale along the axes that `scale_rotation` turns; negative mirrors.
        scale: DVec3,
        /// Unit quaternion that turns the axes of the scale.
        scale_rotation: DQuat,
        /// Centre of rotation and scale, in local space.
        pivot: DVec3,
    },
    /// Any affine matrix.
    Matrix(DAffine3),
}

impl Default for Transform {
    fn default() -> Self {
        Self::IDENTITY
    }
}

impl Transform {
    /// The identity.
    pub const IDENTITY: Self = Self::Trs { translation: DVec3::ZERO, rotation: DQuat::IDENTITY, scale: DVec3::ONE };

    /// A translation.
    pub fn from_translation(translation: DVec3) -> Self {
        Self::Trs { translation, rotation: DQuat::IDENTITY, scale: DVec3::ONE }
    }

    /// A rotation by a unit quaternion.
    pub fn from_rotation(rotation: DQuat) -> Self {
        Self::Trs { translation: DVec3::ZERO, rotation, scale: DVec3::ONE }
    }

    /// A scale along the axes.
    pub fn from_scale(scale: DVec3) -> Self {
        Self::Trs { translation: DVec3::ZERO, rotation: DQuat::IDENTITY, scale }
    }

    /// The pose of a camera or light at `eye`, with -Z towards `target` and +Y as close to `up` as possible. If `up` is
    /// parallel to the view direction, an arbitrary perpendicular is used.
    pub fn looking_at(eye: DVec3, target: DVec3, up: DVec3) -> Self {
        // An orthonormal basis whose +Z points away from the target.
        let back = (eye - target).try_normalize().unwrap_or(DVec3::Z);
        let right = up.cross(back).try_normalize().unwrap_or_else(|| back.any_orthonormal_vector());
        let rotation = DQuat::from_mat3(&DMat3::from_cols(right, back.cross(right), back));
        Self::Trs { translation: eye, rotation, scale: DVec3::ONE }
    }

    /// A copy with another rotation (unit quaternion). A matrix is decomposed first; its shear is lost.
    #[must_use]
    pub fn with_rotation(self, rotation: DQuat) -> Self {
        // A pivoted transform keeps its pivot and the axes of its scale.
        if let Self::Pivoted { translation, scale, scale_rotation, pivot, .. } = self {
            return Self::Pivoted { translation, rotation, scale, scale_rotation, pivot };
        }
        let (scale, _, translation) = self.to_scale_rotation_translation();
        Self::Trs { translation, rotation, scale }
    }

    /// A copy with another translation.
    #[must_use]
    pub fn with_translation(self, translation: DVec3) -> Self {
        match self {
            Self::Trs { rotation, scale, .. } => Self::Trs { translation, rotation, scale },
            Self::Pivoted { rotation, scale, scale_rotation, pivot, .. } => {
                Self::Pivoted { translation, rotation, scale, scale_rotation, pivot }
            }
            Self::Matrix(affine) => Self::Matrix(DAffine3 { translation, ..affine }),
        }
    }

    fn to_scale_rotation_translation(self) -> (DVec3, DQuat, DVec3) {
        let affine = match self {
            Self::Trs { translation, rotation, scale } => return (scale, rotation, translation),
            Self::Pivoted { .. } | Self::Matrix(_) => self.to_affine(),
        };
        // A singular matrix has no unique rotation: only its translation is kept.
        if affine.matrix3.determinant() != 0.0 {
            affine.to_scale_rotation_translation()
        } else {
            (DVec3::ZERO, DQuat::IDENTITY, affine.translation)
        }
    }

    /// The matrix `parent_from_local`.
    pub fn to_affine(&self) -> DAffine3 {
        match *self {
            Self::Trs { translation, rotation, scale } => {
                DAffine3::from_scale_rotation_translation(scale, rotation, translation)
            }
            Self::Pivoted { translation, rotation, scale, scale_rotation, pivot } => {
                // Scale along the turned axes, then rotate; the pivot moves by the translation only.
                let turn = DMat3::from_quat(scale_rotation);
                let linear = DMat3::from_quat(rotation) * turn * DMat3::from_diagonal(scale) * turn.transpose();
                DAffine3 { matrix3: linear, translation: translation + pivot - linear * pivot }
            }
            Self::Matrix(affine) => affine,
        }
    }

    /// Whether every number in it is finite.
    pub fn is_finite(&self) -> bool {
        match self {
            Self::Trs { translation, rotation, scale } => {
                translation.is_finite() && rotation.is_finite() && scale.is_finite()
            }
            Self::Pivoted { translation, rotation, scale, scale_rotation, pivot } => {
                let vectors = [translation, scale, pivot];
                vectors.into_iter().all(|v| v.is_finite()) && rotation.is_finite() && scale_rotation.is_finite()
            }
            Self::Matrix(affine) => affine.is_finite(),
        }
    }
}

impl From<DAffine3> for Transform {
    fn from(affine: DAffine3) -> Self {
        Self::Matrix(affine)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_part_is_replaced_and_the_others_stay() {
        let (turn, other) = (DQuat::from_rotation_y(0.5), DQuat::from_rotation_x(1.0));
        let parts = |rotation| Transform::Trs { translation: DVec3::X, rotation, scale: DVec3::new(1.0, 2.0, -3.0) };
        assert_eq!(parts(other).with_rotation(turn), parts(turn));
        let matrix = Transform::Matrix(parts(other).to_affine()).with_rotation(turn).to_affine();
        // A mirrored matrix may give its sign to another axis: the transform keeps its handedness and its translation.
        assert!(matrix.matrix3.determinant() < 0.0);
        assert_eq!(matrix.translation, DVec3::X);
        assert_eq!(parts(turn).with_translation(DVec3::Y).to_affine().translation, DVec3::Y);
        let moved = Transform::Matrix(parts(turn).to_affine()).with_translation(DVec3::Y).to_affine();
        assert_eq!((moved.matrix3, moved.translation), (parts(turn).to_affine().matrix3, DVec3::Y));
        let flat = Transform::Matrix(DAffine3::from_scale(DVec3::ZERO));
        assert!(flat.with_rotation(turn).is_finite());
    }

    /// OpenSG's order: T * C * R * SR * S * SR^-1 * C^-1.
    #[test]
    fn a_pivot_stays_where_it_is() {
        let (pivot, translation) = (DVec3::new(1.0, 2.0, 3.0), DVec3::new(10.0, 0.0, -4.0));
        let (rotation, scale_rotation) = (DQuat::from_rotation_y(0.7), DQuat::from_rotation_z(0.4));
        let scale = DVec3::new(2.0, 1.0, 0.5);
        let pivoted = Transform::Pivoted { translation, rotation, scale, scale_rotation, pivot };
        let affine = pivoted.to_affine();
        assert!(affine.transform_point3(pivot).abs_diff_eq(pivot + translation, 1e-12));
        let factors = [
            DAffine3::from_translation(translation),
            DAffine3::from_translation(pivot),
            DAffine3::from_quat(rotation),
            DAffine3::from_quat(scale_rotation),
            DAffine3::from_scale(scale),
            DAffine3::from_quat(scale_rotation.inverse()),
            DAffine3::from_translation(-pivot),
        ];
        let product = factors.into_iter().fold(DAffine3::IDENTITY, |product, factor| product * factor);
        assert!(affine.abs_diff_eq(product, 1e-12));
        assert_eq!(pivoted.with_rotation(rotation), pivoted);
        assert_eq!(pivoted.with_translation(translation), pivoted);
    }
}
