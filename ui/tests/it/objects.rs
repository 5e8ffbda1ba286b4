//! The gallery of objects: list, facts, poses, and what is wrong with a file.

use egui::accesskit::Role;
use egui_kittest::kittest::Queryable as _;
use palpate_ui::api_client::Request;
use palpate_wire::api::{ObjectDocument, ObjectEntry, ObjectTake, RestPoseDocument};

use crate::fixture::{FakeWindow, SharedApi, full_api, page};

fn pose(weight: f64, barrier_m: Option<f64>) -> RestPoseDocument {
    RestPoseDocument {
        quaternion_wxyz: [1.0, 0.0, 0.0, 0.0],
        origin_height_m: 0.02,
        com_height_m: 0.02,
        weight,
        barrier_m,
    }
}

pub(crate) fn block() -> ObjectEntry {
    let object_toml = "id = 'block'\nlabel = 'Block'\nshape = { kind = 'box', size_m = [0.08, 0.06, 0.04] }";
    ObjectEntry {
        id: "block".into(),
        own: false,
        content: Ok(ObjectDocument {
            label: "Block".into(),
            group: Some("seen".into()),
            size_m: [0.08, 0.06, 0.04],
            volume_m3: 0.000_192,
            mass_kg: Some(0.1056),
            com_m: [0.0; 3],
            rest_poses: vec![pose(0.6, Some(0.016)), pose(0.4, Some(0.006))],
            object_toml: object_toml.into(),
            meshes_base64: [].into(),
        }),
        takes: vec![ObjectTake { session: "bench-1".into(), take: "take-01".into() }],
    }
}

pub(crate) fn bad() -> ObjectEntry {
    let problem = "bad.toml: line 3, object \"bad\": radius_m is -1, expected a finite number above zero";
    ObjectEntry { id: "bad".into(), own: true, content: Err(problem.into()), takes: Vec::new() }
}

pub(crate) fn with_objects(objects: &[ObjectEntry]) -> SharedApi {
    let api = full_api();
    let body = serde_json::to_vec(objects).expect("it is plain data");
    api.0.borrow_mut().answer(&Request::Objects, body);
    api
}

#[test]
fn facts_and_poses_of_an_object_are_in_words() {
    let api = with_objects(&[block(), bad()]);
    let window = FakeWindow::at("#/objects?object=block");
    let mut harness = page(&api, &window);
    harness.get_by_label_contains("80 x 60 x 40 mm");
    harness.get_by_label_contains("seen in training");
    harness.get_by_role_and_label(Role::Button, "Pose 1: 60 %, tips at +16.0 mm");
    harness.get_by_role_and_label(Role::Button, "Pose 2: 40 %, tips at +6.0 mm").click();
    harness.run_steps(3);
    harness.get_by_role_and_label(Role::Button, "bench-1 take-01").click();
    harness.run_steps(3);
    assert!(window.current().starts_with("#/timelines/bench-1"), "{}", window.current());
}

#[test]
fn a_bad_file_says_what_is_wrong_and_can_be_looked_at_again() {
    let api = with_objects(&[block(), bad()]);
    let window = FakeWindow::at("#/objects");
    let mut harness = page(&api, &window);
    harness.get_by_role_and_label(Role::Button, "Object bad").click();
    harness.run_steps(3);
    assert_eq!(window.current(), "#/objects?object=bad");
    harness.get_by_label_contains("bad.toml: line 3");
    let asked = || api.0.borrow().sent.iter().filter(|request| **request == Request::Objects).count();
    let before = asked();
    harness.get_by_role_and_label(Role::Button, "Look again").click();
    harness.run_steps(3);
    assert_eq!(asked(), before + 1);
}

#[test]
fn no_objects_and_no_list_say_what_to_do() {
    let harness = page(&with_objects(&[]), &FakeWindow::at("#/objects"));
    harness.get_by_label_contains("No object yet");
    let harness = page(&full_api(), &FakeWindow::at("#/objects"));
    harness.get_by_label_contains("The list of objects did not arrive");
}

#[test]
fn a_phone_shows_the_object_below_its_name() {
    let api = with_objects(&[block(), bad()]);
    let window = FakeWindow::at("#/objects?object=block");
    let mut harness = page(&api, &window);
    harness.set_size(egui::vec2(390.0, 844.0));
    harness.run_steps(3);
    let facts = harness.get_by_label_contains("80 x 60 x 40 mm").rect();
    assert!(facts.right() <= 390.0 && facts.top() > 300.0, "{facts:?} lies below a picture of some size");
    harness.get_by_role_and_label(Role::ComboBox, "Object").click();
    harness.run_steps(3);
    harness.get_by_role_and_label(Role::ListBoxOption, "bad").click();
    harness.run_steps(3);
    assert_eq!(window.current(), "#/objects?object=bad");
    harness.get_by_label_contains("radius_m is -1");
}
