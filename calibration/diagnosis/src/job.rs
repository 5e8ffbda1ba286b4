//! The diagnosis of a session: calibrate, find, name, add, show.

use std::collections::BTreeMap;

use palpate_calibration::{CalibrationConfig, CalibrationError, HoldOut, PairedTake, calibrate, held_out};
use palpate_recording::Take;
use palpate_reports::{DiagnosisReport, Doubt, EffectInDoubt};
use palpate_robot_model::{Place, Station};
use palpate_sim::SensorModel;
use palpate_sim::effects::{self, Effect};
use palpate_sim::job::{Cancel, NoProgress, Progress};
use rayon::prelude::*;

use crate::engine::{self, Domain, Model, Naming, NamingConfig, Tried};
use crate::null::NullBar;
use crate::rules::{self, Fired, InForce, RULES, Withheld};
use crate::tactile::adequacy::{
    Adequacy, account_where_they_act, adequacy, changed_signals, complete_by_signal, leave_most_at_a_patch,
    repeating_by_patch,
};
use crate::tactile::judge::{Judged, flickering, gap, judge, set_thresholds};
use crate::tactile::posture::with_posture;
use crate::tactile::{Observed, TactileDomain};
use crate::withhold::withhold;
use crate::{DiagnosisError, show};

/// What to do.
#[derive(Clone, Debug)]
pub struct DiagnosisConfig {
    /// Confirm takes: opened once, for the report.
    pub hold_out: HoldOut,
    /// Most effects to name.
    pub max_effects: usize,
    /// Effects to leave out of the library, by id.
    pub without: Vec<String>,
    /// Rules that withhold nothing, by id: for benches that ask what each of [`RULES`] is good for.
    pub without_rules: Vec<String>,
    /// Resamples behind intervals.
    pub bootstrap_resamples: usize,
    /// Seed of resampling.
    pub seed: u64,
}

impl Default for DiagnosisConfig {
    fn default() -> Self {
        Self {
            hold_out: HoldOut::Auto,
            max_effects: 8,
            without: Vec::new(),
            without_rules: Vec::new(),
            bootstrap_resamples: 1000,
            seed: 0,
        }
    }
}

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
}

/// Steps of the first fit of the model's own parameters.
const FIRST_STEPS: usize = 6;
/// Candidates fitted in a round.
pub(crate) const NUM_FITS: usize = 8;
/// Share of the loss that a named effect removes at least.
pub(crate) const LEAST_SHARE: f64 = 0.002;

/// Evidence that a name must have in the end, beside all others. Of those that had 20 to 25 on the stations of the blind bench
/// four were right, weak all of them, and two stood for effects of no library; of those with less none was right.
pub(crate) const KEPT_EVIDENCE: f64 = 25.0;

/// Evidence and share that a name needs where takes hold events only. What the model gets wrong on its own is then all in
/// the moments at which channels switch, with no reading to tell it by: of 32 sessions of emulated stations that hide nothing
/// three reached more than 120, with shares up to 0.025, and one 109 with more than 0.03.
const EVENTS_EVIDENCE: f64 = 120.0;
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
    let Prepared { domain, start, calibrated, fitted } = prepare(config, station, takes, nominal, cancel)?;
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
    let mut naming = engine::name(&domain, &start, &fitted, &naming_config, &|fraction, stage| {
        watch(0.1 + 0.75 * fraction, stage)
    })?;
    if naming.model.effects.len() > start.effects.len() {
        naming.settle(&domain, &fitted)?;
    }
    let is_cut_short = naming.model.effects.len() - start.effects.len() >= config.max_effects;
    let rules = InForce::all_but(&config.without_rules);
    withhold(&domain, &start, &mut naming, &fitted, is_cut_short, rules)?;

    watch(0.86, "judging on takes that nothing was fitted to")?;
    let (before, left_before) = adequacy(station, &domain, &start, &fitted)?;
    let (mut adequacy, left) = adequacy(station, &domain, &naming.model, &fitted)?;
    let changed = changed_signals(&domain, &naming.model, start.effects.len(), &fitted)?;
    let complete = complete_by_signal(station);
    let names = &naming.model.effects[start.effects.len()..];
    let is_of_channels = |effect: &Effect| matches!(effect.place, Place::Channel(_) | Place::Channels(_));
    let of_channels_only = names.iter().all(is_of_channels);
    let of_limb = domain.limb_of(names);
    let by_patch = [&left_before, &left].map(|left| repeating_by_patch(station, left));
    let mut bent = with_posture(&domain, &naming.model, &fitted)?;
    let evidence = naming.evidence[start.effects.len()..].iter().sum();
    let of_something_else = || {
        let at_patch = rules.keep(leave_most_at_a_patch(&by_patch, &of_limb));
        at_patch.or_else(|| bent.iter().find_map(|change| rules.keep(change.outweighs(evidence, &of_limb))))
    };
    let fired = account_where_they_act(&left_before, &left, &changed, &complete, is_cut_short, rules)
        .or_else(|| rules.keep(adequacy.repeats_more(&before).filter(|_| of_channels_only)))
        .or_else(|| of_something_else().filter(|_| !is_cut_short));
    let mut steps = Steps::new(station, &domain, &naming, &fitted, &calibrated, takes)?;
    let fired = match fired {
        None if domain.num_raw_takes() > 0 => rules.keep(steps.widen_the_gap(station, &domain, &fitted)?),
        fired => fired.filter(|_| domain.num_raw_takes() > 0),
    };
    if let Some(why) = fired {
        naming.withhold(&start, why);
        adequacy = before;
        bent = with_posture(&domain, &start, &fitted)?;
        steps.models.truncate(1);
    }
    let first_evidence = naming.rounds[0].tried.iter().map(|tried| tried.evidence).fold(0.0, f64::max);
    watch(0.95, "writing the report")?;
    let report = show::report(&show::Evidence {
        config,
        station,
        domain: &domain,
        naming: &naming,
        steps: &steps,
        nominal,
        fitted: &fitted,
        adequacy,
        with_posture: &bent,
        bar,
        least_evidence,
        seconds: clock_s() - start_s,
    })?;
    progress.report(1.0, "done");
    let model = steps.models.last().cloned().unwrap_or_else(|| calibrated.clone());
    Ok(DiagnosisOutcome { report, model, calibrated, first_evidence, adequacy })
}

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

