//! The picture of the same scene, rendered by the library without a window.

use ropewalk::glam::DVec3;
use ropewalk::image::Image;
use ropewalk::{Camera, Core, DeviceChoice, NodeKey, Renderer, RendererOptions, Scene, View};
use ropewalk_testkit::flip::{PIXELS_PER_DEGREE, flip};

use crate::builtin;

/// The built-in scene and its view, made as the viewer makes them.
pub(crate) struct Expected {
    pub(crate) scene: Scene,
    pub(crate) view: View,
    renderer: Renderer,
}

impl Expected {
    /// The built-in scene, for pictures of this size.
    pub(crate) fn new(width: u16, height: u16) -> Self {
        let mut scene = Scene::new();
        let camera = builtin::build(&mut scene).unwrap();
        let mut view = View::from_camera(&scene, camera, width.into(), height.into()).unwrap();
        (view.sky, view.aovs) = (builtin::sky(), true);
        let renderer = Renderer::new(&RendererOptions::default().with_device(DeviceChoice::Cpu)).unwrap();
        Self { scene, view, renderer }
    }

    /// The scene as it is now.
    pub(crate) fn render(&mut self) -> Image {
        self.renderer.render(&mut self.scene, &self.view).unwrap().image().unwrap()
    }

    /// The ball that covers most of the picture, and the pixel in the middle of its visible part.
    pub(crate) fn largest_ball(&mut self) -> (NodeKey, [u32; 2]) {
        let image = self.render();
        let balls = self.scene.find("balls").unwrap();
        let nodes: Vec<NodeKey> = self.scene.subtree(balls).unwrap().collect();
        let is_ball = |node: &NodeKey| matches!(self.scene.node_core(*node), Ok(Core::Geometry { .. }));
        let ball = nodes.into_iter().filter(is_ball).max_by_key(|&ball| pixels_of(&image, ball).len()).unwrap();
        let pixels = pixels_of(&image, ball);
        let middle = [0, 1].map(|i| pixels.iter().map(|pixel| f64::from(pixel[i])).sum::<f64>() / pixels.len() as f64);
        let distance = |pixel: &&[u32; 2]| (0..2).map(|i| (f64::from(pixel[i]) - middle[i]).powi(2)).sum::<f64>();
        let nearest = pixels.iter().min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap();
        (ball, *nearest)
    }

    /// The position in the picture of a point in world space, in pixels from the upper left corner.
    pub(crate) fn position_of(&self, point: DVec3) -> [f64; 2] {
        let Camera::Perspective { y_fov, aspect: None, .. } = self.view.camera else {
            panic!("{:?}", self.view.camera)
        };
        let [width, height] = [self.view.width, self.view.height].map(f64::from);
        let seen = self.view.world_from_view.inverse().transform_point3(point);
        let pixels = height * 0.5 / (f64::from(y_fov) * 0.5).tan() / -seen.z;
        [width * 0.5 + seen.x * pixels, height * 0.5 - seen.y * pixels]
    }
}

/// The pixels in which a node is visible.
fn pixels_of(image: &Image, node: NodeKey) -> Vec<[u32; 2]> {
    let pixels = (0..image.height).flat_map(|y| (0..image.width).map(move |x| [x, y]));
    pixels.filter(|&[x, y]| image.node_at(x, y) == Some(node)).collect()
}

/// The mean FLIP difference of two pictures, 0 to 1.
pub(crate) fn difference(width: u16, a: &[[u8; 4]], b: &[[u8; 4]]) -> f32 {
    let differences = flip(width.into(), a, b, PIXELS_PER_DEGREE).unwrap();
    differences.iter().sum::<f32>() / differences.len() as f32
}
