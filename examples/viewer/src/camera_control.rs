//! The free camera: orbit, look, pan, zoom and fly.

use glam::{DAffine3, DMat3, DQuat, DVec2, DVec3};
use ropewalk::math::Bounds;
use ropewalk::{Camera, View};

use crate::projection::Projection;

/// A camera that the user moves. Its pivot, the point that it orbits, lies straight ahead.
#[derive(Clone, Debug)]
pub(crate) struct CameraControl {
    eye: DVec3,
    rotation: DQuat,
    /// Distance from the eye to the pivot.
    distance: f64,
    camera: Camera,
}

impl CameraControl {
    /// The camera of `view`, with the pivot at the depth of `target`.
    pub(crate) fn from_view(view: &View, target: DVec3) -> Self {
        let axes = view.world_from_view.matrix3;
        let axes = [axes.x_axis, axes.y_axis, axes.z_axis].map(DVec3::normalize_or_zero);
        let eye = view.world_from_view.translation;
        let ahead = (target - eye).dot(-axes[2]);
        let distance = if ahead > 0.0 { ahead } else { (target - eye).length().max(1.0) };
        let rotation = DQuat::from_mat3(&DMat3::from_cols(axes[0], axes[1], axes[2])).normalize();
        Self { eye, rotation, distance, camera: view.camera }
    }

    /// Writes its pose and projection into a view.
    pub(crate) fn apply(&self, view: &mut View) {
        view.world_from_view = DAffine3::from_rotation_translation(self.rotation, self.eye);
        view.camera = self.camera;
    }

    /// Orbits the pivot, by a drag given in image heights.
    pub(crate) fn orbit(&mut self, drag: DVec2) {
        let pivot = self.eye + self.forward() * self.distance;
        self.turn(drag * -std::f64::consts::PI);
        self.eye = pivot - self.forward() * self.distance;
    }

    /// Rotates about the eye, by a drag given in image heights.
    pub(crate) fn look(&mut self, drag: DVec2) {
        self.turn(drag * -1.0);
    }

    /// Moves camera and pivot sideways, so that a point at the depth of the pivot follows a drag given in pixels.
    pub(crate) fn pan(&mut self, pixels: DVec2, projection: &Projection) {
        let step = pixels * projection.pixel_size(self.distance);
        self.eye += self.rotation * DVec3::new(-step.x, step.y, 0.0);
    }

    /// Moves towards the pivot (`steps` above 0) or away from it, by a tenth of the distance in each step.
    pub(crate) fn zoom(&mut self, steps: f64) {
        let factor = 0.9_f64.powf(steps.clamp(-50.0, 50.0));
        if let Camera::Orthographic { x_mag, y_mag, .. } = &mut self.camera {
            *x_mag *= factor as f32;
            *y_mag *= factor as f32;
        }
        let pivot = self.eye + self.forward() * self.distance;
        self.distance *= factor;
        self.eye = pivot - self.forward() * self.distance;
    }

    /// Moves camera and pivot right, up and back, in units of the distance to the pivot.
    pub(crate) fn fly(&mut self, step: DVec3) {
        self.eye += self.rotation * step * self.distance;
    }

    /// Keeps the direction, and moves to where a box fills the image.
    pub(crate) fn frame(&mut self, bounds: &Bounds) {
        let radius = bounds.radius().max(f64::MIN_POSITIVE);
        match &mut self.camera {
            Camera::Perspective { y_fov, .. } => self.distance = radius / (f64::from(*y_fov) * 0.5).sin() * 1.1,
            Camera::Orthographic { x_mag, y_mag, .. } => {
                (*x_mag, *y_mag) = (radius as f32 * 1.1, radius as f32 * 1.1);
                self.distance = radius * 2.0;
            }
        }
        self.eye = bounds.center() - self.forward() * self.distance;
    }

    fn forward(&self) -> DVec3 {
        self.rotation * DVec3::NEG_Z
    }

