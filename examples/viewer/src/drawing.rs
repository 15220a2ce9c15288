//! Tracing of the frames that are shown: when, in what detail, and how long it took.

use std::collections::VecDeque;
use std::path::Path;
use std::time::{Duration, Instant};

use glam::{DVec2, UVec2};
use ropewalk::image::Image;
use ropewalk::query::Hit;
use ropewalk::{DeviceChoice, FrameReport, Renderer, Result, Scene, View};

use crate::detail::{Detail, DetailController, Step};
use crate::device::{self, Opened, WindowDevice};

/// A traced frame, in GPU or main memory.
pub(crate) enum Picture {
    /// Linear colour on the window's device.
    Texture(wgpu::Texture),
    Image(Image),
}

/// The result of [`Drawing::draw`].
#[derive(Default)]
pub(crate) struct Drawn {
    /// A new picture; `None` if the last one is still valid.
    pub(crate) picture: Option<Picture>,
    /// When to draw again even without input.
    pub(crate) again: Option<Duration>,
}

/// The renderer, and the state of the frames it has traced.
pub(crate) struct Drawing {
    window: Option<WindowDevice>,
    renderer: Renderer,
    pub(crate) choice: DeviceChoice,
    /// Why the CPU is used although a GPU is preferred.
    pub(crate) fallback: Option<String>,
    controller: DetailController,
    /// The view of the last frame, the scene's revision then, and whether the frame failed.
    last: Option<(View, u64, bool)>,
    pub(crate) report: Option<FrameReport>,
    /// The times of the last frames, the latest last.
    pub(crate) times: VecDeque<Duration>,
}

/// How many frame times are kept.
pub(crate) const MAX_TIMES: usize = 120;

impl Drawing {
    pub(crate) fn new(choice: DeviceChoice, window: Option<WindowDevice>) -> Result<Self> {
        let Opened { renderer, fallback } = device::open(choice, window.as_ref())?;
        let (controller, times) = (DetailController::default(), VecDeque::with_capacity(MAX_TIMES));
        Ok(Self { window, renderer, choice, fallback, controller, last: None, report: None, times })
    }

    /// Changes the device; after an error the device is as before.
    pub(crate) fn choose(&mut self, choice: DeviceChoice) -> Result<()> {
        *self = Self::new(choice, self.window.clone())?;
        Ok(())
    }

    /// The detail that is shown.
    pub(crate) fn detail(&self) -> Option<Detail> {
        self.controller.shown()
    }

    /// Traces all rays of the current view, however long the window has to wait for them.
    pub(crate) fn finish(&mut self) {
        self.controller.finish();
    }

    /// Resets the state of past frames, for a different scene.
    pub(crate) fn start_over(&mut self) {
        (self.controller, self.last) = (DetailController::default(), None);
    }

    /// The estimated time of a frame with `rays` by `rays` rays per pixel.
    pub(crate) fn forecast(&self, rays: u32) -> Option<Duration> {
        let (view, ..) = self.last.as_ref()?;
        self.controller.forecast(Detail::fine(rays), [view.width, view.height])
    }

    /// Traces the next frame of `view`, in a detail that keeps the window responsive, up to `rays` by `rays` rays per
    /// pixel.
    pub(crate) fn draw(&mut self, scene: &mut Scene, view: &View, rays: u32, now: Instant) -> Result<Drawn> {
        let size = [view.width, view.height];
        let (is_same, failed) = match &self.last {
            Some((last, revision, failed)) => (last == view && *revision == scene.revision(), *failed),
            None => (false, false),
        };
        if size.contains(&0) || (is_same && failed) {
            return Ok(Drawn::default());
        }
        let detail = match self.controller.step(!is_same, size, rays, now) {
            Step::Trace(detail) => detail,
            Step::Wait(time) => return Ok(Drawn { picture: None, again: Some(time) }),
            Step::Rest => return Ok(Drawn::default()),
        };
        let traced = self.trace(scene, view, detail);
        self.last = Some((view.clone(), scene.revision(), traced.is_err()));
        let (picture, time) = traced?;
        self.controller.traced(detail, size, time);
        Ok(Drawn { picture: Some(picture), again: Some(Duration::ZERO) })
    }

    /// The closest hit at a position of the image.
    pub(crate) fn pick(&mut self, scene: &mut Scene, view: &View, position: DVec2) -> Result<Option<Hit>> {
        let last = UVec2::new(view.width, view.height).saturating_sub(UVec2::ONE);
        self.renderer.pick(scene, view, position.floor().as_uvec2().min(last).to_array())
    }

    /// Writes an image of the view to a file, in full detail however long that takes.
    pub(crate) fn save(&mut self, scene: &mut Scene, view: &View, rays: u32, path: &Path) -> Result<()> {
        Image::check_format(path)?;
        let view = with_traced_size(view, Detail::fine(rays));
        self.renderer.render(scene, &view)?.image()?.downscaled(rays)?.save(path)
    }

    fn trace(&mut self, scene: &mut Scene, view: &View, detail: Detail) -> Result<(Picture, Duration)> {
        let start = Instant::now();
        let frame = self.renderer.render(scene, &with_traced_size(view, detail))?;
        let picture = match frame.texture() {
            Some(texture) => Picture::Texture(texture.clone()),
            None => Picture::Image(frame.image()?),
        };
        // On a GPU this waits for the frame.
        let time = frame.gpu_time().unwrap_or(frame.report().trace_time);
        self.report = Some(frame.report().clone());
        if self.times.len() == MAX_TIMES {
            self.times.pop_front();
        }
        self.times.push_back(start.elapsed());
        Ok((picture, time))
    }
}

fn with_traced_size(view: &View, detail: Detail) -> View {
    let [width, height] = detail.traced_size([view.width, view.height]);
    View { width, height, ..view.clone() }
}
