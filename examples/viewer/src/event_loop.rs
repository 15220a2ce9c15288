//! The window's life: events in, frames out.

use std::io::Write as _;
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use winit::application::ApplicationHandler;
use winit::dpi::PhysicalSize;
use winit::event::WindowEvent;
use winit::event_loop::{ActiveEventLoop, ControlFlow, EventLoop};
use winit::window::WindowId;

use crate::app::{App, Settings};
use crate::arguments::Arguments;
use crate::detail::Detail;
use crate::drag::Moves;
use crate::theme;
use crate::ui::Panels;
use crate::viewport::Viewport;
use crate::window::{Painted, Window};

/// Opens the window and serves it until it is closed.
pub(crate) fn run(arguments: Arguments) -> Result<(), String> {
    let event_loop = EventLoop::new().map_err(|error| format!("no window can be opened: {error}"))?;
    let mut viewer = Viewer { arguments, state: None, outcome: Ok(()) };
    event_loop.run_app(&mut viewer).map_err(|error| error.to_string())?;
    viewer.outcome
}

/// What winit calls.
struct Viewer {
    arguments: Arguments,
    state: Option<State>,
    /// Why there is no window.
    outcome: Result<(), String>,
}

/// What there is while there is a window.
struct State {
    window: Window,
    input: egui_winit::State,
    app: App,
    panels: Panels,
    laid_out: LaidOut,
    /// When to draw again although nothing happens.
    wake: Option<Instant>,
    log: bool,
    /// What was last logged as shown, and whether there was an overlay.
    logged: Option<(Viewport, Detail, bool)>,
}

/// What egui last laid out, to be drawn.
#[derive(Default)]
struct LaidOut {
    viewport: Viewport,
    shapes: Vec<egui::epaint::ClippedShape>,
    /// Of all passes since something was drawn.
    textures: egui::TexturesDelta,
    pixels_per_point: f32,
    repaint_delay: Duration,
}

impl ApplicationHandler for Viewer {
    fn resumed(&mut self, event_loop: &ActiveEventLoop) {
        if self.state.is_none() {
            match State::new(event_loop, &self.arguments) {
                Ok(state) => self.state = Some(state),
                Err(message) => {
                    self.outcome = Err(message);
                    event_loop.exit();
                }
            }
        }
    }

    fn window_event(&mut self, event_loop: &ActiveEventLoop, _: WindowId, event: WindowEvent) {
        let Some(state) = &mut self.state else { return };
        // However long frames take, a drag is seen as one: its press, its way and its release each in a pass of its own.
        let is_button = matches!(event, WindowEvent::MouseInput { .. });
        if is_button {
            state.lay_out();
        }
        let wants_repaint = state.input.on_window_event(&state.window.handle, &event).repaint;
        match event {
            WindowEvent::CloseRequested => event_loop.exit(),
            WindowEvent::Resized(size) => state.window.resize(size),
            WindowEvent::RedrawRequested => return state.redraw(),
            _ => {}
        }
        if is_button {
            state.lay_out();
        }
        if wants_repaint {
            state.window.handle.request_redraw();
        }
    }

    fn about_to_wait(&mut self, event_loop: &ActiveEventLoop) {
        let Some(state) = &mut self.state else { return };
        match state.wake {
            Some(wake) if wake <= Instant::now() => {
                state.wake = None;
                state.window.handle.request_redraw();
                event_loop.set_control_flow(ControlFlow::Wait);
            }
            Some(wake) => event_loop.set_control_flow(ControlFlow::WaitUntil(wake)),
            None => event_loop.set_control_flow(ControlFlow::Wait),
        }
    }
}

