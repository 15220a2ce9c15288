//! The tree of nodes. Only visible rows are laid out, and only expanded nodes are traversed.

use std::collections::HashSet;

use egui::{Align2, Color32, FontId, Rect, Response, ScrollArea, Sense, TextEdit, Ui, pos2, vec2};
use ropewalk::graph::{Change, ChangeCursor, Changes, ObjectKey};
use ropewalk::{NodeKey, Scene};

use crate::app::App;
use crate::edit::Edit;
use crate::{node_icons, theme};

const ROW_HEIGHT: f32 = 20.0;
const INDENT: f32 = 12.0;
/// Deeper rows are not indented further.
const MAX_INDENTS: usize = 14;

/// The expanded nodes, and the rows that follow from them.
#[derive(Default)]
pub(crate) struct TreePanel {
    expanded: HashSet<NodeKey>,
    filter: String,
    rows: Vec<Row>,
    /// Position in the change log up to which the rows are current.
    cursor: ChangeCursor,
    /// The filter for which the rows were listed.
    listed_filter: String,
    is_stale: bool,
    /// The selection to which the tree was last scrolled.
    revealed: Option<NodeKey>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Row {
    node: NodeKey,
    depth: usize,
}

impl TreePanel {
    pub(crate) fn show(&mut self, ui: &mut Ui, app: &mut App) {
        ui.horizontal(|ui| {
            ui.strong("Nodes");
            ui.weak(app.scene.node_count().to_string());
            ui.add(TextEdit::singleline(&mut self.filter).hint_text("find by name").desired_width(f32::INFINITY));
        });
        ui.add_space(4.0);

        let revealed = self.reveal(app);
        self.list(&mut app.scene);
        ui.spacing_mut().item_spacing.y = 0.0;
        let mut area = ScrollArea::vertical().auto_shrink(false);
        if let Some(row) = revealed.and_then(|node| self.rows.iter().position(|row| row.node == node)) {
            let above = (ui.available_height() - ROW_HEIGHT) * 0.5;
            area = area.vertical_scroll_offset((row as f32 * ROW_HEIGHT - above).max(0.0));
        }
        area.show_rows(ui, ROW_HEIGHT, self.rows.len(), |ui, range| {
            for index in range {
                if let Some(&row) = self.rows.get(index) {
                    self.row(ui, app, row);
                }
            }
        });
    }

    /// Expands the ancestors of a new selection, and returns it, to be scrolled to.
    fn reveal(&mut self, app: &App) -> Option<NodeKey> {
        if self.revealed == app.selection() {
            return None;
        }
        self.revealed = app.selection();
        let node = self.revealed?;
        for ancestor in app.scene.ancestors(node).into_iter().flatten() {
            self.is_stale |= self.expanded.insert(ancestor);
        }
        Some(node)
    }

    /// Lists the rows again if the tree, the expanded nodes or the filter have changed.
    fn list(&mut self, scene: &mut Scene) {
        match scene.changes_since(&mut self.cursor) {
            Changes::Everything => {
                self.expanded = HashSet::from([scene.root()]);
                self.is_stale = true;
            }
            Changes::Since(changes) => self.is_stale |= changes.iter().any(changes_rows),
        }
        if std::mem::take(&mut self.is_stale) || self.listed_filter != self.filter {
            self.listed_filter.clone_from(&self.filter);
            self.expanded.retain(|&node| scene.contains(node));
            self.rows = if self.filter.is_empty() { tree(scene, &self.expanded) } else { found(scene, &self.filter) };
        }
    }

    fn row(&mut self, ui: &mut Ui, app: &mut App, Row { node, depth }: Row) {
        let (rect, response) = ui.allocate_exact_size(vec2(ui.available_width(), ROW_HEIGHT), Sense::click());
        let (Ok(core), Ok(name), Ok(is_visible)) =
            (app.scene.node_core(node), app.scene.name(node), app.scene.is_visible(node))
        else {
            return;
        };
        let is_root = node == app.scene.root();
        let label = if is_root && name.is_empty() {
            "scene"
        } else if name.is_empty() {
            core.kind().name()
        } else {
            name
        };
        let has_children = app.scene.children(node).is_ok_and(|mut children| children.next().is_some());
        let is_selected = app.selection() == Some(node);

        let painter = ui.painter_at(rect);
        if is_selected || response.hovered() {
            let fill = if is_selected { theme::SELECTED } else { theme::HOVERED };
            painter.rect_filled(rect, 3.0, fill);
        }
        let opacity = if is_visible { 1.0 } else { 0.4 };
        let text_color = if name.is_empty() && !is_selected { theme::WEAK } else { theme::TEXT };
        let text_color = text_color.gamma_multiply(opacity);
        let x = rect.left() + 14.0 + depth.min(MAX_INDENTS) as f32 * INDENT;
        let font = FontId::proportional(13.0);
        let at = |x: f32| pos2(x, rect.center().y);
        node_icons::paint(&painter, at(x + 6.0), core.kind(), opacity);
        painter.text(at(x + 18.0), Align2::LEFT_CENTER, label, font, text_color);

        let eye = Rect::from_center_size(at(rect.right() - 14.0), vec2(20.0, ROW_HEIGHT));
        if eye_button(ui, eye, node, is_visible, response.hovered()).clicked() {
            app.edit(Edit::Show(node, !is_visible));
        }
        if has_children && self.filter.is_empty() {
            let triangle = Rect::from_center_size(at(x - 8.0), vec2(16.0, ROW_HEIGHT));
            self.triangle(ui, triangle, node);
        }
        if response.clicked() {
            self.revealed = Some(node);
            app.select(Some(node));
        }
        if response.double_clicked() {
            self.toggle(node);
        }
    }

