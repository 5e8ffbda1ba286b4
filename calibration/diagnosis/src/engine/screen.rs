//! Every candidate by its response to a standard dose.

use std::collections::{BTreeMap, BTreeSet};

use palpate_robot_model::Place;
use palpate_sim::effects::{Effect, Parameter};
use rayon::prelude::*;

use super::linear::{Linear, inside, predict};
use super::rows::Column;
use super::{Domain, Series, each, neutral, overlap, share, unite};
use crate::DiagnosisError;

/// A candidate, to first order.
pub(crate) struct Screened {
    /// The effect with its estimated parameters, within their bounds.
    pub(crate) effect: Effect,
    pub(crate) parameters: Vec<Parameter>,
    /// Loss that it promises to remove: to first order on takes it was not fitted to, or, where that is more, what a
    /// large dose removes from all takes. It orders what is fitted, and decides nothing else.
    pub(crate) promise: f64,
    /// The same over the loss in the kinds of rows that it changes.
    pub(crate) promised_share: f64,
}

/// Large doses (of an effect at a place, of one of its parameters, by their number) that made what is left so much
/// worse when they were last tried that they are not tried again.
#[derive(Default)]
pub(crate) struct Hopeless(BTreeSet<(String, Place, usize, usize)>);

impl Hopeless {
    fn key(effect: &Effect, parameter: usize, dose: usize) -> (String, Place, usize, usize) {
        (effect.id.clone(), effect.place.clone(), parameter, dose)
    }

    fn contains(&self, effect: &Effect, parameter: usize, dose: usize) -> bool {
        self.0.contains(&Self::key(effect, parameter, dose))
    }

    /// Hears that a dose removes so much of the squares that there are where it acts.
    fn hear(&mut self, effect: &Effect, parameter: usize, dose: usize, removed: f64, squares: f64) {
        if removed < -HOPELESS_SHARE * squares {
            self.0.insert(Self::key(effect, parameter, dose));
        }
    }
}

/// Share of the squares that a large dose must add to be hopeless: it then is far from what is there, whatever else is
/// named first.
const HOPELESS_SHARE: f64 = 0.1;

/// Screens `candidates` around `linear`, with large doses that are not `hopeless`; `done` hears the fraction of the
/// work and may stop it.
///
/// One simulation serves every place of an effect that reaches other units: the response is split by unit.
/// Responses take much memory, so that those of an effect are assessed, and forgotten, before others are computed
/// on the same core.
pub(crate) fn screen<D: Domain>(
    linear: &Linear<'_, D>,
    candidates: &[Effect],
    hopeless: &mut Hopeless,
    done: &(dyn Fn(f64) -> Result<(), DiagnosisError> + Sync),
) -> Result<Vec<Screened>, DiagnosisError> {
    let of_effects: Vec<&[Effect]> = candidates.chunk_by(|one, next| one.id == next.id).collect();
    let known = &*hopeless;
    let dosed =
        each(of_effects, |fraction, _| done(fraction), |places| screen_places(linear, places, known))?;
    let squares = linear.squares_by_unit();
    let mut screened = Vec::with_capacity(candidates.len());
    for (one, doses) in dosed.into_iter().flatten() {
        let reach = linear.domain.reach(&one.effect);
        for Dosed { dose, removed } in doses {
            hopeless.hear(&one.effect, 0, dose, removed, within(&squares, &reach));
        }
        screened.push(one);
    }
    dose_places_largely(linear, &mut screened, &squares, hopeless)?;
    Ok(screened)
}

