//! The right panel: settings of the view, and properties of the selected node.

use egui::{ComboBox, DragValue, Grid, Label, RichText, Sense, Slider, TextEdit, Ui, Vec2, vec2};
use glam::{DQuat, DVec3, EulerRot};
use ropewalk::{Core, DeviceChoice, NodeKey, Scene, Transform};

use crate::app::App;
use crate::cameras_and_lights::camera_name;
use crate::detail::Detail;
use crate::edit::Edit;
use crate::{node_icons, theme};

/// Edit state of widgets that is not in the scene.
#[derive(Default)]
pub(crate) struct Inspector {
    /// The node whose name is edited, and the text so far.
    name: Option<(NodeKey, String)>,
    /// A rotation, and the Euler angles in degrees by which it was typed in: others would give the same rotation.
    angles: Option<(DQuat, DVec3)>,
}

impl Inspector {
    pub(crate) fn show(&mut self, ui: &mut Ui, app: &mut App) {
        ui.strong("View");
        view(ui, app);
        ui.add_space(8.0);
        ui.separator();
        match app.selection() {
            Some(node) => self.node(ui, app, node),
            None => {
                ui.weak("Nothing is selected: click an object or a row of the tree.");
            }
        }
    }

    fn node(&mut self, ui: &mut Ui, app: &mut App, node: NodeKey) {
        let (Ok(core), Ok(visible), Ok(mask)) =
            (app.scene.node_core(node), app.scene.is_visible(node), app.scene.mask(node))
        else {
            return;
        };
        let core = core.clone();
        ui.horizontal(|ui| {
            let (icon, _) = ui.allocate_exact_size(Vec2::splat(2.0 * node_icons::RADIUS), Sense::hover());
            node_icons::paint(ui.painter(), icon.center(), core.kind(), 1.0);
            ui.strong(core.kind().name());
            ui.add(Label::new(RichText::new(describe(&app.scene, node, &core)).weak()).truncate());
        });
        self.name(ui, app, node);

        let mut shown = visible;
        if ui.checkbox(&mut shown, "Visible").changed() {
            app.edit(Edit::Show(node, shown));
        }
        if let Some(mask) = mask_editor(ui, "Mask", mask) {
            app.edit(Edit::Mask(node, mask));
        }
        if let Core::Transform(transform) = core {
            ui.add_space(4.0);
            self.transform(ui, app, node, transform);
        }
    }

    fn name(&mut self, ui: &mut Ui, app: &mut App, node: NodeKey) {
        let current = app.scene.name(node).unwrap_or_default().to_owned();
        let typed = match &mut self.name {
            Some((of, typed)) if *of == node => typed,
            name => &mut name.insert((node, current.clone())).1,
        };
        let edit = ui.add(TextEdit::singleline(typed).hint_text("name").desired_width(f32::INFINITY));
        if edit.lost_focus() && *typed != current {
            app.edit(Edit::Rename(node, typed.clone()));
        } else if !edit.has_focus() {
            *typed = current;
        }
    }

    fn transform(&mut self, ui: &mut Ui, app: &mut App, node: NodeKey, transform: Transform) {
        let (mut scale, rotation, mut translation) = match transform {
            Transform::Trs { translation, rotation, scale }
            | Transform::Pivoted { translation, rotation, scale, .. } => (scale, rotation, translation),
            Transform::Matrix(matrix) => matrix.to_scale_rotation_translation(),
        };
        let mut angles = self.angles_of(rotation);
        let radius = app.scene.world_bounds(node).map_or(1.0, |bounds| bounds.radius());
        let step = (radius * 0.02).clamp(1e-6, 1e6);
        let (mut moved, mut turned) = (false, false);
        Grid::new("transform").num_columns(4).spacing(vec2(6.0, 4.0)).show(ui, |ui| {
            moved |= row(ui, "Position", &mut translation, step, 3);
            turned |= row(ui, "Rotation", &mut angles, 0.5, 1);
            moved |= row(ui, "Scale", &mut scale, 0.01, 3);
        });
        if matches!(transform, Transform::Matrix(_)) {
            ui.weak("This is a matrix: an edit here drops its shear.");
        }
        if let Ok(users) = app.scene.core_key(node).and_then(|core| app.scene.users(core).map(Iterator::count))
            && users > 1
        {
            ui.weak(format!("{users} nodes share this transform."));
        }
        if moved || turned {
            let rotation = if turned { rotation_of(angles) } else { rotation };
            self.angles = Some((rotation, angles));
            let edited = match transform {
                Transform::Pivoted { scale_rotation, pivot, .. } => {
                    Transform::Pivoted { translation, rotation, scale, scale_rotation, pivot }
                }
                Transform::Trs { .. } | Transform::Matrix(_) => Transform::Trs { translation, rotation, scale },
            };
            app.edit(Edit::Move(node, edited));
        }
    }

