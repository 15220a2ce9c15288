//! Triangle meshes: shared, immutable vertex streams.

use std::sync::Arc;

use glam::{Vec2, Vec3, Vec4};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::BlasKind;
use crate::math::Aabb;
use crate::{Error, Result};

/// An indexed triangle mesh in local space.
///
/// The streams are reference counted, so a clone is cheap and shares them. Every optional stream, where present, has
/// one element per position. Triangles wind counter-clockwise seen from their front, as in glTF.
///
/// Degenerate triangles, whose corners lie exactly on one line, are valid: they keep their indices, but are not part of
/// the surface. No ray hits them, and no query finds them.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Geometry {
    /// Vertex positions, local space, in the scene's unit of length. Finite.
    pub positions: Arc<[Vec3]>,
    /// Three indices into `positions` for each triangle.
    pub indices: Arc<[[u32; 3]]>,
    /// Unit normals, local space. `None`: flat shading.
    pub normals: Option<Arc<[Vec3]>>,
    /// Texture coordinates, sets 0 and 1; (0, 0) is the upper left corner of an image.
    pub tex_coords: [Option<Arc<[Vec2]>>; 2],
    /// Linear RGBA in 0 to 1, multiplied with the material's base colour.
    pub colors: Option<Arc<[Vec4]>>,
    /// Acceleration structure. `None`: chosen by the compiler from how often the geometry changes:
    /// [`BlasKind::default`] for static geometry, [`Quality::Low`](super::Quality::Low) after three changes in a row
    /// (each within 8 frames of the last). An explicit choice is never overridden.
    pub blas_kind: Option<BlasKind>,
}

impl Geometry {
    /// The largest number of triangles in one geometry, limited by the 28-bit first-primitive field of a leaf.
    pub const MAX_TRIANGLES: usize = 1 << 28;

    /// A geometry with positions and triangles only.
    pub fn new(positions: impl Into<Arc<[Vec3]>>, indices: impl Into<Arc<[[u32; 3]]>>) -> Self {
        Self { positions: positions.into(), indices: indices.into(), ..Self::default() }
    }

    /// A copy with this acceleration structure, see [`blas_kind`](Self::blas_kind).
    #[must_use]
    pub fn with_blas_kind(self, kind: impl Into<Option<BlasKind>>) -> Self {
        Self { blas_kind: kind.into(), ..self }
    }

    /// A copy with other positions (and normals) that shares all other streams; validates the new ones.
    pub(super) fn deformed(&self, positions: Arc<[Vec3]>, normals: Option<Arc<[Vec3]>>) -> Result<Self> {
        // Only the new streams need a check: the others were validated with this geometry.
        let vertex_count = self.positions.len();
        check_stream("positions", Some(&positions), vertex_count, |v| v.is_finite())?;
        check_stream("normals", normals.as_deref(), vertex_count, |v| v.is_finite())?;
        Ok(Self { positions, normals: normals.or_else(|| self.normals.clone()), ..self.clone() })
    }

    /// The box around the triangles of a valid geometry; vertices that none of them uses do not count. O(triangles).
    pub(super) fn bounds(&self) -> Aabb {
        let of_triangle = |triangle: &[u32; 3]| triangle.map(|vertex| self.positions[vertex as usize]);
        // Unite the boxes of chunks in parallel.
        self.indices
            .par_chunks(1 << 13)
            .map(|chunk| Aabb::from_points(chunk.iter().flat_map(of_triangle)))
            .reduce(|| Aabb::EMPTY, Aabb::union)
    }

    /// Equality, with a pointer comparison of the streams first.
    pub(super) fn has_equal_content(&self, other: &Self) -> bool {
        fn is_shared<T>(a: Option<&Arc<[T]>>, b: Option<&Arc<[T]>>) -> bool {
            match (a, b) {
                (Some(a), Some(b)) => Arc::ptr_eq(a, b),
                (a, b) => a.is_none() && b.is_none(),
            }
        }
        // Shared streams are equal without a look at their elements.
        let is_shared = Arc::ptr_eq(&self.positions, &other.positions)
            && Arc::ptr_eq(&self.indices, &other.indices)
            && is_shared(self.normals.as_ref(), other.normals.as_ref())
            && (0..2).all(|i| is_shared(self.tex_coords[i].as_ref(), other.tex_coords[i].as_ref()))
            && is_shared(self.colors.as_ref(), other.colors.as_ref())
            && self.blas_kind == other.blas_kind;
        is_shared || self == other
    }

    /// Checks that all values are finite, all indices in range and all streams of equal length. O(vertices +
    /// triangles).
    ///
    /// # Errors
    /// [`Error::InvalidGeometry`] with the array, the index and the limit.
    pub fn validate(&self) -> Result<()> {
        let vertex_count = self.positions.len();
        let invalid =
            |what, index, value: String, expected: String| Error::InvalidGeometry { what, index, value, expected };

        // Check the number of triangles, then every index.
        if self.indices.len() > Self::MAX_TRIANGLES {
            let expected = format!("at most {} triangles fit in one geometry", Self::MAX_TRIANGLES);
            return Err(invalid("indices", self.indices.len(), "present".into(), expected));
        }
        if let Some(i) = self.indices.iter().position(|t| t.iter().any(|&v| v as usize >= vertex_count)) {
            let expected = format!("there are {vertex_count} positions");
            return Err(invalid("indices", i, format!("{:?}", self.indices[i]), expected));
        }

        // Check all streams for length and finite numbers.
        check_finite("positions", &self.positions, |v| v.is_finite())?;
        for (what, stream) in [("tex_coords[0]", &self.tex_coords[0]), ("tex_coords[1]", &self.tex_coords[1])] {
            check_stream(what, stream.as_deref(), vertex_count, |v| v.is_finite())?;
        }
        check_stream("normals", self.normals.as_deref(), vertex_count, |v| v.is_finite())?;
        check_stream("colors", self.colors.as_deref(), vertex_count, |v| v.is_finite())
    }
}

fn check_stream<T: std::fmt::Debug>(
    what: &'static str,
    stream: Option<&[T]>,
    vertex_count: usize,
    is_finite: impl Fn(&T) -> bool,
) -> Result<()> {
    let Some(stream) = stream else { return Ok(()) };
    if stream.len() != vertex_count {
        let (index, value) = (stream.len(), "the length".to_owned());
        return Err(Error::InvalidGeometry {
            what,
            index,
            value,
            expected: format!("there are {vertex_count} positions"),
        });
    }
    check_finite(what, stream, is_finite)
}

fn check_finite<T: std::fmt::Debug>(what: &'static str, stream: &[T], is_finite: impl Fn(&T) -> bool) -> Result<()> {
    match stream.iter().position(|v| !is_finite(v)) {
        None => Ok(()),
        Some(index) => Err(Error::InvalidGeometry {
            what,
            index,
            value: format!("{:?}", stream[index]),
            expected: "every number must be finite".to_owned(),
        }),
    }
}
