//! The kernel on every executor, compared with brute force and between executors.

mod executors;
mod oracle;
mod range;
mod traversals;
mod watertight;
