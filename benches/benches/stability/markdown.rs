//! The tables as they are in docs/STABILITY.md.

use crate::limits::Limit;
use crate::row::Goal;
use crate::tally::{Cell, Tally};

type Line = (&'static str, usize, Goal, Vec<Cell>);

/// All tables: faults, errors of t, differences between our columns, limits.
pub fn tables(rows: &[Line], limits: &[Limit]) -> String {
    let mut columns: Vec<&'static str> = Vec::new();
    for cell in rows.iter().flat_map(|(.., cells)| cells) {
        if !columns.contains(&cell.tracer) {
            columns.push(cell.tracer);
        }
    }
    let faults = table(rows, &columns, |tally| {
        let Tally { false_misses, false_hits, wrong_triangles, .. } = tally;
        if tally.faults() == 0 { "0".to_owned() } else { format!("{false_misses}/{false_hits}/{wrong_triangles}") }
    });
    let errors = table(rows, &columns, |tally| match tally.worst_t {
        0.0 => "0".to_owned(),
        worst => format!("{worst:.0e}"),
    });
    let is_compared = |column: &&&str| {
        rows.iter().flat_map(|(.., cells)| cells).any(|cell| cell.tracer == **column && cell.tally.differs.is_some())
    };
    let compared: Vec<&'static str> = columns.iter().filter(is_compared).copied().collect();
    let differences = table(rows, &compared, |tally| tally.differs.map_or(String::new(), |count| count.to_string()));
    let limits: String = limits.iter().map(|limit| limit.line()).collect();
    format!(
        "## Faults\n\n{faults}\n## Greatest error of t\n\n{errors}\n## Hits that differ from those of `cpu`\n\n\
         {differences}\n## Limits\n\n| input | error |\n|---|---|\n{limits}"
    )
}

fn table(rows: &[Line], columns: &[&'static str], text: impl Fn(&Tally) -> String) -> String {
    let mut table = format!("| case | rays | {} |\n|---|--:|{}\n", columns.join(" | "), "--:|".repeat(columns.len()));
    for (name, rays, goal, cells) in rows {
        let cell = |column: &&str| {
            let cell = cells.iter().find(|cell| cell.tracer == *column);
            cell.map_or(String::new(), |cell| if is_asked(cell) { text(&cell.tally) } else { "-".to_owned() })
        };
        if columns.iter().map(cell).all(|text| text.is_empty()) {
            continue;
        }
        let mark = match goal {
            Goal::Zero => "",
            Goal::NoLeaks => " (t)",
            Goal::Open => " (open)",
        };
        let cells: Vec<String> = columns.iter().map(cell).collect();
        table += &format!("| {name}{mark} | {rays} | {} |\n", cells.join(" | "));
    }
    table
}

/// Whether the tracer has answered.
fn is_asked(cell: &Cell) -> bool {
    cell.remark.is_empty() || cell.tally != Tally::default() || cell.remark == "counted by the row"
}
