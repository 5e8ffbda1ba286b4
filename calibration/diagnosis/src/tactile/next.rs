//! What to record next: the motion on which two rivals differ most, or that shows most of what has no name.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::{DMatrix, DVector};
use palpate_reports::{NextExperiment, Purpose, Verdict};
use palpate_robot_model::Station;
use palpate_sim::effects::Effect;

use super::TactileDomain;
use super::adequacy::{adequacy, left_over};
use crate::DiagnosisError;
use crate::engine::{Domain, Model, Naming, Round, Series, inverse};

/// Effects with more parameters than this are not compared: they can imitate too much for a linear distance.
const MOST_PARAMETERS: usize = 8;

/// Primitive and object of a take.
type OfMotion = (String, String);

/// What to record next: `None` where nothing is open.
///
/// Where no motion is repeated, the one that touches most: before something repeats, nothing else can be told. Then what
/// tells the first name from its strongest rival of another kind, or what was withheld from its own; then the motion in which
/// most is left of what repeats and has no name.
pub(crate) fn next_experiment(
    station: &Station,
    domain: &TactileDomain<'_>,
    naming: &Naming,
    takes: &[usize],
    verdict: Verdict,
) -> Result<Option<NextExperiment>, DiagnosisError> {
    if verdict == Verdict::CannotBeJudged {
        return Ok(repeat(station, domain, takes));
    }
    // What was dropped again has been told apart.
    let stands = |named: &Effect| {
        naming.model.effects.iter().any(|effect| effect.id == named.id && effect.place == named.place)
    };
    let open = naming.rounds.iter().filter_map(rivals).find(|(_, named, _)| stands(named));
    if let Some((round, named, rival)) = open {
        let label = format!("Cannot tell {} from {} on these takes", named.id, rival.id);
        let next = separate(station, domain, &round.before, [named, rival], takes, &label)?;
        if next.is_some() {
            return Ok(next);
        }
    }
    if !matches!(verdict, Verdict::Unexplained | Verdict::PartlyExplained) {
        return Ok(None);
    }
    for withheld in naming.withheld.iter().map(|withheld| &withheld.effect) {
        let Some((round, rival)) = rival_of(naming, withheld) else { continue };
        let label = format!("{} was withheld, and may stand for {}", withheld.id, rival.id);
        let next = separate(station, domain, &round.before, [withheld, rival], takes, &label)?;
        // Rivals that no motion of this session separates are told apart by none that can be asked for.
        if let Some(next) = next.filter(|next| next.expected_gain >= LEAST_GAIN) {
            return Ok(Some(next));
        }
    }
    show_more(station, domain, &naming.model, takes)
}

/// Standard deviations a repetition below which a motion separates nothing.
const LEAST_GAIN: f64 = 1.0;

/// The motion (of those in the session) that tells `named` from `rival`, by what is left of the difference of their
/// predictions after the first has been fitted to the second's; `None` if they cannot be compared.
///
/// For a motion u this is `min over theta_a of |y_b(u) - y_a(u; theta_a)|^2 / sigma^2`, to first order in theta_a, a
/// repetition: what one more of them is worth.
fn separate(
    station: &Station,
    domain: &TactileDomain<'_>,
    before: &Model,
    [named, rival]: [&Effect; 2],
    takes: &[usize],
    label: &str,
) -> Result<Option<NextExperiment>, DiagnosisError> {
    let parameters = domain.parameters(named);
    if parameters.len() > MOST_PARAMETERS {
        return Ok(None);
    }
    let with = |effect: &Effect| {
        let mut model: Model = before.clone();
        model.effects.push(effect.clone());
        model
    };
    // Squared distance and number of repetitions, by primitive and object.
    let mut by_motion: BTreeMap<OfMotion, (f64, usize)> = BTreeMap::new();
    for &take in takes {
        let of_named = domain.predict(take, &with(named))?;
        let of_rival = domain.predict(take, &with(rival))?;
        let weights: Vec<f64> = of_named
            .iter()
            .enumerate()
            .flat_map(|(signal, predicted)| domain.weights(take, signal, predicted))
            .collect();
        let weighted = |other: &[Series], step: f64| -> DVector<f64> {
            let rows = other.iter().zip(&of_named).flat_map(|(b, a)| b.iter().zip(a.iter()));
            let rows = rows.zip(&weights).map(|((b, a), weight)| (b - a) * weight / step);
            DVector::from_iterator(weights.len(), rows)
        };
        let difference = weighted(&of_rival, 1.0);
        let mut responses = Vec::with_capacity(parameters.len());
        for parameter in &parameters {
            let value = named.parameter(&parameter.name);
            let step = 0.25 * parameter.dose;
            let mut stepped = named.clone();
            stepped.parameters.insert(parameter.name.clone(), (value + step).min(parameter.upper));
            responses.push(weighted(&domain.predict(take, &with(&stepped))?, step));
        }
        let normal =
            DMatrix::from_fn(responses.len(), responses.len(), |i, j| responses[i].dot(&responses[j]));
        let score = DVector::from_iterator(responses.len(), responses.iter().map(|r| r.dot(&difference)));
        let left = (difference.norm_squared() - score.dot(&(inverse(&normal) * &score))).max(0.0);
        let sum = by_motion.entry(motion_of(domain, take)).or_default();
        sum.0 += left;
        sum.1 += repetitions_of(domain, take);
    }
    Ok(most_worth(by_motion).map(|((primitive, object), gain)| NextExperiment {
        separates: vec![named.id.clone(), rival.id.clone()],
        expected_gain: gain,
        purpose: Purpose::Separate,
        sentence: format!(
            "{label}: record more of {primitive} on {}. Of the motions in this session it separates them best, by {gain:.1} \
             standard deviations a repetition.",
            label_of(station, &object)
        ),
        primitive,
        object,
    }))
}

