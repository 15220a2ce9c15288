//! What a scene becomes before it is traced: acceleration structures and device arrays.

mod accel;
mod compile;
