//! Local transforms, in f64.

use glam::{DAffine3, DMat3, DQuat, DVec3};
use serde::{Deserialize, Serialize};

/// The transform of a node's children and core into the space of its parent.
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
    /// Any affine matrix.
    Matrix(DAffine3),
}

impl Default for Transform {
    fn default() -> Self {
        Self::IDENTITY
    }
}

impl Transform {
    /// Leaves everything where it is.
    pub const IDENTITY: Self = Self::Trs { translation: DVec3::ZERO, rotation: DQuat::IDENTITY, scale: DVec3::ONE };

    /// Moves by `translation`.
    pub fn from_translation(translation: DVec3) -> Self {
        Self::Trs { translation, rotation: DQuat::IDENTITY, scale: DVec3::ONE }
    }

    /// Rotates by the unit quaternion `rotation`.
    pub fn from_rotation(rotation: DQuat) -> Self {
        Self::Trs { translation: DVec3::ZERO, rotation, scale: DVec3::ONE }
    }

    /// Scales along the axes.
    pub fn from_scale(scale: DVec3) -> Self {
        Self::Trs { translation: DVec3::ZERO, rotation: DQuat::IDENTITY, scale }
    }

    /// Stands at `eye` and looks along -Z at `target`, with +Y towards `up`: the pose of a camera or a light.
    /// Where `up` is parallel to the direction of view, any perpendicular is taken.
    pub fn looking_at(eye: DVec3, target: DVec3, up: DVec3) -> Self {
        let back = (eye - target).try_normalize().unwrap_or(DVec3::Z);
        let right = up.cross(back).try_normalize().unwrap_or_else(|| back.any_orthonormal_vector());
        let rotation = DQuat::from_mat3(&DMat3::from_cols(right, back.cross(right), back));
        Self::Trs { translation: eye, rotation, scale: DVec3::ONE }
    }

    /// The same with this rotation (a unit quaternion); a shear, which only a matrix can have, is lost.
    #[must_use]
    pub fn with_rotation(self, rotation: DQuat) -> Self {
        let (scale, _, translation) = self.to_parts();
        Self::Trs { translation, rotation, scale }
    }

    /// The same at this place; a shear, which only a matrix can have, is lost.
    #[must_use]
    pub fn with_translation(self, translation: DVec3) -> Self {
        let (scale, rotation, _) = self.to_parts();
        Self::Trs { translation, rotation, scale }
    }

    fn to_parts(self) -> (DVec3, DQuat, DVec3) {
        match self {
            Self::Trs { translation, rotation, scale } => (scale, rotation, translation),
            Self::Matrix(affine) if affine.matrix3.determinant() != 0.0 => affine.to_scale_rotation_translation(),
            Self::Matrix(affine) => (DVec3::ZERO, DQuat::IDENTITY, affine.translation),
        }
    }

    /// The matrix `parent_from_local`.
    pub fn to_affine(&self) -> DAffine3 {
        match *self {
            Self::Trs { translation, rotation, scale } => {
                DAffine3::from_scale_rotation_translation(scale, rotation, translation)
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
        // A mirrored matrix may give its sign to another axis: what the transform keeps is its handedness and its place.
        assert!(matrix.matrix3.determinant() < 0.0);
        assert_eq!(matrix.translation, DVec3::X);
        assert_eq!(parts(turn).with_translation(DVec3::Y).to_affine().translation, DVec3::Y);
        let flat = Transform::Matrix(DAffine3::from_scale(DVec3::ZERO));
        assert!(flat.with_rotation(turn).is_finite());
    }
}
