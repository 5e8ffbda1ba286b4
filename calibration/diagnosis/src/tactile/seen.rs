//! What recordings show of effects by themselves: there a fit begins, or it need not fit it at all.

use palpate_robot_model::{Place, TactileLayout};
use palpate_sim::effects::{Effect, Parameter};

use super::wander::median;
use super::{Observed, Signal};

/// A stream that stands still now and then shows in the noise of its readings, which events do not have: of events
/// alone it stands in for whatever comes late.
pub(super) const SAMPLE_HOLD: &str = "sample_hold";
const STUCK_CHANNEL: &str = "stuck_channel";

/// What some takes show.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Seen {
    /// Per stream, how its readings were repeated to the bit.
    frozen: Vec<Option<Frozen>>,
    /// Per channel, the median of its readings, in units of the switching threshold; 0 without any.
    medians: Vec<f64>,
}

impl Seen {
    pub(super) fn of(takes: &[&Observed<'_>], layout: &TactileLayout) -> Self {
        let median_of = |channel: usize| {
            let readings = takes.iter().flat_map(|take| &take.signals[Signal::Reading.of(channel)]);
            let median = median(readings.copied().collect());
            if median.is_nan() { 0.0 } else { median }
        };
        Self {
            frozen: (0..layout.streams.len()).map(|stream| Frozen::of(takes, stream)).collect(),
            medians: (0..layout.num_channels()).map(median_of).collect(),
        }
    }

    /// Where fits of `effect` begin, in its `parameters`.
    pub(super) fn begin(&self, effect: &Effect, layout: &TactileLayout, parameters: &mut [Parameter]) {
        match (effect.id.as_str(), &effect.place) {
            // How long a stream stands still is seen, not fitted, where it is seen at all.
            (SAMPLE_HOLD, Place::Stream(id)) => {
                let Some(frozen) = layout.stream_index(id).and_then(|idx| self.frozen[idx]) else { return };
                for parameter in parameters {
                    match parameter.name.as_str() {
                        "span_s" => {
                            parameter.neutral = frozen.span_s.clamp(parameter.lower, parameter.upper);
                        }
                        _ => parameter.dose = frozen.fraction.clamp(0.01, parameter.upper),
                    }
                }
            }
            // A stuck channel stands where it mostly is.
            (STUCK_CHANNEL, Place::Channel(id)) => {
                let channel = layout.channels.iter().position(|channel| channel.id == *id);
                let level = parameters.iter_mut().find(|parameter| parameter.name == "level");
                if let (Some(channel), Some(level)) = (channel, level) {
                    level.neutral = self.medians[channel].clamp(level.lower, level.upper);
                }
            }
            _ => {}
        }
    }
}

/// Spans in which a stream stood still, over some takes.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Frozen {
    /// Mean length, s.
    span_s: f64,
    /// Share of the time.
    fraction: f64,
}

impl Frozen {
    fn of(takes: &[&Observed<'_>], stream: usize) -> Option<Self> {
        let spans: Vec<f64> = takes.iter().flat_map(|take| take.frozen_spans_s(stream)).collect();
        let frozen_s: f64 = spans.iter().sum();
        let duration_s: f64 = takes.iter().map(|take| take.take.duration_s()).sum();
        (frozen_s > 0.0).then(|| Self {
            span_s: frozen_s / spans.len() as f64,
            fraction: frozen_s / duration_s.max(f64::MIN_POSITIVE),
        })
    }
}

#[cfg(test)]
mod tests {
    use palpate_sim::effects;

    use super::*;
    use crate::engine::Domain as _;
    use crate::tactile::TactileDomain;
    use crate::testing::{Session, session};

    #[test]
    fn a_stuck_channel_is_looked_for_where_its_readings_mostly_are() {
        let Session { stage, mut takes, nominal } = session("small");
        let station = stage.station();
        takes.truncate(1);
        let (stream, channels) = (0, station.layout.streams[0].channels.clone());
        let threshold = station.streams[stream].on_threshold;
        let log = &mut takes[0].streams[stream];
        let stuck = log.reference[0] + 2.0 * threshold as f32;
        log.raw.chunks_exact_mut(channels.len()).for_each(|sample| sample[0] = stuck);
        let (domain, _) = TactileDomain::new(station, &takes, &[0], &nominal).unwrap();
        let kind = effects::tactile(STUCK_CHANNEL).unwrap();
        let level = |channel: usize| {
            let id = station.layout.channels[channel].id.clone();
            let candidates = domain.candidates();
            let is_it = |one: &&Effect| one.id == kind.id() && one.place == Place::Channel(id.clone());
            let parameters = domain.parameters(candidates.iter().find(is_it).unwrap());
            parameters.iter().find(|parameter| parameter.name == "level").unwrap().neutral
        };
        assert!((level(channels.start) - 2.0).abs() < 0.05, "{}", level(channels.start));
        assert!(level(channels.start + 1).abs() < 0.2, "{}", level(channels.start + 1));
    }
}
