//! What the search compares: scores of the fitted takes, by modality.

use palpate_robot_model::{SensorKind, Stream, TactileLayout};
use palpate_sim::{
    replay::{NEAR_M, PatchTrace},
    tactile,
};

use super::ranked::{Ranked, Unranked};
use crate::PairedTake;

/// The fitted takes, or what some streams have of them.
#[derive(Clone, Debug)]
pub struct FitData<'a> {
    layout: &'a TactileLayout,
    /// Per stream, whether its channels count.
    wanted: Vec<bool>,
    takes: Vec<&'a PairedTake>,
    touches: Touches<'a>,
}

/// Where pressure patches are touched, whatever alpha. Most frames have no touch and are only counted.
#[derive(Clone, Debug, Default)]
struct Touches<'a> {
    /// By take, patch, frame.
    touched: Vec<Touch<'a>>,
    /// Channel-frames without touch.
    at_rest: u64,
    /// Of these, those with the real channel active.
    active_at_rest: u64,
    /// Channel-frames with touch, inactive and active in reality.
    num_touched: [usize; 2],
}

/// One patch in one frame.
#[derive(Clone, Copy, Debug)]
struct Touch<'a> {
    patch_idx: usize,
    /// Nodes under pressure, and how much.
    nodes: &'a [(u32, f64)],
    /// Of the patch's channels.
    real_active: &'a [bool],
}

impl<'a> Touches<'a> {
    fn new(layout: &TactileLayout, wanted: &[bool], takes: &[&'a PairedTake]) -> Self {
        let mut touches = Self::default();
        for take in takes {
            for (patch_idx, (patch, trace)) in layout.patches.iter().zip(&take.contact.patches).enumerate() {
                let PatchTrace::Pressure { offsets, entries } = &**trace else { continue };
                if !wanted[patch.stream] {
                    continue;
                }
                for (frame, real_active) in take.real_active.chunks_exact(layout.num_channels()).enumerate() {
                    let real_active = &real_active[patch.channels.clone()];
                    let nodes = &entries[PatchTrace::entry_range(offsets, frame)];
                    let num_active = real_active.iter().filter(|&&active| active).count();
                    if nodes.is_empty() {
                        touches.at_rest += real_active.len() as u64;
                        touches.active_at_rest += num_active as u64;
                    } else {
                        touches.num_touched[0] += real_active.len() - num_active;
                        touches.num_touched[1] += num_active;
                        touches.touched.push(Touch { patch_idx, nodes, real_active });
                    }
                }
            }
        }
        touches
    }
}

impl<'a> FitData<'a> {
    /// `takes` fit `layout` ([`crate::calibrate`] checks that).
    pub fn new(layout: &'a TactileLayout, takes: impl IntoIterator<Item = &'a PairedTake>) -> Self {
        Self::of_streams(layout, vec![true; layout.streams.len()], takes)
    }

    /// [`Self::new`] of the channels of those streams that are `wanted` (one a stream).
    pub(crate) fn of_streams(
        layout: &'a TactileLayout,
        wanted: Vec<bool>,
        takes: impl IntoIterator<Item = &'a PairedTake>,
    ) -> Self {
        let takes: Vec<&PairedTake> = takes.into_iter().collect();
        let touches = Touches::new(layout, &wanted, &takes);
        Self { layout, wanted, takes, touches }
    }

    /// Per stream, whether its channels count.
    pub(crate) fn wanted(&self) -> &[bool] {
        &self.wanted
    }

    /// Streams of `kind` whose channels count.
    pub(crate) fn streams(&self, kind: SensorKind) -> impl Iterator<Item = &'a Stream> {
        let streams = self.layout.streams.iter().zip(&self.wanted);
        streams.filter(move |(stream, wanted)| **wanted && stream.kind == kind).map(|(stream, _)| stream)
    }

    /// Whether reality has any contact on a channel of `kind`.
    pub(crate) fn has_real_contact(&self, kind: SensorKind) -> bool {
        let num_channels = self.layout.num_channels().max(1);
        self.takes.iter().any(|take| {
            let mut frames = take.real_active.chunks_exact(num_channels);
            frames.any(|real| self.streams(kind).any(|of| real[of.channels.clone()].contains(&true)))
        })
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
        let counts = |stream: usize| self.wanted[stream] && streams[stream].kind == kind;
        (0..self.layout.num_channels()).filter(|&c| counts(self.layout.channels[c].stream)).collect()
    }

    /// Minus the smallest signed distance of every proximity channel-frame. The threshold is `-lambda_con`, its floor
    /// minus the distance up to which a replay is exact.
    pub fn proximity(&self) -> Ranked {
        let num_channels = self.layout.num_channels();
        let mut scores = Unranked::new(-NEAR_M);
        for take in &self.takes {
            for (patch, trace) in self.layout.patches.iter().zip(&take.contact.patches) {
                let PatchTrace::Proximity { min_distance_m, .. } = &**trace else { continue };
                if !self.wanted[patch.stream] {
                    continue;
                }
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
    /// The same sums as in [`tactile::raw_signals`], but for frames without touch.
    pub fn pressure(&self, alpha_per_m: f64) -> Ranked {
        let propagation = tactile::propagation(self.layout, &vec![alpha_per_m; self.layout.patches.len()]);
        let mut scores = Unranked::with_capacity(0.0, self.touches.num_touched);
        scores.push_at_rest(self.touches.at_rest, self.touches.active_at_rest);
        let mut taxels_pa = Vec::new();
        for &Touch { patch_idx, nodes, real_active } in &self.touches.touched {
            taxels_pa.clear();
            taxels_pa.resize(real_active.len(), 0.0);
            tactile::propagate(&propagation[patch_idx].weights, nodes, &mut taxels_pa);
            for (&pressure_pa, &real_active) in taxels_pa.iter().zip(real_active) {
                scores.push(pressure_pa, real_active);
            }
        }
        scores.rank()
    }
}
