//! A view of a scene: the pose and projection of a camera, the size of the image, where paths end, sky and ray mask.

use std::ops::Range;

use glam::{DAffine3, DMat3, DVec2, DVec3, Vec3};

use crate::compile::{ViewHeight, Viewpoint};
use crate::device::layout::FrameParams;
use crate::error::require;
use crate::graph::{Camera, Core, CoreKind, NodeKey, Scene, Transform};
use crate::math::Bounds;
use crate::query::{HalfSpace, Region};
use crate::{Error, Result};

/// Camera, image and sky for [`Renderer::render`](super::Renderer::render).
///
/// ```
/// use ropewalk::View;
/// use ropewalk::graph::Camera;
/// use glam::DVec3;
///
/// let mut view = View::look_at(DVec3::new(0.0, 1.0, 5.0), DVec3::ZERO, DVec3::Y, Camera::default(), 800, 600);
/// view.max_depth = 5; // five reflections or refractions
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct View {
    /// Pose of the camera in world space; it looks along its -Z axis with +Y up. Scale is ignored.
    pub world_from_view: DAffine3,
    /// Projection of the camera.
    pub camera: Camera,
    /// Width of the image in pixels.
    pub width: u32,
    /// Height of the image in pixels.
    pub height: u32,
    /// How many reflections and refractions a path may have, any number; what is deeper sees the sky. 3 by default.
    pub max_depth: u32,
    /// Paths end where they contribute no more than this share of their radiance to the pixel: they see the sky. 0 to
    /// 1; 2^-13 by default ([`DEFAULT_MIN_THROUGHPUT`](Self::DEFAULT_MIN_THROUGHPUT)), which for radiance up to 1
    /// cannot change an 8-bit pixel. More is faster and less accurate where mirrors and glass face each other. With
    /// less, a pixel whose rays branch again and again may have more pending than there is room for, and then counts as
    /// one that needs more than [`max_rays`](Self::max_rays); 0 follows a hall of mirrors to any depth.
    pub min_throughput: f32,
    /// The camera sees nothing nearer than this, along each ray, in world units; 0 by default.
    ///
    /// Whatever it is, a camera on a surface does not see that surface but what lies before and behind it: on a surface
    /// is what is nearer to it than the rounding of positions there, by the bound that keeps secondary rays from
    /// hitting where they start.
    pub near: f32,
    /// The most rays of a pixel, at least 1; shadow rays are not counted. Each blended surface that a pixel is seen
    /// through takes one, each reflection one, each refraction two. A pixel that needs more sees, for each ray that is
    /// left, the nearest opaque surface instead: [`Frame::limited_pixels`](super::Frame::limited_pixels) counts these
    /// pixels. 1024 by default.
    pub max_rays: u32,
    /// Environment radiance: what rays see that leave the scene, and ambient light from all directions.
    pub sky: Sky,
    /// Rays pass through nodes whose mask has no bit in common with this.
    pub ray_mask: u32,
    /// Whether the frame also stores depth, normal, node and triangle of each pixel (arbitrary output variables).
    pub aovs: bool,
}

impl View {
    /// The default of [`min_throughput`](Self::min_throughput), 2^-13: half the smallest step of an 8-bit sRGB image
    /// is 1.24 times that, in linear radiance.
    pub const DEFAULT_MIN_THROUGHPUT: f32 = 1.0 / (1 << 13) as f32;

    /// A view from `eye` towards `target`, both in world space; `up` need not be perpendicular to the view direction.
    pub fn look_at(eye: DVec3, target: DVec3, up: DVec3, camera: Camera, width: u32, height: u32) -> Self {
        Self {
            world_from_view: Transform::looking_at(eye, target, up).to_affine(),
            camera,
            width,
            height,
            max_depth: 3,
            min_throughput: Self::DEFAULT_MIN_THROUGHPUT,
            near: 0.0,
            max_rays: 1024,
            sky: Sky::default(),
            ray_mask: u32::MAX,
            aovs: false,
        }
    }

