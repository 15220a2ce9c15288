//! A virtual display (Xvfb) with simulated pointer and keyboard input and screen capture.

use std::io::{BufRead as _, BufReader};
use std::process::{Child, Command, Stdio};

use x11rb::connection::Connection as _;
use x11rb::protocol::xproto::{
    BUTTON_PRESS_EVENT, BUTTON_RELEASE_EVENT, ConnectionExt as _, ImageFormat, InputFocus, KEY_PRESS_EVENT,
    KEY_RELEASE_EVENT, MOTION_NOTIFY_EVENT, MapState, Window,
};
use x11rb::protocol::xtest::ConnectionExt as _;
use x11rb::rust_connection::RustConnection;

/// Key symbols of X11.
pub(crate) const CONTROL: u32 = 0xffe3;
/// As [`CONTROL`].
pub(crate) const HOME: u32 = 0xff50;

/// A running X server of our own.
pub(crate) struct Display {
    server: Child,
    /// The value of the environment variable DISPLAY: ":5".
    pub(crate) name: String,
    connection: RustConnection,
    root: Window,
}

impl Display {
    /// Starts one; `None` if Xvfb is not installed. Panics then if `ROPEWALK_REQUIRE_WINDOW` is set.
    pub(crate) fn start() -> Option<Self> {
        let mut command = Command::new("Xvfb");
        command.args(["-displayfd", "1", "-screen", "0", "1024x768x24", "-nolisten", "tcp"]);
        let mut server = match command.stdout(Stdio::piped()).stderr(Stdio::null()).spawn() {
            Ok(server) => server,
            Err(error) if std::env::var_os("ROPEWALK_REQUIRE_WINDOW").is_some() => panic!("Xvfb: {error}"),
            Err(error) => {
                eprintln!("skipped: Xvfb: {error} (scripts/install-xvfb.sh installs it)");
                return None;
            }
        };
        let mut number = String::new();
        BufReader::new(server.stdout.take().unwrap()).read_line(&mut number).unwrap();
        let name = format!(":{}", number.trim());
        let (connection, screen) = x11rb::connect(Some(&name)).unwrap();
        let root = connection.setup().roots[screen].root;
        Some(Self { server, name, connection, root })
    }

    /// Gives the keyboard to the window that is shown: there is no window manager to do it.
    pub(crate) fn focus_window(&self) {
        let tree = self.connection.query_tree(self.root).unwrap().reply().unwrap();
        let is_shown = |window: &Window| {
            let attributes = self.connection.get_window_attributes(*window).unwrap().reply();
            attributes.is_ok_and(|attributes| attributes.map_state == MapState::VIEWABLE)
        };
        let window = tree.children.into_iter().find(is_shown).expect("no window is shown");
        self.connection.set_input_focus(InputFocus::PARENT, window, x11rb::CURRENT_TIME).unwrap();
        self.sync();
    }

    /// Moves the pointer.
    pub(crate) fn point(&self, [x, y]: [i16; 2]) {
        self.connection.xtest_fake_input(MOTION_NOTIFY_EVENT, 0, 0, self.root, x, y, 0).unwrap();
        self.sync();
    }

    /// Presses or releases the left button.
    pub(crate) fn button(&self, press: bool) {
        let event = if press { BUTTON_PRESS_EVENT } else { BUTTON_RELEASE_EVENT };
        self.connection.xtest_fake_input(event, 1, 0, self.root, 0, 0, 0).unwrap();
        self.sync();
    }

    /// Types keys together: the last one while the others are held.
    pub(crate) fn keys(&self, keys: &[u32]) {
        let codes: Vec<u8> = keys.iter().map(|&key| self.code(key)).collect();
        for &code in &codes {
            self.key(KEY_PRESS_EVENT, code);
        }
        for &code in codes.iter().rev() {
            self.key(KEY_RELEASE_EVENT, code);
        }
    }

    /// The pixels of a rectangle (left, top, width, height) of the screen, row by row.
    pub(crate) fn screenshot(&self, [x, y, width, height]: [u16; 4]) -> Vec<[u8; 4]> {
        let format = ImageFormat::Z_PIXMAP;
        let image = self.connection.get_image(format, self.root, x as i16, y as i16, width, height, u32::MAX);
        let image = image.unwrap().reply().unwrap();
        assert_eq!(image.depth, 24);
        image.data.chunks_exact(4).map(|pixel| [pixel[2], pixel[1], pixel[0], 255]).collect()
    }

    fn key(&self, event: u8, code: u8) {
        self.connection.xtest_fake_input(event, code, 0, self.root, 0, 0, 0).unwrap();
        self.sync();
    }

    fn code(&self, key: u32) -> u8 {
        let setup = self.connection.setup();
        let count = setup.max_keycode - setup.min_keycode + 1;
        let mapping = self.connection.get_keyboard_mapping(setup.min_keycode, count).unwrap().reply().unwrap();
        let per_code = usize::from(mapping.keysyms_per_keycode);
        let index = mapping.keysyms.chunks(per_code).position(|symbols| symbols.contains(&key)).expect("no such key");
        setup.min_keycode + index as u8
    }

    /// Waits until the server has processed all requests.
    fn sync(&self) {
        self.connection.get_input_focus().unwrap().reply().unwrap();
    }
}

impl Drop for Display {
    fn drop(&mut self) {
        let _ = self.server.kill();
        let _ = self.server.wait();
    }
}
