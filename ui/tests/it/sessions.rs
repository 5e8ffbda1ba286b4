//! Sessions: checks, coverage, trash and undo.

use egui::accesskit::Role;
use egui_kittest::kittest::Queryable as _;
use palpate_reports::{ChannelCoverage, CheckReport, Problem, Severity};
use palpate_ui::{api_client::Request, screens::PickedFile};
use palpate_wire::api::{Role as May, TrashEntry, TrashSort, Via};

use crate::{
    fixture::{FakeWindow, full_api, page, page_of, station},
    home::me,
};

pub(crate) fn check() -> CheckReport {
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
fn takes_of_trials_lead_back_to_their_campaign() {
    let api = full_api();
    let lineage = serde_json::json!({ "artifacts": [
        { "sort": "session", "id": "bench-1", "name": "bench-1", "made_from": [{ "sort": "campaign", "id": "night" }] },
        { "sort": "campaign", "id": "night", "name": "Night", "made_from": [{ "sort": "policy", "id": "cube" }] },
    ] });
    api.0.borrow_mut().answer(&Request::Lineage, lineage.to_string().into_bytes());
    let window = FakeWindow::at("#/sessions/bench-1");
    let mut harness = page(&api, &window);
    harness.get_by_label("which tries cube.");
    harness.get_by_role_and_label(Role::Button, "Night").click();
    harness.run_steps(3);
    assert_eq!(window.current(), "#/trials?campaign=night");
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

#[test]
fn many_warnings_are_one_line_and_coverage_stays_on_the_page() {
    let api = full_api();
    let station = station();
    let channels = &station.layout.channels;
    let coverage = channels
        .iter()
        .map(|channel| ChannelCoverage {
            channel: channel.id.clone(),
            touches: 0,
            touches_by_half: [0, 0],
            active_s: 0.0,
        })
        .collect();
    let problems = channels
        .iter()
        .map(|channel| Problem {
            severity: Severity::Warning,
            place: channel.id.clone(),
            message: "never touched; is it connected, and does a primitive reach it?".into(),
        })
        .collect();
    let report = CheckReport { coverage, problems, ..check() };
    api.0
        .borrow_mut()
        .answer(&Request::Check("bench-1".into()), serde_json::to_vec(&report).expect("it is plain data"));
    let mut harness = page(&api, &FakeWindow::at("#/sessions/bench-1"));
    let (all, first) = (channels.len(), station.layout.channel_label(0));
    harness.get_by_label(&format!("{all} of {all} taxels were touched too seldom, {all} of them never"));
    assert!(harness.query_by_label_contains(&format!("{first}: never touched")).is_none(), "it is folded");
    let about = format!("0 of {all} channels touched at least 4 times in each half");
    let picture = harness.get_by_label(&about).rect();
    assert!(picture.bottom() < 800.0, "{picture:?}");
    harness.get_by_label(&format!("Which {all}")).click();
    harness.run_steps(20);
    harness.get_by_label(&format!("{first}: never touched; is it connected, and does a primitive reach it?"));
}

#[test]
fn file_with_a_long_name_is_not_sent() {
    let api = full_api();
    let window = FakeWindow::at("#/sessions");
    let mut harness = page(&api, &window);
    let name = format!("{}.zip", "a".repeat(61));
    window.0.borrow_mut().picked = vec![PickedFile { name, bytes: vec![1] }];
    harness.run_steps(3);
    harness.get_by_label_contains("in at most 60 letters");
    assert!(!api.0.borrow().sent.iter().any(|request| matches!(request, Request::Import { .. })));
}

#[test]
fn phone_has_the_list_and_the_session_one_at_a_time() {
    let api = full_api();
    api.0
        .borrow_mut()
        .answer(&Request::Check("bench-1".into()), serde_json::to_vec(&check()).expect("it is plain data"));
    let mut harness = page_of(&api, &FakeWindow::at("#/sessions"), [390.0, 844.0]);
    let entry = harness.get_by_role_and_label(Role::Button, "Session bench-1");
    assert!(entry.rect().right() <= 390.0, "{:?}", entry.rect());
    assert!(harness.query_by_label("Move to trash").is_none());
    entry.click();
    harness.run_steps(6);
    let trash = harness.get_by_role_and_label(Role::Button, "Move to trash").rect();
    assert!(trash.right() <= 390.0 && trash.left() >= 60.0, "{trash:?}");
    assert!(harness.query_by_label("Choose a zip").is_none());
    harness.get_by_role_and_label(Role::RadioButton, "All sessions").click();
    harness.run_steps(3);
    harness.get_by_role_and_label(Role::Button, "Session bench-1");
}

fn trash() -> Vec<u8> {
    let entry =
        |sort, id: &str| TrashEntry { sort, id: id.into(), deleted: "2026-11-25T09:00:00.000Z".into() };
    let entries = [entry(TrashSort::Session, "bench-0"), entry(TrashSort::Model, "soft")];
    serde_json::to_vec(&entries).expect("it is plain data")
}

#[test]
fn what_was_deleted_is_listed_and_restored() {
    let api = full_api();
    api.0.borrow_mut().answer(&Request::Trash, trash());
    let mut harness = page(&api, &FakeWindow::at("#/sessions"));
    assert!(!api.0.borrow().sent.contains(&Request::Trash), "nobody has asked what was deleted");
    harness.get_by_label("Deleted").click();
    harness.run_steps(20);
    api.0.borrow_mut().answer(&Request::RestoreSession("bench-0".into()), b"{}".to_vec());
    api.0.borrow_mut().answer(&Request::Trash, b"[]".to_vec());
    harness.get_by_role_and_label(Role::Button, "Restore model soft");
    harness.get_by_role_and_label(Role::Button, "Restore session bench-0").click();
    harness.run_steps(4);
    assert!(api.0.borrow().sent.contains(&Request::RestoreSession("bench-0".into())));
    harness.get_by_label("The trash holds no session and no model.");
}

#[test]
fn what_cannot_be_restored_says_why_and_viewers_are_told_who_may() {
    let api = full_api();
    api.0.borrow_mut().answer(&Request::Trash, trash());
    let mut harness = page(&api, &FakeWindow::at("#/sessions"));
    harness.get_by_label("Deleted").click();
    harness.run_steps(20);
    harness.get_by_role_and_label(Role::Button, "Restore model soft").click();
    harness.run_steps(4);
    harness.get_by_label_contains("nothing at POST /api/v1/models/soft/restore");
    let me = serde_json::to_vec(&me(May::Viewer, Via::Session)).expect("it is plain data");
    api.0.borrow_mut().answer(&Request::Me, me);
    let mut harness = page(&api, &FakeWindow::at("#/sessions"));
    harness.get_by_label("Deleted").click();
    harness.run_steps(20);
    harness.get_by_label("Operators restore what was deleted.");
}

#[test]
fn a_session_and_its_takes_can_be_downloaded() {
    let mut harness = page(&full_api(), &FakeWindow::at("#/sessions/bench-1"));
    let mut opened = |label: &str| {
        harness.get_by_role_and_label(Role::Link, label).click();
        harness.step();
        harness.output().platform_output.commands.iter().find_map(|command| match command {
            egui::OutputCommand::OpenUrl(url) => Some(url.url.clone()),
            _ => None,
        })
    };
    assert_eq!(opened("Download session").as_deref(), Some("/api/v1/sessions/bench%2D1/session.zip"));
    let take = "/api/v1/sessions/bench%2D1/takes/take%2D02/take.mcap";
    assert_eq!(opened("Download take-02").as_deref(), Some(take));
}
