//! Import warnings, and the detection of those that can be found from the JSON alone. Faults that have one reading are
//! forgiven here, or not: [`Warnings::forgive`] is the only place that knows of strict imports.

use std::collections::{BTreeSet, HashMap};

use ::gltf::json;
use json::texture::{MagFilter, MinFilter};
use json::validation::Checked::Valid;
use serde_json::Value;

use super::document::EXTENSIONS;
use super::report::{ImportWarning, UnlistedWarnings};
use super::{Budget, Document, GltfFault, WarningKind};
use crate::{Error, Result};

/// The most warnings of one kind and feature that are listed. Further ones are counted.
const MAX_LISTED_OF_FEATURE: usize = 1000;
/// The most warnings that are listed.
const MAX_LISTED: usize = 10_000;
/// What a warning takes besides its texts: itself, its place in a list and in a map that grow, and their allocations.
const BYTES_PER_WARNING: usize = 512;
/// What a [`Forgivable`] takes: itself, its texts twice (in the error, in the fallback), the error as text by which it
/// is told of once, and their allocations; without the path of the file, which is in the error and in its text.
pub(super) const BYTES_PER_FORGIVABLE: usize = 4 * size_of::<Forgivable>() + 1024;

/// The warnings of an import, in the order in which they were found.
pub(super) struct Warnings {
    pub(super) list: Vec<ImportWarning>,
    /// For each kind and feature, how many warnings are listed and how many are not.
    counts: HashMap<(WarningKind, String), (usize, usize)>,
    /// The number of listed warnings that the budget was charged for.
    charged: usize,
    /// Whether faults are refused that have one reading.
    strict: bool,
}

/// A fault that has one reading, found where no warnings can be added, to be forgiven later.
pub(super) struct Forgivable {
    /// The error of a strict import, about the object that is at fault.
    pub(super) error: Error,
    /// The value or data at fault.
    pub(super) feature: &'static str,
    /// What was done, in words.
    pub(super) fallback: String,
}

impl Warnings {
    /// No warnings yet. If `strict`, nothing is forgiven.
    pub(super) fn new(strict: bool) -> Self {
        Self { list: Vec::new(), counts: HashMap::new(), charged: 0, strict }
    }

    /// Forgives a fault that has one reading, or whose object can be left out alone: adds a warning that says what was
    /// done. A strict import gets the error, and so does every import if it is not about a part of the file: the budget
    /// is exhausted, or the import was cancelled. `root` is the document, in which the object's name is looked up.
    pub(super) fn forgive(
        &mut self,
        root: &Value,
        feature: impl Into<String>,
        fallback: impl Into<String>,
        error: Error,
    ) -> Result<()> {
        match error {
            Error::Gltf { cause: GltfFault::Budget { .. }, .. } => Err(error),
            Error::Gltf { pointer, .. } if !self.strict => {
                self.push(root, WarningKind::Fault, feature.into(), pointer, fallback.into());
                Ok(())
            }
            error => Err(error),
        }
    }

    /// Leaves out what has failed with this error: `part` is the part of the file that is lost, in words. A strict
    /// import gets the error.
    pub(super) fn leave_out(&mut self, root: &Value, part: impl Into<String>, error: Error) -> Result<()> {
        self.forgive(root, part, format!("{}: left out", cause_of(&error)), error)
    }

    /// Adds the warnings about a document that need no binary data.
    pub(super) fn inspect(&mut self, document: &Document) {
        use WarningKind::Feature;

        let warnings = self;
        warnings.add_extensions(document);
        // Warn of what would be animated: animations, skins, morph targets.
        for (i, _) in elements(&document.value, "animations") {
            let fallback = "not supported: the transforms of the nodes are used";
            warnings.add(document, Feature, "animation", format!("/animations/{i}"), fallback);
        }
        // A skin is applied where a node with a mesh has it.
        let skinned = document.nodes.iter().filter(|node| node.mesh.is_some());
        let skins: BTreeSet<usize> = skinned.filter_map(|node| Some(node.skin?.value())).collect();
        for i in skins {
            let fallback = "cannot be animated: applied once, in the rest pose of its joints";
            warnings.add(document, Feature, "skin", format!("/skins/{i}"), fallback);
        }
        for (i, mesh) in document.meshes.iter().enumerate() {
            if mesh.primitives.iter().any(|p| p.targets.as_ref().is_some_and(|t| !t.is_empty())) {
                let fallback = "cannot be animated: applied once, by the default weights";
                warnings.add(document, Feature, "morph targets", format!("/meshes/{i}"), fallback);
            }
        }
        // Warn of what has no effect: occlusion textures and minification filters.
        for (i, material) in document.materials.iter().enumerate() {
            if material.occlusion_texture.is_some() {
                let fallback = "not used: occlusion is traced";
                warnings.add(document, Feature, "occlusion texture", format!("/materials/{i}"), fallback);
            }
        }
        warnings.add_min_filters(document);
    }

