//! Before a session: which plan, under which name.

use egui::RichText;
use palpate_wire::api::{PlanSummary, RecordingDocument, StartRecording, WantedTake};

use super::step::{decides_ui, primary_button_ui, take_control_ui};
use crate::{
    route::{Route, Screen},
    screens::{
        ScreenContext,
        controls::{combo_ui, name_button, option_ui},
        heading_ui,
        plans::{EXTENT_HINT, extent_text},
        topic_ui, words,
    },
    store::control::Holder,
};

/// What was chosen so far.
#[derive(Debug, Default)]
pub(super) struct StartState {
    plan_idx: usize,
    /// The plan that the address named last.
    asked: Option<String>,
    /// What is wanted, without the takes of a plan.
    only_wanted: bool,
    /// `None` until somebody types: then the name is made up.
    name: Option<String>,
}

pub(super) fn start_ui(
    ui: &mut egui::Ui,
    cx: &mut ScreenContext<'_>,
    state: &mut StartState,
    document: &RecordingDocument,
) {
    let plans = &document.plans;
    ui.add_space((ui.available_height() * 0.12).min(90.0));
    ui.vertical_centered(|ui| {
        ui.set_max_width(ui.available_width().min(520.0));
        heading_ui(ui, "Record a calibration session");
        topic_ui(ui, Screen::Record);
        ui.label(
            "A plan is a list of takes: in each, the robot touches one object in one way while everything is recorded. \
             This page leads through them, checks every take, and can be left and taken up again at any time.",
        );
        ui.add_space(12.0);
        // A link that names a plan chooses it, once.
        if let Some(asked) = cx.route.plan.as_ref().filter(|asked| state.asked.as_ref() != Some(asked)) {
            state.plan_idx = plans.iter().position(|plan| plan.id == *asked).unwrap_or(state.plan_idx);
            state.asked = Some(asked.clone());
        }
        let Some(plan) = plans.get(state.plan_idx).or(plans.first()) else {
            ui.label(RichText::new("This station has no plan").strong());
            ui.label(
                "Name one in the station's file, e.g. plans = [\"../plans/nine_takes.toml\"], and start the server \
                 again.",
            );
            return;
        };
        form_ui(ui, cx, state, document, plan);
    });
}

