//! Calibrate: choose, run, see, keep.

mod objective;
mod results;
mod tables;

use std::{collections::BTreeSet, sync::Arc};

use egui::RichText;
use palpate_wire::api::{CalibrationRequest, CalibrationRun, JobState, SessionDetail};

use super::{ScreenContext, duration_text, empty_ui, failed_ui, loading_ui, words};
use crate::{
    playback::ModelRef,
    route::{Route, Screen},
    store::Loadable,
};

/// What the operator chose on this screen and has not run yet.
#[derive(Debug, Default)]
pub struct CalibrateState {
    use_grid: bool,
    /// Takes to hold out, chosen by hand; `None` leaves the choice to the server.
    hold_out: Option<BTreeSet<String>>,
    /// The session that `hold_out` belongs to.
    session: Option<String>,
    model_name: String,
    waits_for_start: bool,
    /// The run whose result was taken over as the compared model already.
    taken_over: Option<String>,
    table: tables::Table,
}

/// The screen.
pub fn calibrate_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, state: &mut CalibrateState) {
    let sessions = match cx.store.sessions() {
        Loadable::Ready(sessions) => sessions,
        Loadable::Failed(error) => return failed_ui(ui, cx, "The list of sessions did not arrive", &error),
        Loadable::Idle | Loadable::Loading => return loading_ui(ui, "Looking for sessions"),
    };
    if sessions.iter().all(|session| session.error.is_some()) {
        let text =
            "Calibration fits the simulator's sense of touch to recorded takes. It needs a session first.";
        if empty_ui(ui, "Nothing to calibrate on", text, "Bring in a session") {
            cx.go_to_screen(Screen::Sessions);
        }
        return;
    }
    let chosen = cx.playback.session.clone().filter(|id| sessions.iter().any(|session| session.id == *id));
    let first = || sessions.iter().find(|session| session.error.is_none()).map(|session| session.id.clone());
    if let Some(session) = chosen.or_else(first) {
        cx.playback.open_session(&session);
    }
    follow_started_run(cx, state);

    egui::Panel::left("calibrate_choice").resizable(false).exact_size(292.0).show(ui, |ui| {
        egui::ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
            choose_ui(ui, cx, state, &sessions);
            ui.add_space(12.0);
            earlier_runs_ui(ui, cx);
        });
    });
    egui::CentralPanel::default().show(ui, |ui| match cx.route.run.clone() {
        Some(run_id) => run_ui(ui, cx, state, &run_id),
        None => intro_ui(ui),
    });
}

fn intro_ui(ui: &mut egui::Ui) {
    ui.add_space((ui.available_height() * 0.25).min(180.0));
    ui.vertical_centered(|ui| {
        ui.set_max_width(520.0);
        ui.heading("Make the simulator feel what the hand felt");
        ui.label(
            "A calibration replays every take, then looks for the three parameters of the sensor model with which \
             simulated touch events differ least from the recorded ones. It is judged on takes it has not seen.",
        );
        ui.add_space(6.0);
        ui.label("Choose a session on the left and press Calibrate.");
    });
}

/// Goes to the run that the button started, once the server has it.
fn follow_started_run(cx: &mut ScreenContext<'_>, state: &mut CalibrateState) {
    if !state.waits_for_start {
        return;
    }
    match &cx.store.started_run {
        Loadable::Ready(run_id) => {
            state.waits_for_start = false;
            *cx.go_to = Some(route_to_run(cx, run_id));
        }
        Loadable::Failed(_) => state.waits_for_start = false,
        Loadable::Idle | Loadable::Loading => {}
    }
}

fn route_to_run(cx: &ScreenContext<'_>, run_id: &str) -> Route {
    Route {
        session: cx.playback.session.clone(),
        run: Some(run_id.to_owned()),
        ..Route::to(Screen::Calibrate)
    }
}