    /// The view of a camera node at its current world transform. O(depth of the node).
    ///
    /// # Errors
    /// [`Error::StaleKey`], or [`Error::WrongCore`] if the node is not a camera.
    pub fn from_camera(scene: &Scene, node: NodeKey, width: u32, height: u32) -> Result<Self> {
        let core = scene.node_core(node)?;
        let Core::Camera(camera) = *core else {
            return Err(Error::WrongCore { node, expected: CoreKind::Camera, found: core.kind() });
        };
        let world_from_view = scene.world_from_local(node)?;
        Ok(Self { world_from_view, ..Self::look_at(DVec3::ZERO, DVec3::NEG_Z, DVec3::Y, camera, width, height) })
    }

    /// A view that fits what is [visible](Scene::visible_bounds) of the scene into the image, seen by the default
    /// camera from the front, a little from the right and from above. A flat scene, whose box is thinner than a
    /// thousandth of its other two extents, is seen face-on: from the side that most of its single-sided triangles
    /// face, else from the front, right or top. Costs as [`Scene::visible_bounds`]; a flat scene O(visible triangles)
    /// more.
    ///
    /// # Errors
    /// As [`Scene::hierarchy`].
    pub fn framing(scene: &mut Scene, width: u32, height: u32) -> Result<Self> {
        let bounds = scene.visible_bounds(scene.root())?;
        let (from, up) = framing_direction(scene, &bounds)?;
        // The distance to a scene without extent must still be representable in f64 where the scene is.
        let point = Bounds { min: DVec3::ZERO, max: DVec3::ZERO };
        let bounds = if bounds.is_empty() { point } else { bounds };
        let (center, least) = (bounds.center(), bounds.min.abs().max(bounds.max.abs()).max_element() * 1e-9);
        let camera = Camera::default();
        // Only the direction matters, which is exact near the origin.
        let mut view = Self::look_at(from, DVec3::ZERO, up, camera, width, height);

        // The least distance at which every corner of the bounds projects into the image, and 8 % more.
        let (half_width, half_height, _) = view.half_extent();
        let view_from_world = view.world_from_view.matrix3.transpose();
        let distance = bounds.corners().map(|corner| {
            let corner = view_from_world * (corner - center);
            corner.z + (corner.x.abs() / f64::from(half_width)).max(corner.y.abs() / f64::from(half_height))
        });
        let distance = distance.into_iter().fold(0.0, f64::max) * 1.08;
        // Keep a distance from a scene without extent.
        let distance = if distance > least { distance } else { least.max(1.0) };
        view.world_from_view.translation = center + view.world_from_view.matrix3.z_axis * distance;
        Ok(view)
    }

    /// Checks every number that rendering depends on.
    ///
    /// # Errors
    /// [`Error::OutOfRange`] names the value: no rays, a least throughput outside 0 to 1, a negative near distance, a
    /// camera pose that is not finite or flattens an axis (a camera node below a scale of zero), a projection out of
    /// range, a sky that is not finite.
    pub fn validate(&self) -> Result<()> {
        let pose = &self.world_from_view;
        let axes = [pose.matrix3.x_axis, pose.matrix3.y_axis, pose.matrix3.z_axis];
        let is_usable = pose.is_finite() && axes.iter().all(|axis| axis.try_normalize().is_some());
        let Sky { zenith, horizon, ground, up } = self.sky;

        require((0.0..=1.0).contains(&self.min_throughput), "min_throughput", &self.min_throughput, "0 to 1")?;
        let is_distance = self.near >= 0.0 && self.near.is_finite();
        require(is_distance, "near", &self.near, "finite and not negative")?;
        require(self.max_rays > 0, "max_rays", &self.max_rays, "at least 1")?;
        let columns = [pose.matrix3.x_axis, pose.matrix3.y_axis, pose.matrix3.z_axis, pose.translation];
        let columns = columns.map(|column| column.to_array());
        require(is_usable, "camera pose", &columns, "finite, with no axis scaled to zero")?;
        self.camera.validate()?;
        require([zenith, horizon, ground].iter().all(|c| c.is_finite()), "sky", &self.sky, "finite")?;
        require(up.try_normalize().is_some(), "sky up", &up, "finite and not zero")
    }

    /// The view frustum in world space: it begins at the camera and has no far plane. For
    /// [`Queries::overlapping`](crate::query::Queries::overlapping).
    ///
    /// # Errors
    /// As [`validate`](Self::validate), and [`Error::OutOfRange`] for an image without pixels or a pose whose axes lie
    /// in a plane.
    pub fn frustum(&self) -> Result<Region> {
        self.pixel_frustum(0..self.width, 0..self.height)
    }

