//! What the search compares: scores of the fitted takes, by modality.

use palpate_robot_model::{SensorKind, TactileLayout};
use palpate_sim::{
    replay::{NEAR_M, PatchTrace},
    tactile,
};

use super::ranked::{Ranked, Unranked};
use crate::PairedTake;

/// The fitted takes.
#[derive(Clone, Debug)]
pub struct FitData<'a> {
    layout: &'a TactileLayout,
    takes: Vec<&'a PairedTake>,
}

impl<'a> FitData<'a> {
    /// `takes` fit `layout` ([`crate::calibrate`] checks that).
    pub fn new(layout: &'a TactileLayout, takes: impl IntoIterator<Item = &'a PairedTake>) -> Self {
        Self { layout, takes: takes.into_iter().collect() }
    }

    /// The layout.
    pub fn layout(&self) -> &'a TactileLayout {
        self.layout
    }

    /// The takes.
    pub fn takes(&self) -> &[&'a PairedTake] {
        &self.takes
    }

    /// Channels of `kind`, in order.
    pub fn channels(&self, kind: SensorKind) -> Vec<usize> {
        let streams = &self.layout.streams;
        (0..self.layout.num_channels())
            .filter(|&c| streams[self.layout.channels[c].stream].kind == kind)
            .collect()
    }

    /// Minus the smallest signed distance of every proximity channel-frame. The threshold is `-lambda_con`, its floor
    /// minus the distance up to which a replay is exact.
    pub fn proximity(&self) -> Ranked {
        let num_channels = self.layout.num_channels();
        let mut scores = Unranked::new(-NEAR_M);
        for take in &self.takes {
            for (patch, trace) in self.layout.patches.iter().zip(&take.contact.patches) {
                let PatchTrace::Proximity { min_distance_m } = trace else { continue };
                for channel in patch.channels.clone() {
                    let real = take.real_active.iter().skip(channel).step_by(num_channels);
                    for (&distance_m, &real_active) in min_distance_m.iter().zip(real) {
                        scores.push(-distance_m, real_active);
                    }
                }
            }
        }
        scores.rank()
    }

    /// Propagated pressure of every pressure channel-frame. The threshold is `lambda_pre`, its floor zero.
    ///
    /// The same sums as in [`tactile::raw_signals`], but frames without contact, which are most, are only counted.
    pub fn pressure(&self, alpha_per_m: f64) -> Ranked {
        let num_channels = self.layout.num_channels();
        let propagation = tactile::propagation(self.layout, alpha_per_m);
        let mut scores = Unranked::new(0.0);
        let mut taxels_pa = Vec::new();
        for take in &self.takes {
            for (patch_idx, patch) in self.layout.patches.iter().enumerate() {
                let PatchTrace::Pressure { offsets, entries } = &take.contact.patches[patch_idx] else {
                    continue;
                };
                let weights = &propagation[patch_idx].weights;
                for (frame, real_active) in take.real_active.chunks_exact(num_channels).enumerate() {
                    let real_active = &real_active[patch.channels.clone()];
                    let touched = &entries[PatchTrace::entry_range(offsets, frame)];
                    if touched.is_empty() {
                        let num_active = real_active.iter().map(|&active| u64::from(active)).sum();
                        scores.push_at_rest(real_active.len() as u64, num_active);
                        continue;
                    }
                    taxels_pa.clear();
                    taxels_pa.resize(real_active.len(), 0.0);
                    tactile::propagate(weights, touched, &mut taxels_pa);
                    for (&pressure_pa, &real_active) in taxels_pa.iter().zip(real_active) {
                        scores.push(pressure_pa, real_active);
                    }
                }
            }
        }
        scores.rank()
    }
}
