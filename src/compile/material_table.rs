//! Materials and the textures they refer to, kept while some visible node uses them.

use std::ops::Range;

use slotmap::SecondaryMap;

use super::buffer_allocator::BufferAllocator;
use super::instance_table::Users;
use super::pack;
use crate::Result;
use crate::device::DeviceArrays;
use crate::device::Needs;
use crate::device::layout::{InstanceFlags, NONE, TextureFlags};
use crate::graph::{Material, MaterialKey, Scene, Texture, TextureKey, TextureRef};

/// The materials, texture references and texels on the device.
#[derive(Debug)]
pub(super) struct MaterialTable {
    materials: SecondaryMap<MaterialKey, MaterialEntry>,
    textures: SecondaryMap<TextureKey, TextureEntry>,
    records: BufferAllocator,
    infos: BufferAllocator,
    texels: BufferAllocator,
}

/// Where one material lies in the device arrays.
#[derive(Debug)]
pub(super) struct MaterialEntry {
    source: Material,
    /// In `materials`.
    pub(super) record: Range<u32>,
    infos: Range<u32>,
    /// What traversal must know of it.
    pub(super) instance_flags: InstanceFlags,
    /// What it needs of the kernel.
    pub(super) needs: Needs,
}

#[derive(Debug)]
struct TextureEntry {
    source: Texture,
    texels: Range<u32>,
}

impl MaterialTable {
    pub(super) fn new() -> Self {
        Self {
            materials: SecondaryMap::new(),
            textures: SecondaryMap::new(),
            records: BufferAllocator::new("the materials array"),
            infos: BufferAllocator::new("the texture references array"),
            texels: BufferAllocator::new("the texels array"),
        }
    }

    /// Makes the table hold exactly the materials in `used` and their textures, as they are now. Returns those that were
    /// stored, which may lie elsewhere than before.
    pub(super) fn update(
        &mut self,
        scene: &Scene,
        used: &Users<MaterialKey>,
        arrays: &mut DeviceArrays,
    ) -> Result<Vec<MaterialKey>> {
        let mut used_textures = SecondaryMap::new();
        for key in used.keys() {
            let slots = texture_slots(scene.material(key)?);
            used_textures.extend(slots.into_iter().flatten().map(|(r, _)| (r.texture, ())));
        }

        // 1. Release what is gone or has changed; a material holds on to where its textures lie.
        let is_current =
            |key, e: &TextureEntry| used_textures.contains_key(key) && scene.texture(key).is_ok_and(|t| *t == e.source);
        let stale: Vec<_> = self.textures.iter().filter(|&(k, e)| !is_current(k, e)).map(|(k, _)| k).collect();
        let reads_stale =
            |m: &Material| texture_slots(m).into_iter().flatten().any(|(r, _)| stale.contains(&r.texture));
        let is_current = |key, e: &MaterialEntry| {
            used.has(key) && scene.material(key).is_ok_and(|m| *m == e.source) && !reads_stale(&e.source)
        };
        let gone: Vec<_> = self.materials.iter().filter(|&(k, e)| !is_current(k, e)).map(|(k, _)| k).collect();
        for entry in gone.into_iter().filter_map(|key| self.materials.remove(key)) {
            self.records.release(&mut arrays.materials, entry.record);
            self.infos.release(&mut arrays.texture_infos, entry.infos);
        }
        for entry in stale.into_iter().filter_map(|key| self.textures.remove(key)) {
            self.texels.release(&mut arrays.texels, entry.texels);
        }

        // 2. Store what is missing.
        for key in used_textures.keys() {
            if !self.textures.contains_key(key) {
                let source = scene.texture(key)?.clone();
                let texels: Vec<u32> = source.texels.iter().map(|&texel| u32::from_le_bytes(texel)).collect();
                let texels = self.texels.store(&mut arrays.texels, &texels)?;
                self.textures.insert(key, TextureEntry { source, texels });
            }
        }
        let missing: Vec<MaterialKey> = used.keys().filter(|&key| !self.materials.contains_key(key)).collect();
        for &key in &missing {
            let entry = self.store(scene, scene.material(key)?, arrays)?;
            self.materials.insert(key, entry);
        }
        Ok(missing)
    }

    /// The entry of a material that was in `used` at the last update.
    pub(super) fn get(&self, key: MaterialKey) -> Option<&MaterialEntry> {
        self.materials.get(key)
    }

    /// What all of them together need.
    pub(super) fn needs(&self) -> Needs {
        self.materials.values().fold(Needs::empty(), |needs, entry| needs | entry.needs)
    }

    /// How many materials there are.
    pub(super) fn len(&self) -> usize {
        self.materials.len()
    }

    /// How many textures there are.
    pub(super) fn texture_count(&self) -> usize {
        self.textures.len()
    }

    fn store(&mut self, scene: &Scene, material: &Material, arrays: &mut DeviceArrays) -> Result<MaterialEntry> {
        let slots = texture_slots(material);
        let mut infos = Vec::new();
        let mut positions = [None; 5];
        for (slot, position) in slots.iter().zip(&mut positions) {
            let Some((reference, color_space)) = slot else { continue };
            let texture = scene.texture(reference.texture)?;
            let first_texel = self.textures[reference.texture].texels.start;
            *position = Some(infos.len() as u32);
            infos.push(pack::texture_record(reference, texture, first_texel, *color_space));
        }
        let infos = self.infos.store(&mut arrays.texture_infos, &infos)?;
        let textures = positions.map(|position| position.map_or(NONE, |p| infos.start + p));
        let record = self.records.store(&mut arrays.materials, &[pack::material_record(material, textures)])?;
        Ok(MaterialEntry {
            source: material.clone(),
            record,
            infos,
            instance_flags: pack::instance_flags(material),
            needs: pack::needs(material),
        })
    }
}

/// The textures of a material in the order of [`pack::material_record`], each with the colour space its texels are in.
fn texture_slots(material: &Material) -> [Option<(TextureRef, TextureFlags)>; 5] {
    let (srgb, linear) = (TextureFlags::SRGB, TextureFlags::empty());
    [
        material.base_color_texture.map(|r| (r, srgb)),
        material.metallic_roughness_texture.map(|r| (r, linear)),
        material.emissive_texture.map(|r| (r, srgb)),
        material.transmission_texture.map(|r| (r, linear)),
        material.normal_texture.map(|r| (r, linear)),
    ]
}
