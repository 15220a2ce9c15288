//! Level of detail: selects one child by viewpoint.

use glam::DVec3;
use serde::{Deserialize, Serialize};

/// Shows one child of a node: the first when near, later ones with increasing distance. If the selected child does not
/// exist, nothing is shown. Each renderer selects for its own camera, so the graph itself does not change.
///
/// `thresholds` separate the levels: up to the first of them the first child is shown, up to the second the second
/// child, and beyond the last the child after it.
///
/// With `hysteresis` h the current level is kept until the measure exceeds a threshold by the factor 1 + h (moving
/// away) or falls below it by 1 - h (approaching), which prevents flicker at a threshold. (The current level is lost
/// when the flattened [hierarchy](crate::graph::Hierarchy) is rebuilt.)
///
/// As OpenSG's `DistanceLOD` and `ScreenLOD`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Lod {
    /// The measure that selects the level.
    pub metric: LodMetric,
    /// Reference point in the node's local space, normally the centre of the subtree.
    pub center: DVec3,
    /// Thresholds between levels, positive: distances in ascending order, or projected sizes in descending order.
    pub thresholds: Vec<f64>,
    /// Relative width of the band in which the current level is kept: at least 0 (none), below 1.
    pub hysteresis: f64,
}

/// The measure that selects a level of detail.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum LodMetric {
    /// The distance of the eye from the centre, in world units.
    Distance,
    /// The projected diameter of a sphere around the centre, as a fraction of the image height (1 = full height).
    ProjectedSize {
        /// Radius of the sphere in the node's local space; it is scaled by the longest axis of the world matrix.
        radius: f64,
    },
}

impl Lod {
    /// Levels by distance from the node's origin, without hysteresis.
    pub fn by_distance(thresholds: impl Into<Vec<f64>>) -> Self {
        Self { metric: LodMetric::Distance, center: DVec3::ZERO, thresholds: thresholds.into(), hysteresis: 0.0 }
    }

    /// Levels by projected size of a sphere around the node's origin, without hysteresis.
    pub fn by_projected_size(radius: f64, thresholds: impl Into<Vec<f64>>) -> Self {
        Self { metric: LodMetric::ProjectedSize { radius }, ..Self::by_distance(thresholds) }
    }

    /// The level for a measured distance or size, where `current` is the level shown before. O(thresholds).
    ///
    /// ```
    /// use ropewalk::graph::Lod;
    ///
    /// let lod = Lod { hysteresis: 0.1, ..Lod::by_distance([10.0, 20.0]) };
    /// assert_eq!(lod.select_level(10.5, None), 1);
    /// assert_eq!(lod.select_level(10.5, Some(0)), 0);
    /// assert_eq!(lod.select_level(11.5, Some(0)), 1);
    /// assert_eq!(lod.select_level(9.5, Some(1)), 1);
    /// assert_eq!(lod.select_level(99.0, Some(0)), 2);
    /// ```
    pub fn select_level(&self, measured: f64, current: Option<u32>) -> u32 {
        // The level is the number of thresholds that the measure is beyond, farther away than each.
        let is_beyond = |threshold: f64| match self.metric {
            LodMetric::Distance => measured > threshold,
            LodMetric::ProjectedSize { .. } => measured < threshold,
        };
        let is_passed = |i: usize| {
            // Thresholds below the current level are relaxed for approaching, those above it for moving away.
            let (far, near) = match self.metric {
                LodMetric::Distance => (1.0 + self.hysteresis, 1.0 - self.hysteresis),
                LodMetric::ProjectedSize { .. } => (1.0 - self.hysteresis, 1.0 + self.hysteresis),
            };
            let factor = current.map_or(1.0, |current| if i < current as usize { near } else { far });
            is_beyond(self.thresholds[i] * factor)
        };
        (0..self.thresholds.len()).take_while(|&i| is_passed(i)).count() as u32
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
