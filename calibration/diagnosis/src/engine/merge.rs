//! One name for what several names explain in parts: channel after channel is found too sensitive where it is the patch
//! that sits elsewhere.

use std::collections::BTreeMap;

use palpate_sim::effects::Effect;

use super::fit::{fit, refit, refit_roughly};
use super::linear::Linear;
use super::name::{REFIT_STEPS, founded, stands_in};
use super::screen::{Hopeless, screen};
use super::{Domain, Model, NamingConfig};
use crate::DiagnosisError;

/// Candidates that are fitted in the place of one set of names.
const FITS: usize = 3;

/// Puts one effect in the place of two or more effects beyond the first `known` that reach one unit each, if it reaches
/// all of their units, is beyond doubt, and leaves less of the loss than they do. `dropped` effects are not tried. Says
/// whether it did.
pub(super) fn merge<D: Domain>(
    domain: &D,
    model: &mut Model,
    known: usize,
    takes: &[usize],
    config: &NamingConfig,
    dropped: &[Effect],
) -> Result<bool, DiagnosisError> {
    let reach = |effect: &Effect| -> Vec<usize> {
        let reach = domain.reach(effect);
        (0..reach.len()).filter(|&unit| reach[unit]).collect()
    };
    let parts: Vec<(usize, usize)> = (known..model.effects.len())
        .filter_map(|idx| match reach(&model.effects[idx])[..] {
            [unit] => Some((idx, unit)),
            _ => None,
        })
        .collect();
    if parts.len() < 2 {
        return Ok(false);
    }
    let mut by_replaced: BTreeMap<Vec<usize>, Vec<Effect>> = BTreeMap::new();
    for candidate in domain.candidates() {
        let same = |other: &Effect| other.id == candidate.id && other.place == candidate.place;
        if config.without.contains(&candidate.id) || model.effects.iter().chain(dropped).any(same) {
            continue;
        }
        let reached = reach(&candidate);
        let replaced: Vec<usize> =
            parts.iter().filter(|(_, unit)| reached.contains(unit)).map(|(idx, _)| *idx).collect();
        if replaced.len() > 1 {
            by_replaced.entry(replaced).or_default().push(candidate);
        }
    }
    let mut least = Linear::without_nuisances(domain, model, takes)?.loss;
    let mut best = None;
    for (replaced, candidates) in by_replaced {
        let effects = model.effects.iter().enumerate().filter(|(idx, _)| !replaced.contains(idx));
        let without =
            Model { base: model.base.clone(), effects: effects.map(|(_, effect)| effect.clone()).collect() };
        let without = refit_roughly(domain, &without, takes)?;
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
            let with = refit(domain, &with, takes, REFIT_STEPS)?;
            let loss = Linear::without_nuisances(domain, &with, takes)?.loss;
            if loss < least && founded(domain, &with, takes, config.bar)? {
                least = loss;
                best = Some(with);
            }
        }
    }
    let Some(better) = best else { return Ok(false) };
    *model = better;
    Ok(true)
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
            let mut model = refit(self, &Model { base: vec![0.0], effects: named }, &[0], 3).unwrap();
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
}
