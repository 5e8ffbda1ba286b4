//! From setpoints to the targets that are streamed to the box.
//!
//! In servo mode the box goes to each target at once, as fast as the joints can: speed and acceleration of the command
//! are ignored. What lies between two setpoints is therefore this module's: straight lines from one to the next, along
//! which no joint ever goes further in a tick than its velocity limit allows, and gets faster only gradually.

/// A setpoint is reached after as long as the one before it took to come, within these bounds, ns.
const SHORTEST_SEGMENT_NS: u64 = 5_000_000;
const LONGEST_SEGMENT_NS: u64 = 50_000_000;
/// The most time that one tick may make up for, ns. After a stall the arm goes on, it does not jump.
const LONGEST_TICK_NS: u64 = 10_000_000;
/// After this long without a tick the joints have come to a stand, ns.
const STANDING_NS: u64 = 30_000_000;
/// Setpoints obey the acceleration limit between themselves; each is a small step in velocity here. Making up for what a
/// stall left behind may therefore take this many times the limit, and needs no more.
const ACCELERATION_ROOM: f64 = 4.0;

/// How fast joints may go.
#[derive(Clone, Debug)]
pub(crate) struct Limits {
    /// Velocity of each joint, rad/s.
    pub(crate) rad_per_sec: Vec<f64>,
    /// Acceleration of each joint, rad/s2.
    pub(crate) rad_per_sec2: Vec<f64>,
}

/// Follows setpoints.
#[derive(Clone, Debug)]
pub(crate) struct Follower {
    limits: Limits,
    /// What was commanded last.
    at_rad: Vec<f64>,
    rad_per_sec: Vec<f64>,
    at_ns: u64,
    from_rad: Vec<f64>,
    to_rad: Vec<f64>,
    begun_ns: u64,
    segment_ns: u64,
    /// When the last setpoint came.
    aimed_ns: u64,
}

impl Follower {
    /// Stands at zero until [`Follower::start`].
    pub(crate) fn new(limits: Limits) -> Self {
        let still = vec![0.0; limits.rad_per_sec.len()];
        Self {
            limits,
            at_rad: still.clone(),
            rad_per_sec: still.clone(),
            at_ns: 0,
            from_rad: still.clone(),
            to_rad: still,
            begun_ns: 0,
            segment_ns: SHORTEST_SEGMENT_NS,
            aimed_ns: 0,
        }
    }

    /// Begins anew where the joints are.
    pub(crate) fn start(&mut self, now_ns: u64, joints_rad: &[f64]) {
        self.at_rad.copy_from_slice(joints_rad);
        self.hold(now_ns);
    }

    /// Stands still where it is; the next setpoint is a new beginning.
    pub(crate) fn hold(&mut self, now_ns: u64) {
        self.from_rad.copy_from_slice(&self.at_rad);
        self.to_rad.copy_from_slice(&self.at_rad);
        self.rad_per_sec.fill(0.0);
        (self.at_ns, self.begun_ns, self.aimed_ns) = (now_ns, now_ns, now_ns);
        self.segment_ns = SHORTEST_SEGMENT_NS;
    }

    /// Takes a new setpoint.
    pub(crate) fn aim(&mut self, now_ns: u64, setpoint_rad: &[f64]) {
        let since_last = now_ns.saturating_sub(self.aimed_ns);
        self.segment_ns = since_last.clamp(SHORTEST_SEGMENT_NS, LONGEST_SEGMENT_NS);
        self.aimed_ns = now_ns;
        // The line begins where the last tick ended, so that no tick stands still between two lines.
        self.begun_ns = self.at_ns.max(now_ns.saturating_sub(LONGEST_TICK_NS));
        self.from_rad.copy_from_slice(&self.at_rad);
        self.to_rad.copy_from_slice(setpoint_rad);
    }

    /// Where the joints shall be now.
    pub(crate) fn step(&mut self, now_ns: u64) -> &[f64] {
        let since_ns = now_ns.saturating_sub(self.at_ns);
        let dt_ns = since_ns.min(LONGEST_TICK_NS);
        self.at_ns = now_ns;
        if since_ns > STANDING_NS {
            self.rad_per_sec.fill(0.0);
        }
        if dt_ns == 0 {
            return &self.at_rad;
        }
        let dt_s = dt_ns as f64 * 1e-9;
        let part = (now_ns.saturating_sub(self.begun_ns) as f64 / self.segment_ns as f64).min(1.0);
        for joint in 0..self.at_rad.len() {
            let goal_rad = self.from_rad[joint] + (self.to_rad[joint] - self.from_rad[joint]) * part;
            let wanted = (goal_rad - self.at_rad[joint]) / dt_s;
            // Slowing down is never limited: that would be overshooting.
            let before = self.rad_per_sec[joint];
            let kept = if before * wanted > 0.0 { before.abs() } else { 0.0 };
            let most = (kept + ACCELERATION_ROOM * self.limits.rad_per_sec2[joint] * dt_s)
                .min(self.limits.rad_per_sec[joint]);
            if wanted.abs() <= most {
                self.rad_per_sec[joint] = wanted;
                self.at_rad[joint] = goal_rad;
            } else {
                self.rad_per_sec[joint] = most.copysign(wanted);
                self.at_rad[joint] += self.rad_per_sec[joint] * dt_s;
            }
        }
        &self.at_rad
    }

