//! Random sessions of edits, transactions, undo and redo, with mirrors, compilers and readers of the hierarchy.

use std::cell::RefCell;
use std::collections::{BTreeMap, HashSet};

use glam::DVec3;
use proptest::collection::vec;
use proptest::prelude::*;
use proptest::test_runner::TestRunner;
use ropewalk::compile::Compiler;
use ropewalk::graph::{ChangeCursor, Delta, ObjectKey, ObjectState};
use ropewalk::{Error, Scene};

use super::content;
use crate::graph::random_edits::compare;
use crate::graph::random_edits::model::Model;
use crate::graph::random_edits::random::{Issued, RawEdit, raw_edit};
use ropewalk_testkit::canonical::Canonical;

const MIRRORS: usize = 2;

#[derive(Clone, Debug)]
enum Step {
    Edit(RawEdit),
    /// A transaction that is committed or rolled back, with a nested one.
    Transaction {
        outer: Vec<RawEdit>,
        inner: Vec<RawEdit>,
        keep_outer: bool,
        keep_inner: bool,
    },
    EndGroup,
    Undo,
    Redo,
    /// Bring a mirror up to date, through serialized bytes or directly.
    Sync {
        mirror: usize,
        as_bytes: bool,
    },
    /// Give a mirror a new cursor: it receives the whole scene although it is not empty.
    Restart(usize),
    /// Bring the hierarchy up to date.
    Update,
    /// Recompile.
    Compile,
}

fn step() -> impl Strategy<Value = Step> {
    let few = || vec(raw_edit(), 0..5);
    prop_oneof![
        30 => raw_edit().prop_map(Step::Edit),
        3 => (few(), few(), any::<bool>(), any::<bool>()).prop_map(|(outer, inner, keep_outer, keep_inner)| {
            Step::Transaction { outer, inner, keep_outer, keep_inner }
        }),
        8 => Just(Step::EndGroup),
        5 => Just(Step::Undo),
        4 => Just(Step::Redo),
        6 => (0..MIRRORS, any::<bool>()).prop_map(|(mirror, as_bytes)| Step::Sync { mirror, as_bytes }),
        1 => (0..MIRRORS).prop_map(Step::Restart),
        4 => Just(Step::Update),
        4 => Just(Step::Compile),
    ]
}

/// A scene, its model, and everything that follows the scene.
struct Session {
    scene: Scene,
    /// The states to which the scene can be undone.
    start: Vec<(ObjectKey, Option<ObjectState>)>,
    model: Model,
    issued: Issued,
    /// Names of groups, and what the model was before each, or after it.
    undo: Vec<(String, Model)>,
    redo: Vec<(String, Model)>,
    /// At the end of the last group.
    group_start: Model,
    group_count: usize,
    mirrors: [(Scene, ChangeCursor); MIRRORS],
    /// Of the first mirror.
    second_hand: (Scene, ChangeCursor),
    compiler: Compiler,
    compiled_instances: usize,
}

impl Session {
    /// The scene starts with geometries and materials, since otherwise too few random edits would create visible nodes.
    fn new() -> Self {
        let mut scene = Scene::new();
        let mut model = Model::new(&scene);
        let mut issued = Issued::new(&scene);
        for (kind, value) in [(19, 7), (19, 9), (20, 3)] {
            let raw = RawEdit { kind, a: 0, b: 0, value };
            issued.resolve(&raw, &model).run(&mut scene, &mut model, &mut issued);
        }
        assert_eq!((scene.geometry_count(), scene.material_count()), (2, 1));
        scene.enable_undo();
        Self {
            start: content(&scene),
            issued,
            scene,
            group_start: model.clone(),
            model,
            undo: vec![],
            redo: vec![],
            group_count: 0,
            mirrors: std::array::from_fn(|_| (Scene::new(), ChangeCursor::default())),
            second_hand: (Scene::new(), ChangeCursor::default()),
            compiler: Compiler::new(),
            compiled_instances: 0,
        }
    }

