//! Charts as SVG and CSV: points with labels, curves, and the Pareto front of the points.
//!
//! The default of the library is drawn larger and filled. On a logarithmic axis 0 has a line of its own at the bottom.

use std::path::Path;

use plotters::coord::Shift;
use plotters::coord::ranged1d::{KeyPointHint, NoDefaultFormatting, Ranged, ValueFormatter};
use plotters::prelude::*;
use plotters::style::FontStyle;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use ropewalk_bench::Result;

use crate::labels::Labels;

/// Of one panel with its legend; two panels stand side by side.
const SIZE: (u32, u32) = (940, 600);
/// The width of its legend.
const LEGEND: u32 = 250;
/// Okabe and Ito's, which colour-blind readers tell apart, and two more: one a curve.
const COLORS: [RGBColor; 9] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(86, 180, 233),
    RGBColor(230, 159, 0),
    RGBColor(0, 0, 0),
    RGBColor(130, 130, 130),
    RGBColor(140, 86, 75),
];
const FONT: &str = "sans-serif";
/// The height of labels, in pixels.
const LABEL: u32 = 13;

/// Panels side by side.
pub struct Chart {
    /// The files are named after it.
    pub name: &'static str,
    pub panels: Vec<Panel>,
}

pub struct Panel {
    pub title: &'static str,
    pub x: Axis,
    pub y: Axis,
    /// Which x are better, if the Pareto front is drawn. Less is better for y.
    pub front: Option<Better>,
    pub curves: Vec<Curve>,
}

#[derive(Clone, Copy, PartialEq)]
pub enum Better {
    Less,
    More,
}

/// What an axis shows, with its unit.
#[derive(Clone, Copy)]
pub struct Axis {
    pub name: &'static str,
    pub scale: Scale,
}

#[derive(Clone, Copy, PartialEq)]
pub enum Scale {
    Linear,
    Log,
}

/// Points of one colour.
pub struct Curve {
    pub name: String,
    /// Whether a line joins them.
    pub is_joined: bool,
    pub points: Vec<Point>,
}

#[derive(Clone, Default)]
pub struct Point {
    pub x: f64,
    pub y: f64,
    /// Empty for none.
    pub label: String,
    /// Whether this is what the library does unless told otherwise.
    pub is_default: bool,
    /// What else was measured, for the table.
    pub detail: String,
}

/// The columns of [`Chart::rows`].
pub const COLUMNS: [&str; 10] =
    ["chart", "panel", "curve", "point", "x axis", "x", "y axis", "y", "default or on the front", "detail"];

impl Chart {
    /// A line for each point.
    pub fn rows(&self) -> Vec<[String; 10]> {
        let mut rows = Vec::new();
        for panel in &self.panels {
            let front = panel.front();
            for (curve, point) in panel.points() {
                let is_on_front = front.iter().any(|&on_front| std::ptr::eq(on_front, point));
                let marks = [(point.is_default, "default"), (is_on_front, "front")];
                let marks: Vec<&str> = marks.into_iter().filter(|(is, _)| *is).map(|(_, mark)| mark).collect();
                rows.push([
                    self.name.to_owned(),
                    panel.title.to_owned(),
                    curve.name.clone(),
                    point.label.clone(),
                    panel.x.name.to_owned(),
                    significant(point.x),
                    panel.y.name.to_owned(),
                    significant(point.y),
                    marks.join(" "),
                    point.detail.clone(),
                ]);
            }
        }
        rows
    }

    /// The same, comma-separated.
    pub fn csv(&self) -> String {
        let quoted = |cell: &String| if cell.contains(',') { format!("\"{cell}\"") } else { cell.clone() };
        let line = |row: &[String; 10]| row.each_ref().map(quoted).join(",");
        self.rows().iter().fold(COLUMNS.join(",") + "\n", |csv, row| csv + &line(row) + "\n")
    }

    /// Writes the picture.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn draw(&self, path: &Path) -> Result<()> {
        let columns = self.panels.len().min(2);
        let rows = self.panels.len().div_ceil(2);
        let (width, height) = SIZE;
        let area = SVGBackend::new(path, (width * columns as u32, height * rows as u32)).into_drawing_area();
        area.fill(&WHITE)?;
        for (panel, area) in self.panels.iter().zip(area.split_evenly((rows, columns))) {
            panel.draw(&area)?;
        }
        area.present()?;
        Ok(())
    }
}

impl Panel {
    fn points(&self) -> impl Iterator<Item = (&Curve, &Point)> {
        self.curves.iter().flat_map(|curve| curve.points.iter().map(move |point| (curve, point)))
    }

    /// The points than which none is better in both, from the best x on.
    fn front(&self) -> Vec<&Point> {
        let Some(better) = self.front else { return Vec::new() };
        let mut points: Vec<&Point> = self.points().map(|(_, point)| point).collect();
        let cost = |point: &Point| if better == Better::Less { point.x } else { -point.x };
        points.sort_by(|a, b| cost(a).total_cmp(&cost(b)).then(a.y.total_cmp(&b.y)));
        let mut least = f64::INFINITY;
        points.retain(|point| {
            point.y < least && {
                least = point.y;
                true
            }
        });
        points
    }

