//! Levels of detail: which child is shown depends on who looks.

use glam::DVec3;
use serde::{Deserialize, Serialize};

/// Shows one child of a node: the first as seen from nearby, later ones from farther away; nothing where there is no
/// such child. Each renderer chooses for its own camera, so the graph itself does not change.
///
/// `limits` separate the levels: up to the first of them the first child is shown, up to the second the second child, and
/// beyond the last the child after it.
///
/// With `hysteresis` h a level once chosen stays until the measure is past the limit by the factor 1 + h on the far side
/// or 1 - h on the near side, so that a camera that trembles at a limit does not flicker. (What was chosen is forgotten when the
/// flattened [hierarchy](crate::Hierarchy) is compacted.)
///
/// OpenSG's `DistanceLOD` and `ScreenLOD`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Lod {
    /// What is measured.
    pub metric: LodMetric,
    /// What is measured from, in the node's local space: the middle of what is below it.
    pub center: DVec3,
    /// Above 0; ascending for distances, descending for sizes.
    pub thresholds: Vec<f64>,
    /// At least 0, below 1; 0 for none.
    pub hysteresis: f64,
}

/// What a level of detail depends on.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum LodMetric {
    /// The distance of the eye from the centre, in world units.
    Distance,
    /// The diameter of the sphere around the centre, as a share of the image's height: 1 fills it.
    ProjectedSize {
        /// Radius of the sphere in the node's local space; a scale above the node grows it by its longest axis.
        radius: f64,
    },
}

impl Lod {
    /// Levels by distance from the node's origin, without hysteresis.
    pub fn by_distance(limits: impl Into<Vec<f64>>) -> Self {
        Self { metric: LodMetric::Distance, center: DVec3::ZERO, thresholds: limits.into(), hysteresis: 0.0 }
    }

    /// Levels by projected size of a sphere around the node's origin, without hysteresis.
    pub fn by_projected_size(radius: f64, limits: impl Into<Vec<f64>>) -> Self {
        Self { metric: LodMetric::ProjectedSize { radius }, ..Self::by_distance(limits) }
    }

    /// The level for what was measured, when `current` was shown before. O(limits).
    ///
    /// ```
    /// use ropewalk::Lod;
    ///
    /// let lod = Lod { hysteresis: 0.1, ..Lod::by_distance([10.0, 20.0]) };
    /// assert_eq!(lod.level(10.5, None), 1);
    /// assert_eq!(lod.level(10.5, Some(0)), 0);
    /// assert_eq!(lod.level(11.5, Some(0)), 1);
    /// assert_eq!(lod.level(9.5, Some(1)), 1);
    /// assert_eq!(lod.level(99.0, Some(0)), 2);
    /// ```
    pub fn select_level(&self, measured: f64, current: Option<u32>) -> u32 {
        let is_beyond = |limit: f64| match self.metric {
            LodMetric::Distance => measured > limit,
            LodMetric::ProjectedSize { .. } => measured < limit,
        };
        let passed = |i: usize| {
            // The limits before the current level are left later on the way back, those after it later on the way out.
            let (far, near) = match self.metric {
                LodMetric::Distance => (1.0 + self.hysteresis, 1.0 - self.hysteresis),
                LodMetric::ProjectedSize { .. } => (1.0 - self.hysteresis, 1.0 + self.hysteresis),
            };
            let factor = current.map_or(1.0, |current| if i < current as usize { near } else { far });
            is_beyond(self.thresholds[i] * factor)
        };
        (0..self.thresholds.len()).take_while(|&i| passed(i)).count() as u32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_count_the_other_way() {
        let lod = Lod { hysteresis: 0.1, ..Lod::by_projected_size(1.0, [0.5, 0.1]) };
        assert_eq!(lod.select_level(0.6, None), 0);
        assert_eq!(lod.select_level(0.3, None), 1);
        assert_eq!(lod.select_level(0.01, None), 2);
        assert_eq!(lod.select_level(0.47, Some(0)), 0);
        assert_eq!(lod.select_level(0.44, Some(0)), 1);
        assert_eq!(lod.select_level(0.54, Some(1)), 1);
        assert_eq!(lod.select_level(0.56, Some(1)), 0);
    }

    #[test]
    fn without_limits_there_is_one_level() {
        assert_eq!(Lod::by_distance([]).select_level(1e9, None), 0);
    }
}