    /// Rotates left about the world's y axis, then up, in radians; never past straight up or down.
    fn turn(&mut self, angles: DVec2) {
        /// The smallest angle to straight up and down, in radians.
        const MARGIN: f64 = 0.01;

        let elevation = self.forward().y.clamp(-1.0, 1.0).asin();
        let max_elevation = std::f64::consts::FRAC_PI_2 - MARGIN;
        let up = (elevation + angles.y).clamp(-max_elevation.max(-elevation), max_elevation.max(elevation)) - elevation;
        self.rotation = (DQuat::from_rotation_y(angles.x) * self.rotation * DQuat::from_rotation_x(up)).normalize();
    }
}

#[cfg(test)]
mod tests {
    use glam::{dvec2, dvec3};

    use super::*;

    fn view() -> View {
        View::look_at(dvec3(0.0, 1.0, 5.0), dvec3(0.0, 1.0, 0.0), DVec3::Y, Camera::default(), 200, 100)
    }

    fn control() -> CameraControl {
        CameraControl::from_view(&view(), dvec3(0.0, 1.0, 0.0))
    }

    fn pivot(control: &CameraControl) -> DVec3 {
        control.eye + control.forward() * control.distance
    }

    #[test]
    fn it_starts_where_the_view_was() {
        let mut same = view();
        control().apply(&mut same);
        assert!(same.world_from_view.abs_diff_eq(view().world_from_view, 1e-12));
    }

    #[test]
    fn orbits_keep_their_pivot_and_distance_and_do_not_tip_over() {
        let mut control = control();
        for step in 0..1000 {
            control.orbit(dvec2(0.01, if step % 200 < 100 { 0.02 } else { -0.02 }));
            assert!(pivot(&control).distance(dvec3(0.0, 1.0, 0.0)) < 1e-9);
            assert!((control.distance - 5.0).abs() < 1e-9);
            assert!((control.rotation * DVec3::Y).y > 0.0, "upside down");
            assert!((control.rotation * DVec3::X).y.abs() < 1e-9, "tilted");
        }
    }

    #[test]
    fn a_drag_to_the_right_shows_the_left_side() {
        let mut control = control();
        control.orbit(dvec2(0.1, 0.0));
        assert!(control.eye.x < 0.0);
        control = self::control();
        control.orbit(dvec2(0.0, 0.1));
        assert!(control.eye.y > 1.0, "a drag downwards shows the top");
    }

    #[test]
    fn panning_carries_the_pivots_surface_with_the_pointer() {
        let (mut control, before) = (control(), Projection::of(&view()));
        let seen = before.segment(dvec3(0.0, 1.0, 0.0), dvec3(0.0, 1.0, -1.0)).unwrap()[0];
        control.pan(dvec2(17.0, -9.0), &before);
        let mut after = view();
        control.apply(&mut after);
        let now = Projection::of(&after).segment(dvec3(0.0, 1.0, 0.0), dvec3(0.0, 1.0, -1.0)).unwrap()[0];
        assert!((now - seen).distance(dvec2(17.0, -9.0)) < 1e-9);
    }

    #[test]
    fn zooming_and_flying_are_undone_by_their_opposites() {
        let mut control = control();
        control.zoom(7.0);
        assert!(control.distance < 3.0);
        control.zoom(-7.0);
        control.fly(dvec3(0.3, -0.2, 0.1));
        control.fly(dvec3(-0.3, 0.2, -0.1));
        assert!(control.eye.distance(dvec3(0.0, 1.0, 5.0)) < 1e-9);
    }

    #[test]
    fn a_framed_box_is_in_the_picture() {
        let mut control = control();
        let bounds = Bounds { min: dvec3(10.0, 0.0, -3.0), max: dvec3(14.0, 1.0, 5.0) };
        control.orbit(dvec2(0.2, 0.1));
        control.frame(&bounds);
        let mut framed = view();
        control.apply(&mut framed);
        let projection = Projection::of(&framed);
        for corner in bounds.corners() {
            let seen = projection.segment(corner, bounds.center()).unwrap()[0];
            assert!(seen.cmpge(DVec2::ZERO).all() && seen.cmple(dvec2(200.0, 100.0)).all(), "{corner} is at {seen}");
        }
    }
}
