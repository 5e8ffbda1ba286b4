//! What to record next, to tell two models of an actuator apart.

use palpate_recording::ServoLog;
use palpate_reports::{NextExperiment, Purpose};
use palpate_sim::actuator::rollout;

use super::ActuatorDomain;
use crate::DiagnosisError;
use crate::engine::{Domain as _, Model};

/// Difference of two models over a log, in standard deviations, that recording it would show.
const LEAST_TELLING: f64 = 4.0;
/// Gains and loads that are tried, over those that were recorded.
const FACTORS: [f64; 2] = [0.5, 2.0];

/// Two models that explain what was recorded alike.
pub(super) struct Rivals {
    /// Ids of the effects in which they differ.
    pub(super) ids: [String; 2],
    /// The models, each with everything else fitted beside its effect.
    pub(super) models: [Model; 2],
}

/// Where two models differ most, among what was recorded and what could be.
pub(super) struct Telling {
    ids: [String; 2],
    /// By how much they differ in any recorded log, in standard deviations.
    recorded: f64,
    best: Planned,
}

/// A log that could be recorded.
struct Planned {
    log: ServoLog,
    /// By how much the two models differ in it, in standard deviations.
    difference: f64,
    changed: Changed,
}

/// In what a log differs from one that was recorded.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Changed {
    Nothing,
    Gain,
    Load,
}

impl Telling {
    /// Tries every recorded log again, and with half and twice the gain and, where it is known, the load.
    pub(super) fn new(domain: &ActuatorDomain<'_>, rivals: &Rivals) -> Result<Option<Self>, DiagnosisError> {
        let Rivals { ids, models } = rivals;
        let mut best: Option<Planned> = None;
        let mut recorded: f64 = 0.0;
        for take in 0..domain.num_takes() {
            let difference = difference(domain, take, models)?;
            recorded = recorded.max(difference);
            let again = Planned { log: domain.log(take).clone(), difference, changed: Changed::Nothing };
            best = Some(further(best, again));
        }
        for take in 0..domain.num_takes() {
            for (log, changed) in varied(domain.log(take)) {
                let planned = imagined(domain, take, log, changed, models)?;
                if let Some(planned) = planned {
                    best = Some(further(best, planned));
                }
            }
        }
        Ok(best.map(|best| Self { ids: ids.clone(), recorded, best }))
    }

    /// A note, if nothing that was recorded tells them apart.
    pub(super) fn note(&self) -> Option<String> {
        let [a, b] = &self.ids;
        (self.recorded < LEAST_TELLING).then(|| {
            format!(
                "no recorded motion tells {a} from {b}: what is stated of the motor and its load decided between \
                 them"
            )
        })
    }

    /// The log that tells them apart best, if one would.
    pub(super) fn next_experiment(self) -> Option<NextExperiment> {
        let Planned { log, difference, changed } = self.best;
        if difference < LEAST_TELLING {
            return None;
        }
        let primitive =
            log.fields.get("trajectory").or(log.fields.get("primitive")).cloned().unwrap_or_default();
        let gain = log
            .position_gain_register
            .map_or_else(String::new, |gain| format!(" at position gain {gain:.0}"));
        let load = match changed {
            Changed::Load => format!(" with a load of {:.2} kg", log.mass_kg),
            Changed::Nothing | Changed::Gain => String::new(),
        };
        let [a, b] = &self.ids;
        let instead = if changed != Changed::Nothing {
            format!(
                "they would differ by {difference:.0} standard deviations, in what was recorded by {:.0} at most",
                self.recorded
            )
        } else {
            "of all that was tried it differs most between them".to_owned()
        };
        Some(NextExperiment {
            sentence: format!(
                "To tell {a} from {b}, record {primitive}{gain}{load}, several times: {instead}."
            ),
            primitive,
            object: String::new(),
            separates: self.ids.to_vec(),
            expected_gain: difference,
            purpose: Purpose::Separate,
        })
    }
}

/// The one in which the models differ more. What was recorded once can be recorded again, so something new must tell
/// twice as much.
fn further(best: Option<Planned>, other: Planned) -> Planned {
    match best {
        Some(best) => {
            let is_first_new = other.changed != Changed::Nothing && best.changed == Changed::Nothing;
            let least = if is_first_new { 2.0 * best.difference } else { best.difference };
            if other.difference > least { other } else { best }
        }
        None => other,
    }
}

/// By how much two models differ over `take`, in standard deviations.
fn difference(domain: &ActuatorDomain<'_>, take: usize, [a, b]: &[Model; 2]) -> Result<f64, DiagnosisError> {
    let (of_a, of_b) = (domain.predict(take, a)?, domain.predict(take, b)?);
    let squares = of_a.iter().zip(&of_b).enumerate().map(|(signal, (a, b))| {
        let weights = domain.weights(take, signal, a);
        let rows = a.iter().zip(b.iter()).zip(weights);
        rows.map(|((a, b), weight)| ((a - b) * weight).powi(2)).sum::<f64>()
    });
    Ok(squares.sum::<f64>().sqrt())
}

/// `log` with other gains and loads; nothing was measured in it yet.
fn varied(log: &ServoLog) -> Vec<(ServoLog, Changed)> {
    let gains = FACTORS.iter().filter_map(|factor| {
        let gain = factor * log.position_gain_register?;
        Some((ServoLog { position_gain_register: Some(gain), ..log.clone() }, Changed::Gain))
    });
    let loads = FACTORS
        .iter()
        .filter(|_| log.states_load())
        .map(|factor| (ServoLog { mass_kg: factor * log.mass_kg, ..log.clone() }, Changed::Load));
    gains.chain(loads).collect()
}

/// `log`, which is `take` under other conditions, as the first model would have it; `None` where a model leaves all
/// bounds, so that nobody should record it.
fn imagined(
    domain: &ActuatorDomain<'_>,
    take: usize,
    mut log: ServoLog,
    changed: Changed,
    models: &[Model; 2],
) -> Result<Option<Planned>, DiagnosisError> {
    let plant = domain.plant(&models[0])?;
    let sensed = {
        let of_log = ActuatorDomain::new(std::slice::from_ref(&log))?;
        rollout(&plant, &of_log.drive(0), domain.start(take), log.times_s.len())
    };
    if sensed.iter().any(|sensed| !sensed.position_rad.is_finite()) {
        return Ok(None);
    }
    log.positions_rad = sensed.iter().map(|sensed| sensed.position_rad).collect();
    let difference = difference(&ActuatorDomain::new(std::slice::from_ref(&log))?, 0, models);
    Ok(difference.ok().map(|difference| Planned { log, difference, changed }))
}
