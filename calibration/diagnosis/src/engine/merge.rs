//! One name for what several names explain in parts: channel after channel is found too sensitive where it is the patch
//! that sits elsewhere; a joint off and its fingertip's layer stiffer, where it is the fingertip that has sunk in.

use std::collections::BTreeMap;

use palpate_sim::effects::Effect;

use super::evidence::founded;
use super::fit::{Fit, fit};
use super::linear::Linear;
use super::naming::stands_in;
use super::screen::{Hopeless, screen};
use super::{Domain, Model, NamingConfig, unite, within};
use crate::DiagnosisError;

/// Candidates that are fitted in the place of one set of names.
const FITS: usize = 3;

/// Puts one effect in the place of two or more effects beyond the first `known`, if it is beyond doubt and has a lower
/// deviance than they do: of effects that reach one unit each, if it reaches all of their units; of all that are named,
/// if one of them reaches as far as all, and it reaches as far as the others and no farther than that one. `dropped`
/// effects are not tried. Says whether it did.
pub(super) fn merge<D: Domain>(
    domain: &D,
    model: &mut Model,
    known: usize,
    takes: &[usize],
    config: &NamingConfig,
    dropped: &[Effect],
) -> Result<bool, DiagnosisError> {
    let mut by_replaced: BTreeMap<Vec<usize>, Vec<Effect>> = BTreeMap::new();
    let reaches: Vec<Vec<bool>> = model.effects[known..].iter().map(|effect| domain.reach(effect)).collect();
    let named = Replaceable::of(&reaches);
    if named.is_empty() {
        return Ok(false);
    }
    for candidate in domain.candidates() {
        let same = |other: &Effect| other.id == candidate.id && other.place == candidate.place;
        if config.without.contains(&candidate.id) || model.effects.iter().chain(dropped).any(same) {
            continue;
        }
        let mut replaced = named.replaced_by(&domain.reach(&candidate));
        replaced.iter_mut().for_each(|idx| *idx += known);
        if replaced.len() > 1 {
            by_replaced.entry(replaced).or_default().push(candidate);
        }
    }
    let mut least = Linear::without_nuisances(domain, model, takes)?.deviance();
    let mut best = None;
    for (replaced, candidates) in by_replaced {
        let effects = model.effects.iter().enumerate().filter(|(idx, _)| !replaced.contains(idx));
        let without =
            Model { base: model.base.clone(), effects: effects.map(|(_, effect)| effect.clone()).collect() };
        let without = Fit::roughly().of(domain, &without, takes)?;
        let linear = Linear::new(domain, &without, takes)?;
        let mut screened = screen(&linear, &candidates, &mut Hopeless::default(), &|_| Ok(()))?;
        screened.sort_by(|a, b| b.promise.total_cmp(&a.promise));
        for candidate in screened.iter().take(FITS).filter(|candidate| candidate.promise > 0.0) {
            let fitted = fit(&linear, &candidate.effect, &candidate.parameters)?;
            if !fitted.changes.contains(&true) || stands_in(&fitted) {
                continue;
            }
            let mut with = without.clone();
            with.effects.push(fitted.effect);
            let with = Fit::again().of(domain, &with, takes)?;
            let deviance = Linear::without_nuisances(domain, &with, takes)?.deviance();
            if deviance < least && founded(domain, &with, takes, config.bar)? {
                least = deviance;
                best = Some(with);
            }
        }
    }
    let Some(better) = best else { return Ok(false) };
    *model = better;
    Ok(true)
}

/// Names that one effect may stand for.
struct Replaceable {
    /// Those that reach one unit each: their indices, and the units.
    single: Vec<(usize, usize)>,
    /// Where one of at least two reaches as far as all.
    nested: Option<Nested>,
}

/// Names of which one reaches as far as all.
struct Nested {
    count: usize,
    /// What the widest reaches.
    widest: Vec<bool>,
    /// What the others reach.
    others: Vec<bool>,
}

impl Replaceable {
    /// Of names with these `reaches`.
    fn of(reaches: &[Vec<bool>]) -> Self {
        let only = |reach: &Vec<bool>| {
            let mut units = (0..reach.len()).filter(|&unit| reach[unit]);
            units.next().filter(|_| units.next().is_none())
        };
        let single =
            reaches.iter().enumerate().filter_map(|(idx, reach)| only(reach).map(|unit| (idx, unit)));
        Self { single: single.collect(), nested: Nested::of(reaches) }
    }

    fn is_empty(&self) -> bool {
        self.single.len() < 2 && self.nested.is_none()
    }

    /// Indices of the names that what reaches so far may stand for.
    fn replaced_by(&self, reach: &[bool]) -> Vec<usize> {
        match &self.nested {
            Some(nested) if within(&nested.others, reach) && within(reach, &nested.widest) => {
                (0..nested.count).collect()
            }
            _ => self.single.iter().filter(|(_, unit)| reach[*unit]).map(|(idx, _)| *idx).collect(),
        }
    }
}

impl Nested {
    fn of(reaches: &[Vec<bool>]) -> Option<Self> {
        if reaches.len() < 2 {
            return None;
        }
        (0..reaches.len()).find_map(|widest| {
            let mut others = vec![false; reaches[widest].len()];
            for (_, reach) in reaches.iter().enumerate().filter(|(idx, _)| *idx != widest) {
                unite(&mut others, reach);
            }
            let is_widest = within(&others, &reaches[widest]);
            is_widest.then(|| Self { count: reaches.len(), widest: reaches[widest].clone(), others })
        })
    }
}

#[cfg(test)]
mod tests {
    use std::ops::Range;

