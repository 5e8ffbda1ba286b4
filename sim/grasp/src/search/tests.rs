//! Laws of the belief, in a made-up world where what a try feels like is known.

use proptest::prelude::*;

use super::experience::{Closing, Closings, Experience};
use super::{Belief, Felt, Moment, Senses};
use crate::GraspError;

const WINDOW_M: f64 = 0.12;
const NUM_FELT: [usize; 2] = [2, 3];

/// What a hand at the origin feels of an object at (x, y), and whether it wins: it feels within 6 cm and grasps within 3 cm.
fn outcome(shape: usize, x: f64, y: f64) -> (Felt, bool) {
    let reach_m = 0.03 + 0.01 * shape as f64;
    let is_felt = x.abs() < 0.06 && y.abs() < 0.06;
    let on = |value: f64| if is_felt { value as f32 } else { 0.0 };
    let felt = Felt {
        touch: vec![on(1.0), on(0.5 + 5.0 * x)],
        tracking: vec![on(10.0 * x), on(10.0 * y), on(0.2 * shape as f64)],
    };
    (felt, x.abs() < reach_m && y.abs() < reach_m)
}

/// Closings on two shapes, evenly over the window; nothing moves but what is won, which is lifted where it is.
fn closings() -> Closings {
    let mut closings = Vec::new();
    let steps = 12;
    for shape in 0..2 {
        for x in -steps..=steps {
            for y in -steps..=steps {
                let at =
                    [f64::from(x) * WINDOW_M / f64::from(steps), f64::from(y) * WINDOW_M / f64::from(steps)];
                let (felt, won) = outcome(shape, at[0], at[1]);
                let start_m = at.map(|at_m| at_m as f32);
                closings.push(Closing {
                    shape,
                    start_m,
                    glanced_m: start_m,
                    closed_m: start_m,
                    end_m: start_m,
                    won,
                    glance: felt.clone(),
                    lifting: felt.clone(),
                    closing: felt,
                });
            }
        }
    }
    Closings { objects: vec!["small".to_owned(), "large".to_owned()], window_m: WINDOW_M, closings }
}

fn experience(senses: Senses) -> Experience {
    Experience::of(closings(), NUM_FELT, senses).expect("a made-up world that is right")
}

fn even(experience: &Experience) -> Belief {
    Belief::even(experience, 0.08, 0.1, None)
}

fn is_distribution(belief: &Belief) -> bool {
    (belief.sum() - 1.0).abs() < 1e-9
        && belief.gone() >= 0.0
        && belief.shapes().iter().all(|mass| (0.0..=1.0 + 1e-9).contains(mass))
}

fn any_felt() -> impl Strategy<Value = Felt> {
    let touch = proptest::collection::vec(-2.0_f32..2.0, NUM_FELT[0]);
    let tracking = proptest::collection::vec(-2.0_f32..2.0, NUM_FELT[1]);
    (touch, tracking).prop_map(|(touch, tracking)| Felt { touch, tracking })
}

fn any_senses() -> impl Strategy<Value = Senses> {
    (any::<bool>(), any::<bool>()).prop_map(|(touch, tracking)| Senses { touch, tracking })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn a_belief_stays_a_distribution_whatever_is_felt(
        senses in any_senses(),
        felt in proptest::collection::vec((any_felt(), any_felt(), -0.12..0.12, -0.12..0.12), 1..4),
    ) {
        let experience = experience(senses);
        let mut belief = even(&experience);
        prop_assert!(is_distribution(&belief));
        for (closing, lifting, x, y) in felt {
            let attempt = belief.attempt(&experience, [x, y], &closing);
            let lifted = attempt.lifted(&experience, &lifting);
            for attempt in [&attempt, &lifted] {
                prop_assert!((-1e-9..=1.0 + 1e-9).contains(&attempt.held(&experience)));
            }
            prop_assert!(is_distribution(&attempt.belief(&experience, Moment::Closed)));
            belief = lifted.lost(&experience).belief(&experience, Moment::Lifted);
            prop_assert!(is_distribution(&belief));
        }
    }

    #[test]
    fn what_is_felt_as_simulated_leads_to_the_true_place(
        shape in 0_usize..2, x in -0.08..0.08, y in -0.08..0.08, off_x in -0.04..0.04, off_y in -0.04..0.04,
    ) {
        let experience = experience(Senses::BOTH);
        let (felt, won) = outcome(shape, off_x, off_y);
        let before = even(&experience);
        let attempt = before.attempt(&experience, [x - off_x, y - off_y], &felt);
        let held = attempt.held(&experience);
        let after = attempt.belief(&experience, Moment::Closed);
        let (prior, posterior) = (before.within([x, y], 0.03), after.within([x, y], 0.03));
        prop_assert!(posterior > 0.8 && posterior > prior, "{prior} {posterior}");
        // At the edge of what is grasped it cannot be sure.
        let to_edge = [off_x, off_y].map(|off: f64| (off.abs() - 0.03 - 0.01 * shape as f64).abs());
        if to_edge.iter().all(|m| *m > 0.012) {
            prop_assert!(if won { held > 0.7 } else { held < 0.3 }, "{won} {held}");
        }
    }

    #[test]
    fn who_has_no_senses_learns_the_same_from_everything(one in any_felt(), other in any_felt(), x in -0.1..0.1) {
        let experience = experience(Senses::NONE);
        let after = |felt: &Felt| even(&experience).attempt(&experience, [x, 0.0], felt).belief(&experience, Moment::Closed);
        prop_assert_eq!(after(&one), after(&other));
        // And nothing moves, so that only the blur is new, and the window's edge, which cuts through cells.
        let mean_m = after(&one).mean_m();
        prop_assert!(mean_m.iter().all(|at_m| at_m.abs() < 5e-3), "{mean_m:?}");
    }

    #[test]
    fn an_oracle_goes_to_the_place_that_it_is_told(x in -0.1..0.1, y in -0.1..0.1) {
        let experience = experience(Senses::BOTH);
        let told = even(&experience).told([x, y]);
        prop_assert!(is_distribution(&told));
        let mean_m = told.mean_m();
        prop_assert!((mean_m[0] - x).abs() < 1e-9 && (mean_m[1] - y).abs() < 1e-9);
        prop_assert!(told.success(&experience, [x, y]) > 0.8);
        prop_assert!(told.success(&experience, [x - 0.1, y]) < 0.1);
    }
}