    fn draw(&self, area: &DrawingArea<SVGBackend<'_>, Shift>) -> Result<()> {
        let (area, legend) = area.split_horizontally(SIZE.0 - LEGEND);
        self.draw_legend(&legend)?;
        let [x, y]: [Vec<f64>; 2] = [|point: &Point| point.x, |point: &Point| point.y]
            .map(|of| self.points().map(|(_, point)| of(point)).collect());
        let mut chart = ChartBuilder::on(&area)
            .caption(self.title, (FONT, 18))
            .margin(12)
            .x_label_area_size(44)
            .y_label_area_size(72)
            .build_cartesian_2d(Ruler::new(self.x, &x), Ruler::new(self.y, &y))?;
        chart
            .configure_mesh()
            .x_desc(self.x.name)
            .y_desc(self.y.name)
            .label_style((FONT, 14))
            .bold_line_style(BLACK.mix(0.12))
            .light_line_style(TRANSPARENT)
            .draw()?;
        let mut labels = Labels::new(chart.plotting_area().get_pixel_range());
        let steps = self.steps();
        steps
            .windows(2)
            .for_each(|ends| labels.keep_line_free([0, 1].map(|end: usize| chart.backend_coord(&ends[end]))));
        chart.draw_series(LineSeries::new(steps, BLACK.mix(0.35).stroke_width(2)))?;
        let mut to_label = Vec::new();
        for (curve, color) in self.curves.iter().zip(COLORS.iter().cycle()) {
            if curve.is_joined {
                let line = curve.points.iter().map(|point| (point.x, point.y));
                chart.draw_series(LineSeries::new(line, color.stroke_width(if curve.is_default() { 4 } else { 1 })))?;
            }
            chart.draw_series(curve.points.iter().map(|point| curve.marker(point, (point.x, point.y), color)))?;
            for point in &curve.points {
                let at = chart.backend_coord(&(point.x, point.y));
                labels.keep_free(at);
                if !point.label.is_empty() {
                    to_label.push((at, point, *color));
                }
            }
        }
        drop(chart);
        // The default has its label first, and so nearest.
        to_label.sort_by_key(|(_, point, _)| !point.is_default);
        for (at, point, color) in to_label {
            draw_label(&area, &mut labels, at, point, color)?;
        }
        Ok(())
    }

    /// The names of the curves, and what the marks mean.
    fn draw_legend(&self, area: &DrawingArea<SVGBackend<'_>, Shift>) -> Result<()> {
        let line = |i: usize| 50 + 22 * i as i32;
        let write = |text: &str, y: i32| {
            let style = TextStyle::from((FONT, LABEL)).pos(Pos::new(HPos::Left, VPos::Center));
            area.draw(&Text::new(text.to_owned(), (26, y), style))
        };
        // One curve is what the title says.
        let named = if self.curves.len() > 1 { &self.curves[..] } else { &[] };
        for (i, (curve, color)) in named.iter().zip(COLORS.iter().cycle()).enumerate() {
            area.draw(&Circle::new((12, line(i)), 4, color.filled()))?;
            let is_default = curve.is_joined && curve.is_default();
            write(&format!("{}{}", curve.name, if is_default { " (default)" } else { "" }), line(i))?;
        }
        if self.front.is_some() {
            let y = line(named.len() + 1);
            area.draw(&PathElement::new([(4, y), (20, y)], BLACK.mix(0.35).stroke_width(2)))?;
            write("Pareto front", y)?;
            area.draw(&Circle::new((12, y + 22), 7, BLACK.filled()))?;
            write("default", y + 22)?;
        }
        Ok(())
    }

    /// The front as steps: everything above them is worse than some point.
    fn steps(&self) -> Vec<(f64, f64)> {
        let front = self.front();
        let mut steps = Vec::new();
        for (i, point) in front.iter().enumerate() {
            if i > 0 {
                steps.push((point.x, front[i - 1].y));
            }
            steps.push((point.x, point.y));
        }
        steps
    }
}

impl Curve {
    fn is_default(&self) -> bool {
        self.points.iter().any(|point| point.is_default)
    }

    fn marker<C>(&self, point: &Point, at: C, color: &RGBColor) -> Circle<C, i32> {
        if self.is_joined {
            Circle::new(at, 3, color.filled())
        } else if point.is_default {
            Circle::new(at, 7, color.filled())
        } else {
            Circle::new(at, 4, color.stroke_width(2))
        }
    }
}