    /// The Euler angles in degrees: those typed last if they give this rotation.
    fn angles_of(&mut self, rotation: DQuat) -> DVec3 {
        match self.angles {
            Some((of, angles)) if of.abs_diff_eq(rotation, 1e-12) => angles,
            _ => {
                let (y, x, z) = rotation.to_euler(EulerRot::YXZ);
                // Without negative zeros.
                let angles = DVec3::new(x, y, z).map(f64::to_degrees) + 0.0;
                self.angles = Some((rotation, angles));
                angles
            }
        }
    }
}

fn rotation_of(degrees: DVec3) -> DQuat {
    let [x, y, z] = degrees.map(f64::to_radians).to_array();
    DQuat::from_euler(EulerRot::YXZ, y, x, z)
}

/// A row of three numbers; returns whether one was changed.
fn row(ui: &mut Ui, label: &str, value: &mut DVec3, speed: f64, decimals: usize) -> bool {
    ui.label(label);
    let mut changed = false;
    for number in value.as_mut() {
        let drag = DragValue::new(number).speed(speed).max_decimals(decimals.max(3)).min_decimals(1);
        changed |= ui.add_sized(vec2(62.0, 20.0), drag).changed();
    }
    ui.end_row();
    changed
}

/// Checkboxes for the 32 bits of a mask; returns the new mask if it changed.
fn mask_editor(ui: &mut Ui, label: &str, mask: u32) -> Option<u32> {
    const SIZE: f32 = 12.0;
    const GAP: f32 = 3.0;

    let mut edited = None;
    ui.horizontal(|ui| {
        ui.label(label);
        if ui.small_button("all").clicked() {
            edited = Some(u32::MAX);
        }
        if ui.small_button("none").clicked() {
            edited = Some(0);
        }
        ui.weak(format!("{mask:08x}"));
    });
    let (area, _) = ui.allocate_exact_size(vec2(16.0 * (SIZE + GAP), 2.0 * (SIZE + GAP)), Sense::hover());
    for bit in 0..u32::BITS {
        let offset = vec2((bit % 16) as f32, (bit / 16) as f32) * (SIZE + GAP);
        let rect = egui::Rect::from_min_size(area.min + offset, vec2(SIZE, SIZE));
        let response = ui.interact(rect, ui.scope_id().with((label, bit)), Sense::click());
        let is_set = mask >> bit & 1 == 1;
        let color = match (is_set, response.hovered()) {
            (true, false) => theme::ACCENT.gamma_multiply(0.75),
            (true, true) => theme::ACCENT,
            (false, false) => theme::HOVERED,
            (false, true) => theme::SELECTED,
        };
        ui.painter().rect_filled(rect, 2.0, color);
        if response.on_hover_text(format!("bit {bit}")).clicked() {
            edited = Some(mask ^ 1 << bit);
        }
    }
    edited.filter(|&new| new != mask)
}

