//! What is looked at: a file, or the scene made in code. Loaded on a thread of its own, so that the window stays alive.

use std::path::{Path, PathBuf};
use std::sync::mpsc::{self, Receiver, TryRecvError};

use ropewalk::{Scene, Sky, View, gltf};

use crate::builtin;
use crate::stage::{cameras, light_if_dark};

/// A scene and how it is seen at first.
pub(crate) struct Subject {
    pub(crate) scene: Scene,
    /// The name of the file.
    pub(crate) title: String,
    pub(crate) view: View,
    /// Features of the file that are not honoured.
    pub(crate) not_honoured: usize,
}

/// A subject that is on its way.
pub(crate) struct Loading {
    pub(crate) title: String,
    receiver: Receiver<Result<Subject, String>>,
}

impl Loading {
    /// Begins to load a file or, without one, to make the built-in scene.
    pub(crate) fn begin(path: Option<PathBuf>) -> Self {
        let (sender, receiver) = mpsc::channel();
        let title = title(path.as_deref());
        // The receiver may be gone: another file was dropped meanwhile.
        std::thread::spawn(move || drop(sender.send(Subject::load(path.as_deref()))));
        Self { title, receiver }
    }

    /// What was loaded, or why it was not, once that is known.
    pub(crate) fn poll(&self) -> Option<Result<Subject, String>> {
        match self.receiver.try_recv() {
            Ok(outcome) => Some(outcome),
            Err(TryRecvError::Empty) => None,
            Err(TryRecvError::Disconnected) => Some(Err(format!("{}: the loader ended early", self.title))),
        }
    }
}

impl Subject {
    pub(crate) fn load(path: Option<&Path>) -> Result<Self, String> {
        let mut scene = Scene::new();
        let (sky, not_honoured) = match path {
            Some(path) if path.extension().is_some_and(|extension| extension == "ropewalk") => {
                scene = Scene::load(path).map_err(|error| error.to_string())?;
                (Sky::default(), 0)
            }
            Some(path) => {
                let root = scene.root();
                let import = gltf::import(path, &mut scene, root).map_err(|error| error.to_string())?;
                (Sky::default(), import.warnings.len())
            }
            None => {
                builtin::build(&mut scene).map_err(|error| format!("the built-in scene: {error}"))?;
                (builtin::sky(), 0)
            }
        };
        let mut view = first_view(&mut scene).map_err(|error| error.to_string())?;
        view.sky = sky;
        light_if_dark(&mut scene, &view).map_err(|error| error.to_string())?;
        Ok(Self { scene, title: title(path), view, not_honoured })
    }
}

/// Through the first camera, else from where everything is seen.
fn first_view(scene: &mut Scene) -> ropewalk::Result<View> {
    /// The usual shape of a window. A view takes another size later.
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
