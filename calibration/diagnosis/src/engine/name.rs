//! Rounds of screening and fitting, until nothing reaches the bar.

use std::collections::BTreeMap;

use palpate_robot_model::Place;
use palpate_sim::effects::{Effect, Parameter};
use rayon::prelude::*;

use super::choose::{apart, choose};
use super::evidence::{Judged, evidence, joint_evidence};
use super::fit::{Fit, Profile, fit};
use super::linear::{Linear, predict};
use super::merge::merge;
use super::naming::{FEW, Naming, NamingConfig, Round, Tried, key, stands_in};
use super::reconsider::reconsider;
use super::screen::{Hopeless, Screened, screen};
use super::{Domain, Model, Watch, each};
use crate::DiagnosisError;

/// What still promises more than this share of what it did once the other is named explains something else.
const SOMETHING_ELSE: f64 = 0.5;
/// Candidates that are screened again after the first round: those that promised most when they were last screened.
const PROMISING: usize = 100;
/// Rounds beyond the most effects: what is named and dropped again costs one each, and must not go on for ever.
const MOST_DROPPED: usize = 2;
/// Share of what removes most at a place that a trial beside thresholds of its own removes at least with its first step: no
/// rival begins worse.
const LEAST_BEGUN: f64 = 0.5;
/// What such a trial must remove, over what the effect removes beside the thresholds that are there.
const PROFILE_GAIN: f64 = 1.3;
/// Share of the remaining loss that a named effect removes at least beside the others.
const LEAST_CARRIED: f64 = 0.004;
/// Rounds in which effects are tried beside thresholds of their own: what thresholds absorb most of is large, and what is
/// large is named first.
const PROFILED_ROUNDS: usize = 2;
/// Candidates that are fitted in a round for the share of the loss in what they change.
const FITS_BY_SHARE: usize = 2;
/// Places of one effect that are fitted in a round.
const PLACES_PER_EFFECT: usize = 2;

/// Names what `start` lacks on `takes`. `progress` hears what is being done and may stop it.
pub fn name<D: Domain>(
    domain: &D,
    start: &Model,
    takes: &[usize],
    config: &NamingConfig,
    progress: &Watch<'_>,
) -> Result<Naming, DiagnosisError> {
    let known = start.effects.len();
    let mut model = start.clone();
    let mut rounds: Vec<Round> = Vec::new();
    let mut dropped: Vec<Effect> = Vec::new();
    // What every candidate promised when it was last screened.
    let mut known_gains: BTreeMap<(String, Place), f64> = BTreeMap::new();
    let mut hopeless = Hopeless::default();
    // The first of the rounds whose rivals were not looked at again.
    let mut unsettled = 0;
    loop {
        let round_idx = rounds.len();
        let stage = format!("round {}: trying every effect everywhere", round_idx + 1);
        let report = |within: f64, stage: &str| {
            // Few sessions need more than three rounds; the fraction only ever rises.
            let fraction = 1.0 - 0.6_f64.powf(round_idx as f64 + within);
            progress(fraction, stage)
        };
        report(0.0, &stage)?;
        let linear = Linear::new(domain, &model, takes)?;
        let mut candidates = domain.candidates();
        candidates.retain(|candidate| {
            !config.without.contains(&candidate.id)
                && !model
                    .effects
                    .iter()
                    .chain(&dropped)
                    .any(|named| named.id == candidate.id && named.place == candidate.place)
        });
        if !known_gains.is_empty() {
            let known = |candidate: &Effect| known_gains.get(&key(candidate)).copied().unwrap_or(0.0);
            candidates.sort_by(|a, b| known(b).total_cmp(&known(a)));
            candidates.truncate(PROMISING);
        }
        let mut screened = screen(&linear, &candidates, &mut hopeless, &|done| report(0.7 * done, &stage))?;
        screened.sort_by(|a, b| b.promise.total_cmp(&a.promise));
        let promises: BTreeMap<_, _> =
            screened.iter().map(|candidate| (key(&candidate.effect), candidate.promise)).collect();
        for round in &mut rounds[unsettled..] {
            keep_rivals(round, &known_gains, &promises);
        }
        known_gains.extend(promises);
        let finalists = finalists(&screened, config.num_fits);
        let profiled = round_idx < PROFILED_ROUNDS;
        let fitted = fit_all(&linear, finalists.iter().map(|&idx| &screened[idx]), profiled, &|done, id| {
            report(0.7 + 0.3 * done, &format!("round {}: fitting {id}", round_idx + 1))
        })?;
        // Where thresholds have absorbed one effect of a stream, no effect of that stream shows beside them.
        let mut absorbed: BTreeMap<Place, f64> = BTreeMap::new();
        for (place, gain) in fitted.iter().filter_map(Trial::absorbed) {
            absorbed.entry(place).and_modify(|most| *most = most.max(gain)).or_insert(gain);
        }
        let masked = screened.iter().enumerate().filter(|(idx, candidate)| {
            absorbed.contains_key(&candidate.effect.place) && !finalists.contains(idx)
        });
        let masked =
            masked.map(|(_, candidate)| (candidate.effect.clone(), &candidate.parameters[..])).collect();
        let masked = beside_own_thresholds(&linear, masked, &absorbed)?;
        let mut tried: Vec<Tried> = fitted.into_iter().filter_map(|trial| trial.tried).collect();
        tried.extend(masked.into_iter().flatten());
        tried.sort_by(|a, b| b.held_out_gain.total_cmp(&a.held_out_gain));
        let more = model.effects.len() < config.max_effects && round_idx < config.max_effects + MOST_DROPPED;
        let chosen =
            if more { choose(domain, &model, linear.deviance(), &tried, takes, config)? } else { None };
        unsettled = rounds.len();
        let Some(chosen) = chosen else {
            rounds.push(Round { before: model.clone(), tried, named: None, class: Vec::new() });
            report(1.0, "putting names together")?;
            if more && merge(domain, &mut model, known, takes, config, &dropped)? {
                continue;
            }
            break;
        };
        let apart = apart(domain, &chosen.model, &tried, chosen.named);
        rounds.push(chosen.round(model, tried));
        model = chosen.model;
        if !apart.is_empty()
            && model.effects.len() < config.max_effects
            && let Some(chosen) = choose(domain, &model, chosen.deviance, &apart, takes, config)?
        {
            rounds.push(chosen.round(model, apart));
            model = chosen.model;
        }
        drop_one(domain, &mut model, known, takes, config.bar, &mut dropped)?;
    }
    reconsider(domain, &mut model, known, &mut rounds, takes, config.bar)?;
    finish(domain, &mut model, known, takes, config.kept_bar, &mut dropped)?;
    let Judged { evidence, standard_errors, .. } = Judged::new(domain, &model, takes)?;
    Ok(Naming { model, standard_errors, evidence, rounds, dropped, withheld: Vec::new(), needs: None })
}

