//! Convex regions of the world: boxes, frustums, anything between planes.

use glam::{DAffine3, DVec3};

use super::require;
use crate::Result;
use crate::device::layout::Node;
use crate::math::Bounds;

/// One side of a plane: the points with `normal . point <= offset`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HalfSpace {
    /// Points out of it; any length but zero.
    pub normal: DVec3,
    /// Where the plane is: `normal . point` of its points.
    pub offset: f64,
}

impl HalfSpace {
    /// The half space that `normal` points out of, with this point on its plane.
    pub fn through(point: DVec3, normal: DVec3) -> Self {
        Self { normal, offset: normal.dot(point) }
    }
}

/// What lies in all of some half spaces, in world space: a convex region, with its boundary.
///
/// [`View::frustum`](crate::View::frustum) makes one of what a camera sees.
#[derive(Clone, Debug, PartialEq)]
pub struct Region {
    half_spaces: Vec<HalfSpace>,
}

impl Region {
    /// Where all of these overlap; everywhere, without any.
    ///
    /// # Errors
    /// [`Error::OutOfRange`](crate::Error::OutOfRange) for a half space with a number that is not finite, or a normal of zero.
    pub fn new(half_spaces: impl Into<Vec<HalfSpace>>) -> Result<Self> {
        let half_spaces = half_spaces.into();
        for half_space in &half_spaces {
            let HalfSpace { normal, offset } = half_space;
            let is_plane = normal.is_finite() && offset.is_finite() && *normal != DVec3::ZERO;
            require(is_plane, "half space", half_space, "finite, with a normal that is not zero")?;
        }
        Ok(Self { half_spaces })
    }

    /// A box along the world's axes.
    ///
    /// # Errors
    /// [`Error::OutOfRange`](crate::Error::OutOfRange) for a box that is empty or not finite.
    pub fn new_box(bounds: &Bounds) -> Result<Self> {
        let is_box = bounds.min.is_finite() && bounds.max.is_finite() && !bounds.is_empty();
        require(is_box, "box", bounds, "finite, with no lower corner above the upper one")?;
        let sides =
            DVec3::AXES.map(|axis| [HalfSpace::through(bounds.max, axis), HalfSpace::through(bounds.min, -axis)]);
        Self::new(sides.concat())
    }

    /// What it lies between.
    pub fn half_spaces(&self) -> &[HalfSpace] {
        &self.half_spaces
    }
}

/// How a box lies to a region.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Containment {
    Outside,
    Intersecting,
    Inside,
}

/// A region in the space of one level.
pub(super) struct TraversalRegion {
    half_spaces: Vec<HalfSpace>,
}

impl TraversalRegion {
    /// The region where `origin` is the origin.
    pub(super) fn relative(region: &Region, origin: DVec3) -> Self {
        let shift = |half: &HalfSpace| HalfSpace { offset: half.offset - half.normal.dot(origin), ..*half };
        Self { half_spaces: region.half_spaces.iter().map(shift).collect() }
    }

    /// The region in local space.
    pub(super) fn transformed(&self, world_from_local: &DAffine3) -> Self {
        let to_local = world_from_local.matrix3.transpose();
        let transform = |half: &HalfSpace| HalfSpace {
            normal: to_local * half.normal,
            offset: half.offset - half.normal.dot(world_from_local.translation),
        };
        Self { half_spaces: self.half_spaces.iter().map(transform).collect() }
    }

    /// How the box of a node lies to it. `Intersecting` is a maybe.
    pub(super) fn classify_box(&self, node: &Node) -> Containment {
        let [min, max] = [super::to_dvec3(node.min), super::to_dvec3(node.max)];
        let (center, half) = ((min + max) * 0.5, (max - min) * 0.5);
        let mut side = Containment::Inside;
        for half_space in &self.half_spaces {
            let height = half_space.normal.dot(center) - half_space.offset;
            let reach = half_space.normal.abs().dot(half);
            if height > reach {
                return Containment::Outside;
            }
            if height > -reach {
                side = Containment::Intersecting;
            }
        }
        side
    }

    pub(super) fn contains(&self, point: DVec3) -> bool {
        self.half_spaces.iter().all(|half_space| half_space.signed_distance(point) <= 0.0)
    }

    /// Whether any of the triangle lies in it: clips it by one plane after the other (I. Sutherland, G. Hodgman, *Reentrant
    /// Polygon Clipping*, 1974).
    pub(super) fn overlaps_triangle(&self, triangle: [DVec3; 3], clipper: &mut Clipper) -> bool {
        clipper.polygon.clear();
        clipper.polygon.extend(triangle);
        self.half_spaces.iter().all(|half_space| clipper.clip(half_space))
    }
}

impl HalfSpace {
    /// How far the point is out of it, in units of the normal's length.
    fn signed_distance(&self, point: DVec3) -> f64 {
        self.normal.dot(point) - self.offset
    }
}

/// A convex polygon, and room for what is left of it.
#[derive(Default)]
pub(super) struct Clipper {
    polygon: Vec<DVec3>,
    clipped: Vec<DVec3>,
}

impl Clipper {
    /// Keeps what lies in the half space; whether anything does.
    fn clip(&mut self, half_space: &HalfSpace) -> bool {
        self.clipped.clear();
        let Some(&(mut previous)) = self.polygon.last() else { return false };
        let mut previous_height = half_space.signed_distance(previous);
        for &corner in &self.polygon {
            let height = half_space.signed_distance(corner);
            if (height > 0.0) != (previous_height > 0.0) {
                self.clipped.push(previous.lerp(corner, previous_height / (previous_height - height)));
            }
            if height <= 0.0 {
                self.clipped.push(corner);
            }
            (previous, previous_height) = (corner, height);
        }
        std::mem::swap(&mut self.polygon, &mut self.clipped);
        !self.polygon.is_empty()
    }
}
