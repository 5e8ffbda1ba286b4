//! Work in chunks whose bounds depend on the amount of work only, so that results have the same bits for any number
//! of threads.

/// `work(i)` for `i` in `0..num_chunks`, in order of `i`; on every core with the `batch` feature.
#[cfg(feature = "batch")]
pub(crate) fn map_chunks<T: Send>(num_chunks: usize, work: impl Fn(usize) -> T + Sync + Send) -> Vec<T> {
    use rayon::prelude::*;
    (0..num_chunks).into_par_iter().map(work).collect()
}

/// `work(i)` for `i` in `0..num_chunks`, in order of `i`.
#[cfg(not(feature = "batch"))]
pub(crate) fn map_chunks<T>(num_chunks: usize, work: impl Fn(usize) -> T) -> Vec<T> {
    (0..num_chunks).map(work).collect()
}

/// `work(i, chunk)` for the `i`-th chunk of `chunk_len` values; on every core with the `batch` feature.
#[cfg(feature = "batch")]
pub(crate) fn for_each_chunk(
    values: &mut [f64],
    chunk_len: usize,
    work: impl Fn(usize, &mut [f64]) + Sync + Send,
) {
    use rayon::prelude::*;
    values.par_chunks_mut(chunk_len).enumerate().for_each(|(i, chunk)| work(i, chunk));
}

/// `work(i, chunk)` for the `i`-th chunk of `chunk_len` values.
#[cfg(not(feature = "batch"))]
pub(crate) fn for_each_chunk(values: &mut [f64], chunk_len: usize, work: impl Fn(usize, &mut [f64])) {
    values.chunks_mut(chunk_len).enumerate().for_each(|(i, chunk)| work(i, chunk));
}
