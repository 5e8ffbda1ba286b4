//! Parameters.

use crate::seed::{fill_normal, generator};

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

/// Makes first parameters one after the other. Each array has a generator of its own: seed, purpose, and how many came
/// before.
#[derive(Clone, Debug)]
pub struct ArrayBuilder {
    arrays: Vec<Array>,
    seed: u64,
    purpose: u64,
}

impl ArrayBuilder {
    /// Nothing yet. `purpose` tells this noise from other noise of a training ([`generator`]).
    pub fn new(seed: u64, purpose: u64) -> Self {
        Self { arrays: Vec::new(), seed, purpose }
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.arrays.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.arrays.is_empty()
    }

    /// All of them.
    pub fn into_arrays(self) -> Vec<Array> {
        self.arrays
    }

    /// Adds normal numbers with standard deviation `std`.
    pub fn normal(&mut self, name: String, shape: [usize; 2], std: f32) {
        let mut values = vec![0.0; shape[0] * shape[1]];
        fill_normal(&mut generator(self.seed, self.purpose, self.arrays.len() as u64, 0), &mut values);
        values.iter_mut().for_each(|value| *value *= std);
        self.arrays.push(Array { name, shape, values });
    }

    /// Adds one row.
    pub fn row(&mut self, name: String, values: Vec<f32>) {
        self.arrays.push(Array { name, shape: [1, values.len()], values });
    }

    /// Adds one row of `len` times `value`.
    pub fn constant(&mut self, name: String, len: usize, value: f32) {
        self.row(name, vec![value; len]);
    }

    /// Adds `NAME.weight`, normal with variance `1 / inputs`, and `NAME.bias`, zeros.
    pub fn linear(&mut self, name: &str, inputs: usize, outputs: usize) {
        self.normal(format!("{name}.weight"), [inputs, outputs], (inputs as f32).sqrt().recip());
        self.constant(format!("{name}.bias"), outputs, 0.0);
    }

    /// Adds `NAME.gain`, ones, and `NAME.bias`, zeros.
    pub fn norm(&mut self, name: &str, width: usize) {
        self.constant(format!("{name}.gain"), width, 1.0);
        self.constant(format!("{name}.bias"), width, 0.0);
    }
}