    /// The part of the [frustum](Self::frustum) seen through these columns and rows of pixels, counted from the upper
    /// left: for selection by a rubber band.
    ///
    /// # Errors
    /// As [`frustum`](Self::frustum), and [`Error::OutOfRange`] for pixels outside the image, or none.
    pub fn pixel_frustum(&self, columns: Range<u32>, rows: Range<u32>) -> Result<Region> {
        self.validate()?;
        self.check_pixels(columns.clone(), rows.clone())?;
        let axes = self.world_from_view.matrix3;
        let [right, up, back] = [axes.x_axis, axes.y_axis, axes.z_axis].map(DVec3::normalize_or_zero);
        // 1. The rows of view_from_world, which give the coordinates to the right, above and ahead.
        let view_from_world = DMat3::from_cols(right, up, -back).inverse().transpose();
        let [across, above, ahead] = [view_from_world.x_axis, view_from_world.y_axis, view_from_world.z_axis];

        let (half_width, half_height, orthographic) = self.half_extent();
        let (size, shift) = (DVec2::new(half_width.into(), half_height.into()), self.camera.shift().as_dvec2());
        // 2. The edges of the rectangle of pixels, in the plane at distance 1 or, orthographic, at the eye.
        let to_ndc = |edge: u32, count: u32| f64::from(edge) / f64::from(count) * 2.0 - 1.0;
        let low = (DVec2::new(to_ndc(columns.start, self.width), -to_ndc(rows.end, self.height)) + shift) * size;
        let high = (DVec2::new(to_ndc(columns.end, self.width), -to_ndc(rows.start, self.height)) + shift) * size;

        // 3. A half-space for each edge: perspective ones through the eye, orthographic ones parallel, with a near
        //    plane.
        let eye = self.world_from_view.translation;
        if orthographic == 0 {
            let normals =
                [ahead * low.x - across, across - ahead * high.x, ahead * low.y - above, above - ahead * high.y];
            return Region::new(normals.map(|normal| HalfSpace::through(eye, normal)));
        }
        let sides = [(-across, -low.x), (across, high.x), (-above, -low.y), (above, high.y), (-ahead, 0.0)];
        Region::new(sides.map(|(normal, out)| HalfSpace { normal, offset: normal.dot(eye) + out }))
    }

    /// Checks that the pixels are inside the image, and not none.
    pub(super) fn check_pixels(&self, columns: Range<u32>, rows: Range<u32>) -> Result<()> {
        let is_within = |range: &Range<u32>, end| !range.is_empty() && range.end <= end;
        let is_inside = is_within(&columns, self.width) && is_within(&rows, self.height);
        let value = format_args!("columns {columns:?}, rows {rows:?} of {} x {}", self.width, self.height);
        require(is_inside, "pixel", &value, "inside the image")
    }

    /// The viewpoint that levels of detail, billboards and the render origin are chosen for.
    pub fn viewpoint(&self) -> Viewpoint {
        let (_, half_height, orthographic) = self.half_extent();
        let height = 2.0 * f64::from(half_height);
        let height = if orthographic == 0 { ViewHeight::Perspective(height) } else { ViewHeight::Orthographic(height) };
        let up = self.world_from_view.matrix3.y_axis.normalize_or(DVec3::Y);
        Viewpoint { eye: self.world_from_view.translation, up, height }
    }

