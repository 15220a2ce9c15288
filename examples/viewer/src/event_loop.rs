//! The winit event loop.

use std::io::Write as _;
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use winit::application::ApplicationHandler;
use winit::dpi::PhysicalSize;
use winit::event::WindowEvent;
use winit::event_loop::{ActiveEventLoop, ControlFlow, EventLoop};
use winit::window::WindowId;

use crate::allowed_folders::check_folders;
use crate::app::{App, Settings};
use crate::arguments::Arguments;
use crate::detail::Detail;
use crate::drag::Moves;
use crate::theme;
use crate::ui::Panels;
use crate::viewport::Viewport;
use crate::window::{EguiOutput, Window};

/// Opens the window and runs until it is closed.
pub(crate) fn run(arguments: Arguments) -> Result<(), String> {
    check_folders(&arguments.allow_folder)?;
    let event_loop = EventLoop::new().map_err(|error| format!("no window can be opened: {error}"))?;
    let mut viewer = Viewer { arguments, state: None, outcome: Ok(()) };
    event_loop.run_app(&mut viewer).map_err(|error| error.to_string())?;
    viewer.outcome
}

/// The event handler of winit.
struct Viewer {
    arguments: Arguments,
    state: Option<State>,
    /// The error if the window could not be opened.
    outcome: Result<(), String>,
}

/// The state while the window is open.
struct State {
    window: Window,
    input: egui_winit::State,
    app: App,
    panels: Panels,
    laid_out: LaidOut,
    /// When to draw again even without input.
    wake: Option<Instant>,
    log: bool,
    /// The viewport, detail and overlay that were last logged as shown.
    logged: Option<(Viewport, Detail, bool)>,
}

/// The last output of egui, to be drawn.
#[derive(Default)]
struct LaidOut {
    viewport: Viewport,
    shapes: Vec<egui::epaint::ClippedShape>,
    /// The texture changes of all passes since the last frame.
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
        // Press, movement and release are handled in separate passes, so that a drag is recognised however long frames
        // take.
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
            Some(window.max_texture_side()),
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
            allowed_folders: arguments.allow_folder.clone(),
        };
        let mut app =
            App::new(arguments.device.into(), settings, Some(window.gpu.clone())).map_err(|error| error.to_string())?;
        app.open(arguments.file.clone());
        window.handle.request_redraw();
        let (panels, laid_out) = (Panels::default(), LaidOut::default());
        Ok(Self { window, input, app, panels, laid_out, wake: None, log: arguments.log, logged: None })
    }

    /// Lays out the window and handles the input since the last call.
    fn lay_out(&mut self) {
        let Self { window, input, app, panels, laid_out, .. } = self;
        for error in window.take_device_errors() {
            app.fail(&error);
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

    /// Lays out the window, traces the next frame if one is due, and draws.
    fn redraw(&mut self) {
        let title = self.app.title.clone();
        self.lay_out();
        let Self { window, input, app, laid_out, .. } = self;
        if app.title != title {
            window.handle.set_title(&format!("{} - Ropewalk", app.title));
        }
        let drawn = app.draw(Instant::now());
        if let Some(picture) = &drawn.picture {
            window.presenter.set_picture(&window.gpu.device, &window.gpu.queue, picture);
        }
        let LaidOut { viewport, pixels_per_point, repaint_delay, .. } = *laid_out;
        let jobs = input.egui_ctx().tessellate(std::mem::take(&mut laid_out.shapes), pixels_per_point);
        let textures = std::mem::take(&mut laid_out.textures);
        let presented = window.draw(EguiOutput { jobs, textures, pixels_per_point }, viewport);

        let loading_poll = app.loading().map(|_| Duration::from_millis(30));
        let soonest = [Some(repaint_delay), loading_poll, drawn.again].into_iter().flatten().min();
        self.wake = soonest.and_then(|delay| Instant::now().checked_add(delay));
        let is_resting = drawn.picture.is_none() && drawn.again.is_none() && loading_poll.is_none();
        self.log_events(viewport, presented && is_resting);
    }

    /// Logs the events and, once the picture is final, its viewport and detail.
    fn log_events(&mut self, viewport: Viewport, is_resting: bool) {
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
            let rect = [x, y, width, height];
            let event = "at rest";
            events.push(json!({
                "event": event, "viewport": rect, "block": block, "rays": rays, "overlay": overlay,
            }));
        }
        if self.log {
            events.iter().for_each(print);
        }
    }
}

/// Prints a line to standard output; a closed pipe is ignored.
fn print(event: &Value) {
    let mut output = std::io::stdout().lock();
    let _ = writeln!(output, "{event}").and_then(|()| output.flush());
}
