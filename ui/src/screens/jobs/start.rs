//! The form that starts a training: every kind of job that `palpate-train` does.

use egui::RichText;
use palpate_wire::api::{
    DemonstrationsRequest, EvaluationRequest, ExpertRequest, Job, JobRequest, JobState, PretrainingRequest,
    TuneRequest,
};

use super::super::{
    ScreenContext,
    controls::{combo_ui, option_ui},
    copy_as,
};
use crate::store::Loadable;

/// What can be started.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Training {
    #[default]
    Expert,
    Evaluation,
    Demonstrations,
    Pretraining,
    Tune,
}

impl Training {
    const ALL: [Self; 5] =
        [Self::Expert, Self::Evaluation, Self::Demonstrations, Self::Pretraining, Self::Tune];

    /// As requests name it.
    fn kind(self) -> &'static str {
        match self {
            Self::Expert => "expert",
            Self::Evaluation => "evaluation",
            Self::Demonstrations => "demonstrations",
            Self::Pretraining => "pretraining",
            Self::Tune => "tune",
        }
    }

    fn words(self) -> &'static str {
        match self {
            Self::Expert => "Train an expert",
            Self::Evaluation => "Evaluate a policy",
            Self::Demonstrations => "Make demonstrations",
            Self::Pretraining => "Pretrain the encoder",
            Self::Tune => "Tune a script",
        }
    }

    fn explained(self) -> &'static str {
        match self {
            Self::Expert => {
                "Learns to grasp one object by touch in simulation: minutes to hours on every core."
            }
            Self::Evaluation => "Scores a policy in fresh trials in simulation.",
            Self::Demonstrations => {
                "Rolls a policy out in simulation and keeps the trials that succeed, to learn from."
            }
            Self::Pretraining => "Teaches the tactile encoder what demonstrations know beyond touch.",
            Self::Tune => "Makes a closing script better on one object, by trying variants of it.",
        }
    }
}

/// What the operator filled in.
#[derive(Debug)]
pub(super) struct StartState {
    training: Training,
    object: String,
    policy: String,
    demonstrations: String,
    preset: String,
    /// Steps, epochs, trials, demonstrations or generations; empty means the usual number.
    number: String,
    protocol: Option<String>,
    silence_touch: bool,
    model: Option<String>,
    seed: u64,
}

impl Default for StartState {
    fn default() -> Self {
        Self {
            training: Training::default(),
            object: "cube".to_owned(),
            policy: String::new(),
            demonstrations: String::new(),
            preset: "quick".to_owned(),
            number: String::new(),
            protocol: None,
            silence_touch: false,
            model: None,
            seed: 1,
        }
    }
}

impl StartState {
    /// What is asked for, or what is missing.
    fn request(&self) -> Result<JobRequest, String> {
        let number = match self.number.trim() {
            "" => None,
            text => match text.parse::<u64>() {
                Ok(number) if number > 0 => Some(number),
                _ => return Err(format!("{text:?} is no number above 0")),
            },
        };
        let policy = || match self.policy.trim() {
            "" => Err("which policy? Give a job such as expert-1, or a shipped one such as cube".to_owned()),
            policy => Ok(policy.to_owned()),
        };
        let model = self.model.clone();
        let request = match self.training {
            Training::Expert => value(&ExpertRequest {
                object: self.object.clone(),
                preset: Some(self.preset.clone()),
                total_steps: number,
                silence_touch: self.silence_touch,
                model,
                ..ExpertRequest::default()
            }),
            Training::Evaluation => value(&EvaluationRequest {
                policy: policy()?,
                trials: number,
                protocol: self.protocol.clone(),
                silence_touch: self.silence_touch,
                model,
                ..EvaluationRequest::default()
            }),
            Training::Demonstrations => value(&DemonstrationsRequest {
                policy: policy()?,
                count: number.unwrap_or(64),
                model,
                ..DemonstrationsRequest::default()
            }),
            Training::Pretraining => {
                let words =
                    self.demonstrations.split([',', ' ']).map(str::trim).filter(|word| !word.is_empty());
                let demonstrations: Vec<String> = words.map(str::to_owned).collect();
                if demonstrations.is_empty() {
                    return Err("which demonstrations? Give jobs such as demonstrations-1".to_owned());
                }
                value(&PretrainingRequest {
                    demonstrations,
                    preset: Some(self.preset.clone()),
                    epochs: number,
                    silence_touch: self.silence_touch,
                    ..PretrainingRequest::default()
                })
            }
            Training::Tune => value(&TuneRequest {
                object: self.object.clone(),
                generations: number,
                model,
                ..TuneRequest::default()
            }),
        };
        Ok(JobRequest {
            kind: self.training.kind().to_owned(),
            request,
            seed: self.seed,
            priority: 0,
            resources: None,
            runner: None,
        })
    }
}

/// A request without what was left to the studio.
fn value(request: &impl serde::Serialize) -> serde_json::Value {
    // Plain data always serialises.
    let mut value = serde_json::to_value(request).unwrap_or_default();
    if let Some(fields) = value.as_object_mut() {
        fields.retain(|_, value| !value.is_null() && *value != serde_json::Value::Bool(false));
    }
    value
}

