//! The load of every channel, frame by frame.

use std::sync::Arc;

use palpate_robot_model::{Place, TactileLayout};

use super::{Contact, Geometry, places};
use crate::effects::Force;
use crate::parallel::map_chunks;
use crate::replay::PatchTrace;
use crate::tactile::propagate_patch;

/// Load of every channel over time, as its sensor reports it.
#[derive(Clone, Debug)]
pub struct Load {
    /// Per channel, frame by frame: pressure in Pa, or for proximity channels how far the patch has come into the
    /// sensor's reach ([`crate::Response::reach_m`]) in m. Zero without touch. A channel that nobody needs may have no frames.
    pub values: Vec<Arc<[f64]>>,
    /// Per channel, whether anybody needs its load: what is made of others is lost.
    pub needed: Vec<bool>,
    /// Per channel, the load at which it switches on. Effects size additive errors by it.
    pub on_loads: Vec<f64>,
    /// The load that all channels share on which nothing ever presses.
    silence: Arc<[f64]>,
    /// Per channel, the force that its values are: what several effects do to it in turn needs no load between them.
    taken_as: Vec<Force>,
}

impl Load {
    /// Of the channels that are `needed`, over `num_frames`. `geometry` remembers the pressures of patches that no effect has
    /// changed; `reaches_m` has each patch's reach.
    pub(super) fn new(
        contact: &Contact<'_>,
        geometry: &Geometry,
        reaches_m: &[f64],
        needed: Vec<bool>,
        on_loads: Vec<f64>,
        num_frames: usize,
    ) -> Self {
        let patches = &contact.layout.patches;
        let silence: Arc<[f64]> = vec![0.0; num_frames].into();
        let nothing: Arc<[f64]> = Arc::new([]);
        // Patches are independent: each is a unit of work.
        let by_patch = map_chunks(patches.len(), |idx| {
            let (patch, trace) = (&patches[idx], &contact.trace.patches[idx]);
            if !contact.needed[idx] {
                return vec![Arc::clone(&nothing); patch.channels.len()];
            }
            match &**trace {
                PatchTrace::Proximity { min_distance_m, .. } => {
                    let reach_m = reaches_m[idx];
                    let load = if min_distance_m.iter().any(|distance_m| *distance_m < reach_m) {
                        min_distance_m.iter().map(|distance_m| (reach_m - distance_m).max(0.0)).collect()
                    } else {
                        Arc::clone(&silence)
                    };
                    vec![load; patch.channels.len()]
                }
                PatchTrace::Pressure { .. } => {
                    let alpha_per_m = contact.alpha_per_m[idx];
                    let propagated =
                        || propagate_patch(contact.layout, patch, trace, alpha_per_m, num_frames).into();
                    let unchanged = Arc::ptr_eq(trace, &geometry.trace.patches[idx]);
                    let of_patch = match geometry.made.as_ref().filter(|_| unchanged) {
                        Some(made) => made.spread.of(idx, alpha_per_m, propagated),
                        None => propagated(),
                    };
                    let of_taxel = |load: &Option<Arc<[f64]>>| Arc::clone(load.as_ref().unwrap_or(&silence));
                    of_patch.iter().map(of_taxel).collect()
                }
            }
        });
        let values: Vec<Arc<[f64]>> = by_patch.into_iter().flatten().collect();
        Self { taken_as: vec![Force::LOAD; values.len()], values, needed, on_loads, silence }
    }

    /// The channels at `place` that are needed.
    pub(in super::super) fn needed_at(&self, place: &Place, layout: &TactileLayout) -> Vec<usize> {
        let mut channels = places::channels_of(place, layout);
        channels.retain(|&channel| self.needed[channel]);
        channels
    }

    /// Those of the channels at `place` that are needed on which anything ever presses: what scales a load, or follows it, leaves
    /// the others as they are.
    pub(in super::super) fn pressed_at(&self, place: &Place, layout: &TactileLayout) -> Vec<usize> {
        let mut channels = self.needed_at(place, layout);
        channels.retain(|&channel| !self.is_silent(channel));
        channels
    }

    /// Whether nothing ever presses on `channel`. A load that an effect has changed never counts as silent.
    pub fn is_silent(&self, channel: usize) -> bool {
        Arc::ptr_eq(&self.values[channel], &self.silence)
    }

    /// Loads of `channel`, frame by frame.
    pub fn of_channel(&self, channel: usize) -> &Arc<[f64]> {
        &self.values[channel]
    }

    /// As [`Self::of_channel`], to change them.
    pub fn of_channel_mut(&mut self, channel: usize) -> &mut [f64] {
        Arc::make_mut(&mut self.values[channel])
    }

    /// The forces that go with the loads of `channel`, to change them.
    pub(in super::super) fn forces_mut(&mut self, channel: usize, force: Force) -> &mut [f64] {
        let before = std::mem::replace(&mut self.taken_as[channel], force);
        let values = self.of_channel_mut(channel);
        before.make_other(values, force);
        values
    }

    /// Makes loads again of the forces that effects have left.
    pub(super) fn take_as_loads(&mut self) {
        for channel in 0..self.values.len() {
            if self.taken_as[channel] != Force::LOAD {
                self.forces_mut(channel, Force::LOAD);
            }
        }
    }

    /// Multiplies the loads of `channel` by `factor`; by 1 they stay the same values, not copies of them.
    pub(in super::super) fn scale(&mut self, channel: usize, factor: f64) {
        if factor != 1.0 {
            self.of_channel_mut(channel).iter_mut().for_each(|load| *load *= factor);
        }
    }
}
