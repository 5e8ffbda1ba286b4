//! What a step is worth, term by term.

use super::RewardConfig;

/// Names of the terms, in their order. The reward is their sum.
pub const REWARD_TERMS: [&str; 7] = ["tips", "grasp", "lift", "action", "table", "success", "stop"];

/// What a step's reward is made from.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Facts<'a> {
    /// Distance of each digit's tip to the object's surface, m; negative inside.
    pub tip_distances_m: &'a [f64],
    /// Whether the opposing digit and two others touch the object.
    pub grasped: bool,
    /// How far the object is above where it began, m.
    pub lift_m: f64,
    /// The action, each number within -1 to 1.
    pub action: &'a [f64],
    /// Whether the robot touches the table.
    pub on_table: bool,
    /// Whether the episode ended with a success.
    pub success: bool,
    /// Whether it ended with an emergency stop.
    pub stopped: bool,
}

impl RewardConfig {
    /// The terms of one step.
    pub fn terms(&self, facts: &Facts<'_>) -> [f64; REWARD_TERMS.len()] {
        let mean = |sum: f64, count: usize| if count == 0 { 0.0 } else { sum / count as f64 };
        let near = |distance_m: &f64| (-distance_m.max(0.0) / self.tip_distance_m).exp();
        let tips = mean(facts.tip_distances_m.iter().map(near).sum(), facts.tip_distances_m.len());
        let effort = mean(facts.action.iter().map(|a| a * a).sum(), facts.action.len());
        let lifted = (facts.lift_m / self.lift_at_m).clamp(0.0, 1.0);
        let held = if facts.grasped { 1.0 } else { self.lift_without_grasp };
        let when = |so: bool| f64::from(u8::from(so));
        [
            self.tips * tips,
            self.grasp * when(facts.grasped),
            self.lift * lifted * held,
            -self.action * effort,
            -self.table * when(facts.on_table),
            self.success * when(facts.success),
            -self.stop * when(facts.stopped),
        ]
        .map(|term| self.scale * term)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CONFIG: RewardConfig = RewardConfig {
        scale: 0.1,
        tips: 0.1,
        tip_distance_m: 0.05,
        grasp: 0.15,
        lift: 1.0,
        lift_at_m: 0.05,
        lift_without_grasp: 0.3,
        action: 0.03,
        table: 0.05,
        success: 10.0,
        stop: 5.0,
    };

    fn term(name: &str, facts: &Facts<'_>) -> f64 {
        let at = REWARD_TERMS.iter().position(|term| *term == name).expect("a term");
        CONFIG.terms(facts)[at]
    }

    #[test]
    fn each_term_answers_to_its_own_fact_and_to_no_other() {
        let nothing = Facts { tip_distances_m: &[1e3, 1e3], action: &[0.0, 0.0], ..Facts::default() };
        assert!(CONFIG.terms(&nothing).iter().all(|term| term.abs() < 1e-12));
        let cases: [(&str, Facts<'_>, f64); 7] = [
            ("tips", Facts { tip_distances_m: &[-0.001, 1e3], ..nothing.clone() }, 0.005),
            ("grasp", Facts { grasped: true, ..nothing.clone() }, 0.015),
            ("lift", Facts { lift_m: 0.025, ..nothing.clone() }, 0.015),
            ("action", Facts { action: &[1.0, 0.0], ..nothing.clone() }, -0.0015),
            ("table", Facts { on_table: true, ..nothing.clone() }, -0.005),
            ("success", Facts { success: true, ..nothing.clone() }, 1.0),
            ("stop", Facts { stopped: true, ..nothing.clone() }, -0.5),
        ];
        for (name, facts, expected) in cases {
            for (other, value) in REWARD_TERMS.iter().zip(CONFIG.terms(&facts)) {
                let expected = if *other == name { expected } else { 0.0 };
                assert!((value - expected).abs() < 1e-12, "{other} with {name}: {value}");
            }
        }
        // A lift is worth more in a grasp, and no more than at its full height.
        let held = Facts { lift_m: 0.5, grasped: true, ..nothing };
        assert!((term("lift", &held) - 0.1).abs() < 1e-12);
    }
}
