//! Axis-aligned bounding boxes: [`Aabb`] in f32 for acceleration structures and device data, [`Bounds`] in f64 for
//! scene-graph world space.

use glam::{DAffine3, DVec3, Vec3};

/// An axis-aligned box in f32, as the acceleration structures store it. Empty where `min > max`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Aabb {
    /// The corner with the smallest coordinates.
    pub min: Vec3,
    /// The corner with the largest coordinates.
    pub max: Vec3,
}

impl Aabb {
    /// The empty box, identity of [`union`](Self::union).
    pub const EMPTY: Self = Self { min: Vec3::INFINITY, max: Vec3::NEG_INFINITY };

    /// The smallest box around the points; empty without any.
    pub fn from_points(points: impl IntoIterator<Item = Vec3>) -> Self {
        points.into_iter().fold(Self::EMPTY, |b, p| Self { min: b.min.min(p), max: b.max.max(p) })
    }

    /// The smallest box around both.
    #[must_use]
    pub fn union(self, other: Self) -> Self {
        Self { min: self.min.min(other.min), max: self.max.max(other.max) }
    }

    /// Whether the box is empty: `min > max`, or NaN, on some axis.
    pub fn is_empty(&self) -> bool {
        !self.min.cmple(self.max).all()
    }

    /// Whether `other` lies inside or on the boundary; every box contains an empty one.
    pub fn contains(&self, other: &Self) -> bool {
        other.is_empty() || (self.min.cmple(other.min).all() && self.max.cmpge(other.max).all())
    }

    /// Half the surface area, in units of length squared: the measure of the surface area heuristic. 0 if empty.
    pub fn half_area(&self) -> f32 {
        if self.is_empty() {
            return 0.0;
        }
        let d = self.max - self.min;
        d.x * d.y + d.y * d.z + d.z * d.x
    }

    /// The centre, computed without overflow.
    pub fn center(&self) -> Vec3 {
        self.min * 0.5 + self.max * 0.5
    }

    /// The box clamped to finite f32 coordinates; `None` if it is empty or NaN.
    #[inline]
    pub(crate) fn clamped_to_finite(&self) -> Option<Self> {
        let farthest = Vec3::splat(f32::MAX);
        let clamped = || Self { min: self.min.clamp(-farthest, farthest), max: self.max.clamp(-farthest, farthest) };
        (!self.is_empty()).then(clamped)
    }
}

/// An axis-aligned box in f64 world space. Empty where `min > max`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// The corner with the smallest coordinates.
    pub min: DVec3,
    /// The corner with the largest coordinates.
    pub max: DVec3,
}

impl Bounds {
    /// The empty box, identity of [`union`](Self::union).
    pub const EMPTY: Self = Self { min: DVec3::INFINITY, max: DVec3::NEG_INFINITY };

    /// The smallest box around both.
    #[must_use]
    pub fn union(self, other: Self) -> Self {
        Self { min: self.min.min(other.min), max: self.max.max(other.max) }
    }

    /// Whether the box is empty: `min > max`, or NaN, on some axis.
    pub fn is_empty(&self) -> bool {
        !self.min.cmple(self.max).all()
    }

    /// Whether `other` lies inside or on the boundary; every box contains an empty one.
    pub fn contains(&self, other: &Self) -> bool {
        other.is_empty() || (self.min.cmple(other.min).all() && self.max.cmpge(other.max).all())
    }

    /// The box relative to a point.
    pub(crate) fn relative_to(&self, point: DVec3) -> Self {
        Self { min: self.min - point, max: self.max - point }
    }

    /// The bounding box of the transformed box, in the transform's target space (J. Arvo, 1990: exact for the box, an
    /// overestimate for its contents). An empty box stays empty.
    #[must_use]
    pub fn transformed(self, affine: &DAffine3) -> Self {
        if self.is_empty() {
            return self;
        }
        let mut result = Self { min: affine.translation, max: affine.translation };
        for axis in 0..3 {
            let (a, b) = (affine.matrix3.col(axis) * self.min[axis], affine.matrix3.col(axis) * self.max[axis]);
            result.min += a.min(b);
            result.max += a.max(b);
        }
        result
    }

    /// The centre.
    pub fn center(&self) -> DVec3 {
        self.min * 0.5 + self.max * 0.5
    }

    /// The eight corners.
    pub fn corners(&self) -> [DVec3; 8] {
        std::array::from_fn(|i| {
            let pick = |axis: usize| if i >> axis & 1 == 0 { self.min[axis] } else { self.max[axis] };
            DVec3::new(pick(0), pick(1), pick(2))
        })
    }

    /// Half the length of the diagonal, which is the radius of the sphere around the box. 0 if empty.
    pub fn radius(&self) -> f64 {
        if self.is_empty() { 0.0 } else { (self.max * 0.5 - self.min * 0.5).length() }
    }
}

impl From<Aabb> for Bounds {
    fn from(aabb: Aabb) -> Self {
        Self { min: aabb.min.as_dvec3(), max: aabb.max.as_dvec3() }
    }
}
