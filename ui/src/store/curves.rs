//! The curves of a job: numbers that it tells from step to step.

use std::collections::BTreeMap;

/// What people look at first.
const FIRST: &[&str] = &[
    "recent_success_rate",
    "success_rate",
    "return_mean",
    "loss",
    "held_out_loss",
    "check_score",
    "mean_score",
];
/// Numbers over steps, by name.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct Curves(BTreeMap<String, Vec<(f64, f64)>>);

impl Curves {
    /// From a JSON object a line. Lines that are none are left out; of a step that comes twice, because an attempt went
    /// on from a checkpoint, the last one counts.
    pub fn parse(text: &str) -> Self {
        let mut curves: BTreeMap<String, BTreeMap<u64, (f64, f64)>> = BTreeMap::new();
        for line in text.lines() {
            let Ok(point) = serde_json::from_str::<BTreeMap<String, serde_json::Value>>(line) else {
                continue;
            };
            let Some(step) = point.get("step").and_then(serde_json::Value::as_f64) else { continue };
            for (name, value) in point.iter().filter(|(name, _)| *name != "step") {
                if let Some(value) = value.as_f64().filter(|value| value.is_finite()) {
                    curves.entry(name.clone()).or_default().insert(step.max(0.0) as u64, (step, value));
                }
            }
        }
        Self(curves.into_iter().map(|(name, points)| (name, points.into_values().collect())).collect())
    }

    /// Names, those that people look at first in front.
    pub fn names(&self) -> Vec<&str> {
        let mut names: Vec<&str> = self.0.keys().map(String::as_str).collect();
        names
            .sort_by_key(|name| (FIRST.iter().position(|first| first == name).unwrap_or(FIRST.len()), *name));
        names
    }

    /// Step and value of each point of the curve `name`.
    pub fn points(&self, name: &str) -> Option<&[(f64, f64)]> {
        self.0.get(name).map(Vec::as_slice)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn curves_are_read_by_name_and_the_last_of_a_step_counts() {
        let text = "{\"step\":1,\"loss\":4.0,\"kl\":0.1}\nno point\n{\"loss\":9}\n{\"step\":2,\"loss\":3.0,\"label\":\"x\"}\n\
            {\"step\":1,\"loss\":5.0}\n{\"step\":3";
        let curves = Curves::parse(text);
        assert_eq!(curves.names(), ["loss", "kl"]);
        assert_eq!(curves.0["loss"], [(1.0, 5.0), (2.0, 3.0)]);
        assert_eq!(Curves::parse(""), Curves::default());
    }
}