fn draw_label(
    area: &DrawingArea<SVGBackend<'_>, Shift>,
    labels: &mut Labels,
    at: (i32, i32),
    point: &Point,
    color: RGBColor,
) -> Result<()> {
    let text = if point.is_default { format!("{} (default)", point.label) } else { point.label.clone() };
    let style = if point.is_default { FontStyle::Bold } else { FontStyle::Normal };
    let place = labels.place(at, &text, LABEL);
    let (left, top) = area.get_base_pixel();
    let relative = |(x, y): (i32, i32)| (x - left, y - top);
    if let Some(end) = place.leader {
        area.draw(&PathElement::new([relative(at), relative(end)], color.mix(0.5)))?;
    }
    let font = (FONT, LABEL).into_font().style(style);
    let style = TextStyle::from(font).color(&color).pos(Pos::new(HPos::Left, VPos::Center));
    area.draw(&Text::new(text, relative(place.left), style))?;
    Ok(())
}

/// Where the values of an axis are.
#[derive(Clone)]
struct Ruler {
    scale: Scale,
    /// The ends, in decades if the scale is logarithmic.
    range: [f64; 2],
    /// Where 0 is on a logarithmic scale.
    zero: f64,
    ticks: Vec<f64>,
}

impl Ruler {
    fn new(axis: Axis, values: &[f64]) -> Self {
        let measure = |value: f64| if axis.scale == Scale::Log { value.log10() } else { value };
        let placed = values.iter().copied().map(measure).filter(|at| at.is_finite());
        let [low, high] = placed.fold([f64::INFINITY, f64::NEG_INFINITY], |[l, h], at| [l.min(at), h.max(at)]);
        let [low, high] = if low <= high { [low, high] } else { [0.0, 1.0] };
        let has_zero = axis.scale == Scale::Log && values.contains(&0.0);
        let margin = ((high - low) * 0.08).max(0.05);
        let zero = low.floor() - 0.35 * (high - low).max(1.0);
        let low = if has_zero { zero - margin } else { low - margin };
        let ticks =
            if axis.scale == Scale::Log { log_ticks(low, high + margin, has_zero) } else { linear_ticks(low, high) };
        Self { scale: axis.scale, range: [low, high + 1.5 * margin], zero, ticks }
    }

    fn position(&self, value: f64) -> f64 {
        match self.scale {
            Scale::Linear => value,
            Scale::Log if value <= 0.0 => self.zero,
            Scale::Log => value.log10(),
        }
    }
}

fn linear_ticks(low: f64, high: f64) -> Vec<f64> {
    let rough = (high - low) / 6.0;
    let decade = 10f64.powf(rough.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0].map(|step| step * decade).into_iter().find(|&step| step >= rough).unwrap_or(rough);
    let (first, last) = ((low / step).ceil() as i64, (high / step).floor() as i64);
    (first..=last).map(|i| i as f64 * step).collect()
}

fn log_ticks(low: f64, high: f64, has_zero: bool) -> Vec<f64> {
    let every = ((high - low) / 9.0).ceil().max(1.0) as i32;
    let within: &[f64] = if high - low < 2.5 { &[1.0, 2.0, 5.0] } else { &[1.0] };
    let decades = (low.floor() as i32..=high.ceil() as i32).filter(|decade| decade % every == 0);
    let ticks = decades.flat_map(|decade| within.iter().map(move |tick| tick * 10f64.powi(decade)));
    let least = if has_zero { low + 0.3 * (high - low) } else { low };
    let mut ticks: Vec<f64> = ticks.filter(|tick| (least..=high).contains(&tick.log10())).collect();
    if has_zero {
        ticks.push(0.0);
    }
    ticks
}

impl Ranged for Ruler {
    type ValueType = f64;
    type FormatOption = NoDefaultFormatting;

    fn map(&self, value: &f64, (first, last): (i32, i32)) -> i32 {
        let [low, high] = self.range;
        let share = (self.position(*value) - low) / (high - low);
        (f64::from(first) + share * f64::from(last - first)).round() as i32
    }

    fn key_points<Hint: KeyPointHint>(&self, hint: Hint) -> Vec<f64> {
        // There are no light lines.
        if hint.weight().allow_light_points() { Vec::new() } else { self.ticks.clone() }
    }

    fn range(&self) -> std::ops::Range<f64> {
        let ends = self.range.map(|end| if self.scale == Scale::Log { 10f64.powf(end) } else { end });
        ends[0]..ends[1]
    }
}

impl ValueFormatter<f64> for Ruler {
    fn format_ext(&self, value: &f64) -> String {
        short(*value)
    }
}

/// In as few characters as say it.
fn short(value: f64) -> String {
    match value.abs() {
        0.0 => "0".to_owned(),
        1e-3..1e5 => format!("{}", (value * 1e6).round() / 1e6),
        _ => format!("{value:.0e}"),
    }
}

/// With four significant digits.
fn significant(value: f64) -> String {
    match value.abs() {
        0.0 => "0".to_owned(),
        1e-3..1e5 => format!("{:.*}", (3.0 - value.abs().log10().floor()).clamp(0.0, 6.0) as usize, value),
        _ => format!("{value:.3e}"),
    }
}
