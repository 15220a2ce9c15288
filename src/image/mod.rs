//! Linear images with what was seen in each pixel.

use crate::graph::NodeKey;

/// A rendered image: linear RGBA, row by row from the top.
#[derive(Clone, Debug, PartialEq)]
pub struct Image {
    /// Pixels a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Linear radiance and coverage; not clamped.
    pub color: Vec<[f32; 4]>,
    /// What the primary rays met, where the view asked for it.
    pub aovs: Option<Aovs>,
}

/// Arbitrary output variables: what the primary ray of each pixel met. All arrays are in the image's order.
#[derive(Clone, Debug, PartialEq)]
pub struct Aovs {
    /// Distance from the camera along the ray, in the scene's unit of length; infinite where nothing was met.
    pub depth: Vec<f32>,
    /// Unit shading normal in world space, towards the camera; zero where nothing was met.
    pub normal: Vec<[f32; 3]>,
    /// The node whose geometry was met; the null key where nothing was.
    pub node: Vec<NodeKey>,
    /// The triangle's index in its geometry; `u32::MAX` where nothing was met.
    pub triangle: Vec<u32>,
}