    fn run(&mut self, step: &Step) {
        match step {
            Step::Edit(raw) => self.edit(raw),
            Step::Transaction { outer, inner, keep_outer, keep_inner } => {
                self.transaction(outer, inner, *keep_outer, *keep_inner);
            }
            Step::EndGroup => self.end_group(),
            Step::Undo => self.undo(),
            Step::Redo => self.redo(),
            Step::Sync { mirror, as_bytes } => self.sync(*mirror, *as_bytes),
            Step::Restart(mirror) => self.mirrors[*mirror].1 = ChangeCursor::default(),
            Step::Update => {
                compare::hierarchy(&mut self.scene, &self.model);
                compare::boxes(&mut self.scene, &self.model);
            }
            Step::Compile => self.compile(),
        }
        compare::state(&mut self.scene, &self.model, &self.issued);
    }

    fn edit(&mut self, raw: &RawEdit) {
        let revision = self.scene.revision();
        self.issued.resolve(raw, &self.model).run(&mut self.scene, &mut self.model, &mut self.issued);
        if self.scene.revision() != revision {
            self.redo.clear();
        }
    }

    fn transaction(&mut self, outer: &[RawEdit], inner: &[RawEdit], keep_outer: bool, keep_inner: bool) {
        let before = (self.model.clone(), content(&self.scene));
        let (issued, model) = (&mut self.issued, &mut self.model);
        // Whether the edits changed anything.
        let mut run = |edits: &[RawEdit], scene: &mut Scene, model: &mut Model| {
            let revision = scene.revision();
            for raw in edits {
                issued.resolve(raw, model).run(scene, model, issued);
            }
            compare::state(scene, model, issued);
            scene.revision() != revision
        };
        let mut is_edited = false;
        let result = self.scene.transaction(|scene| {
            is_edited |= run(outer, scene, model);
            assert!(matches!(scene.undo(), Err(Error::Transaction { .. })));
            let before = (model.clone(), content(scene));
            let result = scene.transaction(|scene| {
                is_edited |= run(inner, scene, model) && keep_inner;
                if keep_inner { Ok(()) } else { Err(Error::QueueClosed) }
            });
            assert_eq!(result.is_ok(), keep_inner);
            if !keep_inner {
                *model = before.0;
                assert_eq!(content(scene), before.1);
            }
            if keep_outer { Ok(()) } else { Err(Error::QueueClosed) }
        });
        assert_eq!(result.is_ok(), keep_outer);
        if !keep_outer {
            self.model = before.0;
            assert_eq!(content(&self.scene), before.1);
        } else if is_edited {
            self.redo.clear();
        }
    }

    fn end_group(&mut self) {
        self.group_count += 1;
        let name = format!("group {}", self.group_count);
        self.scene.end_undo_group(&name);
        let before = std::mem::replace(&mut self.group_start, self.model.clone());
        if self.scene.next_undo() == Some(&name) {
            self.undo.push((name, before));
        } else {
            assert!(before.changes_to(&self.model).is_empty(), "a group was forgotten");
        }
    }

    fn undo(&mut self) {
        self.end_group();
        assert_eq!(self.scene.next_undo(), self.undo.last().map(|(name, _)| name.as_str()));
        let name = self.scene.undo().unwrap();
        let group = self.undo.pop();
        assert_eq!(name.as_deref(), group.as_ref().map(|(name, _)| name.as_str()));
        if let Some((name, before)) = group {
            self.redo.push((name, std::mem::replace(&mut self.model, before)));
        }
        self.group_start = self.model.clone();
    }

