//! Which channels a plan means to touch.

use palpate_robot_model::Station;

use crate::{Plan, PlanError, channel_named};

/// How often a plan means to touch one channel.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ChannelCoverage {
    /// Index of the channel in the layout.
    pub channel: usize,
    /// Indices of the takes that name it, once for each time.
    pub takes: Vec<usize>,
    /// Indices of the takes that name it or another channel of its patch, once for each time: a press with one taxel
    /// usually reaches its neighbours.
    pub patch_takes: Vec<usize>,
}

/// What `plan` means to touch on `station`: one entry for each channel of the layout, in order.
pub fn coverage(plan: &Plan, station: &Station) -> Result<Vec<ChannelCoverage>, PlanError> {
    plan.check(station)?;
    let layout = &station.layout;
    let mut coverage: Vec<ChannelCoverage> = (0..layout.num_channels())
        .map(|channel| ChannelCoverage { channel, takes: Vec::new(), patch_takes: Vec::new() })
        .collect();
    for (take_idx, take) in plan.takes.iter().enumerate() {
        for channel in take.touch.iter().filter_map(|touch| channel_named(station, touch)) {
            coverage[channel].takes.push(take_idx);
            let patch = layout.channels[channel].patch;
            for mate in layout.patches[patch].channels.clone() {
                coverage[mate].patch_takes.push(take_idx);
            }
        }
    }
    Ok(coverage)
}
