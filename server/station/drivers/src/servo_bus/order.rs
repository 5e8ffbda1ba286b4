//! What the newest goal means for the motors now: the decision, without the bytes.

use crate::context::Goal;

/// What the servos shall do in this cycle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Order<'a> {
    /// No torque.
    Limp,
    /// Torque where the joints are, then this goal.
    Follow(&'a Goal),
    /// Torque, and no new goal.
    Hold,
}

/// Decides, and remembers what must not start again by itself.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Decider {
    hold_ns: u64,
    /// Torque went off for another reason than a goal, so a goal without torque has to come before the next one with
    /// torque: whoever commands has then seen that the joints are limp, and where they are.
    needs_disarming: bool,
    /// [`Goal::disarms`] of the goal that was looked at last.
    disarms: u64,
}

impl Decider {
    /// Joints are held for `hold_ns` once goals have dried up. A goal without torque has to come after the first `disarms`.
    pub(crate) fn new(hold_ns: u64, disarms: u64) -> Self {
        Self { hold_ns, needs_disarming: true, disarms }
    }

    /// What to do at `now_ns`, with motors `armed` or not.
    pub(crate) fn decide<'a>(&mut self, goal: Option<&'a Goal>, armed: bool, now_ns: u64) -> Order<'a> {
        let Some(goal) = goal else { return Order::Limp };
        let is_valid = now_ns < goal.valid_until_ns;
        if std::mem::replace(&mut self.disarms, goal.disarms) < goal.disarms && goal.torque {
            // One without torque came and went since the last look.
            self.needs_disarming = false;
        }
        if !goal.torque {
            if is_valid {
                self.needs_disarming = false;
            }
            return Order::Limp;
        }
        if is_valid && !self.needs_disarming {
            return Order::Follow(goal);
        }
        if armed && now_ns < goal.valid_until_ns.saturating_add(self.hold_ns) && !self.needs_disarming {
            return Order::Hold;
        }
        if armed {
            self.needs_disarming = true;
        }
        Order::Limp
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn goal(torque: bool, valid_until_ns: u64) -> Goal {
        Goal { torque, lead_through: false, positions: [0.0].into(), valid_until_ns, disarms: 0 }
    }

    fn ready() -> Decider {
        let mut decider = Decider::new(50, 0);
        assert_eq!(decider.decide(Some(&goal(false, 10)), false, 0), Order::Limp);
        decider
    }

    #[test]
    fn goals_that_dry_up_are_held_then_the_joints_go_limp_and_stay_so() {
        let mut decider = ready();
        let newest = goal(true, 100);
        assert_eq!(decider.decide(Some(&newest), false, 10), Order::Follow(&newest));
        assert_eq!(decider.decide(Some(&newest), true, 99), Order::Follow(&newest));
        assert_eq!(decider.decide(Some(&newest), true, 100), Order::Hold);
        assert_eq!(decider.decide(Some(&newest), true, 149), Order::Hold);
        assert_eq!(decider.decide(Some(&newest), true, 150), Order::Limp);
        // Whoever commands comes back to life: not before it has seen that the joints are limp.
        let next = goal(true, 400);
        assert_eq!(decider.decide(Some(&next), false, 200), Order::Limp);
        assert_eq!(decider.decide(Some(&goal(false, 500)), false, 250), Order::Limp);
        let next = goal(true, 600);
        assert_eq!(decider.decide(Some(&next), false, 300), Order::Follow(&next));
    }

    #[test]
    fn nothing_moves_without_a_goal_or_before_one_without_torque() {
        let mut decider = Decider::new(50, 0);
        assert_eq!(decider.decide(None, false, 0), Order::Limp);
        assert_eq!(decider.decide(Some(&goal(true, 100)), false, 1), Order::Limp);
        assert_eq!(decider.decide(None, true, 0), Order::Limp);
        // One that is no longer valid does not count.
        assert_eq!(decider.decide(Some(&goal(false, 1)), false, 2), Order::Limp);
        assert_eq!(decider.decide(Some(&goal(true, 100)), false, 3), Order::Limp);
    }

    #[test]
    fn a_goal_without_torque_counts_though_the_next_one_came_before_it_was_seen() {
        // The slot counts one without torque before the first with torque.
        let armed = |disarms, valid_until_ns| Goal { disarms, ..goal(true, valid_until_ns) };
        let mut decider = Decider::new(50, 0);
        assert_eq!(decider.decide(Some(&armed(1, 100)), false, 1), Order::Follow(&armed(1, 100)));
        // Goals dry up; the same arming does not count once more, the next one does.
        assert_eq!(decider.decide(Some(&armed(1, 100)), true, 150), Order::Limp);
        assert_eq!(decider.decide(Some(&armed(1, 400)), false, 200), Order::Limp);
        assert_eq!(decider.decide(Some(&armed(2, 400)), false, 201), Order::Follow(&armed(2, 400)));
        // A thread that begins while the motors are on waits for the next arming.
        let mut late = Decider::new(50, 2);
        assert_eq!(late.decide(Some(&armed(2, 400)), false, 202), Order::Limp);
        assert_eq!(late.decide(Some(&armed(3, 400)), false, 203), Order::Follow(&armed(3, 400)));
    }

    #[test]
    fn a_goal_without_torque_counts_even_when_it_is_old() {
        let mut decider = ready();
        assert_eq!(decider.decide(Some(&goal(false, 10)), true, 20), Order::Limp);
        assert_eq!(decider.decide(Some(&goal(true, 10)), false, 20), Order::Limp);
    }
}
