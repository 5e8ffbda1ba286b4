//! The plans of the live station: what a session would touch.

use egui::accesskit::Role;
use egui_kittest::kittest::Queryable as _;
use palpate_ui::api_client::Request;
use palpate_wire::api::{PlanDocument, PlanTake};

use crate::{
    fixture::{FakeWindow, full_api},
    live::{Bench, nothing_recorded},
    record,
};

fn take(primitive: &str, touches: &[&str]) -> PlanTake {
    PlanTake {
        object: "sphere_50mm".into(),
        object_label: "Sphere, 50 mm".into(),
        object_position_m: [0.47, -0.02, 0.19],
        primitive: primitive.to_lowercase(),
        primitive_label: primitive.into(),
        instruction: String::new(),
        touches: touches.iter().map(|&id| id.to_owned()).collect(),
        duration_s: 65.1,
    }
}

/// The page at `hash` of a studio with two plans.
pub(crate) fn with_plans(window: FakeWindow, size: [f32; 2]) -> Bench {
    let document = |id: &str, label: &str, takes| PlanDocument { id: id.into(), label: label.into(), takes };
    let plans = [
        document(
            "nine_takes",
            "Nine takes",
            vec![
                take("Tap", &["palm_heel", "index_tip.3", "index_tip.3"]),
                take("Slide", &["index_tip.3", "thumb_tip.1"]),
            ],
        ),
        document("taps", "Taps", vec![take("Tap", &["palm_heel"])]),
    ];
    let mut recording = nothing_recorded();
    recording.plans = record::plans();
    let api = full_api();
    let body = serde_json::to_vec(&plans).expect("it is plain data");
    api.0.borrow_mut().answer(&Request::Plans, body);
    Bench::on(api, window, &recording, size)
}

#[test]
fn a_plan_says_what_it_touches_and_leads_to_its_recording() {
    let mut bench = with_plans(FakeWindow::of("Ada", "#/plans"), [1280.0, 800.0]);
    bench.harness.run_steps(4);
    bench.harness.get_by_label("2 takes, at least 2 min 10 s of motion. File nine_takes.toml");
    bench.harness.get_by_label_contains("3 of 44 channels, the most often touched 3 times");
    assert_eq!(bench.harness.query_all_by_label("470, \u{2212}20, 190").count(), 2);
    bench.harness.get_by_role_and_label(Role::Button, "Plan Taps").click();
    bench.harness.run_steps(3);
    assert_eq!(bench.window.current(), "#/plans?plan=taps");
    bench.harness.get_by_label("1 take, at least 1 min 05 s of motion. File taps.toml");
    bench.harness.get_by_label_contains("1 of 44 channels, the most often touched once");
    bench.click("Record it");
    assert_eq!(bench.window.current(), "#/record?plan=taps");
}

#[test]
fn the_wizard_shows_the_plan_that_is_chosen() {
    let mut bench = with_plans(FakeWindow::of("Ada", "#/record?plan=nine_takes"), [1280.0, 800.0]);
    bench.harness.run_steps(4);
    bench.click("Look at the plan");
    assert_eq!(bench.window.current(), "#/plans?plan=nine_takes");
}

#[test]
fn a_link_to_a_plan_that_is_gone_says_so() {
    let mut bench = with_plans(FakeWindow::of("Ada", "#/plans?plan=gone"), [1280.0, 800.0]);
    bench.harness.run_steps(4);
    bench.harness.get_by_label_contains("The station has no plan gone");
}
