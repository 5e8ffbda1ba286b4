//! Settings: what each role sees, people, tokens whose secret is shown once, storage, the audit log.

use egui::accesskit::Role;
use egui_kittest::kittest::{NodeT as _, Queryable as _};
use palpate_ui::api_client::Request;
use palpate_wire::api::{
    CreatedToken, NewPerson, NewToken, Person, PersonChanges, Role as May, Scope, Token, Via,
};

use crate::{
    fixture::{FakeWindow, SharedApi, full_api, page, page_of},
    home::me,
};

fn json(value: &impl serde::Serialize) -> Vec<u8> {
    serde_json::to_vec(value).expect("it is plain data")
}

fn person(name: &str, role: May) -> Person {
    Person { name: name.into(), role, created: "2026-11-25T09:00:00Z".into(), last_login: None }
}

fn token() -> Token {
    Token {
        id: 7,
        name: "nightly".into(),
        person: "ada".into(),
        role: May::Operator,
        scopes: vec![Scope::Read, Scope::Jobs],
        created: "2026-11-25T09:00:00Z".into(),
        expires: "2027-02-23T09:00:00Z".into(),
        last_used: None,
    }
}

pub(crate) fn studio(role: May, via: Via) -> SharedApi {
    let api = full_api();
    {
        let mut fake = api.0.borrow_mut();
        fake.answer(&Request::Me, json(&me(role, via)));
        fake.answer(&Request::People, json(&[person("ada", May::Admin), person("bo", May::Viewer)]));
        fake.answer(&Request::Tokens, json(&[token()]));
        fake.answer(&Request::Metrics, b"palpate_disk_free_bytes 1200000000.0\n# EOF\n".to_vec());
        let audit = "{\"time\":\"2026-11-25T09:00:00Z\",\"who\":\"ada\",\"what\":\"started job run-1\"}\n\
            {\"time\":\"2026-11-25T09:01:00Z\",\"who\":\"station\",\"what\":\"stopped: too hot\"}\n";
        fake.answer(&Request::Audit, audit.into());
    }
    api
}

#[test]
fn an_admin_adds_changes_and_removes_people() {
    let api = studio(May::Admin, Via::Session);
    let mut harness = page(&api, &FakeWindow::at("#/settings"));
    harness.get_by_label("You are ada (admin).");
    // Whoever is logged in does not remove themselves by a slip.
    assert!(harness.query_by_label("Remove ada").is_none());
    harness.get_by_label("Remove bo").click();
    harness.run_steps(3);
    let removed = Request::RemovePerson("bo".into());
    assert!(!api.0.borrow().sent.contains(&removed), "it asks once");
    harness.get_by_role_and_label(Role::Button, "Yes, remove bo").click();
    harness.run_steps(3);
    assert!(api.0.borrow().sent.contains(&removed));
    // The made-up server refuses, and its words are on the page.
    harness.get_by_label_contains("nothing at DELETE /api/v1/people/bo");

    harness.get_by_label("Role of bo").click();
    harness.run_steps(3);
    harness.get_by_role_and_label(Role::ListBoxOption, "scorer").click();
    harness.run_steps(3);
    let changes = PersonChanges { role: Some(May::Scorer), password: None };
    let changed = Request::ChangePerson { person: "bo".into(), changes };
    assert!(api.0.borrow().sent.contains(&changed));
    assert!(api.0.borrow().http.iter().any(|http| http.name() == "PATCH /api/v1/people/bo"));

    harness.get_by_role_and_label(Role::TextInput, "Name").focus();
    harness.run_steps(2);
    harness.event(egui::Event::Text("cleo".into()));
    harness.run_steps(2);
    harness.get_by_label_contains("at least 10 characters");
    assert!(harness.get_by_role_and_label(Role::Button, "Add").accesskit_node().is_disabled());
    harness.get_by_role_and_label(Role::PasswordInput, "Password").focus();
    harness.run_steps(2);
    harness.event(egui::Event::Text("correct horse".into()));
    harness.run_steps(3);
    harness.get_by_role_and_label(Role::Button, "Add").click();
    harness.run_steps(3);
    let added = NewPerson { name: "cleo".into(), role: May::Viewer, password: "correct horse".into() };
    assert!(api.0.borrow().sent.contains(&Request::AddPerson(added)));
}

