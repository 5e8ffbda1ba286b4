//! What intervals, tests and the sequential boundary promise, checked by counting and by simulation.

use palpate_statistics::{
    Decision, Pairs, SequentialTest, barnard_exact, clopper_pearson, mcnemar_exact, wilson,
};
use proptest::prelude::*;
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;

/// Binomial probabilities by repeated convolution.
fn masses(n: u64, rate: f64) -> Vec<f64> {
    (0..n).fold(vec![1.0], |masses, _| {
        let at = |k: usize| masses.get(k).copied().unwrap_or(0.0);
        (0..=masses.len())
            .map(|k| (1.0 - rate) * at(k) + if k > 0 { rate * at(k - 1) } else { 0.0 })
            .collect()
    })
}

/// The exact p-value of Barnard's test at one common rate, by comparing squares of z as fractions of whole numbers.
fn barnard_at(a: (u64, u64), b: (u64, u64), rate: f64) -> f64 {
    let z_squared = |x: u64, y: u64| -> (u128, u128) {
        let (n_a, n_b, sum) = (u128::from(a.1), u128::from(b.1), u128::from(x + y));
        let difference = (u128::from(x) * n_b).abs_diff(u128::from(y) * n_a);
        (difference * difference * (n_a + n_b), n_a * n_b * sum * (n_a + n_b - sum))
    };
    let seen = z_squared(a.0, b.0);
    let is_extreme = |x, y| {
        let z = z_squared(x, y);
        // 0 / 0 is 0: all succeed or none.
        let (z, seen) = ((z.0, z.1.max(1)), (seen.0, seen.1.max(1)));
        z.0 * seen.1 >= seen.0 * z.1
    };
    let (mass_a, mass_b) = (masses(a.1, rate), masses(b.1, rate));
    let tables = (0..=a.1).flat_map(|x| (0..=b.1).map(move |y| (x, y)));
    tables.filter(|&(x, y)| is_extreme(x, y)).map(|(x, y)| mass_a[x as usize] * mass_b[y as usize]).sum()
}

proptest! {
    #[test]
    fn intervals_hold_the_rate_that_was_seen_and_shrink_with_confidence(trials in 1_u64..300, share in 0.0..=1.0) {
        let successes = (share * trials as f64) as u64;
        let rate = successes as f64 / trials as f64;
        for interval in [wilson, clopper_pearson] {
            let (wide, narrow) = (interval(successes, trials, 0.99).unwrap(), interval(successes, trials, 0.8).unwrap());
            prop_assert!(0.0 <= wide.low && wide.low <= narrow.low && narrow.low <= rate);
            prop_assert!(rate <= narrow.high && narrow.high <= wide.high && wide.high <= 1.0);
        }
    }

    #[test]
    fn clopper_and_pearson_cover_what_they_promise(trials in 1_u64..60, rate in 0.01..0.99) {
        let masses = masses(trials, rate);
        let covers = |k: u64| {
            let interval = clopper_pearson(k, trials, 0.9).unwrap();
            interval.low <= rate && rate <= interval.high
        };
        let coverage: f64 = (0..=trials).filter(|&k| covers(k)).map(|k| masses[k as usize]).sum();
        prop_assert!(coverage >= 0.9 - 1e-9, "{coverage}");
    }

    #[test]
    fn barnard_is_the_worst_common_rate(a in 0_u64..=12, b in 0_u64..=9, rate in 0.001..0.999) {
        let p = barnard_exact((a, 12), (b, 9)).unwrap();
        let at_rate = barnard_at((a, 12), (b, 9), rate);
        prop_assert!(at_rate <= p + 1e-4, "{at_rate} at {rate}, {p} at the worst");
        prop_assert!((barnard_exact((b, 9), (a, 12)).unwrap() - p).abs() < 1e-9, "whoever is called A");
    }

    #[test]
    fn equal_policies_are_called_different_as_seldom_as_promised(only_a in 0_u64..40, only_b in 0_u64..40) {
        let n = only_a + only_b;
        let p = mcnemar_exact(only_a, only_b);
        let as_extreme = |k: u64| mcnemar_exact(k, n - k) <= p + 1e-12;
        let coin = masses(n, 0.5);
        let chance: f64 = (0..=n).filter(|&k| as_extreme(k)).map(|k| coin[k as usize]).sum();
        prop_assert!(chance <= p + 1e-9, "{chance} and {p}");
    }

    #[test]
    fn equal_policies_end_a_sequential_test_as_seldom_as_promised(rate in 0.001..0.999) {
        let test = SequentialTest::plan(30, 0.1).unwrap();
        let found = test.operating(rate, rate).unwrap();
        prop_assert!(found.says_a + found.says_b <= 0.1, "{found:?}");
        prop_assert!((found.says_a - found.says_b).abs() < 1e-12, "{found:?}");
    }
}

