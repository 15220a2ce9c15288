//! Whole sessions without a window: pointer and keys through egui, and their effect on the scene.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use egui::{Event, Key, Modifiers, PointerButton, Pos2, RawInput, Rect, pos2, vec2};
use ropewalk::{Core, DeviceChoice, NodeKey};
use serde_json::Value;

use crate::app::{App, Settings};
use crate::drag::Moves;
use crate::edit::Edit;
use crate::loaded_scene::LoadedScene;
use crate::ui::Panels;
use crate::viewport::Viewport;

/// The viewer without its window.
struct Session {
    app: App,
    panels: Panels,
    context: egui::Context,
    viewport: Viewport,
    events: Vec<Value>,
}

impl Session {
    /// With the built-in scene.
    fn new() -> Self {
        let settings = Settings {
            depth: 1,
            rays: 1,
            ray_mask: u32::MAX,
            camera: None,
            moves: Moves::Object,
            overlay: true,
            save_path: String::new(),
            open_path: String::new(),
            allowed_folders: Vec::new(),
        };
        let mut app = App::new(DeviceChoice::Cpu, settings, None).unwrap();
        app.show(LoadedScene::load(None, &[]).unwrap());
        let context = egui::Context::default();
        let mut session =
            Self { app, panels: Panels::default(), context, viewport: Viewport::default(), events: Vec::new() };
        // Panels find their sizes in the first passes.
        (0..3).for_each(|_| session.pass(Vec::new(), Vec::new()));
        session
    }

    fn pass(&mut self, events: Vec<Event>, dropped_files: Vec<egui::DroppedFileHandle>) {
        let screen_rect = Some(Rect::from_min_size(Pos2::ZERO, vec2(760.0, 300.0)));
        let input = RawInput { screen_rect, events, dropped_files, focused: true, ..RawInput::default() };
        let (panels, app, viewport) = (&mut self.panels, &mut self.app, &mut self.viewport);
        let mut output = self.context.run_ui(input, |ui| *viewport = panels.show(ui, app));
        output.textures_delta.clear();
        self.events.extend(self.app.take_events());
    }

    fn point(&mut self, at: Pos2) {
        self.pass(vec![Event::PointerMoved(at)], Vec::new());
    }

    fn button(&mut self, pos: Pos2, pressed: bool) {
        let (button, modifiers) = (PointerButton::Primary, Modifiers::NONE);
        self.pass(vec![Event::PointerButton { pos, button, pressed, modifiers }], Vec::new());
    }

    fn click(&mut self, at: Pos2) {
        self.point(at);
        self.button(at, true);
        self.button(at, false);
    }

    fn drag(&mut self, from: Pos2, to: Pos2) {
        self.point(from);
        self.button(from, true);
        (1..=5).for_each(|step| self.point(from + (to - from) * (step as f32 / 5.0)));
        self.button(to, false);
    }

    fn key(&mut self, key: Key, modifiers: Modifiers) {
        let event = |pressed| Event::Key { key, physical_key: None, pressed, repeat: false, modifiers };
        self.pass(vec![Event::ModifiersChanged(modifiers), event(true)], Vec::new());
        self.pass(vec![event(false), Event::ModifiersChanged(Modifiers::NONE)], Vec::new());
    }

    /// The window position of a point of the picture, given as fractions of its width and height.
    fn at(&self, across: f32, down: f32) -> Pos2 {
        let Viewport { x, y, width, height } = self.viewport;
        pos2(x as f32 + width as f32 * across, y as f32 + height as f32 * down)
    }

    fn count(&self, name: &str) -> usize {
        self.events.iter().filter(|event| event["event"] == name).count()
    }

    fn drum_and_knot(&self) -> (NodeKey, NodeKey) {
        (self.app.scene.find("drum").unwrap(), self.app.scene.find("knot").unwrap())
    }
}

