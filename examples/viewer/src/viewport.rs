//! The picture, and input by pointer and keys within it.

use egui::{Key, Modifiers, PointerButton, Pos2, Rect, Response, Sense, Ui};
use glam::{DVec2, DVec3, dvec2};

use crate::app::App;
use crate::drag::{Axis, Moves};
use crate::overlay;

/// The rectangle of the picture in the window, in pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Viewport {
    pub(crate) x: u32,
    pub(crate) y: u32,
    pub(crate) width: u32,
    pub(crate) height: u32,
}

impl Viewport {
    fn of(rect: Rect, scale: f32) -> Self {
        let pixels = |points: f32| (points * scale).round().max(0.0) as u32;
        let (x, y) = (pixels(rect.left()), pixels(rect.top()));
        let (right, bottom) = (pixels(rect.right()), pixels(rect.bottom()));
        Self { x, y, width: right.saturating_sub(x), height: bottom.saturating_sub(y) }
    }

    /// Clips it to a window of this size.
    pub(crate) fn within(self, [width, height]: [u32; 2]) -> Self {
        let (x, y) = (self.x.min(width), self.y.min(height));
        Self { x, y, width: self.width.min(width - x), height: self.height.min(height - y) }
    }
}

/// Fills the remaining space, and handles input there.
pub(crate) fn show(ui: &mut Ui, app: &mut App) -> Viewport {
    let (rect, scale) = (ui.max_rect(), ui.ctx().pixels_per_point());
    let viewport = Viewport::of(rect, scale);
    let size = [viewport.width, viewport.height];
    app.update_view(size);
    let response = ui.interact(rect, ui.scope_id().with("picture"), Sense::click_and_drag());
    // The center of the pixel under the pointer.
    let position = |at: Pos2| {
        let pixels = (at - rect.min) * scale;
        dvec2(f64::from(pixels.x), f64::from(pixels.y)).floor() + 0.5
    };
    pointer(ui, app, &response, scale, position);
    if !ui.ctx().egui_wants_keyboard_input() {
        keys(ui, app);
    }
    app.update_view(size);
    overlay::show(ui, app, rect, scale);
    viewport
}

fn pointer(ui: &Ui, app: &mut App, response: &Response, scale: f32, position: impl Fn(Pos2) -> DVec2) {
    let modifiers = ui.input(|input| input.modifiers);
    if response.clicked_by(PointerButton::Primary)
        && let Some(at) = response.interact_pointer_pos()
    {
        app.pick(position(at));
    }
    if response.drag_started_by(PointerButton::Primary)
        && !modifiers.shift
        && let Some(origin) = ui.input(|input| input.pointer.press_origin())
    {
        let moves = if modifiers.command { Moves::Group } else { app.settings.moves };
        app.begin_drag(position(origin), moves);
    }
    if response.dragged()
        && let Some(at) = response.interact_pointer_pos()
    {
        let pixels = response.drag_delta() * scale;
        let pixels = dvec2(f64::from(pixels.x), f64::from(pixels.y));
        let heights = pixels / f64::from((response.rect.height() * scale).max(1.0));
        let axis = ui.input(|input| {
            let held = [(Key::X, Axis::X), (Key::Y, Axis::Y), (Key::Z, Axis::Z)];
            held.into_iter().find(|(key, _)| input.key_down(*key)).map(|(_, axis)| axis)
        });
        let primary = response.dragged_by(PointerButton::Primary);
        if primary && app.drag_to(position(at), axis) {
            // The drag has moved the selection.
        } else if response.dragged_by(PointerButton::Middle) || (primary && modifiers.shift) {
            let projection = app.projection();
            app.free_camera().pan(pixels, &projection);
        } else if primary {
            app.free_camera().orbit(heights);
        } else {
            app.free_camera().look(heights);
        }
    }
    if response.drag_stopped() {
        app.end_drag();
    }
    /// Scrolling for a step of the zoom, in points.
    const WHEEL_STEP: f32 = 40.0;
    let wheel = ui.input(|input| input.smooth_scroll_delta().y);
    if response.hovered() && wheel != 0.0 {
        app.free_camera().zoom(f64::from(wheel / WHEEL_STEP));
    }
}

/// Keys: flying, and shortcuts of buttons.
fn keys(ui: &Ui, app: &mut App) {
    /// Speed of flight, in distances to the pivot per second.
    const SPEED: f64 = 0.7;
    /// The longest time step, in seconds, so that a slow frame does not make the camera jump.
    const MAX_STEP: f32 = 0.1;

    let (step, seconds) = ui.input(|input| {
        let held = |key| if input.key_down(key) { 1.0 } else { 0.0 };
        let [right, up, back] = [(Key::D, Key::A), (Key::E, Key::Q), (Key::S, Key::W)].map(|(a, b)| held(a) - held(b));
        let speed = if input.modifiers.shift { 4.0 * SPEED } else { SPEED };
        let is_shortcut = input.modifiers.command;
        (if is_shortcut { DVec3::ZERO } else { DVec3::new(right, up, back) * speed }, input.stable_dt.min(MAX_STEP))
    });
    if step != DVec3::ZERO {
        app.free_camera().fly(step * f64::from(seconds));
        ui.ctx().request_repaint();
    }
    let pressed = |key| ui.input_mut(|input| input.consume_key(Modifiers::NONE, key));
    if pressed(Key::F) {
        app.frame();
    }
    if pressed(Key::Home) {
        app.go_home();
    }
    if pressed(Key::O) {
        app.settings.overlay = !app.settings.overlay;
    }
    if pressed(Key::R) {
        app.drawing.finish();
    }
    if pressed(Key::Delete) {
        app.remove_selection();
    }
    if pressed(Key::Escape) {
        app.select(None);
    }
}
