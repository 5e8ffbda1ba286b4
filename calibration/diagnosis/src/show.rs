//! The report: names with their evidence, the gap step by step, and what is left.

use std::collections::BTreeMap;

use palpate_reports::{
    Bar, Candidate, DiagnosisReport, Gap, NamedEffect, Rival, TooMuchLeft, Unexplained, Verdict,
    WaterfallStep,
};
use palpate_robot_model::{Place, Station};
use palpate_sim::SensorModel;
use palpate_sim::effects::{self, Effect};

use palpate_reports::wording::effect_at;
use rayon::prelude::*;

use crate::DiagnosisError;
use crate::config::DiagnosisConfig;
use crate::engine::{Naming, Tried};
use crate::null::NullBar;
use crate::reference::Reference;
use crate::steps::{Steps, in_doubt, interval, judge_all};
use crate::tactile::adequacy::Adequacy;
use crate::tactile::find::{cells, residual_map};
use crate::tactile::judge::{Judged, gap, gap_interval, judge, metrics, noise_floor, repeated};
use crate::tactile::next::next_experiment;
use crate::tactile::posture::WithPosture;
use crate::tactile::{Observed, TactileDomain};

/// Everything that a report is made of.
pub(crate) struct Evidence<'a> {
    pub(crate) config: &'a DiagnosisConfig,
    pub(crate) reference: &'a Reference,
    pub(crate) station: &'a Station,
    pub(crate) domain: &'a TactileDomain<'a>,
    pub(crate) naming: &'a Naming,
    pub(crate) steps: &'a Steps,
    pub(crate) nominal: &'a SensorModel,
    pub(crate) fitted: &'a [usize],
    pub(crate) adequacy: Adequacy,
    /// As in the report.
    pub(crate) touch_to_touch: BTreeMap<String, f64>,
    /// What is left that changes with posture.
    pub(crate) with_posture: &'a [WithPosture],
    pub(crate) bar: Option<&'a NullBar>,
    /// What a name needed.
    pub(crate) least_evidence: f64,
    pub(crate) seconds: f64,
}

