//! Measures reference sessions.

use palpate_calibration::HoldOut;
use palpate_recording::Take;
use palpate_reports::MIN_REFERENCES;
use palpate_sim::SensorModel;
use palpate_sim::job::{Cancel, Progress};

use crate::DiagnosisError;
use crate::config::DiagnosisConfig;
use crate::null::NullBar;
use crate::prepare::{Prepared, check, prepare};
use crate::reference::{Measured, Reference};
use crate::search::search;
use crate::tactile::adequacy::adequacy;
use crate::tactile::posture::{Least, with_posture};

/// Measures what `sessions`, of one station, leave in which nothing is wrong; each is searched like any other session.
///
/// A limit is a prediction limit: one more such session stays below it with a probability of 99 %, if logarithms are normally
/// distributed. So few sessions, or sessions that differ much, give high limits. None is below the shipped one.
pub fn reference(
    config: &DiagnosisConfig,
    sessions: &[Vec<Take>],
    nominal: &SensorModel,
    progress: &dyn Progress,
    cancel: &Cancel,
) -> Result<Reference, DiagnosisError> {
    let [first, ..] = sessions else { return Err(too_few(0)) };
    if sessions.len() < MIN_REFERENCES {
        return Err(too_few(sessions.len()));
    }
    let of_first = check(config, first)?;
    // Takes that are kept for judging are named in the session that is diagnosed.
    let config = &DiagnosisConfig { hold_out: HoldOut::Auto, ..config.clone() };
    let mut measured: Vec<Measured> = Vec::new();
    for (idx, takes) in sessions.iter().enumerate() {
        let watch = |within: f64, stage: &str| {
            let share = (idx as f64 + within) / sessions.len() as f64;
            progress.report(share, &format!("reference session {} of {}: {stage}", idx + 1, sessions.len()));
            if cancel.is_cancelled() { Err(DiagnosisError::Cancelled) } else { Ok(()) }
        };
        watch(0.0, "calibrating")?;
        let station = check(config, takes)?;
        if station.id != of_first.id {
            return Err(DiagnosisError::Input(format!(
                "reference session {} is of station {:?}, but the first is of {:?}; give sessions of one station",
                idx + 1,
                station.id,
                of_first.id
            )));
        }
        let Prepared { mut domain, mut start, fitted, .. } =
            prepare(config, station, takes, nominal, cancel)?;
        let naming = NullBar::naming(config.max_effects + nominal.effects.len());
        let known = start.effects.len();
        let found = search(&mut domain, &mut start, &fitted, &naming, &watch)?;
        let (of_all, _) = adequacy(station, &domain, &start, &fitted)?;
        let bent = with_posture(&domain, &start, &fitted, Least::ANY)?;
        measured.push(Measured {
            left: of_all,
            posture: bent.iter().map(|change| change.evidence).fold(0.0, f64::max),
            named: found.model.effects.into_iter().zip(found.evidence).skip(known).collect(),
        });
    }
    progress.report(1.0, "done");
    Ok(Reference::of(of_first, &measured))
}

fn too_few(count: usize) -> DiagnosisError {
    DiagnosisError::Input(format!(
        "expected at least {MIN_REFERENCES} reference sessions, better 5, to tell what is usual; got {count}"
    ))
}
