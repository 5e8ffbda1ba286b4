//! The diagnosis of a session: calibrate, find, name, add, show.

use palpate_recording::Take;
use palpate_reports::DiagnosisReport;
use palpate_robot_model::Place;
use palpate_sim::SensorModel;
use palpate_sim::effects::Effect;
use palpate_sim::job::{Cancel, Progress};

use crate::config::{DiagnosisConfig, KEPT_EVIDENCE, LEAST_SHARE, NUM_FITS};
use crate::engine::{self, NamingConfig};
use crate::fired::{self, InForce};
use crate::null::NullBar;
use crate::prepare::{Prepared, check, prepare};
use crate::reference::Reference;
use crate::steps::Steps;
use crate::tactile::adequacy::{
    Adequacy, adequacy, leave_most_at_a_patch, repeating_by_patch, touch_to_touch,
};
use crate::tactile::posture::with_posture;
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
}

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
    let shipped;
    let reference = match &config.reference {
        Some(reference) => reference.check(station)?,
        None => {
            shipped = Reference::shipped(station);
            &shipped
        }
    };
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
    withhold(&domain, &start, &mut naming, &fitted, is_cut_short, reference, rules)?;

    watch(0.86, "judging on takes that nothing was fitted to")?;
    let (before, left_before) = adequacy(station, &domain, &start, &fitted)?;
    let (mut after, mut left) = adequacy(station, &domain, &naming.model, &fitted)?;
    let has_readings = domain.num_raw_takes() > 0;
    if has_readings && !is_cut_short && rules.has(fired::WEAK_BESIDE_REST) {
        let overdispersion = after.overdispersion(&reference.left);
        if withhold_weak(&domain, start.effects.len(), &mut naming, &fitted, overdispersion)? {
            (after, left) = adequacy(station, &domain, &naming.model, &fitted)?;
        }
    }
    let names = &naming.model.effects[start.effects.len()..];
    let is_of_channels = |effect: &Effect| matches!(effect.place, Place::Channel(_) | Place::Channels(_));
    let of_channels_only = names.iter().all(is_of_channels);
    let of_limb = domain.limb_of(names);
    let by_patch = [&left_before, &left].map(|left| repeating_by_patch(station, left));
    let mut bent = with_posture(&domain, &naming.model, &fitted, reference.posture)?;
    let evidence = naming.evidence[start.effects.len()..].iter().sum();
    // What reference sessions leave as well speaks against no name.
    let is_usual = reference.sessions().is_some() && after.repeating <= reference.left.repeating;
    let of_something_else = || {
        let at_patch = rules.keep(leave_most_at_a_patch(&by_patch, &of_limb, reference.much_at_patch()));
        at_patch.or_else(|| bent.iter().find_map(|change| rules.keep(change.outweighs(evidence, &of_limb))))
    };
    let fired = rules
        .keep(after.repeats_more(&before).filter(|_| of_channels_only && !is_usual))
        .or_else(|| of_something_else().filter(|_| !is_cut_short));
    let mut steps = Steps::new(station, &domain, &naming, &fitted, &calibrated, takes)?;
    let fired = match fired {
        None if has_readings => rules.keep(steps.widen_the_gap(station, &domain, &fitted)?),
        fired => fired.filter(|_| has_readings),
    };
    if let Some(why) = fired {
        naming.withhold(&start, why);
        (after, left) = (before, left_before);
        bent = with_posture(&domain, &start, &fitted, reference.posture)?;
        steps.models.truncate(1);
    }
    let first_evidence = naming.rounds[0].tried.iter().map(|tried| tried.evidence).fold(0.0, f64::max);
    watch(0.95, "writing the report")?;
    let streams = station.layout.streams.iter().zip(touch_to_touch(station, &left));
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
        adequacy: after,
        touch_to_touch,
        with_posture: &bent,
        bar,
        least_evidence,
        seconds: clock_s() - start_s,
    })?;
    progress.report(1.0, "done");
    let model = steps.models.last().cloned().unwrap_or_else(|| calibrated.clone());
    Ok(DiagnosisOutcome { report, model, calibrated, first_evidence, adequacy: after })
}
