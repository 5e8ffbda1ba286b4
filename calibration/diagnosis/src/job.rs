//! The diagnosis of a session: calibrate, find, name, add, show.

use std::collections::BTreeMap;

use palpate_recording::Take;
use palpate_reports::DiagnosisReport;
use palpate_robot_model::{Place, Station};
use palpate_sim::SensorModel;
use palpate_sim::effects::Effect;
use palpate_sim::job::{Cancel, Progress};

use crate::config::{DiagnosisConfig, KEPT_EVIDENCE, LEAST_SHARE, NUM_FITS};
use crate::engine::{Model, Naming, NamingConfig};
use crate::fired::{self, Fired, InForce};
use crate::null::NullBar;
use crate::prepare::{Prepared, check, prepare};
use crate::reference::Reference;
use crate::search::search;
use crate::steps::Steps;
use crate::tactile::TactileDomain;
use crate::tactile::adequacy::{Adequacy, Left, adequacy, touch_to_touch};
use crate::tactile::posture::{WithPosture, with_posture};
use crate::withhold::{withhold, withhold_weak};
use crate::{DiagnosisError, show};

/// What a diagnosis found.
#[derive(Clone, Debug)]
pub struct DiagnosisOutcome {
    /// The report, as the command line prints it and the page shows it.
    pub report: DiagnosisReport,
    /// The calibrated model with the named effects.
    pub model: SensorModel,
    /// The calibrated model; of a start with effects, that model, its thresholds set anew where that lowers the
    /// mismatch.
    pub calibrated: SensorModel,
    /// Highest evidence of any effect in the first round: what a null bar is made of.
    pub first_evidence: f64,
    /// What is left of the diagnosed model's residuals.
    pub adequacy: Adequacy,
    /// Which effects would be named instead, the weightiest first, with each of [`DiagnosisConfig::ablation`].
    pub ablation: Vec<Vec<Effect>>,
}

/// Evidence and share that a name needs where takes hold events only. What the model gets wrong on its own is then all in
/// the moments at which channels switch, with no reading to tell it by: of twelve sessions that hide nothing (a tuning
/// station, and world d of the blind bench) one had 30 with more than the share, right names there 66 and more.
const EVENTS_EVIDENCE: f64 = 60.0;
const EVENTS_SHARE: f64 = 0.035;

/// Diagnoses `takes` (of one station), starting from `nominal`.
///
/// `bar` is the station's null bar, see [`crate::null_bar`]; without one a shipped default applies and the report says
/// so. `clock_s` gives seconds since any fixed moment, for the report. All else depends on the arguments alone, to the bit,
/// for any number of threads.
pub fn diagnose(
    config: &DiagnosisConfig,
    takes: &[Take],
    nominal: &SensorModel,
    bar: Option<&NullBar>,
    progress: &dyn Progress,
    cancel: &Cancel,
    clock_s: &(dyn Fn() -> f64 + Sync),
) -> Result<DiagnosisOutcome, DiagnosisError> {
    let start_s = clock_s();
    let watch = |fraction: f64, stage: &str| {
        progress.report(fraction, stage);
        if cancel.is_cancelled() { Err(DiagnosisError::Cancelled) } else { Ok(()) }
    };
    watch(0.0, "calibrating thresholds")?;
    let station = check(config, takes)?;
    let shipped;
    let reference = match &config.reference {
        Some(reference) => reference.check(station)?,
        None => {
            shipped = Reference::shipped(station);
            &shipped
        }
    };
    let Prepared { mut domain, mut start, calibrated, fitted } =
        prepare(config, station, takes, nominal, cancel)?;
    watch(0.1, "looking for what is missing")?;
    let of_station = bar.map_or(NullBar::DEFAULT_EVIDENCE, |bar| bar.evidence);
    let (least_evidence, least_share) = if domain.num_raw_takes() == 0 {
        (of_station.max(EVENTS_EVIDENCE), EVENTS_SHARE)
    } else {
        (of_station, LEAST_SHARE)
    };
    let naming_config = NamingConfig {
        max_effects: config.max_effects + nominal.effects.len(),
        bar: least_evidence,
        kept_bar: of_station.max(KEPT_EVIDENCE),
        least_share,
        num_fits: NUM_FITS,
        without: config.without.clone(),
    };
    let naming = search(&mut domain, &mut start, &fitted, &naming_config, &|fraction, stage| {
        watch(0.1 + 0.75 * fraction, stage)
    })?;
    let known = start.effects.len();
    let is_cut_short = naming.model.effects.len() - known >= config.max_effects;
    let first_evidence = naming.rounds[0].tried.iter().map(|tried| tried.evidence).fold(0.0, f64::max);

    watch(0.86, "judging on takes that nothing was fitted to")?;
    let before = measured(station, &domain, &start, &fitted, reference)?;
    let found = Found {
        station,
        takes,
        reference,
        domain: &domain,
        fitted: &fitted,
        start: &start,
        calibrated: &calibrated,
        naming,
        is_cut_short,
        before,
    };
    let Judged { naming, steps, left } = found.judged(InForce::scaled(&config.rule_scales))?;
    let names = |naming: &Naming| naming.model.effects[known..].to_vec();
    let changed = |rule_scales: &BTreeMap<String, f64>| {
        // A rule that withheld nothing withholds nothing with a higher limit either.
        let is_idle = |(rule, scale): (&String, &f64)| {
            *scale >= 1.0 && naming.withheld.iter().all(|withheld| withheld.why.rule != rule)
        };
        if config.rule_scales.is_empty() && rule_scales.iter().all(is_idle) {
            return Ok(names(&naming));
        }
        Ok(names(&found.judged(InForce::scaled(rule_scales))?.naming))
    };
    let ablation = config.ablation.iter().map(changed).collect::<Result<_, DiagnosisError>>()?;

    watch(0.95, "writing the report")?;
    let streams = station.layout.streams.iter().zip(touch_to_touch(station, &left.by_signal));
    let touch_to_touch = streams.filter_map(|(stream, of)| Some((stream.id.clone(), of?))).collect();
    let report = show::report(&show::Evidence {
        config,
        reference,
        station,
        domain: &domain,
        naming: &naming,
        steps: &steps,
        nominal,
        fitted: &fitted,
        adequacy: left.adequacy,
        touch_to_touch,
        with_posture: &left.with_posture,
        bar,
        least_evidence,
        seconds: clock_s() - start_s,
    })?;
    progress.report(1.0, "done");
    let model = steps.models.last().cloned().unwrap_or_else(|| calibrated.clone());
    Ok(DiagnosisOutcome { report, model, calibrated, first_evidence, adequacy: left.adequacy, ablation })
}

