use proptest::prelude::*;

use super::*;
use crate::reflex::tests::{shipped, station};

const TURN_NS: u64 = 5_000_000;

/// A hand before a reflex: what it feels, where its joints are, and what is in force.
struct Hand {
    station: Station,
    reflex: Reflex,
    now_ns: u64,
    readings: Vec<Option<Reading>>,
    joints: Vec<Option<JointReading>>,
    /// What the safety layer aims at.
    in_force: Vec<Option<f64>>,
    told: Vec<f64>,
}

impl Hand {
    fn new() -> Self {
        let station = station();
        let num_dofs = station.robot.num_dofs();
        let config = shipped(&station);
        let told: Vec<f64> =
            station.safety.joints.iter().map(|limits| 0.5 * (limits.lower + limits.upper)).collect();
        let nothing = Reading { raw: 0.0, reference: 0.0, active: false };
        let mut hand = Self {
            reflex: Reflex::new(Lease(1), config, num_dofs),
            now_ns: 0,
            readings: vec![Some(nothing); station.layout.num_channels()],
            joints: vec![None; num_dofs],
            in_force: vec![None; num_dofs],
            told: told.clone(),
            station,
        };
        hand.tell(&told);
        hand.follow();
        hand
    }

    /// Whoever has control tells all joints where to go.
    fn tell(&mut self, positions: &[f64]) {
        let dofs: Vec<u32> = (0..positions.len() as u32).collect();
        self.reflex.told(&dofs, positions);
        self.told = positions.to_vec();
        self.in_force = positions.iter().copied().map(Some).collect();
    }

    /// Joints are where they are commanded to be.
    fn follow(&mut self) {
        self.joints = self
            .in_force
            .iter()
            .zip(&self.told)
            .map(|(in_force, told)| {
                let position = in_force.unwrap_or(*told);
                Some(JointReading {
                    position,
                    velocity: 0.0,
                    torque_on: Some(true),
                    received_ns: self.now_ns,
                })
            })
            .collect();
    }

    fn feel(&mut self, group: &str, raw: f32, active: bool) {
        for patch in self.station.layout.patches.iter().filter(|patch| patch.group == group) {
            for channel in patch.channels.clone() {
                self.readings[channel] = Some(Reading { raw, reference: 0.0, active });
            }
        }
    }

    /// One turn; the targets that it sent, which are in force from then on.
    fn turn(&mut self) -> Vec<(usize, f64)> {
        self.now_ns += TURN_NS;
        let commanded: Vec<f64> =
            self.in_force.iter().zip(&self.told).map(|(in_force, told)| in_force.unwrap_or(*told)).collect();
        let now = Now {
            now_ns: self.now_ns,
            readings: &self.readings,
            joints: &self.joints,
            commanded: &commanded,
        };
        let in_force = self.in_force.clone();
        let targets = self.reflex.turn(&self.station, &now, |dof| in_force[dof]);
        for &(dof, target) in &targets {
            self.in_force[dof] = Some(target);
        }
        targets
    }

    fn dof(&self, joint: &str) -> usize {
        self.station.robot.dofs().position(|known| known.name == joint).expect("the joint is known")
    }
}

#[test]
fn a_digit_that_loses_contact_closes_and_no_other_joint_is_told_anything() {
    let mut hand = Hand::new();
    hand.feel("index", 400.0, true);
    for _ in 0..20 {
        assert_eq!(hand.turn(), [], "contact is firm");
    }
    hand.feel("index", 0.0, false);
    for _ in 0..60 {
        hand.turn();
        hand.follow();
    }
    let (index, told) = (hand.dof("index_mcp_forward"), hand.told.clone());
    let moved: Vec<usize> = (0..told.len()).filter(|&dof| hand.in_force[dof] != Some(told[dof])).collect();
    assert_eq!(moved, ["index_mcp_forward", "index_pip", "index_dip"].map(|joint| hand.dof(joint)));
    assert!(hand.in_force[index].expect("a target") > told[index] + 0.1);
    // Firm again: what was told is in force again, to the bit.
    hand.feel("index", 400.0, true);
    for _ in 0..1000 {
        hand.turn();
        hand.follow();
    }
    assert_eq!(hand.in_force, told.into_iter().map(Some).collect::<Vec<_>>());
}

