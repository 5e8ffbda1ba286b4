//! The form that starts a job: every kind that `palpate-train` does, and the blind bench.

use std::collections::{BTreeMap, BTreeSet};

use egui::RichText;
use palpate_wire::api::{ConfiguredObservation, ImitationRequest, Job, JobRequest, JobState};
use serde_json::{Map, Value};

use super::super::{
    ScreenContext,
    controls::{combo_ui, may_start_jobs_ui, option_ui},
    copy_as,
};
use super::{
    needs::Needs,
    trainings::{Field, TRAININGS, Training, help, shown},
};
use crate::store::Loadable;

/// What the operator filled in. A word that several trainings share is kept from one to the other.
#[derive(Debug)]
pub(super) struct StartState {
    /// Its place in [`TRAININGS`].
    training: usize,
    object: String,
    /// Texts by key; empty means what is usual.
    texts: BTreeMap<&'static str, String>,
    choices: BTreeMap<&'static str, &'static str>,
    flags: BTreeSet<&'static str>,
    model: Option<String>,
    seed: u64,
    needs: Needs,
}

impl Default for StartState {
    fn default() -> Self {
        Self {
            training: 0,
            object: "cube".to_owned(),
            texts: BTreeMap::new(),
            choices: BTreeMap::new(),
            flags: BTreeSet::new(),
            model: None,
            seed: 1,
            needs: Needs::default(),
        }
    }
}

impl StartState {
    fn training(&self) -> &'static Training {
        TRAININGS.get(self.training).unwrap_or(&TRAININGS[0])
    }

    fn text(&self, key: &str) -> &str {
        self.texts.get(key).map_or("", |text| text.trim())
    }

    /// What was chosen, or the first where that is no choice of this training.
    fn chosen(&self, key: &str, choices: &'static [&'static str]) -> &'static str {
        let chosen = self.choices.get(key).copied().filter(|chosen| choices.contains(chosen));
        chosen.or(choices.first().copied()).unwrap_or_default()
    }

    /// What is asked for, or what is missing.
    fn request(&self) -> Result<JobRequest, String> {
        let training = self.training();
        let mut request = Map::new();
        for field in training.fields {
            if let Some((key, value)) = self.value(*field)? {
                request.insert(key.to_owned(), value);
            }
        }
        if training.kind == "imitation" {
            go_together(training, &request)?;
        }
        let resources = self.needs.resources(training.parts.is_some(), training.may_use_gpu);
        if training.kind == "evaluation" {
            let is_divided = resources.is_some();
            match (request.contains_key("protocol"), request.contains_key("objects")) {
                (false, true) => return Err("objects belong to a protocol; choose one too".to_owned()),
                (has_protocol, has_objects) if is_divided && !(has_protocol && has_objects) => {
                    let missing =
                        "parts share the objects of a protocol; choose a protocol and which objects";
                    return Err(missing.to_owned());
                }
                _ => {}
            }
        }
        Ok(JobRequest {
            kind: training.kind.to_owned(),
            request: Value::Object(request),
            seed: if training.is_seeded { self.seed } else { 0 },
            priority: 0,
            resources,
            runner: None,
        })
    }

    /// Name and value of `field` in the request, unless it is left to the studio; or what is missing.
    fn value(&self, field: Field) -> Result<Option<(&'static str, Value)>, String> {
        let value: Option<(_, Value)> = match field {
            Field::Object => Some(("object", self.object.clone().into())),
            Field::Objects { slot, groups } => {
                let group = self.chosen(slot, groups);
                (Some(&group) != groups.first()).then(|| ("objects", vec![group].into()))
            }
            Field::Policy(_) => match self.text("policy") {
                "" => {
                    return Err(
                        "which policy? Give a job such as expert-1, or a shipped one such as cube".to_owned()
                    );
                }
                policy => Some(("policy", policy.into())),
            },
            Field::Job { key, .. } => match self.text(key) {
                "" => None,
                job => Some((key, job.into())),
            },
            Field::Jobs { key, label, kind } => {
                let words = self.text(key).split([',', ' ']).filter(|word| !word.is_empty());
                let jobs: Vec<&str> = words.collect();
                if jobs.is_empty() {
                    return Err(format!("which {}? Give jobs such as {kind}-1", label.to_lowercase()));
                }
                Some((key, jobs.into()))
            }
            Field::Number { key, otherwise, .. } => match self.text(key) {
                "" => otherwise.map(|number| (key, number.into())),
                text => match text.parse::<u64>() {
                    Ok(number) if number > 0 => Some((key, number.into())),
                    _ => return Err(format!("{text:?} is no number above 0")),
                },
            },
            Field::Choice { key, choices, .. } => {
                let chosen = self.chosen(key, choices);
                (!chosen.is_empty()).then(|| (key, chosen.into()))
            }
            Field::Model => self.model.clone().map(|model| ("model", model.into())),
            Field::Flag { key, .. } => self.flags.contains(key).then(|| (key, true.into())),
        };
        Ok(value)
    }
}

