//! Coincident triangles: those that a geometry states more than once.
//!
//! No builder can separate them, so that a ray through n of them would test all n. They are the same surface, and one
//! stands for all: the one of the lowest index, which would win at equal distance anyway. Two triangles coincide if the
//! corners of one are those of the other, from whichever corner on, in the same winding, and so are all attributes that
//! decide whether and how much light passes: texture coordinates and colours. Triangles of opposite winding do not
//! coincide, since a ray that culls one may hit the other; and normals need not be equal, since they decide nothing but
//! the shading of the triangle that is hit.

use std::collections::HashMap;
use std::hash::{Hash, Hasher};
use std::sync::{Mutex, PoisonError};

use glam::Vec3;
use rayon::prelude::*;

use crate::accel::tree::PrimitiveReference;
use crate::graph::Geometry;

/// The triangles that were left out of a structure because they coincide with others in it.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct MergedTriangles {
    /// How many there are.
    count: usize,
    /// Those that can come apart when the geometry changes, since they do not have the same vertices: each with the
    /// triangle that stands for it.
    separable: Vec<[u32; 2]>,
}

impl MergedTriangles {
    /// How many triangles were left out.
    pub(crate) fn count(&self) -> usize {
        self.count
    }

    /// Whether they still coincide in `geometry`, which has the same list of triangles. O(triangles left out that have
    /// vertices of their own).
    pub(crate) fn still_coincide(&self, geometry: &Geometry) -> bool {
        let coincide = |&[left_out, kept]: &[u32; 2]| {
            let is_there = (left_out.max(kept) as usize) < geometry.indices.len();
            is_there && CoincidenceKey { geometry, primitive: left_out } == CoincidenceKey { geometry, primitive: kept }
        };
        self.separable.par_iter().with_min_len(1 << 12).all(coincide)
    }
}

/// Collects the triangles of a geometry that builders leave out because they coincide with others.
///
/// Coincident triangles have equal boxes, and so has every part of them that a builder clips off. No split by boxes or
/// centres separates them: builders offer to [`merge`](Self::merge) what has one centre, or is about to be split in
/// another way. Elsewhere there is nothing to search.
pub(in crate::accel) struct CoincidentTriangles<'a> {
    geometry: &'a Geometry,
    /// The triangles left out, each with one that coincides with it and has a lower index. In no particular order, and
    /// a triangle of which several leaves hold parts is there for each.
    found: Mutex<Vec<[u32; 2]>>,
}

impl<'a> CoincidentTriangles<'a> {
    pub(in crate::accel) fn new(geometry: &'a Geometry) -> Self {
        Self { geometry, found: Mutex::default() }
    }

    /// Keeps of each set of coincident triangles the one of the lowest index, and moves the references that are kept to
    /// the front, in their order. Returns how many there are. O(n).
    pub(in crate::accel) fn merge(&self, references: &mut [PrimitiveReference]) -> usize {
        let (mut count, mut found) = (0, Vec::new());
        let mut search = PlaceSearch::new(self.geometry, references.len());
        for i in 0..references.len() {
            let reference = references[i];
            match search.find_or_add(&references[..count], &reference) {
                None => {
                    references[count] = reference;
                    count += 1;
                }
                // The lower index is kept, in the place of the first.
                Some(place) => {
                    let kept = references[place].primitive();
                    let primitive = reference.primitive();
                    found.push([kept.max(primitive), kept.min(primitive)]);
                    if primitive < kept {
                        references[place] = reference;
                    }
                }
            }
        }
        if !found.is_empty() {
            self.found.lock().unwrap_or_else(PoisonError::into_inner).append(&mut found);
        }
        count
    }

    /// What was left out.
    pub(in crate::accel) fn finish(self) -> MergedTriangles {
        let mut found = self.found.into_inner().unwrap_or_else(PoisonError::into_inner);
        found.par_sort_unstable();
        found.dedup_by_key(|[left_out, _]| *left_out);
        let count = found.len();
        found.retain(|&[left_out, kept]| !have_same_vertices(self.geometry, left_out, kept));
        MergedTriangles { count, separable: found }
    }
}

