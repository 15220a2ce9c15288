//! The columns of the table.

use glam::Vec3;
use ropewalk::graph::{BlasKind, Quality};
use ropewalk_bench::columns::{Column, Executor, Hit, PEERS, Placed, Traced, peer};
use ropewalk_bench::embree::Embree;
use ropewalk_bench::exact::{Oracle, Truth, widened};
use ropewalk_bench::{Options, Result};

use crate::row::{Row, Subject};
use crate::tally::{Cell, Tally, is_finite};

/// Our executors over one scene, by their names in the table. The first is what the others are compared with.
pub const EXECUTORS: [(&str, Executor); 6] = [
    ("cpu", Executor::Cpu),
    ("rope", Executor::EmulatedRope),
    ("wide", Executor::EmulatedWide),
    ("recursive", Executor::Recursive),
    ("batches", Executor::Batches),
    ("queries", Executor::Queries),
];

/// The bottom-level structures besides the default, traced by `cpu`.
pub const STRUCTURES: [(&str, BlasKind); 3] = [
    ("cpu, low", BlasKind::Bvh(Quality::Low)),
    ("cpu, high", BlasKind::Bvh(Quality::High)),
    ("cpu, kd-tree", BlasKind::KdTree),
];

/// The name of the executor `gpu` in the table.
pub const GPU: &str = "gpu";

/// What is opened once for all rows.
pub struct Tracers {
    embree: std::result::Result<Embree, String>,
    #[cfg(feature = "gpu")]
    options: Options,
}

/// A row as it is judged.
struct Judge<'a> {
    row: &'a Row,
    oracle: Oracle,
    truths: Vec<Truth>,
    cells: Vec<Cell>,
    /// The hits of the column that others are compared with.
    reference: Option<Vec<Hit>>,
}

impl Tracers {
    pub fn open(options: &Options) -> Self {
        #[cfg(not(feature = "gpu"))]
        let _ = options;
        Self {
            embree: Embree::open(0).map_err(|error| error.to_string()),
            #[cfg(feature = "gpu")]
            options: options.clone(),
        }
    }

    /// Which columns cannot be measured here.
    pub fn missing(&self) -> Option<String> {
        self.embree.as_ref().err().map(|error| format!("The columns of Embree are empty: {error}"))
    }

    /// All columns of a row.
    ///
    /// # Errors
    /// One of our scenes cannot be compiled.
    pub fn measure(&self, row: &Row) -> Result<Vec<Cell>> {
        let (placed, triangles) = match &row.subject {
            Subject::Triangles(triangles) => (None, widened(triangles)),
            Subject::Scene(placed, triangles) | Subject::Far(placed, triangles) => (Some(placed), triangles.clone()),
            Subject::Counted(faults, _) => {
                let cell = |&(tracer, faults)| Cell {
                    tracer,
                    tally: Tally { wrong_triangles: faults, ..Tally::default() },
                    first_fault: None,
                    remark: "counted by the row".to_owned(),
                };
                return Ok(faults.iter().map(cell).collect());
            }
        };
        let oracle = Oracle::new(triangles, row.ends);
        let truths = oracle.truths(&row.traced);
        let mut judge = Judge { row, oracle, truths, cells: Vec::new(), reference: None };
        if let Subject::Triangles(triangles) = &row.subject {
            let default = Placed::of_triangles(triangles, None)?;
            self.measure_gpu(&mut judge, &default);
            judge.executors(&default, &EXECUTORS);
            for (name, kind) in STRUCTURES {
                judge.executors(&Placed::of_triangles(triangles, kind)?, &[(name, Executor::Cpu)]);
            }
            self.measure_peers(&mut judge, triangles);
        } else if let Some(placed) = placed {
            let is_far = matches!(row.subject, Subject::Far(..));
            if !is_far {
                self.measure_gpu(&mut judge, placed);
            }
            judge.executors(placed, if is_far { &EXECUTORS[4..] } else { &EXECUTORS });
        }
        Ok(judge.cells)
    }

    fn measure_peers(&self, judge: &mut Judge<'_>, triangles: &[[Vec3; 3]]) {
        let embree = self.embree.as_ref().map_err(String::as_str);
        for name in PEERS {
            let traced = peer(name, triangles, embree).and_then(|column| column.closest(&judge.row.traced));
            judge.add(name, traced);
        }
    }

    #[cfg(feature = "gpu")]
    fn measure_gpu(&self, judge: &mut Judge<'_>, placed: &Placed) {
        let traced = ropewalk_bench::gpu::open(&self.options)
            .and_then(|tracer| ropewalk_bench::columns::TracedByGpu::new(tracer, placed).closest(&judge.row.traced));
        judge.add(GPU, traced);
    }

    #[cfg(not(feature = "gpu"))]
    #[expect(clippy::unused_self, reason = "with the feature it uses the options")]
    fn measure_gpu(&self, _: &mut Judge<'_>, _: &Placed) {}
}

impl Judge<'_> {
    fn executors(&mut self, placed: &Placed, executors: &[(&'static str, Executor)]) {
        for &(name, executor) in executors {
            self.add(name, Traced(executor, placed).closest(&self.row.traced));
        }
    }

    fn add(&mut self, tracer: &'static str, traced: Result<Vec<Hit>>) {
        let (mut tally, mut first_fault, mut remark) = (Tally::default(), None, String::new());
        match traced {
            Ok(hits) => {
                tally = Tally::of(&self.oracle, &self.row.traced, &self.truths, &hits);
                if tally.faults() > 0 {
                    first_fault = Tally::first_fault(&self.oracle, &self.row.traced, &self.truths, &hits);
                }
                let is_compared = !PEERS.contains(&tracer) && !["batches", "queries", GPU].contains(&tracer);
                tally.differs = self.reference.as_ref().filter(|_| is_compared).map(|reference| {
                    let pairs = self.row.traced.iter().zip(reference.iter().zip(&hits));
                    pairs.filter(|(ray, (ours, theirs))| is_finite(ray) && ours != theirs).count() as u64
                });
                if tracer == EXECUTORS[0].0 {
                    self.reference = Some(hits);
                }
            }
            Err(error) => remark = error.to_string(),
        }
        self.cells.push(Cell { tracer, tally, first_fault, remark });
    }
}
