//! What traces device arrays: the kernel on each executor, and its shaders.

mod trace;