/// One effect at all its `places`, with what became of its large doses; places at which it does nothing are left out.
fn screen_places<D: Domain>(
    linear: &Linear<'_, D>,
    places: &[Effect],
    hopeless: &Hopeless,
) -> Result<Vec<(Screened, Vec<Dosed>)>, DiagnosisError> {
    let parameters: Vec<Vec<Parameter>> =
        places.iter().map(|effect| linear.domain.parameters(effect)).collect();
    let neutrals: Vec<Effect> =
        places.iter().zip(&parameters).map(|(effect, parameters)| neutral(effect, parameters)).collect();
    let mut columns: Vec<Vec<Column>> = parameters.iter().map(|p| vec![Column::default(); p.len()]).collect();
    let of_places = neutrals.iter().zip(&parameters).enumerate();
    let items = of_places.flat_map(|(owner, (effect, parameters))| {
        parameters.iter().enumerate().map(move |(idx, parameter)| Item {
            owner,
            parameter: idx,
            dose: 0,
            effect: dosed(effect, parameter),
            step: parameter.dose,
            name: parameter.name.clone(),
        })
    });
    let passes = pack(linear.domain, items.collect());
    let respond = |pass: &Vec<(Item, Vec<bool>)>| {
        let mut model = linear.model.clone();
        model.effects.extend(pass.iter().map(|(item, _)| item.effect.clone()));
        let predicted = predict(linear.domain, &model, &linear.takes)?;
        let owner = owners(pass.iter().map(|(_, reach)| reach.as_slice()), linear.domain.num_units());
        let steps: Vec<f64> = pass.iter().map(|(item, _)| item.step).collect();
        Ok(linear.columns(&linear.predicted, &predicted, &owner, &steps))
    };
    let split: Vec<Vec<Column>> = passes.par_iter().map(respond).collect::<Result<_, DiagnosisError>>()?;
    for (column, (item, _)) in split.into_iter().flatten().zip(passes.iter().flatten()) {
        columns[item.owner][item.parameter] = column;
    }
    let jobs: Vec<_> = neutrals.into_iter().zip(parameters).zip(columns).collect();
    jobs.into_par_iter()
        .filter(|(_, columns)| columns.iter().any(|column| !column.is_empty()))
        .map(|((effect, parameters), columns)| {
            let assessment = linear.assess(&columns, &linear.residual);
            let estimate = stepped(&effect, &parameters, assessment.step.as_slice());
            let promise = assessment.held_out_gains.iter().sum::<f64>();
            let loss = linear.loss_in(&linear.kinds_in(&columns));
            let promised_share = share(promise, loss);
            let screened = Screened { effect: estimate, parameters, promise, promised_share };
            match &screened.effect.place {
                Place::Stream(_) if screened.parameters.len() <= FEW => {
                    dosed_largely(linear, &effect, screened, hopeless)
                }
                _ => Ok((screened, Vec::new())),
            }
        })
        .collect()
}

/// Parameters of an effect that is tried at large doses too.
const FEW: usize = 2;
/// Large doses, as multiples of the standard one.
const LARGE_DOSES: [f64; 2] = [1.0, 3.0];

/// What became of a large dose.
struct Dosed {
    dose: usize,
    removed: f64,
}

/// The sum of `squares` over the units that are reached.
fn within(squares: &[f64], reach: &[bool]) -> f64 {
    squares.iter().zip(reach).filter(|(_, reached)| **reached).map(|(squares, _)| squares).sum()
}

/// `screened`, or the effect at a large dose of its first parameter where that removes more than the estimate promises:
/// what delays or filters a whole stream is far from linear, so that a small dose says little about a large effect.
fn dosed_largely<D: Domain>(
    linear: &Linear<'_, D>,
    neutral: &Effect,
    mut screened: Screened,
    hopeless: &Hopeless,
) -> Result<(Screened, Vec<Dosed>), DiagnosisError> {
    let mut dosed = Vec::new();
    let Some(parameter) = screened.parameters.first().cloned() else { return Ok((screened, dosed)) };
    let before = linear.residual.square();
    let doses = LARGE_DOSES.iter().flat_map(|share| [share * parameter.dose, -share * parameter.dose]);
    for (dose_idx, dose) in doses.enumerate() {
        let value = parameter.neutral + dose;
        if !(parameter.lower..=parameter.upper).contains(&value) || hopeless.contains(neutral, 0, dose_idx) {
            continue;
        }
        let mut effect = neutral.clone();
        effect.parameters.insert(parameter.name.clone(), value);
        let predicted = predict(linear.domain, &linear.with(effect.clone()), &linear.takes)?;
        let removed = before - linear.residual_of(&predicted).square();
        dosed.push(Dosed { dose: dose_idx, removed });
        if removed > screened.promise {
            (screened.effect, screened.promise) = (effect, removed);
        }
    }
    Ok((screened, dosed))
}