#[test]
fn a_click_selects_and_a_second_drag_moves_what_is_above_as_one_edit() {
    let mut session = Session::new();
    let middle = session.at(0.5, 0.62);
    session.click(middle);
    let (drum, knot) = session.drum_and_knot();
    assert_eq!(session.app.selection(), Some(drum));

    // No transform is above the drum: it stays, and a message says so.
    session.drag(middle, middle + vec2(20.0, 0.0));
    assert_eq!((session.count("error"), session.count("moved")), (1, 0));

    session.app.select(Some(knot));
    let strand = session.app.scene.children(knot).unwrap().next().unwrap();
    let column: Vec<Pos2> = (0..200).map(|i| session.at(0.5, i as f32 / 200.0)).collect();
    let rope = column.into_iter().find(|&at| {
        session.click(at);
        let picked = session.app.selection();
        picked.is_some_and(|node| session.app.scene.ancestors(node).unwrap().any(|above| above == knot))
    });
    let rope = rope.expect("the rope is seen");
    session.app.select(Some(knot));
    let (before, strand_before) = (session.app.scene.local(knot).unwrap(), session.app.scene.local(strand).unwrap());
    session.drag(rope, rope + vec2(30.0, 10.0));
    let after = session.app.scene.local(knot).unwrap();
    assert_ne!(after, before);
    assert_eq!(session.app.scene.local(strand).unwrap(), strand_before);
    assert_eq!((session.count("moved"), session.count("edited")), (1, 1));

    session.key(Key::Z, Modifiers::COMMAND);
    assert_eq!(session.app.scene.local(knot).unwrap(), before);
    session.key(Key::Y, Modifiers::COMMAND);
    assert_eq!(session.app.scene.local(knot).unwrap(), after);
}

#[test]
fn dragging_beside_the_selection_turns_the_camera_only() {
    let mut session = Session::new();
    let revision = session.app.scene.revision();
    let ray = session.app.projection().ray(glam::DVec2::ZERO);
    let sky = session.at(0.5, 0.02);
    session.drag(sky, sky + vec2(40.0, 12.0));
    assert_ne!(session.app.projection().ray(glam::DVec2::ZERO), ray);
    session.key(Key::Home, Modifiers::NONE);
    let home = session.app.projection().ray(glam::DVec2::ZERO);
    assert!(home.direction.distance(ray.direction) < 1e-12 && home.origin.distance(ray.origin) < 1e-12);
    assert_eq!(session.app.scene.revision(), revision);
}

#[test]
fn every_kind_of_edit_is_undone_and_done_again() {
    let mut session = Session::new();
    let (drum, knot) = session.drum_and_knot();
    let turned = ropewalk::Transform::from_translation(glam::DVec3::X);
    for edit in [
        Edit::Rename(drum, "barrel".into()),
        Edit::Show(drum, false),
        Edit::Mask(drum, 5),
        Edit::Move(knot, turned),
        Edit::Remove(knot),
    ] {
        session.app.edit(edit);
        session.app.end_group();
    }
    let state = |app: &App| {
        let scene = &app.scene;
        let (name, core) = (scene.name(drum).unwrap().to_owned(), scene.node_core(knot).ok().cloned());
        (name, scene.is_visible(drum).unwrap(), scene.mask(drum).unwrap(), core)
    };
    let moved = ("barrel".to_owned(), false, 5, Some(Core::Transform(turned)));
    let edited = (moved.0.clone(), false, 5, None);
    assert_eq!(state(&session.app), edited);
    session.app.undo();
    assert_eq!(state(&session.app), moved);
    (0..5).for_each(|_| session.app.undo());
    let original = state(&session.app);
    assert_eq!((original.0.as_str(), original.1, original.2), ("drum", true, u32::MAX));
    assert!(original.3.is_some() && original.3 != moved.3);
    (0..6).for_each(|_| session.app.redo());
    assert_eq!(state(&session.app), edited);
}