/// Refuses fields of an imitation that do not go together, by what the form calls them.
fn go_together(training: &Training, request: &Map<String, Value>) -> Result<(), String> {
    let asked = serde_json::from_value::<ImitationRequest>(Value::Object(request.clone()));
    let asked = asked.map_err(|err| err.to_string())?;
    asked.check(ConfiguredObservation::default()).map_err(|problem| {
        let mut names = training.fields.iter().filter_map(|field| field.names());
        let label = names.find(|(key, _)| *key == problem.field).map(|(_, label)| label);
        format!("{}: {}", label.unwrap_or(problem.field), problem.problem)
    })
}

/// Less wide than this, points, what fills a field stands below it.
const BESIDE: f32 = 500.0;

/// The form. `jobs` are those that are known.
pub(super) fn start_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, state: &mut StartState, jobs: &[Job]) {
    ui.heading("Start a job");
    ui.horizontal_wrapped(|ui| {
        combo_ui(ui, "What to start", state.training().words, 190.0, |ui| {
            for (idx, training) in TRAININGS.iter().enumerate() {
                option_ui(ui, &mut state.training, idx, training.words);
            }
        });
    });
    ui.add(egui::Label::new(RichText::new(state.training().explained).color(cx.palette.text_weak)).wrap());
    ui.add_space(6.0);
    egui::Grid::new("start_job").num_columns(2).spacing([14.0, 6.0]).show(ui, |ui| {
        for field in state.training().fields {
            field_ui(ui, cx, state, jobs, *field);
            ui.end_row();
        }
        if state.training().is_seeded {
            let label = ui.label("Seed");
            ui.add(egui::DragValue::new(&mut state.seed)).labelled_by(label.id);
            ui.end_row();
        }
    });
    let training = state.training();
    state.needs.show(ui, cx, training.parts, training.may_use_gpu);
    ui.add_space(6.0);
    let problem = match cx.store.jobs.kinds() {
        Loadable::Ready(kinds) => {
            kinds.iter().find(|kind| kind.kind == state.training().kind).and_then(|kind| kind.problem.clone())
        }
        _ => None,
    };
    if let Some(problem) = &problem {
        let text = format!("\u{26a0} Not available here: {problem}");
        ui.add(egui::Label::new(RichText::new(text).color(cx.palette.warning)).wrap().selectable(true));
    }
    match state.request() {
        Err(missing) => {
            ui.label(RichText::new(missing).color(cx.palette.text_weak));
        }
        Ok(request) => {
            let is_on_its_way = matches!(cx.store.jobs.cloned, Loadable::Loading);
            let can = may_start_jobs_ui(ui, cx) && problem.is_none() && !is_on_its_way;
            if ui.add_enabled(can, egui::Button::new("Start")).clicked() {
                cx.store.jobs.submit(request.clone());
            }
            if let Some(problem) = cx.store.jobs.problem.clone() {
                let text = RichText::new(format!("\u{26a0} {problem}")).color(cx.palette.mismatch);
                ui.add(egui::Label::new(text).wrap());
            }
            copy_as::copy_ui(ui, &copy_as::submission(&request, copy_as::DATA_FOLDER));
        }
    }
}