    /// Adds a warning about the object at a JSON pointer.
    pub(super) fn add(
        &mut self,
        document: &Document,
        kind: WarningKind,
        feature: impl Into<String>,
        pointer: impl Into<String>,
        fallback: impl Into<String>,
    ) {
        self.push(&document.value, kind, feature.into(), pointer.into(), fallback.into());
    }

    /// Counts a warning; returns whether it is to be listed. A file of a few MB can give cause for millions.
    fn count(&mut self, kind: WarningKind, feature: &str) -> bool {
        let is_full = self.list.len() >= MAX_LISTED;
        let mut key = (kind, feature.to_owned());
        // The features themselves could be millions.
        if is_full && !self.counts.contains_key(&key) {
            key.1.clear();
        }
        let (listed, unlisted) = self.counts.entry(key).or_default();
        let lists = !is_full && *listed < MAX_LISTED_OF_FEATURE;
        *(if lists { listed } else { unlisted }) += 1;
        lists
    }

    /// How many warnings were not listed, sorted by feature.
    pub(super) fn unlisted(&self) -> Vec<UnlistedWarnings> {
        let unlisted = self.counts.iter().filter(|(_, (_, unlisted))| *unlisted > 0);
        let mut unlisted: Vec<_> = unlisted
            .map(|((kind, feature), &(_, count))| UnlistedWarnings { kind: *kind, feature: feature.clone(), count })
            .collect();
        unlisted.sort_by(|a, b| (&a.feature, a.kind as u8).cmp(&(&b.feature, b.kind as u8)));
        unlisted
    }

    /// Charges for the warnings that were listed since the last call.
    pub(super) fn charge(&mut self, document: &Document, budget: &mut Budget) -> Result<()> {
        let new = &self.list[self.charged..];
        let texts = |w: &ImportWarning| 2 * w.feature.len() + w.pointer.len() + w.name.len() + w.fallback.len();
        let bytes = new.iter().map(texts).sum::<usize>() + BYTES_PER_WARNING * new.len();
        self.charged = self.list.len();
        budget.charge(1, bytes, document, String::new)
    }

    fn push(&mut self, root: &Value, kind: WarningKind, feature: String, pointer: String, fallback: String) {
        if !self.count(kind, &feature) {
            return;
        }
        // The name is that of the object in a top-level array, also where the pointer leads to a part of it.
        let owner = pointer.match_indices('/').nth(2).map_or(&pointer[..], |(end, _)| &pointer[..end]);
        let name = root.pointer(owner).and_then(|o| o.get("name")).and_then(Value::as_str);
        let name = shorten(name.unwrap_or_default());
        self.list.push(ImportWarning { kind, feature, pointer, name, fallback });
    }

    /// Adds an extension of an object, which is Null for the file as a whole.
    fn add_extension(&mut self, document: &Document, name: &str, pointer: &str, object: &Value) {
        let fallback = fallback_text(document, name, object);
        self.add(document, WarningKind::Extension, shorten(name), pointer, fallback);
    }

    /// Adds every extension in the file that is not supported, once for each object of the file's top-level arrays.
    fn add_extensions(&mut self, document: &Document) {
        let members = document.value.as_object().into_iter().flatten();
        for (key, member) in members {
            match (&**key, member) {
                // The extensions of the file as a whole.
                ("extensions", Value::Object(extensions)) => {
                    let names = extensions.keys().map(|name| &**name).filter(|name| !EXTENSIONS.contains(name));
                    names.for_each(|name| self.add_extension(document, name, "/", &Value::Null));
                }
                // Each object of a top-level array is searched by itself, so that warnings can name it.
                (key, Value::Array(elements)) => {
                    for (i, element) in elements.iter().enumerate() {
                        let pointer = format!("/{}/{i}", shorten(key));
                        self.add_extensions_of(document, element, &pointer);
                    }
                }
                // Other members, such as "asset", are searched as a whole.
                (key, member) => self.add_extensions_of(document, member, &format!("/{}", shorten(key))),
            }
        }
    }

    /// Adds the extensions of an object and of everything in it, each once.
    fn add_extensions_of(&mut self, document: &Document, object: &Value, pointer: &str) {
        let mut names = BTreeSet::new();
        let mut pending = vec![object];
        while let Some(value) = pending.pop() {
            if let Some(extensions) = value.get("extensions").and_then(Value::as_object) {
                names.extend(extensions.keys().map(|name| &**name).filter(|name| !EXTENSIONS.contains(name)));
            }
            match value {
                Value::Array(elements) => pending.extend(elements),
                Value::Object(members) => pending.extend(members.values()),
                _ => {}
            }
        }
        names.into_iter().for_each(|name| self.add_extension(document, name, pointer, object));
    }

