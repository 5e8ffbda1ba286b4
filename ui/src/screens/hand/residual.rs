//! How much simulation and recording differ, channel by channel, over the confirm takes of a diagnosis.

use palpate_reports::{ChannelResidual, DiagnosisReport};
use palpate_robot_model::Station;

use super::signal::Signal;

/// Mismatch of each channel of a station before and after the named effects.
#[derive(Clone, Debug, PartialEq)]
pub struct Residual {
    /// Calibrated model: L1 a second, all phases together; `None` for channels that the diagnosis does not know.
    pub before: Vec<Option<f64>>,
    /// The same with the named effects.
    pub after: Vec<Option<f64>>,
    /// Upper end of the colour scale, the same for both: the worst channel of either.
    pub full_scale_per_s: f64,
}

impl Residual {
    /// Of `report`, in the channel order of `station`.
    pub fn new(report: &DiagnosisReport, station: &Station) -> Self {
        let of = |total: fn(&ChannelResidual) -> f64| -> Vec<Option<f64>> {
            let channels = station.layout.channels.iter();
            channels
                .map(|channel| {
                    report.residual_map.iter().find(|known| known.channel == channel.id).map(total)
                })
                .collect()
        };
        let before = of(|channel| channel.calibrated.values().sum());
        let after = of(|channel| channel.diagnosed.values().sum());
        let worst = before.iter().chain(&after).flatten().copied().fold(0.0, f64::max);
        // With nothing to show, everything is at the scale's lower end.
        let full_scale_per_s = if worst > 0.0 { worst } else { 1.0 };
        Self { before, after, full_scale_per_s }
    }

    /// Of the simulation that is looked at: with effects, or without.
    pub(super) fn of(&self, signal: Signal) -> &[Option<f64>] {
        if signal == Signal::Diagnosed { &self.after } else { &self.before }
    }
}
