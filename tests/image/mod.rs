//! Images.

mod save;
