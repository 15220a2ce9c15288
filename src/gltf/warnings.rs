//! Collects what is not honoured; finds that part of it that shows in the JSON alone.

use std::collections::BTreeSet;

use ::gltf::json;
use json::texture::{MagFilter, MinFilter};
use json::validation::Checked::Valid;
use serde_json::Value;

use super::Document;
use super::document::EXTENSIONS;
use super::report::ImportWarning;

/// Everything that the import does not honour, in the order it was met.
#[derive(Default)]
pub(super) struct Warnings {
    pub(super) list: Vec<ImportWarning>,
}

impl Warnings {
    /// The extensions and features in a document that no data has to be read for.
    pub(super) fn of(document: &Document) -> Self {
        let mut notes = Self::default();
        notes.add_extensions(document);
        for (i, _) in elements(&document.value, "animations") {
            notes.add(document, "animation", format!("/animations/{i}"), "not yet played: shown as the nodes stand");
        }
        for i in 0..document.skins.len() {
            notes.add(document, "skin", format!("/skins/{i}"), "not yet played: applied once, as the joints stand");
        }
        for (i, mesh) in document.meshes.iter().enumerate() {
            if mesh.primitives.iter().any(|p| p.targets.as_ref().is_some_and(|t| !t.is_empty())) {
                let effect = "not yet played: applied once, by the default weights";
                notes.add(document, "morph targets", format!("/meshes/{i}"), effect);
            }
        }
        for (i, material) in document.materials.iter().enumerate() {
            if material.occlusion_texture.is_some() {
                let effect = "not used: what light reaches is traced";
                notes.add(document, "occlusion texture", format!("/materials/{i}"), effect);
            }
        }
        notes.add_min_filters(document);
        notes
    }

    /// Adds a note about the object at a JSON pointer.
    pub(super) fn add(
        &mut self,
        document: &Document,
        feature: impl Into<String>,
        object: impl Into<String>,
        effect: impl Into<String>,
    ) {
        let object = object.into();
        // The object itself, not the part of it that the pointer may lead to.
        let owner = object.match_indices('/').nth(2).map_or(&object[..], |(end, _)| &object[..end]);
        let name = document.value.pointer(owner).and_then(|o| o.get("name")).and_then(Value::as_str);
        let name = shorten(name.unwrap_or_default());
        self.list.push(ImportWarning { feature: feature.into(), pointer: object, name, fallback: effect.into() });
    }

    /// Every extension in the file but for those that are honoured, once for each object of the file's top-level arrays.
    fn add_extensions(&mut self, document: &Document) {
        let members = document.value.as_object().into_iter().flatten();
        for (key, member) in members {
            match (&**key, member) {
                ("extensions", Value::Object(extensions)) => {
                    let names = extensions.keys().map(|name| &**name).filter(|name| !EXTENSIONS.contains(name));
                    names.for_each(|name| self.add(document, shorten(name), "/", fallback_text(name)));
                }
                (key, Value::Array(elements)) => {
                    for (i, element) in elements.iter().enumerate() {
                        let pointer = format!("/{}/{i}", shorten(key));
                        self.add_extensions_of(document, element, &pointer);
                    }
                }
                (key, member) => self.add_extensions_of(document, member, &format!("/{}", shorten(key))),
            }
        }
    }

    /// The extensions of an object and of everything in it.
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
        names.into_iter().for_each(|name| self.add(document, shorten(name), pointer, fallback_text(name)));
    }

    /// One note for all samplers: a ray reads the full image by one filter, near or far.
    fn add_min_filters(&mut self, document: &Document) {
        let differs = |sampler: &json::texture::Sampler| match sampler.min_filter {
            Some(Valid(MinFilter::Nearest)) => sampler.mag_filter != Some(Valid(MagFilter::Nearest)),
            Some(Valid(MinFilter::Linear)) => sampler.mag_filter == Some(Valid(MagFilter::Nearest)),
            Some(_) => true,
            None => false,
        };
        let mut differing = document.samplers.iter().enumerate().filter(|(_, sampler)| differs(sampler));
        if let Some((first, _)) = differing.next() {
            let effect = match differing.count() {
                0 => "not used: the full image is read by magFilter at any distance".to_owned(),
                more => {
                    format!("not used, here and in {more} more: the full image is read by magFilter at any distance")
                }
            };
            self.add(document, "minFilter and mipmaps", format!("/samplers/{first}"), effect);
        }
    }
}

fn elements<'a>(root: &'a Value, key: &str) -> impl Iterator<Item = (usize, &'a Value)> {
    root.get(key).and_then(Value::as_array).into_iter().flatten().enumerate()
}

/// At most 80 characters of a name from the file: one long name on an object with many notes must not multiply.
fn shorten(name: &str) -> String {
    match name.char_indices().nth(80) {
        Some((end, _)) => format!("{}...", &name[..end]),
        None => name.to_owned(),
    }
}

/// What an extension's absence means, in words.
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
        "KHR_materials_volume" => "not supported: light passes through it without loss",
        _ => "not supported: ignored",
    }
}
