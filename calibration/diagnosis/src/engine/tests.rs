//! The engine on a domain of sines, where everything is known.

use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::Mutex;

use nalgebra::{Matrix2, Vector2};
use palpate_robot_model::Place;
use palpate_sim::effects::{Effect, Parameter};
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::linear::{Linear, predict};
use super::naming::Tried;
use super::{BaseParameter, Contributions, Domain, Model, Naming, NamingConfig, Series, each, name, refit};
use crate::DiagnosisError;
use crate::fired::Fired;

const ROWS: usize = 400;
const TAKES: usize = 4;
const NOISE: f64 = 0.1;

/// Rows are `level + sum of size * shape(row)`; each shape is an effect. A second number of the base, where there is one,
/// is how much of the slow shape is no news.
struct Sines {
    observed: Vec<Vec<f64>>,
    blocks: Vec<Range<usize>>,
    base: Vec<BaseParameter>,
    shapes: &'static [&'static str],
    /// What the level is known to be.
    level: Option<f64>,
    /// Standard deviation that the second number of the base is known to have.
    prior: Option<f64>,
}

const SHAPES: [&str; 4] = ["slow", "fast", "nearly_fast", "square"];

fn shape(id: &str, row: usize) -> f64 {
    let phase = row as f64 * 0.05;
    match id {
        "slow" | "steep" => phase.sin(),
        // With another level not to be told from the one above.
        "slow_and_raised" => phase.sin() + 1.0,
        "fast" | "wound" => (3.0 * phase).sin(),
        // Hardly to be told from the one above.
        "nearly_fast" => (3.0 * phase).sin() + 0.05 * (7.0 * phase).sin(),
        "square" => (0.7 * phase).sin().signum(),
        _ => 0.0,
    }
}

/// Twice pi of this size, and what is wound is as it was.
const TURNS: f64 = 10.0;

/// By how much an effect multiplies its shape.
fn strength(effect: &Effect) -> f64 {
    let size = effect.parameter("size");
    if effect.id == "wound" { 0.3 * (TURNS * size).sin() } else { size }
}

/// What an effect adds to its shape: near the size [`MISSED`] a few rows of one take change as steeply as nothing else
/// does.
fn steep(effect: &Effect, take: usize, row: usize) -> f64 {
    if effect.id != "steep" || take > 0 || row > 2 {
        return 0.0;
    }
    50.0 * (effect.parameter("size") - MISSED).clamp(-0.05, 0.05)
}

const MISSED: f64 = 0.3;

fn effect(id: &str, size: f64) -> Effect {
    sized(id, Place::Stream("all".to_owned()), size)
}

/// An effect of this `size`, which is its one parameter.
pub(super) fn sized(id: &str, place: Place, size: f64) -> Effect {
    Effect {
        id: id.to_owned(),
        place,
        parameters: BTreeMap::from([("size".to_owned(), size)]),
        interval: BTreeMap::new(),
        takes: Vec::new(),
    }
}

/// Parameters of what [`sized`] makes.
pub(super) fn size() -> Vec<Parameter> {
    let name = "size".to_owned();
    vec![Parameter { name, lower: -3.0, upper: 3.0, neutral: 0.0, smallest: 0.02, dose: 0.1 }]
}

/// Levels that models fit along.
pub(super) static LEVELS: [BaseParameter; 2] =
    [const { BaseParameter { name: String::new(), lower: -5.0, upper: 5.0, dose: 0.1 } }; 2];