    /// The uniform buffer of a frame of this view, which must be [valid](Self::validate): positions are relative to
    /// `origin` (see [`Compiler::origin`](crate::compile::Compiler::origin)), and the first `light_count` lights of the
    /// device arrays are used. For [frames](crate::trace::FrameRequest) that an application traces by a tracer of its
    /// own.
    pub fn frame_params(&self, origin: DVec3, light_count: u32) -> FrameParams {
        // Bring the axes to length 1, whatever the scale of the camera's node.
        let axes = self.world_from_view.matrix3;
        let [right, up, back] = [axes.x_axis, axes.y_axis, axes.z_axis].map(|axis| axis.normalize_or_zero().as_vec3());
        let (half_width, half_height, orthographic) = self.half_extent();
        // Scale the axes of the image to half its size.
        let (right, up, shift) = (right * half_width, up * half_height, self.camera.shift());
        // Subtract the origin in f64, before the eye is rounded to f32.
        let (mut eye, mut forward) = ((self.world_from_view.translation - origin).as_vec3(), -back);
        // A shifted lens moves the centre of the image: perspective rays turn, orthographic ones start elsewhere.
        let to_center = right * shift.x + up * shift.y;
        *(if orthographic == 0 { &mut forward } else { &mut eye }) += to_center;
        FrameParams {
            eye: eye.to_array(),
            width: self.width,
            right: right.to_array(),
            height: self.height,
            up: up.to_array(),
            max_depth: self.max_depth,
            forward: forward.to_array(),
            orthographic,
            sky_zenith: self.sky.zenith.to_array(),
            ray_mask: self.ray_mask,
            sky_horizon: self.sky.horizon.to_array(),
            light_count,
            sky_ground: self.sky.ground.to_array(),
            first_row: 0,
            sky_up: self.sky.up.normalize_or(Vec3::Y).to_array(),
            max_rays: self.max_rays,
            near: self.near,
            min_throughput: self.min_throughput,
            _pad: [0; 2],
        }
    }

    /// Half the width and height of the image, at distance 1 (perspective) or at any distance (orthographic), and 1 for
    /// an orthographic camera. Where the image has another aspect than the camera it shows more than the camera's
    /// field, never less.
    fn half_extent(&self) -> (f32, f32, u32) {
        let image_aspect = self.width.max(1) as f32 / self.height.max(1) as f32;
        let (half_width, half_height, orthographic) = match self.camera {
            Camera::Perspective { y_fov, aspect, .. } => {
                let half_height = (y_fov * 0.5).tan();
                (half_height * aspect.unwrap_or(image_aspect), half_height, 0)
            }
            Camera::Orthographic { x_mag, y_mag, .. } => (x_mag, y_mag, 1),
        };
        // Grow the width or the height to the aspect of the image.
        let grown_width = half_width.max(half_height * image_aspect);
        let grown_height = half_height.max(half_width / image_aspect);
        (grown_width, grown_height, orthographic)
    }
}

/// From where a scene with these bounds is framed, and what is up: face-on if it is flat, else from the front, a little
/// from the right and from above.
fn framing_direction(scene: &mut Scene, bounds: &Bounds) -> Result<(DVec3, DVec3)> {
    let Some(axis) = flat_axis(bounds) else { return Ok((DVec3::new(0.45, 0.35, 1.0), DVec3::Y)) };
    let side = if scene.net_area_facing(axis)? < 0.0 { -1.0 } else { 1.0 };
    // Seen from above, the image's upper edge is at the back; seen from below, at the front.
    let up = if axis == 1 { DVec3::NEG_Z * side } else { DVec3::Y };
    Ok((DVec3::AXES[axis] * side, up))
}

/// The axis along which a box is flat to the eye: thinner than a thousandth of its other two extents.
fn flat_axis(bounds: &Bounds) -> Option<usize> {
    let extent = bounds.max - bounds.min;
    (0..3).find(|&axis| extent[axis] * 1000.0 < extent[(axis + 1) % 3].min(extent[(axis + 2) % 3]))
}

/// Environment radiance: a gradient from straight up over the horizon to straight down. Linear.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sky {
    /// Straight up.
    pub zenith: Vec3,
    /// At the horizon.
    pub horizon: Vec3,
    /// Straight down.
    pub ground: Vec3,
    /// Which way is up, in world space; any length but zero.
    pub up: Vec3,
}

impl Default for Sky {
    /// Grey, and dark enough that a white surface lit by it and by 2.6 lux is not yet white in the image.
    fn default() -> Self {
        let [zenith, horizon, ground] = [0.22, 0.30, 0.10].map(Vec3::splat);
        Self { zenith, horizon, ground, up: Vec3::Y }
    }
}

impl Sky {
    /// The same radiance from all directions.
    pub fn uniform(radiance: Vec3) -> Self {
        Self { zenith: radiance, horizon: radiance, ground: radiance, up: Vec3::Y }
    }
}
