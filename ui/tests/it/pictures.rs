//! Every screen as a picture: on a phone, a laptop and a large screen, light and dark, compared with the one of before.
//!
//! `UPDATE_SNAPSHOTS=true cargo test -p palpate_ui --test it pictures` accepts what changed. The pictures of the last run
//! lie in `pages/` of the folder `$PALPATE_ARTIFACTS`, where that is set.

use std::path::PathBuf;

use egui_kittest::{Harness, SnapshotOptions, try_image_snapshot_options};
use palpate_ui::{StudioApp, api_client::Request};
use palpate_wire::api::{JobState, RecordingPhase, Role as May, TrialState, Via};

use crate::{
    calibrate, diagnose,
    fixture::{FakeWindow, SharedApi, full_api, page_of},
    home, jobs,
    live::{Bench, nothing_recorded},
    models, objects, plans, record, settings, trials,
};

/// Width and height, points.
const SIZES: [[f32; 2]; 3] = [[390.0, 844.0], [1280.0, 800.0], [1920.0, 1080.0]];

/// Width and theme of the pictures that are compared; the others would say the same once more.
const KEPT: [(f32, egui::Theme); 3] =
    [(390.0, egui::Theme::Light), (1280.0, egui::Theme::Dark), (1920.0, egui::Theme::Light)];

/// Draws the screen at `hash`, which `api` answers.
fn compare(name: &str, api: &SharedApi, hash: &str) {
    compare_pages(name, hash, |window, size| page_of(api, &window, size));
}

/// Draws the page that `open` makes of a window at `hash`, in every size and theme.
fn compare_pages(
    name: &str,
    hash: &str,
    open: impl Fn(FakeWindow, [f32; 2]) -> Harness<'static, Option<StudioApp>>,
) {
    let themes = [egui::Theme::Light, egui::Theme::Dark];
    let pages = SIZES.into_iter().flat_map(|size| themes.map(|theme| (size, theme)));
    let differences: Vec<String> =
        pages.filter_map(|(size, theme)| difference(name, hash, size, theme, &open)).collect();
    assert!(differences.is_empty(), "{}", differences.join("\n"));
}

/// Draws the page that `open` makes of a window at `hash`; how it differs from the picture of before, if one is kept.
fn difference(
    name: &str,
    hash: &str,
    size: [f32; 2],
    theme: egui::Theme,
    open: impl Fn(FakeWindow, [f32; 2]) -> Harness<'static, Option<StudioApp>>,
) -> Option<String> {
    let window = FakeWindow::of("Ada", hash);
    window.0.borrow_mut().theme = Some(theme);
    let mut page = open(window, size);
    let word = if theme == egui::Theme::Dark { "dark" } else { "light" };
    let name = format!("{name}_{}_{word}", size[0]);
    let picture = page.render().expect("it is painted on the CPU");
    if let Some(folder) = std::env::var_os("PALPATE_ARTIFACTS") {
        let folder = PathBuf::from(folder).join("pages");
        std::fs::create_dir_all(&folder).expect("the folder of artifacts can be written");
        picture.save(folder.join(format!("{name}.png"))).expect("the folder can be written");
    }
    if !KEPT.contains(&(size[0], theme)) {
        return None;
    }
    // As much as egui's own pictures: a processor with other vectors may round the edge of a glyph otherwise.
    let options = SnapshotOptions::new().threshold(0.6);
    try_image_snapshot_options(&picture, &name, &options).err().map(|err| err.to_string())
}

#[test]
fn home() {
    compare("home", &home::studio(May::Operator), "#/home");
}

#[test]
fn sessions() {
    let api = full_api();
    let check = serde_json::to_vec(&crate::sessions::check()).expect("it is plain data");
    api.0.borrow_mut().answer(&Request::Check("bench-1".into()), check);
    compare("sessions", &api, "#/sessions/bench-1");
}

#[test]
fn hand() {
    compare("hand", &full_api(), "#/hand/bench-1/take-01?t=4");
}

#[test]
fn timelines() {
    compare("timelines", &full_api(), "#/timelines/bench-1/take-01?t=4&model=bench-fit");
}

#[test]
fn calibrate() {
    let api = full_api();
    let run = calibrate::run(JobState::Done);
    calibrate::answer(&api, &Request::Run("run-7".into()), &run);
    compare("calibrate", &api, "#/calibrate/bench-1?run=run-7");
}

#[test]
fn diagnose() {
    let run = diagnose::run(JobState::Done, Some(diagnose::named()));
    let (api, window) = diagnose::result_page(&run);
    compare("diagnose", &api, &window.current());
}

/// From its first line to its last: what only shows when one scrolls.
#[test]
fn diagnose_on_a_tall_phone() {
    let run = diagnose::run(JobState::Done, Some(diagnose::full()));
    let (api, window) = diagnose::result_page(&run);
    let (size, hash) = ([390.0, 3600.0], window.current());
    let open = |window, size| page_of(&api, &window, size);
    let difference = difference("diagnose_tall", &hash, size, egui::Theme::Light, open);
    assert_eq!(difference, None);
}

#[test]
fn objects() {
    let api = objects::with_objects(&[objects::block(), objects::bad()]);
    compare("objects", &api, "#/objects?object=block");
}

#[test]
fn plans() {
    compare_pages("plans", "#/plans", |window, size| {
        let mut bench = plans::with_plans(window, size);
        bench.harness.run_steps(4);
        bench.harness
    });
}

#[test]
fn trials() {
    compare(
        "trials",
        &trials::with(&trials::campaign(TrialState::Waiting)),
        "#/trials?campaign=first-trials",
    );
}

#[test]
fn jobs() {
    let running = jobs::job("expert-2", "expert", JobState::Running);
    let done = jobs::job("expert-1", "expert", JobState::Done);
    let api = jobs::with(vec![running, done]);
    let points =
        "{\"step\":1,\"success_rate\":0.25,\"kl\":0.01}\n{\"step\":2,\"success_rate\":0.5,\"kl\":0.02}\n";
    api.0.borrow_mut().answer(&Request::JobMetrics("expert-2".into()), points.into());
    compare("jobs", &api, "#/jobs?job=expert-2");
}

#[test]
fn training_form() {
    let gathered = jobs::job("gathering-2", "gathering", JobState::Done);
    let api = jobs::with(vec![gathered, jobs::job("pretraining-1", "pretraining", JobState::Done)]);
    jobs::kinds(&api, None);
    compare_pages("training_form", "#/jobs?job=new", |window, size| {
        let mut page = page_of(&api, &window, size);
        jobs::choose(&mut page, "What to start", "Imitate an expert");
        page
    });
}

#[test]
fn models() {
    compare("models", &models::from_takes_to_trials(), "#/models?artifact=policy%3Aimitation-1");
}

#[test]
fn settings() {
    compare("settings", &settings::studio(May::Admin, Via::Session), "#/settings");
}

#[test]
fn help() {
    compare("help", &crate::help::with_docs(), "#/help/learning");
}

#[test]
fn record() {
    let document = record::document(RecordingPhase::StartPose);
    compare_pages("record", "#/record", |window, size| Bench::of(window, &document, size).harness);
}

#[test]
fn live() {
    compare_pages("live", "#/hand?source=live", |window, size| {
        Bench::of(window, &nothing_recorded(), size).harness
    });
}
