//! Compiles and builds that are cancelled at each of the places where they can be.

#![expect(clippy::unwrap_used, reason = "a panic in a test is a failure")]

use glam::{DVec3, Vec3};
use ropewalk::accel::{Blas, BlasBuildParams};
use ropewalk::compile::Compiler;
use ropewalk::graph::{BlasKind, Quality};
use ropewalk::{Cancel, Core, Error, Geometry, GeometryKey, Light, Material, MaterialKey, NodeKey, Scene, Transform};
use ropewalk_testkit::Mesh;
use ropewalk_testkit::canonical::Canonical;

const STRUCTURES: [BlasKind; 4] =
    [BlasKind::Bvh(Quality::Low), BlasKind::Bvh(Quality::Medium), BlasKind::Bvh(Quality::High), BlasKind::KdTree];

/// A bumpy ball of 5120 triangles: several subtrees of each builder look at the token.
fn ball() -> Geometry {
    let Mesh { positions, indices } = Mesh::displaced_icosphere(4);
    Geometry::new(positions, indices)
}

/// A scene with a geometry of each structure, in a row.
struct Row {
    scene: Scene,
    geometries: Vec<GeometryKey>,
    material: MaterialKey,
    places: Vec<NodeKey>,
}

impl Row {
    fn new() -> Self {
        Self::of(STRUCTURES)
    }

    fn of(structures: [BlasKind; 4]) -> Self {
        let mut scene = Scene::new();
        let material = scene.add_material(Material::default()).unwrap();
        let mut row = Self { scene, geometries: Vec::new(), material, places: Vec::new() };
        for structure in structures {
            row.add(ball().with_blas_kind(structure));
        }
        row.scene.add(row.scene.root(), Light::point(Vec3::ONE, 10.0)).unwrap();
        row
    }

    fn add(&mut self, geometry: Geometry) {
        let x = 3.0 * self.places.len() as f64;
        let place = self.scene.add(self.scene.root(), Transform::from_translation(DVec3::new(x, 0.0, 0.0))).unwrap();
        let geometry = self.scene.add_geometry(geometry).unwrap();
        self.scene.add(place, Core::Geometry { geometry, material: self.material }).unwrap();
        self.geometries.push(geometry);
        self.places.push(place);
    }

    /// Edits of each kind that the compiler treats on its own: two refits (one of which fails, since triangles become
    /// degenerate), two builds of deformed geometries, a new geometry, one that goes, and what needs no build.
    fn edit(&mut self) {
        for (i, &key) in self.geometries.iter().enumerate() {
            let mut positions = self.scene.geometry(key).unwrap().positions.to_vec();
            positions.iter_mut().for_each(|p| p.y *= 1.5);
            if i == 1 {
                positions[12..40].fill(Vec3::ZERO);
            }
            self.scene.set_positions(key, positions, None).unwrap();
        }
        self.add(ball());
        self.scene.remove(self.places[2]).unwrap();
        self.scene.set_material(self.material, Material::diffuse(Vec3::X)).unwrap();
        self.scene.set_local(self.places[0], Transform::from_translation(DVec3::new(0.0, 5.0, 0.0))).unwrap();
    }

    /// Sets the positions back to those of [`new`](Self::new), as if nothing had to be done.
    fn deform_back(&mut self) {
        for &key in &self.geometries {
            // One of them was removed with its node.
            if self.scene.geometry(key).is_ok() {
                self.scene.set_positions(key, ball().positions, None).unwrap();
            }
        }
    }

    /// The canonical form of the scene compiled from nothing.
    fn compiled_anew(&mut self) -> Canonical {
        let mut compiler = Compiler::new();
        compiler.compile(&mut self.scene, EYE).unwrap();
        Canonical::of(compiler.arrays())
    }
}

const EYE: DVec3 = DVec3::new(4.0, 2.0, 20.0);

/// Numbers of checks to cancel after: the first ones, and then ever fewer.
fn checks() -> impl Iterator<Item = u64> {
    std::iter::successors(Some(0), |&checks| Some(checks + 1 + checks / 6))
}