/// Models as deployed: calibrated, then with one more effect each.
pub(crate) struct Steps {
    /// Indices of the confirm takes; all takes where none is held out.
    pub(crate) confirm: Vec<usize>,
    /// The calibrated model first.
    pub(crate) models: Vec<SensorModel>,
}

impl Steps {
    fn new(
        station: &Station,
        domain: &TactileDomain<'_>,
        naming: &Naming,
        fitted: &[usize],
        calibrated: &SensorModel,
        takes: &[Take],
    ) -> Result<Self, DiagnosisError> {
        let mut confirm: Vec<usize> = (0..takes.len()).filter(|idx| !fitted.contains(idx)).collect();
        if confirm.is_empty() {
            confirm = (0..takes.len()).collect();
        }
        let ids: Vec<String> = fitted.iter().map(|&take| takes[take].id.clone()).collect();
        let first = naming.rounds.first().map_or(0, |round| round.before.effects.len());
        let all = naming.model.effects.len();
        let step = |count: usize| -> Result<SensorModel, DiagnosisError> {
            // The effects in the order of the final model, each step with the parameters of a fit of its own.
            let partial =
                Model { base: naming.model.base.clone(), effects: naming.model.effects[..count].to_vec() };
            let partial =
                if count == all { partial } else { engine::refit_roughly(domain, &partial, fitted)? };
            let effects = described(domain, naming, &partial.effects, &ids, first);
            let mut model = deployed(station, domain, &partial, effects, calibrated, fitted)?;
            model.provenance.push(format!(
                "effects named by palpate {} on takes {}",
                env!("CARGO_PKG_VERSION"),
                ids.join(", ")
            ));
            Ok(model)
        };
        let mut models = vec![calibrated.clone()];
        models.extend((first + 1..=all).into_par_iter().map(step).collect::<Result<Vec<_>, _>>()?);
        Ok(Self { confirm, models })
    }

    /// The model of the step that adds the effect at `idx`, with `rival` in the place of that effect and everything
    /// fitted anew.
    pub(crate) fn with_rival(
        &self,
        station: &Station,
        domain: &TactileDomain<'_>,
        naming: &Naming,
        fitted: &[usize],
        idx: usize,
        rival: &Tried,
    ) -> Result<SensorModel, DiagnosisError> {
        let mut effects = naming.model.effects[..=idx].to_vec();
        effects[idx] = rival.effect.clone();
        let model = Model { base: naming.model.base.clone(), effects };
        let model = engine::refit_roughly(domain, &model, fitted)?;
        deployed(station, domain, &model, model.effects.clone(), &self.models[0], fitted)
    }

