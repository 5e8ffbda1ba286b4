use std::path::Path;

use palpate_robot_model::Station;
use proptest::prelude::*;

use super::*;

pub(crate) fn station() -> Station {
    let dir = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../assets/stations");
    let read = |path: &str| std::fs::read(dir.join(path)).map_err(|err| err.to_string());
    Station::read("xarm6_leap.toml", read).expect("the shipped station reads")
}

pub(crate) fn shipped_text() -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../assets/grasp/reflex/xarm6_leap.toml");
    std::fs::read_to_string(path).expect("the shipped reflex")
}

pub(crate) fn shipped(station: &Station) -> ReflexConfig {
    ReflexConfig::from_toml(&shipped_text(), station).expect("the shipped reflex fits the shipped station")
}

fn gains() -> Gains {
    shipped(&station()).gains
}

const TURN_S: f64 = 0.005;

/// `step` again and again.
fn run(gains: &Gains, state: DigitState, seen: DigitSeen, for_s: f64) -> DigitState {
    (0..(for_s / TURN_S) as usize).fold(state, |state, _| step(gains, &state, &seen, TURN_S))
}

const FIRM: DigitSeen = DigitSeen { in_contact: true, load: 2.0, error_rad: 0.05, closed_rad: 0.8 };
const GONE: DigitSeen = DigitSeen { in_contact: false, load: 0.1, error_rad: 0.0, closed_rad: 0.8 };

#[test]
fn contact_that_is_lost_is_looked_for_and_what_was_told_comes_back_with_it() {
    let gains = gains();
    let held = run(&gains, DigitState::default(), FIRM, 0.2);
    assert_eq!((held.phase, held.offset_rad), (Phase::Holding, 0.0));
    let lost = run(&gains, held, GONE, 0.15);
    assert_eq!(lost.phase, Phase::Tightening);
    assert!(lost.offset_rad > 0.04 && lost.offset_rad < 0.15, "{lost:?}");
    let found = run(&gains, lost, FIRM, 0.1);
    assert_eq!(found.phase, Phase::Holding);
    let back = run(&gains, found, FIRM, 2.0);
    assert_eq!((back.phase, back.offset_rad), (Phase::Holding, 0.0));
}

#[test]
fn a_fast_fall_is_a_slip_and_a_slow_one_is_none() {
    let gains = gains();
    let held = run(&gains, DigitState::default(), FIRM, 0.2);
    let weaker = DigitSeen { load: 1.05, ..FIRM };
    assert_eq!(run(&gains, held, weaker, 0.06).phase, Phase::Tightening);
    // The same fall over three seconds, as a skin relaxes.
    let mut state = held;
    for turn in 0..600 {
        let load = 2.0 - 0.95 * f64::from(turn) / 600.0;
        state = step(&gains, &state, &DigitSeen { load, ..FIRM }, TURN_S);
        assert_eq!((state.phase, state.offset_rad), (Phase::Holding, 0.0), "{turn}");
    }
}

#[test]
fn what_does_not_come_back_is_given_up() {
    let gains = gains();
    let held = run(&gains, DigitState::default(), FIRM, 0.2);
    let given_up = run(&gains, held, GONE, 1.0);
    assert_eq!(given_up.phase, Phase::Free);
    assert_eq!(run(&gains, given_up, GONE, 3.0).offset_rad, 0.0);
}

#[test]
fn a_hand_that_is_told_to_open_is_not_held_shut() {
    let gains = gains();
    let held = run(&gains, DigitState::default(), FIRM, 0.2);
    let opening = DigitSeen { closed_rad: FIRM.closed_rad - 0.1, ..GONE };
    let opened = run(&gains, held, opening, 1.0);
    assert_eq!((opened.phase, opened.offset_rad), (Phase::Free, 0.0));
}

#[test]
fn a_digit_that_presses_too_hard_opens_until_it_does_not() {
    let gains = gains();
    let pressing = DigitSeen { error_rad: 0.4, ..FIRM };
    let yielding = run(&gains, DigitState::default(), pressing, 0.1);
    assert_eq!(yielding.phase, Phase::Yielding);
    assert!(yielding.offset_rad < -0.05, "{yielding:?}");
    // Between the two errors it goes on, below it comes back.
    let between = run(&gains, yielding, DigitSeen { error_rad: 0.2, ..FIRM }, 0.05);
    assert!(between.phase == Phase::Yielding && between.offset_rad < yielding.offset_rad);
    let calm = run(&gains, between, FIRM, 5.0);
    assert_eq!((calm.phase, calm.offset_rad), (Phase::Holding, 0.0));
}

prop_compose! {
    fn any_gains()(
        times in [0.0..0.3_f64, 0.0..0.3_f64, 0.01..1.0_f64, 0.0..1.0_f64],
        slip_share in 0.0..=1.0_f64,
        let_go_rad in 0.0..0.3_f64,
        offsets in [0.0..=0.5_f64, 0.0..=0.5_f64],
        speeds in [0.0..=5.0_f64, 0.0..=5.0_f64, 0.01..=5.0_f64],
        errors in [0.0..=0.5_f64, 0.0..=0.5_f64, 0.0..=0.5_f64],
    ) -> Gains {
        let mut errors = errors;
        errors.sort_by(f64::total_cmp);
        Gains {
            confirm_s: times[0],
            lost_s: times[1],
            slip_share,
            slip_within_s: times[2],
            give_up_s: times[3],
            let_go_rad,
            tighten_rad: offsets[0],
            tighten_rad_per_s: speeds[0],
            calm_error_rad: errors[0],
            tighten_error_rad: errors[1],
            yield_error_rad: errors[2],
            yield_rad: offsets[1],
            yield_rad_per_s: speeds[1],
            return_rad_per_s: speeds[2],
            still_rad_per_s: 0.2,
        }
    }
}