    use palpate_robot_model::Place;
    use palpate_sim::effects::Parameter;

    use super::super::tests::{LEVELS, config, deviates, size, sized};
    use super::super::{BaseParameter, Series};
    use super::*;

    const UNITS: usize = 3;
    const ROWS: usize = 200;
    const NOISE: f64 = 0.1;
    /// How much of what reaches the whole reaches each part.
    const SHARES: [f64; UNITS] = [1.0, -0.6, 0.8];

    /// Parts of one whole. `part` changes one of them, `whole` each by its share.
    struct Parts {
        observed: Vec<Vec<f64>>,
        blocks: Vec<Range<usize>>,
    }

    fn part(unit: usize, size: f64) -> Effect {
        sized("part", Place::Channel(unit.to_string()), size)
    }

    fn whole(size: f64) -> Effect {
        sized("whole", Place::Stream("all".to_owned()), size)
    }

    fn size_in(effects: &[Effect], unit: usize) -> f64 {
        let of = |effect: &Effect| match &effect.place {
            Place::Channel(id) => f64::from(u8::from(*id == unit.to_string())),
            _ => SHARES[unit],
        };
        effects.iter().map(|effect| of(effect) * effect.parameter("size")).sum()
    }

    impl Parts {
        fn hiding(effects: &[Effect]) -> Self {
            let mut noise = deviates(5, NOISE);
            let observed = (0..UNITS)
                .map(|unit| {
                    (0..ROWS).map(|row| size_in(effects, unit) * (row as f64 * 0.1).sin() + noise()).collect()
                })
                .collect();
            Self { observed, blocks: (0..ROWS / 10).map(|block| block * 10..(block + 1) * 10).collect() }
        }

        /// What becomes of `named`.
        fn merged(&self, named: Vec<Effect>) -> (bool, Vec<String>) {
            let model = Model { base: vec![0.0], effects: named };
            let mut model = Fit::again().of(self, &model, &[0]).unwrap();
            let merged = merge(self, &mut model, 0, &[0], &config(), &[]).unwrap();
            (merged, model.effects.into_iter().map(|effect| effect.id).collect())
        }
    }

    impl Domain for Parts {
        fn num_takes(&self) -> usize {
            1
        }

        fn blocks(&self, _take: usize) -> &[Range<usize>] {
            &self.blocks
        }

        fn observed(&self, _take: usize, signal: usize) -> &[f64] {
            &self.observed[signal]
        }

        fn base(&self) -> &[BaseParameter] {
            &LEVELS[..1]
        }

        fn candidates(&self) -> Vec<Effect> {
            (0..UNITS).map(|unit| part(unit, 0.0)).chain([whole(0.0)]).collect()
        }

        fn parameters(&self, _effect: &Effect) -> Vec<Parameter> {
            size()
        }

        fn num_units(&self) -> usize {
            UNITS
        }

        fn support(&self, effect: &Effect, _parameter: &str) -> Vec<bool> {
            (0..UNITS).map(|unit| size_in(&[effect_of_size(effect, 1.0)], unit) != 0.0).collect()
        }

        fn predict(&self, _take: usize, model: &Model) -> Result<Vec<Series>, DiagnosisError> {
            let of_unit = |unit: usize| {
                let size = size_in(&model.effects, unit);
                (0..ROWS).map(|row| model.base[0] + size * (row as f64 * 0.1).sin()).collect()
            };
            Ok((0..UNITS).map(of_unit).collect())
        }

        fn weights(&self, _take: usize, _signal: usize, prediction: &[f64]) -> Vec<f64> {
            vec![1.0 / NOISE; prediction.len()]
        }
    }

    fn effect_of_size(like: &Effect, size: f64) -> Effect {
        sized(&like.id, like.place.clone(), size)
    }

    #[test]
    fn parts_of_a_whole_become_one_name() {
        let parts = Parts::hiding(&[whole(0.4)]);
        assert_eq!(parts.merged(vec![part(0, 0.0), part(1, 0.0)]), (true, vec!["whole".to_owned()]));
    }

    #[test]
    fn parts_that_have_nothing_in_common_stay() {
        let parts = Parts::hiding(&[part(0, 0.4), part(1, 0.4)]);
        assert_eq!(parts.merged(vec![part(0, 0.0), part(1, 0.0)]), (false, vec!["part".to_owned(); 2]));
        let one = Parts::hiding(&[part(0, 0.4)]);
        assert_eq!(one.merged(vec![part(0, 0.0)]), (false, vec!["part".to_owned()]));
    }

    fn replaced(reaches: &[&[usize]], candidate: &[usize]) -> Vec<usize> {
        let reach = |units: &[usize]| (0..4).map(|unit| units.contains(&unit)).collect::<Vec<bool>>();
        let reaches: Vec<Vec<bool>> = reaches.iter().map(|units| reach(units)).collect();
        Replaceable::of(&reaches).replaced_by(&reach(candidate))
    }

    #[test]
    fn names_within_the_reach_of_one_have_one_place() {
        let bent_and_blurred: [&[usize]; 2] = [&[0, 1, 2], &[1, 2]];
        assert_eq!(replaced(&bent_and_blurred, &[1, 2]), [0, 1]);
        assert!(replaced(&bent_and_blurred, &[1]).is_empty(), "less than either");
        assert!(replaced(&bent_and_blurred, &[1, 2, 3]).is_empty(), "farther than both");
        assert!(replaced(&[&[0, 1], &[1, 2]], &[1]).is_empty(), "neither is within the other");
        assert_eq!(replaced(&[&[0], &[1], &[2, 3]], &[0, 1]), [0, 1], "those of one unit each");
    }
}
