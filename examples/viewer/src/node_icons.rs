//! Icons of node kinds, drawn as shapes because fonts lack the glyphs.

use egui::{Color32, Painter, Pos2, Rect, Shape, Stroke, StrokeKind, Vec2, pos2, vec2};
use ropewalk::graph::CoreKind;

use crate::theme;

/// Half the size of an icon, in points.
pub(crate) const RADIUS: f32 = 6.0;

/// Paints the icon of a kind of core; `opacity` is 0 to 1.
pub(crate) fn paint(painter: &Painter, center: Pos2, kind: CoreKind, opacity: f32) {
    let color = |r, g, b| Color32::from_rgb(r, g, b).gamma_multiply(opacity);
    match kind {
        CoreKind::Transform => cross(painter, center, color(0x7F, 0xB2, 0xE5)),
        CoreKind::Geometry => triangle(painter, center, color(0x8F, 0xC9, 0x8A)),
        CoreKind::Light => sun(painter, center, color(0xF2, 0xD0, 0x6B)),
        CoreKind::Camera => camera(painter, center, color(0xC8, 0xA2, 0xE0)),
        CoreKind::Instance => {
            let stroke = Stroke::new(1.3, color(0xE0, 0x9A, 0xB0));
            for offset in [vec2(-1.8, -1.8), vec2(1.8, 1.8)] {
                let rect = Rect::from_center_size(center + offset, Vec2::splat(7.0));
                painter.rect_stroke(rect, 1.0, stroke, StrokeKind::Middle);
            }
        }
        _ => {
            let rect = Rect::from_center_size(center, Vec2::splat(8.0));
            let stroke = Stroke::new(1.3, theme::WEAK.gamma_multiply(opacity));
            painter.rect_stroke(rect, 1.5, stroke, StrokeKind::Middle);
        }
    }
}

/// An eye, open or crossed out.
pub(crate) fn eye(painter: &Painter, center: Pos2, is_open: bool, color: Color32) {
    let stroke = Stroke::new(1.2, color);
    let lid = |side: f32| {
        let at = |i: i32| i as f32 / 8.0;
        (0..=8).map(|i| center + vec2((at(i) * 2.0 - 1.0) * 6.0, side * 7.0 * at(i) * (1.0 - at(i)) * 2.0)).collect()
    };
    painter.add(Shape::line(lid(-1.0), stroke));
    painter.add(Shape::line(lid(1.0), stroke));
    painter.circle_filled(center, 1.9, color);
    if !is_open {
        painter.line_segment([center + vec2(-5.0, 5.0), center + vec2(5.0, -5.0)], Stroke::new(1.5, color));
    }
}

fn cross(painter: &Painter, center: Pos2, color: Color32) {
    for direction in [vec2(1.0, 0.0), vec2(0.0, 1.0)] {
        painter.line_segment([center - direction * 5.0, center + direction * 5.0], Stroke::new(1.4, color));
        for end in [direction, -direction] {
            let side = end.rot90() * 1.8;
            let tip = [end * RADIUS, end * 3.2 + side, end * 3.2 - side].map(|offset| center + offset);
            painter.add(Shape::convex_polygon(tip.to_vec(), color, Stroke::NONE));
        }
    }
}

fn triangle(painter: &Painter, center: Pos2, color: Color32) {
    let corners = [vec2(0.0, -4.5), vec2(5.0, 4.0), vec2(-5.0, 4.0)].map(|offset| center + offset);
    painter.add(Shape::convex_polygon(corners.to_vec(), color, Stroke::NONE));
}

fn sun(painter: &Painter, center: Pos2, color: Color32) {
    painter.circle_filled(center, 2.6, color);
    for ray in 0..8 {
        let direction = Vec2::angled(ray as f32 * std::f32::consts::FRAC_PI_4);
        painter.line_segment([center + direction * 4.0, center + direction * RADIUS], Stroke::new(1.2, color));
    }
}

fn camera(painter: &Painter, center: Pos2, color: Color32) {
    let body = Rect::from_min_max(center + vec2(-6.0, -3.5), center + vec2(2.0, 3.5));
    painter.rect_filled(body, 1.5, color);
    let (x, y) = (center.x, center.y);
    let lens = vec![pos2(x + 2.5, y), pos2(x + 6.0, y - 3.0), pos2(x + 6.0, y + 3.0)];
    painter.add(Shape::convex_polygon(lens, color, Stroke::NONE));
}