#[test]
fn a_viewer_learns_what_is_hidden_and_nothing_hidden_is_asked_for() {
    let api = studio(May::Viewer, Via::Session);
    let harness = page(&api, &FakeWindow::at("#/settings"));
    harness.get_by_label_contains("People are managed by admins. Your role is viewer");
    let sent = api.0.borrow().sent.clone();
    assert!(!sent.contains(&Request::People), "{sent:?}");
}

#[test]
fn without_a_login_it_says_so_plainly() {
    let harness = page(&studio(May::Admin, Via::Local), &FakeWindow::at("#/settings"));
    harness.get_by_label_contains("There is no login: this studio can be reached from its own computer only");
}

#[test]
fn the_secret_of_a_token_is_shown_once() {
    let api = studio(May::Admin, Via::Session);
    let wanted = NewToken {
        name: "bench".into(),
        person: None,
        role: Some(May::Viewer),
        scopes: Some(vec![Scope::Read]),
        expires_days: Some(90),
    };
    let created =
        CreatedToken { token: Token { name: "bench".into(), ..token() }, secret: "plp_secret".into() };
    api.0.borrow_mut().answer(&Request::CreateToken(wanted.clone()), json(&created));
    let mut harness = page(&api, &FakeWindow::at("#/settings?part=tokens"));
    harness.get_by_label("read, jobs");
    assert!(harness.get_by_role_and_label(Role::Button, "Make the token").accesskit_node().is_disabled());
    harness.get_by_role_and_label(Role::TextInput, "What for").focus();
    harness.run_steps(2);
    harness.event(egui::Event::Text("bench".into()));
    harness.run_steps(3);
    harness.get_by_role_and_label(Role::Button, "Make the token").click();
    harness.run_steps(4);
    assert!(api.0.borrow().sent.contains(&Request::CreateToken(wanted)));
    harness.get_by_label("plp_secret");
    harness.get_by_role_and_label(Role::Button, "I have kept it").click();
    harness.run_steps(3);
    assert!(harness.query_by_label("plp_secret").is_none());

    harness.get_by_label("Revoke nightly").click();
    harness.run_steps(3);
    harness.get_by_role_and_label(Role::Button, "Yes, revoke nightly").click();
    harness.run_steps(3);
    assert!(api.0.borrow().sent.contains(&Request::RevokeToken(7)));
}

#[test]
fn storage_warns_of_a_full_disk_and_says_how_to_back_up() {
    let harness = page(&studio(May::Viewer, Via::Session), &FakeWindow::at("#/settings?part=storage"));
    harness
        .get_by_label_contains("1.2 GB are free on the disk of the data folder: a recording may end early.");
    harness.get_by_label("palpate backup --data data --out palpate.tar");
}

#[test]
fn the_audit_log_comes_newest_first_and_is_filtered_by_words() {
    for size in [[1280.0, 800.0], [390.0, 844.0]] {
        let mut harness =
            page_of(&studio(May::Viewer, Via::Session), &FakeWindow::at("#/settings?part=audit"), size);
        let newest = harness.get_by_label("stopped: too hot").rect();
        let oldest = harness.get_by_label("started job run-1").rect();
        assert!(newest.top() < oldest.top() && newest.right() <= size[0], "{newest:?} {oldest:?}");
        harness.get_by_role_and_label(Role::TextInput, "Filter").focus();
        harness.run_steps(2);
        harness.event(egui::Event::Text("ADA job".into()));
        harness.run_steps(3);
        assert!(harness.query_by_label("stopped: too hot").is_none());
        harness.get_by_label("1 of the newest 2 lines");
    }
}

#[test]
fn what_does_not_come_is_said() {
    let api = studio(May::Admin, Via::Session);
    api.0.borrow_mut().bodies.remove("GET /api/v1/audit");
    let harness = page(&api, &FakeWindow::at("#/settings?part=audit"));
    harness.get_by_label_contains("The audit log did not arrive");
    let api = studio(May::Admin, Via::Session);
    api.0.borrow_mut().bodies.remove("GET /api/v1/me");
    let harness = page(&api, &FakeWindow::at("#/settings"));
    harness.get_by_label_contains("Who you are did not arrive");
}
