//! The motion of one joint towards its target, within its limits of speed and acceleration.

use palpate_robot_model::JointSafety;

/// Nearer to its target than this a joint has arrived, rad or m.
const ARRIVED: f64 = 1e-9;

/// What a joint is commanded to do.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Motion {
    pub(crate) position: f64,
    /// Of the last step, per s.
    pub(crate) velocity: f64,
}

impl Motion {
    /// Where it comes to rest if it brakes from now on.
    pub(crate) fn stop_position(&self, limits: &JointSafety) -> f64 {
        self.position + self.velocity * self.velocity.abs() / (2.0 * limits.acceleration)
    }

    /// The next step of `dt_s`, towards `target` or to rest without one, no faster than `velocity`.
    ///
    /// A step moves at one speed v for its whole length. From a distance d the largest v after which braking at a comes to
    /// rest in time satisfies v dt + v² / (2 a) <= d. Later steps may have any length: braking in steps never goes
    /// further than braking at every instant, because each step's speed is that of its end.
    pub(crate) fn step(&self, target: Option<f64>, limits: &JointSafety, velocity: f64, dt_s: f64) -> Self {
        if dt_s <= 0.0 {
            return *self;
        }
        let wanted = target.map_or(0.0, |target| {
            let distance = target - self.position;
            if distance.abs() <= ARRIVED {
                return 0.0;
            }
            // The root of the quadratic above in the form that does not cancel.
            let in_time = 2.0 * distance.abs()
                / (dt_s + (dt_s * dt_s + 2.0 * distance.abs() / limits.acceleration).sqrt());
            in_time.min(velocity).copysign(distance)
        });
        let change = limits.acceleration * dt_s;
        let velocity = wanted.clamp(self.velocity - change, self.velocity + change);
        // A joint that was found outside its limits may stay there, but not go further.
        let (lower, upper) = (limits.lower.min(self.position), limits.upper.max(self.position));
        let position = (self.position + velocity * dt_s).clamp(lower, upper);
        Self { position, velocity }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const LIMITS: JointSafety = JointSafety { lower: -1.0, upper: 1.5, velocity: 3.0, acceleration: 40.0 };

    #[test]
    fn a_joint_arrives_in_the_time_of_the_trapezoid() {
        let (mut motion, mut time_s, dt_s) = (Motion::default(), 0.0, 0.001);
        while (motion.position - 1.5).abs() > 1e-6 {
            motion = motion.step(Some(1.5), &LIMITS, LIMITS.velocity, dt_s);
            time_s += dt_s;
            assert!(time_s < 2.0, "{motion:?}");
        }
        // 1.5 rad at 3 rad/s, with 3 / 40 s more for getting up to speed and down again.
        assert!((0.57..0.60).contains(&time_s), "{time_s} s");
        for _ in 0..5 {
            motion = motion.step(Some(1.5), &LIMITS, LIMITS.velocity, dt_s);
        }
        assert_eq!(motion.velocity, 0.0);
    }

    #[test]
    fn without_a_target_a_joint_brakes_to_rest_where_it_can() {
        let mut motion = Motion { position: 0.0, velocity: 2.0 };
        let stop = motion.stop_position(&LIMITS);
        for _ in 0..6 {
            motion = motion.step(None, &LIMITS, LIMITS.velocity, 0.01);
        }
        assert_eq!(motion.velocity, 0.0);
        assert!(motion.position <= stop && motion.position > 0.0, "{motion:?}, {stop}");
    }

    proptest! {
        #[test]
        fn steps_of_any_length_stay_within_all_limits(
            steps in prop::collection::vec((prop::option::of(-1.0..=1.5), 1e-6..0.15), 1..200),
        ) {
            let mut motion = Motion::default();
            for (target, dt_s) in steps {
                let next = motion.step(target, &LIMITS, LIMITS.velocity, dt_s);
                prop_assert!(next.velocity.abs() <= LIMITS.velocity);
                prop_assert!((next.velocity - motion.velocity).abs() <= LIMITS.acceleration * dt_s * (1.0 + 1e-12) + 1e-15);
                // The step is what the speed says: the clamp of positions takes away rounding only.
                prop_assert!((next.position - motion.position - next.velocity * dt_s).abs() < 1e-12);
                let stop = next.stop_position(&LIMITS);
                prop_assert!((LIMITS.lower - 1e-12..=LIMITS.upper + 1e-12).contains(&stop), "{:?}", next);
                motion = next;
            }
        }
    }
}
