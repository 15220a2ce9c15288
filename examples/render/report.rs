//! The report of a run: what was done and how long it took, as tables or as JSON.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::time::Duration;

use comfy_table::Table;
use comfy_table::presets::UTF8_FULL_CONDENSED;
use ropewalk::FrameReport;
use ropewalk::compile::CompileReport;
use ropewalk::gltf::{ImportCounts, ImportWarning, UnlistedWarnings};
use serde::{Serialize, Serializer};

use crate::one_line;

/// One run of the program. Times are in seconds.
#[derive(Serialize)]
pub(crate) struct Report {
    /// The file rendered; none for the built-in scene.
    pub(crate) file: Option<PathBuf>,
    /// How much the file added to the scene.
    pub(crate) import: Option<ImportCounts>,
    /// What in the file is unsupported, only approximated, corrected or replaced.
    pub(crate) warnings: Vec<ImportWarning>,
    /// How many more there are than are listed.
    pub(crate) unlisted_warnings: Vec<UnlistedWarnings>,
    /// Why the CPU was used although a GPU is preferred.
    pub(crate) fallback: Option<String>,
    /// Time to read the file or make the scene.
    #[serde(serialize_with = "seconds")]
    pub(crate) load_time: Duration,
    pub(crate) nodes: usize,
    pub(crate) geometries: usize,
    /// Pixels of each image.
    pub(crate) size: (u32, u32),
    /// Rays along each side of a pixel.
    pub(crate) samples: u32,
    pub(crate) frames: Vec<FrameEntry>,
}

/// One image.
#[derive(Serialize)]
pub(crate) struct FrameEntry {
    pub(crate) output: PathBuf,
    #[serde(flatten)]
    pub(crate) report: FrameReport,
    /// Pixels that needed more rays than `--max-rays`.
    pub(crate) limited_pixels: u64,
    /// Time to read the frame back, after the call that renders it.
    #[serde(serialize_with = "seconds")]
    pub(crate) read_time: Duration,
    /// Time to average the samples and write the file.
    #[serde(serialize_with = "seconds")]
    pub(crate) save_time: Duration,
}

impl Report {
    /// Two tables: the scene; and the time of each phase in the first frame and in the later ones.
    pub(crate) fn to_tables(&self) -> String {
        let Some((first, later)) = self.frames.split_first() else { return String::new() };
        format!("{}\n{}", self.scene_table(first), phase_table(first, later))
    }

    /// The whole report as JSON.
    pub(crate) fn to_json(&self) -> Result<String, serde_json::Error> {
        serde_json::to_string_pretty(self)
    }

    fn scene_table(&self, FrameEntry { report: first, limited_pixels, .. }: &FrameEntry) -> Table {
        let compile = &first.compile;
        let needs: Vec<_> = compile.needs.iter_names().map(|(name, _)| name.to_lowercase().replace('_', " ")).collect();
        let rays = u64::from(self.size.0) * u64::from(self.size.1) * u64::from(self.samples * self.samples);

        let mut table = Table::new();
        table.load_style(UTF8_FULL_CONDENSED);
        table.set_header([
            "scene",
            &self.file.as_ref().map_or("built-in".into(), |file| one_line(&file.display().to_string())),
        ]);
        table.add_rows([
            ["device", &format!("{} ({})", first.device.executor, first.device.name)],
            ["image", &format!("{}x{}, {rays} primary rays", self.size.0, self.size.1)],
            ["pixels that needed more rays", &limited_pixels.to_string()],
            ["nodes", &self.nodes.to_string()],
            ["geometries", &format!("{}, {} triangles", self.geometries, compile.unique_triangles)],
            ["instances", &format!("{}, {} triangles", compile.instances, compile.instanced_triangles)],
            ["of these, coinciding with others", &compile.coincident_instances.to_string()],
            ["instances that no ray can hit", &compile.unhittable_instances.to_string()],
            ["displaced by their shear", &displaced(compile)],
            [
                "materials, textures, lights",
                &format!("{}, {}, {}", compile.materials, compile.textures, compile.lights),
            ],
            ["in use", &needs.join(", ")],
            ["device memory", &format!("{:.1} MiB", compile.device_bytes as f64 / f64::from(1 << 20))],
            ["load", &milliseconds(self.load_time)],
        ]);
        table
    }
}

