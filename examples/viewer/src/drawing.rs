//! Tracing what is to be shown: when, how finely, and how long it took.

use std::collections::VecDeque;
use std::path::Path;
use std::time::{Duration, Instant};

use glam::{DVec2, UVec2};
use ropewalk::image::Image;
use ropewalk::query::Hit;
use ropewalk::{DeviceChoice, FrameReport, Renderer, Result, Scene, View};

use crate::detail::{Detail, Pace, Step};
use crate::device::{self, Opened, WindowDevice};

/// A traced frame, where it is.
pub(crate) enum Picture {
    /// Linear colour on the window's device.
    Texture(wgpu::Texture),
    Image(Image),
}

/// What [`Drawing::draw`] did.
#[derive(Default)]
pub(crate) struct Drawn {
    /// A new picture; none where the last one will do.
    pub(crate) picture: Option<Picture>,
    /// When to draw again although nothing happens.
    pub(crate) again: Option<Duration>,
}

/// The renderer and what is known of its frames.
pub(crate) struct Drawing {
    window: Option<WindowDevice>,
    renderer: Renderer,
    pub(crate) choice: DeviceChoice,
    /// Why the GPU is not used, where it was wanted.
    pub(crate) fallback: Option<String>,
    pace: Pace,
    /// Of the last frame: its view, the scene's revision, and whether it failed.
    last: Option<(View, u64, bool)>,
    pub(crate) report: Option<FrameReport>,
    /// Of the last frames, the latest last.
    pub(crate) times: VecDeque<Duration>,
}

/// How many frame times are remembered.
pub(crate) const MOST_TIMES: usize = 120;

impl Drawing {
    pub(crate) fn new(choice: DeviceChoice, window: Option<WindowDevice>) -> Result<Self> {
        let Opened { renderer, fallback } = device::open(choice, window.as_ref())?;
        let (pace, times) = (Pace::default(), VecDeque::with_capacity(MOST_TIMES));
        Ok(Self { window, renderer, choice, fallback, pace, last: None, report: None, times })
    }

    /// Traces with another device from now on; after an error with the same as before.
    pub(crate) fn choose(&mut self, choice: DeviceChoice) -> Result<()> {
        *self = Self::new(choice, self.window.clone())?;
        Ok(())
    }

    /// The detail that is shown.
    pub(crate) fn detail(&self) -> Option<Detail> {
        self.pace.shown()
    }

    /// Traces all rays of what is to be seen, however long the window has to wait for them.
    pub(crate) fn finish(&mut self) {
        self.pace.finish();
    }

    /// Forgets what was drawn and how long it took: another scene is to be seen.
    pub(crate) fn start_over(&mut self) {
        (self.pace, self.last) = (Pace::default(), None);
    }

    /// How long a frame with so many rays a pixel would take.
    pub(crate) fn forecast(&self, rays: u32) -> Option<Duration> {
        let (view, ..) = self.last.as_ref()?;
        self.pace.forecast(Detail::fine(rays), [view.width, view.height])
    }

    /// Brings what is shown nearer to `view` with `rays` by `rays` rays a pixel, as far as that is fluent.
    pub(crate) fn draw(&mut self, scene: &mut Scene, view: &View, rays: u32, now: Instant) -> Result<Drawn> {
        let size = [view.width, view.height];
        let (same, failed) = match &self.last {
            Some((last, revision, failed)) => (last == view && *revision == scene.revision(), *failed),
            None => (false, false),
        };
        if size.contains(&0) || (same && failed) {
            return Ok(Drawn::default());
        }
        let detail = match self.pace.step(!same, size, rays, now) {
            Step::Trace(detail) => detail,
            Step::Wait(time) => return Ok(Drawn { picture: None, again: Some(time) }),
            Step::Rest => return Ok(Drawn::default()),
        };
        let traced = self.trace(scene, view, detail);
        self.last = Some((view.clone(), scene.revision(), traced.is_err()));
        let (picture, time) = traced?;
        self.pace.traced(detail, size, time);
        Ok(Drawn { picture: Some(picture), again: Some(Duration::ZERO) })
    }

    /// What is seen at a position of the view's picture.
    pub(crate) fn pick(&mut self, scene: &mut Scene, view: &View, position: DVec2) -> Result<Option<Hit>> {
        let last = UVec2::new(view.width, view.height).saturating_sub(UVec2::ONE);
        self.renderer.pick(scene, view, position.floor().as_uvec2().min(last).to_array())
    }

    /// Writes the view to a file, in full detail however long that takes.
    pub(crate) fn save(&mut self, scene: &mut Scene, view: &View, rays: u32, path: &Path) -> Result<()> {
        Image::check_format(path)?;
        let view = sized(view, Detail::fine(rays));
        self.renderer.render(scene, &view)?.image()?.downscaled(rays)?.save(path)
    }

    fn trace(&mut self, scene: &mut Scene, view: &View, detail: Detail) -> Result<(Picture, Duration)> {
        let start = Instant::now();
        let frame = self.renderer.render(scene, &sized(view, detail))?;
        let picture = match frame.texture() {
            Some(texture) => Picture::Texture(texture.clone()),
            None => Picture::Image(frame.image()?),
        };
        // On a GPU this waits for the frame.
        let time = frame.gpu_time().unwrap_or(frame.report().trace_time);
        self.report = Some(frame.report().clone());
        if self.times.len() == MOST_TIMES {
            self.times.pop_front();
        }
        self.times.push_back(start.elapsed());
        Ok((picture, time))
    }
}

fn sized(view: &View, detail: Detail) -> View {
    let [width, height] = detail.traced_size([view.width, view.height]);
    View { width, height, ..view.clone() }
}