/// Finds the triangle among those that are kept with which another one coincides.
enum PlaceSearch<'a> {
    /// Compares all pairs.
    Pairs(&'a Geometry),
    /// By the corners, for more than a few.
    Hashed(&'a Geometry, HashMap<CoincidenceKey<'a>, usize>),
}

/// The most triangles of which all pairs are compared.
const MAX_PAIRED: usize = 16;

impl<'a> PlaceSearch<'a> {
    fn new(geometry: &'a Geometry, count: usize) -> Self {
        if count <= MAX_PAIRED { Self::Pairs(geometry) } else { Self::Hashed(geometry, HashMap::new()) }
    }

    /// The place in `kept` of a triangle that coincides with this one; if there is none, this one will be at the end.
    fn find_or_add(&mut self, kept: &[PrimitiveReference], reference: &PrimitiveReference) -> Option<usize> {
        match self {
            Self::Pairs(geometry) => {
                let key =
                    |reference: &PrimitiveReference| CoincidenceKey { geometry, primitive: reference.primitive() };
                kept.iter().position(|other| has_same_box(other, reference) && key(other) == key(reference))
            }
            Self::Hashed(geometry, places) => {
                let key = CoincidenceKey { geometry, primitive: reference.primitive() };
                let place = *places.entry(key).or_insert(kept.len());
                (place < kept.len()).then_some(place)
            }
        }
    }
}

/// Whether two references have equal boxes.
fn has_same_box(a: &PrimitiveReference, b: &PrimitiveReference) -> bool {
    let [a, b] = [a, b].map(PrimitiveReference::bounds);
    a.min.truncate() == b.min.truncate() && a.max.truncate() == b.max.truncate()
}

/// Whether the same vertices are the corners of both triangles, from whichever corner on.
fn have_same_vertices(geometry: &Geometry, a: u32, b: u32) -> bool {
    let [a, b] = [a, b].map(|primitive| geometry.indices[primitive as usize]);
    (0..3).any(|first| [0, 1, 2].map(|corner| b[(first + corner) % 3]) == a)
}

/// A triangle of a geometry; equal to those that coincide with it.
#[derive(Clone, Copy)]
struct CoincidenceKey<'a> {
    geometry: &'a Geometry,
    primitive: u32,
}

impl CoincidenceKey<'_> {
    fn vertices(&self) -> [usize; 3] {
        self.geometry.indices[self.primitive as usize].map(|vertex| vertex as usize)
    }

    fn position(&self, vertex: usize) -> Vec3 {
        self.geometry.positions.get(vertex).copied().unwrap_or(Vec3::NAN)
    }

    /// The bits of the texture coordinates and the colour of a vertex; zeros for what there is not.
    fn attribute_bits(&self, vertex: usize) -> [u32; 8] {
        let Geometry { tex_coords, colors, .. } = self.geometry;
        let tex_coord = |set: usize| {
            let stream = tex_coords[set].as_deref().and_then(|stream| stream.get(vertex));
            stream.map_or([0; 2], |uv| uv.to_array().map(f32::to_bits))
        };
        let ([u0, v0], [u1, v1]) = (tex_coord(0), tex_coord(1));
        let color = colors.as_deref().and_then(|stream| stream.get(vertex));
        let [r, g, b, a] = color.map_or([0; 4], |color| color.to_array().map(f32::to_bits));
        [u0, v0, u1, v1, r, g, b, a]
    }
}

impl PartialEq for CoincidenceKey<'_> {
    fn eq(&self, other: &Self) -> bool {
        // Turn the other triangle so that it begins with the same corner; no two corners of a triangle are equal.
        let (ours, theirs) = (self.vertices(), other.vertices());
        let first_position = self.position(ours[0]);
        let Some(first) = (0..3).find(|&corner| self.position(theirs[corner]) == first_position) else { return false };
        let theirs = [0, 1, 2].map(|corner| theirs[(first + corner) % 3]);
        // Compare the other positions, then the attributes.
        let mut corners = ours.into_iter().zip(theirs);
        corners.clone().all(|(a, b)| self.position(a) == self.position(b))
            && corners.all(|(a, b)| a == b || self.attribute_bits(a) == self.attribute_bits(b))
    }
}