/// How many instances f32 displaces, and how far.
fn displaced(compile: &CompileReport) -> String {
    match compile.displaced_instances {
        0 => "0".to_owned(),
        count => format!("{count}, by up to {:.1e} of their coordinates", compile.greatest_displacement),
    }
}

/// A line for each warning about a file, in their order. Of those of one kind, only the first ten are there; if there
/// are more, listed in the report or counted there, a line after them tells how many.
pub(crate) fn warning_lines(file: &Path, warnings: &[ImportWarning], unlisted: &[UnlistedWarnings]) -> Vec<String> {
    const SHOWN: usize = 10;

    let file = file.file_name().map_or_else(|| file.to_string_lossy(), |name| name.to_string_lossy());
    let file = one_line(&file);
    // The warnings of each kind, in the order of the first ones.
    let mut kinds: Vec<Vec<&ImportWarning>> = Vec::new();
    let mut kind_index = HashMap::new();
    for warning in warnings {
        let index = *kind_index.entry((warning.kind, &*warning.feature)).or_insert_with(|| {
            kinds.push(Vec::new());
            kinds.len() - 1
        });
        kinds[index].push(warning);
    }
    // How many of each kind the report only counts; those of kinds that it does not list are told of at the end.
    let mut counted = vec![0; kinds.len()];
    let mut others = Vec::new();
    for more in unlisted {
        match kind_index.get(&(more.kind, &*more.feature)) {
            Some(&index) => counted[index] += more.count,
            None => others.push(format!("note: {file}: {more}")),
        }
    }
    let mut lines = Vec::new();
    for (alike, counted) in kinds.iter().zip(counted) {
        lines.extend(alike.iter().take(SHOWN).map(|warning| format!("note: {file}: {warning}")));
        let more = alike.len().saturating_sub(SHOWN) + counted;
        if more > 0 {
            lines.push(format!("note: {file}: ... and {more} more of this kind"));
        }
    }
    lines.extend(others);
    lines
}

/// A row of the table of phases.
struct Phase {
    name: &'static str,
    time: fn(&FrameEntry) -> Duration,
    /// What the first frame did in this phase, in words.
    done: String,
}

fn phases(first: &FrameEntry) -> [Phase; 8] {
    let phase = |name, time, done| Phase { name, time, done };
    let FrameReport { compile, uploaded_bytes, .. } = &first.report;
    [
        phase("update", |frame| frame.report.compile.update_time, String::new()),
        phase("BLAS", |frame| frame.report.compile.blas_time, format!("{} built", compile.blas_built)),
        phase("TLAS", |frame| frame.report.compile.tlas_time, compile.tlas.to_string()),
        phase("upload", |frame| frame.report.upload_time, format!("{uploaded_bytes} bytes")),
        phase("trace", |frame| frame.report.trace_time, String::new()),
        phase("read back", |frame| frame.read_time, String::new()),
        phase("save", |frame| frame.save_time, String::new()),
        phase("total", |frame| frame.report.total_time + frame.read_time + frame.save_time, String::new()),
    ]
}

fn phase_table(first: &FrameEntry, later: &[FrameEntry]) -> Table {
    let mut table = Table::new();
    table.load_style(UTF8_FULL_CONDENSED);
    let mut header = vec!["phase".to_owned(), "first frame".to_owned(), "what was done".to_owned()];
    if !later.is_empty() {
        header.push(format!("mean of {} later", later.len()));
    }
    table.set_header(header);
    for Phase { name, time, done } in phases(first) {
        let mut row = vec![name.to_owned(), milliseconds(time(first)), done];
        if !later.is_empty() {
            row.push(milliseconds(later.iter().map(time).sum::<Duration>() / later.len() as u32));
        }
        table.add_row(row);
    }
    table
}

fn milliseconds(time: Duration) -> String {
    format!("{:.2} ms", time.as_secs_f64() * 1e3)
}

fn seconds<S: Serializer>(time: &Duration, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_f64(time.as_secs_f64())
}
