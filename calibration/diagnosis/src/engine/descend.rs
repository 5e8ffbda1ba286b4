//! Steps of a fit that lower the loss: within bounds, and each group of parameters for itself.
//!
//! Parameters that reach no unit in common have nothing to do with each other: where the step of one group overshoots, those
//! of others need not wait for it.

use nalgebra::{DMatrix, DVector};

use super::linear::{Assessment, Linear};
use super::normal::inverse;
use super::{BaseParameter, Domain, Model};
use crate::DiagnosisError;

/// A parameter that is fitted.
pub(super) struct Free {
    /// How far it may go down and up.
    room: [f64; 2],
    /// Units that it reaches.
    reach: Vec<bool>,
}

impl Free {
    /// The parameter `idx` of the base of `domain`, where `model` has it.
    pub(super) fn of_base<D: Domain>(domain: &D, model: &Model, idx: usize) -> Self {
        let BaseParameter { lower, upper, .. } = domain.base()[idx];
        let value = model.base[idx];
        Self { room: [lower - value, upper - value], reach: domain.base_support(idx) }
    }

    /// Every parameter of `model`: its own, and then those of its effects.
    pub(super) fn all<D: Domain>(domain: &D, model: &Model) -> Vec<Self> {
        let of_base = (0..model.base.len()).map(|idx| Self::of_base(domain, model, idx));
        let of_effects = model.effects.iter().flat_map(|effect| {
            let reach = domain.reach(effect);
            domain.parameters(effect).into_iter().map(move |parameter| {
                let value = effect.parameter(&parameter.name);
                Self { room: [parameter.lower - value, parameter.upper - value], reach: reach.clone() }
            })
        });
        of_base.chain(of_effects).collect()
    }
}

/// Parameters that reach units in common, directly or by others of the group.
struct Group {
    columns: Vec<usize>,
    units: Vec<bool>,
}

impl Group {
    fn all(free: &[Free]) -> Vec<Self> {
        let mut groups: Vec<Self> = Vec::new();
        for (column, Free { reach, .. }) in free.iter().enumerate() {
            let is_joined = |group: &Self| group.units.iter().zip(reach).any(|(one, other)| *one && *other);
            let (joined, apart): (Vec<Self>, Vec<Self>) = groups.into_iter().partition(is_joined);
            let mut group = Self { columns: vec![column], units: reach.clone() };
            for Self { columns, units } in joined {
                group.columns.extend(columns);
                group.units.iter_mut().zip(units).for_each(|(unit, other)| *unit |= other);
            }
            groups = apart;
            groups.push(group);
        }
        groups
    }

    fn loss(&self, by_unit: &[f64]) -> f64 {
        by_unit.iter().zip(&self.units).map(|(loss, of_group)| if *of_group { *loss } else { 0.0 }).sum()
    }
}

/// A step that lowers the loss.
pub(super) struct Lower<'a, D: Domain> {
    pub(super) linear: Linear<'a, D>,
    /// Whether no group gained what is worth another step.
    pub(super) is_done: bool,
}

/// A fit ends where a step gains less than this share of the loss.
const LEAST_GAINED: f64 = 1e-3;

/// For every group of what is `free`, the first step from `from` that lowers its loss: that of `assessment`, which ends at
/// the bounds of what would go past them; or the one that keeps within them, and ever shorter ones of that. `None` where no
/// group has any. `stepped` makes the model of a step.
pub(super) fn descend<'a, D: Domain>(
    from: &Linear<'a, D>,
    assessment: &Assessment,
    free: &[Free],
    stepped: impl Fn(&DVector<f64>) -> Model,
) -> Result<Option<Lower<'a, D>>, DiagnosisError> {
    let before = from.loss_by_unit();
    let within = step_within(assessment, free);
    let mut steps = vec![assessment.step.clone()];
    if within != assessment.step {
        steps.push(within.clone());
    }
    steps.extend(SHORTER.map(|scale| &within * scale));
    let mut taken = DVector::<f64>::zeros(free.len());
    let mut pending = Group::all(free);
    let num_groups = pending.len();
    let mut is_done = true;
    for step in steps {
        let mut with = taken.clone();
        pending.iter().flat_map(|group| &group.columns).for_each(|&column| with[column] = step[column]);
        let linear = from.moved_to(stepped(&with))?;
        let after = linear.loss_by_unit();
        let (lowered, rest): (Vec<Group>, Vec<Group>) =
            pending.into_iter().partition(|group| group.loss(&after) < group.loss(&before));
        for group in lowered {
            let gained = group.loss(&before) - group.loss(&after);
            is_done &= gained < LEAST_GAINED * group.loss(&after).max(1.0);
            group.columns.iter().for_each(|&column| taken[column] = step[column]);
        }
        if rest.is_empty() {
            return Ok(Some(Lower { linear, is_done }));
        }
        pending = rest;
    }
    if pending.len() == num_groups {
        return Ok(None);
    }
    Ok(Some(Lower { linear: from.moved_to(stepped(&taken))?, is_done }))
}

/// Shares of a step that are tried where all of it goes too far.
const SHORTER: [f64; 3] = [0.5, 0.2, 0.05];

