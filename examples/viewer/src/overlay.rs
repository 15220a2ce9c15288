//! Overlays of the picture: the box of the selection, the frame report, the frame times, messages.

use std::time::{Duration, Instant};

use egui::{Align2, Area, Color32, Frame, Id, Margin, Painter, Pos2, Rect, RichText, Sense, Stroke, Ui, pos2, vec2};
use glam::DVec2;
use ropewalk::FrameReport;

use crate::app::App;
use crate::detail::{Detail, FRAME_TIME_TARGET};
use crate::drawing::MAX_TIMES;
use crate::theme;

/// Draws all overlays. `rect` is the rectangle of the picture in points, `scale` the number of pixels per point.
pub(crate) fn show(ui: &mut Ui, app: &mut App, rect: Rect, scale: f32) {
    if app.settings.overlay {
        selection(&ui.painter_at(rect), app, rect, scale);
        report(ui, app, rect);
    }
    messages(ui, app, rect);
}

/// The edges of the box around the selection.
fn selection(painter: &Painter, app: &mut App, rect: Rect, scale: f32) {
    let Some(corners) = app.selected_corners() else { return };
    let projection = app.projection();
    let at = |position: DVec2| rect.min + vec2(position.x as f32, position.y as f32) / scale;
    // Corners whose indices differ in one bit share an edge.
    for (from, bit) in
        (0..8).flat_map(|corner| [1, 2, 4].map(|bit| (corner, bit))).filter(|(from, bit)| from & bit == 0)
    {
        if let Some([a, b]) = projection.segment(corners[from], corners[from | bit]) {
            let (a, b) = (at(a), at(b));
            painter.line_segment([a, b], Stroke::new(3.0, Color32::from_black_alpha(110)));
            painter.line_segment([a, b], Stroke::new(1.3, theme::ACCENT));
        }
    }
}

/// The report of the last frame, and the times of the last frames.
fn report(ui: &Ui, app: &App, rect: Rect) {
    let Some(report) = &app.drawing.report else { return };
    Area::new(Id::unique("report")).fixed_pos(rect.min + vec2(10.0, 10.0)).interactable(false).show(ui.ctx(), |ui| {
        veil().show(ui, |ui| {
            ui.set_width(252.0);
            ui.spacing_mut().item_spacing.y = 2.0;
            for line in lines(report, app.drawing.detail()) {
                ui.label(RichText::new(line).size(12.0).color(theme::TEXT));
            }
            ui.add_space(4.0);
            graph(ui, app.drawing.times.iter().copied());
        });
    });
}

fn lines(report: &FrameReport, detail: Option<Detail>) -> Vec<String> {
    let compile = &report.compile;
    let name = report.device.name.split(" (").next().unwrap_or_default();
    let rays = match detail {
        Some(Detail { block: 1, rays }) => format!("{rays}×{rays} rays a pixel"),
        Some(Detail { block, .. }) => format!("1 ray for {block}×{block} pixels"),
        None => String::new(),
    };
    vec![
        format!("{} · {name}", report.device.executor),
        rays,
        format!("{} instances · {} triangles", grouped(compile.instances), grouped(compile.instanced_triangles)),
        format!("TLAS {}", compile.tlas),
        format!("BLAS: {} built, {} refitted of {}", compile.blas_built, compile.blas_refitted, compile.blas_count),
        format!("{} bytes uploaded", grouped(report.uploaded_bytes as usize)),
        format!(
            "update {} · build {} · upload {}",
            milliseconds(compile.update_time),
            milliseconds(compile.blas_time + compile.tlas_time),
            milliseconds(report.upload_time)
        ),
    ]
}

