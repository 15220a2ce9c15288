//! Small glTF files, made in code.

use std::path::Path;

use ropewalk::gltf::{self, GltfFault, ImportOptions, ImportReport};
use ropewalk::{Core, Error, Geometry, Material, NodeKey, Result, Scene};
use serde_json::{Value, json};

/// A glTF file under construction: its JSON and the data of its buffer 0.
pub(crate) struct Fixture {
    pub(crate) json: Value,
    pub(crate) bin: Vec<u8>,
}

/// Component types of accessors.
pub(crate) const I8: u32 = 5120;
pub(crate) const U8: u32 = 5121;
pub(crate) const I16: u32 = 5122;
pub(crate) const U16: u32 = 5123;
pub(crate) const U32: u32 = 5125;
pub(crate) const F32: u32 = 5126;

/// A right triangle in the plane z = 0 whose legs along x and y have different lengths, so that axes cannot be
/// confused.
pub(crate) const TRIANGLE: [f32; 9] = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 2.0, 0.0];

impl Fixture {
    pub(crate) fn new() -> Self {
        Self { json: json!({"asset": {"version": "2.0"}}), bin: Vec::new() }
    }

    /// A file that shows one mesh primitive with these JSON members, among them `attributes`.
    pub(crate) fn with_primitive(mut self, primitive: Value) -> Self {
        self.json["meshes"] = json!([{"primitives": [primitive]}]);
        self.json["nodes"] = json!([{"mesh": 0}]);
        self
    }

    /// A file that shows [`TRIANGLE`].
    pub(crate) fn triangle() -> Self {
        let mut fixture = Self::new();
        let positions = fixture.floats("VEC3", &TRIANGLE);
        fixture.with_primitive(json!({"attributes": {"POSITION": positions}}))
    }

    /// Appends an object to a top-level array; returns its index.
    pub(crate) fn push(&mut self, array: &str, object: Value) -> usize {
        if self.json[array].is_null() {
            self.json[array] = json!([]);
        }
        let array = self.json[array].as_array_mut().unwrap();
        array.push(object);
        array.len() - 1
    }

    /// Appends bytes to the buffer, as a view of their own; returns its index.
    pub(crate) fn view(&mut self, bytes: &[u8]) -> usize {
        self.bin.resize(self.bin.len().next_multiple_of(4), 0);
        let offset = self.bin.len();
        self.bin.extend(bytes);
        self.push("bufferViews", json!({"buffer": 0, "byteOffset": offset, "byteLength": bytes.len()}))
    }

    /// Appends an accessor of bytes in a view of their own; returns its index.
    pub(crate) fn accessor(&mut self, component: u32, shape: &str, count: usize, bytes: &[u8]) -> usize {
        let view = self.view(bytes);
        self.push("accessors", json!({"bufferView": view, "componentType": component, "type": shape, "count": count}))
    }

    /// Appends an accessor of f32; returns its index.
    pub(crate) fn floats(&mut self, shape: &str, values: &[f32]) -> usize {
        let components = match shape {
            "SCALAR" => 1,
            "VEC2" => 2,
            "VEC3" => 3,
            "VEC4" => 4,
            "MAT4" => 16,
            _ => panic!("{shape}"),
        };
        self.accessor(F32, shape, values.len() / components, bytemuck::cast_slice(values))
    }

    /// The file as GLB.
    pub(crate) fn glb(&self) -> Vec<u8> {
        let mut json = self.json.clone();
        if json["buffers"].is_null() && !self.bin.is_empty() {
            json["buffers"] = json!([{"byteLength": self.bin.len()}]);
        }
        let mut text = json.to_string().into_bytes();
        text.resize(text.len().next_multiple_of(4), b' ');
        let mut bin = self.bin.clone();
        bin.resize(bin.len().next_multiple_of(4), 0);

        let mut bytes = b"glTF\x02\0\0\0".to_vec();
        bytes.extend((28 + text.len() as u32 + bin.len() as u32).to_le_bytes());
        for (kind, data) in [(b"JSON", &text), (b"BIN\0", &bin)] {
            bytes.extend((data.len() as u32).to_le_bytes());
            bytes.extend(kind);
            bytes.extend(data);
        }
        bytes
    }

    /// Imports the file into a scene of its own.
    pub(crate) fn try_import(&self) -> Result<Imported> {
        self.try_import_with(&ImportOptions::default())
    }

    pub(crate) fn try_import_with(&self, options: &ImportOptions) -> Result<Imported> {
        let mut scene = Scene::new();
        let root = scene.root();
        let report = gltf::import_from_slice(&self.glb(), Path::new("fixture.glb"), options, &mut scene, root)?;
        scene.validate().unwrap();
        Ok(Imported { scene, report })
    }

    pub(crate) fn import(&self) -> Imported {
        self.try_import().unwrap()
    }

    /// The error that the import fails with.
    pub(crate) fn error(&self) -> Error {
        match self.try_import() {
            Ok(_) => panic!("imports, but should not: {}", self.json),
            Err(error @ (Error::Gltf { .. } | Error::UnsupportedExtension { .. })) => error,
            Err(error) => panic!("unexpected kind of error: {error:?}"),
        }
    }

    /// The JSON pointer and the cause of the error that the import fails with.
    pub(crate) fn fault(&self) -> (String, GltfFault) {
        match self.error() {
            Error::Gltf { pointer, cause, .. } => (pointer, cause),
            error => panic!("unexpected kind of error: {error:?}"),
        }
    }

    /// The JSON pointer and the cause of the error that a strict import fails with.
    pub(crate) fn strict_fault(&self) -> (String, GltfFault) {
        match self.try_import_with(&ImportOptions::default().with_strict(true)) {
            Err(Error::Gltf { pointer, cause, .. }) => (pointer, cause),
            Err(error) => panic!("unexpected kind of error: {error:?}"),
            Ok(_) => panic!("a strict import accepts {}", self.json),
        }
    }

    /// Whether the import fails because it would need too much memory.
    pub(crate) fn exceeds_budget(&self) -> bool {
        matches!(self.fault().1, GltfFault::Budget { .. })
    }
}

/// A scene into which one file was imported.
pub(crate) struct Imported {
    pub(crate) scene: Scene,
    pub(crate) report: ImportReport,
}

impl Imported {
    /// The node of the file's node with this index.
    pub(crate) fn node(&self, index: usize) -> NodeKey {
        self.report.nodes[index].unwrap()
    }

    /// The children of the file's node with this index that have geometry.
    pub(crate) fn geometry_nodes(&self, index: usize) -> Vec<NodeKey> {
        let children = self.scene.children(self.node(index)).unwrap();
        children.filter(|&child| matches!(self.scene.node_core(child), Ok(Core::Geometry { .. }))).collect()
    }

    /// The geometry and material of a node.
    pub(crate) fn drawn(&self, node: NodeKey) -> (&Geometry, &Material) {
        let Core::Geometry { geometry, material } = *self.scene.node_core(node).unwrap() else { panic!("no geometry") };
        (self.scene.geometry(geometry).unwrap(), self.scene.material(material).unwrap())
    }

    /// The geometry of the file's first node's first primitive.
    pub(crate) fn geometry(&self) -> &Geometry {
        self.drawn(self.geometry_nodes(0)[0]).0
    }

    /// The material of the file's first node's first primitive.
    pub(crate) fn material(&self) -> &Material {
        self.drawn(self.geometry_nodes(0)[0]).1
    }

    /// The import's warnings, a line each.
    pub(crate) fn notes(&self) -> Vec<String> {
        self.report.warnings.iter().map(ToString::to_string).collect()
    }
}