/// Highest evidence of any effect beside `model`, among those that remove more than the least share: what the first round
/// of [`name`] makes of `takes`.
pub(crate) fn strongest<D: Domain>(
    domain: &D,
    model: &Model,
    takes: &[usize],
    config: &NamingConfig,
    progress: &Watch<'_>,
) -> Result<f64, DiagnosisError> {
    let linear = Linear::new(domain, model, takes)?;
    let mut candidates = domain.candidates();
    candidates.retain(|candidate| !config.without.contains(&candidate.id));
    let mut screened = screen(&linear, &candidates, &mut Hopeless::default(), &|done| {
        progress(0.7 * done, "trying every effect")
    })?;
    screened.sort_by(|a, b| b.promise.total_cmp(&a.promise));
    let finalists = finalists(&screened, config.num_fits).into_iter().map(|idx| &screened[idx]);
    let fitted =
        fit_all(&linear, finalists, true, &|done, id| progress(0.7 + 0.3 * done, &format!("fitting {id}")))?;
    let tried = fitted.into_iter().filter_map(|trial| trial.tried);
    let evidence = tried.filter(|tried| tried.share > config.least_share).map(|tried| tried.evidence);
    Ok(evidence.fold(0.0, f64::max))
}

/// What became of a candidate.
struct Trial {
    tried: Option<Tried>,
    /// Whether it shows only beside thresholds of its own.
    is_absorbed: bool,
}

impl Trial {
    /// The place of an effect that thresholds absorb, and the loss that it removes beside thresholds of its own.
    fn absorbed(&self) -> Option<(Place, f64)> {
        let tried = self.tried.as_ref().filter(|_| self.is_absorbed)?;
        Some((tried.effect.place.clone(), tried.held_out_gain))
    }
}

