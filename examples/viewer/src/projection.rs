//! Conversion between pixels of a view and world space.
//!
//! Positions in a picture are in pixels from its upper left corner, so that the center of the first pixel is at 0.5.

use glam::{DAffine3, DVec2, DVec3, dvec2, dvec3};
use ropewalk::{Camera, View};

/// A ray in world space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Ray {
    pub(crate) origin: DVec3,
    /// A unit vector.
    pub(crate) direction: DVec3,
}

/// The projection of a view: from world space to its picture and back.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Projection {
    /// A rotation and translation, without scale.
    world_from_view: DAffine3,
    /// Half the width and height of the image, in world units: at distance 1 (perspective) or at any distance.
    half_extent: DVec2,
    /// Lens shift, in half extents.
    shift: DVec2,
    orthographic: bool,
    size: DVec2,
}

impl Projection {
    pub(crate) fn of(view: &View) -> Self {
        let size = dvec2(f64::from(view.width.max(1)), f64::from(view.height.max(1)));
        let aspect = size.x / size.y;
        let (half_width, half_height, orthographic) = match view.camera {
            Camera::Perspective { y_fov, aspect: camera_aspect, .. } => {
                let half_height = (f64::from(y_fov) * 0.5).tan();
                (half_height * camera_aspect.map_or(aspect, f64::from), half_height, false)
            }
            Camera::Orthographic { x_mag, y_mag, .. } => (f64::from(x_mag), f64::from(y_mag), true),
        };
        // The whole field of view of the camera is in the image, whatever the image's aspect.
        let half_extent = dvec2(half_width.max(half_height * aspect), half_height.max(half_width / aspect));
        let mut world_from_view = view.world_from_view;
        for axis in 0..3 {
            *world_from_view.matrix3.col_mut(axis) = world_from_view.matrix3.col(axis).normalize_or_zero();
        }
        Self { world_from_view, half_extent, shift: view.camera.shift().as_dvec2(), orthographic, size }
    }

    /// The camera ray through a position of the picture.
    pub(crate) fn ray(&self, position: DVec2) -> Ray {
        let across = ((position / self.size * 2.0 - 1.0) * dvec2(1.0, -1.0) + self.shift) * self.half_extent;
        let (eye, axes) = (self.world_from_view.translation, self.world_from_view.matrix3);
        let at = axes.x_axis * across.x + axes.y_axis * across.y;
        if self.orthographic {
            Ray { origin: eye + at, direction: -axes.z_axis }
        } else {
            Ray { origin: eye, direction: (at - axes.z_axis).normalize_or_zero() }
        }
    }

    /// The viewing direction, in world space.
    pub(crate) fn forward(&self) -> DVec3 {
        -self.world_from_view.matrix3.z_axis
    }

    /// The size of a pixel in world units, at a distance in front of the camera.
    pub(crate) fn pixel_size(&self, distance: f64) -> f64 {
        2.0 * self.half_extent.y / self.size.y * if self.orthographic { 1.0 } else { distance }
    }

    /// Projects a line segment, clipped to the part in front of the camera; `None` if nothing is.
    pub(crate) fn segment(&self, from: DVec3, to: DVec3) -> Option<[DVec2; 2]> {
        /// Distance of the near plane, relative to that of the farther end.
        const NEAR: f64 = 1e-4;

        let [mut from, mut to] = [from, to].map(|point| self.view_from_world(point));
        if !self.orthographic {
            let near = NEAR * from.length().max(to.length());
            let clipped =
                |behind: DVec3, in_front: DVec3| behind.lerp(in_front, (near + behind.z) / (behind.z - in_front.z));
            match (-from.z < near, -to.z < near) {
                (true, true) => return None,
                (true, false) => from = clipped(from, to),
                (false, true) => to = clipped(to, from),
                (false, false) => {}
            }
        }
        Some([from, to].map(|point| self.position(point)))
    }

