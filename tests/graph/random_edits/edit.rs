//! Random edits: how each is applied to the scene and to the model, and with which error it must fail.

use glam::{DAffine3, DMat3, DVec3, Vec3};
use ropewalk::graph::{Billboard, CoreSource, KeepTransform, ObjectKey};
use ropewalk::{
    Camera, Core, CoreKey, Error, Geometry, GeometryKey, Material, MaterialKey, NodeKey, Result, Scene, Texture,
    TextureKey, Transform,
};

use super::model::{Model, ModelNode};
use super::random::Issued;

#[derive(Clone, Debug)]
pub(crate) enum Edit {
    Add(NodeKey, CoreSource),
    Remove(NodeKey),
    Reparent(NodeKey, NodeKey, KeepTransform),
    AssignCore(NodeKey, CoreSource),
    SetLocal(NodeKey, Transform),
    SetName(NodeKey, String),
    SetMask(NodeKey, u32),
    SetVisible(NodeKey, bool),
    AddCore(Core),
    SetCore(CoreKey, Core),
    AddGeometry(Geometry),
    SetGeometry(GeometryKey, Geometry),
    SetPositions(GeometryKey, Vec<Vec3>, Option<Vec<Vec3>>),
    AddMaterial(Material),
    SetMaterial(MaterialKey, Material),
    AddTexture(Texture),
    SetTexture(TextureKey, Texture),
    RemoveUnused,
}

/// The reason why an edit must fail.
#[derive(Debug, PartialEq)]
enum Fault {
    Stale(ObjectKey),
    Root,
    Cycle,
    WrongCore,
    Singular,
    OutOfRange,
    Geometry,
}

impl From<&Error> for Fault {
    fn from(error: &Error) -> Self {
        match error {
            Error::StaleKey { object } => Self::Stale(*object),
            Error::Root { .. } => Self::Root,
            Error::Cycle { .. } => Self::Cycle,
            Error::WrongCore { .. } => Self::WrongCore,
            Error::Singular { .. } => Self::Singular,
            Error::OutOfRange { .. } => Self::OutOfRange,
            Error::InvalidGeometry { .. } => Self::Geometry,
            other => panic!("no edit may end with: {other}"),
        }
    }
}

impl Edit {
    /// Applies the edit to the scene and, if it is valid, to the model. Returns how it ended.
    pub(crate) fn run(self, scene: &mut Scene, model: &mut Model, issued: &mut Issued) -> String {
        let fault = self.check(scene, model).err();
        let ending = self.describe(fault.as_ref());
        let before = fault.is_some().then(|| format!("{scene:?}"));
        let worlds = model.nodes.keys().map(|&key| (key, scene.world_from_local(key).unwrap())).collect::<Vec<_>>();
        let outcome = self.run_on_scene(scene);
        match (fault, outcome) {
            (None, Ok(created)) => {
                issued.note(created);
                self.run_on_model(scene, model, created);
                issued.note_cores(model);
                if let Self::Reparent(node, _, KeepTransform::World) = self {
                    let stays = model.preorder(node);
                    for (key, world) in worlds {
                        let others_stay = !stays.contains(&key) && scene.world_from_local(key).unwrap() == world;
                        assert!(
                            others_stay || is_close(&scene.world_from_local(key).unwrap(), &world, model),
                            "{key:?} moved"
                        );
                    }
                }
            }
            (Some(fault), Err(error)) => {
                assert_eq!(Fault::from(&error), fault, "{error}");
                assert_eq!(Some(format!("{scene:?}")), before, "a failed {self:?} left traces");
            }
            (fault, outcome) => panic!("{self:?} ended with {outcome:?}, not with {fault:?}"),
        }
        ending
    }

    /// A label of the edit and its expected outcome: `SetLocal` for success, `SetLocal: Stale` for an error.
    fn describe(&self, fault: Option<&Fault>) -> String {
        let name = |debug: String| debug.split(['(', ' ']).next().unwrap().to_owned();
        let edit = name(format!("{self:?}"));
        fault.map_or(edit.clone(), |fault| format!("{edit}: {}", name(format!("{fault:?}"))))
    }