pub(crate) fn report(evidence: &Evidence<'_>) -> Result<DiagnosisReport, DiagnosisError> {
    let Evidence { config, station, domain, naming, steps, nominal, fitted, .. } = *evidence;
    let observed: Vec<&Observed<'_>> = steps.confirm.iter().map(|&take| domain.take(take)).collect();
    let mut models = vec![nominal.clone()];
    models.extend(steps.models.iter().cloned());
    let judged = judge_all(station, &observed, &models)?;
    let last = judged.len() - 1;
    let floor = noise_floor(station, &observed);
    let gaps: Vec<f64> = judged.iter().map(|judged| gap(judged)).collect();
    let held_out = Gap { nominal: gaps[0], calibrated: gaps[1], diagnosed: gaps[last], noise_floor: floor };
    let on_fitted: Vec<&Observed<'_>> = fitted.iter().map(|&take| domain.take(take)).collect();
    let of_fitted = |model: &SensorModel| Ok::<_, DiagnosisError>(gap(&judge(station, &on_fitted, model)?));
    let of_fit = Gap {
        nominal: of_fitted(nominal)?,
        calibrated: of_fitted(&models[1])?,
        diagnosed: of_fitted(&models[last])?,
        noise_floor: noise_floor(station, &on_fitted),
    };
    let repeats = on_fitted.iter().any(|observed| !repeated(observed).is_empty());
    let named: Vec<&Effect> =
        steps.models[steps.models.len() - 1].effects.iter().skip(nominal.effects.len()).collect();

    let mut waterfall = Vec::new();
    for (idx, judged) in judged.iter().enumerate() {
        let step = match idx {
            0 => "nominal".to_owned(),
            1 => "calibrated".to_owned(),
            _ => named[idx - 2].id.clone(),
        };
        let interval_95 = gap_interval(judged, config.bootstrap_resamples, config.seed);
        waterfall.push(WaterfallStep { step, gap: gaps[idx], interval_95 });
    }

    let mut reported = Vec::new();
    for (idx, effect) in named.iter().enumerate() {
        reported.push(named_effect(evidence, effect, idx, [&gaps[idx + 1], &gaps[idx + 2]], &judged)?);
    }
    let because = too_much_left(evidence);
    let verdict = verdict(!because.is_empty(), &reported, repeats);
    let fraction = share_left(&held_out);
    let unexplained = Unexplained {
        fraction,
        significant: matches!(verdict, Verdict::Unexplained | Verdict::PartlyExplained),
        cells: cells(station, &observed, &judged[last], config.seed),
        because,
        touch_to_touch: evidence.touch_to_touch.clone(),
    };
    let ids =
        |takes: &[usize]| takes.iter().map(|&take| domain.take(take).take.id.clone()).collect::<Vec<_>>();
    let first = &naming.rounds[0];
    let mut notes = Vec::new();
    if domain.num_raw_takes() == 0 {
        notes.push(
            "these takes hold events only, in which a skin that creeps looks like a late or filtered stream, and a \
             hand that is a little off like a bent joint: raw readings or reference sessions should confirm a name"
                .to_owned(),
        );
    }
    if steps.confirm.len() == fitted.len() && steps.confirm == fitted {
        notes.push("no take is held out: the figures are from the takes that were fitted".to_owned());
    }
    if evidence.bar.is_none() {
        notes.push(
            "the bar is the shipped one: no sessions were simulated to set it for this station".to_owned(),
        );
    }
    if let Some(count) = evidence.reference.sessions() {
        notes.push(format!(
            "limits are what {count} reference sessions of this station leave, in which nothing is wrong"
        ));
    }
    for effect in &naming.dropped {
        notes.push(format!(
            "{} was named at first and dropped when later effects accounted for it",
            effect_at(&effect.id, &effect.place)
        ));
    }
    Ok(DiagnosisReport {
        verdict,
        sentence: sentence(verdict, &reported, &held_out, evidence.reference.sessions()),
        candidates: first
            .tried
            .iter()
            .enumerate()
            .filter(|&(idx, _)| first.named != Some(idx))
            .map(|(_, tried)| candidate(station, tried))
            .collect(),
        effects: reported,
        in_doubt: in_doubt(naming),
        cells: cells(station, &observed, &judged[1], config.seed),
        gap: held_out.clone(),
        held_out,
        fitted: of_fit,
        waterfall,
        metrics: BTreeMap::from([
            ("nominal".to_owned(), metrics(&judged[0])),
            ("calibrated".to_owned(), metrics(&judged[1])),
            ("diagnosed".to_owned(), metrics(&judged[last])),
        ]),
        unexplained,
        next_experiment: next_experiment(station, domain, naming, fitted, verdict)?,
        residual_map: residual_map(station, &observed, &judged[1], &judged[last]),
        takes: BTreeMap::from([("fit".to_owned(), ids(fitted)), ("confirm".to_owned(), ids(&steps.confirm))]),
        reference_sessions: evidence.reference.sessions(),
        bar: Bar {
            evidence: evidence.least_evidence,
            ..evidence.bar.map_or_else(Bar::default, NullBar::to_report)
        },
        notes,
        seconds: evidence.seconds,
    })
}

