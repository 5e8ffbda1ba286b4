//! Controls that more than one screen has: choices, buttons with symbols, the playing speed, the model to compare with.

use egui::accesskit::Role;
use palpate_wire::api::{CalibrationRequest, DiagnosisRequest, JobState, Role as PersonRole, Run, Scope};

use super::ScreenContext;
use crate::{
    api_client::segment,
    playback::{ModelRef, Playback},
};

/// Names a button by a word where its face shows a symbol.
pub fn name_button(response: &egui::Response, label: &str) {
    response.widget_info(|| egui::WidgetInfo::labeled(Role::Button, true, label));
}

/// A link to a file of the server, which the browser keeps: `path` below `/api/v1`, with `ids` in the places of `{}`. Its
/// name is `label`, which may say more than `face` shows.
pub fn file_link_ui(ui: &mut egui::Ui, face: &str, label: &str, path: &str, ids: &[&str]) -> egui::Response {
    let path = ids.iter().fold(path.to_owned(), |path, id| path.replacen("{}", &segment(id), 1));
    let link = ui.hyperlink_to(face, format!("/api/v1/{path}"));
    link.widget_info(|| egui::WidgetInfo::labeled(Role::Link, true, label));
    link
}

/// A combo box called `label` that shows `chosen`; `contents` are its [`option_ui`]s.
pub fn combo_ui(
    ui: &mut egui::Ui,
    label: &str,
    chosen: &str,
    width: f32,
    contents: impl FnOnce(&mut egui::Ui),
) -> egui::Response {
    egui::ComboBox::from_id_salt(label)
        .selected_text(chosen)
        .width(width)
        .height(420.0)
        .show_ui(ui, contents)
        .response
        .accessible_name(label)
}

/// A line of a combo box, with the role that belongs there.
pub fn option_ui<T: PartialEq>(ui: &mut egui::Ui, chosen: &mut T, value: T, text: &str) {
    let is_chosen = *chosen == value;
    let response = ui.selectable_value(chosen, value, text);
    response.widget_info(|| egui::WidgetInfo::selected(Role::ListBoxOption, true, is_chosen, text));
}

/// Whether whoever sits here may start and end jobs; where they may not, that is said.
pub fn may_start_jobs_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>) -> bool {
    let Some(me) = cx.store.people.lacks(PersonRole::Operator, Scope::Jobs) else { return true };
    let text = format!("You are {} ({}): you can watch. Operators start and end jobs.", me.name, me.role);
    ui.add(egui::Label::new(text).wrap());
    false
}

/// How fast a take plays.
pub fn speed_ui(ui: &mut egui::Ui, playback: &mut Playback) {
    let text = |speed: f64| format!("{speed}\u{d7}");
    let chosen = text(playback.speed);
    combo_ui(ui, "Speed", &chosen, 64.0, |ui| {
        for speed in Playback::SPEEDS {
            option_ui(ui, &mut playback.speed, speed, &text(speed));
        }
    });
}

/// Which simulation is the blue one: saved models, and what finished calibrations of this session found.
pub fn compared_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>) {
    let mut choices = saved_models(cx, false);
    if let Some(runs) = cx.store.runs().ready() {
        choices.extend(unsaved_runs(cx, runs).map(|id| ModelRef::Run(id.clone())));
    }
    let chosen = cx.playback.compared.clone();
    let empty = "Calibrate a session to have more to compare with.";
    let (response, chosen) = model_ui(ui, cx, "Compare with", "nominal only", choices, chosen, empty);
    response.on_hover_text("The simulation in blue, beside the nominal one");
    cx.playback.compared = chosen;
}

/// Which simulation is the green one: saved models with effects, and what finished diagnoses of this session named.
pub fn diagnosed_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>) {
    let mut choices = saved_models(cx, true);
    if let Some(runs) = cx.store.diagnoses().ready() {
        choices.extend(unsaved_runs(cx, runs).map(|id| ModelRef::Diagnosis(id.clone())));
    }
    let chosen = cx.playback.diagnosed.clone();
    let empty = "Diagnose a session to have a model with effects.";
    let (response, chosen) = model_ui(ui, cx, "With effects", "without effects", choices, chosen, empty);
    response.on_hover_text("The simulation in green: a model with effects that a diagnosis named");
    cx.playback.diagnosed = chosen;
}

fn saved_models(cx: &mut ScreenContext<'_>, with_effects: bool) -> Vec<ModelRef> {
    let models = cx.store.models();
    let models = models.ready().map_or(&[][..], |models| models.as_slice());
    let fitting = models
        .iter()
        .filter(|model| model.id != ModelRef::Nominal.key() && model.effects.is_empty() != with_effects);
    fitting.map(|model| ModelRef::Saved(model.id.clone())).collect()
}

/// A request about one session.
pub trait OfSession {
    /// Its id.
    fn session(&self) -> &str;
}

impl OfSession for CalibrationRequest {
    fn session(&self) -> &str {
        &self.session
    }
}

impl OfSession for DiagnosisRequest {
    fn session(&self) -> &str {
        &self.session
    }
}

/// Ids of the finished runs of this session whose result was not saved.
fn unsaved_runs<'a, Q: OfSession, R>(
    cx: &'a ScreenContext<'_>,
    runs: &'a [Run<Q, R>],
) -> impl Iterator<Item = &'a String> {
    let mine = runs.iter().filter(|run| {
        run.state == JobState::Done
            && run.saved_as.is_none()
            && Some(run.request.session()) == cx.playback.session.as_deref()
    });
    mine.map(|run| &run.id)
}

fn model_ui(
    ui: &mut egui::Ui,
    cx: &mut ScreenContext<'_>,
    label: &str,
    none: &str,
    mut choices: Vec<ModelRef>,
    mut chosen: Option<ModelRef>,
    empty: &str,
) -> (egui::Response, Option<ModelRef>) {
    if let Some(current) = &chosen
        && !choices.contains(current)
    {
        choices.insert(0, current.clone());
    }
    let text = |cx: &mut ScreenContext<'_>, model: &Option<ModelRef>| match model {
        None => none.to_owned(),
        model => cx.store.compared_label(model.as_ref()),
    };
    let chosen_text = text(cx, &chosen);
    let response = combo_ui(ui, label, &chosen_text, 190.0, |ui| {
        option_ui(ui, &mut chosen, None, none);
        for choice in choices.iter().cloned().map(Some) {
            let text = text(cx, &choice);
            option_ui(ui, &mut chosen, choice, &text);
        }
        if choices.is_empty() {
            ui.label(empty);
        }
    });
    (response, chosen)
}
