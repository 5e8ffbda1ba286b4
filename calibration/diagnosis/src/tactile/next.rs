//! What to record next: the motion on which two rivals differ most.

use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector};
use palpate_reports::NextExperiment;
use palpate_robot_model::Station;
use palpate_sim::effects::Effect;

use super::TactileDomain;
use crate::DiagnosisError;
use crate::engine::{Domain, Model, Naming, Round, Series, inverse};

/// Effects with more parameters than this are not compared: they can imitate too much for a linear distance.
const MOST_PARAMETERS: usize = 8;

/// The motion (of those in the session) that tells the first name from its strongest rival of another kind, by what is
/// left of the difference of their predictions after the named one has been fitted to the rival's; `None` if no name has
/// such a rival.
///
/// For a motion u this is `min over theta_a of |y_b(u) - y_a(u; theta_a)|^2 / sigma^2`, to first order in theta_a, a
/// repetition: what one more of them is worth.
pub(crate) fn next_experiment(
    station: &Station,
    domain: &TactileDomain<'_>,
    naming: &Naming,
    takes: &[usize],
) -> Result<Option<NextExperiment>, DiagnosisError> {
    // What was dropped again has been told apart.
    let stands = |named: &Effect| {
        naming.model.effects.iter().any(|effect| effect.id == named.id && effect.place == named.place)
    };
    let open = naming.rounds.iter().filter_map(rivals).find(|(_, named, _)| stands(named));
    let Some((round, named, rival)) = open else { return Ok(None) };
    let parameters = domain.parameters(named);
    if parameters.len() > MOST_PARAMETERS {
        return Ok(None);
    }
    let with = |effect: &Effect| {
        let mut model: Model = round.before.clone();
        model.effects.push(effect.clone());
        model
    };
    // Squared distance and number of repetitions, by primitive and object.
    let mut by_motion: BTreeMap<(String, String), (f64, usize)> = BTreeMap::new();
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
        let observed = domain.take(take);
        let repetitions = observed.repetitions.iter().filter(|(_, label)| !label.is_empty()).count();
        let motion = (observed.take.meta.primitive.clone(), observed.take.meta.object.clone());
        let sum = by_motion.entry(motion).or_default();
        sum.0 += left;
        sum.1 += repetitions.max(1);
    }
    let worth = |(squared, repetitions): &(f64, usize)| (squared / *repetitions as f64).sqrt();
    let best = by_motion.iter().max_by(|(_, a), (_, b)| worth(a).total_cmp(&worth(b)));
    Ok(best.map(|((primitive, object), sum)| {
        let label = station.objects.get(object).map_or(object.as_str(), |object| object.label.as_str());
        let gain = worth(sum);
        NextExperiment {
            primitive: primitive.clone(),
            object: object.clone(),
            separates: vec![named.id.clone(), rival.id.clone()],
            expected_gain: gain,
            sentence: format!(
                "Cannot tell {} from {} on these takes: record more of {primitive} on {label}. Of the motions in \
                 this session it separates them best, by {gain:.1} standard deviations a repetition.",
                named.id, rival.id
            ),
        }
    }))
}

/// The named effect of a round and its strongest rival of another kind.
fn rivals(round: &Round) -> Option<(&Round, &Effect, &Effect)> {
    let named = &round.tried[round.named?].effect;
    let others = round.class.iter().map(|&idx| &round.tried[idx].effect);
    others.into_iter().find(|other| other.id != named.id).map(|rival| (round, named, rival))
}