    fn redo(&mut self) {
        assert_eq!(self.scene.next_redo(), self.redo.last().map(|(name, _)| name.as_str()));
        let name = self.scene.redo().unwrap();
        let group = self.redo.pop();
        assert_eq!(name.as_deref(), group.as_ref().map(|(name, _)| name.as_str()));
        if let Some((name, after)) = group {
            self.undo.push((name, std::mem::replace(&mut self.model, after)));
            self.group_start = self.model.clone();
        }
    }

    fn sync(&mut self, number: usize, as_bytes: bool) {
        let (mirror, cursor) = &mut self.mirrors[number];
        let mut delta = self.scene.delta_since(cursor);
        if as_bytes {
            let bytes = postcard::to_stdvec(&delta).unwrap();
            delta = postcard::from_bytes::<Delta>(&bytes).unwrap();
        }
        mirror.apply(&delta).unwrap();
        compare::state(mirror, &self.model, &self.issued);
        assert_eq!(content(mirror), content(&self.scene));
        let revision = mirror.revision();
        mirror.apply(&delta).unwrap();
        assert_eq!(mirror.revision(), revision, "nothing is left to do");
        if number == 0 {
            let (second, cursor) = &mut self.second_hand;
            second.apply(&mirror.delta_since(cursor)).unwrap();
            assert_eq!(content(second), content(&self.scene));
            compare::hierarchy(second, &self.model);
        }
    }

    fn compile(&mut self) {
        self.compiler.compile(&mut self.scene, DVec3::Z).unwrap();
        let mut fresh = Compiler::new();
        fresh.compile(&mut self.scene, DVec3::Z).unwrap();
        let difference = Canonical::of(self.compiler.arrays()).difference(&Canonical::of(fresh.arrays()));
        assert_eq!(difference, None, "edit by edit, and from nothing");
        self.compiled_instances += Canonical::of(fresh.arrays()).instance_count();
    }

    /// Undoes everything, and redoes it.
    fn there_and_back(&mut self) {
        self.end_group();
        let (end, end_content) = (self.model.clone(), content(&self.scene));
        let count = self.undo.len();
        for _ in 0..count {
            self.undo();
            compare::state(&mut self.scene, &self.model, &self.issued);
        }
        assert_eq!(self.scene.next_undo(), None);
        assert_eq!(content(&self.scene), self.start);
        for _ in 0..count {
            self.redo();
            compare::state(&mut self.scene, &self.model, &self.issued);
        }
        assert_eq!(content(&self.scene), end_content);
        compare::state(&mut self.scene, &end, &self.issued);
        for mirror in 0..MIRRORS {
            self.sync(mirror, mirror == 0);
        }
        self.compile();
        compare::hierarchy(&mut self.scene, &self.model);
    }
}

#[test]
fn sessions_equal_their_models() {
    let config = ProptestConfig { cases: 800, failure_persistence: None, ..ProptestConfig::default() };
    let seen = RefCell::new(BTreeMap::<&str, usize>::new());
    let outcome = TestRunner::new(config).run(&vec(step(), 1..150), |steps| {
        let mut session = Session::new();
        for step in &steps {
            let counts = (session.undo.len(), session.redo.len());
            session.run(step);
            let kind = match step {
                Step::Undo if session.redo.len() > counts.1 => "undo",
                Step::Redo if session.redo.len() < counts.1 => "redo",
                Step::Sync { .. } => "sync",
                _ => continue,
            };
            *seen.borrow_mut().entry(kind).or_default() += 1;
        }
        session.there_and_back();
        *seen.borrow_mut().entry("instance").or_default() += session.compiled_instances;
        let nodes: HashSet<_> = session.issued.nodes.iter().collect();
        assert_eq!(nodes.len(), session.issued.nodes.len(), "a key was given out twice");
        Ok(())
    });
    outcome.unwrap_or_else(|failure| panic!("{failure}"));
    let seen = seen.into_inner();
    assert!(
        ["undo", "redo", "sync", "instance"].iter().all(|kind| seen.get(kind).is_some_and(|&count| count > 100)),
        "{seen:?}"
    );
}