/// Compiles with a token that is cancelled after so many checks; whether that was cancelled.
fn is_cancelled_after(checks: u64, compiler: &mut Compiler, scene: &mut Scene) -> bool {
    compiler.set_cancel(Cancel::after_checks(checks));
    let compiled = compiler.compile(scene, EYE);
    compiler.set_cancel(None);
    match compiled {
        Ok(_) => false,
        Err(error) => {
            assert_eq!(error, Error::Cancelled);
            true
        }
    }
}

#[test]
fn a_first_compile_that_is_cancelled_anywhere_is_finished_by_the_next() {
    let mut row = Row::new();
    let mut reference = Compiler::new();
    let reported = reference.compile(&mut row.scene, EYE).unwrap();
    let expected = Canonical::exactly(reference.arrays());
    for checks in checks() {
        let mut compiler = Compiler::new();
        if !is_cancelled_after(checks, &mut compiler, &mut row.scene) {
            assert!(checks > 20, "only {checks} places to cancel");
            break;
        }
        // From another place, to which the render origin must move since nothing was compiled before.
        if checks % 2 == 1 {
            compiler.set_cancel(Cancel::after_checks(0));
            assert_eq!(compiler.compile(&mut row.scene, EYE * 2.0).err(), Some(Error::Cancelled));
            compiler.set_cancel(None);
        }
        let report = compiler.compile(&mut row.scene, EYE).unwrap();
        assert_eq!(Canonical::exactly(compiler.arrays()).difference(&expected), None, "after {checks} checks");
        assert_eq!((report.blas_built, report.instances), (reported.blas_built, reported.instances));
        assert_eq!(compiler.origin(), EYE);
        // Nothing is left to be done.
        assert_eq!(compiler.compile(&mut row.scene, EYE).unwrap().blas_built, 0);
    }
}

#[test]
fn an_update_that_is_cancelled_anywhere_is_finished_by_the_next_whatever_was_edited_meanwhile() {
    for deforms_back in [false, true] {
        for checks in checks() {
            let mut row = Row::new();
            let mut compiler = Compiler::new();
            compiler.compile(&mut row.scene, EYE).unwrap();
            row.edit();
            if !is_cancelled_after(checks, &mut compiler, &mut row.scene) {
                assert!(checks > 10, "only {checks} places to cancel");
                break;
            }
            if deforms_back {
                row.deform_back();
            }
            compiler.compile(&mut row.scene, EYE).unwrap();
            let difference = Canonical::of(compiler.arrays()).difference(&row.compiled_anew());
            assert_eq!(difference, None, "after {checks} checks, {deforms_back}");
        }
    }
}

#[test]
fn what_was_built_before_a_compile_was_cancelled_is_not_built_again() {
    // On one thread the geometries are built in order, and the checks are counted in order.
    let one_thread = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    one_thread.install(|| {
        let mut row = Row::of([BlasKind::default(); 4]);
        let mut compiler = Compiler::new();
        // Half of the checks that all needs: no attempt would end if all was built anew.
        let checks_of_all = checks().find(|&n| !is_cancelled_after(n, &mut Compiler::new(), &mut row.scene)).unwrap();
        let attempts = (0..100).find(|_| !is_cancelled_after(checks_of_all / 2, &mut compiler, &mut row.scene));
        assert!(attempts.is_some_and(|attempts| attempts > 0), "{attempts:?}");
    });
}

#[test]
fn a_build_that_is_cancelled_anywhere_returns_the_error() {
    for structure in STRUCTURES {
        let params = BlasBuildParams::new(structure);
        let expected = Blas::build(&ball(), &params).unwrap();
        for checks in checks() {
            match Blas::build_with_cancel(&ball(), &params, &Cancel::after_checks(checks)) {
                Err(error) => assert_eq!(error, Error::Cancelled),
                Ok(blas) => {
                    assert_eq!(blas, expected);
                    assert!(checks > 5, "{structure:?}: only {checks} places to cancel");
                    break;
                }
            }
        }
    }
}