impl Eq for CoincidenceKey<'_> {}

impl Hash for CoincidenceKey<'_> {
    fn hash<H: Hasher>(&self, state: &mut H) {
        // From the corner on whose position has the least bits; zeros of either sign are equal.
        let corners =
            self.vertices().map(|vertex| ((self.position(vertex) + 0.0).to_array().map(f32::to_bits), vertex));
        let first = (1..3).fold(0, |least, corner| if corners[corner].0 < corners[least].0 { corner } else { least });
        for (position, vertex) in [0, 1, 2].map(|corner| corners[(first + corner) % 3]) {
            (position, self.attribute_bits(vertex)).hash(state);
        }
    }
}

#[cfg(test)]
mod tests {
    use glam::{IVec3, Vec2, Vec4};

    use super::*;
    use crate::accel::{Blas, BlasBuildParams};
    use crate::graph::{BlasKind, Quality};

    const STRUCTURES: [BlasKind; 4] =
        [BlasKind::Bvh(Quality::Low), BlasKind::Bvh(Quality::Medium), BlasKind::Bvh(Quality::High), BlasKind::KdTree];

    /// The triangles that are in a structure, ascending, and what is left out.
    fn kept(geometry: &Geometry, structure: BlasKind) -> (Vec<u32>, MergedTriangles) {
        let blas = Blas::build(geometry, &BlasBuildParams::new(structure)).unwrap();
        let mut kept: Vec<u32> = blas.triangles.iter().map(|triangle| triangle.primitive).collect();
        kept.sort_unstable();
        kept.dedup();
        (kept, blas.merged().clone())
    }

    /// The triangles that are left out of a geometry, the same for all structures, and those of them that can come
    /// apart from the ones that are kept.
    fn merged(geometry: &Geometry) -> (Vec<u32>, Vec<u32>) {
        let mut results = STRUCTURES.map(|structure| {
            let (kept, merged) = kept(geometry, structure);
            let left_out: Vec<u32> = (0..geometry.indices.len() as u32).filter(|p| !kept.contains(p)).collect();
            assert_eq!(left_out.len(), merged.count(), "{structure:?}");
            (left_out, merged.separable.iter().map(|pair| pair[0]).collect::<Vec<u32>>())
        });
        assert!(results.iter().all(|result| *result == results[0]), "{results:?}");
        std::mem::take(&mut results[0])
    }

    /// A triangle, and each that has its corners, from vertices of their own: three of the same winding, three of the
    /// other.
    fn six_arrangements() -> Geometry {
        let corners = [Vec3::new(0.0, -0.0, 1.0), Vec3::X, Vec3::Y];
        let other = [Vec3::new(-0.0, 0.0, 1.0), Vec3::X, Vec3::Y];
        let positions: Vec<Vec3> = corners.into_iter().chain(other).collect();
        Geometry::new(positions, [[0, 1, 2], [4, 5, 3], [5, 3, 4], [3, 5, 4], [2, 1, 0], [1, 0, 2]])
    }

    #[test]
    fn triangles_coincide_from_whichever_corner_but_not_in_the_other_winding() {
        assert_eq!(merged(&six_arrangements()), (vec![1, 2, 4, 5], vec![1, 2, 4, 5]));
        let shared = Geometry::new([Vec3::ZERO, Vec3::X, Vec3::Y], [[0, 1, 2], [1, 2, 0], [0, 1, 2]]);
        assert_eq!(merged(&shared), (vec![1, 2], vec![]), "the same vertices never come apart");
    }