#[test]
fn a_failing_edit_is_told_and_changes_nothing() {
    let mut session = Session::new();
    let (drum, knot) = session.drum_and_knot();
    let revision = session.app.scene.revision();
    session.app.edit(Edit::Move(drum, ropewalk::Transform::IDENTITY));
    session.app.edit(Edit::Move(knot, ropewalk::Transform::from_scale(glam::DVec3::NAN)));
    session.app.end_group();
    session.pass(Vec::new(), Vec::new());
    assert_eq!((session.count("error"), session.count("edited")), (2, 0));
    assert_eq!(session.app.scene.revision(), revision);
    assert_eq!(session.app.undoable(), [None, None]);
}

#[test]
fn a_dropped_file_is_opened_and_a_bad_one_leaves_what_there_was() {
    let mut session = Session::new();
    let folder = tempfile::tempdir().unwrap();
    let (good, bad) = (folder.path().join("empty.gltf"), folder.path().join("bad.gltf"));
    std::fs::write(&good, r#"{"asset":{"version":"2.0"},"scenes":[{"nodes":[0]}],"nodes":[{"name":"lone"}]}"#).unwrap();
    std::fs::write(&bad, "{").unwrap();
    session.drop_file(bad);
    assert_eq!((session.count("error"), session.count("opened")), (1, 1));
    assert!(session.app.scene.find("drum").is_some());
    session.drop_file(good);
    assert_eq!((session.app.title.as_str(), session.count("opened")), ("empty.gltf", 2));
    assert!(session.app.scene.find("lone").is_some());
}

#[test]
fn a_saved_scene_is_opened_as_it_was() {
    let mut session = Session::new();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("edited.ropewalk");
    let (drum, knot) = session.drum_and_knot();
    session.app.edit(Edit::Rename(drum, "barrel".into()));
    session.app.edit(Edit::Show(knot, false));
    session.app.save(&path);
    let saved = session.app.scene.snapshot();
    session.drop_file(path);
    assert_eq!((session.count("saved"), session.count("error")), (1, 0));
    assert_eq!(session.app.scene.snapshot(), saved);
}

/// A dropped file, as the window system passes it.
#[derive(Debug)]
struct Dropped(PathBuf);

impl egui::DroppedFile for Dropped {
    fn path(&self) -> &Path {
        &self.0
    }

    fn bytes(&self) -> Result<Vec<u8>, String> {
        std::fs::read(&self.0).map_err(|error| error.to_string())
    }
}

impl Session {
    /// Drops a file and waits until it is loaded, or has failed to be.
    fn drop_file(&mut self, path: PathBuf) {
        self.pass(Vec::new(), vec![Arc::new(Dropped(path))]);
        while self.app.loading().is_some() {
            self.pass(Vec::new(), Vec::new());
        }
        self.pass(Vec::new(), Vec::new());
    }
}

#[test]
fn frames_become_sharp_and_then_rest() {
    let mut session = Session::new();
    let mut details = Vec::new();
    session.app.drawing.finish();
    loop {
        let drawn = session.app.draw(Instant::now());
        details.extend(session.app.drawing.detail().filter(|_| drawn.picture.is_some()));
        if drawn.picture.is_none() && drawn.again.is_none() {
            break;
        }
        session.app.drawing.finish();
    }
    assert_eq!(details.last().map(|detail| (detail.block, detail.rays)), Some((1, 1)));
    let revision = session.app.scene.revision();
    let knot = session.drum_and_knot().1;
    session.app.edit(Edit::Show(knot, false));
    assert_ne!(session.app.scene.revision(), revision);
    assert!(session.app.draw(Instant::now()).picture.is_some(), "an edit is seen");
}

#[test]
fn the_device_can_be_changed_at_any_time() {
    let mut session = Session::new();
    session.app.use_device(DeviceChoice::Emulated);
    assert!(session.app.draw(Instant::now()).picture.is_some());
    assert_eq!(session.app.drawing.choice, DeviceChoice::Emulated);
    assert_eq!(session.app.drawing.report.as_ref().map(|report| report.device.executor), Some("emulated"));
}