/// Fits each of `candidates` beside the model of `linear`; if `profiled`, beside thresholds of its own too.
fn fit_all<'c, D: Domain>(
    linear: &Linear<'_, D>,
    candidates: impl Iterator<Item = &'c Screened>,
    profiled: bool,
    progress: &Watch<'_>,
) -> Result<Vec<Trial>, DiagnosisError> {
    let fits = each(
        candidates.collect(),
        |done, candidate| progress(done, &candidate.effect.id),
        |candidate| Ok((fit(linear, &candidate.effect, &candidate.parameters)?, &candidate.parameters)),
    )?;
    let beside = if profiled {
        let effects = fits.iter().map(|(fitted, parameters)| (fitted.effect.clone(), &parameters[..]));
        beside_own_thresholds(linear, effects.collect(), &BTreeMap::new())?
    } else {
        fits.iter().map(|_| None).collect()
    };
    let trials = fits.into_iter().zip(beside).map(|((fitted, _), beside)| {
        let as_is = (fitted.changes.contains(&true) && !stands_in(&fitted)).then(|| {
            let evidence = evidence(&fitted.effect, &fitted.parameters, &fitted.assessment.standard_errors);
            let loss = linear.loss_in(&fitted.changes);
            Tried::new(fitted.effect, &linear.model, evidence, &fitted.held_out_gains, loss)
        });
        let (gain, evidence) =
            as_is.as_ref().map_or((0.0, 0.0), |tried| (tried.held_out_gain, tried.evidence));
        let better = beside.filter(|tried| tried.held_out_gain > PROFILE_GAIN * gain);
        // What is founded beside the thresholds that are there is no less so beside its own.
        let better = better.map(|tried| Tried { evidence, ..tried });
        Trial { is_absorbed: better.is_some(), tried: better.or(as_is) }
    });
    Ok(trials.collect())
}

/// Leaves in the class of `round` what is an alternative to the effect that was named: what promised to remove much
/// `before` and no longer does `after`. What promises as much as ever acts elsewhere, and may be missing as well.
fn keep_rivals(
    round: &mut Round,
    before: &BTreeMap<(String, Place), f64>,
    after: &BTreeMap<(String, Place), f64>,
) {
    let Round { class, tried, named, .. } = round;
    class.retain(|&idx| {
        let key = key(&tried[idx].effect);
        let promise = |known: &BTreeMap<(String, Place), f64>| known.get(&key).copied().unwrap_or(0.0);
        *named == Some(idx) || promise(after) <= SOMETHING_ELSE * promise(before)
    });
}

/// Those of `effects`, each with its parameters, that are of a whole stream and have few parameters, with the model's own
/// parameters fitted anew beside them; `None` for those that remove nothing, or much less to begin with
/// than others at their place do, or is `known` to be removed there. Their evidence is left to the full fit.
fn beside_own_thresholds<D: Domain>(
    linear: &Linear<'_, D>,
    effects: Vec<(Effect, &[Parameter])>,
    known: &BTreeMap<Place, f64>,
) -> Result<Vec<Option<Tried>>, DiagnosisError> {
    let begin = |(effect, parameters): &(Effect, &[Parameter])| {
        if !matches!(effect.place, Place::Stream(_)) || parameters.len() > FEW {
            return Ok(None);
        }
        Profile::begin(linear, effect, parameters)
    };
    let begun: Vec<Option<Profile<'_, '_, D>>> =
        effects.par_iter().map(begin).collect::<Result<_, DiagnosisError>>()?;
    let mut most = known.clone();
    for ((effect, _), profile) in effects.iter().zip(&begun) {
        let gained = profile.as_ref().map_or(0.0, Profile::gained_so_far);
        most.entry(effect.place.clone()).and_modify(|most| *most = most.max(gained)).or_insert(gained);
    }
    let go_on = |(profile, (effect, _)): (Option<Profile<'_, '_, D>>, &(Effect, &[Parameter]))| {
        let least = LEAST_BEGUN * most.get(&effect.place).copied().unwrap_or(0.0);
        let Some(profile) = profile.filter(|profile| profile.gained_so_far() >= least) else {
            return Ok(None);
        };
        let Some(profiled) = profile.finish()? else { return Ok(None) };
        let Some(effect) = profiled.model.effects.last() else { return Ok(None) };
        let beside = Model { base: profiled.model.base.clone(), effects: linear.model.effects.clone() };
        let (with, without) = (&profiled.model, &beside);
        let without = Linear::without_nuisances(linear.domain, without, &linear.takes)?;
        let changes = without.kinds_changed(&predict(linear.domain, with, &linear.takes)?);
        let tried = Tried::new(effect.clone(), with, 0.0, &profiled.held_out_gains, linear.loss_in(&changes));
        Ok((tried.held_out_gain > 0.0 && changes.contains(&true)).then_some(tried))
    };
    begun.into_par_iter().zip(&effects).map(go_on).collect()
}

/// Indices of candidates to fit: those that promise most, few places of each effect, and those that promise the largest
/// share of the loss in the kinds of rows that they change.
fn finalists(screened: &[Screened], num_fits: usize) -> Vec<usize> {
    let mut finalists: Vec<usize> = Vec::new();
    let mut by_share: Vec<usize> = (0..screened.len()).collect();
    by_share.sort_by(|&a, &b| screened[b].promised_share.total_cmp(&screened[a].promised_share));
    let mut admit = |order: &mut dyn Iterator<Item = usize>, most: usize| {
        for idx in order {
            let candidate = &screened[idx];
            let places = finalists.iter().filter(|&&other| screened[other].effect.id == candidate.effect.id);
            let places = places.count();
            if finalists.len() == most {
                break;
            }
            if candidate.promise > 0.0 && places < PLACES_PER_EFFECT && !finalists.contains(&idx) {
                finalists.push(idx);
            }
        }
    };
    admit(&mut (0..screened.len()), num_fits);
    admit(&mut by_share.into_iter(), num_fits + FITS_BY_SHARE);
    finalists
}

