//! The page about plans says all that the reader knows: fields are those that serde lists.

use palpate_motion::Plan;

const PAGE: &str = include_str!("../../../../docs/plans.md");
const PLAN: &str = include_str!("../../../../assets/plans/nine_takes.toml");

fn example() -> &'static str {
    PAGE.split("```toml\n").nth(1).and_then(|rest| rest.split("```").next()).expect("an example")
}

/// The fields that the reader would take in the table where `key` stands first.
fn fields_beside(text: &str, key: &str) -> Vec<String> {
    let key = format!("\n{key} = ");
    assert!(text.contains(&key), "{key:?}");
    let wrong = text.replacen(&key, &format!("\nno_such_field = 1{key}"), 1);
    let error = Plan::from_text("p.toml", &wrong).expect_err("an unknown key").to_string();
    let listed = error.split("expected").nth(1).unwrap_or_default();
    listed.split('`').skip(1).step_by(2).map(str::to_owned).collect()
}

#[test]
fn every_field_of_a_plan_is_on_the_page() {
    let mut num_fields = 0;
    for key in ["seed", "speed_fraction", "depth_m", "press_m_per_s", "touch"] {
        let fields = fields_beside(PLAN, key);
        assert!(fields.len() >= 3, "beside {key}: {fields:?}");
        for field in &fields {
            assert!(PAGE.contains(&format!("`{field}`")), "docs/plans.md does not mention `{field}`");
        }
        num_fields += fields.len();
    }
    assert!(num_fields > 30, "{num_fields}");
}

#[test]
fn the_example_on_the_page_is_read() {
    let plan = Plan::from_text("taps.toml", example()).unwrap();
    assert_eq!((plan.takes.len(), plan.needs().len()), (1, 0));
    assert_eq!(fields_beside(example(), "touch"), fields_beside(PLAN, "touch"));
}
