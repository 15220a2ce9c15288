//! Finding nodes: by name, by path, by the geometry or material that they use.

use super::{Core, GeometryKey, MaterialKey, NodeKey, Scene};
use crate::Result;

/// Finding nodes.
impl Scene {
    /// The first node in preorder that has this name. O(nodes).
    pub fn find(&self, name: &str) -> Option<NodeKey> {
        self.find_all(name).next()
    }

    /// All nodes that have this name, in preorder. O(nodes).
    pub fn find_all<'a>(&'a self, name: &'a str) -> impl Iterator<Item = NodeKey> + 'a {
        let all = self.subtree(self.root).into_iter().flatten();
        all.filter(move |&node| *self.nodes[node].name == *name)
    }

    /// Follows a path of names from `top`: each name selects a child. An empty path is `top` itself. If siblings share
    /// a name, all are tried (backtracking), and the first match in preorder is returned. O(children of the nodes
    /// tried).
    ///
    /// ```
    /// use ropewalk::{Scene, Transform};
    ///
    /// let mut scene = Scene::new();
    /// let arm = scene.add(scene.root(), Transform::IDENTITY)?;
    /// let hand = scene.add(arm, Transform::IDENTITY)?;
    /// scene.set_name(arm, "arm")?;
    /// scene.set_name(hand, "hand")?;
    ///
    /// assert_eq!(scene.find_path(scene.root(), "arm/hand".split('/'))?, Some(hand));
    /// // A name may contain the separator: it is one segment.
    /// assert_eq!(scene.find_path(scene.root(), ["arm", "left/right"])?, None);
    /// assert_eq!(scene.path_of(hand)?.join("/"), "arm/hand");
    /// # Ok::<(), ropewalk::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::StaleKey`](crate::Error::StaleKey).
    pub fn find_path<S: AsRef<str>>(
        &self,
        top: NodeKey,
        names: impl IntoIterator<Item = S>,
    ) -> Result<Option<NodeKey>> {
        let mut candidate = self.node(top)?.first_child;
        let names: Vec<S> = names.into_iter().collect();
        // Backtracking search: `depth` names lead from `top` to `parent`, whose children are the candidates for the
        // next name, from `candidate` on.
        let mut depth = 0;
        let mut parent = top;
        while depth < names.len() {
            match candidate {
                // A match: descend to its children.
                Some(node) if *self.nodes[node].name == *names[depth].as_ref() => {
                    (parent, candidate) = (node, self.nodes[node].first_child);
                    depth += 1;
                }
                Some(node) => candidate = self.nodes[node].next_sibling,
                None if depth == 0 => return Ok(None),
                // No candidate left: backtrack to the parent's next sibling.
                None => {
                    let Some(above) = self.nodes[parent].parent else { return Ok(None) };
                    (parent, candidate) = (above, self.nodes[parent].next_sibling);
                    depth -= 1;
                }
            }
        }
        Ok(Some(parent))
    }

    /// The names on the path from the root down to the node: the root's own is left out, the node's is last.
    /// [`find_path`](Self::find_path) from the root with these names finds this node, or an earlier one with the same
    /// path. O(depth).
    ///
    /// # Errors
    /// [`Error::StaleKey`](crate::Error::StaleKey).
    pub fn path_of(&self, node: NodeKey) -> Result<Vec<&str>> {
        let path = std::iter::once(node).chain(self.ancestors(node)?);
        let mut names: Vec<&str> = path.filter(|&node| node != self.root).map(|node| &*self.nodes[node].name).collect();
        names.reverse();
        Ok(names)
    }

    /// The nodes whose core uses this geometry, in no particular order. O(cores + nodes found).
    ///
    /// # Errors
    /// [`Error::StaleKey`](crate::Error::StaleKey).
    pub fn geometry_users(&self, key: GeometryKey) -> Result<impl Iterator<Item = NodeKey>> {
        self.geometry(key)?;
        Ok(self.users_of(move |core| core.geometry() == Some(key)))
    }

    /// The nodes whose core uses this material, material groups included, in no particular order. O(cores + nodes
    /// found).
    ///
    /// # Errors
    /// [`Error::StaleKey`](crate::Error::StaleKey).
    pub fn material_users(&self, key: MaterialKey) -> Result<impl Iterator<Item = NodeKey>> {
        self.material(key)?;
        Ok(self.users_of(move |core| core.material() == Some(key)))
    }

    fn users_of(&self, uses: impl Fn(&Core) -> bool) -> impl Iterator<Item = NodeKey> {
        let cores = self.cores.iter().filter(move |(_, slot)| uses(&slot.core));
        cores.filter_map(|(key, _)| self.users(key).ok()).flatten()
    }
}
