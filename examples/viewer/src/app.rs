//! The state of the viewer and all operations on it, independent of the window.

use std::path::{Path, PathBuf};
use std::time::Instant;

use glam::{DVec2, DVec3};
use ropewalk::query::Hit;
use ropewalk::{DeviceChoice, NodeKey, Scene, View};
use serde_json::{Value, json};

use crate::camera_control::CameraControl;
use crate::cameras_and_lights::cameras;
use crate::device::WindowDevice;
use crate::drag::{Axis, Drag, Moves, moved_by};
use crate::drawing::{Drawing, Drawn};
use crate::edit::Edit;
use crate::loaded_scene::{LoadedScene, Loading};
use crate::messages::Messages;
use crate::projection::Projection;

/// The whole state of the viewer except the window.
pub(crate) struct App {
    pub(crate) scene: Scene,
    pub(crate) title: String,
    pub(crate) settings: Settings,
    pub(crate) drawing: Drawing,
    pub(crate) messages: Messages,
    /// The name of the edits since the last step of undo.
    editing: Option<&'static str>,
    selection: Option<NodeKey>,
    control: CameraControl,
    /// The first view of the scene.
    home: View,
    /// The current view, of the size that it has in the window.
    view: View,
    drag: Option<Drag>,
    loading: Option<Loading>,
    events: Vec<Value>,
}

/// Settings that the user changes.
#[derive(Clone, Debug)]
pub(crate) struct Settings {
    pub(crate) depth: u32,
    /// So many by so many rays are traced for each pixel when nothing moves.
    pub(crate) rays: u32,
    /// Nodes whose mask has no bit in common with it are not shown.
    pub(crate) ray_mask: u32,
    /// A camera of the scene; `None` for the free camera.
    pub(crate) camera: Option<NodeKey>,
    pub(crate) moves: Moves,
    /// Whether panels, boxes and numbers are shown.
    pub(crate) overlay: bool,
    /// The path to save to.
    pub(crate) save_path: String,
    /// The path to open, as typed in.
    pub(crate) open_path: String,
    /// Folders below which files may name buffers and images, besides their own.
    pub(crate) allowed_folders: Vec<PathBuf>,
}

impl App {
    /// A viewer of an empty scene.
    pub(crate) fn new(
        device: DeviceChoice,
        settings: Settings,
        window: Option<WindowDevice>,
    ) -> ropewalk::Result<Self> {
        let (drawing, messages) = open_device(device, window)?;
        let mut scene = Scene::new();
        let view = View::framing(&mut scene, 0, 0)?;
        let mut app = Self {
            scene,
            title: String::new(),
            settings,
            drawing,
            messages,
            editing: None,
            selection: None,
            control: CameraControl::from_view(&view, DVec3::ZERO),
            home: view.clone(),
            view,
            drag: None,
            loading: None,
            events: Vec::new(),
        };
        app.report_fallback();
        Ok(app)
    }

    /// The events since the last call, for the log.
    pub(crate) fn take_events(&mut self) -> Vec<Value> {
        std::mem::take(&mut self.events)
    }

    // --- The scene

    /// Begins to load a file or, without one, the built-in scene.
    pub(crate) fn open(&mut self, path: Option<PathBuf>) {
        self.loading = Some(Loading::begin(path, self.settings.allowed_folders.clone()));
    }

    /// The name of what is being loaded.
    pub(crate) fn loading(&self) -> Option<&str> {
        self.loading.as_ref().map(|loading| loading.title.as_str())
    }

    /// Shows the loaded scene, once it is complete.
    pub(crate) fn finish_loading(&mut self) {
        match self.loading.as_ref().and_then(Loading::poll) {
            None => return,
            Some(Ok(loaded)) => self.show(loaded),
            Some(Err(message)) => self.fail(&message),
        }
        self.loading = None;
    }

    /// Replaces the scene.
    pub(crate) fn show(&mut self, loaded: LoadedScene) {
        let LoadedScene { scene, title, view, warning_count } = loaded;
        if warning_count > 0 {
            self.messages.inform(format!("{title}: {warning_count} warnings about the file"));
        }
        self.events.push(json!({ "event": "opened", "title": title, "nodes": scene.node_count() }));
        (self.scene, self.title, self.home) = (scene, title, view);
        (self.editing, self.selection, self.drag) = (None, None, None);
        self.scene.enable_undo();
        self.drawing.start_over();
        self.go_home();
    }

    // --- The camera

    /// Resets the free camera to the first view.
    pub(crate) fn go_home(&mut self) {
        self.settings.camera = None;
        let center = self.scene_center();
        self.control = CameraControl::from_view(&self.home, center);
    }