fn field_ui(
    ui: &mut egui::Ui,
    cx: &mut ScreenContext<'_>,
    state: &mut StartState,
    jobs: &[Job],
    field: Field,
) {
    let weak = cx.palette.text_weak;
    match field {
        Field::Object => {
            ui.label("Object");
            let objects = cx.store.objects();
            combo_ui(ui, "Object to grasp", &state.object.clone(), 160.0, |ui| {
                for object in objects.ready().map_or(&[][..], |objects| objects.as_slice()) {
                    option_ui(ui, &mut state.object, object.id.clone(), &object.id);
                }
            });
        }
        Field::Objects { slot, groups } => choice_ui(ui, state, slot, weak, "Objects", groups),
        Field::Policy(kinds) => {
            let known = kinds.iter().flat_map(|kind| done(jobs, kind)).collect();
            text_ui(ui, "Policy", "expert-1 or cube", state.texts.entry("policy").or_default(), known);
        }
        Field::Job { key, label, kind } => {
            let hint = format!("none, or {kind}-1");
            let known = done(jobs, kind);
            beside_ui(ui, weak, [label, key, ""], |ui, name| {
                line_ui(ui, name, &hint, state.texts.entry(key).or_default(), known);
            });
        }
        Field::Jobs { key, label, kind } => {
            let hint = format!("{kind}-1");
            text_ui(ui, label, &hint, state.texts.entry(key).or_default(), done(jobs, kind));
        }
        Field::Number { key, label, usual, .. } => {
            text_ui(ui, label, usual, state.texts.entry(key).or_default(), Vec::new());
        }
        Field::Choice { key, label, choices } => choice_ui(ui, state, key, weak, label, choices),
        Field::Model => {
            ui.label("Sensor model");
            let models = cx.store.models();
            let chosen = state.model.clone().unwrap_or_else(|| "nominal".to_owned());
            combo_ui(ui, "Sensor model that makes touch", &chosen, 190.0, |ui| {
                option_ui(ui, &mut state.model, None, "nominal");
                let models = models.ready().map_or(&[][..], |models| models.as_slice());
                for model in models.iter().filter(|model| model.id != "nominal") {
                    option_ui(ui, &mut state.model, Some(model.id.clone()), &model.name);
                }
            });
        }
        Field::Flag { key, label, words } => {
            let mut is_set = state.flags.contains(key);
            beside_ui(ui, weak, [label, key, ""], |ui, _| {
                if ui.checkbox(&mut is_set, words).changed() {
                    if is_set {
                        state.flags.insert(key)
                    } else {
                        state.flags.remove(key)
                    };
                }
            });
        }
    }
}

fn choice_ui(
    ui: &mut egui::Ui,
    state: &mut StartState,
    key: &'static str,
    weak: egui::Color32,
    label: &'static str,
    choices: &'static [&'static str],
) {
    let mut chosen = state.chosen(key, choices);
    let before = chosen;
    beside_ui(ui, weak, [label, key, before], |ui, _| {
        combo_ui(ui, label, shown(key, chosen), 140.0, |ui| {
            for choice in choices {
                option_ui(ui, &mut chosen, *choice, shown(key, choice));
            }
        });
    });
    state.choices.insert(key, chosen);
}

/// A row: `label`, what fills it, and below that the line of help of `choice`, if there is one.
fn beside_ui(
    ui: &mut egui::Ui,
    weak: egui::Color32,
    [label, key, choice]: [&str; 3],
    fill: impl FnOnce(&mut egui::Ui, egui::Id),
) {
    let name = ui.label(label).id;
    match help(key, choice) {
        "" => fill(ui, name),
        line => {
            ui.vertical(|ui| {
                fill(ui, name);
                ui.add(egui::Label::new(RichText::new(line).color(weak)).wrap());
            });
        }
    }
}

/// A line to fill in; what is known fills it by a press.
fn text_ui(ui: &mut egui::Ui, name: &str, hint: &str, text: &mut String, known: Vec<&str>) {
    let label = ui.label(name).id;
    line_ui(ui, label, hint, text, known);
}