/// What a model loses without one of its effects.
struct Carried {
    /// Loss that comes back.
    loss: f64,
    /// The same in the kinds of rows that the effect changes, over the loss there.
    share: f64,
}

/// What the effect `idx` of the model of `after` carries.
fn carried_by<D: Domain>(after: &Linear<'_, D>, idx: usize) -> Result<Carried, DiagnosisError> {
    let (domain, takes) = (after.domain, &after.takes[..]);
    let mut without = after.model.clone();
    without.effects.remove(idx);
    let kinds = after.kinds_changed(&predict(domain, &without, takes)?);
    let without = Fit::roughly().of(domain, &without, takes)?;
    let back = after.losses_of(&predict(domain, &without, takes)?);
    let sum = |losses: &[Vec<f64>], of: &[bool]| -> f64 {
        let of_take = |losses: &Vec<f64>| -> f64 {
            losses.iter().zip(of).map(|(loss, of)| if *of { *loss } else { 0.0 }).sum()
        };
        losses.iter().map(of_take).sum()
    };
    let before = after.losses_of(&after.predicted);
    let gained = |of: &[bool]| sum(&back, of) - sum(&before, of);
    Ok(Carried {
        loss: gained(&vec![true; kinds.len()]),
        share: gained(&kinds) / sum(&before, &kinds).max(f64::MIN_POSITIVE),
    })
}

/// Weighs every effect beyond the first `known` by the loss that comes back without it: drops what carries too little, or
/// has lost its evidence, and puts the others in order, the weightiest first.
fn finish<D: Domain>(
    domain: &D,
    model: &mut Model,
    known: usize,
    takes: &[usize],
    bar: f64,
    dropped: &mut Vec<Effect>,
) -> Result<(), DiagnosisError> {
    while model.effects.len() > known {
        let after = Linear::without_nuisances(domain, model, takes)?;
        let evidence = joint_evidence(domain, model, takes)?;
        if let Some(unfounded) = (known..evidence.len()).find(|&idx| evidence[idx] < bar) {
            drop_effect(domain, model, unfounded, takes, dropped)?;
            continue;
        }
        let carried: Vec<Carried> = (known..model.effects.len())
            .into_par_iter()
            .map(|idx| carried_by(&after, idx))
            .collect::<Result<_, DiagnosisError>>()?;
        let weakest = (0..carried.len()).min_by(|&a, &b| carried[a].share.total_cmp(&carried[b].share));
        let Some(weakest) = weakest else { break };
        if carried[weakest].share < LEAST_CARRIED {
            drop_effect(domain, model, known + weakest, takes, dropped)?;
            continue;
        }
        let mut order: Vec<usize> = (0..carried.len()).collect();
        order.sort_by(|&a, &b| carried[b].loss.total_cmp(&carried[a].loss));
        let named = model.effects.split_off(known);
        model.effects.extend(order.into_iter().map(|idx| named[idx].clone()));
        break;
    }
    Ok(())
}

/// Drops identified effects that lost their evidence to later ones, the weakest first. The first `known` effects were
/// given with the model and stay: the takes at hand may not exercise them, which is no evidence against them.
fn drop_one<D: Domain>(
    domain: &D,
    model: &mut Model,
    known: usize,
    takes: &[usize],
    bar: f64,
    dropped: &mut Vec<Effect>,
) -> Result<(), DiagnosisError> {
    while model.effects.len() > known + 1 {
        let evidence = joint_evidence(domain, model, takes)?;
        let weakest = (known..evidence.len()).min_by(|&a, &b| evidence[a].total_cmp(&evidence[b]));
        let Some(weakest) = weakest.filter(|&idx| evidence[idx] < 0.5 * bar) else { break };
        drop_effect(domain, model, weakest, takes, dropped)?;
    }
    Ok(())
}

/// Takes the effect `idx` out of `model`, and fits the others anew.
fn drop_effect<D: Domain>(
    domain: &D,
    model: &mut Model,
    idx: usize,
    takes: &[usize],
    dropped: &mut Vec<Effect>,
) -> Result<(), DiagnosisError> {
    dropped.push(model.effects.remove(idx));
    *model = Fit::again().of(domain, model, takes)?;
    Ok(())
}