fn named_effect(
    evidence: &Evidence<'_>,
    effect: &Effect,
    idx: usize,
    [before, after]: [&f64; 2],
    judged: &[Vec<Judged>],
) -> Result<NamedEffect, DiagnosisError> {
    let Evidence { station, domain, naming, steps, nominal, fitted, bar, .. } = *evidence;
    let at = nominal.effects.len() + idx;
    let round = naming.round_of(effect).map(|(round, _)| round);
    let mut class = vec![effect.id.clone()];
    let (mut members, mut rivals) = (Vec::new(), Vec::new());
    if let Some(round) = round {
        for &member in &round.class {
            let other = &round.tried[member].effect;
            // What was named later is there beside it, not in its place.
            let is_named = naming.model.effects.iter().any(|e| e.id == other.id && e.place == other.place);
            if is_named {
                continue;
            }
            if !class.contains(&other.id) {
                class.push(other.id.clone());
            }
            members.push(member);
        }
    }
    if let Some(round) = round {
        let confirm: Vec<&Observed<'_>> = steps.confirm.iter().map(|&take| domain.take(take)).collect();
        let rival = |member: usize| {
            let tried = &round.tried[member];
            let model = steps.with_rival(station, domain, naming, fitted, at, tried)?;
            let (id, place) = (tried.effect.id.clone(), tried.effect.place.clone());
            Ok(Rival { id, place, gap_after: gap(&judge(station, &confirm, &model)?) })
        };
        rivals = members.into_par_iter().map(rival).collect::<Result<Vec<_>, DiagnosisError>>()?;
    }
    let takes = judged[idx + 1].iter().zip(&judged[idx + 2]);
    let mismatch = |judged: &Judged| judged.mismatch_s.iter().sum::<f64>();
    let improved = takes.filter(|(before, after)| mismatch(after) < mismatch(before)).count();
    let strength = naming.evidence.get(at).copied().unwrap_or(0.0);
    Ok(NamedEffect {
        id: effect.id.clone(),
        place: effect.place.clone(),
        parameters: effect.parameters.clone(),
        interval: interval(domain, effect, &naming.standard_errors[at]),
        gap_before: *before,
        gap_after: *after,
        p_value: bar.and_then(|bar| bar.p_value(strength)),
        evidence: strength,
        takes_improved: format!("{improved}/{}", judged[0].len()),
        class,
        rivals,
        explanation: explain(station, effect),
    })
}

fn explain(station: &Station, effect: &Effect) -> String {
    effects::tactile(&effect.id).map_or_else(String::new, |kind| kind.explain(effect, station))
}

fn candidate(station: &Station, tried: &Tried) -> Candidate {
    Candidate {
        id: tried.effect.id.clone(),
        place: tried.effect.place.clone(),
        parameters: tried.effect.parameters.clone(),
        evidence: tried.evidence,
        share_removed: tried.share,
        explanation: explain(station, &tried.effect),
    }
}

/// Share of the calibrated gap that is left, of what lies above the noise floor; of all of it where the floor is no
/// floor, as where it comes from motions that were repeated only roughly.
fn share_left(gap: &Gap) -> f64 {
    let floor = gap.noise_floor.filter(|floor| *floor < gap.calibrated).unwrap_or(0.0);
    let removable = gap.calibrated - floor;
    if removable > 0.0 { ((gap.diagnosed - floor) / removable).clamp(0.0, 1.0) } else { 0.0 }
}