fn choose_ui(
    ui: &mut egui::Ui,
    cx: &mut ScreenContext<'_>,
    state: &mut CalibrateState,
    sessions: &[palpate_wire::api::SessionSummary],
) {
    ui.add_space(4.0);
    ui.heading("1  Choose");
    let mut session = cx.playback.session.clone().unwrap_or_default();
    ui.horizontal(|ui| {
        let label = ui.label("Session");
        egui::ComboBox::from_id_salt("calibrate_session")
            .selected_text(&session)
            .width(ui.available_width() - 8.0)
            .show_ui(ui, |ui| {
                for known in sessions.iter().filter(|known| known.error.is_none()) {
                    ui.selectable_value(&mut session, known.id.clone(), &known.id);
                }
            })
            .response
            .labelled_by(label.id);
    });
    if cx.playback.session.as_ref() != Some(&session) {
        cx.playback.open_session(&session);
        *cx.go_to = Some(Route::to(Screen::Calibrate).with_session(session.clone()));
    }
    if state.session.as_ref() != Some(&session) {
        state.session = Some(session.clone());
        state.hold_out = None;
    }

    ui.label("Search");
    ui.radio_value(&mut state.use_grid, false, "Exact: best of all thresholds")
        .on_hover_text("One sort per alpha finds the best threshold over all real values");
    ui.radio_value(&mut state.use_grid, true, "Grid: 20 × 20 × 20, as in the paper");

    ui.add_space(4.0);
    ui.label("Takes kept for judging");
    let detail = cx.store.session(&session);
    match &detail {
        Loadable::Ready(detail) => hold_out_ui(ui, state, detail),
        Loadable::Failed(error) => {
            ui.colored_label(cx.palette.mismatch, error);
        }
        Loadable::Idle | Loadable::Loading => {
            ui.spinner();
        }
    }

    ui.add_space(8.0);
    ui.heading("2  Run");
    let running = running_run(cx);
    let problem = detail.ready().and_then(|detail| problem_with_choice(state, detail));
    let ready = running.is_none() && detail.ready().is_some() && problem.is_none() && !state.waits_for_start;
    let size = egui::vec2(ui.available_width() - 8.0, 40.0);
    let text = RichText::new("Calibrate").strong().size(16.0).color(cx.palette.surface);
    let button = egui::Button::new(text).fill(cx.palette.calibrated);
    let response = ui.add_enabled_ui(ready, |ui| ui.add_sized(size, button)).inner;
    // The rail has a button of that name already.
    response
        .widget_info(|| egui::WidgetInfo::labeled(egui::accesskit::Role::Button, ready, "Start calibration"));
    if response.clicked() {
        state.waits_for_start = true;
        cx.store.start_run(CalibrationRequest {
            session,
            method: Some(if state.use_grid { "grid" } else { "exact" }.to_owned()),
            hold_out: state.hold_out.as_ref().map(|takes| takes.iter().cloned().collect()),
        });
    }
    if let Some(problem) = problem {
        ui.colored_label(cx.palette.warning, problem);
    }
    if let Loadable::Failed(error) = &cx.store.started_run {
        ui.colored_label(cx.palette.mismatch, format!("The run did not start: {error}"));
    }
    if let Some(run) = running {
        progress_ui(ui, cx, &run);
    }
}

fn hold_out_ui(ui: &mut egui::Ui, state: &mut CalibrateState, detail: &SessionDetail) {
    let mut automatic = state.hold_out.is_none();
    if ui.checkbox(&mut automatic, "Choose for me (about a third)").changed() {
        state.hold_out = (!automatic).then(BTreeSet::new);
    }
    let Some(held_out) = &mut state.hold_out else { return };
    for take in &detail.takes {
        let mut held = held_out.contains(&take.id);
        let text = format!("{}: {}, {}", take.id, words(&take.primitive), take.object);
        let response = ui.checkbox(&mut held, egui::AtomExt::atom_shrink(text, true));
        if response.changed() {
            if held {
                held_out.insert(take.id.clone());
            } else {
                held_out.remove(&take.id);
            }
        }
    }
}

