//! Import warnings, and the detection of those that can be found from the JSON alone.

use std::collections::{BTreeSet, HashMap};

use ::gltf::json;
use json::texture::{MagFilter, MinFilter};
use json::validation::Checked::Valid;
use serde_json::Value;

use super::document::EXTENSIONS;
use super::report::{ImportWarning, UnlistedWarnings};
use super::{Budget, Document, WarningKind};
use crate::Result;

/// The most warnings of one kind and feature that are listed. Further ones are counted.
const MAX_LISTED_OF_FEATURE: usize = 1000;
/// The most warnings that are listed.
const MAX_LISTED: usize = 10_000;
/// What a warning takes besides its texts: itself, its place in a list and in a map that grow, and their allocations.
const BYTES_PER_WARNING: usize = 512;

/// The warnings of an import, in the order in which they were found.
#[derive(Default)]
pub(super) struct Warnings {
    pub(super) list: Vec<ImportWarning>,
    /// For each kind and feature, how many warnings are listed and how many are not.
    counts: HashMap<(WarningKind, String), (usize, usize)>,
    /// The number of listed warnings that the budget was charged for.
    charged: usize,
}

impl Warnings {
    /// The warnings about a document that need no binary data.
    pub(super) fn of(document: &Document) -> Self {
        use WarningKind::Feature;

        let mut warnings = Self::default();
        warnings.add_extensions(document);
        // Warn of what would be animated: animations, skins, morph targets.
        for (i, _) in elements(&document.value, "animations") {
            let fallback = "not supported: the transforms of the nodes are used";
            warnings.add(document, Feature, "animation", format!("/animations/{i}"), fallback);
        }
        for i in 0..document.skins.len() {
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
        warnings
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
        let (feature, pointer) = (feature.into(), pointer.into());
        if !self.count(kind, &feature) {
            return;
        }
        // The name is that of the object in a top-level array, also where the pointer leads to a part of it.
        let owner = pointer.match_indices('/').nth(2).map_or(&pointer[..], |(end, _)| &pointer[..end]);
        let name = document.value.pointer(owner).and_then(|o| o.get("name")).and_then(Value::as_str);
        let name = shorten(name.unwrap_or_default());
        self.list.push(ImportWarning { kind, feature, pointer, name, fallback: fallback.into() });
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

    fn add_extension(&mut self, document: &Document, name: &str, pointer: &str) {
        self.add(document, WarningKind::Extension, shorten(name), pointer, fallback_text(name));
    }

    /// Adds every extension in the file that is not supported, once for each object of the file's top-level arrays.
    fn add_extensions(&mut self, document: &Document) {
        let members = document.value.as_object().into_iter().flatten();
        for (key, member) in members {
            match (&**key, member) {
                // The extensions of the file as a whole.
                ("extensions", Value::Object(extensions)) => {
                    let names = extensions.keys().map(|name| &**name).filter(|name| !EXTENSIONS.contains(name));
                    names.for_each(|name| self.add_extension(document, name, "/"));
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
        names.into_iter().for_each(|name| self.add_extension(document, name, pointer));
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

/// What is done instead of an extension that is not supported, in words.
fn fallback_text(extension: &str) -> &'static str {
    match extension {
        "EXT_meshopt_compression" | "KHR_draco_mesh_compression" => "not supported: the uncompressed data is read",
        "EXT_texture_webp" | "KHR_texture_basisu" => "not supported: the PNG or JPEG fallback is shown",
        "KHR_materials_anisotropy" => "not supported: highlights are round",
        "KHR_materials_clearcoat" => "not supported: shown without its clear coat",
        "KHR_materials_dispersion" => "not supported: all colours are refracted alike",
        "KHR_materials_iridescence" => "not supported: shown without its thin film",
        "KHR_materials_pbrSpecularGlossiness" => "not supported: the metallic-roughness values are used",
        "KHR_materials_sheen" => "not supported: shown without its sheen",
        "KHR_materials_specular" => "not supported: reflects as its index of refraction says",
        "KHR_materials_variants" => "not supported: the default material is shown",
        _ => "not supported: ignored",
    }
}