/// The motion that touches most channels, to be repeated.
fn repeat(station: &Station, domain: &TactileDomain<'_>, takes: &[usize]) -> Option<NextExperiment> {
    let mut touched: BTreeMap<OfMotion, BTreeSet<usize>> = BTreeMap::new();
    for &take in takes {
        let active = domain.take(take).active.iter().enumerate().filter(|(_, active)| **active);
        let channels = active.map(|(at, _)| at % station.layout.num_channels());
        touched.entry(motion_of(domain, take)).or_default().extend(channels);
    }
    // The first of several that touch as many.
    let most = touched.into_iter().rev().max_by_key(|(_, channels)| channels.len());
    most.map(|((primitive, object), channels)| NextExperiment {
        separates: Vec::new(),
        expected_gain: 0.0,
        purpose: Purpose::Repeat,
        sentence: format!(
            "No motion is repeated, so nobody can tell what is left from noise: record {primitive} on {} at least twice in the \
             same way, and mark the repetitions. Of the motions in this session it touches most channels, {} of {}.",
            label_of(station, &object),
            channels.len(),
            station.layout.num_channels()
        ),
        primitive,
        object,
    })
}

/// The motion in which most is left that repeats; where it is in no residual of repetitions, most of the loss.
fn show_more(
    station: &Station,
    domain: &TactileDomain<'_>,
    model: &Model,
    takes: &[usize],
) -> Result<Option<NextExperiment>, DiagnosisError> {
    // What repetitions share and what is lost, each with the number of repetitions.
    let mut shared: BTreeMap<OfMotion, (f64, usize)> = BTreeMap::new();
    let mut lost = shared.clone();
    for &take in takes {
        let (_, left) = adequacy(station, domain, model, &[take])?;
        let left = left_over(&left);
        for (sums, left) in [(&mut shared, left.repeating), (&mut lost, left.loss)] {
            let sum = sums.entry(motion_of(domain, take)).or_default();
            sum.0 += left.max(0.0);
            sum.1 += repetitions_of(domain, take);
        }
    }
    let repeats = shared.values().any(|(squared, _)| *squared > 0.0);
    let what = if repeats { "the residual that repetitions share" } else { "the loss" };
    Ok(most_worth(if repeats { shared } else { lost }).map(|((primitive, object), gain)| NextExperiment {
        separates: Vec::new(),
        expected_gain: gain,
        purpose: Purpose::ShowMore,
        sentence: format!(
            "Something is left that has no name: record more of {primitive} on {}. Of the motions in this session it shows most \
             of it: {what} is {gain:.1} standard deviations a repetition there.",
            label_of(station, &object)
        ),
        primitive,
        object,
    }))
}

/// The motion whose repetitions are worth most, and the square root of what one of them is worth.
fn most_worth(by_motion: BTreeMap<OfMotion, (f64, usize)>) -> Option<(OfMotion, f64)> {
    let worth = by_motion
        .into_iter()
        .map(|(motion, (squared, repetitions))| (motion, (squared / repetitions.max(1) as f64).sqrt()));
    worth.max_by(|(_, a), (_, b)| a.total_cmp(b))
}

fn motion_of(domain: &TactileDomain<'_>, take: usize) -> OfMotion {
    let meta = &domain.take(take).take.meta;
    (meta.primitive.clone(), meta.object.clone())
}

/// Marked repetitions of a take; one where none is marked.
fn repetitions_of(domain: &TactileDomain<'_>, take: usize) -> usize {
    let repetitions = domain.take(take).repetitions.iter();
    repetitions.filter(|(_, label)| !label.is_empty()).count().max(1)
}

fn label_of<'s>(station: &'s Station, object: &'s str) -> &'s str {
    station.objects.get(object).map_or(object, |object| object.label.as_str())
}

/// The strongest rival of what was withheld, of another kind: of its class in the round that named it, or else the next best that
/// was tried there.
fn rival_of<'n>(naming: &'n Naming, withheld: &Effect) -> Option<(&'n Round, &'n Effect)> {
    let (round, _) = naming.round_of(withheld)?;
    let rival = rivals(round).map(|(_, _, rival)| rival);
    let next_best = || round.tried.iter().map(|tried| &tried.effect).find(|other| other.id != withheld.id);
    Some((round, rival.or_else(next_best)?))
}

/// The named effect of a round and its strongest rival of another kind.
fn rivals(round: &Round) -> Option<(&Round, &Effect, &Effect)> {
    let named = &round.tried[round.named?].effect;
    let others = round.class.iter().map(|&idx| &round.tried[idx].effect);
    others.into_iter().find(|other| other.id != named.id).map(|rival| (round, named, rival))
}
