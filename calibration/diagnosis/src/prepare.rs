//! A session before it is searched: checked, and calibrated.

use std::collections::BTreeMap;

use palpate_calibration::{CalibrationConfig, CalibrationError, PairedTake, calibrate, held_out};
use palpate_recording::Take;
use palpate_robot_model::Station;
use palpate_sim::SensorModel;
use palpate_sim::effects;
use palpate_sim::job::{Cancel, NoProgress};
use rayon::prelude::*;

use crate::DiagnosisError;
use crate::config::DiagnosisConfig;
use crate::engine::{self, Model};
use crate::rules::RULES;
use crate::tactile::judge::{gap, judge, set_thresholds};
use crate::tactile::{Observed, TactileDomain};

/// Steps of the first fit of the model's own parameters.
const FIRST_STEPS: usize = 6;
/// What may be added to the gap by chance, over what it is.
const CHANCE_IN_GAP: f64 = 0.1;

/// A session, calibrated and ready to be searched.
pub(crate) struct Prepared<'a> {
    pub(crate) domain: TactileDomain<'a>,
    /// The model to begin with, its own parameters fitted.
    pub(crate) start: Model,
    pub(crate) calibrated: SensorModel,
    /// Indices of the takes that are not kept for confirmation.
    pub(crate) fitted: Vec<usize>,
}

pub(crate) fn prepare<'a>(
    config: &DiagnosisConfig,
    station: &'a Station,
    takes: &'a [Take],
    nominal: &SensorModel,
    cancel: &Cancel,
) -> Result<Prepared<'a>, DiagnosisError> {
    let paired: Vec<PairedTake> = takes.par_iter().map(PairedTake::from_take).collect::<Result<_, _>>()?;
    let is_confirm = held_out(&config.hold_out, &paired)?;
    let fitted: Vec<usize> = (0..takes.len()).filter(|&idx| !is_confirm[idx]).collect();
    nominal.check_streams(&station.layout).map_err(|err| DiagnosisError::Input(err.to_string()))?;
    if !nominal.effects.is_empty() {
        // Thresholds that were calibrated without the effects would have absorbed a part of them.
        let (domain, start) = TactileDomain::new(station, takes, &fitted, nominal)?;
        let start = engine::refit(&domain, &start, &fitted, FIRST_STEPS)?;
        let calibrated = recalibrated(station, &domain, nominal, &fitted)?;
        return Ok(Prepared { domain, start, calibrated, fitted });
    }
    let calibration = CalibrationConfig {
        hold_out: config.hold_out.clone(),
        bootstrap_resamples: 0,
        ..CalibrationConfig::default()
    };
    let outcome = calibrate(&calibration, &station.layout, nominal, &paired, &NoProgress, cancel, &|| 0.0)?;
    let mut calibrated = outcome.model;
    calibrated.response = nominal.response.clone();
    let (domain, start) = TactileDomain::new(station, takes, &fitted, &calibrated)?;
    let start = engine::refit(&domain, &start, &fitted, FIRST_STEPS)?;
    Ok(Prepared { domain, start, calibrated, fitted })
}

/// `nominal`, which has effects, with its thresholds set anew beside them where the takes `fitted` show that they have
/// moved: where that lowers the mismatch by more than chance does. Otherwise the model stays as it is, to the bit, so
/// that a second diagnosis begins where the first ended.
fn recalibrated(
    station: &Station,
    domain: &TactileDomain<'_>,
    nominal: &SensorModel,
    fitted: &[usize],
) -> Result<SensorModel, DiagnosisError> {
    let observed: Vec<&Observed<'_>> = fitted.iter().map(|&take| domain.take(take)).collect();
    let mut anew = nominal.clone();
    set_thresholds(station, &observed, &mut anew)?;
    let [before, after] =
        [gap(&judge(station, &observed, nominal)?), gap(&judge(station, &observed, &anew)?)];
    Ok(if after < (1.0 - CHANCE_IN_GAP) * before { anew } else { nominal.clone() })
}

/// The station of `takes`; refuses what cannot be diagnosed.
pub(crate) fn check<'a>(config: &DiagnosisConfig, takes: &'a [Take]) -> Result<&'a Station, DiagnosisError> {
    let Some(first) = takes.first() else {
        return Err(DiagnosisError::Input(
            "nothing to diagnose: the session has no accepted take; record or accept one".to_owned(),
        ));
    };
    if let Some(other) = takes.iter().find(|take| take.station.id != first.station.id) {
        return Err(DiagnosisError::Input(format!(
            "take {:?} is of station {:?}, but take {:?} is of {:?}; diagnose the takes of one station at a time",
            other.id, other.station.id, first.id, first.station.id
        )));
    }
    for id in &config.without {
        if effects::tactile(id).is_none() {
            let known: Vec<&str> = effects::TACTILE.iter().map(|kind| kind.id()).collect();
            return Err(DiagnosisError::Input(format!(
                "there is no effect {id:?} to leave out; the library has {}",
                known.join(", ")
            )));
        }
    }
    config.ablation.iter().chain([&config.rule_scales]).try_for_each(check_scales)?;
    Ok(&first.station)
}

/// Refuses factors of rules that there are not, and those that are no factor.
fn check_scales(scales: &BTreeMap<String, f64>) -> Result<(), DiagnosisError> {
    for (id, scale) in scales {
        if !RULES.iter().any(|rule| rule.id == *id) {
            let known: Vec<&str> = RULES.iter().map(|rule| rule.id).collect();
            return Err(DiagnosisError::Input(format!(
                "there is no rule {id:?} to switch off or to scale; the rules are {}",
                known.join(", ")
            )));
        }
        if scale.is_nan() || *scale <= 0.0 {
            return Err(DiagnosisError::Input(format!(
                "the limit of rule {id:?} cannot be multiplied by {scale}; give a number above 0"
            )));
        }
    }
    Ok(())
}

impl From<CalibrationError> for DiagnosisError {
    fn from(error: CalibrationError) -> Self {
        match error {
            CalibrationError::Cancelled => Self::Cancelled,
            other => Self::Input(other.to_string()),
        }
    }
}