/// Properties of a core, in words.
fn describe(scene: &Scene, node: NodeKey, core: &Core) -> String {
    match core {
        Core::Geometry { geometry, .. } => {
            let triangles = scene.geometry(*geometry).map_or(0, |geometry| geometry.indices.len());
            let users = scene.core_key(node).and_then(|core| Ok(scene.users(core)?.count())).unwrap_or(1);
            let shared = if users > 1 { format!(", shared by {users} nodes") } else { String::new() };
            format!("{triangles} {}{shared}", if triangles == 1 { "triangle" } else { "triangles" })
        }
        _ => {
            let children = scene.children(node).map_or(0, Iterator::count);
            format!("{children} {}", if children == 1 { "child" } else { "children" })
        }
    }
}

/// Settings of the view: device, camera, depth, rays and ray mask.
fn view(ui: &mut Ui, app: &mut App) {
    Grid::new("view").num_columns(2).spacing(vec2(12.0, 5.0)).show(ui, |ui| {
        ui.label("Device");
        device(ui, app);
        ui.end_row();
        ui.label("Camera");
        camera(ui, app);
        ui.end_row();
        ui.label("Depth");
        ui.add(Slider::new(&mut app.settings.depth, 0..=1000).logarithmic(true))
            .on_hover_text("Reflections and refractions that a ray may have");
        ui.end_row();
        ui.label("Rays a pixel");
        ui.horizontal(|ui| {
            for rays in 1..=3 {
                ui.selectable_value(&mut app.settings.rays, rays, format!("{0}×{0}", rays));
            }
        });
        ui.end_row();
    });
    if let Some(mask) = mask_editor(ui, "Ray mask", app.settings.ray_mask) {
        app.settings.ray_mask = mask;
    }
    let shown = app.drawing.detail();
    if let (Some(shown), Some(time)) = (shown, app.drawing.forecast(app.settings.rays))
        && shown != Detail::fine(app.settings.rays)
    {
        ui.horizontal(|ui| {
            ui.weak(format!("All rays take about {:.1} s.", time.as_secs_f64()));
            if ui.small_button("Trace them").on_hover_text("The window waits for them (R)").clicked() {
                app.drawing.finish();
            }
        });
    }
}

fn device(ui: &mut Ui, app: &mut App) {
    let current = app.drawing.choice;
    let mut chosen = current;
    ComboBox::from_id_salt("device").selected_text(device_name(current)).width(150.0).show_ui(ui, |ui| {
        for choice in [DeviceChoice::Auto, DeviceChoice::Gpu, DeviceChoice::Cpu, DeviceChoice::Emulated] {
            ui.selectable_value(&mut chosen, choice, device_name(choice));
        }
    });
    if chosen != current {
        app.use_device(chosen);
    }
}

fn device_name(choice: DeviceChoice) -> &'static str {
    match choice {
        DeviceChoice::Auto => "auto",
        DeviceChoice::Gpu => "gpu",
        DeviceChoice::Cpu => "cpu",
        DeviceChoice::Emulated => "emulated",
    }
}

fn camera(ui: &mut Ui, app: &mut App) {
    let label = |scene: &Scene, camera: Option<NodeKey>| match camera {
        None => "free".to_owned(),
        Some(node) => match camera_name(scene, node) {
            "" => "camera".to_owned(),
            name => name.to_owned(),
        },
    };
    let mut chosen = app.settings.camera;
    ComboBox::from_id_salt("camera").selected_text(label(&app.scene, chosen)).width(150.0).show_ui(ui, |ui| {
        ui.selectable_value(&mut chosen, None, "free");
        for camera in app.cameras() {
            ui.selectable_value(&mut chosen, Some(camera), label(&app.scene, Some(camera)));
        }
    });
    match chosen {
        None => drop(app.free_camera()),
        chosen => app.settings.camera = chosen,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn angles_stand_for_their_rotation() {
        for degrees in [DVec3::ZERO, DVec3::new(10.0, -170.0, 35.0), DVec3::new(-80.0, 20.0, 179.0)] {
            let mut inspector = Inspector::default();
            let rotation = rotation_of(degrees);
            let shown = inspector.angles_of(rotation);
            assert!(rotation_of(shown).dot(rotation).abs() > 1.0 - 1e-12, "{degrees} is shown as {shown}");
        }
    }
}