/// The form. `jobs` are those that are known.
pub(super) fn start_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, state: &mut StartState, jobs: &[Job]) {
    ui.heading("Start a training");
    ui.horizontal_wrapped(|ui| {
        combo_ui(ui, "What to start", state.training.words(), 190.0, |ui| {
            for training in Training::ALL {
                option_ui(ui, &mut state.training, training, training.words());
            }
        });
    });
    ui.add(egui::Label::new(RichText::new(state.training.explained()).color(cx.palette.text_weak)).wrap());
    ui.add_space(6.0);
    egui::Grid::new("start_training").num_columns(2).spacing([14.0, 6.0]).show(ui, |ui| {
        fields_ui(ui, cx, state, jobs);
    });
    ui.add_space(6.0);
    let problem = match cx.store.jobs.kinds() {
        Loadable::Ready(kinds) => {
            kinds.iter().find(|kind| kind.kind == state.training.kind()).and_then(|kind| kind.problem.clone())
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
            let can = problem.is_none() && !is_on_its_way;
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

fn fields_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, state: &mut StartState, jobs: &[Job]) {
    let training = state.training;
    if matches!(training, Training::Expert | Training::Tune) {
        ui.label("Object");
        let objects = cx.store.objects();
        combo_ui(ui, "Object to grasp", &state.object.clone(), 160.0, |ui| {
            for object in objects.ready().map_or(&[][..], |objects| objects.as_slice()) {
                option_ui(ui, &mut state.object, object.id.clone(), &object.id);
            }
        });
        ui.end_row();
    }
    if matches!(training, Training::Evaluation | Training::Demonstrations) {
        text_ui(ui, "Policy", "expert-1 or cube", &mut state.policy, done(jobs, "expert"));
    }
    if training == Training::Pretraining {
        let known = done(jobs, "demonstrations");
        text_ui(ui, "Demonstrations", "demonstrations-1", &mut state.demonstrations, known);
    }
    if matches!(training, Training::Expert | Training::Pretraining) {
        ui.label("Preset");
        combo_ui(ui, "Preset", &state.preset.clone(), 100.0, |ui| {
            for preset in ["quick", "paper"] {
                option_ui(ui, &mut state.preset, preset.to_owned(), preset);
            }
        });
        ui.end_row();
    }
    let (name, usual) = match training {
        Training::Expert => ("Steps", "as the preset says"),
        Training::Evaluation => ("Trials", "50, or the protocol's"),
        Training::Demonstrations => ("How many", "64"),
        Training::Pretraining => ("Epochs", "as the preset says"),
        Training::Tune => ("Generations", "8"),
    };
    text_ui(ui, name, usual, &mut state.number, Vec::new());
    if training == Training::Evaluation {
        ui.label("Protocol");
        let chosen = state.protocol.clone().unwrap_or_else(|| "none".to_owned());
        combo_ui(ui, "Protocol", &chosen, 120.0, |ui| {
            option_ui(ui, &mut state.protocol, None, "none");
            for protocol in ["paper", "wide", "wide_20s", "claim"] {
                option_ui(ui, &mut state.protocol, Some(protocol.to_owned()), protocol);
            }
        });
        ui.end_row();
    }
    if training != Training::Pretraining {
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
        ui.end_row();
    }
    if matches!(training, Training::Expert | Training::Evaluation | Training::Pretraining) {
        ui.label("Touch");
        ui.checkbox(&mut state.silence_touch, "feels nothing");
        ui.end_row();
    }
    let label = ui.label("Seed");
    ui.add(egui::DragValue::new(&mut state.seed)).labelled_by(label.id);
    ui.end_row();
}

/// A line to fill in; what is known fills it by a press.
fn text_ui(ui: &mut egui::Ui, name: &str, hint: &str, text: &mut String, known: Vec<&str>) {
    let label = ui.label(name);
    ui.horizontal_wrapped(|ui| {
        let field = egui::TextEdit::singleline(text).desired_width(170.0).char_limit(400).hint_text(hint);
        ui.add(field).labelled_by(label.id);
        for id in known.into_iter().take(3) {
            if ui.button(id).clicked() {
                *text = id.to_owned();
            }
        }
    });
    ui.end_row();
}

/// Ids of the jobs of `kind` that are done, newest first.
fn done<'a>(jobs: &'a [Job], kind: &str) -> Vec<&'a str> {
    let done = jobs.iter().filter(|job| job.kind == kind && job.state == JobState::Done);
    done.map(|job| job.id.as_str()).collect()
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn request_says_what_was_chosen_and_leaves_the_rest_to_the_studio() {
        let mut state = StartState { number: " 4000 ".to_owned(), ..StartState::default() };
        let request = state.request().unwrap();
        assert_eq!(request.request, json!({ "object": "cube", "preset": "quick", "total_steps": 4000 }));
        assert_eq!((request.kind.as_str(), request.seed), ("expert", 1));
        state.number = "many".to_owned();
        assert!(state.request().unwrap_err().contains("many"));
        state = StartState { training: Training::Evaluation, ..StartState::default() };
        assert!(state.request().unwrap_err().contains("which policy"));
        state.policy = "expert-2".to_owned();
        state.silence_touch = true;
        assert_eq!(state.request().unwrap().request, json!({ "policy": "expert-2", "silence_touch": true }));
        state.training = Training::Demonstrations;
        assert_eq!(state.request().unwrap().request, json!({ "policy": "expert-2", "count": 64 }));
        state.training = Training::Pretraining;
        assert!(state.request().is_err());
        state.demonstrations = "demonstrations-1, demonstrations-2".to_owned();
        let asked = state.request().unwrap().request;
        assert_eq!(asked["demonstrations"], json!(["demonstrations-1", "demonstrations-2"]));
        state.training = Training::Tune;
        assert_eq!(state.request().unwrap().request, json!({ "object": "cube" }));
    }
}
