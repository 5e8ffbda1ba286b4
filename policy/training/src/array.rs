//! A parameter.

/// A named matrix.
#[derive(Clone, Debug, PartialEq)]
pub struct Array {
    /// Name in files.
    pub name: String,
    /// Rows and columns; a bias has one row.
    pub shape: [usize; 2],
    /// Row by row.
    pub values: Vec<f32>,
}
