//! Image files, written whole or not at all.

use std::path::Path;

use super::{Image, encode};
use crate::atomic_file::write_atomically;
use crate::{Error, Result};

impl Image {
    /// Writes the image to a file. The extension of the name selects the format:
    /// - `.png`: [`to_rgba8`](Self::to_rgba8), sRGB, tone mapped as [`tone_mapping`](Self::tone_mapping) says;
    /// - `.exr`: the linear colour, unchanged (channels R, G, B, A), [`unlit`](Self::unlit) if it is not empty, and
    ///   with AOVs also Z, N.X, N.Y, N.Z and, as unsigned integers, `id.node`, `id.node_version` and `id.triangle`; all
    ///   32 bit, ZIP compressed without loss.
    ///
    /// The file appears whole or not at all: it is written to the same folder under another name and then renamed, so
    /// that an older file of that name stays as it was until the new one is complete. That other name is
    /// `.ropewalk-<process id>-<number>.tmp`, for a program that ends itself meanwhile and removes the file.
    ///
    /// # Errors
    /// - [`Error::ImageFormat`] for any other extension.
    /// - [`Error::Io`] if the file cannot be written: most often the folder does not exist or may not be written to.
    /// - [`Error::Image`] if the image cannot be encoded: it has no pixels.
    /// - [`Error::OutOfRange`] if an array does not have `width * height` elements.
    pub fn save(&self, path: impl AsRef<Path>) -> Result<()> {
        let path = path.as_ref();
        let encode = encode::encoder_for_path(path)?;
        self.validate()?;
        let bytes = encode(self).map_err(|error| Error::Image { path: path.to_owned(), cause: error.to_string() })?;
        write_atomically(path, &bytes).map_err(|error| Error::io(path, error))
    }

    /// Checks that [`save`](Self::save) knows the format of a file of this name. Call it before a long render to fail
    /// early.
    ///
    /// # Errors
    /// [`Error::ImageFormat`] if it does not.
    pub fn check_format(path: impl AsRef<Path>) -> Result<()> {
        encode::encoder_for_path(path.as_ref()).map(|_| ())
    }
}
