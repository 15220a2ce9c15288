//! Straight lines through points.

/// y = `at_0` + `slope` x.
#[derive(Clone, Copy, Debug)]
pub struct Line {
    pub at_0: f64,
    pub slope: f64,
    /// The part of the variance of y that the line explains.
    pub r_squared: f64,
}

/// The line of least squares. Of points that all have one x, a level one.
pub fn fit(points: impl IntoIterator<Item = [f64; 2]>) -> Line {
    let points: Vec<[f64; 2]> = points.into_iter().collect();
    let mean = |of: fn(&[f64; 2]) -> f64| points.iter().map(of).sum::<f64>() / points.len().max(1) as f64;
    let [mean_x, mean_y] = [mean(|p| p[0]), mean(|p| p[1])];
    let [mut xx, mut xy, mut yy] = [0.0; 3];
    for [x, y] in &points {
        let (x, y) = (x - mean_x, y - mean_y);
        xx += x * x;
        xy += x * y;
        yy += y * y;
    }
    let slope = if xx > 0.0 { xy / xx } else { 0.0 };
    let r_squared = if yy > 0.0 { slope * xy / yy } else { 1.0 };
    Line { at_0: mean_y - slope * mean_x, slope, r_squared }
}
