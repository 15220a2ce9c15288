//! How finely to trace, so that moving stays fluent and what stands still becomes sharp.

use std::time::{Duration, Instant};

/// How many rays there are for how many pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Detail {
    /// One ray for a block of so many by so many pixels.
    pub(crate) block: u32,
    /// So many by so many rays for each pixel.
    pub(crate) rays: u32,
}

/// A frame may take this long while something moves.
pub(crate) const FLUENT: Duration = Duration::from_millis(50);
/// A frame may take this long when nothing moves: the window waits for it.
const PATIENCE: Duration = Duration::from_secs(2);
/// What takes longer than [`FLUENT`] is begun only when nothing has moved for so long.
const STILL: Duration = Duration::from_millis(150);
/// The coarsest blocks.
const MOST_PIXELS: u32 = 16;

impl Detail {
    /// One ray a pixel.
    pub(crate) const PIXEL: Self = Self { block: 1, rays: 1 };

    /// `rays` by `rays` rays a pixel.
    pub(crate) fn fine(rays: u32) -> Self {
        Self { block: 1, rays }
    }

    /// The size of what is traced for a picture of this size.
    pub(crate) fn traced_size(self, size: [u32; 2]) -> [u32; 2] {
        size.map(|pixels| (pixels * self.rays).div_ceil(self.block))
    }

    /// The next finer one on the way to `rays` by `rays` rays a pixel.
    fn finer(self, rays: u32) -> Option<Self> {
        match self {
            Self { block: 1, rays: shown } if shown == rays => None,
            Self { block: 1, .. } => Some(Self::fine(rays)),
            Self { block, .. } => Some(Self { block: block.div_ceil(2), rays: 1 }),
        }
    }

    fn ray_count(self, size: [u32; 2]) -> f64 {
        let [width, height] = self.traced_size(size).map(f64::from);
        width * height
    }
}

/// What to do now.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Step {
    /// Trace with this detail.
    Trace(Detail),
    /// Ask again after this time.
    Wait(Duration),
    /// What is shown is as good as it gets.
    Rest,
}

/// Knows how fast frames are and chooses the detail of the next.
#[derive(Debug, Default)]
pub(crate) struct Pace {
    /// Of the last frame.
    seconds_per_ray: Option<f64>,
    shown: Option<Detail>,
    moved: Option<Instant>,
    /// Whether the window is to wait for all rays of what is seen now.
    finishes: bool,
}

impl Pace {
    /// The detail of the frame that is shown.
    pub(crate) fn shown(&self) -> Option<Detail> {
        self.shown
    }

    /// Takes note of a frame that was traced.
    pub(crate) fn traced(&mut self, detail: Detail, size: [u32; 2], time: Duration) {
        let rays = detail.ray_count(size);
        if rays > 0.0 {
            self.seconds_per_ray = Some(time.as_secs_f64() / rays);
        }
        self.shown = Some(detail);
    }

    /// How long a frame of this detail would take; nothing is known before the first.
    pub(crate) fn forecast(&self, detail: Detail, size: [u32; 2]) -> Option<Duration> {
        let seconds = self.seconds_per_ray? * detail.ray_count(size);
        Duration::try_from_secs_f64(seconds).ok()
    }

    /// From now on until something moves, frames may take as long as they want.
    pub(crate) fn finish(&mut self) {
        self.finishes = true;
    }