fn form_ui(
    ui: &mut egui::Ui,
    cx: &mut ScreenContext<'_>,
    state: &mut StartState,
    document: &RecordingDocument,
    plan: &PlanSummary,
) {
    let wanted = &document.wanted;
    state.only_wanted &= !wanted.is_empty();
    let sessions = cx.store.sessions();
    let known: Vec<&str> = sessions
        .ready()
        .map_or_else(Vec::new, |sessions| sessions.iter().map(|session| session.id.as_str()).collect());
    let mut name = state
        .name
        .clone()
        .unwrap_or_else(|| free_name(if state.only_wanted { "next" } else { &plan.id }, &known));
    ui.horizontal_wrapped(|ui| {
        ui.label("Plan");
        combo_ui(ui, "Plan", &plan.label, 260.0, |ui| {
            for (idx, plan) in document.plans.iter().enumerate() {
                option_ui(ui, &mut state.plan_idx, idx, &plan.label);
            }
        });
        let look = ui.button("Look at it").on_hover_text("Its takes, and what they touch");
        name_button(&look, "Look at the plan");
        if look.clicked() {
            *cx.go_to = Some(Route { plan: Some(plan.id.clone()), ..Route::to(Screen::Plans) });
        }
    });
    if state.only_wanted {
        ui.label("Of this plan, only where objects stand and how the robot moves");
    } else {
        ui.label(extent_text(plan.takes, plan.duration_s)).on_hover_text(EXTENT_HINT);
    }
    if !wanted.is_empty() {
        ui.add_space(6.0);
        wanted_ui(ui, cx, state, wanted);
    }
    ui.add_space(6.0);
    let enter = ui
        .horizontal(|ui| {
            ui.label("Name");
            let field = egui::TextEdit::singleline(&mut name)
                .desired_width(260.0)
                .char_limit(60)
                .min_size(egui::vec2(0.0, 32.0));
            let response = ui.add(field).accessible_name("Session name");
            if response.changed() {
                state.name = Some(name.clone());
            }
            response.lost_focus() && ui.input(|input| input.key_pressed(egui::Key::Enter))
        })
        .inner;
    let name = name.trim();
    let problem = name_problem(name);
    if let Some(problem) = problem {
        ui.colored_label(cx.palette.warning, problem);
    } else if known.contains(&name) {
        ui.label("A session of this name is there. It goes on where it stopped if it follows the same plan.");
    }
    ui.add_space(10.0);
    let holder = cx.store.control.holder(cx.store.control_state());
    match &holder {
        Holder::Other(name) => return decides_ui(ui, cx, name),
        Holder::Nobody => take_control_ui(ui, cx),
        Holder::Me => {
            let live = cx.store.control.is_open() && cx.store.frozen_since(cx.now_s).is_none();
            let starts = cx.store.recording_busy;
            let ready = problem.is_none() && live && !starts;
            let face = if starts { "Starting\u{2026}" } else { "Start session  (Enter)" };
            let clicked = primary_button_ui(ui, &cx.palette, "Start session", face, ready).clicked();
            let enter = enter || {
                let free = ui.memory(|memory| memory.focused().is_none());
                free && ui.input(|input| input.modifiers.is_none() && input.key_pressed(egui::Key::Enter))
            };
            if (clicked || enter) && ready {
                cx.store.start_recording(StartRecording {
                    plan: plan.id.clone(),
                    session: name.to_owned(),
                    operator: cx.store.control.operator.trim().to_owned(),
                    only_wanted: state.only_wanted,
                });
                state.name = None;
            }
        }
    }
    if let Some(problem) = &cx.store.recording_problem {
        ui.add_space(6.0);
        ui.colored_label(cx.palette.mismatch, format!("\u{26a0} The session did not start: {problem}"));
    }
}

/// What the session records besides the plan, and why.
fn wanted_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, state: &mut StartState, wanted: &[WantedTake]) {
    ui.separator();
    ui.label(RichText::new("At the end, what was asked for").strong());
    for take in wanted {
        ui.horizontal(|ui| {
            ui.label(
                RichText::new(format!("{} on {}", words(&take.primitive), words(&take.object))).strong(),
            );
            let others = matches!(cx.store.control.holder(cx.store.control_state()), Holder::Other(_));
            let button = ui.add_enabled(!cx.store.wanted_busy && !others, egui::Button::new("Remove"));
            let name = format!("Remove {} on {}", words(&take.primitive), words(&take.object));
            name_button(&button, &name);
            if button.clicked() {
                cx.store.unwant(&take.object, &take.primitive);
            }
        });
        if !take.because.is_empty() {
            ui.label(RichText::new(&take.because).color(cx.palette.text_weak));
        }
    }
    ui.checkbox(&mut state.only_wanted, "Record only this, not the takes of the plan");
    if let Some(problem) = &cx.store.wanted_problem {
        ui.colored_label(cx.palette.mismatch, format!("\u{26a0} The list was not changed: {problem}"));
    }
    ui.separator();
}

/// The first name of the form `plan-1` that no session has.
pub(super) fn free_name(plan: &str, known: &[&str]) -> String {
    (1..)
        .map(|number| format!("{plan}-{number}"))
        .find(|name| !known.contains(&name.as_str()))
        .unwrap_or_else(|| plan.to_owned())
}

/// Why a session cannot be called so: its name becomes a folder.
pub(super) fn name_problem(name: &str) -> Option<&'static str> {
    let fits = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.');
    if name.is_empty() {
        Some("Give the session a name.")
    } else if !name.chars().all(fits) || name.starts_with('.') {
        Some("Letters, digits, - and _ only: the name becomes a folder.")
    } else {
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_free_and_fit_a_folder() {
        assert_eq!(free_name("nine", &["nine-1", "nine-3"]), "nine-2");
        assert!(name_problem("nine-2").is_none());
        for name in ["", "a/b", "..", "a b", "\u{e4}"] {
            assert!(name_problem(name).is_some(), "{name}");
        }
    }
}
