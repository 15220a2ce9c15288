//! Frames of whole scenes.

mod cancel;
mod flat;
mod framing;
mod golden;
mod lens_shift;
mod real_scenes;
mod renderer;
mod shading;
