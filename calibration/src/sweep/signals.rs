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
                        // Adding zero turns -0.0 into 0.0, so that equal scores have equal bits.
                        scores.push(-distance_m + 0.0, real_active);
                    }
                }
            }
        }
        scores.rank()
    }

    /// Propagated pressure of every pressure channel-frame. The threshold is `lambda_pre`, its floor zero.
    pub fn pressure(&self, alpha_per_m: f64) -> Ranked {
        let num_channels = self.layout.num_channels();
        let mut scores = Unranked::new(0.0);
        let ranges = self.pressure_ranges();
        for take in &self.takes {
            let raw = tactile::raw_signals(self.layout, &take.contact, alpha_per_m);
            let frames = raw.chunks_exact(num_channels).zip(take.real_active.chunks_exact(num_channels));
            for (raw, real_active) in frames {
                for range in &ranges {
                    for (&pressure_pa, &real_active) in
                        raw[range.clone()].iter().zip(&real_active[range.clone()])
                    {
                        scores.push(pressure_pa, real_active);
                    }
                }
            }
        }
        scores.rank()
    }

    /// Channels of the pressure streams, as ranges.
    fn pressure_ranges(&self) -> Vec<std::ops::Range<usize>> {
        let streams = self.layout.streams.iter();
        streams
            .filter(|stream| stream.kind == SensorKind::Pressure)
            .map(|stream| stream.channels.clone())
            .collect()
    }
}