    /// What was commanded last.
    pub(crate) fn at_rad(&self) -> &[f64] {
        &self.at_rad
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const MS: u64 = 1_000_000;

    fn limits() -> Limits {
        Limits { rad_per_sec: vec![0.6, 1.0], rad_per_sec2: vec![5.0, 10.0] }
    }

    #[test]
    fn setpoints_within_the_limits_are_met_one_setpoint_later() {
        let path = |t_s: f64| [0.1 * (1.0 - (3.0 * t_s).cos()), 0.05 * (1.0 - (2.0 * t_s).cos())];
        let mut follower = Follower::new(limits());
        follower.start(0, &[0.0, 0.0]);
        for ms in (0..4000_u64).step_by(5) {
            if ms % 10 == 0 {
                follower.aim(ms * MS, &path(ms as f64 * 1e-3));
            }
            let at = follower.step(ms * MS).to_vec();
            let expected = path((ms as f64 - 10.0).max(0.0) * 1e-3);
            for (at, expected) in at.iter().zip(expected) {
                assert!((at - expected).abs() < 2e-3, "{ms} ms: {at} against {expected}");
            }
        }
    }

    #[test]
    fn a_stall_is_made_up_for_without_a_jump() {
        let mut follower = Follower::new(limits());
        follower.start(0, &[0.0, 0.0]);
        follower.aim(0, &[1.0, 1.0]);
        follower.step(5 * MS);
        let before = follower.at_rad()[0];
        let after = follower.step(195 * MS)[0];
        assert!(after - before <= 0.6 * 0.010 + 1e-12, "{before} to {after}");
    }

    #[test]
    fn holding_stops_where_it_is_and_the_next_start_is_slow() {
        let mut follower = Follower::new(limits());
        follower.start(0, &[0.0, 0.0]);
        follower.aim(0, &[1.0, 1.0]);
        for ms in (5..500).step_by(5) {
            follower.step(ms * MS);
        }
        follower.hold(500 * MS);
        let held = follower.at_rad()[0];
        assert_eq!(follower.step(505 * MS)[0].to_bits(), held.to_bits());
        follower.aim(510 * MS, &[1.0, 1.0]);
        let first = follower.step(515 * MS)[0] - held;
        assert!(first > 0.0 && first <= 4.0 * 5.0 * 0.010 * 0.010 + 1e-12, "{first}");
    }

    proptest! {
        #[test]
        fn no_step_is_longer_than_the_limit_and_none_overshoots(
            jumps in prop::collection::vec((0_u64..60, -3.0..3.0_f64, -3.0..3.0_f64), 1..40),
            ticks in prop::collection::vec(1_u64..30, 40..200),
        ) {
            let mut follower = Follower::new(limits());
            follower.start(0, &[0.0, 0.0]);
            let (mut now_ns, mut jumps) = (0, jumps.into_iter());
            let mut reach = [(0.0_f64, 0.0_f64); 2];
            let mut next_ns = 0;
            for tick_ms in ticks {
                now_ns += tick_ms * MS;
                if now_ns >= next_ns && let Some((wait_ms, a, b)) = jumps.next() {
                    follower.aim(now_ns, &[a, b]);
                    next_ns = now_ns + wait_ms * MS;
                    for (reach, to) in reach.iter_mut().zip([a, b]) {
                        *reach = (reach.0.min(to), reach.1.max(to));
                    }
                }
                let before = follower.at_rad().to_vec();
                let after = follower.step(now_ns).to_vec();
                for joint in 0..2 {
                    let most = limits().rad_per_sec[joint] * (tick_ms.min(10) as f64 * 1e-3);
                    prop_assert!((after[joint] - before[joint]).abs() <= most + 1e-12);
                    prop_assert!(after[joint] >= reach[joint].0 - 1e-12 && after[joint] <= reach[joint].1 + 1e-12);
                }
            }
        }
    }
}
