//! The rates as a picture: a panel for triangles and one for instances, both axes logarithmic. Dots are measured, lines
//! fitted.

use std::path::Path;

use plotters::coord::Shift;
use plotters::prelude::*;
use ropewalk_bench::Result;
use ropewalk_bench::rays::RayKind;

use crate::{Point, Series, curves, power};

const SIZE: (u32, u32) = (1280, 600);
/// Okabe and Ito's, which colour-blind readers tell apart: one an executor.
const COLORS: [RGBColor; 5] =
    [RGBColor(213, 94, 0), RGBColor(204, 121, 167), RGBColor(0, 114, 178), RGBColor(0, 158, 115), RGBColor(0, 0, 0)];
const FONT: &str = "sans-serif";

/// Writes the chart.
///
/// # Errors
/// The file cannot be written.
pub fn draw(path: &Path, points: &[Point]) -> Result<()> {
    let area = SVGBackend::new(path, SIZE).into_drawing_area();
    area.fill(&WHITE)?;
    let [left, right] = <[_; 2]>::try_from(area.split_evenly((1, 2))).map_err(|_| "two panels")?;
    panel(&left, points, Series::Triangles)?;
    panel(&right, points, Series::Instances)?;
    area.present()?;
    Ok(())
}

fn panel(area: &DrawingArea<SVGBackend<'_>, Shift>, points: &[Point], series: Series) -> Result<()> {
    let rate = |point: &Point| 1e3 / point.nanoseconds_a_ray;
    let shown = points.iter().filter(|point| point.series == series);
    let extent = |of: &dyn Fn(&Point) -> f64| {
        shown.clone().map(of).fold((f64::INFINITY, 0.0f64), |(least, most), x| (least.min(x), most.max(x)))
    };
    let ((fewest, most), (_, fastest)) = (extent(&|point| point.count), extent(&rate));
    // Room for the legend above the fastest.
    let (slowest, _) = extent(&rate);
    let mut chart = ChartBuilder::on(area)
        .caption(format!("Rate against {}", series.name()), (FONT, 20))
        .margin(12)
        .x_label_area_size(44)
        .y_label_area_size(56)
        .build_cartesian_2d((fewest / 1.5..most * 1.5).log_scale(), (slowest / 2.0..fastest * 40.0).log_scale())?;
    chart
        .configure_mesh()
        .x_desc(series.name())
        .y_desc("million rays a second")
        .x_label_formatter(&|count| thousands(*count))
        .y_label_formatter(&|rate| rate.to_string())
        .label_style((FONT, 14))
        .light_line_style(TRANSPARENT)
        .draw()?;
    let mut executors: Vec<&str> = Vec::new();
    for curve in curves(points, series) {
        let Point { kind, executor, .. } = curve[0];
        if !executors.contains(&executor.as_str()) {
            executors.push(executor);
        }
        let place = executors.iter().position(|name| name == executor).unwrap_or(0);
        let color = COLORS[place % COLORS.len()];
        let is_filled = *kind == RayKind::Primary;
        let style = if is_filled { color.filled() } else { color.stroke_width(1) };
        let line = power(&curve);
        let fitted = [curve[0].count, curve[curve.len() - 1].count]
            .map(|count| (count, 1e3 / (line.at_0 + line.slope * count.ln()).exp()));
        chart.draw_series(LineSeries::new(fitted, color.stroke_width(if is_filled { 2 } else { 1 })))?;
        chart
            .draw_series(curve.iter().map(|point| Circle::new((point.count, rate(point)), 4, style)))?
            .label(format!("{executor}, {}: n^{:.2}", kind.name(), -line.slope))
            .legend(move |(x, y)| Circle::new((x + 10, y), 4, style));
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::UpperRight)
        .label_font((FONT, 13))
        .background_style(WHITE.mix(0.85))
        .border_style(BLACK.mix(0.3))
        .draw()?;
    Ok(())
}

/// 1, 10, 1 k, 1 M.
fn thousands(count: f64) -> String {
    match count {
        1e6.. => format!("{} M", count / 1e6),
        1e3.. => format!("{} k", count / 1e3),
        _ => count.to_string(),
    }
}
