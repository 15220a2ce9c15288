//! The targets. Each panics if something is wrong; what it returns tells inputs apart.

use std::path::Path;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use ropewalk::gltf::{self, FilePolicy, ImportOptions};
use ropewalk::graph::{ChangeCursor, Delta, EditQueue};
use ropewalk::{Error, Scene};
use ropewalk_testkit::world::{Edit, World};

use crate::{Target, seeds};

/// All targets.
pub const TARGETS: &[Target] = &[
    Target { name: "import", seeds: import_seeds, run: import },
    Target { name: "import-glb", seeds: import_glb_seeds, run: import_glb },
    Target { name: "scene-file", seeds: seeds::deltas, run: scene_file },
    Target { name: "delta", seeds: seeds::deltas, run: delta },
    Target { name: "edit-queue", seeds: edit_seeds, run: edit_queue },
];

/// The memory that an import may take.
const MEMORY_LIMIT: u64 = 64 << 20;

fn import_seeds() -> Vec<Vec<u8>> {
    let (mut document, data) = seeds::gltf_parts();
    let binary = seeds::glb(document.to_string().as_bytes(), &data);
    let escaped: String = data.iter().map(|byte| format!("%{byte:02x}")).collect();
    document["buffers"][0]["uri"] = format!("data:,{escaped}").into();
    vec![document.to_string().into_bytes(), binary, br#"{"asset":{"version":"2.0"},"nodes":[{}]}"#.to_vec()]
}

/// A glTF or GLB file.
fn import(bytes: &[u8]) -> String {
    let options = ImportOptions::default().with_files(FilePolicy::below([""; 0])).with_memory_limit(MEMORY_LIMIT);
    let mut scene = Scene::new();
    let (root, revision) = (scene.root(), scene.revision());
    match gltf::import_from_slice(bytes, Path::new("fuzz.glb"), &options, &mut scene, root) {
        Ok(report) => {
            scene.validate().expect("an imported scene is valid");
            scene.world_bounds(root).expect("the root is there");
            let outcome = report.warnings.iter().map(|w| shape_of(&w.to_string())).collect::<Vec<_>>().join(";");
            let added = scene.snapshot();
            assert!(Scene::new().apply(&added).is_ok(), "an imported scene can be sent elsewhere");
            scene.remove(report.root).expect("the import's root can be removed");
            assert_eq!((scene.node_count(), scene.geometry_count(), scene.texture_count()), (1, 0, 0));
            format!("imported: {outcome}")
        }
        Err(error @ (Error::Gltf { .. } | Error::UnsupportedExtension { .. })) => {
            assert_eq!(scene.revision(), revision, "a failed import changed the scene");
            let message = error.to_string();
            assert!(message.len() < 4096 + bytes.len(), "a message of {} bytes", message.len());
            shape_of(&message)
        }
        Err(error) => panic!("unexpected kind of error: {error:?}"),
    }
}

/// The JSON text, an 0xFF and the binary chunk.
fn import_glb_seeds() -> Vec<Vec<u8>> {
    let (document, data) = seeds::gltf_parts();
    vec![[document.to_string().as_bytes(), &[0xFF], &data].concat()]
}

/// A GLB file whose lengths are right, whatever its chunks are.
fn import_glb(bytes: &[u8]) -> String {
    let mut parts = bytes.splitn(2, |&byte| byte == 0xFF);
    let (json, data) = (parts.next().unwrap_or_default(), parts.next().unwrap_or_default());
    import(&seeds::glb(json, data))
}

/// The body of a frame of a scene file, whose length and checksum are right.
fn scene_file(body: &[u8]) -> String {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("fuzz.ropewalk");
    // Magic and version of this build, written once: saving waits for the disk.
    static HEADER: OnceLock<Vec<u8>> = OnceLock::new();
    let header = HEADER.get_or_init(|| {
        Scene::new().save(&path).expect("the folder can be written to");
        std::fs::read(&path).expect("it was written")[..12].to_vec()
    });
    let head = [&(body.len() as u64).to_le_bytes()[..], &crc32fast::hash(body).to_le_bytes()].concat();
    std::fs::write(&path, [header, &head[..], body].concat()).expect("the folder can be written to");
    match Scene::load(&path) {
        Ok(mut scene) => {
            check_scene(&mut scene);
            scene.save(&path).expect("the folder can be written to");
            let again = Scene::load(&path).expect("a scene that was saved can be loaded");
            assert_same(&again, &scene);
            "loaded".to_owned()
        }
        Err(error @ Error::SceneFile { .. }) => shape_of(&error.to_string().replace(&*path.to_string_lossy(), "")),
        Err(error) => panic!("unexpected kind of error: {error:?}"),
    }
}

/// A delta, from whoever sent it, for a scene with a few objects.
fn delta(bytes: &[u8]) -> String {
    let Ok(delta) = postcard::from_bytes::<Delta>(bytes) else { return "not a delta".to_owned() };
    let mut scene = seeds::scene();
    let before = scene.snapshot();
    let mut cursor = ChangeCursor::default();
    let mut replica = Scene::new();
    replica.apply(&scene.delta_since(&mut cursor)).expect("a replica follows");
    scene.enable_undo();
    match scene.apply(&delta) {
        Ok(()) => {
            check_scene(&mut scene);
            replica.apply(&scene.delta_since(&mut cursor)).expect("a replica follows");
            assert_same(&replica, &scene);
            scene.end_undo_group("");
            scene.undo().expect("what was applied can be undone");
            check_scene(&mut scene);
            assert!(scene.snapshot().objects().eq(before.objects()), "undone is not what was before");
            "applied".to_owned()
        }
        Err(error) => {
            assert_eq!(scene.snapshot(), before, "a delta that failed changed the scene: {error}");
            check_scene(&mut scene);
            shape_of(&error.to_string())
        }
    }
}

fn edit_seeds() -> Vec<Vec<u8>> {
    let mut random = fastrand::Rng::with_seed(1);
    (0..4).map(|_| (0..200).map(|_| random.u8(..)).collect()).collect()
}

/// The first byte of an edit that ends a batch instead.
const END_OF_BATCH: u8 = 232;

/// Batches of edits that go through a queue, each whole or not at all. Four bytes are an edit, or the end of a batch,
/// which fails if the second byte is odd.
fn edit_queue(bytes: &[u8]) -> String {
    let batches: Vec<&[[u8; 4]]> = bytes.as_chunks().0.split_inclusive(|edit| edit[0] >= END_OF_BATCH).collect();
    let (batch_count, mut failed) = (batches.len(), 0);
    let mut world = World::new();
    world.populate();
    let mut scene = std::mem::take(&mut world.scene);
    let world = Arc::new(Mutex::new(world));
    let (mut replica, mut cursor) = (Scene::new(), ChangeCursor::default());
    let queue = EditQueue::new();
    let sender = queue.sender();
    scene.enable_undo();
    for batch in batches {
        let edits: Vec<Edit> = batch.iter().filter(|edit| edit[0] < END_OF_BATCH).copied().map(edit_of).collect();
        let fails = batch.last().is_some_and(|edit| edit[0] >= END_OF_BATCH && edit[1] % 2 == 1);
        failed += u32::from(fails);
        let before = scene.snapshot();
        let keeper = world.clone();
        let pending = sender.send(move |scene| {
            let mut world = keeper.lock().unwrap_or_else(PoisonError::into_inner);
            // The world edits its own scene, which is this one meanwhile.
            std::mem::swap(scene, &mut world.scene);
            world.forget_stale_keys();
            edits.iter().for_each(|edit| world.apply(edit));
            std::mem::swap(scene, &mut world.scene);
            if fails { scene.remove(Default::default()) } else { Ok(()) }
        });
        assert_eq!(queue.apply(&mut scene), 1);
        assert_eq!(pending.wait().is_err(), fails);
        check_scene(&mut scene);
        if fails {
            assert!(scene.snapshot().objects().eq(before.objects()), "a batch that failed changed the scene");
        }
        replica.apply(&scene.delta_since(&mut cursor)).expect("a replica follows");
        assert_same(&replica, &scene);
        scene.end_undo_group("");
    }
    let end = scene.snapshot();
    let (mut undone, mut redone) = (0, 0);
    while scene.undo().expect("what was done can be undone").is_some() {
        undone += 1;
    }
    while scene.redo().expect("what was undone can be done again").is_some() {
        redone += 1;
    }
    assert_eq!(undone, redone);
    assert!(scene.snapshot().objects().eq(end.objects()), "undone and done again is something else");
    format!("{batch_count} batches, {failed} failed, {undone} undone, {} nodes", scene.node_count().ilog2())
}

fn edit_of([kind, a, b, c]: [u8; 4]) -> Edit {
    let (i, j, k) = (a.into(), b.into(), c.into());
    match kind % 16 {
        0 => Edit::Insert(i, j, k),
        1 => Edit::Shine(i, j),
        2 => Edit::Share(i, j),
        3 => Edit::Move(i, b as i8, c as i8),
        4 => Edit::Scale(i, b as i8),
        5 => Edit::Remove(i),
        6 => Edit::Reparent(i, j),
        7 => Edit::SetMask(i, b.into()),
        8 => Edit::SetVisible(i, b.is_multiple_of(2)),
        9 => Edit::SetMaterial(i, j),
        10 => Edit::SetGeometry(i, j),
        11 => Edit::Deform(i, b),
        12 => Edit::Choose(i, j),
        13 => Edit::SetTexture(i, b),
        14 => Edit::SwapCore(i, j, k),
        _ => Edit::ChangeCore(i, j, k),
    }
}

fn check_scene(scene: &mut Scene) {
    let _ = scene.hierarchy();
    scene.validate().expect("the scene is valid");
}

fn assert_same(one: &Scene, other: &Scene) {
    assert!(one.snapshot().objects().eq(other.snapshot().objects()), "the copy differs");
}

/// A message without its numbers and quoted parts, so that messages of one kind are one outcome.
fn shape_of(message: &str) -> String {
    let mut quoted = false;
    let mut shape = String::new();
    for character in message.chars() {
        match character {
            '"' => quoted = !quoted,
            _ if quoted => {}
            '0'..='9' if shape.ends_with('#') => {}
            '0'..='9' => shape.push('#'),
            _ => shape.push(character),
        }
    }
    shape.truncate(shape.floor_char_boundary(200));
    shape
}