    /// Fires if the last model mistakes more events than the first on the takes `fitted`, on channels that it does not
    /// say flicker by chance. Names that do not shrink the gap that they were made for are no use. A model that has
    /// effects already is held to it without an allowance for chance, so that diagnoses in a row cannot make it worse
    /// bit by bit.
    fn widen_the_gap(
        &self,
        station: &Station,
        domain: &TactileDomain<'_>,
        fitted: &[usize],
    ) -> Result<Option<Fired>, DiagnosisError> {
        let [first, .., last] = &self.models[..] else { return Ok(None) };
        let observed: Vec<&Observed<'_>> = fitted.iter().map(|&take| domain.take(take)).collect();
        let flickers = flickering(station, &observed, last);
        let mistaken = |model: &SensorModel| -> Result<f64, DiagnosisError> {
            let judged = judge(station, &observed, model)?;
            let by_channel = judged.iter().flat_map(|judged| judged.sums.iter().zip(&flickers));
            let frames = by_channel
                .filter(|(_, flickers)| !**flickers)
                .map(|(sum, _)| sum.false_positives + sum.false_negatives);
            Ok(frames.sum::<u64>() as f64)
        };
        let allowance = if first.effects.is_empty() { CHANCE_IN_GAP } else { 0.0 };
        let (before, after) = (mistaken(first)?, mistaken(last)?);
        let fired =
            Fired { rule: rules::GAP_GROWS, measured: after / before.max(1.0), limit: 1.0 + allowance };
        Ok((after > (1.0 + allowance) * before).then_some(fired))
    }
}

/// `model` as a file that starts from `calibrated`: with `effects`, and with thresholds set on the takes `fitted`.
fn deployed(
    station: &Station,
    domain: &TactileDomain<'_>,
    model: &Model,
    effects: Vec<Effect>,
    calibrated: &SensorModel,
    fitted: &[usize],
) -> Result<SensorModel, DiagnosisError> {
    let observed: Vec<&Observed<'_>> = fitted.iter().map(|&take| domain.take(take)).collect();
    let (theta, streams, response) = domain.theta_and_response(model);
    let name = calibrated.name.trim_end_matches(DIAGNOSED);
    let mut model = SensorModel {
        name: format!("{name}{DIAGNOSED}"),
        theta,
        streams,
        response,
        effects,
        ..calibrated.clone()
    };
    set_thresholds(station, &observed, &mut model)?;
    Ok(model)
}

/// What the names of diagnosed models end with.
const DIAGNOSED: &str = ", diagnosed";

/// What may be added to the gap by chance, over what it is.
pub(crate) const CHANCE_IN_GAP: f64 = 0.1;

/// `effects` with intervals and takes, as they go into a model file.
fn described(
    domain: &TactileDomain<'_>,
    naming: &Naming,
    effects: &[Effect],
    takes: &[String],
    first: usize,
) -> Vec<Effect> {
    let mut effects = effects.to_vec();
    for (idx, effect) in effects.iter_mut().enumerate().skip(first) {
        effect.takes = takes.to_vec();
        effect.interval = interval(domain, effect, &naming.standard_errors[idx]);
    }
    effects
}

/// 95 % intervals of the parameters of `effect`.
pub(crate) fn interval<D: Domain>(domain: &D, effect: &Effect, errors: &[f64]) -> BTreeMap<String, [f64; 2]> {
    let parameters = domain.parameters(effect);
    parameters
        .iter()
        .zip(errors)
        .map(|(parameter, error)| {
            let value = effect.parameter(&parameter.name);
            let end = |sign: f64| (value + sign * 1.96 * error).clamp(parameter.lower, parameter.upper);
            (parameter.name.clone(), [end(-1.0), end(1.0)])
        })
        .collect()
}

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
    if let Some(id) = config.without_rules.iter().find(|id| !RULES.iter().any(|rule| rule.id == **id)) {
        let known: Vec<&str> = RULES.iter().map(|rule| rule.id).collect();
        return Err(DiagnosisError::Input(format!(
            "there is no rule {id:?} to switch off; the rules are {}",
            known.join(", ")
        )));
    }
    Ok(&first.station)
}

/// What was withheld, as a report has it.
pub(crate) fn in_doubt(naming: &Naming) -> Vec<EffectInDoubt> {
    let of = |withheld: &Withheld| EffectInDoubt {
        id: withheld.effect.id.clone(),
        place: withheld.effect.place.clone(),
        parameters: withheld.effect.parameters.clone(),
        doubt: vec![Doubt {
            check: withheld.why.rule.to_owned(),
            measured: withheld.why.measured,
            limit: withheld.why.limit,
        }],
    };
    naming.withheld.iter().map(of).collect()
}

impl From<CalibrationError> for DiagnosisError {
    fn from(error: CalibrationError) -> Self {
        match error {
            CalibrationError::Cancelled => Self::Cancelled,
            other => Self::Input(other.to_string()),
        }
    }
}

/// Judges each of `models` on the confirm takes.
pub(crate) fn judge_all(
    station: &Station,
    observed: &[&Observed<'_>],
    models: &[SensorModel],
) -> Result<Vec<Vec<Judged>>, DiagnosisError> {
    models.iter().map(|model| judge(station, observed, model)).collect()
}
