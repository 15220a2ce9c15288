//! The scene that is rendered, and its views.

use std::path::Path;

use glam::{DAffine3, DMat3, DQuat, DVec3};
use ropewalk::gltf::{self, ImportOptions, ImportReport, SceneSelector};
use ropewalk::{Cancel, NodeKey, Scene, Sky, View};

use crate::allowed_folders::file_policy;
use crate::arguments::Arguments;
use crate::builtin;
use crate::cameras_and_lights::{add_light_if_none, camera_name, cameras};

/// A scene and the view of its first frame.
pub(crate) struct LoadedScene {
    pub(crate) scene: Scene,
    /// The report of the import; `None` for the built-in scene.
    pub(crate) import: Option<ImportReport>,
    /// The first view; a turntable goes around from there.
    view: View,
    /// The point that a turntable rotates about, in world space.
    center: DVec3,
}

impl LoadedScene {
    /// Loads the requested file, or makes the built-in scene.
    pub(crate) fn load(arguments: &Arguments, cancel: &Cancel) -> Result<Self, String> {
        let mut scene = Scene::new();
        let (import, sky) = match &arguments.file {
            Some(file) => (Some(import(file, arguments, cancel, &mut scene)?), Sky::default()),
            None => {
                builtin::build(&mut scene).map_err(|error| format!("the built-in scene: {error}"))?;
                (None, builtin::sky())
            }
        };

        let mut view = first_view(&mut scene, import.as_ref(), arguments)?;
        view.sky = sky;
        view.max_depth = arguments.depth;
        view.max_rays = arguments.max_rays;
        (view.min_throughput, view.near) = (arguments.min_throughput, arguments.near);
        // Only EXR files can hold depth, normals and ids.
        view.aovs = arguments.output.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("exr"));
        add_light_if_none(&mut scene, &view).map_err(|error| error.to_string())?;

        let bounds = scene.visible_bounds(scene.root()).map_err(|error| error.to_string())?;
        let center = if bounds.is_empty() { DVec3::ZERO } else { bounds.center() };
        Ok(Self { scene, import, view, center })
    }

    /// The view of one of `frames` frames, counted from 0: the camera goes once around the center of the scene.
    pub(crate) fn view(&self, frame: u32, frames: u32) -> View {
        let angle = std::f64::consts::TAU * f64::from(frame) / f64::from(frames);
        let turned = DAffine3::from_mat3_translation(DMat3::from_quat(DQuat::from_rotation_y(angle)), self.center)
            * DAffine3::from_translation(-self.center);
        View { world_from_view: turned * self.view.world_from_view, ..self.view.clone() }
    }
}

fn import(file: &Path, arguments: &Arguments, cancel: &Cancel, scene: &mut Scene) -> Result<ImportReport, String> {
    let selector = |requested: &String| match requested.parse() {
        Ok(index) => SceneSelector::Index(index),
        Err(_) => SceneSelector::Name(requested.clone()),
    };
    let options = ImportOptions::default()
        .with_scene(arguments.scene.as_ref().map(selector))
        .with_wall(arguments.wall.into())
        .with_files(file_policy(file, &arguments.allow_folder))
        .with_memory_limit(arguments.memory.map(|mebibytes| u64::from(mebibytes) << 20))
        .with_cancel(cancel.clone());
    let root = scene.root();
    gltf::import_with(file, &options, scene, root).map_err(|error| error.to_string())
}

/// The requested camera, else the first camera of the scene, else a view that frames the scene.
fn first_view(scene: &mut Scene, import: Option<&ImportReport>, arguments: &Arguments) -> Result<View, String> {
    let (width, height) = arguments.traced_size();
    let cameras = cameras(scene);
    // An error about a view names what the user knows: the file and the camera.
    let file = arguments.file.as_ref().map_or("the built-in scene".into(), |file| file.display().to_string());
    let camera = match &arguments.camera {
        None => cameras.first().copied(),
        Some(requested) => Some(choose_camera(scene, &cameras, requested).map_err(|message| {
            // It may be one that the import has left out.
            let warnings = import.into_iter().flat_map(|import| &import.warnings);
            let left_out = warnings.filter(|warning| warning.feature.starts_with("camera"));
            left_out.fold(message, |message, warning| format!("{message}; {file}: {warning}"))
        })?),
    };
    match camera {
        Some(camera) => {
            let name = camera_name(scene, camera).to_owned();
            let checked = View::from_camera(scene, camera, width, height).and_then(|view| {
                view.validate()?;
                Ok(view)
            });
            checked.map_err(|error| format!("{file}: the camera {name:?}: {error}"))
        }
        None => View::framing(scene, width, height).map_err(|error| format!("{file}: {error}")),
    }
}

fn choose_camera(scene: &Scene, cameras: &[NodeKey], requested: &str) -> Result<NodeKey, String> {
    let names: Vec<&str> = cameras.iter().map(|&camera| camera_name(scene, camera)).collect();
    let index = requested.parse().ok().or_else(|| names.iter().position(|name| *name == requested));
    index.and_then(|index: usize| cameras.get(index)).copied().ok_or_else(|| {
        let known = names.iter().enumerate().map(|(i, name)| format!("{i} {name:?}")).collect::<Vec<_>>();
        match known.as_slice() {
            [] => format!("there is no camera {requested:?}: the scene has none"),
            _ => format!("there is no camera {requested:?}; there are: {}", known.join(", ")),
        }
    })
}
