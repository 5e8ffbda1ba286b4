//! Generalised advantage estimation (Schulman et al. 2016).

/// One step of one environment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Transition {
    /// What the step earned.
    pub reward: f64,
    /// The critic's guess before the step.
    pub value: f64,
    /// The critic's guess after the step: of the next state, of the last state of a truncated episode, or 0 after a
    /// terminated one.
    pub next_value: f64,
    /// Whether the episode ended with this step.
    pub ended: bool,
}

/// Discounts of an estimate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gae {
    /// gamma, in 0..=1: what a reward is worth one step later.
    pub discount: f64,
    /// lambda, in 0..=1: 0 believes the critic after one step (least variance), 1 only the rewards (least bias).
    pub lambda: f64,
}

impl Gae {
    /// Advantage of every transition of one environment, in order of time:
    ///
    /// `A_t = sum_k (gamma lambda)^k delta_(t+k)`, `delta_t = r_t + gamma V_(t+1) - V_t`, the sum ending with the episode.
    /// The last transition's `next_value` stands for what comes after the rollout.
    pub fn advantages(&self, transitions: &[Transition]) -> Vec<f64> {
        let mut advantages = vec![0.0; transitions.len()];
        let mut later = 0.0;
        for (advantage, step) in advantages.iter_mut().zip(transitions).rev() {
            if step.ended {
                later = 0.0;
            }
            let surprise = step.reward + self.discount * step.next_value - step.value;
            later = surprise + self.discount * self.lambda * later;
            *advantage = later;
        }
        advantages
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn step(reward: f64, value: f64, next_value: f64, ended: bool) -> Transition {
        Transition { reward, value, next_value, ended }
    }

    #[test]
    fn advantages_worked_by_hand() {
        // gamma 1/2, lambda 1/2, so each later surprise counts a quarter.
        // Surprises: 1 + 4/2 - 2 = 1; 0 + 6/2 - 4 = -1; 2 + 0 - 6 = -4 (terminated);
        //            3 + 8/2 - 5 = 2 (truncated at a state worth 8); 1 + 2/2 - 1 = 1.
        let steps = [
            step(1.0, 2.0, 4.0, false),
            step(0.0, 4.0, 6.0, false),
            step(2.0, 6.0, 0.0, true),
            step(3.0, 5.0, 8.0, true),
            step(1.0, 1.0, 2.0, false),
        ];
        let gae = Gae { discount: 0.5, lambda: 0.5 };
        assert_eq!(gae.advantages(&steps), [1.0 + (-1.0 + -4.0 / 4.0) / 4.0, -2.0, -4.0, 2.0, 1.0]);
    }

    fn episode() -> impl Strategy<Value = (Vec<(f64, f64)>, f64, bool, f64)> {
        (proptest::collection::vec((-5.0..5.0, -5.0..5.0), 1..30), -5.0..5.0, proptest::bool::ANY, 0.0..=1.0)
    }

    fn transitions(steps: &[(f64, f64)], after: f64, terminated: bool) -> Vec<Transition> {
        let last = if terminated { 0.0 } else { after };
        let next = steps.iter().skip(1).map(|&(_, value)| value).chain([last]);
        let mut all: Vec<Transition> = steps
            .iter()
            .zip(next)
            .map(|(&(reward, value), next_value)| step(reward, value, next_value, false))
            .collect();
        all.last_mut().expect("a step").ended = true;
        all
    }

    proptest! {
        #[test]
        fn with_lambda_one_it_is_the_return_less_the_value((steps, after, terminated, discount) in episode()) {
            let all = transitions(&steps, after, terminated);
            let advantages = Gae { discount, lambda: 1.0 }.advantages(&all);
            let mut earned = all[all.len() - 1].next_value;
            for (at, transition) in all.iter().enumerate().rev() {
                earned = transition.reward + discount * earned;
                prop_assert!((advantages[at] - (earned - transition.value)).abs() < 1e-9);
            }
        }

        #[test]
        fn with_lambda_zero_it_is_the_surprise_of_one_step((steps, after, terminated, discount) in episode()) {
            let all = transitions(&steps, after, terminated);
            let advantages = Gae { discount, lambda: 0.0 }.advantages(&all);
            for (advantage, t) in advantages.iter().zip(&all) {
                prop_assert!((advantage - (t.reward + discount * t.next_value - t.value)).abs() < 1e-12);
            }
        }

        #[test]
        fn an_episode_does_not_see_what_follows_it((steps, after, terminated, discount) in episode(), next in -5.0..5.0) {
            let gae = Gae { discount, lambda: 0.9 };
            let alone = transitions(&steps, after, terminated);
            let mut followed = alone.clone();
            followed.push(step(next, next, next, false));
            prop_assert_eq!(&gae.advantages(&alone)[..], &gae.advantages(&followed)[..alone.len()]);
        }
    }
}
