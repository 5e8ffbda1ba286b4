//! A stream whose readings freeze at times.

use palpate_robot_model::{Place, Station};

use super::{Effect, EffectKind, Hold, Parameter, Stage, TakeScene, Transport, places};

/// For a share `frozen_fraction` of the time the readings are frozen, `span_s` at a stretch, and then jump to the present.
/// When the spans begin is not a parameter, because nothing that a fit could follow leads there. Where a recording shows it,
/// because its readings are repeated to the bit ([`TakeScene::frozen_for_s`]), the spans are those, and the fraction over
/// theirs says how much of it counts. Elsewhere a soft chain gives the mean over all phases, and a hard one freezes
/// regularly from the start of the take ([`super::Hold`]).
pub(super) struct SampleHold;

impl EffectKind for SampleHold {
    fn id(&self) -> &'static str {
        "sample_hold"
    }

    fn stage(&self) -> Stage {
        Stage::Transport
    }

    fn explain(&self, effect: &Effect, station: &Station) -> String {
        format!(
            "The {} freezes for {:.0} ms at a stretch, {:.0} % of the time.",
            places::name(&effect.place, station),
            effect.parameter("span_s") * 1e3,
            effect.parameter("frozen_fraction") * 1e2
        )
    }

    fn signature(&self) -> &'static str {
        "some onsets and releases late by up to the span, others on time; all channels of the stream stand still together"
    }

    fn parameters(&self, _place: &Place, _station: &Station) -> Vec<Parameter> {
        vec![
            Parameter::new("frozen_fraction", 0.0..=0.9, 0.0, 0.05, 0.25),
            // Without a fraction it does nothing.
            Parameter::new("span_s", 0.05..=5.0, 0.5, 10.0, 0.2),
        ]
    }

    fn places(&self, station: &Station) -> Vec<Place> {
        places::all_streams(station)
    }

    fn transport(&self, effect: &Effect, scene: &TakeScene<'_>, state: &mut Transport) {
        let (fraction, span_s) = (effect.parameter("frozen_fraction"), effect.parameter("span_s"));
        if fraction <= 0.0 || span_s <= 0.0 {
            return;
        }
        for stream in places::streams_of(&effect.place, &scene.station.layout) {
            let seen_for_s = scene.frozen_for_s.get(stream).map_or_else(Vec::new, Vec::clone);
            let frozen = seen_for_s.iter().filter(|age_s| **age_s > 0.0).count();
            if seen_for_s.is_empty() {
                state.holds[stream] = Some(Hold { fraction, span_s, seen_for_s });
            } else if frozen > 0 {
                let share = fraction * seen_for_s.len() as f64 / frozen as f64;
                state.holds[stream] = Some(Hold { fraction: share.min(MOST_SHARE), span_s, seen_for_s });
            }
        }
    }
}

/// More than all of what is seen to be frozen makes no sense, but a fit has to be able to look there.
const MOST_SHARE: f64 = 2.0;