/// Large doses of what acts on a patch, an object or a joint, as multiples of the standard one.
const PLACED_DOSES: [f64; 2] = [2.0, -2.0];

/// Replaces estimates for effects of patches, objects and joints by large doses of one parameter where those remove
/// more than the estimates promise: a patch that is moved by half a taxel's distance feels with other taxels, of
/// which a small dose knows nothing. One simulation serves all patches, all objects, of which no take has two, and
/// a joint of every limb; joints that move everything would cost one each and are left out.
fn dose_places_largely<D: Domain>(
    linear: &Linear<'_, D>,
    screened: &mut [Screened],
    squares: &[f64],
    hopeless: &mut Hopeless,
) -> Result<(), DiagnosisError> {
    let (mut apart, mut of_objects) = (Vec::new(), BTreeMap::<_, Vec<_>>::new());
    for (owner, candidate) in screened.iter().enumerate() {
        for (idx, parameter) in candidate.parameters.iter().enumerate() {
            for (dose_idx, step) in PLACED_DOSES.map(|share| share * parameter.dose).into_iter().enumerate() {
                let value = parameter.neutral + step;
                if !(parameter.lower..=parameter.upper).contains(&value)
                    || hopeless.contains(&candidate.effect, idx, dose_idx)
                {
                    continue;
                }
                let mut effect = neutral(&candidate.effect, &candidate.parameters);
                effect.parameters.insert(parameter.name.clone(), value);
                let item = Item {
                    owner,
                    parameter: idx,
                    dose: dose_idx,
                    effect,
                    step,
                    name: parameter.name.clone(),
                };
                match candidate.effect.place {
                    Place::Patch(_) => apart.push(item),
                    Place::Joint(_) if linear.domain.support(&item.effect, &item.name).contains(&false) => {
                        apart.push(item);
                    }
                    Place::Object(_) => {
                        let everywhere = vec![true; linear.domain.num_units()];
                        let pass =
                            of_objects.entry((candidate.effect.id.clone(), idx, dose_idx)).or_default();
                        pass.push((item, everywhere));
                    }
                    _ => {}
                }
            }
        }
    }
    let passes: Vec<_> = pack(linear.domain, apart).into_iter().chain(of_objects.into_values()).collect();
    let removed: Vec<Vec<Vec<f64>>> = passes
        .par_iter()
        .map(|pass| {
            let mut model = linear.model.clone();
            model.effects.extend(pass.iter().map(|(item, _)| item.effect.clone()));
            Ok(linear.removed(&predict(linear.domain, &model, &linear.takes)?))
        })
        .collect::<Result<_, DiagnosisError>>()?;
    for (pass, removed) in passes.into_iter().zip(removed) {
        for (item, reach) in pass {
            let mut of_item = 0.0;
            for (of_take, &take) in removed.iter().zip(&linear.takes) {
                if linear.domain.reaches_take(&item.effect, take) {
                    let reached = of_take.iter().zip(&reach).filter(|(_, reached)| **reached);
                    of_item += reached.map(|(removed, _)| removed).sum::<f64>();
                }
            }
            hopeless.hear(&item.effect, item.parameter, item.dose, of_item, within(squares, &reach));
            let candidate = &mut screened[item.owner];
            if of_item > candidate.promise {
                (candidate.effect, candidate.promise) = (item.effect, of_item);
            }
        }
    }
    Ok(())
}