    /// The error with which the edit must fail; `None` if it must succeed.
    fn check(&self, scene: &Scene, model: &Model) -> Result<(), Fault> {
        let node = |key: NodeKey| if model.nodes.contains_key(&key) { Ok(()) } else { Err(Fault::Stale(key.into())) };
        let core_key = |key| if model.cores.contains_key(&key) { Ok(()) } else { Err(Fault::Stale(key.into())) };
        match self {
            Self::Add(parent, source) => {
                node(*parent)?;
                check_source(source, model)?;
                check_target(*parent, source, model)
            }
            Self::Remove(key) => node(*key).and_then(|()| not(*key == model.root, Fault::Root)),
            Self::Reparent(key, parent, keep) => {
                node(*key)?;
                node(*parent)?;
                not(*key == model.root, Fault::Root)?;
                not(model.shows(*key, *parent), Fault::Cycle)?;
                if *keep == KeepTransform::World {
                    not(!matches!(model.core(*key), Core::Transform(_)), Fault::WrongCore)?;
                    let old_parent = model.nodes[key].parent.unwrap();
                    let (old, new) =
                        (scene.world_from_local(old_parent).unwrap(), scene.world_from_local(*parent).unwrap());
                    not(new.matrix3 == DMat3::ZERO && new != old, Fault::Singular)?;
                }
                Ok(())
            }
            Self::AssignCore(key, source) => {
                node(*key)?;
                if *key == model.root {
                    let core = match source {
                        CoreSource::New(core) => core,
                        CoreSource::Shared(key) => model.cores.get(key).ok_or(Fault::Stale((*key).into()))?,
                    };
                    not(*core != Core::Group, Fault::Root)?;
                }
                check_source(source, model)?;
                check_target(*key, source, model)
            }
            Self::SetLocal(key, transform) => {
                node(*key)?;
                not(!matches!(model.core(*key), Core::Transform(_)), Fault::WrongCore)?;
                check_core(&Core::Transform(*transform), model)
            }
            Self::SetName(key, _) | Self::SetMask(key, _) | Self::SetVisible(key, _) => node(*key),
            Self::AddCore(core) => check_core(core, model),
            Self::SetCore(key, core) => {
                core_key(*key)?;
                let of_root = model.nodes[&model.root].core == *key;
                not(of_root && *core != Core::Group, Fault::Root)?;
                check_core(core, model)?;
                let source = CoreSource::New(core.clone());
                model.users(*key).into_iter().try_for_each(|user| check_target(user, &source, model))
            }
            Self::AddGeometry(geometry) => check_geometry(geometry),
            Self::SetGeometry(key, geometry) => {
                not(!model.geometries.contains_key(key), Fault::Stale((*key).into()))?;
                check_geometry(geometry)
            }
            Self::SetPositions(key, positions, normals) => {
                let old = model.geometries.get(key).ok_or(Fault::Stale((*key).into()))?;
                not(old.positions.len() != positions.len(), Fault::Geometry)?;
                check_geometry(&deformed(old, positions, normals.as_ref()))
            }
            Self::AddMaterial(material) => check_material(material, model),
            Self::SetMaterial(key, material) => {
                not(!model.materials.contains_key(key), Fault::Stale((*key).into()))?;
                check_material(material, model)
            }
            Self::AddTexture(texture) => check_texture(texture),
            Self::SetTexture(key, texture) => {
                not(!model.textures.contains_key(key), Fault::Stale((*key).into()))?;
                check_texture(texture)
            }
            Self::RemoveUnused => Ok(()),
        }
    }

    fn run_on_scene(&self, scene: &mut Scene) -> Result<Option<ObjectKey>> {
        match self.clone() {
            Self::Add(parent, source) => scene.add(parent, source).map(|key| Some(key.into())),
            Self::AddCore(core) => scene.add_core(core).map(|key| Some(key.into())),
            Self::AddGeometry(geometry) => scene.add_geometry(geometry).map(|key| Some(key.into())),
            Self::AddMaterial(material) => scene.add_material(material).map(|key| Some(key.into())),
            Self::AddTexture(texture) => scene.add_texture(texture).map(|key| Some(key.into())),
            Self::Remove(key) => scene.remove(key).map(|()| None),
            Self::Reparent(key, parent, keep) => scene.reparent(key, parent, keep).map(|()| None),
            Self::AssignCore(key, source) => scene.assign_core(key, source).map(|()| None),
            Self::SetLocal(key, transform) => scene.set_local(key, transform).map(|()| None),
            Self::SetName(key, name) => scene.set_name(key, name).map(|()| None),
            Self::SetMask(key, mask) => scene.set_mask(key, mask).map(|()| None),
            Self::SetVisible(key, visible) => scene.set_visible(key, visible).map(|()| None),
            Self::SetCore(key, core) => scene.set_core(key, core).map(|()| None),
            Self::SetGeometry(key, geometry) => scene.set_geometry(key, geometry).map(|()| None),
            Self::SetPositions(key, positions, normals) => {
                scene.set_positions(key, positions, normals.map(Into::into)).map(|()| None)
            }
            Self::SetMaterial(key, material) => scene.set_material(key, material).map(|()| None),
            Self::SetTexture(key, texture) => scene.set_texture(key, texture).map(|()| None),
            Self::RemoveUnused => {
                scene.remove_unused();
                Ok(None)
            }
        }
    }

