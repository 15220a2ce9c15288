//! Image files, written whole or not at all.

use std::path::Path;

use super::{Image, encode};
use crate::atomic_file::write_atomically;
use crate::{Error, Result};

impl Image {
    /// Writes the image to a file, in the format that the name's ending says:
    /// - `.png`: [`to_rgba8`](Self::to_rgba8), sRGB;
    /// - `.exr`: the linear colour as it is (channels R, G, B, A), and where there are AOVs, Z, N.X, N.Y, N.Z, and as
    ///   unsigned integers `id.node`, `id.node_version` and `id.triangle`; all 32 bit, ZIP compressed without loss.
    ///
    /// The file appears whole or not at all: it is written beside its place under another name and then moved, so that an
    /// older file of that name stays as it was until the new one is complete.
    ///
    /// # Errors
    /// - [`Error::ImageFormat`] for any other ending.
    /// - [`Error::Io`] where the file cannot be written: most often the folder does not exist or may not be written to.
    /// - [`Error::Image`] where the image cannot be encoded: it has no pixels.
    /// - [`Error::OutOfRange`] where an array has not `width * height` elements.
    pub fn save(&self, path: impl AsRef<Path>) -> Result<()> {
        let path = path.as_ref();
        let encode = encode::encoder_for_path(path)?;
        self.validate()?;
        let bytes = encode(self).map_err(|error| Error::Image { path: path.to_owned(), cause: error.to_string() })?;
        write_atomically(path, &bytes).map_err(|error| Error::io(path, error))
    }

    /// Whether [`save`](Self::save) knows the format of a file of this name: to be asked before a long render.
    ///
    /// # Errors
    /// [`Error::ImageFormat`] where it does not.
    pub fn check_format(path: impl AsRef<Path>) -> Result<()> {
        encode::encoder_for_path(path.as_ref()).map(|_| ())
    }
}
