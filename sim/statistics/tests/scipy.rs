//! The same numbers as SciPy 1.17 (`binomtest(k, n).proportion_ci`, `binomtest(b, b + c)`, `barnard_exact`).

use palpate_statistics::{
    Interval, StatisticsError, barnard_exact, clopper_pearson, cohens_kappa, mcnemar_exact, pass_hat_k,
    wilson,
};

/// Successes, trials, Wilson's interval and Clopper and Pearson's at 95 %, the latter at 90 %.
const RATES: [(u64, u64, [f64; 6]); 7] = [
    (
        9,
        10,
        [
            0.5958499732047615,
            0.9821237869049271,
            0.5549838829718047,
            0.9974714214555375,
            0.6058366975630259,
            0.9948838031076954,
        ],
    ),
    (0, 20, [0.0, 0.16112515805281935, 0.0, 0.16843347098308548, 0.0, 0.13910834066837535]),
    (
        45,
        50,
        [
            0.7863976856252034,
            0.9565242350681095,
            0.7818646335657977,
            0.9667249064109785,
            0.8011669974840242,
            0.9597634095978971,
        ],
    ),
    (
        16,
        50,
        [
            0.20758216260656842,
            0.4581029730814407,
            0.1952041946628379,
            0.46699384011473305,
            0.21210409790460144,
            0.44462329581907956,
        ],
    ),
    (50, 50, [0.9286524008666412, 1.0, 0.9288782635357954, 1.0, 0.9418449208830241, 1.0]),
    (1, 1, [0.20654931437723745, 1.0, 0.025000000000000022, 1.0, 0.04999999999999999, 1.0]),
    (
        117,
        200,
        [
            0.5157391490134404,
            0.6510571455024243,
            0.5133753143831973,
            0.65406633181922,
            0.5245269463245367,
            0.6435685402354634,
        ],
    ),
];

fn assert_close(found: f64, expected: f64, what: &str) {
    assert!((found - expected).abs() < 1e-10, "{what}: {found} instead of {expected}");
}

#[test]
fn intervals_of_rates_are_scipys() {
    for (successes, trials, expected) in RATES {
        let ends = |interval: Result<Interval, StatisticsError>| {
            let Interval { low, high } = interval.unwrap();
            [low, high]
        };
        let found = [
            ends(wilson(successes, trials, 0.95)),
            ends(clopper_pearson(successes, trials, 0.95)),
            ends(clopper_pearson(successes, trials, 0.9)),
        ];
        for (found, expected) in found.as_flattened().iter().zip(expected) {
            assert_close(*found, expected, &format!("{successes} of {trials}"));
        }
    }
}

#[test]
fn pairs_on_the_same_starts_are_compared_as_scipy_does() {
    let cases = [
        (0, 0, 1.0),
        (3, 9, 0.14599609375),
        (10, 10, 1.0),
        (1, 12, 0.00341796875),
        (40, 60, 0.05688793364098089),
        (0, 5, 0.0625),
    ];
    for (only_a, only_b, expected) in cases {
        assert_close(mcnemar_exact(only_a, only_b), expected, &format!("{only_a} and {only_b}"));
        assert_close(mcnemar_exact(only_b, only_a), expected, &format!("{only_b} and {only_a}"));
    }
}

#[test]
fn trials_on_starts_of_their_own_are_compared_as_scipy_does() {
    let cases = [
        ((45, 100), (60, 100), 0.037_263_496),
        ((16, 50), (11, 50), 0.276_492_838),
        ((10, 10), (10, 10), 1.0),
        ((0, 8), (5, 9), 0.014_648_437),
        ((2, 30), (9, 31), 0.024_360_060),
    ];
    for (a, b, expected) in cases {
        let found = barnard_exact(a, b).unwrap();
        assert!((found - expected).abs() < 1e-6, "{a:?} and {b:?}: {found} instead of {expected}");
    }
    // SciPy gives 0.12293 here: of tables that are exactly as extreme as the one seen, it leaves some out by rounding.
    let found = barnard_exact((7, 12), (3, 12)).unwrap();
    assert!((found - 0.12588).abs() < 1e-5, "{found}");
}

#[test]
fn agreement_is_cohens() {
    // The example of J. L. Fleiss, "Statistical Methods for Rates and Proportions", table 13.1: 0.676.
    let counts = [[75, 1, 4], [5, 4, 1], [0, 0, 10]];
    let kappa = cohens_kappa(&counts).unwrap().unwrap();
    assert!((kappa - 0.676).abs() < 5e-4, "{kappa}");
    assert_eq!(cohens_kappa(&[[3, 0], [0, 4]]).unwrap(), Some(1.0));
    assert_eq!(cohens_kappa(&[[3, 0], [0, 0]]).unwrap(), None, "chance explains everything");
    assert!(cohens_kappa(&[[0, 0], [0, 0]]).is_err());
}

#[test]
fn trials_in_a_row_are_drawn_without_replacement() {
    assert_eq!(pass_hat_k(3, 4, 0).unwrap(), 1.0);
    assert_eq!(pass_hat_k(3, 4, 1).unwrap(), 0.75);
    assert_eq!(pass_hat_k(3, 4, 2).unwrap(), 0.5);
    assert_eq!(pass_hat_k(3, 4, 4).unwrap(), 0.0);
    assert!(pass_hat_k(3, 4, 5).is_err());
}

#[test]
fn numbers_that_no_trials_have_are_refused_by_name() {
    let refused = wilson(5, 4, 0.95).unwrap_err().to_string();
    assert_eq!(refused, "5 successes of 4 trials; expected at most as many successes as trials");
    let refused = clopper_pearson(1, 4, 1.0).unwrap_err().to_string();
    assert_eq!(refused, "the confidence is 1, expected more than 0 and less than 1");
    assert!(wilson(1, 4, f64::NAN).is_err());
    assert!(barnard_exact((0, 0), (1, 2)).is_err());
    let all = Interval { low: 0.0, high: 1.0 };
    assert_eq!((wilson(0, 0, 0.95), clopper_pearson(0, 0, 0.95)), (Ok(all), Ok(all)), "nothing is known");
}
