//! How the rows of several takes are numbered, and responses over them.

use std::ops::Range;

use nalgebra::{DMatrix, DVector};

use super::Domain;

/// The response of all rows to one unit of a parameter, where it is not zero.
#[derive(Clone, Debug, Default)]
pub(crate) struct Column {
    /// Segments that it reaches, in order, with their ranges of what follows.
    pub(super) parts: Vec<(usize, Range<usize>)>,
    pub(super) rows: Vec<u32>,
    pub(super) values: Vec<f32>,
    /// What is known of the parameter beforehand.
    pub(super) prior: Prior,
}

/// What is known of a parameter before anything is measured, as one more row: 0 where nothing is.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Prior {
    /// One over its variance.
    pub(super) precision: f64,
    /// The precision times how far the parameter would have to go.
    pub(super) score: f64,
}

impl Column {
    /// Calls `visit` with each row that both columns have, and the product of their values there.
    pub(super) fn each_common(&self, other: &Self, mut visit: impl FnMut(usize, f64)) {
        let mut others = other.parts.iter().peekable();
        for (segment, part) in &self.parts {
            while others.next_if(|(other, _)| other < segment).is_some() {}
            let Some((_, other_part)) = others.next_if(|(other, _)| other == segment) else { continue };
            let (mut i, mut j) = (part.start, other_part.start);
            while i < part.end && j < other_part.end {
                let (row, other_row) = (self.rows[i], other.rows[j]);
                if row == other_row {
                    visit(row as usize, f64::from(self.values[i]) * f64::from(other.values[j]));
                }
                i += usize::from(row <= other_row);
                j += usize::from(other_row <= row);
            }
        }
    }

    pub(super) fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    /// Whether anything is known of the parameter beforehand.
    pub(super) fn is_known(&self) -> bool {
        self.prior.precision > 0.0
    }
}

/// Adds what is known of the parameters of `columns` to the last block, which has no rows: to its normal matrix, and to the
/// products of its responses with what is left.
pub(super) fn add_priors<'c>(
    columns: impl Iterator<Item = &'c Column>,
    normals: &mut [DMatrix<f64>],
    scores: &mut [DVector<f64>],
) {
    if let (Some(normal), Some(score)) = (normals.last_mut(), scores.last_mut()) {
        for (idx, column) in columns.enumerate() {
            normal[(idx, idx)] += column.prior.precision;
            score[idx] += column.prior.score;
        }
    }
}

/// How rows are numbered through over takes: the samples of a signal follow one another, then come those of the next
/// signal, then those of the next take. The rows of one signal of one take are a segment.
pub(super) struct Rows {
    pub(super) num_signals: usize,
    pub(super) num_kinds: usize,
    /// First row of each segment, and the number of all rows.
    pub(super) starts: Vec<usize>,
    /// Block of each row.
    pub(super) blocks: Vec<u32>,
    /// Per block, the index of its take. The last block has no rows: it is what is known beforehand.
    pub(super) takes: Vec<usize>,
}

impl Rows {
    pub(super) fn new<D: Domain>(domain: &D, takes: &[usize]) -> Self {
        let num_signals = domain.num_signals();
        let (mut starts, mut blocks, mut take_of_block) = (vec![0], Vec::new(), Vec::new());
        for (idx, &take) in takes.iter().enumerate() {
            let first = take_of_block.len() as u32;
            let of_take = domain.blocks(take);
            take_of_block.resize(take_of_block.len() + of_take.len(), idx);
            let of_sample: Vec<u32> = (first..)
                .zip(of_take)
                .flat_map(|(block, samples)| samples.clone().map(move |_| block))
                .collect();
            for _ in 0..num_signals {
                blocks.extend_from_slice(&of_sample);
                starts.push(blocks.len());
            }
        }
        take_of_block.extend(take_of_block.last().copied());
        Self { num_signals, num_kinds: domain.num_kinds(), starts, blocks, takes: take_of_block }
    }

    pub(super) fn take(&self, segment: usize) -> usize {
        segment / self.num_signals
    }

    pub(super) fn signal(&self, segment: usize) -> usize {
        segment % self.num_signals
    }

    pub(super) fn unit(&self, segment: usize) -> usize {
        self.signal(segment) / self.num_kinds
    }

    pub(super) fn kind(&self, segment: usize) -> usize {
        self.signal(segment) % self.num_kinds
    }
}
