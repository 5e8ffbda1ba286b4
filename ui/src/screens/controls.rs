//! Controls that more than one screen has: choices, buttons with symbols, the playing speed, the model to compare with.

use egui::accesskit::Role;
use palpate_wire::api::JobState;

use super::ScreenContext;
use crate::playback::{ModelRef, Playback};

/// Names a button by a word where its face shows a symbol.
pub fn name_button(response: &egui::Response, label: &str) {
    response.widget_info(|| egui::WidgetInfo::labeled(Role::Button, true, label));
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
    let mut choices: Vec<ModelRef> = Vec::new();
    if let Some(models) = cx.store.models().ready() {
        let saved = models.iter().filter(|model| model.id != ModelRef::Nominal.key());
        choices.extend(saved.map(|model| ModelRef::Saved(model.id.clone())));
    }
    if let Some(runs) = cx.store.runs().ready() {
        let unsaved = runs.iter().filter(|run| {
            run.state == JobState::Done
                && run.saved_as.is_none()
                && Some(&run.request.session) == cx.playback.session.as_ref()
        });
        choices.extend(unsaved.map(|run| ModelRef::Run(run.id.clone())));
    }
    if let Some(current) = &cx.playback.compared
        && !choices.contains(current)
    {
        choices.insert(0, current.clone());
    }
    let mut compared = cx.playback.compared.clone();
    let chosen_text = cx.store.compared_label(compared.as_ref());
    let response = combo_ui(ui, "Compare with", &chosen_text, 190.0, |ui| {
        option_ui(ui, &mut compared, None, &cx.store.compared_label(None));
        for choice in choices.iter().cloned().map(Some) {
            let text = cx.store.compared_label(choice.as_ref());
            option_ui(ui, &mut compared, choice, &text);
        }
        if choices.is_empty() {
            ui.label("Calibrate a session to have more to compare with.");
        }
    });
    response.on_hover_text("The simulation in blue, beside the nominal one");
    cx.playback.compared = compared;
}
