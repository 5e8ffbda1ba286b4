//! Sessions: checks, coverage, trash and undo.

use egui::accesskit::Role;
use egui_kittest::kittest::Queryable as _;
use palpate_ui::api_client::Request;
use palpate_wire::api::{ChannelCoverage, CheckReport, Problem, Severity};

use crate::fixture::{FakeWindow, full_api, page};

fn check() -> CheckReport {
    let coverage = |channel: &str, touches_by_half: [usize; 2]| ChannelCoverage {
        channel: channel.into(),
        touches: touches_by_half.iter().sum(),
        touches_by_half,
        active_s: 2.5,
    };
    CheckReport {
        session: "bench-1".into(),
        ok: true,
        frames: 400,
        duration_s: 40.0,
        takes: Vec::new(),
        coverage: vec![coverage("pad.0", [6, 5]), coverage("pad.1", [6, 2])],
        problems: vec![Problem {
            severity: Severity::Warning,
            place: "pad.1".into(),
            message: "touched 2 times in the second half; record more taps on it".into(),
        }],
    }
}

#[test]
fn check_results_and_coverage_are_in_words_too() {
    let api = full_api();
    api.0
        .borrow_mut()
        .answer(&Request::Check("bench-1".into()), serde_json::to_vec(&check()).expect("it is plain data"));
    let harness = page(&api, &FakeWindow::at("#/sessions/bench-1"));
    harness.get_by_role_and_label(Role::Button, "Session bench-1");
    harness.get_by_label_contains("pad.1: touched 2 times in the second half");
    harness.get_by_label_contains("1 of 2 channels touched at least 4 times in each half");
    harness.get_by_role_and_label(Role::Button, "Choose a zip");
}

#[test]
fn deleted_session_can_be_brought_back() {
    let api = full_api();
    api.0.borrow_mut().answer(&Request::DeleteSession("bench-1".into()), Vec::new());
    let mut harness = page(&api, &FakeWindow::at("#/sessions/bench-1"));
    harness.get_by_role_and_label(Role::Button, "Move to trash").click();
    harness.run_steps(6);
    harness.get_by_role_and_label(Role::Button, "Undo").click();
    harness.run_steps(3);
    let sent = api.0.borrow().sent.clone();
    assert!(sent.contains(&Request::DeleteSession("bench-1".into())), "{sent:?}");
    assert!(sent.contains(&Request::RestoreSession("bench-1".into())), "{sent:?}");
}