/// Why the chosen takes cannot be used, in words.
fn problem_with_choice(state: &CalibrateState, detail: &SessionDetail) -> Option<String> {
    let held_out = state.hold_out.as_ref()?;
    if held_out.is_empty() {
        Some("Tick at least one take to judge on.".to_owned())
    } else if held_out.len() >= detail.takes.len() {
        Some("Leave at least one take to fit on.".to_owned())
    } else {
        None
    }
}

fn is_running(run: &CalibrationRun) -> bool {
    matches!(run.state, JobState::Queued | JobState::Running)
}

fn running_run(cx: &mut ScreenContext<'_>) -> Option<CalibrationRun> {
    let runs = cx.store.runs();
    runs.ready()?.iter().find(|run| is_running(run)).cloned()
}

fn progress_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, run: &CalibrationRun) {
    let left = run.seconds_left.map(|s| format!(", {} left", duration_text(s))).unwrap_or_default();
    let bar = egui::ProgressBar::new(run.fraction as f32)
        .desired_width(ui.available_width() - 8.0)
        .text(format!("{:.0} %{left}", run.fraction * 100.0));
    ui.add(bar);
    ui.label(RichText::new(&run.stage).color(cx.palette.text_weak));
    if ui.button("Cancel").on_hover_text("Stop the run; nothing is saved").clicked() {
        cx.store.cancel_run(&run.id);
    }
    ui.ctx().request_repaint_after(std::time::Duration::from_millis(200));
}

fn earlier_runs_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>) {
    let Loadable::Ready(runs) = cx.store.runs() else { return };
    let mine: Vec<&CalibrationRun> = runs
        .iter()
        .filter(|run| Some(&run.request.session) == cx.playback.session.as_ref() && !is_running(run))
        .collect();
    if mine.is_empty() {
        return;
    }
    ui.separator();
    ui.label(RichText::new("Earlier runs").strong());
    for run in mine {
        let chosen = cx.route.run.as_ref() == Some(&run.id);
        let method = run.request.method.as_deref().unwrap_or("exact");
        let saved = run.saved_as.as_ref().map_or(String::new(), |model| format!(", saved as {model}"));
        let text = format!("{}  {method}, {}{saved}", run.id, state_text(run.state));
        let width = ui.available_width() - 8.0;
        let button = egui::Button::selectable(chosen, text).min_size(egui::vec2(width, 32.0)).right_text("");
        if ui.add(button).clicked() && !chosen {
            *cx.go_to = Some(route_to_run(cx, &run.id));
        }
    }
}

fn state_text(state: JobState) -> &'static str {
    match state {
        JobState::Queued => "waiting",
        JobState::Running => "running",
        JobState::Done => "done",
        JobState::Failed => "failed",
        JobState::Cancelled => "cancelled",
    }
}

fn run_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, state: &mut CalibrateState, run_id: &str) {
    let run: Arc<CalibrationRun> = match cx.store.run(run_id) {
        Loadable::Ready(run) => run,
        Loadable::Failed(error) => return failed_ui(ui, cx, &format!("Run {run_id} did not open"), &error),
        Loadable::Idle | Loadable::Loading => return loading_ui(ui, "Opening the run"),
    };
    match run.state {
        JobState::Queued | JobState::Running => loading_ui(ui, &run.stage),
        JobState::Failed => {
            let why = run.error.as_deref().unwrap_or("the server gave no reason");
            failed_ui(ui, cx, "The calibration failed", why);
        }
        JobState::Cancelled => {
            ui.add_space(80.0);
            ui.vertical_centered(|ui| {
                ui.heading("Cancelled");
                ui.label("This run was stopped before it was done. Press Calibrate to run it again.");
            });
        }
        JobState::Done => {
            let Some(report) = &run.report else { return loading_ui(ui, "Fetching the result") };
            if state.taken_over.as_deref() != Some(run_id) {
                state.taken_over = Some(run_id.to_owned());
                state.model_name = format!("{} {}", run.request.session, report.method);
                cx.playback.compared = Some(ModelRef::Run(run_id.to_owned()));
            }
            results::results_ui(ui, cx, state, &run, report);
        }
    }
}
