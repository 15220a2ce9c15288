//! Convex regions of world space: boxes, frustums, any intersection of half spaces.

use glam::{DAffine3, DVec3};

use super::require;
use crate::Result;
use crate::device::layout::Node;
use crate::math::Bounds;

/// One side of a plane: the points with `normal . point <= offset`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HalfSpace {
    /// Outward normal of the half space; any non-zero length.
    pub normal: DVec3,
    /// `normal . point` of the points on the plane.
    pub offset: f64,
}

impl HalfSpace {
    /// The half space with this outward normal and this point on its plane.
    pub fn through(point: DVec3, normal: DVec3) -> Self {
        Self { normal, offset: normal.dot(point) }
    }
}

/// A convex region of world space: the intersection of half spaces, including its boundary.
///
/// [`View::frustum`](crate::View::frustum) is the region that a camera sees.
#[derive(Clone, Debug, PartialEq)]
pub struct Region {
    half_spaces: Vec<HalfSpace>,
}

impl Region {
    /// The intersection of half spaces; all of space for an empty list.
    ///
    /// # Errors
    /// [`Error::OutOfRange`](crate::Error::OutOfRange) if a half space has a number that is not finite, or a zero
    /// normal.
    pub fn new(half_spaces: impl Into<Vec<HalfSpace>>) -> Result<Self> {
        let half_spaces = half_spaces.into();
        for half_space in &half_spaces {
            let HalfSpace { normal, offset } = half_space;
            let is_plane = normal.is_finite() && offset.is_finite() && *normal != DVec3::ZERO;
            require(is_plane, "half space", half_space, "finite, with a normal that is not zero")?;
        }
        Ok(Self { half_spaces })
    }

    /// An axis-aligned box in world space.
    ///
    /// # Errors
    /// [`Error::OutOfRange`](crate::Error::OutOfRange) if the box is empty or not finite.
    pub fn new_box(bounds: &Bounds) -> Result<Self> {
        let is_box = bounds.min.is_finite() && bounds.max.is_finite() && !bounds.is_empty();
        require(is_box, "box", bounds, "finite, with no lower corner above the upper one")?;
        let sides =
            DVec3::AXES.map(|axis| [HalfSpace::through(bounds.max, axis), HalfSpace::through(bounds.min, -axis)]);
        Self::new(sides.concat())
    }

    /// The half spaces of the region.
    pub fn half_spaces(&self) -> &[HalfSpace] {
        &self.half_spaces
    }
}

/// Classification of a box against a region.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Containment {
    Outside,
    /// Neither; conservative, so the box may still be outside.
    Intersecting,
    Inside,
}

/// A region prepared for traversal, in world space for the TLAS or in local space for a BLAS.
pub(super) struct TraversalRegion {
    half_spaces: Vec<HalfSpace>,
}

impl TraversalRegion {
    /// The region relative to the render origin.
    pub(super) fn relative(region: &Region, origin: DVec3) -> Self {
        let shift = |half: &HalfSpace| HalfSpace { offset: half.offset - half.normal.dot(origin), ..*half };
        Self { half_spaces: region.half_spaces.iter().map(shift).collect() }
    }

    /// The region in the local space of an instance.
    pub(super) fn transformed(&self, world_from_local: &DAffine3) -> Self {
        let to_local = world_from_local.matrix3.transpose();
        let transform = |half: &HalfSpace| HalfSpace {
            normal: to_local * half.normal,
            offset: half.offset - half.normal.dot(world_from_local.translation),
        };
        Self { half_spaces: self.half_spaces.iter().map(transform).collect() }
    }

    /// Classifies the box of a node: its centre and half extents are projected onto each normal.
    pub(super) fn classify_box(&self, node: &Node) -> Containment {
        let [min, max] = [super::to_dvec3(node.min), super::to_dvec3(node.max)];
        let (center, half) = ((min + max) * 0.5, (max - min) * 0.5);
        let mut containment = Containment::Inside;
        for half_space in &self.half_spaces {
            let distance = half_space.signed_distance(center);
            let extent = half_space.normal.abs().dot(half);
            if distance > extent {
                return Containment::Outside;
            }
            if distance > -extent {
                containment = Containment::Intersecting;
            }
        }
        containment
    }

    /// Whether the point is in the region or on its boundary.
    pub(super) fn contains(&self, point: DVec3) -> bool {
        self.half_spaces.iter().all(|half_space| half_space.signed_distance(point) <= 0.0)
    }

    /// Whether any part of the triangle is in the region: clips it by one plane after the other (I. Sutherland, G.
    /// Hodgman, *Reentrant Polygon Clipping*, 1974).
    pub(super) fn overlaps_triangle(&self, triangle: [DVec3; 3], clipper: &mut Clipper) -> bool {
        clipper.polygon.clear();
        clipper.polygon.extend(triangle);
        self.half_spaces.iter().all(|half_space| clipper.clip(half_space))
    }
}

impl HalfSpace {
    /// Signed distance to the plane, positive outside, in units of the normal's length.
    fn signed_distance(&self, point: DVec3) -> f64 {
        self.normal.dot(point) - self.offset
    }
}

/// A convex polygon, and a buffer for its clipped successor; both are reused.
#[derive(Default)]
pub(super) struct Clipper {
    polygon: Vec<DVec3>,
    clipped: Vec<DVec3>,
}

impl Clipper {
    /// Clips the polygon to the half space. Returns whether any of it is left.
    fn clip(&mut self, half_space: &HalfSpace) -> bool {
        // Walk the edges, each from the previous corner to the next.
        self.clipped.clear();
        let Some(&(mut previous)) = self.polygon.last() else { return false };
        let mut previous_distance = half_space.signed_distance(previous);
        for &corner in &self.polygon {
            let distance = half_space.signed_distance(corner);
            // An edge across the plane adds its intersection, and a corner inside adds itself.
            if (distance > 0.0) != (previous_distance > 0.0) {
                self.clipped.push(previous.lerp(corner, previous_distance / (previous_distance - distance)));
            }
            if distance <= 0.0 {
                self.clipped.push(corner);
            }
            (previous, previous_distance) = (corner, distance);
        }
        std::mem::swap(&mut self.polygon, &mut self.clipped);
        !self.polygon.is_empty()
    }
}