prop_compose! {
    fn any_seen()(
        in_contact in any::<bool>(),
        load in -1.0..5.0_f64,
        error_rad in 0.0..1.0_f64,
        closed_rad in -1.0..2.0_f64,
        turns in 1_usize..40,
    ) -> (DigitSeen, usize) {
        (DigitSeen { in_contact, load, error_rad, closed_rad }, turns)
    }
}

proptest! {
    #[test]
    fn offsets_stay_within_their_limits_and_speeds_and_never_press_harder_than_the_bound(
        gains in any_gains(),
        seen in prop::collection::vec(any_seen(), 1..20),
        dt_s in 0.0..0.02_f64,
    ) {
        let mut state = DigitState::default();
        let fastest = gains.tighten_rad_per_s.max(gains.yield_rad_per_s).max(gains.return_rad_per_s);
        for (seen, turns) in seen {
            for _ in 0..turns {
                let next = step(&gains, &state, &seen, dt_s);
                prop_assert!((-gains.yield_rad..=gains.tighten_rad).contains(&next.offset_rad), "{next:?}");
                prop_assert!((next.offset_rad - state.offset_rad).abs() <= fastest * dt_s + 1e-15);
                if seen.error_rad > gains.tighten_error_rad {
                    prop_assert!(next.offset_rad <= state.offset_rad, "{state:?} {next:?}");
                }
                if seen.error_rad > gains.yield_error_rad {
                    prop_assert_eq!(next.phase, Phase::Yielding);
                }
                state = next;
            }
        }
    }

    #[test]
    fn under_firm_and_gentle_contact_what_was_told_comes_back(
        gains in any_gains(),
        seen in prop::collection::vec(any_seen(), 0..20),
    ) {
        let mut state = DigitState::default();
        for (seen, turns) in seen {
            for _ in 0..turns {
                state = step(&gains, &state, &seen, TURN_S);
            }
        }
        // Long enough for every time and for the slowest way back.
        let firm = DigitSeen { in_contact: true, load: 6.0, error_rad: 0.0, closed_rad: 2.0 };
        let end = run(&gains, state, firm, 3.0 + 1.0 / gains.return_rad_per_s);
        prop_assert_eq!((end.phase, end.offset_rad), (Phase::Holding, 0.0));
    }

    #[test]
    fn where_nothing_is_felt_and_nothing_pressed_nothing_is_added(
        gains in any_gains(),
        closed_rad in prop::collection::vec(-1.0..2.0_f64, 1..100),
    ) {
        let mut state = DigitState::default();
        for closed_rad in closed_rad {
            let seen = DigitSeen { in_contact: false, load: 0.2, error_rad: 0.0, closed_rad };
            state = step(&gains, &state, &seen, TURN_S);
            prop_assert_eq!((state.phase, state.offset_rad), (Phase::Free, 0.0));
        }
    }
}

#[test]
fn what_is_wrong_with_a_configuration_is_named() {
    let (station, text) = (station(), shipped_text());
    let refused = |from: &str, to: &str, expected: &str| {
        assert!(text.contains(from), "{from:?}");
        let said = ReflexConfig::from_toml(&text.replacen(from, to, 1), &station)
            .map_or_else(|problem| problem, |_| "it was taken".to_owned());
        assert!(said.contains(expected), "{expected:?} in {said}");
    };
    refused("tighten_rad = 0.15", "tighten_rad = 1.5", "gains.tighten_rad is 1.5, expected 0 to 1");
    refused("slip_share = 0.4", "slip_share = nan", "gains.slip_share is NaN");
    refused("calm_error_rad = 0.15", "calm_error_rad = 0.25", "expected each no smaller than the one before");
    refused("lost_s = 0.03", "", "missing field `lost_s`");
    refused("lost_s = 0.03", "lost_s = 0.03\nstrength = 1", "unknown field `strength`");
    refused("groups = [\"ring\"]", "groups = [\"toe\"]", "no patch of the layout is in the group \"toe\"");
    refused("groups = [\"ring\"]", "groups = []", "groups is empty");
    refused("ring_pip = 0.5", "ring_pop = 0.5", "the station has no joint \"ring_pop\"");
    refused("ring_pip = 0.5", "joint3 = 0.5", "\"joint3\" is no joint of a finger");
    refused("ring_pip = 0.5", "index_pip = 0.5", "digits \"index\" and \"ring\" move the same joint");
    refused("ring_pip = 0.5", "ring_pip = 0", "closing.ring_pip is 0, expected -1 to 1 and not 0");
    let long = format!("{text}{}", "#".repeat(20_000));
    assert!(ReflexConfig::from_toml(&long, &station).is_err_and(|problem| problem.contains("bytes")));
}