/// Nearly normal deviates with this standard `deviation`.
pub(super) fn deviates(seed: u64, deviation: f64) -> impl FnMut() -> f64 {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    move || deviation * ((0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0)
}

impl Sines {
    fn new(hidden: &[(&str, f64)], seed: u64) -> Self {
        let mut noise = deviates(seed, NOISE);
        let observed = (0..TAKES)
            .map(|_| {
                let of_row = |row: usize| -> f64 {
                    0.7 + hidden.iter().map(|(id, size)| size * shape(id, row)).sum::<f64>()
                };
                (0..ROWS).map(|row| of_row(row) + noise()).collect()
            })
            .collect();
        Self {
            observed,
            blocks: (0..ROWS / 20).map(|block| block * 20..(block + 1) * 20).collect(),
            base: LEVELS[..1].to_vec(),
            shapes: &SHAPES,
            level: None,
            prior: None,
        }
    }

    fn name(&self, config: &NamingConfig) -> Naming {
        let start = Model { base: vec![0.7], effects: Vec::new() };
        name(self, &start, &[0, 1, 2, 3], config, &|_, _| Ok(())).expect("predictions cannot fail")
    }
}

pub(super) fn config() -> NamingConfig {
    NamingConfig {
        max_effects: 4,
        bar: 12.0,
        kept_bar: 12.0,
        least_share: 0.002,
        num_fits: 4,
        without: Vec::new(),
    }
}

fn ids(naming: &Naming) -> Vec<&str> {
    naming.model.effects.iter().map(|effect| effect.id.as_str()).collect()
}

impl Domain for Sines {
    fn num_takes(&self) -> usize {
        TAKES
    }

    fn blocks(&self, _take: usize) -> &[Range<usize>] {
        &self.blocks
    }

    fn observed(&self, take: usize, _signal: usize) -> &[f64] {
        &self.observed[take]
    }

    fn base(&self) -> &[BaseParameter] {
        &self.base
    }

    fn prior_standard_deviation(&self, idx: usize) -> Option<f64> {
        self.prior.filter(|_| idx == 1)
    }

    fn candidates(&self) -> Vec<Effect> {
        self.shapes.iter().map(|id| effect(id, 0.0)).collect()
    }

    fn parameters(&self, _effect: &Effect) -> Vec<Parameter> {
        size()
    }

    fn num_units(&self) -> usize {
        1
    }

    fn support(&self, _effect: &Effect, _parameter: &str) -> Vec<bool> {
        vec![true]
    }

    fn predict(&self, take: usize, model: &Model) -> Result<Vec<Series>, DiagnosisError> {
        let of_row = |row: usize| -> f64 {
            let effects = model.effects.iter();
            let expected = model.base.get(1).map_or(0.0, |size| size * shape("slow", row));
            model.base[0]
                + expected
                + effects.map(|e| strength(e) * shape(&e.id, row) + steep(e, take, row)).sum::<f64>()
        };
        Ok(vec![(0..ROWS).map(of_row).collect()])
    }

    fn strain(&self, model: &Model) -> Result<f64, DiagnosisError> {
        Ok(self.level.map_or(0.0, |level| (model.base[0] - level).powi(2)))
    }

    fn weights(&self, _take: usize, _signal: usize, prediction: &[f64]) -> Vec<f64> {
        vec![1.0 / NOISE; prediction.len()]
    }
}

#[test]
fn two_hidden_shapes_are_named_with_their_sizes() {
    let naming = Sines::new(&[("slow", 0.3), ("square", -0.2)], 1).name(&config());
    assert_eq!(ids(&naming), ["slow", "square"]);
    for (effect, (size, errors)) in
        naming.model.effects.iter().zip([0.3, -0.2].iter().zip(&naming.standard_errors))
    {
        let error = (effect.parameter("size") - size).abs();
        assert!(error < 4.0 * errors[0], "{effect:?} is {error} off, standard error {}", errors[0]);
    }
}

/// A search that has found `effects`.
fn found(effects: Vec<Effect>) -> Naming {
    Naming {
        model: Model { base: vec![0.7], effects },
        standard_errors: Vec::new(),
        evidence: Vec::new(),
        rounds: Vec::new(),
        dropped: Vec::new(),
        withheld: Vec::new(),
        needs: None,
    }
}

#[test]
fn what_is_told_sharply_where_nothing_is_gained_is_no_name() {
    let domain = Sines::new(&[("slow", 0.3)], 11);
    let once_around = std::f64::consts::TAU / TURNS;
    let mut naming = found(vec![effect("slow", 0.3), effect("wound", once_around)]);
    let takes = [0, 1, 2, 3];
    naming.settle(&domain, &takes).unwrap();
    assert!(naming.evidence.iter().all(|evidence| *evidence > 1000.0), "{:?}", naming.evidence);
    naming.weigh_again(&domain, 0, &takes, 25.0).unwrap();
    assert_eq!(ids(&naming), ["slow"]);
    assert_eq!(naming.dropped[0].id, "wound");
}

#[test]
fn what_every_repetition_misses_is_a_name_though_a_few_rows_seem_to_tell_it() {
    let takes = [0, 1, 2, 3];
    let weighed = |hidden: &[(&str, f64)]| {
        let domain = Sines::new(hidden, 11);
        let mut naming = found(vec![effect("steep", MISSED)]);
        naming.settle(&domain, &takes).unwrap();
        let by_error = naming.evidence[0];
        naming.weigh_again(&domain, 0, &takes, 25.0).unwrap();
        (by_error, naming.evidence)
    };
    let (by_error, evidence) = weighed(&[("slow", MISSED)]);
    assert!(by_error < 12.0, "{by_error}");
    assert!(evidence.len() == 1 && evidence[0] > 25.0, "{evidence:?}");
    assert!(weighed(&[]).1.is_empty(), "nothing is hidden");
}

#[test]
fn what_every_repetition_misses_keeps_its_evidence_when_another_name_is_withheld() {
    let takes = [0, 1, 2, 3];
    let domain = Sines::new(&[("slow", MISSED), ("square", 0.05)], 11);
    let mut naming = found(vec![effect("steep", MISSED), effect("square", 0.05)]);
    naming.settle(&domain, &takes).unwrap();
    let by_error = naming.evidence[0];
    naming.weigh_again(&domain, 0, &takes, 25.0).unwrap();
    assert_eq!(ids(&naming), ["steep", "square"]);
    let why = Fired { rule: "size_by_take", measured: 1.0, limit: 0.8 };
    naming.withhold_one(&domain, 1, &takes, why).unwrap();
    assert!(by_error < 12.0 && naming.evidence[0] > 25.0, "{by_error}, {:?}", naming.evidence);
}

#[test]
fn an_effect_of_many_parameters_needs_a_third_of_those_that_the_data_sees() {
    let parameters: Vec<Parameter> = (0..12)
        .map(|idx| Parameter {
            name: format!("size_{idx}"),
            lower: -1.0,
            upper: 1.0,
            neutral: 0.0,
            smallest: 0.02,
            dose: 0.1,
        })
        .collect();
    // `out` of twelve parameters are ten standard errors beyond what matters, and `unseen` of the others have no error.
    let of = |out: usize, unseen: usize| {
        let size = |idx: usize| if idx < out { 0.12 } else { 0.0 };
        let sizes = parameters.iter().enumerate().map(|(idx, parameter)| (parameter.name.clone(), size(idx)));
        let effect =
            Effect { parameters: sizes.collect(), ..sized("many", Place::Stream("all".to_owned()), 0.0) };
        let errors: Vec<f64> = (0..12).map(|idx| if idx < 12 - unseen { 0.01 } else { 0.0 }).collect();
        super::evidence::evidence(&effect, &parameters, &errors)
    };
    assert!((of(4, 0) - 100.0).abs() < 1e-9 && (of(12, 0) - 100.0).abs() < 1e-9);
    assert_eq!(of(3, 0), 0.0, "one of the strongest third is nothing");
    assert!((of(3, 3) - 100.0).abs() < 1e-9, "three of nine");
    assert_eq!(of(0, 12), 0.0, "the data sees none");
}

#[test]
fn what_the_model_takes_up_is_no_news_as_far_as_its_range_goes() {
    let named = |hidden: f64| {
        let mut sines = Sines::new(&[("slow", hidden)], 5);
        let slow = "slow".to_owned();
        sines.base.push(BaseParameter { name: slow, lower: 0.0, upper: 0.1, dose: 0.02 });
        let start = Model { base: vec![0.7, hidden.min(0.1)], effects: Vec::new() };
        let naming = name(&sines, &start, &[0, 1, 2, 3], &config(), &|_, _| Ok(())).unwrap();
        naming.model.effects.iter().map(|effect| effect.parameter("size")).collect::<Vec<_>>()
    };
    assert!(named(0.08).is_empty());
    let beyond = named(0.3);
    assert!(beyond.len() == 1 && beyond[0] > 0.15, "{beyond:?}");
}

#[test]
fn what_is_known_beforehand_counts_as_one_more_row() {
    let (hidden, prior) = (0.3, 0.01);
    let mut sines = Sines::new(&[("slow", hidden)], 5);
    sines.base = LEVELS.to_vec();
    sines.prior = Some(prior);
    let start = Model { base: vec![0.7, 0.0], effects: Vec::new() };
    let Model { base, .. } = refit(&sines, &start, &[0, 1, 2, 3], 8).unwrap();
    // The normal equations of the level and the shape, by hand.
    let rows = || sines.observed.iter().flat_map(|take| take.iter().enumerate());
    let weight = NOISE.powi(-2);
    let sum = |of: &dyn Fn(usize, f64) -> f64| weight * rows().map(|(row, &y)| of(row, y)).sum::<f64>();
    let slow = |row| shape("slow", row);
    let normal = Matrix2::new(
        sum(&|_, _| 1.0),
        sum(&|row, _| slow(row)),
        sum(&|row, _| slow(row)),
        sum(&|row, _| slow(row).powi(2)) + prior.powi(-2),
    );
    let right = Vector2::new(sum(&|_, y| y), sum(&|row, y| slow(row) * y));
    let expected = normal.try_inverse().unwrap() * right;
    // Rows beyond what Huber's loss takes for squares weigh less.
    let off = [0, 1].map(|idx| (base[idx] - expected[idx]).abs());
    assert!(off.iter().all(|off| *off < 2e-3), "{base:?} instead of {expected}");
    assert!(base[1] < 0.95 * hidden, "{base:?} is as far as the rows alone would have it");
}

#[test]
fn a_name_that_usual_sizes_account_for_as_well_is_dropped() {
    let left = |hidden: f64| {
        let mut sines = Sines::new(&[("slow", hidden), ("square", 0.2)], 5);
        let mut naming = sines.name(&config());
        let mut named = ids(&naming);
        named.sort_unstable();
        assert_eq!(named, ["slow", "square"]);
        sines.base = LEVELS.to_vec();
        sines.prior = Some(0.05);
        naming.model.base.push(0.0);
        naming.weigh_again(&sines, 0, &[0, 1, 2, 3], config().kept_bar).unwrap();
        assert_eq!(naming.evidence.len(), naming.model.effects.len());
        ids(&naming).into_iter().map(str::to_owned).collect::<Vec<_>>()
    };
    assert_eq!(left(0.1), ["square"]);
    assert_eq!(left(0.5).len(), 2);
}

#[test]
fn nothing_is_a_share_of_no_loss() {
    let effect = sized("slow", Place::Stream("all".to_owned()), 0.3);
    let model = Model { base: Vec::new(), effects: Vec::new() };
    let tried = |loss: f64| Tried::new(effect.clone(), &model, 0.0, &[2.0, 1.0], loss).share;
    assert_eq!([tried(12.0), tried(0.0)], [0.25, 0.0]);
}

#[test]
fn what_the_data_cannot_tell_apart_is_one_class() {
    let naming = Sines::new(&[("fast", 0.3)], 2).name(&config());
    let round = &naming.rounds[0];
    let mut class: Vec<&str> = round.class.iter().map(|&idx| round.tried[idx].effect.id.as_str()).collect();
    class.sort_unstable();
    assert_eq!(class, ["fast", "nearly_fast"]);
    assert_eq!(naming.model.effects.len(), 1, "the rival is not named beside it");
}

#[test]
fn of_two_that_explain_the_same_the_one_that_leaves_the_model_as_it_is_known_is_named() {
    for hidden in ["slow", "slow_and_raised"] {
        let mut sines = Sines::new(&[(hidden, 0.3)], 5);
        sines.shapes = &["slow_and_raised", "slow"];
        sines.level = Some(0.7);
        let naming = sines.name(&config());
        assert_eq!(ids(&naming), [hidden]);
        assert_eq!(naming.rounds[0].class.len(), 2, "both are in the class");
    }
}

#[test]
fn what_is_missing_as_well_is_no_rival() {
    // As large as each other, and alike in nothing.
    let naming = Sines::new(&[("slow", 0.3), ("square", -0.2)], 1).name(&config());
    assert_eq!(ids(&naming), ["slow", "square"]);
    let first = &naming.rounds[0];
    let gains: Vec<f64> = first.tried.iter().map(|tried| tried.held_out_gain).collect();
    assert!(gains[1] > 0.8 * gains[0], "{gains:?}");
    assert_eq!(first.class.len(), 1);
}

/// Takes of which each has its own size of the slow shape.
fn slow_by_take(sizes: [f64; TAKES]) -> Sines {
    let mut sines = Sines::new(&[], 6);
    for (observed, size) in sines.observed.iter_mut().zip(sizes) {
        observed.iter_mut().enumerate().for_each(|(row, value)| *value += size * shape("slow", row));
    }
    sines
}

#[test]
fn takes_agree_on_the_size_of_a_right_name_and_of_no_other() {
    let disagreement = |sizes: [f64; TAKES]| {
        let model = Model { base: vec![0.7], effects: vec![effect("slow", 0.3)] };
        let sines = slow_by_take(sizes);
        Contributions::of(&sines, &model, &[0, 1, 2, 3]).unwrap().disagreements().unwrap()[0]
    };
    let right = disagreement([0.3; TAKES]);
    assert!(right < 0.05, "{right}");
    // As large as the name on average, and as far from it in every take.
    let wrong = disagreement([0.6, 0.0, 0.6, 0.0]);
    assert!((wrong - 1.0).abs() < 0.05, "{wrong}");
}

#[test]
fn an_effect_that_was_given_stays_though_the_takes_do_not_show_it() {
    // No row depends on the given effect, so that its evidence is nothing.
    let given = effect("not_exercised", 0.3);
    let start = Model { base: vec![0.7], effects: vec![given.clone()] };
    for hidden in [&[][..], &[("slow", 0.3)], &[("slow", 0.3), ("square", -0.2)]] {
        let naming = name(&Sines::new(hidden, 8), &start, &[0, 1, 2, 3], &config(), &|_, _| Ok(())).unwrap();
        let expected: Vec<&str> =
            ["not_exercised"].into_iter().chain(hidden.iter().map(|(id, _)| *id)).collect();
        assert_eq!(ids(&naming), expected);
        assert_eq!(naming.model.effects[0], given);
        assert!(naming.dropped.is_empty(), "{:?}", naming.dropped);
        assert_eq!(naming.evidence.len(), expected.len());
    }
}

#[test]
fn the_class_of_an_effect_is_that_of_the_last_round_that_named_it() {
    let mut naming = Sines::new(&[("fast", 0.3)], 2).name(&config());
    assert_eq!(naming.rounds[0].class.len(), 2);
    // Named, dropped and named again, without a rival.
    let mut again = naming.rounds[0].clone();
    again.class.retain(|member| Some(*member) == again.named);
    naming.rounds.push(again);
    let (round, named) = naming.round_of(&naming.model.effects[0]).unwrap();
    assert_eq!(round.class, [named]);
    assert!(naming.round_of(&effect("square", 0.1)).is_none());
}

#[test]
fn an_effect_that_is_left_out_is_not_named() {
    let without = NamingConfig { without: vec!["slow".to_owned()], ..config() };
    let naming = Sines::new(&[("slow", 0.3)], 3).name(&without);
    assert!(!ids(&naming).contains(&"slow"));
}

#[test]
fn a_stop_is_passed_on() {
    let sines = Sines::new(&[], 4);
    let start = Model { base: vec![0.7], effects: Vec::new() };
    let stopped = name(&sines, &start, &[0], &config(), &|_, _| Err(DiagnosisError::Cancelled));
    assert!(matches!(stopped, Err(DiagnosisError::Cancelled)));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn noise_is_given_no_name(seed in any::<u64>()) {
        let naming = Sines::new(&[], seed).name(&config());
        prop_assert!(naming.model.effects.is_empty(), "{:?}", naming.model.effects);
    }

    #[test]
    fn a_shape_below_the_size_that_matters_is_given_no_name(seed in any::<u64>(), size in -0.02..0.02) {
        let naming = Sines::new(&[("slow", size)], seed).name(&config());
        prop_assert!(naming.model.effects.is_empty(), "{:?}", naming.model.effects);
    }
}

#[test]
fn a_prediction_that_is_made_again_has_the_same_bits() {
    let mut sines = Sines::new(&[], 4);
    // An outlier, whose weight is damped.
    sines.observed[1][5] += 20.0 * NOISE;
    let model = Model { base: vec![0.7], effects: Vec::new() };
    let linear = Linear::new(&sines, &model, &[0, 1, 2, 3]).unwrap();
    let again = predict(&sines, &model, &linear.takes).unwrap();
    assert_eq!(linear.losses_of(&again), linear.losses_of(&linear.predicted));
    assert_eq!(linear.residual_of(&again).squares, linear.residual_of(&linear.predicted).squares);
}

#[test]
fn work_on_every_core_keeps_its_order_and_stops_when_told() {
    let heard = Mutex::new(Vec::new());
    let begun = |done: f64, _: &i32| {
        heard.lock().unwrap().push(done);
        Ok(())
    };
    let doubled = each((0..50).collect(), begun, |item: i32| Ok(2 * item)).unwrap();
    assert_eq!(doubled, (0..50).map(|item| 2 * item).collect::<Vec<_>>());
    let heard = heard.into_inner().unwrap();
    assert!(heard.is_sorted() && heard[0] == 0.0 && heard.len() == 50, "{heard:?}");

    let enough = |done: f64, _: &i32| if done < 0.5 { Ok(()) } else { Err(DiagnosisError::Cancelled) };
    let stopped = each((0..50).collect(), enough, |item: i32| Ok(item));
    assert!(matches!(stopped, Err(DiagnosisError::Cancelled)));
}
