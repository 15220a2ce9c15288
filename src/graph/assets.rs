//! Geometries, materials and textures: added, replaced, and freed when their last user is removed.

use std::sync::Arc;

use glam::Vec3;

use super::changes::Change;
use super::core::CoreSlot;
use super::store::Store;
use super::value_checks::{check_material, check_texture};
use super::{Core, CoreKey, Geometry, GeometryKey, Material, MaterialKey, Scene, Texture, TextureKey};
use crate::Result;
use crate::math::Bounds;

/// An asset with the number of its users: cores that refer to a geometry or a material, references in materials to a
/// texture.
#[derive(Debug)]
pub(super) struct UseCounted<T> {
    pub(super) value: T,
    pub(super) user_count: usize,
}

impl<T> UseCounted<T> {
    pub(super) fn new(value: T) -> Self {
        Self { value, user_count: 0 }
    }
}

/// A geometry with its version and local bounds.
#[derive(Debug)]
pub(super) struct StoredGeometry {
    pub(super) geometry: Geometry,
    /// Increases each time the geometry under this key is replaced.
    pub(super) version: u64,
    /// The box around its triangles; vertices that none of them uses do not count.
    pub(super) bounds: Bounds,
}

impl StoredGeometry {
    /// Computes the bounds of a geometry that was validated.
    pub(super) fn from_validated(geometry: Geometry, version: u64) -> Self {
        let bounds = geometry.bounds().into();
        Self { geometry, version, bounds }
    }
}

/// Geometries, materials, textures.
impl Scene {
    /// Adds a geometry that no core uses yet. O(vertices + triangles), to check it.
    ///
    /// # Errors
    /// [`Error::InvalidGeometry`](crate::Error::InvalidGeometry) as [`Geometry::validate`].
    pub fn add_geometry(&mut self, geometry: Geometry) -> Result<GeometryKey> {
        geometry.validate()?;
        let key = self.geometries.insert(UseCounted::new(StoredGeometry::from_validated(geometry, 0)));
        self.record(key, Change::ADDED);
        Ok(key)
    }

    /// The geometry with this key. O(1).
    ///
    /// # Errors
    /// [`Error::StaleKey`](crate::Error::StaleKey).
    pub fn geometry(&self, key: GeometryKey) -> Result<&Geometry> {
        Ok(&self.stored_geometry(key)?.geometry)
    }

    /// Version of the geometry; increases with every replacement. Data derived from one (key, version) pair stays
    /// valid.
    ///
    /// # Errors
    /// [`Error::StaleKey`](crate::Error::StaleKey).
    pub fn geometry_version(&self, key: GeometryKey) -> Result<u64> {
        Ok(self.stored_geometry(key)?.version)
    }

    /// The box around the triangles of a geometry, in its local space; empty without any. O(1).
    ///
    /// # Errors
    /// [`Error::StaleKey`](crate::Error::StaleKey).
    pub fn geometry_bounds(&self, key: GeometryKey) -> Result<Bounds> {
        Ok(self.stored_geometry(key)?.bounds)
    }

    /// All geometries, in no particular order.
    pub fn geometries(&self) -> impl Iterator<Item = (GeometryKey, &Geometry)> {
        self.geometries.iter().map(|(key, used)| (key, &used.value.geometry))
    }

    /// Replaces a geometry for all cores that use it. O(vertices + triangles), to check it; if its box changes, also
    /// O(cores).
    ///
    /// # Errors
    /// [`Error::StaleKey`](crate::Error::StaleKey); [`Error::InvalidGeometry`](crate::Error::InvalidGeometry) as
    /// [`Geometry::validate`].
    pub fn set_geometry(&mut self, key: GeometryKey, geometry: Geometry) -> Result<()> {
        if *self.geometry(key)? != geometry {
            geometry.validate()?;
            self.replace_geometry(key, geometry);
        }
        Ok(())
    }

    /// Moves the vertices of a geometry and keeps its triangles; for deforming meshes. `None` keeps the current
    /// normals. O(vertices + triangles), on all threads; if its box changes, also O(cores).
    ///
    /// The next render then refits the geometry's acceleration structure instead of rebuilding it, if that is a BVH of
    /// quality [`Low`](super::Quality::Low) or [`Medium`](super::Quality::Medium); see `docs/SCENE_GRAPH.md`, "What
    /// deforms". [`set_geometry`](Self::set_geometry) with equal `indices` does the same, but has to compare them.
    ///
    /// ```
    /// use glam::Vec3;
    /// use ropewalk::{Geometry, Scene};
    ///
    /// let mut scene = Scene::new();
    /// let geometry = scene.add_geometry(Geometry::new([Vec3::ZERO, Vec3::X, Vec3::Y], [[0, 1, 2]]))?;
    /// scene.set_positions(geometry, [Vec3::ZERO, Vec3::X, Vec3::Y * 2.0], None)?;
    /// assert_eq!(scene.geometry_bounds(geometry)?.max.y, 2.0);
    /// # Ok::<(), ropewalk::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::StaleKey`](crate::Error::StaleKey); [`Error::InvalidGeometry`](crate::Error::InvalidGeometry) if the
    /// number of positions or normals is not that of the geometry's vertices, or one is not finite.
    pub fn set_positions(
        &mut self,
        key: GeometryKey,
        positions: impl Into<Arc<[Vec3]>>,
        normals: Option<Arc<[Vec3]>>,
    ) -> Result<()> {
        // Validate the new streams before anything changes.
        let old = self.geometry(key)?;
        let new = old.deformed(positions.into(), normals)?;
        if old.positions != new.positions || old.normals != new.normals {
            self.replace_geometry(key, new);
        }
        Ok(())
    }