/// The step of `assessment`, within the room that what is `free` has: a parameter that would go past its end stops there, the
/// one that gets there first before the others, and the rest go where that leaves them.
fn step_within(assessment: &Assessment, free: &[Free]) -> DVector<f64> {
    let Assessment { normal, score, .. } = assessment;
    let mut step = assessment.step.clone();
    let mut stopped = DVector::<f64>::zeros(free.len());
    let mut moving: Vec<usize> = (0..free.len()).collect();
    loop {
        // Share of its step after which a parameter is at its end.
        let share = |idx: usize| {
            let [down, up] = free[idx].room;
            if step[idx] > up {
                up / step[idx]
            } else if step[idx] < down {
                down / step[idx]
            } else {
                f64::INFINITY
            }
        };
        let first =
            moving.iter().map(|&idx| (share(idx), idx)).min_by(|(one, _), (two, _)| one.total_cmp(two));
        let Some((_, first)) = first.filter(|(share, _)| share.is_finite()) else { return step };
        let [down, up] = free[first].room;
        stopped[first] = step[first].clamp(down, up);
        moving.retain(|&idx| idx != first);
        if moving.is_empty() {
            return stopped;
        }
        let left = score - normal * &stopped;
        let of_moving = DMatrix::from_fn(moving.len(), moving.len(), |i, j| normal[(moving[i], moving[j])]);
        let steps = inverse(&of_moving) * DVector::from_fn(moving.len(), |i, _| left[moving[i]]);
        step.copy_from(&stopped);
        moving.iter().zip(steps.iter()).for_each(|(&idx, own)| step[idx] = *own);
    }
}

#[cfg(test)]
mod tests {
    use std::ops::Range;

    use palpate_sim::effects::{Effect, Parameter};
    use proptest::prelude::*;

    use super::super::Series;
    use super::*;

    /// Two units that have nothing in common: one reads its number, the other one the arc tangent of its own.
    struct Apart {
        base: [BaseParameter; 2],
    }

    impl Domain for Apart {
        fn num_takes(&self) -> usize {
            1
        }

        fn blocks(&self, _take: usize) -> &[Range<usize>] {
            const BLOCK: Range<usize> = 0..1;
            &[BLOCK]
        }

        fn observed(&self, _take: usize, _signal: usize) -> &[f64] {
            &[0.0]
        }

        fn base(&self) -> &[BaseParameter] {
            &self.base
        }

        fn base_support(&self, idx: usize) -> Vec<bool> {
            vec![idx == 0, idx == 1]
        }

        fn candidates(&self) -> Vec<Effect> {
            Vec::new()
        }

        fn parameters(&self, _effect: &Effect) -> Vec<Parameter> {
            Vec::new()
        }

        fn num_units(&self) -> usize {
            2
        }

        fn support(&self, _effect: &Effect, _parameter: &str) -> Vec<bool> {
            vec![false; 2]
        }

        fn predict(&self, _take: usize, model: &Model) -> Result<Vec<Series>, DiagnosisError> {
            Ok(vec![vec![model.base[0]].into(), vec![model.base[1].atan()].into()])
        }

        fn weights(&self, _take: usize, _signal: usize, prediction: &[f64]) -> Vec<f64> {
            vec![1.0; prediction.len()]
        }
    }

    #[test]
    fn a_group_that_overshoots_does_not_hold_up_the_others() {
        let number =
            |name: &str| BaseParameter { name: name.to_owned(), lower: -100.0, upper: 100.0, dose: 1e-2 };
        let domain = Apart { base: [number("even"), number("curved")] };
        let model = Model { base: vec![2.0, 2.0], effects: Vec::new() };
        let from = Linear::without_nuisances(&domain, &model, &[0]).unwrap();
        let assessment = from.assess(&from.nuisance_columns().unwrap(), &from.residual);
        let of = |step: &DVector<f64>| Model { base: vec![2.0 + step[0], 2.0 + step[1]], ..model.clone() };
        assert!(of(&assessment.step).base[1] < -2.5, "the whole step leads farther away");
        let lower = descend(&from, &assessment, &Free::all(&domain, &model), of).unwrap().unwrap();
        let [even, curved] = lower.linear.model.base[..] else { panic!("two numbers") };
        assert!(even.abs() < 1e-3, "{even}");
        assert!((0.05..1.0).contains(&curved.abs()), "{curved}");
        assert!(!lower.is_done);
    }

    proptest! {
        #[test]
        fn a_step_stays_within_its_room(
            entries in prop::collection::vec(-1.0..1.0_f64, 16),
            score in prop::collection::vec(-3.0..3.0_f64, 4),
            room in prop::collection::vec((0.0..2.0_f64, 0.0..2.0_f64), 4),
        ) {
            let root = DMatrix::from_vec(4, 4, entries);
            let normal = &root * root.transpose() + DMatrix::identity(4, 4);
            let score = DVector::from_vec(score);
            let step = inverse(&normal) * &score;
            let assessment =
                Assessment { step: step.clone(), normal, score, standard_errors: Vec::new(), held_out_gains: Vec::new() };
            let free: Vec<Free> =
                room.iter().map(|(down, up)| Free { room: [-down, *up], reach: vec![true] }).collect();
            let within = step_within(&assessment, &free);
            let fits = |step: &DVector<f64>| {
                step.iter().zip(&free).all(|(step, free)| (free.room[0]..=free.room[1]).contains(step))
            };
            prop_assert!(fits(&within), "{within} in {room:?}");
            prop_assert!(!fits(&step) || within == step, "what fits stays as it is");
        }
    }
}