/// The same without its label, which is `label`.
fn line_ui(ui: &mut egui::Ui, label: egui::Id, hint: &str, text: &mut String, known: Vec<&str>) {
    let is_narrow = ui.available_width() < BESIDE;
    let contents = |ui: &mut egui::Ui| {
        let field = egui::TextEdit::singleline(text).desired_width(170.0).char_limit(400).hint_text(hint);
        ui.add(field).labelled_by(label);
        for id in known.into_iter().take(3) {
            if ui.button(id).clicked() {
                *text = id.to_owned();
            }
        }
    };
    // A row of the grid grows with what stands below one another, not with what wraps.
    if is_narrow {
        ui.vertical(contents);
    } else {
        ui.horizontal(contents);
    }
}

/// Ids of the jobs of `kind` that are done, newest first.
fn done<'a>(jobs: &'a [Job], kind: &str) -> Vec<&'a str> {
    let done = jobs.iter().filter(|job| job.kind == kind && job.state == JobState::Done);
    done.map(|job| job.id.as_str()).collect()
}

#[cfg(test)]
mod tests {
    use palpate_wire::api::{
        BlindRequest, DemonstrationsRequest, EXPERTS, EvaluationRequest, ExpertRequest, GatheringRequest,
        HEADS, MEMORIES, PAPER_POLICIES, PipelineRequest, PretrainingRequest, TuneRequest,
    };
    use serde::de::DeserializeOwned;
    use serde_json::json;

    use super::*;