    fn view_from_world(&self, point: DVec3) -> DVec3 {
        let offset = point - self.world_from_view.translation;
        let axes = self.world_from_view.matrix3;
        dvec3(axes.x_axis.dot(offset), axes.y_axis.dot(offset), axes.z_axis.dot(offset))
    }

    fn position(&self, in_view: DVec3) -> DVec2 {
        let distance = if self.orthographic { 1.0 } else { -in_view.z };
        let across = in_view.truncate() / (self.half_extent * distance) - self.shift;
        (across * dvec2(1.0, -1.0) + 1.0) * 0.5 * self.size
    }
}

#[cfg(test)]
mod tests {
    use glam::vec2;

    use super::*;

    fn views() -> [View; 4] {
        let (eye, target) = (dvec3(3.0, 2.0, 5.0), dvec3(0.5, 0.0, -1.0));
        let shift = vec2(0.3, -0.2);
        let wide = Camera::Perspective { y_fov: 0.8, aspect: Some(3.0), shift };
        let flat = Camera::orthographic(2.0, 1.0);
        [Camera::default(), wide, flat, flat.with_lens_shift(shift)]
            .map(|camera| View::look_at(eye, target, DVec3::Y, camera, 320, 200))
    }

    #[test]
    fn a_point_on_a_ray_is_seen_where_the_ray_starts() {
        for view in views() {
            let projection = Projection::of(&view);
            for position in [dvec2(0.5, 0.5), dvec2(160.0, 100.0), dvec2(300.2, 20.7)] {
                let ray = projection.ray(position);
                let [near, far] = [1.5, 40.0].map(|distance| ray.origin + ray.direction * distance);
                let seen = projection.segment(near, far).unwrap();
                assert!(seen.iter().all(|at| at.distance(position) < 1e-9), "{seen:?} for {position}");
            }
        }
    }

    /// Against the renderer: the node that a ray should meet is in that pixel of a picture.
    #[test]
    fn rays_are_those_of_the_renderer() {
        use ropewalk::{Core, DeviceChoice, Geometry, Material, Renderer, RendererOptions, Scene};

        for mut view in views() {
            let projection = Projection::of(&view);
            for pixel in [(20_u32, 30_u32), (160, 100), (301, 170)] {
                let ray = projection.ray(dvec2(f64::from(pixel.0), f64::from(pixel.1)) + 0.5);
                let at = (ray.origin + ray.direction * 4.0).as_vec3();
                // As large as half a pixel: a neighbouring ray misses it.
                let half = (projection.pixel_size(4.0) * 0.25) as f32;
                let corners = [(-1.0, -1.0), (3.0, -1.0), (-1.0, 3.0)].map(|(x, y)| {
                    let axes = view.world_from_view.matrix3.as_mat3();
                    at + (axes.x_axis * x + axes.y_axis * y) * half
                });
                let mut scene = Scene::new();
                let geometry = scene.add_geometry(Geometry::new(corners, [[0, 1, 2]])).unwrap();
                let material = scene.add_material(Material::default()).unwrap();
                let node = scene.add(scene.root(), Core::Geometry { geometry, material }).unwrap();
                view.aovs = true;
                let mut renderer = Renderer::new(&RendererOptions::default().with_device(DeviceChoice::Cpu)).unwrap();
                let image = renderer.render(&mut scene, &view).unwrap().image().unwrap();
                assert_eq!(image.node_at(pixel.0, pixel.1), Some(node));
            }
        }
    }

    #[test]
    fn what_is_behind_is_cut_off() {
        let projection = Projection::of(&views()[0]);
        let (eye, forward) = (dvec3(3.0, 2.0, 5.0), projection.forward());
        assert_eq!(projection.segment(eye - forward, eye - forward * 3.0), None);
        let across = projection.segment(eye - forward * 3.0 + DVec3::Y, eye + forward * 3.0 + DVec3::Y).unwrap();
        assert!(across.iter().all(|at| at.is_finite()), "{across:?}");
    }
}