#[test]
fn new_targets_are_followed_with_the_offset_on_top() {
    let mut hand = Hand::new();
    hand.feel("index", 400.0, true);
    (0..20).for_each(|_| drop(hand.turn()));
    hand.feel("index", 0.0, false);
    (0..40).for_each(|_| drop(hand.turn()));
    let index = hand.dof("index_mcp_forward");
    let offset = hand.in_force[index].expect("a target") - hand.told[index];
    assert!(offset > 0.05);
    let mut told = hand.told.clone();
    told[index] += 0.02;
    hand.tell(&told);
    hand.turn();
    let again = hand.in_force[index].expect("a target") - told[index];
    assert!((again - offset).abs() < 0.01, "{again} after {offset}");
}

#[test]
fn a_joint_that_is_stopped_far_from_its_target_yields() {
    let mut hand = Hand::new();
    let pip = hand.dof("index_pip");
    let stuck_rad = hand.told[pip] - 0.5;
    for _ in 0..20 {
        hand.follow();
        let reading = hand.joints[pip].as_mut().expect("a reading");
        reading.position = stuck_rad;
        hand.turn();
    }
    assert!(hand.in_force[pip].expect("a target") < hand.told[pip] - 0.04);
    // One that is as far behind and moves is none.
    let mut moving = Hand::new();
    for _ in 0..20 {
        moving.follow();
        let reading = moving.joints[pip].as_mut().expect("a reading");
        (reading.position, reading.velocity) = (stuck_rad, 2.0);
        assert_eq!(moving.turn(), []);
    }
}

#[test]
fn a_silent_board_is_no_lost_contact() {
    let mut hand = Hand::new();
    hand.feel("index", 400.0, true);
    (0..20).for_each(|_| drop(hand.turn()));
    hand.feel("index", 0.0, false);
    let silent = hand.station.layout.patches.iter().find(|patch| patch.group == "index").expect("a patch");
    let channel = silent.channels.start;
    hand.readings[channel] = None;
    for _ in 0..100 {
        assert_eq!(hand.turn(), []);
    }
}

#[test]
fn what_the_safety_layer_forgot_is_not_told_again() {
    let mut hand = Hand::new();
    hand.feel("index", 400.0, true);
    (0..20).for_each(|_| drop(hand.turn()));
    hand.feel("index", 0.0, false);
    assert!((0..20).any(|_| !hand.turn().is_empty()), "it tightens");
    hand.in_force.fill(None);
    for _ in 0..20 {
        assert_eq!(hand.turn(), []);
    }
    // Only one joint is told something new: the rest of its digit stays where it is.
    let pip = hand.dof("index_pip");
    hand.in_force[pip] = Some(0.4);
    hand.reflex.told(&[pip as u32], &[0.4]);
    for _ in 0..20 {
        assert_eq!(hand.turn(), []);
    }
}

prop_compose! {
    fn any_reading()(raw in -500.0_f32..5000.0, active in any::<bool>(), silent in prop::bool::weighted(0.02)) -> Option<Reading> {
        (!silent).then_some(Reading { raw, reference: 0.0, active })
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn whatever_is_felt_targets_stay_within_the_limits(
        readings in prop::collection::vec(prop::collection::vec(any_reading(), 44), 1..8),
        told in prop::collection::vec(prop::collection::vec(0.0..=1.0_f64, 22), 1..8),
        behind in prop::collection::vec(-1.0..1.0_f64, 22),
    ) {
        let mut hand = Hand::new();
        let limits = hand.station.safety.joints.clone();
        let carriers = hand.station.carrier_dofs.clone();
        for (readings, shares) in readings.into_iter().zip(told) {
            let told: Vec<f64> = shares.iter().zip(&limits).map(|(share, limits)| limits.lower + share * (limits.upper - limits.lower)).collect();
            hand.tell(&told);
            hand.readings = readings;
            for _ in 0..30 {
                hand.follow();
                for (joint, behind) in hand.joints.iter_mut().flatten().zip(&behind) {
                    joint.position -= behind;
                }
                for (dof, target) in hand.turn() {
                    prop_assert!((limits[dof].lower..=limits[dof].upper).contains(&target), "{dof} {target}");
                    prop_assert!(!carriers.contains(&dof));
                }
            }
        }
    }

    #[test]
    fn a_hand_that_feels_nothing_and_follows_is_told_nothing(told in prop::collection::vec(prop::collection::vec(0.0..=1.0_f64, 22), 1..20)) {
        let mut hand = Hand::new();
        let limits = hand.station.safety.joints.clone();
        for shares in told {
            let told: Vec<f64> = shares.iter().zip(&limits).map(|(share, limits)| limits.lower + share * (limits.upper - limits.lower)).collect();
            hand.tell(&told);
            for _ in 0..10 {
                hand.follow();
                prop_assert_eq!(hand.turn(), []);
            }
        }
    }
}