    /// What to do for a picture of this size, of which everything is new (`moves`) or nothing.
    pub(crate) fn step(&mut self, moves: bool, size: [u32; 2], rays: u32, now: Instant) -> Step {
        if moves {
            (self.moved, self.finishes) = (Some(now), false);
            return Step::Trace(self.while_moving(size));
        }
        let Some(shown) = self.shown else { return Step::Trace(self.while_moving(size)) };
        let Some(finer) = shown.finer(rays) else { return Step::Rest };
        let time = |detail| self.forecast(detail, size).unwrap_or_default();
        // All at once, where that is soon done.
        let at_once = self.finishes || time(Detail::fine(rays)) < 4 * FLUENT;
        let next = if at_once { Detail::fine(rays) } else { finer };
        let still_for = self.moved.map_or(STILL, |moved| now.saturating_duration_since(moved));
        if time(next) > PATIENCE && !self.finishes {
            Step::Rest
        } else if time(next) > FLUENT && still_for < STILL {
            Step::Wait(STILL - still_for)
        } else {
            Step::Trace(next)
        }
    }

    /// The finest detail that is fluent.
    fn while_moving(&self, size: [u32; 2]) -> Detail {
        /// For the first frame.
        const UNKNOWN: Detail = Detail { block: 4, rays: 1 };

        let Some(full) = self.forecast(Detail::PIXEL, size) else { return UNKNOWN };
        let block = (full.as_secs_f64() / FLUENT.as_secs_f64()).sqrt().ceil();
        Detail { block: (block as u32).clamp(1, MOST_PIXELS), rays: 1 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: [u32; 2] = [800, 600];

    /// A pace that has seen a whole frame take so long.
    fn pace(milliseconds: u64) -> Pace {
        let mut pace = Pace::default();
        pace.traced(Detail::PIXEL, SIZE, Duration::from_millis(milliseconds));
        pace
    }

    #[test]
    fn moving_stays_below_the_limit() {
        let now = Instant::now();
        assert_eq!(pace(49).step(true, SIZE, 2, now), Step::Trace(Detail::PIXEL));
        for milliseconds in [51, 200, 1_000, 5_000] {
            let mut pace = pace(milliseconds);
            let Step::Trace(detail) = pace.step(true, SIZE, 2, now) else { panic!("it moves") };
            assert!(detail.block > 1);
            assert!(pace.forecast(detail, SIZE).unwrap() < FLUENT * 11 / 10, "{milliseconds} ms: {detail:?}");
        }
    }

    #[test]
    fn what_stands_still_becomes_sharp_in_steps() {
        let mut pace = pace(800);
        let moved = Instant::now();
        let Step::Trace(mut shown) = pace.step(true, SIZE, 1, moved) else { panic!("it moves") };
        assert_eq!(shown.block, 4);
        let later = moved + STILL;
        let mut steps = Vec::new();
        loop {
            pace.traced(shown, SIZE, pace.forecast(shown, SIZE).unwrap());
            match pace.step(false, SIZE, 1, later) {
                Step::Trace(detail) => shown = detail,
                step => break assert_eq!(step, Step::Rest),
            }
            steps.push(shown.block);
        }
        assert_eq!(steps, [2, 1]);
    }

    #[test]
    fn slow_frames_wait_for_stillness_and_endless_ones_are_not_begun() {
        let moved = Instant::now();
        let mut slow = pace(1_000);
        let Step::Trace(detail) = slow.step(true, SIZE, 1, moved) else { panic!("it moves") };
        slow.traced(detail, SIZE, slow.forecast(detail, SIZE).unwrap());
        assert_eq!(slow.step(false, SIZE, 1, moved + STILL / 3), Step::Wait(STILL - STILL / 3));

        let mut endless = pace(9_000);
        endless.traced(Detail { block: 2, rays: 1 }, SIZE, Duration::from_millis(2_250));
        assert_eq!(endless.step(false, SIZE, 1, moved + STILL), Step::Rest);
        endless.finish();
        assert_eq!(endless.step(false, SIZE, 1, moved + STILL), Step::Trace(Detail::PIXEL));
    }

    #[test]
    fn sizes_that_do_not_divide_are_covered() {
        assert_eq!(Detail { block: 4, rays: 1 }.traced_size([801, 3]), [201, 1]);
        assert_eq!(Detail::fine(2).traced_size([5, 7]), [10, 14]);
    }
}
