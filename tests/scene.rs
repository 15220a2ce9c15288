//! What an application describes: the scene graph, and glTF files that become one.

mod gltf;
mod graph;