/// Responses to each parameter of `effect` around its present values, at which the predictions are those of `before`.
pub(crate) fn responses<D: Domain>(
    linear: &Linear<'_, D>,
    effect: &Effect,
    parameters: &[Parameter],
    before: &[Vec<Series>],
) -> Result<Vec<Column>, DiagnosisError> {
    let mut columns = vec![Column::default(); parameters.len()];
    // Parameters that reach different units are stepped together.
    type Pass = (Effect, Vec<bool>, Vec<(usize, f64, Vec<bool>)>);
    let mut passes: Vec<Pass> = Vec::new();
    for (idx, parameter) in parameters.iter().enumerate() {
        let value = effect.parameter(&parameter.name);
        let step = inside(value, 0.25 * parameter.dose, parameter.lower, parameter.upper);
        let reach = linear.domain.support(effect, &parameter.name);
        let free = passes.iter_mut().find(|(_, taken, _)| !overlap(taken, &reach));
        let pass = match free {
            Some(pass) => pass,
            None => {
                passes.push((effect.clone(), vec![false; reach.len()], Vec::new()));
                passes.last_mut().expect("it was just added")
            }
        };
        pass.0.parameters.insert(parameter.name.clone(), value + step);
        unite(&mut pass.1, &reach);
        pass.2.push((idx, step, reach));
    }
    for (stepped, _, parts) in passes {
        let after = predict(linear.domain, &linear.with(stepped), &linear.takes)?;
        let owner = owners(parts.iter().map(|(_, _, reach)| reach.as_slice()), linear.domain.num_units());
        let steps: Vec<f64> = parts.iter().map(|(_, step, _)| *step).collect();
        for (column, (idx, ..)) in linear.columns(before, &after, &owner, &steps).into_iter().zip(parts) {
            columns[idx] = column;
        }
    }
    Ok(columns)
}

/// Which of several disjoint sets of units each unit is in; `usize::MAX`: none.
fn owners<'r>(reaches: impl Iterator<Item = &'r [bool]>, num_units: usize) -> Vec<usize> {
    let mut owner = vec![usize::MAX; num_units];
    for (idx, reach) in reaches.enumerate() {
        for (owner, reach) in owner.iter_mut().zip(reach) {
            if *reach {
                *owner = idx;
            }
        }
    }
    owner
}

/// `effect` with its parameters moved by `steps` from where they are, as far as their bounds allow.
pub(crate) fn stepped(effect: &Effect, parameters: &[Parameter], steps: &[f64]) -> Effect {
    let mut moved = effect.clone();
    for (parameter, step) in parameters.iter().zip(steps) {
        let value = (effect.parameter(&parameter.name) + step).clamp(parameter.lower, parameter.upper);
        moved.parameters.insert(parameter.name.clone(), value);
    }
    moved
}

/// One parameter of one candidate at a dose.
struct Item {
    owner: usize,
    parameter: usize,
    /// Which of several doses.
    dose: usize,
    effect: Effect,
    step: f64,
    name: String,
}

fn dosed(effect: &Effect, parameter: &Parameter) -> Effect {
    let mut effect = effect.clone();
    effect.parameters.insert(parameter.name.clone(), parameter.neutral + parameter.dose);
    effect
}

/// Items that one simulation can serve, with the units that each reaches: same effect, no unit in common.
fn pack<D: Domain>(domain: &D, items: Vec<Item>) -> Vec<Vec<(Item, Vec<bool>)>> {
    type Pass = (Vec<bool>, Vec<(Item, Vec<bool>)>);
    let mut by_id: BTreeMap<String, Vec<Pass>> = BTreeMap::new();
    for item in items {
        let reach = domain.support(&item.effect, &item.name);
        let passes = by_id.entry(item.effect.id.clone()).or_default();
        match passes.iter_mut().find(|(taken, _)| !overlap(taken, &reach)) {
            Some((taken, pass)) => {
                unite(taken, &reach);
                pass.push((item, reach));
            }
            None => passes.push((reach.clone(), vec![(item, reach)])),
        }
    }
    by_id.into_values().flatten().map(|(_, pass)| pass).collect()
}
