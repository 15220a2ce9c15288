//! The window's contents: the bar above, the tree at the left, details at the right, the picture in the middle.

use std::path::{Path, PathBuf};

use egui::{Button, CentralPanel, Frame, Key, KeyboardShortcut, Margin, Modifiers, Panel, TextEdit, Ui};

use crate::app::App;
use crate::drag::Moves;
use crate::inspector::Inspector;
use crate::theme;
use crate::tree_panel::TreePanel;
use crate::viewport::{self, Viewport};

/// The state of the panels.
#[derive(Default)]
pub(crate) struct Panels {
    tree: TreePanel,
    inspector: Inspector,
}

impl Panels {
    /// Lays out the window and handles input. Returns the rectangle of the picture.
    pub(crate) fn show(&mut self, ui: &mut Ui, app: &mut App) -> Viewport {
        app.finish_loading();
        if let Some(path) =
            ui.input(|input| input.raw.dropped_files.iter().map(|file| PathBuf::from(file.path())).next_back())
        {
            app.open(Some(path));
        }
        shortcuts(ui, app);
        let panel = Frame::new().fill(theme::PANEL).inner_margin(Margin::same(8));
        Panel::top("bar").frame(panel.inner_margin(Margin::symmetric(8, 5))).show(ui, |ui| bar(ui, app));
        Panel::left("tree").frame(panel).default_size(240.0).show(ui, |ui| self.tree.show(ui, app));
        Panel::right("details").frame(panel).default_size(280.0).resizable(false).show(ui, |ui| {
            self.inspector.show(ui, app);
        });
        let viewport = CentralPanel::no_frame().show(ui, |ui| viewport::show(ui, app)).inner;
        // A drag is one step of undo, however many edits it consists of.
        if !ui.input(|input| input.pointer.any_down()) {
            app.end_group();
        }
        viewport
    }
}

const UNDO: KeyboardShortcut = KeyboardShortcut::new(Modifiers::COMMAND, Key::Z);
const REDO: KeyboardShortcut = KeyboardShortcut::new(Modifiers::COMMAND, Key::Y);
const REDO_ALTERNATIVE: KeyboardShortcut = KeyboardShortcut::new(Modifiers::COMMAND.plus(Modifiers::SHIFT), Key::Z);
const SAVE: KeyboardShortcut = KeyboardShortcut::new(Modifiers::COMMAND, Key::S);

fn shortcuts(ui: &Ui, app: &mut App) {
    // A text field handles undo itself.
    if ui.ctx().egui_wants_keyboard_input() {
        return;
    }
    let pressed = |shortcut| ui.input_mut(|input| input.consume_shortcut(shortcut));
    if pressed(&REDO_ALTERNATIVE) || pressed(&REDO) {
        app.redo();
    }
    if pressed(&UNDO) {
        app.undo();
    }
    if pressed(&SAVE) {
        save(app);
    }
}

fn bar(ui: &mut Ui, app: &mut App) {
    ui.horizontal(|ui| {
        ui.menu_button("File", |ui| file_menu(ui, app));
        ui.separator();
        let [undo, redo] = app.undoable().map(|name| name.map(str::to_owned));
        let button = |ui: &mut Ui, label: &str, what: &str, name: &Option<String>| {
            let hint = name.as_ref().map_or_else(|| format!("Nothing to {what}"), |name| format!("{what} {name}"));
            ui.add_enabled(name.is_some(), Button::new(label))
                .on_hover_text(hint.clone())
                .on_disabled_hover_text(hint)
                .clicked()
        };
        if button(ui, "Undo", "undo", &undo) {
            app.undo();
        }
        if button(ui, "Redo", "redo", &redo) {
            app.redo();
        }
        ui.separator();
        ui.weak("Drag moves");
        ui.selectable_value(&mut app.settings.moves, Moves::Object, "object")
            .on_hover_text("The nearest transform at or above what is selected. Hold X, Y or Z for an axis.");
        ui.selectable_value(&mut app.settings.moves, Moves::Group, "group")
            .on_hover_text("The next transform above that one, with its whole subtree; also with Ctrl held");
        ui.separator();
        if ui.button("Frame").on_hover_text("Bring the selection, or everything, into the picture (F)").clicked() {
            app.frame();
        }
        if ui.button("Home").on_hover_text("Back to where the camera was at first (Home)").clicked() {
            app.go_home();
        }
        ui.toggle_value(&mut app.settings.overlay, "Overlay").on_hover_text("Report and selection box (O)");
        ui.menu_button("Keys", help);
        ui.separator();
        ui.add(egui::Label::new(egui::RichText::new(&app.title).color(theme::WEAK)).truncate());
    });
}

fn file_menu(ui: &mut Ui, app: &mut App) {
    ui.set_min_width(320.0);
    ui.weak("A .gltf, .glb or .ropewalk file; or drop one into the window");
    ui.horizontal(|ui| {
        ui.add(TextEdit::singleline(&mut app.settings.open_path).hint_text("path").desired_width(240.0));
        if ui.add_enabled(!app.settings.open_path.is_empty(), Button::new("Open")).clicked() {
            app.open(Some(PathBuf::from(&app.settings.open_path)));
            ui.close();
        }
    });
    if ui.button("Open the built-in scene").clicked() {
        app.open(None);
        ui.close();
    }
    ui.separator();
    ui.weak("The picture as .png or .exr (Ctrl+S), the scene as .ropewalk");
    ui.horizontal(|ui| {
        ui.add(TextEdit::singleline(&mut app.settings.save_path).desired_width(240.0));
        if ui.button("Save").clicked() {
            save(app);
            ui.close();
        }
    });
}

fn save(app: &mut App) {
    let path = app.settings.save_path.clone();
    app.save(Path::new(&path));
}

fn help(ui: &mut Ui) {
    egui::Grid::new("keys").num_columns(2).spacing([16.0, 3.0]).show(ui, |ui| {
        for (keys, what) in [
            ("click", "select"),
            ("drag", "turn around; on what is selected: move it"),
            ("X, Y, Z while moving", "along that axis"),
            ("Ctrl while moving", "the group above"),
            ("right drag", "look around"),
            ("middle or Shift drag", "pan"),
            ("wheel", "nearer and further"),
            ("W A S D Q E", "fly (Shift: faster)"),
            ("F, Home", "frame the selection, go home"),
            ("Ctrl+Z, Ctrl+Y", "undo, redo"),
            ("R", "trace all rays now"),
            ("O, Esc", "overlay, select nothing"),
            ("Delete", "remove the selection"),
        ] {
            ui.colored_label(theme::ACCENT, keys);
            ui.label(what);
            ui.end_row();
        }
    });
}
