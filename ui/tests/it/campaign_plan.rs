//! The plan of a campaign, before there is one.

use egui::accesskit::Role;
use egui_kittest::kittest::{NodeT as _, Queryable as _};
use palpate_ui::api_client::Request;
use serde_json::json;

use crate::{
    fixture::{FakeWindow, full_api, page},
    objects::{block, with_objects},
};

#[test]
fn a_campaign_is_planned_and_what_is_missing_is_said() {
    let api = full_api();
    api.0.borrow_mut().answer(&Request::Campaigns, b"[]".to_vec());
    let mut harness = page(&api, &FakeWindow::at("#/trials"));
    harness.run_steps(3);
    harness.get_by_role_and_label(Role::Button, "Plan a campaign").click();
    harness.run_steps(3);
    harness.get_by_label_contains("Give the campaign a name.");
}

#[test]
fn policies_that_there_are_are_chosen_from_a_list() {
    let api = with_objects(&[block()]);
    api.0.borrow_mut().answer(&Request::Campaigns, b"[]".to_vec());
    let policy = |id: &str, name: &str, is_shipped: bool| json!({ "sort": "policy", "id": id, "name": name, "is_shipped": is_shipped });
    // One of the shipped ones is named after an object that there is.
    let lineage = json!({ "artifacts": [
        policy("block", "block", true), policy("searching", "searching", true),
        policy("imitation-3", "Imitation of Monday", false),
    ] });
    api.0.borrow_mut().answer(&Request::Lineage, lineage.to_string().into_bytes());
    let mut harness = page(&api, &FakeWindow::at("#/trials"));
    harness.run_steps(3);
    harness.get_by_role_and_label(Role::Button, "Plan a campaign").click();
    harness.run_steps(4);
    harness.get_by_role_and_label(Role::ComboBox, "Choose policy 1").click();
    harness.run_steps(4);
    let options: Vec<String> = harness
        .get_all_by_role(Role::ListBoxOption)
        .filter_map(|option| option.accesskit_node().label())
        .collect();
    assert_eq!(
        options,
        [
            "searching, comes with the program",
            "Imitation of Monday",
            "the expert that comes with the program for each object",
            "the script of each object, which feels nothing",
        ]
    );
    harness.get_by_role_and_label(Role::ListBoxOption, "Imitation of Monday").click();
    harness.run_steps(4);
    for (field, text) in [("Source of policy 1", "imitation-3"), ("Name of policy 1", "imitation-3")] {
        let value = harness.get_by_role_and_label(Role::TextInput, field).accesskit_node().value();
        assert_eq!(value.as_deref(), Some(text), "{field}");
    }
}