impl State {
    fn new(event_loop: &ActiveEventLoop, arguments: &Arguments) -> Result<Self, String> {
        let (width, height) = arguments.size;
        let attributes = winit::window::Window::default_attributes()
            .with_title("Ropewalk")
            .with_inner_size(PhysicalSize::new(width, height));
        let handle = event_loop.create_window(attributes).map_err(|error| error.to_string())?;
        let window = Window::new(handle, event_loop.owned_display_handle())?;

        let context = egui::Context::default();
        theme::apply(&context);
        let input = egui_winit::State::new(
            context,
            egui::ViewportId::ROOT,
            event_loop,
            Some(window.handle.scale_factor() as f32),
            None,
            Some(window.most_texels()),
        );
        let settings = Settings {
            depth: arguments.depth,
            rays: arguments.samples,
            ray_mask: u32::MAX,
            camera: None,
            moves: Moves::Object,
            overlay: true,
            save_path: arguments.save.clone(),
            open_path: String::new(),
        };
        let mut app =
            App::new(arguments.device.into(), settings, Some(window.on.clone())).map_err(|error| error.to_string())?;
        app.open(arguments.file.clone());
        window.handle.request_redraw();
        let (panels, laid_out) = (Panels::default(), LaidOut::default());
        Ok(Self { window, input, app, panels, laid_out, wake: None, log: arguments.log, logged: None })
    }

    /// Lays out the window and does what the user did since the last time.
    fn lay_out(&mut self) {
        let Self { window, input, app, panels, laid_out, .. } = self;
        for complaint in window.take_complaints() {
            app.fail(&complaint);
        }
        let context = input.egui_ctx().clone();
        let output = context.run_ui(input.take_egui_input(&window.handle), |ui| {
            laid_out.viewport = panels.show(ui, app);
        });
        input.handle_platform_output(&window.handle, output.platform_output);
        laid_out.shapes = output.shapes;
        laid_out.textures.append(output.textures_delta);
        laid_out.pixels_per_point = output.pixels_per_point;
        let root = output.viewport_output.get(&egui::ViewportId::ROOT);
        laid_out.repaint_delay = root.map_or(Duration::MAX, |output| output.repaint_delay);
    }

    /// Lays out, traces what is to be seen, and draws it.
    fn redraw(&mut self) {
        let title = self.app.title.clone();
        self.lay_out();
        let Self { window, input, app, laid_out, .. } = self;
        if app.title != title {
            window.handle.set_title(&format!("{} - Ropewalk", app.title));
        }
        let drawn = app.draw(Instant::now());
        if let Some(picture) = &drawn.picture {
            window.presenter.take(&window.on.device, &window.on.queue, picture);
        }
        let LaidOut { viewport, pixels_per_point, repaint_delay, .. } = *laid_out;
        let jobs = input.egui_ctx().tessellate(std::mem::take(&mut laid_out.shapes), pixels_per_point);
        let textures = std::mem::take(&mut laid_out.textures);
        let presented = window.draw(Painted { jobs, textures, pixels_per_point }, viewport);

        let loading_wants = app.loading().map(|_| Duration::from_millis(30));
        let soonest = [Some(repaint_delay), loading_wants, drawn.again].into_iter().flatten().min();
        self.wake = soonest.and_then(|delay| Instant::now().checked_add(delay));
        let is_resting = drawn.picture.is_none() && drawn.again.is_none() && loading_wants.is_none();
        self.tell(viewport, presented && is_resting);
    }

    /// Logs what happened, and what is shown once nothing more will happen to it.
    fn tell(&mut self, viewport: Viewport, is_resting: bool) {
        let mut events = self.app.take_events();
        let overlay = self.app.settings.overlay;
        let shown = self.app.drawing.detail().map(|detail| (viewport, detail, overlay));
        if !is_resting {
            self.logged = None;
        } else if self.logged != shown
            && let Some((Viewport { x, y, width, height }, detail, _)) = shown
        {
            self.logged = shown;
            let (block, rays) = (detail.block, detail.rays);
            let place = [x, y, width, height];
            let event = "at rest";
            events.push(json!({
                "event": event, "viewport": place, "block": block, "rays": rays, "overlay": overlay,
            }));
        }
        if self.log {
            events.iter().for_each(print);
        }
    }
}

/// A line on standard output; where nobody reads it, there is no harm.
fn print(event: &Value) {
    let mut output = std::io::stdout().lock();
    let _ = writeln!(output, "{event}").and_then(|()| output.flush());
}
