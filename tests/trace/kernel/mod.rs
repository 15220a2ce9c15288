//! The kernel on every executor, against brute force and against itself.

mod executors;
mod oracle;
mod traversals;
mod watertight;