/// What is left, by the measures that are above their limits.
fn too_much_left(evidence: &Evidence<'_>) -> Vec<TooMuchLeft> {
    let (of, limits) = (&evidence.adequacy, &evidence.reference.left);
    let layout = &evidence.station.layout;
    let patch = layout.patches.get(of.patch);
    let patch = patch.map_or(("", ""), |patch| (patch.id.as_str(), patch.label.as_str()));
    let stream = layout.streams.get(of.stream);
    let stream = stream.map_or(("", ""), |stream| (stream.id.as_str(), stream.label.as_str()));
    let mut left = Vec::new();
    let mut measure = |check: &str, measured: f64, limit: f64, place: Option<Place>, says: String| {
        if measured > limit {
            let sentence = format!("{says} (at most {limit} where nothing is missing).");
            left.push(TooMuchLeft { check: check.to_owned(), measured, limit, place, sentence });
        }
    };
    let says = format!("Residuals of repeated motions have {:.2} variances in common", of.repeating);
    measure("repeating", of.repeating, limits.repeating, None, says);
    let says = format!(
        "In the readings of patch {}, residuals of repeated motions have {:.2} variances in common",
        patch.1, of.at_patch
    );
    measure("repeating_at_patch", of.at_patch, limits.at_patch, Some(Place::Patch(patch.0.to_owned())), says);
    let says = format!(
        "Quiet channels of the {} stream wander together: the variance of their mean is {:.2} times what noise and the \
         wander of a board make it",
        stream.1, of.common_mode
    );
    let place = Place::Stream(stream.0.to_owned());
    measure("common_mode", of.common_mode, limits.common_mode, Some(place), says);
    let says = format!(
        "Events differ from what the thresholds make of the readings by a loss of {:.2} variances a sample",
        of.switching
    );
    measure("switching", of.switching, limits.switching, None, says);
    if evidence.domain.num_raw_takes() > 0 {
        let says = format!(
            "Events and readings are farther off than noise, by a loss of {:.2} variances a sample",
            of.loss
        );
        measure("loss", of.loss, limits.loss, None, says);
    }
    left.extend(
        evidence
            .with_posture
            .iter()
            .map(|change| change.too_much_left(evidence.station, evidence.reference.posture.evidence)),
    );
    left
}

/// `left`: whether more is left than where nothing is missing; `repeats`: whether any motion is repeated, by which to tell.
fn verdict(left: bool, named: &[NamedEffect], repeats: bool) -> Verdict {
    match (named.is_empty(), left) {
        (_, false) if !repeats => Verdict::CannotBeJudged,
        (true, true) => Verdict::Unexplained,
        (true, false) => Verdict::NoDiscrepancy,
        (false, true) => Verdict::PartlyExplained,
        (false, false) => Verdict::Explained,
    }
}

fn sentence(verdict: Verdict, named: &[NamedEffect], gap: &Gap, references: Option<usize>) -> String {
    let removed = if gap.calibrated > 0.0 { 100.0 * (1.0 - gap.diagnosed / gap.calibrated) } else { 0.0 };
    let names: Vec<&str> = named.iter().map(|effect| effect.explanation.trim_end_matches('.')).collect();
    let found = match names.len() {
        0 => String::new(),
        1 => format!("{}. Adding it removes {removed:.0} % of the gap on takes it has not seen", names[0]),
        count => format!(
            "{count} effects are missing from the simulator; adding them removes {removed:.0} % of the gap on takes \
             they have not seen"
        ),
    };
    match verdict {
        Verdict::Explained => format!("{found}."),
        Verdict::PartlyExplained => format!("{found}; something that repeats is still unexplained."),
        Verdict::Unexplained => {
            "Something repeats that no effect of the library accounts for: see where.".to_owned()
        }
        Verdict::CannotBeJudged if named.is_empty() => {
            "No effect of the library is found. No motion is repeated, so that nobody can tell whether something else is \
             missing: mark the repetitions of each motion."
                .to_owned()
        }
        Verdict::CannotBeJudged => {
            format!("{found}; no motion is repeated, by which to tell whether something else is missing.")
        }
        Verdict::NoDiscrepancy if references.is_some() => {
            "Nothing stands out from what the reference sessions of this station leave.".to_owned()
        }
        Verdict::NoDiscrepancy => {
            "Simulation and measurement agree as well as repetitions of the same motion do.".to_owned()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_left_is_of_what_lies_above_the_floor_if_that_is_one() {
        let left = |diagnosed: f64, noise_floor: Option<f64>| {
            share_left(&Gap { nominal: 0.03, calibrated: 0.02, diagnosed, noise_floor })
        };
        assert!((left(0.015, Some(0.01)) - 0.5).abs() < 1e-12);
        assert!((left(0.015, None) - 0.75).abs() < 1e-12);
        assert!((left(0.02, Some(0.025)) - 1.0).abs() < 1e-12, "a floor above the gap hides nothing");
    }
}