    fn triangle(&mut self, ui: &Ui, rect: Rect, node: NodeKey) {
        let response = ui.interact(rect, ui.scope_id().with(("expand", node)), Sense::click());
        let color = if response.hovered() { theme::TEXT } else { theme::WEAK };
        let center = rect.center();
        let points = if self.expanded.contains(&node) {
            [vec2(-4.0, -2.0), vec2(4.0, -2.0), vec2(0.0, 3.0)]
        } else {
            [vec2(-2.0, -4.0), vec2(3.0, 0.0), vec2(-2.0, 4.0)]
        };
        let points = points.map(|offset| center + offset).to_vec();
        ui.painter().add(egui::Shape::convex_polygon(points, color, egui::Stroke::NONE));
        if response.clicked() {
            self.toggle(node);
        }
    }

    fn toggle(&mut self, node: NodeKey) {
        if !self.expanded.remove(&node) {
            self.expanded.insert(node);
        }
        self.is_stale = true;
    }
}

/// Shows or hides a node; faint until the pointer is near, unless the node is hidden.
fn eye_button(ui: &Ui, rect: Rect, node: NodeKey, is_visible: bool, is_near: bool) -> Response {
    let response = ui.interact(rect, ui.scope_id().with(("eye", node)), Sense::click());
    let color = match (is_visible, is_near || response.hovered()) {
        (true, false) => Color32::TRANSPARENT,
        (true, true) => theme::WEAK,
        (false, _) => theme::ACCENT,
    };
    node_icons::eye(ui.painter(), rect.center(), is_visible, color);
    response.on_hover_text(if is_visible { "Hide" } else { "Show" })
}

/// Whether a change may add, remove or move rows.
fn changes_rows((object, change): &(ObjectKey, Change)) -> bool {
    matches!(object, ObjectKey::Node(_)) && change.intersects(Change::ADDED | Change::REMOVED | Change::PARENT)
}

/// The expanded part of the tree, in preorder. O(rows).
fn tree(scene: &Scene, expanded: &HashSet<NodeKey>) -> Vec<Row> {
    let mut rows = Vec::new();
    let mut pending = vec![Row { node: scene.root(), depth: 0 }];
    while let Some(row) = pending.pop() {
        rows.push(row);
        if expanded.contains(&row.node) {
            let first = pending.len();
            let children = scene.children(row.node).into_iter().flatten();
            pending.extend(children.map(|node| Row { node, depth: row.depth + 1 }));
            pending[first..].reverse();
        }
    }
    rows
}

/// The nodes whose names contain the text, and those without a name whose kind is the text. O(nodes).
fn found(scene: &Scene, text: &str) -> Vec<Row> {
    let text = text.to_lowercase();
    let matches = |node: &NodeKey| {
        let kind = scene.node_core(*node).map_or("", |core| core.kind().name());
        scene.name(*node).is_ok_and(|name| name.to_lowercase().contains(&text) || name.is_empty() && kind == text)
    };
    let nodes = scene.subtree(scene.root()).into_iter().flatten();
    nodes.filter(matches).map(|node| Row { node, depth: 0 }).collect()
}

#[cfg(test)]
mod tests {
    use ropewalk::Core;

    use super::*;

    /// A scene with a node of `count` children, and a chain of `count` nodes.
    fn large(count: usize) -> (Scene, Vec<NodeKey>) {
        let mut scene = Scene::new();
        let wide = scene.add(scene.root(), Core::Group).unwrap();
        for _ in 0..count {
            scene.add(wide, Core::Group).unwrap();
        }
        let mut chain = vec![scene.root()];
        for i in 0..count {
            let node = scene.add(chain[i], Core::Group).unwrap();
            chain.push(node);
        }
        scene.set_name(chain[count], "end of the chain").unwrap();
        (scene, chain)
    }

    #[test]
    fn rows_are_the_preorder_of_what_is_expanded() {
        let (scene, chain) = large(100_000);
        assert_eq!(tree(&scene, &HashSet::new()).len(), 1);
        assert_eq!(tree(&scene, &HashSet::from([scene.root()])).len(), 3);

        let all: HashSet<_> = scene.subtree(scene.root()).unwrap().collect();
        let rows = tree(&scene, &all);
        assert!(rows.iter().map(|row| row.node).eq(scene.subtree(scene.root()).unwrap()));
        assert_eq!(rows.last(), Some(&Row { node: chain[100_000], depth: 100_000 }));
    }

    #[test]
    fn rows_are_listed_again_only_if_the_tree_changes() {
        let (mut scene, chain) = large(10);
        let mut panel = TreePanel::default();
        panel.list(&mut scene);
        let marked = Row { node: chain[3], depth: 77 };
        panel.rows.push(marked);
        scene.set_name(chain[1], "other").unwrap();
        panel.list(&mut scene);
        assert_eq!(panel.rows.last(), Some(&marked), "a changed name does not list the rows again");
        scene.add(chain[1], Core::Group).unwrap();
        panel.list(&mut scene);
        assert_eq!(panel.rows.len(), 3);
    }

    #[test]
    fn nodes_are_found_by_a_part_of_their_name() {
        let (scene, chain) = large(100);
        assert_eq!(found(&scene, "OF THE"), [Row { node: chain[100], depth: 0 }]);
        assert_eq!(found(&scene, "light"), []);
    }
}
