//! Colours and spacing of the user interface.

use egui::{Color32, Context, CornerRadius, Stroke, Theme, Visuals, vec2};

pub(crate) const ACCENT: Color32 = Color32::from_rgb(0xE3, 0xAE, 0x4F);
pub(crate) const TEXT: Color32 = Color32::from_rgb(0xDD, 0xDF, 0xE3);
pub(crate) const WEAK: Color32 = Color32::from_rgb(0x8D, 0x93, 0x9E);
pub(crate) const ERROR: Color32 = Color32::from_rgb(0xF0, 0x7A, 0x6A);
pub(crate) const PANEL: Color32 = Color32::from_rgb(0x1B, 0x1D, 0x22);
pub(crate) const SELECTED: Color32 = Color32::from_rgb(0x4A, 0x3C, 0x22);
pub(crate) const HOVERED: Color32 = Color32::from_rgb(0x28, 0x2B, 0x32);
/// Background of text over the picture.
pub(crate) const VEIL: Color32 = Color32::from_rgba_premultiplied(12, 13, 16, 205);

/// Applies the colours and the spacing.
pub(crate) fn apply(context: &Context) {
    context.set_theme(Theme::Dark);
    let mut visuals = Visuals::dark();
    visuals.panel_fill = PANEL;
    visuals.window_fill = PANEL;
    visuals.extreme_bg_color = Color32::from_rgb(0x12, 0x13, 0x17);
    visuals.selection.bg_fill = SELECTED;
    visuals.selection.stroke = Stroke::new(1.0, ACCENT);
    visuals.hyperlink_color = ACCENT;
    visuals.slider_trailing_fill = true;
    let widgets = &mut visuals.widgets;
    widgets.noninteractive.bg_stroke = Stroke::new(1.0, Color32::from_rgb(0x2C, 0x2F, 0x36));
    widgets.noninteractive.fg_stroke.color = TEXT;
    widgets.inactive.fg_stroke.color = TEXT;
    for widget in [&mut widgets.inactive, &mut widgets.hovered, &mut widgets.active, &mut widgets.open] {
        widget.corner_radius = CornerRadius::same(4);
    }
    widgets.inactive.bg_fill = Color32::from_rgb(0x2B, 0x2E, 0x36);
    widgets.inactive.weak_bg_fill = widgets.inactive.bg_fill;
    context.set_visuals_of(Theme::Dark, visuals);
    context.all_styles_mut(|style| {
        style.spacing.item_spacing = vec2(8.0, 5.0);
        style.spacing.button_padding = vec2(7.0, 3.0);
        style.interaction.selectable_labels = false;
    });
}
