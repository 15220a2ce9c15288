//! The material records, texture references and texels of all materials in use.

use std::ops::Range;

use slotmap::SecondaryMap;

use super::buffer_allocator::BufferAllocator;
use super::pack;
use super::users::SlotsByKey;
use crate::Result;
use crate::device::layout::{InstanceFlags, NONE, TextureFlags};
use crate::device::{DeviceArrays, Needs};
use crate::graph::{Material, MaterialKey, Scene, Texture, TextureKey, TextureRef, WallKind};

/// The materials, texture references and texels on the device.
#[derive(Debug)]
pub(super) struct MaterialTable {
    materials: SecondaryMap<MaterialKey, MaterialEntry>,
    textures: SecondaryMap<TextureKey, TextureEntry>,
    records: BufferAllocator,
    texture_infos: BufferAllocator,
    texels: BufferAllocator,
}

/// One material as it was stored, and where.
#[derive(Debug)]
pub(super) struct MaterialEntry {
    source: Material,
    /// The range in `materials`: one element.
    pub(super) record: Range<u32>,
    /// The range in `texture_infos`: one element for each texture reference.
    texture_infos: Range<u32>,
    /// The instance flags that follow from the material.
    pub(super) instance_flags: InstanceFlags,
    /// The kernel features that it needs.
    pub(super) needs: Needs,
}

#[derive(Debug)]
struct TextureEntry {
    source: Texture,
    /// The range in `texels`.
    texels: Range<u32>,
}

impl MaterialEntry {
    /// What a transmissive surface of the material bounds.
    pub(super) fn wall(&self) -> WallKind {
        self.source.wall
    }
}

impl MaterialTable {
    pub(super) fn new() -> Self {
        Self {
            materials: SecondaryMap::new(),
            textures: SecondaryMap::new(),
            records: BufferAllocator::new("the materials array"),
            texture_infos: BufferAllocator::new("the texture references array"),
            texels: BufferAllocator::new("the texels array"),
        }
    }

    /// Makes the table hold exactly the materials in `used` and their textures, as they are now. Returns the materials
    /// that were stored: their records may have other indices than before. O(materials and textures in use).
    pub(super) fn update(
        &mut self,
        scene: &Scene,
        used: &SlotsByKey<MaterialKey>,
        arrays: &mut DeviceArrays,
    ) -> Result<Vec<MaterialKey>> {
        // 1. Collect the textures in use.
        let mut used_textures = SecondaryMap::new();
        for key in used.keys() {
            let slots = texture_slots(scene.material(key)?);
            used_textures.extend(slots.into_iter().flatten().map(|(r, _)| (r.texture, ())));
        }

        // 2. Release materials and textures that are gone or have changed. A material refers to the texel offsets of
        //    its textures, so it is stored again when one of them changes.
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
            self.texture_infos.release(&mut arrays.texture_infos, entry.texture_infos);
        }
        for entry in stale.into_iter().filter_map(|key| self.textures.remove(key)) {
            self.texels.release(&mut arrays.texels, entry.texels);
        }

        // 3. Store the missing textures, then the missing materials.
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

    /// The kernel features that all materials together need.
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

    /// Writes a material, whose textures are stored, to the device arrays.
    fn store(&mut self, scene: &Scene, material: &Material, arrays: &mut DeviceArrays) -> Result<MaterialEntry> {
        // 1. One element for each texture reference, in the order of the slots.
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
        let texture_infos = self.texture_infos.store(&mut arrays.texture_infos, &infos)?;
        let textures = positions.map(|position| position.map_or(NONE, |p| texture_infos.start + p));
        // 2. The record, which holds their indices.
        let record = self.records.store(&mut arrays.materials, &[pack::material_record(material, textures)])?;
        Ok(MaterialEntry {
            source: material.clone(),
            record,
            texture_infos,
            instance_flags: pack::instance_flags(material),
            needs: pack::material_needs(material),
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