    fn form(kind: &str, texts: &[(&'static str, &str)]) -> StartState {
        let training = TRAININGS.iter().position(|training| training.kind == kind).unwrap();
        let texts = texts.iter().map(|(key, text)| (*key, (*text).to_owned())).collect();
        StartState { training, texts, ..StartState::default() }
    }

    #[test]
    fn request_says_what_was_chosen_and_leaves_the_rest_to_the_studio() {
        let request = form("expert", &[("total_steps", " 4000 ")]).request().unwrap();
        assert_eq!(request.request, json!({ "object": "cube", "preset": "quick", "total_steps": 4000 }));
        assert_eq!((request.kind.as_str(), request.seed), ("expert", 1));
        for (kind, texts, expected) in [
            ("evaluation", &[("policy", "expert-2")][..], json!({ "policy": "expert-2" })),
            ("demonstrations", &[("policy", "cube")], json!({ "policy": "cube", "count": 64 })),
            (
                "pretraining",
                &[("demonstrations", "demonstrations-1, demonstrations-2")],
                json!({ "demonstrations": ["demonstrations-1", "demonstrations-2"], "preset": "quick" }),
            ),
            ("gathering", &[("count", "20")], json!({ "count": 20, "protocol": "wide" })),
            (
                "imitation",
                &[("trials", "gathering-1")],
                json!({ "trials": ["gathering-1"], "preset": "small" }),
            ),
            ("tune", &[], json!({ "object": "cube" })),
            ("blind", &[("seeds", "8")], json!({ "domain": "tactile", "seeds": 8 })),
        ] {
            assert_eq!(form(kind, texts).request().unwrap().request, expected, "{kind}");
        }
    }

    #[test]
    fn what_is_missing_is_named() {
        for (kind, texts, words) in [
            ("expert", &[("total_steps", "many")][..], "many"),
            ("evaluation", &[], "which policy"),
            ("pretraining", &[("demonstrations", " ,")], "which demonstrations"),
            ("imitation", &[], "gathering-1"),
        ] {
            let problem = form(kind, texts).request().unwrap_err();
            assert!(problem.contains(words), "{problem}");
        }
    }

    #[test]
    fn every_field_belongs_to_its_request() {
        fn reads<T: DeserializeOwned>(request: Value) -> Result<(), serde_json::Error> {
            serde_json::from_value::<T>(request).map(drop)
        }
        for (idx, training) in TRAININGS.iter().enumerate() {
            let mut state =
                StartState { training: idx, model: Some("mine".to_owned()), ..StartState::default() };
            for field in training.fields {
                match *field {
                    Field::Object | Field::Model => {}
                    Field::Objects { slot, .. } => {
                        state.choices.insert(slot, "all");
                    }
                    Field::Policy(_) => {
                        state.texts.insert("policy", "cube".to_owned());
                    }
                    Field::Job { key, .. } => {
                        state.texts.insert(key, "job-1".to_owned());
                    }
                    Field::Jobs { key, .. } => {
                        state.texts.insert(key, "job-1, job-2".to_owned());
                    }
                    Field::Number { key, .. } => {
                        state.texts.insert(key, "7".to_owned());
                    }
                    Field::Choice { key, choices, .. } => {
                        state.choices.insert(key, choices[choices.len() - 1]);
                    }
                    Field::Flag { key, .. } => {
                        state.flags.insert(key);
                    }
                }
            }
            let mut num_fields = training.fields.len();
            if training.kind == "imitation" {
                // A policy of the paper says what these two say.
                assert!(
                    state.request().unwrap_err().starts_with("What predicts: the policy \"pretrained-bc\"")
                );
                state.choices.remove("head");
                assert!(state.request().unwrap_err().starts_with("Features of touch: the policy"));
                state.flags.remove("features");
                num_fields -= 2;
            }
            let request = state.request().unwrap();
            assert_eq!(request.request.as_object().unwrap().len(), num_fields, "{request:?}");
            let read = match training.kind {
                "expert" => reads::<ExpertRequest>(request.request),
                "evaluation" => reads::<EvaluationRequest>(request.request),
                "demonstrations" => reads::<DemonstrationsRequest>(request.request),
                "pretraining" => reads::<PretrainingRequest>(request.request),
                "gathering" => reads::<GatheringRequest>(request.request),
                "imitation" => reads::<ImitationRequest>(request.request),
                "pipeline" => reads::<PipelineRequest>(request.request),
                "tune" => reads::<TuneRequest>(request.request),
                "blind" => reads::<BlindRequest>(request.request),
                other => panic!("{other} is no kind of training"),
            };
            assert!(read.is_ok(), "{}: {read:?}", training.kind);
        }
    }

    #[test]
    fn choices_are_those_of_the_studio_and_each_has_a_line_of_help() {
        let choices_of = |kind: &str, wanted: &str| {
            let fields = TRAININGS.iter().filter(|training| training.kind == kind).flat_map(|one| one.fields);
            let mut choices = fields.filter_map(|field| match field {
                Field::Choice { key, choices, .. } if *key == wanted => Some(*choices),
                _ => None,
            });
            choices.next().unwrap()
        };
        for (kind, key, known) in [
            ("imitation", "policy", &PAPER_POLICIES[..]),
            ("imitation", "head", &HEADS),
            ("imitation", "memory", &MEMORIES),
            ("gathering", "expert", &EXPERTS),
        ] {
            let choices = choices_of(kind, key);
            assert_eq!(choices[1..], *known, "{key}");
            assert!(choices.iter().all(|choice| !help(key, choice).is_empty()), "{key}");
        }
    }

    #[test]
    fn choice_of_another_training_is_not_carried_over() {
        let mut state = form("expert", &[]);
        state.choices.insert("preset", "quick");
        state.training = form("imitation", &[]).training;
        state.texts.insert("trials", "gathering-1".to_owned());
        assert_eq!(state.request().unwrap().request["preset"], "small");
    }

    #[test]
    fn parts_of_an_evaluation_share_the_objects_of_a_protocol() {
        let mut state = form("evaluation", &[("policy", "imitation-1")]);
        state.needs.parts = 3;
        assert!(state.request().unwrap_err().contains("choose a protocol"));
        state.choices.insert("protocol", "wide");
        assert!(state.request().unwrap_err().contains("which objects"));
        state.choices.insert("scored", "all");
        let request = state.request().unwrap();
        assert_eq!(
            request.request,
            json!({ "policy": "imitation-1", "protocol": "wide", "objects": ["all"] })
        );
        let resources = request.resources.unwrap();
        assert_eq!((resources.shards, resources.cores, resources.at_once), (3, 1, 0));
        state.choices.insert("protocol", "");
        state.needs.parts = 1;
        assert!(state.request().unwrap_err().contains("objects belong to a protocol"));
    }

    #[test]
    fn a_pipeline_has_its_seeds_in_its_configuration() {
        let state = StartState { seed: 7, ..form("pipeline", &[]) };
        assert_eq!(state.request().unwrap().seed, 0);
        let state = StartState { seed: 7, ..form("tune", &[]) };
        assert_eq!(state.request().unwrap().seed, 7);
    }
}
