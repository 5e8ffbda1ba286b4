//! One error for everything that a robot, layout, object or station file can have wrong.

/// A robot, layout, object or station file that cannot be used: where, what was expected, what to do.
#[derive(Debug, thiserror::Error)]
#[error("{file}: {place}: {problem}")]
pub struct ModelError {
    /// Which text was being read, e.g. `robot.urdf`.
    pub file: String,
    /// Where in it: a line, or `joint "joint3"`, `patch "index_tip"`.
    pub place: String,
    /// What is wrong, what was expected, and what to do about it.
    pub problem: String,
}

impl ModelError {
    /// An error at `place` in `file`.
    pub fn new(file: impl Into<String>, place: impl Into<String>, problem: impl Into<String>) -> Self {
        Self { file: file.into(), place: place.into(), problem: problem.into() }
    }
}