/// A bar for each of the last frames, the latest at the right.
fn graph(ui: &mut Ui, times: impl DoubleEndedIterator<Item = Duration> + Clone) {
    const HEIGHT: f32 = 44.0;
    const BAR: f32 = 252.0 / MAX_TIMES as f32;

    // Longer bars are clipped.
    let longest = times.clone().max().unwrap_or_default().clamp(2 * FRAME_TIME_TARGET, 6 * FRAME_TIME_TARGET);
    let (area, _) = ui.allocate_exact_size(vec2(BAR * MAX_TIMES as f32, HEIGHT), Sense::hover());
    let painter = ui.painter_at(area);
    painter.rect_filled(area, 2.0, Color32::from_black_alpha(90));
    let height = |time: Duration| HEIGHT * time.as_secs_f32() / longest.as_secs_f32();
    for (age, time) in times.clone().rev().enumerate() {
        let right = area.right() - age as f32 * BAR;
        let top = area.bottom() - height(time).clamp(1.0, HEIGHT);
        let color = if time > FRAME_TIME_TARGET { theme::ACCENT } else { Color32::from_rgb(0x8F, 0xC9, 0x8A) };
        painter.rect_filled(Rect::from_min_max(pos2(right - BAR, top), pos2(right - 0.4, area.bottom())), 0.0, color);
    }
    let line = area.bottom() - height(FRAME_TIME_TARGET);
    painter.hline(area.x_range(), line, Stroke::new(1.0, theme::WEAK.gamma_multiply(0.6)));
    let text = |at: Pos2, align, text: String| {
        painter.text(at, align, text, egui::FontId::proportional(10.5), theme::TEXT);
    };
    text(pos2(area.left() + 3.0, line - 1.0), Align2::LEFT_BOTTOM, milliseconds(FRAME_TIME_TARGET));
    if let Some(last) = times.last() {
        text(area.left_top() + vec2(3.0, 2.0), Align2::LEFT_TOP, format!("last frame {}", milliseconds(last)));
    }
}

/// Messages, in the lower left corner; a click dismisses one.
fn messages(ui: &Ui, app: &mut App, rect: Rect) {
    let loading = app.loading().map(|title| format!("Loading {title} …"));
    let now = Instant::now();
    let current = app.messages.current(now).to_vec();
    if let Some(delay) = app.messages.time_to_next_expiry(now) {
        ui.ctx().request_repaint_after(delay);
    }
    if loading.is_none() && current.is_empty() {
        return;
    }
    let position = rect.left_bottom() + vec2(10.0, -10.0);
    let area = Area::new(Id::unique("messages")).pivot(Align2::LEFT_BOTTOM).fixed_pos(position);
    area.show(ui.ctx(), |ui| {
        ui.set_max_width((rect.width() - 20.0).clamp(80.0, 640.0));
        if let Some(loading) = loading {
            veil().show(ui, |ui| {
                ui.horizontal(|ui| {
                    ui.spinner();
                    ui.label(loading);
                })
            });
        }
        for (index, message) in current.into_iter().enumerate() {
            let color = if message.is_error { theme::ERROR } else { theme::TEXT };
            let shown = veil().show(ui, |ui| ui.colored_label(color, message.text)).response;
            if shown.interact(Sense::click()).on_hover_text("Click to dismiss").clicked() {
                app.messages.dismiss(index);
            }
        }
    });
}

fn veil() -> Frame {
    Frame::new().fill(theme::VEIL).corner_radius(5.0).inner_margin(Margin::same(9))
}

fn milliseconds(time: Duration) -> String {
    let milliseconds = time.as_secs_f64() * 1e3;
    match milliseconds {
        ..10.0 => format!("{milliseconds:.1} ms"),
        ..1000.0 => format!("{milliseconds:.0} ms"),
        _ => format!("{:.1} s", milliseconds * 1e-3),
    }
}

/// A number with its digits in groups of three.
fn grouped(number: usize) -> String {
    let digits = number.to_string();
    let groups: Vec<_> = digits.as_bytes().rchunks(3).rev().map(String::from_utf8_lossy).collect();
    groups.join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thousands_are_apart() {
        assert_eq!([0, 999, 1_000, 12_345_678].map(grouped), ["0", "999", "1 000", "12 345 678"]);
    }
}