    fn run_on_model(&self, scene: &Scene, model: &mut Model, created: Option<ObjectKey>) {
        match (self.clone(), created) {
            (Self::Add(parent, source), Some(ObjectKey::Node(key))) => {
                let core = take_core(source, scene.core_key(key).unwrap(), model);
                model.nodes.insert(key, ModelNode::new(Some(parent), core));
                model.nodes.get_mut(&parent).unwrap().children.push(key);
            }
            (Self::AddCore(core), Some(ObjectKey::Core(key))) => assert!(model.cores.insert(key, core).is_none()),
            (Self::Remove(key), _) => {
                detach(key, model);
                for key in model.preorder(key) {
                    model.nodes.remove(&key);
                    for core in model.cores.values_mut().filter(|core| **core == Core::Instance(key)) {
                        *core = Core::Group;
                    }
                }
            }
            (Self::Reparent(key, parent, keep), _) => {
                if model.nodes[&key].parent != Some(parent) {
                    detach(key, model);
                    model.nodes.get_mut(&parent).unwrap().children.push(key);
                    model.nodes.get_mut(&key).unwrap().parent = Some(parent);
                }
                if keep == KeepTransform::World {
                    // The new local transform is taken from the scene: the caller checks that the world transform stays
                    // the same.
                    let local = Core::Transform(scene.local(key).unwrap());
                    let core = model.nodes[&key].core;
                    let shared = model.users(core).len() > 1 && model.cores[&core] != local;
                    let core = if shared { scene.core_key(key).unwrap() } else { core };
                    assert!(!shared || !model.cores.contains_key(&core), "a shared core must not change");
                    model.cores.insert(core, local);
                    model.nodes.get_mut(&key).unwrap().core = core;
                }
            }
            (Self::AssignCore(key, source), _) => {
                let old = model.nodes[&key].core;
                let alone = model.users(old).len() == 1;
                if !(alone && source == CoreSource::New(model.cores[&old].clone())) {
                    let core = take_core(source, scene.core_key(key).unwrap(), model);
                    model.nodes.get_mut(&key).unwrap().core = core;
                }
            }
            (Self::SetLocal(key, transform), _) => {
                let core = model.nodes[&key].core;
                model.cores.insert(core, Core::Transform(transform));
            }
            (Self::SetName(key, name), _) => model.nodes.get_mut(&key).unwrap().name = name,
            (Self::SetMask(key, mask), _) => model.nodes.get_mut(&key).unwrap().mask = mask,
            (Self::SetVisible(key, visible), _) => model.nodes.get_mut(&key).unwrap().visible = visible,
            (Self::SetCore(key, core), _) => {
                let _ = model.cores.insert(key, core);
            }
            (Self::AddGeometry(geometry), Some(ObjectKey::Geometry(key))) | (Self::SetGeometry(key, geometry), _) => {
                let _ = model.geometries.insert(key, geometry);
            }
            (Self::SetPositions(key, positions, normals), _) => {
                let geometry = model.geometries.get_mut(&key).unwrap();
                *geometry = deformed(geometry, &positions, normals.as_ref());
            }
            (Self::AddMaterial(material), Some(ObjectKey::Material(key))) | (Self::SetMaterial(key, material), _) => {
                let _ = model.materials.insert(key, material);
            }
            (Self::AddTexture(texture), Some(ObjectKey::Texture(key))) | (Self::SetTexture(key, texture), _) => {
                let _ = model.textures.insert(key, texture);
            }
            (Self::RemoveUnused, _) => model.collect(true),
            (edit, created) => panic!("{edit:?} created {created:?}"),
        }
        model.collect(false);
    }
}