    /// Replaces a geometry by a validated one.
    pub(super) fn replace_geometry(&mut self, key: GeometryKey, geometry: Geometry) {
        // Compute the new bounds, and note whether they differ.
        let old = &self.geometries[key].value;
        let new = StoredGeometry::from_validated(geometry, old.version + 1);
        let bounds_changed = old.bounds != new.bounds;
        // Save the old state for undo, then replace it.
        self.save_prior_state(key);
        self.geometries[key].value = new;
        // Only a changed box concerns the hierarchy.
        if bounds_changed {
            self.users_bounds_changed(key);
        }
        self.record(key, Change::DATA);
    }

    /// Adds a material that no core uses yet. O(1).
    ///
    /// # Errors
    /// [`Error::StaleKey`](crate::Error::StaleKey) for a texture; [`Error::OutOfRange`](crate::Error::OutOfRange) for
    /// a number outside the range that [`Material`] states.
    pub fn add_material(&mut self, material: Material) -> Result<MaterialKey> {
        self.check_material(&material)?;
        self.acquire_textures(&material);
        let key = self.materials.insert(UseCounted::new(material));
        self.record(key, Change::ADDED);
        Ok(key)
    }

    /// The material with this key. O(1).
    ///
    /// # Errors
    /// [`Error::StaleKey`](crate::Error::StaleKey).
    pub fn material(&self, key: MaterialKey) -> Result<&Material> {
        Ok(&self.materials.require(key)?.value)
    }

    /// All materials, in no particular order.
    pub fn materials(&self) -> impl Iterator<Item = (MaterialKey, &Material)> {
        self.materials.iter().map(|(key, used)| (key, &used.value))
    }

    /// Replaces a material for all cores that use it. O(1).
    ///
    /// # Errors
    /// As [`add_material`](Self::add_material), and [`Error::StaleKey`](crate::Error::StaleKey) for the material.
    pub fn set_material(&mut self, key: MaterialKey, material: Material) -> Result<()> {
        if *self.material(key)? != material {
            self.check_material(&material)?;
            // Acquire the new textures before the old ones are released: those that both use must not be freed.
            self.acquire_textures(&material);
            self.save_prior_state(key);
            let old = std::mem::replace(&mut self.materials[key].value, material);
            self.record(key, Change::DATA);
            self.release_textures(&old);
        }
        Ok(())
    }

    /// Edits a material for all cores that use it: [`set_material`](Self::set_material) with a changed copy. O(1).
    ///
    /// ```
    /// use ropewalk::{Material, Scene};
    ///
    /// let mut scene = Scene::new();
    /// let material = scene.add_material(Material::default())?;
    /// scene.edit_material(material, |material| material.roughness = 0.2)?;
    /// assert_eq!(scene.material(material)?.roughness, 0.2);
    /// # Ok::<(), ropewalk::Error>(())
    /// ```
    ///
    /// # Errors
    /// As [`set_material`](Self::set_material).
    pub fn edit_material(&mut self, key: MaterialKey, edit: impl FnOnce(&mut Material)) -> Result<()> {
        let mut material = self.material(key)?.clone();
        edit(&mut material);
        self.set_material(key, material)
    }

    /// Adds a texture that no material uses yet. O(1).
    ///
    /// # Errors
    /// [`Error::OutOfRange`](crate::Error::OutOfRange) if its size is 0 or not that of its texels.
    pub fn add_texture(&mut self, texture: Texture) -> Result<TextureKey> {
        check_texture(&texture)?;
        let key = self.textures.insert(UseCounted::new(texture));
        self.record(key, Change::ADDED);
        Ok(key)
    }

    /// The texture with this key. O(1).
    ///
    /// # Errors
    /// [`Error::StaleKey`](crate::Error::StaleKey).
    pub fn texture(&self, key: TextureKey) -> Result<&Texture> {
        Ok(&self.textures.require(key)?.value)
    }

    /// All textures, in no particular order.
    pub fn textures(&self) -> impl Iterator<Item = (TextureKey, &Texture)> {
        self.textures.iter().map(|(key, used)| (key, &used.value))
    }

    /// Replaces a texture for all materials that use it. O(texels), to compare.
    ///
    /// # Errors
    /// As [`add_texture`](Self::add_texture), and [`Error::StaleKey`](crate::Error::StaleKey) for the texture.
    pub fn set_texture(&mut self, key: TextureKey, texture: Texture) -> Result<()> {
        if *self.texture(key)? != texture {
            check_texture(&texture)?;
            self.save_prior_state(key);
            self.textures[key].value = texture;
            self.record(key, Change::DATA);
        }
        Ok(())
    }

