//! Places for labels beside points, such that none covers another.

use std::ops::Range;

/// The width of a character, as a share of its height: more than that of most fonts without serifs.
const WIDTH: f64 = 0.58;
/// Around a point, in pixels.
const MARKER: i32 = 6;
/// From this distance on a line leads from the point to its label.
const FAR: i32 = 22;

#[derive(Clone, Copy)]
struct Rectangle {
    x: [i32; 2],
    y: [i32; 2],
}

impl Rectangle {
    fn overlap(self, other: Self) -> i32 {
        let along = |a: [i32; 2], b: [i32; 2]| (a[1].min(b[1]) - a[0].max(b[0])).max(0);
        along(self.x, other.x) * along(self.y, other.y)
    }
}

/// What is taken, in pixels.
pub struct Labels {
    area: Rectangle,
    taken: Vec<Rectangle>,
}

/// The place of a label.
pub struct Place {
    /// The middle of its left side.
    pub left: (i32, i32),
    /// The end of the line that leads to it, if it is far from its point.
    pub leader: Option<(i32, i32)>,
}

impl Labels {
    /// Of a plot with these pixels.
    pub fn new((x, y): (Range<i32>, Range<i32>)) -> Self {
        Self { area: Rectangle { x: [x.start, x.end], y: [y.start, y.end] }, taken: Vec::new() }
    }

    /// No label covers this point.
    pub fn keep_free(&mut self, (x, y): (i32, i32)) {
        self.taken.push(Rectangle { x: [x - MARKER, x + MARKER], y: [y - MARKER, y + MARKER] });
    }

    /// Nor this line along an axis.
    pub fn keep_line_free(&mut self, [(x0, y0), (x1, y1)]: [(i32, i32); 2]) {
        self.taken.push(Rectangle { x: [x0.min(x1) - 1, x0.max(x1) + 1], y: [y0.min(y1) - 1, y0.max(y1) + 1] });
    }

    /// The nearest place beside a point that covers the least.
    pub fn place(&mut self, (x, y): (i32, i32), text: &str, height: u32) -> Place {
        let (width, height) = (width(text.chars().count(), height), height as i32 + 2);
        let rectangle = |(left, middle): (i32, i32)| Rectangle {
            x: [left, left + width],
            y: [middle - height / 2, middle + height / 2],
        };
        // Right, left, above and below, and between these, farther and farther.
        let candidates = (0..14).flat_map(|ring| {
            let away = 9 + ring * 8;
            let (right, left, middle) = (x + away, x - away - width, x - width / 2);
            let near = x + 4 - width / 2;
            [(right, y), (left, y), (right - 6, y - away), (right - 6, y + away), (middle, y - away - 4)]
                .into_iter()
                .chain([(middle, y + away + 4), (left + 6, y - away), (left + 6, y + away), (near, y - away)])
        });
        let cost = |place: (i32, i32)| {
            let own = rectangle(place);
            let covered: i32 = self.taken.iter().map(|taken| own.overlap(*taken)).sum();
            covered + width * height - own.overlap(self.area)
        };
        let left = candidates.min_by_key(|&place| cost(place)).unwrap_or((x, y));
        let own = rectangle(left);
        self.taken.push(own);
        let end = (x.clamp(own.x[0], own.x[1]), y.clamp(own.y[0], own.y[1]));
        let is_far = (end.0 - x).abs().max((end.1 - y).abs()) > FAR;
        Place { left, leader: is_far.then_some(end) }
    }
}

fn width(characters: usize, height: u32) -> i32 {
    (characters as f64 * WIDTH * f64::from(height)) as i32
}
