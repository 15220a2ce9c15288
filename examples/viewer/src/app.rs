//! The state of the viewer and all that can be done with it. Knows nothing of windows.

use std::path::{Path, PathBuf};
use std::time::Instant;

use glam::{DVec2, DVec3};
use ropewalk::query::Hit;
use ropewalk::{DeviceChoice, NodeKey, Scene, View};
use serde_json::{Value, json};

use crate::camera_control::CameraControl;
use crate::device::WindowDevice;
use crate::drag::{Axis, Drag, Moves, moved_by};
use crate::drawing::{Drawing, Drawn};
use crate::edit::Edit;
use crate::messages::Messages;
use crate::projection::Projection;
use crate::stage::cameras;
use crate::subject::{Loading, Subject};

/// Everything but the window.
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
    /// Where the camera was at first.
    home: View,
    /// What was last seen, of the size that it has in the window.
    view: View,
    drag: Option<Drag>,
    loading: Option<Loading>,
    events: Vec<Value>,
}

/// What the user chooses.
#[derive(Clone, Debug)]
pub(crate) struct Settings {
    pub(crate) depth: u32,
    /// So many by so many rays a pixel, where nothing moves.
    pub(crate) rays: u32,
    /// Nodes whose mask shares no bit with it are not seen.
    pub(crate) ray_mask: u32,
    /// A camera of the scene; none for the free one.
    pub(crate) camera: Option<NodeKey>,
    pub(crate) moves: Moves,
    /// Whether panels, boxes and numbers are shown.
    pub(crate) overlay: bool,
    /// Where pictures are saved.
    pub(crate) save_path: String,
    /// What is typed in to be opened.
    pub(crate) open_path: String,
}