    /// Adds one warning for all samplers. There are no mipmaps: minification filters are ignored.
    fn add_min_filters(&mut self, document: &Document) {
        // Find the samplers whose minification filter needs mipmaps, or is not the filter that is used.
        let differs = |sampler: &json::texture::Sampler| match sampler.min_filter {
            Some(Valid(MinFilter::Nearest)) => sampler.mag_filter != Some(Valid(MagFilter::Nearest)),
            Some(Valid(MinFilter::Linear)) => sampler.mag_filter == Some(Valid(MagFilter::Nearest)),
            Some(_) => true,
            None => false,
        };
        let mut differing = document.samplers.iter().enumerate().filter(|(_, sampler)| differs(sampler));
        // Warn once: of the first of them, with the number of the others.
        if let Some((first, _)) = differing.next() {
            let fallback = match differing.count() {
                0 => "not used: the full image is read by magFilter at any distance".to_owned(),
                more => {
                    format!("not used, here and in {more} more: the full image is read by magFilter at any distance")
                }
            };
            self.add(document, WarningKind::Feature, "minFilter and mipmaps", format!("/samplers/{first}"), fallback);
        }
    }
}

/// Whether the data that an extension compresses is in the file without compression too: for a mesh, that all its
/// positions are in buffer views; for a buffer or a buffer view, that the buffer has data.
fn has_uncompressed_data(document: &Document, object: &Value) -> bool {
    let buffer_has_data = |index: usize| index == 0 || document.buffers.get(index).is_some_and(|b| b.uri.is_some());
    if let Some(primitives) = object.get("primitives").and_then(Value::as_array) {
        let positions = |primitive: &Value| primitive.pointer("/attributes/POSITION").and_then(Value::as_u64);
        let has_view = |index: u64| document.accessors.get(index as usize).is_some_and(|a| a.buffer_view.is_some());
        return primitives.iter().filter_map(positions).all(has_view);
    }
    match object.get("buffer").and_then(Value::as_u64) {
        Some(buffer) => buffer_has_data(buffer as usize),
        None => object.get("uri").is_some(),
    }
}

/// The cause of an error about the file, without path and pointer.
pub(super) fn cause_of(error: &Error) -> String {
    match error {
        Error::Gltf { cause, .. } => cause.to_string(),
        error => error.to_string(),
    }
}

fn elements<'a>(root: &'a Value, key: &str) -> impl Iterator<Item = (usize, &'a Value)> {
    root.get(key).and_then(Value::as_array).into_iter().flatten().enumerate()
}

/// At most 80 characters of a name from the file: a long name is repeated in every warning about its object.
fn shorten(name: &str) -> String {
    match name.char_indices().nth(80) {
        Some((end, _)) => format!("{}...", &name[..end]),
        None => name.to_owned(),
    }
}

/// What is done instead of an extension of this object that is not supported, in words.
fn fallback_text(document: &Document, extension: &str, object: &Value) -> &'static str {
    match extension {
        "EXT_meshopt_compression" | "KHR_draco_mesh_compression" if has_uncompressed_data(document, object) => {
            "not supported: the uncompressed data is read"
        }
        "EXT_meshopt_compression" | "KHR_draco_mesh_compression" => {
            "not supported, and the file has no uncompressed data for it: not shown"
        }
        "EXT_texture_webp" | "KHR_texture_basisu" if object.get("source").is_some() => {
            "not supported: the PNG or JPEG fallback is shown"
        }
        "EXT_texture_webp" | "KHR_texture_basisu" => {
            "not supported, and the file has no fallback: a checkerboard is shown"
        }
        "KHR_materials_anisotropy" => "not supported: highlights are round",
        "KHR_materials_clearcoat" => "not supported: shown without its clear coat",
        "KHR_materials_dispersion" => "not supported: all colours are refracted alike",
        "KHR_materials_iridescence" => "not supported: shown without its thin film",
        "KHR_materials_pbrSpecularGlossiness" if object.get("pbrMetallicRoughness").is_some() => {
            "not supported: the metallic-roughness values are used"
        }
        "KHR_materials_pbrSpecularGlossiness" => {
            "not supported, and there are no metallic-roughness values: shown as white metal, the default"
        }
        "KHR_materials_sheen" => "not supported: shown without its sheen",
        "KHR_materials_specular" => "not supported: reflects as its index of refraction says",
        "KHR_materials_variants" => "not supported: the default material is shown",
        _ => "not supported: ignored",
    }
}