#[test]
fn what_is_next_to_impossible_teaches_nothing() {
    let experience = experience(Senses::BOTH);
    let before = even(&experience);
    // Found by the property above: a sum of likelihoods between zero and the smallest number with all its digits.
    let felt = Felt { touch: vec![0.0, -0.421_714_04], tracking: vec![-0.472_165_55, 1.259_781_1, 0.0] };
    let nothing = Felt { touch: vec![0.0; 2], tracking: vec![0.0; 3] };
    let attempt = before.attempt(&experience, [-0.113_398_952_571_003_62, 0.0], &felt);
    let lifted = attempt.lifted(&experience, &nothing);
    for attempt in [&attempt, &lifted] {
        assert!((0.0..=1.0 + 1e-9).contains(&attempt.held(&experience)));
        assert!(is_distribution(&attempt.belief(&experience, Moment::Lifted)));
    }
}

#[test]
fn a_try_that_felt_nothing_moves_the_belief_away_from_its_place() {
    let experience = experience(Senses::BOTH);
    let before = even(&experience);
    let (nothing, _) = outcome(0, 1.0, 1.0);
    let attempt = before.attempt(&experience, [0.0, 0.0], &nothing);
    assert!(attempt.held(&experience) < 1e-3);
    let after = attempt.belief(&experience, Moment::Closed);
    assert!(before.within([0.0, 0.0], 0.03) > 0.09 && after.within([0.0, 0.0], 0.03) < 1e-3);
    // The next try is expected to be better elsewhere, which it was not before.
    let success = |belief: &Belief, at_m| belief.success(&experience, at_m);
    let (here, corner) = ([0.0, 0.0], [0.07, 0.07]);
    assert!(success(&before, here) > success(&before, corner));
    assert!(success(&after, here) < 0.01 && success(&after, corner) > success(&before, corner));
}

#[test]
fn objects_beyond_the_window_stay_where_they_are_believed_to_be() {
    let experience = experience(Senses::BOTH);
    let far = even(&experience).told([0.16, 0.0]);
    let (nothing, _) = outcome(0, 1.0, 1.0);
    let after = far.attempt(&experience, [-0.05, 0.0], &nothing).belief(&experience, Moment::Closed);
    assert!(after.within([0.16, 0.0], 0.02) > 0.999);
}

#[test]
fn a_shape_that_is_known_is_the_only_one_believed_in() {
    let experience = experience(Senses::BOTH);
    assert_eq!(Belief::even(&experience, 0.02, 0.1, Some(1)).shapes()[0], 0.0);
    let shapes = even(&experience).shapes();
    assert!((shapes[0] - shapes[1]).abs() < 1e-12);
    // Half of the cells at the edge of a square of 2 cm lie in it, which is what makes its mean exact.
    assert!((Belief::even(&experience, 0.02, 0.1, None).within([0.0, 0.0], 0.03) - 1.0).abs() < 1e-9);
}

#[test]
fn what_is_wrong_with_closings_is_named() {
    let said = |change: &dyn Fn(&mut Closings)| {
        let mut closings = closings();
        change(&mut closings);
        match Experience::of(closings, NUM_FELT, Senses::BOTH) {
            Err(GraspError::Config { problem, .. }) => problem,
            other => panic!("{other:?}"),
        }
    };
    for (expected, found) in [
        ("there are no closings", said(&|closings| closings.objects.clear())),
        ("no closings on \"cube\"", said(&|closings| closings.objects.push("cube".to_owned()))),
        ("closing 3 has shape 7", said(&|closings| closings.closings[3].shape = 7)),
        ("closing 5 holds NaN", said(&|closings| closings.closings[5].lifting.touch[1] = f32::NAN)),
        ("window_m is NaN", said(&|closings| closings.window_m = f64::NAN)),
        (
            "closing 2 has [1, 3] numbers",
            said(&|closings| {
                closings.closings[2].closing.touch.pop();
            }),
        ),
    ] {
        assert!(found.contains(expected), "{found}");
    }
}