impl App {
    /// With an empty scene.
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
        app.tell_device();
        Ok(app)
    }

    /// What happened since the last call, for the log.
    pub(crate) fn take_events(&mut self) -> Vec<Value> {
        std::mem::take(&mut self.events)
    }

    // --- The scene

    /// Begins to load a file or, without one, the built-in scene.
    pub(crate) fn open(&mut self, path: Option<PathBuf>) {
        self.loading = Some(Loading::begin(path));
    }

    /// The name of what is being loaded.
    pub(crate) fn loading(&self) -> Option<&str> {
        self.loading.as_ref().map(|loading| loading.title.as_str())
    }

    /// Shows what was loaded, once it is.
    pub(crate) fn finish_loading(&mut self) {
        match self.loading.as_ref().and_then(Loading::poll) {
            None => return,
            Some(Ok(subject)) => self.show(subject),
            Some(Err(message)) => self.fail(&message),
        }
        self.loading = None;
    }

    /// Shows another scene.
    pub(crate) fn show(&mut self, subject: Subject) {
        let Subject { scene, title, view, not_honoured } = subject;
        if not_honoured > 0 {
            self.messages.tell(format!("{title}: {not_honoured} features of the file are not honoured"));
        }
        self.events.push(json!({ "event": "opened", "title": title, "nodes": scene.node_count() }));
        (self.scene, self.title, self.home) = (scene, title, view);
        (self.editing, self.selection, self.drag) = (None, None, None);
        self.scene.enable_undo();
        self.drawing.start_over();
        self.go_home();
    }

    // --- The camera

    /// Puts the free camera where it was at first.
    pub(crate) fn go_home(&mut self) {
        self.settings.camera = None;
        let middle = self.middle();
        self.control = CameraControl::from_view(&self.home, middle);
    }

    /// Brings the selection, or without one the whole scene, into the picture.
    pub(crate) fn frame(&mut self) {
        let node = self.selection.unwrap_or(self.scene.root());
        match self.scene.world_bounds(node) {
            Ok(bounds) if !bounds.is_empty() => self.free_camera().frame(&bounds),
            Ok(_) => {}
            Err(error) => self.fail(&error.to_string()),
        }
    }

    /// The free camera, which from now on is looked through: from where the view is.
    pub(crate) fn free_camera(&mut self) -> &mut CameraControl {
        if self.settings.camera.take().is_some() {
            let middle = self.middle();
            self.control = CameraControl::from_view(&self.view, middle);
        }
        &mut self.control
    }

    /// The middle of the scene.
    fn middle(&mut self) -> DVec3 {
        let bounds = self.scene.world_bounds(self.scene.root()).ok().filter(|bounds| !bounds.is_empty());
        bounds.map_or(DVec3::ZERO, |bounds| bounds.center())
    }

    /// The cameras of the scene.
    pub(crate) fn cameras(&self) -> Vec<NodeKey> {
        cameras(&self.scene)
    }

    /// Takes the size of the picture, and looks through the chosen camera.
    pub(crate) fn look(&mut self, [width, height]: [u32; 2]) {
        let mut view = View { width, height, ..self.home.clone() };
        self.control.apply(&mut view);
        if let Some(camera) = self.settings.camera {
            match View::from_camera(&self.scene, camera, width, height) {
                Ok(seen) => (view.world_from_view, view.camera) = (seen.world_from_view, seen.camera),
                Err(error) => {
                    self.settings.camera = None;
                    self.fail(&error.to_string());
                }
            }
        }
        (view.max_depth, view.ray_mask) = (self.settings.depth, self.settings.ray_mask);
        self.view = view;
    }

    /// How the current view maps the world to its picture.
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

    /// Traces with another device.
    pub(crate) fn use_device(&mut self, choice: DeviceChoice) {
        match self.drawing.choose(choice) {
            Ok(()) => self.tell_device(),
            Err(error) => self.fail(&error.to_string()),
        }
    }

    /// Writes the current view to a file, in full detail; or, as the name's ending says, the scene.
    pub(crate) fn save(&mut self, path: &Path) {
        let saved = if path.extension().is_some_and(|extension| extension == "ropewalk") {
            self.scene.save(path)
        } else {
            self.drawing.save(&mut self.scene, &self.view, self.settings.rays, path)
        };
        match saved {
            Ok(()) => {
                self.messages.tell(format!("Saved {}", path.display()));
                self.events.push(json!({ "event": "saved", "path": path }));
            }
            Err(error) => self.fail(&error.to_string()),
        }
    }

    // --- Selecting and moving

    /// The node that is selected. It is in the scene.
    pub(crate) fn selection(&self) -> Option<NodeKey> {
        self.selection
    }

    /// Selects a node, or nothing.
    pub(crate) fn select(&mut self, node: Option<NodeKey>) {
        self.selection = node.filter(|&node| self.scene.contains(node));
        self.events.push(json!({ "event": "selected", "node": self.selection }));
    }

    /// Selects what is seen at a position of the picture.
    pub(crate) fn pick(&mut self, position: DVec2) {
        match self.drawing.pick(&mut self.scene, &self.view, position) {
            Ok(hit) => self.select(hit.map(|hit| in_tree(&hit))),
            Err(error) => self.fail(&error.to_string()),
        }
    }

    /// The corners of the box around the selection, in the order of [`Bounds::padded_corners`](ropewalk::Bounds::corners): its
    /// own box where it is a geometry, a box along the world's axes around a subtree.
    pub(crate) fn selected_corners(&mut self) -> Option<[DVec3; 8]> {
        let node = self.selection?;
        if let Some(geometry) = self.scene.node_core(node).ok()?.geometry() {
            let (bounds, world) = (self.scene.geometry_bounds(geometry).ok()?, self.scene.world_from_local(node).ok()?);
            return (!bounds.is_empty()).then(|| bounds.corners().map(|corner| world.transform_point3(corner)));
        }
        let bounds = self.scene.world_bounds(node).ok()?;
        (!bounds.is_empty()).then(|| bounds.corners())
    }

    /// Takes hold of the selection, if it is what is seen at this position; whether it is.
    pub(crate) fn begin_drag(&mut self, position: DVec2, moves: Moves) -> bool {
        match self.take_hold(position, moves) {
            Ok(drag) => self.drag = drag,
            Err(message) => self.fail(&message),
        }
        self.drag.is_some()
    }

    fn take_hold(&mut self, position: DVec2, moves: Moves) -> Result<Option<Drag>, String> {
        let Some(selection) = self.selection else { return Ok(None) };
        let hit = self.drawing.pick(&mut self.scene, &self.view, position).map_err(|error| error.to_string())?;
        let Some(hit) = hit.filter(|hit| is_at_or_below(&self.scene, in_tree(hit), selection)) else { return Ok(None) };
        let node = moved_by(&self.scene, selection, moves)
            .ok_or("This cannot be moved: neither it nor any node above it is a transform.")?;
        let forward = self.projection().forward();
        let drag = Drag::begin(&self.scene, node, hit.position, forward).map_err(|error| error.to_string())?;
        drag.map(Some).ok_or_else(|| "This cannot be moved: a transform above it is singular.".to_owned())
    }

    /// Moves what was taken hold of to this position; whether anything was.
    pub(crate) fn drag_to(&mut self, position: DVec2, axis: Option<Axis>) -> bool {
        let Some(drag) = self.drag else { return false };
        if let Some(local) = drag.to(self.projection().ray(position), axis) {
            self.edit(Edit::Move(drag.node, local));
        }
        true
    }

    /// Lets go.
    pub(crate) fn end_drag(&mut self) {
        if let Some(drag) = self.drag.take()
            && let Ok(local) = self.scene.local(drag.node)
        {
            let (place, anchor) = (local.to_affine().translation, drag.anchor);
            self.events.push(json!({
                "event": "moved", "node": drag.node, "translation": place.to_array(), "anchor": anchor.to_array(),
            }));
        }
    }

    // --- Editing

    /// Changes the scene, as part of the step of undo that [`end_group`](Self::end_group) ends.
    pub(crate) fn edit(&mut self, edit: Edit) {
        let name = edit.name();
        match edit.apply(&mut self.scene) {
            Ok(()) => self.editing = Some(name),
            Err(error) => self.fail(&error.to_string()),
        }
        self.selection = self.selection.filter(|&node| self.scene.contains(node));
    }

    /// Removes what is selected, with everything below it.
    pub(crate) fn remove_selection(&mut self) {
        if let Some(node) = self.selection {
            self.edit(Edit::Remove(node));
        }
    }

    /// Makes one step of undo of all edits since the last.
    pub(crate) fn end_group(&mut self) {
        if let Some(name) = self.editing.take() {
            self.scene.end_undo_group(name);
            self.events.push(json!({ "event": "edited", "name": name }));
        }
    }

    /// The names of what can be undone and done again.
    pub(crate) fn undoable(&self) -> [Option<&str>; 2] {
        [self.scene.next_undo(), self.scene.next_redo()]
    }

    pub(crate) fn undo(&mut self) {
        self.end_group();
        let undone = self.scene.undo();
        self.tell_history("undone", undone);
    }

    pub(crate) fn redo(&mut self) {
        self.end_group();
        let redone = self.scene.redo();
        self.tell_history("redone", redone);
    }

    fn tell_history(&mut self, event: &str, outcome: ropewalk::Result<Option<String>>) {
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

    fn tell_device(&mut self) {
        if let Some(reason) = &self.drawing.fallback {
            self.messages.tell(format!("Tracing on the CPU: {reason}"));
        }
    }
}

/// The device asked for; where that does not work, the CPU, and a message that says why.
fn open_device(choice: DeviceChoice, window: Option<WindowDevice>) -> ropewalk::Result<(Drawing, Messages)> {
    let mut messages = Messages::default();
    let drawing = Drawing::new(choice, window.clone()).or_else(|error| {
        messages.fail(error.to_string());
        Drawing::new(DeviceChoice::Cpu, window)
    })?;
    Ok((drawing, messages))
}

/// The node of the tree that was hit; of what is seen through instances, the outermost instance.
fn in_tree(hit: &Hit) -> NodeKey {
    hit.path.instances.first().copied().unwrap_or(hit.path.node)
}

fn is_at_or_below(scene: &Scene, node: NodeKey, top: NodeKey) -> bool {
    node == top || scene.ancestors(node).into_iter().flatten().any(|ancestor| ancestor == top)
}
