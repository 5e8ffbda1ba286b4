use std::collections::BTreeMap;

use palpate_robot_model::Place;

use super::*;

/// A motion that shows every effect: a swing to both sides, steps, and a drop with the torque off.
struct Motion {
    times_s: Vec<f64>,
    goals_rad: Vec<f64>,
    torque_on: Vec<bool>,
}

impl Motion {
    fn new() -> Self {
        let times_s: Vec<f64> = (0..1200).map(|idx| 0.005 * f64::from(idx)).collect();
        let goal = |&time_s: &f64| match time_s {
            0.0..2.0 => 1.2 * (2.5 * time_s).sin(),
            2.0..3.0 => 0.8,
            3.0..4.0 => -0.9,
            _ => 1.4,
        };
        Self {
            goals_rad: times_s.iter().map(goal).collect(),
            torque_on: times_s.iter().map(|&time_s| time_s < 4.6).collect(),
            times_s,
        }
    }

    fn drive(&self) -> Drive<'_> {
        Drive {
            times_s: &self.times_s,
            goals_rad: &self.goals_rad,
            torque_on: &self.torque_on,
            gain_per_rad: 1.15,
            supply_v: 7.4,
            mass_kg: 0.49,
            length_m: 0.1,
        }
    }

    fn run(&self, effects: &[Effect]) -> Vec<Sensed> {
        let mut plant = Plant::default();
        plant.add(effects).expect("effects of the library");
        rollout(&plant, &self.drive(), START, self.times_s.len())
    }
}

const START: Start =
    Start { sample: 0, position_rad: 0.0, speed_rad_per_s: 0.0, acceleration_rad_per_s2: 0.0 };

fn effect(kind: &dyn ActuatorEffect, parameters: impl IntoIterator<Item = (String, f64)>) -> Effect {
    Effect {
        id: kind.id().to_owned(),
        place: Place::Joint("joint".to_owned()),
        parameters: parameters.into_iter().collect(),
        interval: BTreeMap::new(),
        takes: Vec::new(),
    }
}

/// `kind` with its first parameter at `size`.
fn sized(kind: &dyn ActuatorEffect, size: f64) -> Effect {
    let neutral = kind.parameters().into_iter().map(|p| (p.name, p.neutral));
    let mut effect = effect(kind, neutral);
    effect.parameters.insert(kind.parameters()[0].name.clone(), size);
    effect
}

/// Squared distance, each signal in units of what a servo resolves.
fn distance(a: &[Sensed], b: &[Sensed]) -> f64 {
    let square = |(a, b): (&Sensed, &Sensed)| {
        ((a.position_rad - b.position_rad) / 1.5e-3).powi(2)
            + ((a.duty - b.duty) / 0.01).powi(2)
            + ((a.supply_v - b.supply_v) / 0.1).powi(2)
            + ((a.carry - b.carry) / 0.3).powi(2)
    };
    a.iter().zip(b).map(square).sum()
}

#[test]
fn effects_at_rest_change_nothing() {
    let motion = Motion::new();
    let bare = motion.run(&[]);
    for kind in ACTUATOR {
        assert_eq!(motion.run(&[sized(*kind, 0.0)]), bare, "{}", kind.id());
    }
}

#[test]
fn every_effect_is_recovered_at_three_strengths_from_quantised_positions() {
    let motion = Motion::new();
    for kind in ACTUATOR {
        let parameter = &kind.parameters()[0];
        for strength in [1.0, 2.0, 4.0] {
            let hidden = (strength * parameter.dose).min(parameter.upper);
            let mut measured = motion.run(&[sized(*kind, hidden)]);
            for sensed in &mut measured {
                let count_rad = std::f64::consts::TAU / 4096.0;
                sensed.position_rad = (sensed.position_rad / count_rad).round() * count_rad;
            }
            // A search that knows nothing of derivatives: ever finer grids around the best.
            let (mut centre, mut width) = (parameter.neutral, 6.0 * parameter.dose);
            for _ in 0..12 {
                let sizes = (-5..=5).map(|idx| centre + width * f64::from(idx) / 5.0);
                centre = sizes
                    .map(|size| size.clamp(parameter.lower, parameter.upper))
                    .map(|size| (distance(&measured, &motion.run(&[sized(*kind, size)])), size))
                    .min_by(|a, b| a.0.total_cmp(&b.0))
                    .expect("sizes to try")
                    .1;
                width *= 0.45;
            }
            let off = (centre - hidden).abs();
            assert!(off < 0.1 * hidden, "{}: {hidden} was hidden and {centre} found", kind.id());
        }
    }
}

#[test]
fn effects_compose_in_any_order() {
    let motion = Motion::new();
    let all: Vec<Effect> = ACTUATOR.iter().map(|kind| sized(*kind, kind.parameters()[0].dose)).collect();
    let reversed: Vec<Effect> = all.iter().rev().cloned().collect();
    assert!(distance(&motion.run(&all), &motion.run(&reversed)) < 1e-9);
    assert!(motion.run(&all).iter().all(|sensed| sensed.position_rad.is_finite()));
}

#[test]
fn a_servo_without_friction_keeps_its_energy_with_the_torque_off() {
    let motion = Motion::new();
    let off = vec![false; motion.times_s.len()];
    let drive = Drive { torque_on: &off, ..motion.drive() };
    let start = Start { position_rad: 1.0, ..START };
    let path = rollout(&Plant::default(), &drive, start, motion.times_s.len());
    let highest = path[600..].iter().map(|sensed| sensed.position_rad).fold(f64::MIN, f64::max);
    assert!((highest - 1.0).abs() < 0.01, "it swings as high as it started: {highest}");
}

#[test]
fn dry_friction_holds_without_creep_or_chatter() {
    let motion = Motion::new();
    let off = vec![false; motion.times_s.len()];
    let drive = Drive { torque_on: &off, ..motion.drive() };
    let plant = Plant { coulomb_nm: 0.05, ..Plant::default() };
    // m g l sin(0.1) = 0.048 N m is held, 0.06 N m is not.
    let held = rollout(&plant, &drive, Start { position_rad: 0.1, ..START }, motion.times_s.len());
    assert!(held.iter().all(|sensed| sensed.position_rad == 0.1));
    let falls = rollout(&plant, &drive, Start { position_rad: 0.13, ..START }, motion.times_s.len());
    assert!(falls[falls.len() - 1].position_rad < 0.12);
}

#[test]
fn every_effect_says_what_it_is_and_how_large() {
    for kind in ACTUATOR {
        let parameters = kind.parameters();
        let sentence = kind.explain(&sized(*kind, parameters[0].dose));
        assert!(sentence.ends_with('.') && sentence.contains(|c: char| c.is_ascii_digit()), "{sentence}");
        assert!(!kind.signature().is_empty());
        assert_eq!(actuator(kind.id()).map(|found| found.id()), Some(kind.id()));
        for parameter in parameters {
            assert!(
                parameter.lower <= parameter.neutral && parameter.neutral + parameter.dose <= parameter.upper
            );
        }
    }
    let unknown = effect(&gain_error::GainError, []);
    let unknown = Effect { id: "rust".to_owned(), ..unknown };
    assert_eq!(Plant::default().add(&[unknown]), Err("rust".to_owned()));
}