    /// Frames the selection or, without one, the whole scene.
    pub(crate) fn frame(&mut self) {
        let node = self.selection.unwrap_or(self.scene.root());
        match self.scene.world_bounds(node) {
            Ok(bounds) if !bounds.is_empty() => self.free_camera().frame(&bounds),
            Ok(_) => {}
            Err(error) => self.fail(&error.to_string()),
        }
    }

    /// Switches to the free camera, at the current view if another camera was used, and returns it.
    pub(crate) fn free_camera(&mut self) -> &mut CameraControl {
        if self.settings.camera.take().is_some() {
            let center = self.scene_center();
            self.control = CameraControl::from_view(&self.view, center);
        }
        &mut self.control
    }

    /// The center of the scene's bounds.
    fn scene_center(&mut self) -> DVec3 {
        let bounds = self.scene.visible_bounds(self.scene.root()).ok().filter(|bounds| !bounds.is_empty());
        bounds.map_or(DVec3::ZERO, |bounds| bounds.center())
    }

    /// The cameras of the scene.
    pub(crate) fn cameras(&self) -> Vec<NodeKey> {
        cameras(&self.scene)
    }

    /// Updates the view for a picture of this size, through the chosen camera.
    pub(crate) fn update_view(&mut self, [width, height]: [u32; 2]) {
        let mut view = View { width, height, ..self.home.clone() };
        self.control.apply(&mut view);
        if let Some(camera) = self.settings.camera {
            match View::from_camera(&self.scene, camera, width, height) {
                Ok(camera) => (view.world_from_view, view.camera) = (camera.world_from_view, camera.camera),
                Err(error) => {
                    self.settings.camera = None;
                    self.fail(&error.to_string());
                }
            }
        }
        (view.max_depth, view.ray_mask) = (self.settings.depth, self.settings.ray_mask);
        self.view = view;
    }

    /// The projection of the current view.
    pub(crate) fn projection(&self) -> Projection {
        Projection::of(&self.view)
    }

    /// Draws the current view.
    pub(crate) fn draw(&mut self, now: Instant) -> Drawn {
        let drawn = self.drawing.draw(&mut self.scene, &self.view, self.settings.rays, now);
        drawn.unwrap_or_else(|error| {
            self.fail(&error.to_string());
            Drawn::default()
        })
    }

    /// Changes the device.
    pub(crate) fn use_device(&mut self, choice: DeviceChoice) {
        match self.drawing.choose(choice) {
            Ok(()) => self.report_fallback(),
            Err(error) => self.fail(&error.to_string()),
        }
    }

    /// Writes the current view to a file, in full detail, or the scene if the extension is `.ropewalk`.
    pub(crate) fn save(&mut self, path: &Path) {
        let saved = if path.extension().is_some_and(|extension| extension == "ropewalk") {
            self.scene.save(path)
        } else {
            self.drawing.save(&mut self.scene, &self.view, self.settings.rays, path)
        };
        match saved {
            Ok(()) => {
                self.messages.inform(format!("Saved {}", path.display()));
                self.events.push(json!({ "event": "saved", "path": path }));
            }
            Err(error) => self.fail(&error.to_string()),
        }
    }

    // --- Selecting and moving

    /// The selected node, which is in the scene.
    pub(crate) fn selection(&self) -> Option<NodeKey> {
        self.selection
    }

    /// Selects a node, or none.
    pub(crate) fn select(&mut self, node: Option<NodeKey>) {
        self.selection = node.filter(|&node| self.scene.contains(node));
        self.events.push(json!({ "event": "selected", "node": self.selection }));
    }

    /// Selects the node that is visible at a position of the picture.
    pub(crate) fn pick(&mut self, position: DVec2) {
        match self.drawing.pick(&mut self.scene, &self.view, position) {
            Ok(hit) => self.select(hit.map(|hit| in_tree(&hit))),
            Err(error) => self.fail(&error.to_string()),
        }
    }

    /// The corners of the box around the selection, in the order of
    /// [`Bounds::corners`](ropewalk::math::Bounds::corners): the local box of a geometry, or the world-space box of a
    /// subtree.
    pub(crate) fn selected_corners(&mut self) -> Option<[DVec3; 8]> {
        let node = self.selection?;
        if let Some(geometry) = self.scene.node_core(node).ok()?.geometry() {
            let (bounds, world) = (self.scene.geometry_bounds(geometry).ok()?, self.scene.world_from_local(node).ok()?);
            return (!bounds.is_empty()).then(|| bounds.corners().map(|corner| world.transform_point3(corner)));
        }
        let bounds = self.scene.world_bounds(node).ok()?;
        (!bounds.is_empty()).then(|| bounds.corners())
    }

    /// Starts a drag of the selection, if it is visible at this position; returns whether it is.
    pub(crate) fn begin_drag(&mut self, position: DVec2, moves: Moves) -> bool {
        match self.try_begin_drag(position, moves) {
            Ok(drag) => self.drag = drag,
            Err(message) => self.fail(&message),
        }
        self.drag.is_some()
    }