    /// Frees the cores, geometries, materials and textures without users, which are those that never had one. O(cores +
    /// geometries + materials + textures).
    pub fn remove_unused(&mut self) {
        // Cores first: freeing one may free its geometry.
        for key in keys_where(&self.cores, |slot| slot.user_count == 0) {
            self.release_core_if_unused(key);
        }
        // Then all assets without users, those of the freed cores included.
        let geometries = keys_where(&self.geometries, |used| used.user_count == 0);
        let materials = keys_where(&self.materials, |used| used.user_count == 0);
        let textures = keys_where(&self.textures, |used| used.user_count == 0);
        self.remove_unused_among(&geometries, &materials, &textures);
    }

    /// Frees those of these assets that have no users; stale keys are ignored. O(keys).
    pub(crate) fn remove_unused_among(
        &mut self,
        geometries: &[GeometryKey],
        materials: &[MaterialKey],
        textures: &[TextureKey],
    ) {
        for &key in geometries {
            if is_unused(&self.geometries, key) {
                self.free_geometry(key);
            }
        }
        // Materials before textures: freeing one may free its textures.
        for &key in materials {
            if is_unused(&self.materials, key) {
                self.free_material(key);
            }
        }
        for &key in textures {
            if is_unused(&self.textures, key) {
                self.free_texture(key);
            }
        }
    }

    /// Counts a core as a user of its geometry, material and instance target.
    pub(super) fn acquire_assets(&mut self, key: CoreKey, core: &Core) {
        self.register_instance(key, core);
        if let Some(geometry) = core.geometry() {
            self.geometries[geometry].user_count += 1;
        }
        if let Some(material) = core.material() {
            self.materials[material].user_count += 1;
        }
    }

    /// Ends what [`acquire_assets`](Self::acquire_assets) began, and frees the geometry and material without other
    /// users.
    pub(super) fn release_assets(&mut self, key: CoreKey, core: &Core) {
        self.unregister_instance(key, core);
        if let Some(geometry) = core.geometry()
            && release(&mut self.geometries[geometry])
        {
            self.free_geometry(geometry);
        }
        if let Some(material) = core.material()
            && release(&mut self.materials[material])
        {
            self.free_material(material);
        }
    }

    /// Tells the hierarchy that the bounds of a geometry changed. O(cores + its users).
    pub(super) fn users_bounds_changed(&mut self, key: GeometryKey) {
        let users = |slot: &CoreSlot| std::iter::successors(slot.first_user, |&user| self.nodes[user].next_user);
        // Cores are not indexed by geometry: search all of them.
        for slot in self.cores.values().filter(|slot| slot.core.geometry() == Some(key)) {
            users(slot).for_each(|user| self.hierarchy.geometry_bounds_changed(user));
        }
    }

    fn stored_geometry(&self, key: GeometryKey) -> Result<&StoredGeometry> {
        Ok(&self.geometries.require(key)?.value)
    }

    pub(super) fn acquire_textures(&mut self, material: &Material) {
        for texture in material.textures() {
            self.textures[texture.texture].user_count += 1;
        }
    }

    pub(super) fn release_textures(&mut self, material: &Material) {
        for texture in material.textures() {
            if release(&mut self.textures[texture.texture]) {
                self.free_texture(texture.texture);
            }
        }
    }

    fn free_geometry(&mut self, key: GeometryKey) {
        // While a delta is applied nothing is freed here: the delta lists its removals.
        if self.defers_release {
            return;
        }
        self.save_prior_state(key);
        self.geometries.remove(key);
        self.record(key, Change::REMOVED);
    }

    fn free_material(&mut self, key: MaterialKey) {
        if self.defers_release {
            return;
        }
        self.save_prior_state(key);
        // Its textures lose a user, and may be freed in turn.
        if let Some(used) = self.materials.remove(key) {
            self.record(key, Change::REMOVED);
            self.release_textures(&used.value);
        }
    }

    fn free_texture(&mut self, key: TextureKey) {
        if self.defers_release {
            return;
        }
        self.save_prior_state(key);
        self.textures.remove(key);
        self.record(key, Change::REMOVED);
    }

    /// Checks the keys and the numbers in a material.
    fn check_material(&self, material: &Material) -> Result<()> {
        for texture in material.textures() {
            self.texture(texture.texture)?;
        }
        check_material(material)
    }
}

/// Ends one use. Returns whether it was the last.
fn release<T>(used: &mut UseCounted<T>) -> bool {
    used.user_count -= 1;
    used.user_count == 0
}

fn is_unused<K: slotmap::Key, T>(assets: &Store<K, UseCounted<T>>, key: K) -> bool {
    assets.get(key).is_some_and(|used| used.user_count == 0)
}

fn keys_where<K: slotmap::Key, V>(map: &Store<K, V>, condition: impl Fn(&V) -> bool) -> Vec<K> {
    map.iter().filter(|(_, value)| condition(value)).map(|(key, _)| key).collect()
}
