//! Normal matrices of least squares.

use nalgebra::DMatrix;

/// Directions of parameters that the data sees less than this, of what it sees of one alone, are left at rest: steps
/// along them would be large and say nothing.
const LEAST_SEEN: f64 = 1e-3;

/// Inverse of a normal matrix, with directions that the data says nothing about left at rest.
pub(crate) fn inverse(normal: &DMatrix<f64>) -> DMatrix<f64> {
    let n = normal.nrows();
    // Scaled to a unit diagonal first: parameters have units.
    let scale: Vec<f64> =
        (0..n).map(|i| if normal[(i, i)] > 0.0 { normal[(i, i)].sqrt().recip() } else { 0.0 }).collect();
    let scaled = DMatrix::from_fn(n, n, |i, j| normal[(i, j)] * scale[i] * scale[j]);
    let eigen = scaled.symmetric_eigen();
    let mut inverse = DMatrix::zeros(n, n);
    for (idx, &value) in eigen.eigenvalues.iter().enumerate() {
        if value > LEAST_SEEN {
            let vector = eigen.eigenvectors.column(idx);
            inverse += vector * vector.transpose() / value;
        }
    }
    DMatrix::from_fn(n, n, |i, j| inverse[(i, j)] * scale[i] * scale[j])
}
