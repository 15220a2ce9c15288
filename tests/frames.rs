//! What an application gets: frames, image files, answers to queries, and the example `render`.

mod examples;
mod image;
mod query;
mod render;
