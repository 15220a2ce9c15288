//! Frames of whole scenes.

mod camera_on_surface;
mod cancel;
mod flat;
mod framing;
mod golden;
mod lens_shift;
mod real_scenes;
mod renderer;
mod shading;
