//! A row of the table: triangles and rays, and how to make them.

use glam::{DVec3, Vec3};
use ropewalk::device::layout::RayRecord;
use ropewalk_bench::Result;
use ropewalk_bench::columns::Placed;
use ropewalk_bench::exact::Ends;

/// A row before it is made.
pub struct Recipe {
    pub name: &'static str,
    pub goal: Goal,
    /// Makes the row, of at most so many rays.
    pub make: fn(usize) -> Result<Row>,
}

/// Whether our columns must be free of faults.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Goal {
    Zero,
    /// No false misses and no false hits. Triangles may be wrong where rays graze them, since f32 does not know their
    /// order: `docs/STABILITY.md` says more.
    NoLeaks,
    /// Known not to be free of them: `docs/STABILITY.md` says why.
    Open,
}

/// What rays are traced through.
pub enum Subject {
    /// One mesh, for all columns.
    Triangles(Vec<[Vec3; 3]>),
    /// A scene of ours, and the same triangles in the space of the rays, for our columns. Peers have none of what it is
    /// about.
    Scene(Box<Placed>, Vec<[DVec3; 3]>),
    /// A scene whose rays f32 cannot hold in the space of the scene: for our batches and queries, which take f64.
    Far(Box<Placed>, Vec<[DVec3; 3]>),
    /// Faults that the row has counted by itself, by column.
    Counted(Vec<(&'static str, u64)>, usize),
}

/// A row.
pub struct Row {
    pub subject: Subject,
    pub traced: Vec<RayRecord>,
    pub ends: Ends,
}

impl Row {
    /// Rays through triangles, without faults of ours.
    pub fn new(triangles: Vec<[Vec3; 3]>, traced: Vec<RayRecord>) -> Self {
        Self { subject: Subject::Triangles(triangles), traced, ends: Ends::Open }
    }

    /// Rays through a scene of ours.
    pub fn of_scene(placed: Placed, triangles: Vec<[DVec3; 3]>, traced: Vec<RayRecord>) -> Self {
        Self { subject: Subject::Scene(Box::new(placed), triangles), traced, ends: Ends::Open }
    }

    /// Faults by column, counted among so many trials.
    pub fn counted(faults: Vec<(&'static str, u64)>, trials: usize) -> Self {
        Self { subject: Subject::Counted(faults, trials), traced: Vec::new(), ends: Ends::Open }
    }

    /// The number of rays or trials.
    pub fn rays(&self) -> usize {
        if let Subject::Counted(_, trials) = self.subject { trials } else { self.traced.len() }
    }
}
