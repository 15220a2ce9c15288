//! The choice of detail: coarse enough that the view moves smoothly, refined while it stands still.

use std::time::{Duration, Instant};

/// The number of rays per pixel, or of pixels per ray.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Detail {
    /// One ray is traced for a block of so many by so many pixels.
    pub(crate) block: u32,
    /// So many by so many rays are traced for each pixel.
    pub(crate) rays: u32,
}

/// The longest time of a frame while something moves.
pub(crate) const FRAME_TIME_TARGET: Duration = Duration::from_millis(50);
/// The longest time of a frame when nothing moves; the window does not respond meanwhile.
const MAX_FRAME_TIME: Duration = Duration::from_secs(2);
/// A frame that takes longer than [`FRAME_TIME_TARGET`] is begun only when nothing has moved for so long.
const STILL_TIME: Duration = Duration::from_millis(150);
/// The largest block, in pixels on a side.
const MAX_BLOCK: u32 = 16;

impl Detail {
    /// One ray per pixel.
    pub(crate) const PIXEL: Self = Self { block: 1, rays: 1 };

    /// `rays` by `rays` rays per pixel.
    pub(crate) fn fine(rays: u32) -> Self {
        Self { block: 1, rays }
    }

    /// The traced size, in rays, for an image of this size in pixels.
    pub(crate) fn traced_size(self, size: [u32; 2]) -> [u32; 2] {
        size.map(|pixels| (pixels * self.rays).div_ceil(self.block))
    }

    /// The next finer detail towards `rays` by `rays` rays per pixel; `None` at that detail.
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

/// The next step of the [`DetailController`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Step {
    /// Trace with this detail.
    Trace(Detail),
    /// Ask again after this time.
    Wait(Duration),
    /// The picture is final.
    Rest,
}

/// Estimates frame times and chooses the detail of the next frame.
#[derive(Debug, Default)]
pub(crate) struct DetailController {
    /// Measured in the last frame.
    seconds_per_ray: Option<f64>,
    /// The detail of the frame that is shown.
    shown: Option<Detail>,
    /// When something moved last.
    moved: Option<Instant>,
    /// Whether all rays are traced at once, however long that takes, until something moves.
    finishes: bool,
}

impl DetailController {
    /// The detail of the frame that is shown.
    pub(crate) fn shown(&self) -> Option<Detail> {
        self.shown
    }

    /// Records the detail and time of a frame.
    pub(crate) fn traced(&mut self, detail: Detail, size: [u32; 2], time: Duration) {
        let rays = detail.ray_count(size);
        if rays > 0.0 {
            self.seconds_per_ray = Some(time.as_secs_f64() / rays);
        }
        self.shown = Some(detail);
    }

    /// The estimated time of a frame of this detail; `None` before the first frame.
    pub(crate) fn forecast(&self, detail: Detail, size: [u32; 2]) -> Option<Duration> {
        let seconds = self.seconds_per_ray? * detail.ray_count(size);
        Duration::try_from_secs_f64(seconds).ok()
    }

    /// Lifts the limits of frame times until something moves.
    pub(crate) fn finish(&mut self) {
        self.finishes = true;
    }

    /// The next step for an image of this size in pixels. `moves` says whether view or scene differ from the last
    /// frame.
    pub(crate) fn step(&mut self, moves: bool, size: [u32; 2], rays: u32, now: Instant) -> Step {
        // 1. While something moves: one frame within the target.
        if moves {
            (self.moved, self.finishes) = (Some(now), false);
            return Step::Trace(self.while_moving(size));
        }
        let Some(shown) = self.shown else { return Step::Trace(self.while_moving(size)) };
        let Some(finer) = shown.finer(rays) else { return Step::Rest };
        let time = |detail| self.forecast(detail, size).unwrap_or_default();

        // 2. While nothing moves: refine step by step, or to full detail at once if that is fast.
        let at_once = self.finishes || time(Detail::fine(rays)) < 4 * FRAME_TIME_TARGET;
        let next = if at_once { Detail::fine(rays) } else { finer };

        // 3. Do not begin a frame that is too slow, and begin a slow one only after a pause.
        let still_for = self.moved.map_or(STILL_TIME, |moved| now.saturating_duration_since(moved));
        if time(next) > MAX_FRAME_TIME && !self.finishes {
            Step::Rest
        } else if time(next) > FRAME_TIME_TARGET && still_for < STILL_TIME {
            Step::Wait(STILL_TIME - still_for)
        } else {
            Step::Trace(next)
        }
    }

    /// The highest detail within the frame time target.
    fn while_moving(&self, size: [u32; 2]) -> Detail {
        /// The detail of the first frame, when nothing has been measured.
        const INITIAL: Detail = Detail { block: 4, rays: 1 };

        let Some(full) = self.forecast(Detail::PIXEL, size) else { return INITIAL };
        let block = (full.as_secs_f64() / FRAME_TIME_TARGET.as_secs_f64()).sqrt().ceil();
        Detail { block: (block as u32).clamp(1, MAX_BLOCK), rays: 1 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: [u32; 2] = [800, 600];

    /// A controller that has recorded a frame of one ray per pixel.
    fn controller(milliseconds: u64) -> DetailController {
        let mut controller = DetailController::default();
        controller.traced(Detail::PIXEL, SIZE, Duration::from_millis(milliseconds));
        controller
    }

    #[test]
    fn moving_stays_below_the_limit() {
        let now = Instant::now();
        assert_eq!(controller(49).step(true, SIZE, 2, now), Step::Trace(Detail::PIXEL));
        for milliseconds in [51, 200, 1_000, 5_000] {
            let mut controller = controller(milliseconds);
            let Step::Trace(detail) = controller.step(true, SIZE, 2, now) else { panic!("it moves") };
            assert!(detail.block > 1);
            assert!(
                controller.forecast(detail, SIZE).unwrap() < FRAME_TIME_TARGET * 11 / 10,
                "{milliseconds} ms: {detail:?}"
            );
        }
    }

    #[test]
    fn what_stands_still_becomes_sharp_in_steps() {
        let mut controller = controller(800);
        let moved = Instant::now();
        let Step::Trace(mut shown) = controller.step(true, SIZE, 1, moved) else { panic!("it moves") };
        assert_eq!(shown.block, 4);
        let later = moved + STILL_TIME;
        let mut steps = Vec::new();
        loop {
            controller.traced(shown, SIZE, controller.forecast(shown, SIZE).unwrap());
            match controller.step(false, SIZE, 1, later) {
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
        let mut slow = controller(1_000);
        let Step::Trace(detail) = slow.step(true, SIZE, 1, moved) else { panic!("it moves") };
        slow.traced(detail, SIZE, slow.forecast(detail, SIZE).unwrap());
        assert_eq!(slow.step(false, SIZE, 1, moved + STILL_TIME / 3), Step::Wait(STILL_TIME - STILL_TIME / 3));

        let mut endless = controller(9_000);
        endless.traced(Detail { block: 2, rays: 1 }, SIZE, Duration::from_millis(2_250));
        assert_eq!(endless.step(false, SIZE, 1, moved + STILL_TIME), Step::Rest);
        endless.finish();
        assert_eq!(endless.step(false, SIZE, 1, moved + STILL_TIME), Step::Trace(Detail::PIXEL));
    }

    #[test]
    fn sizes_that_do_not_divide_are_covered() {
        assert_eq!(Detail { block: 4, rays: 1 }.traced_size([801, 3]), [201, 1]);
        assert_eq!(Detail::fine(2).traced_size([5, 7]), [10, 14]);
    }
}