/// What a search found, before rules withhold any of it.
struct Found<'a> {
    station: &'a Station,
    takes: &'a [Take],
    reference: &'a Reference,
    domain: &'a TactileDomain<'a>,
    /// Indices of the takes that are not kept for confirmation.
    fitted: &'a [usize],
    start: &'a Model,
    calibrated: &'a SensorModel,
    naming: Naming,
    /// Whether the search ended at its limit of names.
    is_cut_short: bool,
    /// What is left without any of the names.
    before: Measured,
}

/// What rules leave of what was found.
struct Judged {
    naming: Naming,
    steps: Steps,
    left: Measured,
}

/// What is left of a model's residuals on the fitted takes.
#[derive(Clone)]
struct Measured {
    adequacy: Adequacy,
    by_signal: Vec<Left>,
    with_posture: Vec<WithPosture>,
}

fn measured(
    station: &Station,
    domain: &TactileDomain<'_>,
    model: &Model,
    fitted: &[usize],
    reference: &Reference,
) -> Result<Measured, DiagnosisError> {
    let (adequacy, by_signal) = adequacy(station, domain, model, fitted)?;
    let with_posture = with_posture(domain, model, fitted, reference.posture)?;
    Ok(Measured { adequacy, by_signal, with_posture })
}

impl Found<'_> {
    /// What stands by these rules.
    fn judged(&self, rules: InForce<'_>) -> Result<Judged, DiagnosisError> {
        let Self { station, domain, fitted, start, reference, .. } = *self;
        let known = start.effects.len();
        let has_readings = domain.num_raw_takes() > 0;
        let mut naming = self.naming.clone();
        withhold(domain, known, &mut naming, fitted, self.is_cut_short, reference, rules)?;
        naming.begin_again_without_names(start);
        let mut left = measured(station, domain, &naming.model, fitted, reference)?;
        if has_readings && !self.is_cut_short && rules.has(fired::WEAK_BESIDE_REST) {
            let overdispersion = left.adequacy.overdispersion(&reference.left);
            if withhold_weak(domain, known, &mut naming, fitted, overdispersion, rules)? {
                naming.begin_again_without_names(start);
                left = measured(station, domain, &naming.model, fitted, reference)?;
            }
        }
        let mut steps = Steps::new(station, domain, &naming, fitted, self.calibrated, self.takes)?;
        let fired = match self.repeat_more(&naming, &left, rules) {
            None if has_readings => steps.widen_the_gap(station, domain, fitted, rules)?,
            fired => fired.filter(|_| has_readings),
        };
        if let Some(why) = fired {
            naming.withhold(start, why);
            left = self.before.clone();
            steps.models.truncate(1);
        }
        Ok(Judged { naming, steps, left })
    }

    /// Fires if the names are of channels alone, and more of what is `left` repeats with them than without.
    fn repeat_more(&self, naming: &Naming, left: &Measured, rules: InForce<'_>) -> Option<Fired> {
        let names = &naming.model.effects[self.start.effects.len()..];
        let is_of_channels = |effect: &Effect| matches!(effect.place, Place::Channel(_) | Place::Channels(_));
        // What reference sessions leave as well speaks against no name.
        let is_usual =
            self.reference.sessions().is_some() && left.adequacy.repeating <= self.reference.left.repeating;
        if is_usual || !names.iter().all(is_of_channels) {
            return None;
        }
        left.adequacy.repeats_more(&self.before.adequacy, rules)
    }
}