    fn try_begin_drag(&mut self, position: DVec2, moves: Moves) -> Result<Option<Drag>, String> {
        let Some(selection) = self.selection else { return Ok(None) };
        let hit = self.drawing.pick(&mut self.scene, &self.view, position).map_err(|error| error.to_string())?;
        let Some(hit) = hit.filter(|hit| is_at_or_below(&self.scene, in_tree(hit), selection)) else { return Ok(None) };
        let node = moved_by(&self.scene, selection, moves)
            .ok_or("This cannot be moved: neither it nor any node above it is a transform.")?;
        let forward = self.projection().forward();
        let drag = Drag::begin(&self.scene, node, hit.position, forward).map_err(|error| error.to_string())?;
        drag.map(Some).ok_or_else(|| "This cannot be moved: a transform above it is singular.".to_owned())
    }

    /// Moves the dragged node to this position; returns whether there is a drag.
    pub(crate) fn drag_to(&mut self, position: DVec2, axis: Option<Axis>) -> bool {
        let Some(drag) = self.drag else { return false };
        if let Some(local) = drag.to(self.projection().ray(position), axis) {
            self.edit(Edit::Move(drag.node, local));
        }
        true
    }

    /// Ends the drag.
    pub(crate) fn end_drag(&mut self) {
        if let Some(drag) = self.drag.take()
            && let Ok(local) = self.scene.local(drag.node)
        {
            let (translation, anchor) = (local.to_affine().translation, drag.anchor);
            self.events.push(json!({
                "event": "moved", "node": drag.node, "translation": translation.to_array(), "anchor": anchor.to_array(),
            }));
        }
    }

    // --- Editing

    /// Applies an edit, as part of the step of undo that [`end_group`](Self::end_group) ends.
    pub(crate) fn edit(&mut self, edit: Edit) {
        let name = edit.name();
        match edit.apply(&mut self.scene) {
            Ok(()) => self.editing = Some(name),
            Err(error) => self.fail(&error.to_string()),
        }
        self.selection = self.selection.filter(|&node| self.scene.contains(node));
    }

    /// Removes the selected node with its subtree.
    pub(crate) fn remove_selection(&mut self) {
        if let Some(node) = self.selection {
            self.edit(Edit::Remove(node));
        }
    }

    /// Combines all edits since the last call into one step of undo.
    pub(crate) fn end_group(&mut self) {
        if let Some(name) = self.editing.take() {
            self.scene.end_undo_group(name);
            self.events.push(json!({ "event": "edited", "name": name }));
        }
    }

    /// The names of the next steps of undo and redo.
    pub(crate) fn undoable(&self) -> [Option<&str>; 2] {
        [self.scene.next_undo(), self.scene.next_redo()]
    }

    pub(crate) fn undo(&mut self) {
        self.end_group();
        let undone = self.scene.undo();
        self.report_history("undone", undone);
    }

    pub(crate) fn redo(&mut self) {
        self.end_group();
        let redone = self.scene.redo();
        self.report_history("redone", redone);
    }

    fn report_history(&mut self, event: &str, outcome: ropewalk::Result<Option<String>>) {
        self.selection = self.selection.filter(|&node| self.scene.contains(node));
        match outcome {
            Ok(Some(name)) => self.events.push(json!({ "event": event, "name": name })),
            Ok(None) => {}
            Err(error) => self.fail(&error.to_string()),
        }
    }

    /// Shows an error.
    pub(crate) fn fail(&mut self, message: &str) {
        self.messages.fail(message);
        self.events.push(json!({ "event": "error", "message": message }));
    }

    fn report_fallback(&mut self) {
        if let Some(reason) = &self.drawing.fallback {
            self.messages.inform(format!("Tracing on the CPU: {reason}"));
        }
    }
}

/// The requested device; if that fails, the CPU and a message that says why.
fn open_device(choice: DeviceChoice, window: Option<WindowDevice>) -> ropewalk::Result<(Drawing, Messages)> {
    let mut messages = Messages::default();
    let drawing = Drawing::new(choice, window.clone()).or_else(|error| {
        messages.fail(error.to_string());
        Drawing::new(DeviceChoice::Cpu, window)
    })?;
    Ok((drawing, messages))
}

/// The node of the tree that was hit; for a hit within an instance, the outermost instance node.
fn in_tree(hit: &Hit) -> NodeKey {
    hit.path.instances.first().copied().unwrap_or(hit.path.node)
}

fn is_at_or_below(scene: &Scene, node: NodeKey, top: NodeKey) -> bool {
    node == top || scene.ancestors(node).into_iter().flatten().any(|ancestor| ancestor == top)
}
