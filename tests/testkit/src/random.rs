//! Random numbers that are the same on every machine.

use glam::Vec3;

/// A sequence of random numbers that its seed determines.
pub struct Random(fastrand::Rng);

impl Random {
    /// The sequence of a seed.
    pub fn new(seed: u64) -> Self {
        Self(fastrand::Rng::with_seed(seed))
    }

    /// Any 64 bits.
    pub fn bits(&mut self) -> u64 {
        self.0.u64(..)
    }

    /// An index below `end`, which is at least 1.
    pub fn index(&mut self, end: usize) -> usize {
        self.0.usize(..end)
    }

    /// From 0 to 1, below 1.
    pub fn unsigned(&mut self) -> f32 {
        self.0.f32()
    }

    /// From -1 to 1, below 1.
    pub fn signed(&mut self) -> f32 {
        self.unsigned() * 2.0 - 1.0
    }

    /// A point in the cube from -1 to 1.
    pub fn in_cube(&mut self) -> Vec3 {
        Vec3::new(self.signed(), self.signed(), self.signed())
    }

    /// A unit vector, any direction as likely as any other.
    pub fn direction(&mut self) -> Vec3 {
        loop {
            let v = self.in_cube();
            if (0.01..=1.0).contains(&v.length_squared()) {
                return v.normalize();
            }
        }
    }
}