/// Pairs of the comparisons below, with a chance of 0.05 in each direction.
const PAIRS: u64 = 50;

#[test]
fn power_and_length_are_those_of_simulated_comparisons() {
    const ROUNDS: u32 = 20_000;
    let test = SequentialTest::plan(PAIRS, 0.1).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for (rate_a, rate_b) in [(0.5, 0.8), (0.8, 0.95), (0.9, 0.9)] {
        let (mut says_b, mut says_a, mut pairs) = (0, 0, 0);
        for _ in 0..ROUNDS {
            let mut seen = Pairs { pairs: 0, successes_a: 0, successes_b: 0 };
            let decision = loop {
                seen.pairs += 1;
                seen.successes_a += u64::from(rng.random_bool(rate_a));
                seen.successes_b += u64::from(rng.random_bool(rate_b));
                let decision = test.decide(seen).unwrap();
                if decision != Decision::Undecided {
                    break decision;
                }
            };
            says_b += u32::from(decision == Decision::B);
            says_a += u32::from(decision == Decision::A);
            pairs += seen.pairs;
        }
        let expected = test.operating(rate_a, rate_b).unwrap();
        let share = |count: u32| f64::from(count) / f64::from(ROUNDS);
        // Four standard errors of a share.
        assert!((share(says_b) - expected.says_b).abs() < 0.015, "{} and {expected:?}", share(says_b));
        assert!((share(says_a) - expected.says_a).abs() < 0.015, "{} and {expected:?}", share(says_a));
        let mean = pairs as f64 / f64::from(ROUNDS);
        assert!((mean - expected.mean_pairs).abs() < 0.5, "{mean} and {expected:?}");
    }
}

#[test]
fn power_is_that_of_an_exact_boundary_with_linear_spending() {
    // Computed elsewhere by the same method, one direction at 0.05.
    for (rate_a, rate_b, power, pairs) in
        [(0.5, 0.8, 0.905, 26.4), (0.5, 0.9, 0.997, 17.3), (0.5, 0.7, 0.574, 37.5)]
    {
        let found = SequentialTest::plan(PAIRS, 0.1).unwrap().operating(rate_a, rate_b).unwrap();
        assert!((found.says_b - power).abs() < 0.01, "{found:?} instead of {power}");
        assert!((found.mean_pairs - pairs).abs() < 0.5, "{found:?} instead of {pairs}");
    }
}

#[test]
fn decisions_are_symmetric_and_a_hint_says_what_would_settle() {
    let test = SequentialTest::plan(PAIRS, 0.1).unwrap();
    let seen = |pairs, successes_a, successes_b| Pairs { pairs, successes_a, successes_b };
    assert_eq!(test.decide(seen(0, 0, 0)).unwrap(), Decision::Undecided);
    assert_eq!(test.decide(seen(20, 2, 18)).unwrap(), Decision::B);
    assert_eq!(test.decide(seen(20, 18, 2)).unwrap(), Decision::A);
    assert_eq!(test.decide(seen(20, 10, 12)).unwrap(), Decision::Undecided);
    assert_eq!(test.decide(seen(50, 30, 31)).unwrap(), Decision::Exhausted);
    assert!(test.decide(seen(51, 1, 1)).is_err(), "the plan is fixed before the first trial");
    let hint = test.pairs_to_settle(seen(20, 8, 14)).unwrap().expect("a difference of 0.3 is settled");
    assert!((1..=30).contains(&hint), "{hint}");
    assert_eq!(test.pairs_to_settle(seen(20, 10, 10)).unwrap(), None, "nothing tells them apart");
    assert_eq!(test.pairs_to_settle(seen(20, 2, 18)).unwrap(), None, "it is settled");
    assert!(SequentialTest::plan(0, 0.05).is_err() && SequentialTest::plan(1_000, 0.05).is_err());
}