fn deformed(old: &Geometry, positions: &[Vec3], normals: Option<&Vec<Vec3>>) -> Geometry {
    let normals = normals.map(|normals| normals.as_slice().into()).or_else(|| old.normals.clone());
    Geometry { positions: positions.into(), normals, ..old.clone() }
}

fn not(wrong: bool, fault: Fault) -> Result<(), Fault> {
    if wrong { Err(fault) } else { Ok(()) }
}

fn check_source(source: &CoreSource, model: &Model) -> Result<(), Fault> {
    match source {
        CoreSource::New(core) => check_core(core, model),
        CoreSource::Shared(key) => not(!model.cores.contains_key(key), Fault::Stale((*key).into())),
    }
}

/// Instances must not form cycles.
fn check_target(node: NodeKey, source: &CoreSource, model: &Model) -> Result<(), Fault> {
    let core = match source {
        CoreSource::New(core) => core,
        CoreSource::Shared(key) => &model.cores[key],
    };
    match *core {
        Core::Instance(target) => not(model.shows(target, node), Fault::Cycle),
        _ => Ok(()),
    }
}

fn check_core(core: &Core, model: &Model) -> Result<(), Fault> {
    match core {
        Core::Geometry { geometry, material } => {
            not(!model.geometries.contains_key(geometry), Fault::Stale((*geometry).into()))?;
            not(!model.materials.contains_key(material), Fault::Stale((*material).into()))
        }
        Core::MaterialGroup(material) => not(!model.materials.contains_key(material), Fault::Stale((*material).into())),
        Core::Instance(target) => not(!model.nodes.contains_key(target), Fault::Stale((*target).into())),
        Core::Lod(lod) => not(!lod.thresholds.is_sorted(), Fault::OutOfRange),
        Core::Billboard(Billboard::Cylindrical(axis)) => not(*axis == DVec3::ZERO, Fault::OutOfRange),
        Core::Transform(transform) => not(!transform.is_finite(), Fault::OutOfRange),
        Core::Light(light) => not(light.intensity.is_nan() || light.intensity < 0.0, Fault::OutOfRange),
        Core::Camera(camera) => {
            let right = matches!(camera, Camera::Perspective { y_fov, .. } if *y_fov > 0.0 && y_fov.is_finite());
            not(!right, Fault::OutOfRange)
        }
        _ => Ok(()),
    }
}

fn check_geometry(geometry: &Geometry) -> Result<(), Fault> {
    let broken = geometry.positions.iter().any(|p| p.is_nan()) || geometry.indices.iter().flatten().any(|&i| i > 4);
    let normals = geometry.normals.as_ref().map_or(geometry.positions.len(), |normals| normals.len());
    not(broken || normals != geometry.positions.len(), Fault::Geometry)
}

fn check_material(material: &Material, model: &Model) -> Result<(), Fault> {
    let gone = material.textures().find(|t| !model.textures.contains_key(&t.texture));
    gone.map_or(Ok(()), |t| Err(Fault::Stale(t.texture.into())))?;
    not(material.base_color.x > 1.0, Fault::OutOfRange)
}

fn check_texture(texture: &Texture) -> Result<(), Fault> {
    not(texture.width == 0 || texture.width * texture.height != texture.texels.len() as u32, Fault::OutOfRange)
}

/// The key of the source's core, which is added to the model if it is new.
fn take_core(source: CoreSource, found: CoreKey, model: &mut Model) -> CoreKey {
    match source {
        CoreSource::Shared(key) => key,
        CoreSource::New(core) => {
            assert!(model.cores.insert(found, core).is_none(), "a new core must have a new key");
            found
        }
    }
}

fn detach(node: NodeKey, model: &mut Model) {
    let parent = model.nodes[&node].parent.unwrap();
    model.nodes.get_mut(&parent).unwrap().children.retain(|&child| child != node);
}

/// Whether two world matrices are equal up to rounding at the scale of the model's coordinates.
fn is_close(a: &DAffine3, b: &DAffine3, model: &Model) -> bool {
    let largest = model.nodes.keys().map(|&node| model.to_world(node, DVec3::ONE).1).fold(1.0, f64::max);
    let difference = (0..4).map(|i| (a.to_cols_array_2d()[i], b.to_cols_array_2d()[i]));
    difference.flat_map(|(a, b)| std::iter::zip(a, b)).all(|(a, b)| (a - b).abs() <= 1e-6 * largest)
}