    #[test]
    fn attributes_that_decide_whether_light_passes_must_be_equal_and_normals_need_not() {
        let geometry = six_arrangements();
        let normals = Geometry { normals: Some((0..6).map(|i| Vec3::new(1.0, i as f32, 0.0)).collect()), ..geometry };
        assert_eq!(merged(&normals).0, [1, 2, 4, 5]);
        let geometry = six_arrangements();
        for set in 0..2 {
            let mut other = geometry.clone();
            other.tex_coords[set] = Some([0.0, 0.0, 0.0, 0.0, 0.0, 0.5].map(Vec2::splat).into());
            assert_eq!(merged(&other).0, [2, 5], "texture coordinates {set}");
        }
        let other = Geometry { colors: Some([1.0, 1.0, 1.0, 1.0, 0.5, 1.0].map(Vec4::splat).into()), ..geometry };
        assert_eq!(merged(&other).0, [2, 5]);
    }

    #[test]
    fn triangles_that_share_less_are_kept() {
        // Two corners, the plane, or the box in common; and two degenerate triangles, which are left out elsewhere.
        let corners = [Vec3::ZERO, Vec3::X, Vec3::ONE.with_z(0.0), Vec3::Y];
        let geometry =
            Geometry::new(corners, [[0, 1, 2], [0, 2, 3], [0, 1, 3], [1, 2, 3], [2, 1, 0], [0, 0, 1], [0, 0, 1]]);
        for structure in STRUCTURES {
            let (kept, merged) = kept(&geometry, structure);
            assert_eq!((kept, merged.count()), (vec![0, 1, 2, 3, 4], 0), "{structure:?}");
        }
    }

    #[test]
    fn a_change_is_noticed_that_parts_them() {
        let geometry = six_arrangements();
        let (_, merged) = kept(&geometry, BlasKind::default());
        assert!(merged.still_coincide(&geometry));
        let moved = |vertex: usize, position: Vec3| {
            let mut positions = geometry.positions.to_vec();
            positions[vertex] = position;
            Geometry { positions: positions.into(), ..geometry.clone() }
        };
        assert!(!merged.still_coincide(&moved(4, Vec3::X * 2.0)));
        let both = Geometry { positions: geometry.positions.iter().map(|p| *p * 3.0).collect(), ..geometry.clone() };
        assert!(merged.still_coincide(&both));
        let cut = Geometry { colors: Some([1.0, 1.0, 1.0, 1.0, 1.0, 0.0].map(Vec4::splat).into()), ..geometry.clone() };
        assert!(!merged.still_coincide(&cut));
    }

    #[test]
    fn the_result_is_that_of_comparing_all_pairs() {
        let mut random = fastrand::Rng::with_seed(3);
        for triangles in [1, 100, 3000, 20_000] {
            // Corners of a small grid, so that many triangles coincide, and some are degenerate.
            let side = if triangles > 1000 { 4 } else { 3 };
            let mut corner = || Vec3::from_array([0; 3].map(|_| random.u32(..side) as f32 - 1.0));
            let positions: Vec<Vec3> = (0..3 * triangles).map(|_| corner()).collect();
            let indices: Vec<[u32; 3]> = (0..triangles as u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
            let geometry = Geometry::new(positions, indices);
            // The expected ones, by sorting the corners that begin with the least.
            let mut expected = std::collections::BTreeMap::new();
            for (primitive, triangle) in geometry.indices.iter().enumerate() {
                let corners = triangle.map(|v| geometry.positions[v as usize].to_array().map(|x| x as i32));
                let [u, v] = [1, 2].map(|k| IVec3::from_array(corners[k]) - IVec3::from_array(corners[0]));
                if u.cross(v) != IVec3::ZERO {
                    let turned = (0..3).map(|first| [0, 1, 2].map(|k| corners[(first + k) % 3])).min().unwrap();
                    expected.entry(turned).or_insert(primitive as u32);
                }
            }
            let mut expected: Vec<u32> = expected.into_values().collect();
            expected.sort_unstable();
            for structure in STRUCTURES {
                assert_eq!(kept(&geometry, structure).0, expected, "{structure:?}");
            }
        }
    }
}
