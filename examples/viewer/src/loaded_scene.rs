//! The scene that is shown: a file, or the scene made in code. It is loaded on a thread, so that the window stays
//! responsive.

use std::path::{Path, PathBuf};
use std::sync::mpsc::{self, Receiver, TryRecvError};

use ropewalk::gltf::{self, ImportOptions};
use ropewalk::{Scene, Sky, View};

use crate::allowed_folders::file_policy;
use crate::builtin;
use crate::cameras_and_lights::{add_light_if_none, cameras};

/// A scene and its first view.
pub(crate) struct LoadedScene {
    pub(crate) scene: Scene,
    /// The name of the file.
    pub(crate) title: String,
    pub(crate) view: View,
    /// The number of warnings about the file.
    pub(crate) warning_count: usize,
}

/// A scene that is being loaded.
pub(crate) struct Loading {
    pub(crate) title: String,
    receiver: Receiver<Result<LoadedScene, String>>,
}

impl Loading {
    /// Begins to load a file or, without one, to make the built-in scene.
    pub(crate) fn begin(path: Option<PathBuf>, allowed_folders: Vec<PathBuf>) -> Self {
        let (sender, receiver) = mpsc::channel();
        let title = title(path.as_deref());
        // Sending fails if the receiver is dropped: another file has been opened meanwhile.
        std::thread::spawn(move || drop(sender.send(LoadedScene::load(path.as_deref(), &allowed_folders))));
        Self { title, receiver }
    }

    /// The loaded scene or the error message; `None` while it is being loaded.
    pub(crate) fn poll(&self) -> Option<Result<LoadedScene, String>> {
        match self.receiver.try_recv() {
            Ok(outcome) => Some(outcome),
            Err(TryRecvError::Empty) => None,
            Err(TryRecvError::Disconnected) => Some(Err(format!("{}: the loader ended early", self.title))),
        }
    }
}

impl LoadedScene {
    pub(crate) fn load(path: Option<&Path>, allowed_folders: &[PathBuf]) -> Result<Self, String> {
        let mut scene = Scene::new();
        let (sky, warning_count) = match path {
            Some(path) if path.extension().is_some_and(|extension| extension == "ropewalk") => {
                scene = Scene::load(path).map_err(|error| error.to_string())?;
                (Sky::default(), 0)
            }
            Some(path) => {
                let root = scene.root();
                let options = ImportOptions::default().with_files(file_policy(path, allowed_folders));
                let import = gltf::import_with(path, &options, &mut scene, root).map_err(|error| error.to_string())?;
                (Sky::default(), import.warnings.len())
            }
            None => {
                builtin::build(&mut scene).map_err(|error| format!("the built-in scene: {error}"))?;
                (builtin::sky(), 0)
            }
        };
        let mut view = first_view(&mut scene).map_err(|error| error.to_string())?;
        view.sky = sky;
        add_light_if_none(&mut scene, &view).map_err(|error| error.to_string())?;
        Ok(Self { scene, title: title(path), view, warning_count })
    }
}

/// The first camera of the scene, else a view that frames the scene.
fn first_view(scene: &mut Scene) -> ropewalk::Result<View> {
    /// A usual window size. It is replaced by that of the window later.
    const SIZE: (u32, u32) = (1200, 800);

    match cameras(scene).first() {
        Some(&camera) => View::from_camera(scene, camera, SIZE.0, SIZE.1),
        None => View::framing(scene, SIZE.0, SIZE.1),
    }
}

fn title(path: Option<&Path>) -> String {
    let name = path.map(|path| path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned());
    name.unwrap_or_else(|| "built-in scene".to_owned())
}
