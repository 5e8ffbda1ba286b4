//! Calibrate: choose, run, see, keep.

mod objective;
mod results;
mod tables;

use std::sync::Arc;

use palpate_robot_model::TactileLayout;
use palpate_wire::api::{CalibrationRequest, CalibrationRun, JobState};

use super::{
    About, Part, ScreenContext, Subject, View, copy_as, empty_ui, failed_ui, heading_ui, is_missing,
    loading_ui, missing_session_ui,
    run_controls::{
        HoldOutChoice, cancelled_ui, earlier_runs_ui, newest_run_ui, open_a_session, progress_ui,
        route_to_run, session_ui, start_ui,
    },
    two_parts_ui,
};
use crate::{playback::ModelRef, route::Screen, store::Loadable};

/// This screen.
pub const ABOUT: About = About {
    label: "Calibrate",
    slug: "calibrate",
    key: Some(egui::Key::Num7),
    icon: "\u{2696}",
    purpose: "Fit the sensor model until simulated events line up with real ones",
    group: Some("Simulator"),
    document: ("calibration", None),
    subject: Subject::Session,
    needs_station: false,
    shows_stream: false,
    new: || Box::<CalibrateState>::default(),
};

/// What the operator chose on this screen and has not run yet.
#[derive(Debug, Default)]
struct CalibrateState {
    use_grid: bool,
    /// One theta for all streams of a kind; counts where a layout has several.
    shared_theta: bool,
    hold_out: HoldOutChoice,
    model_name: String,
    waits_for_start: bool,
    /// The run whose result was taken over as the compared model already.
    taken_over: Option<String>,
    table: tables::Table,
}

impl View for CalibrateState {
    fn ui(&mut self, ui: &mut egui::Ui, cx: &mut ScreenContext<'_>) {
        let sessions = match cx.store.sessions() {
            Loadable::Ready(sessions) => sessions,
            Loadable::Failed(error) => {
                return failed_ui(ui, cx, "The list of sessions did not arrive", &error);
            }
            Loadable::Idle | Loadable::Loading => return loading_ui(ui, "Looking for sessions"),
        };
        if sessions.iter().all(|session| session.error.is_some()) {
            let text = "Calibration fits the simulator's sense of touch to recorded takes. It needs a session first.";
            if empty_ui(ui, "Nothing to calibrate on", text, "Bring in a session") {
                cx.go_to_screen(Screen::Sessions);
            }
            return;
        }
        if let Some(session) = cx.route.session.clone().filter(|session| is_missing(cx, session)) {
            return missing_session_ui(ui, cx, &session);
        }
        open_a_session(cx, &sessions);
        follow_started_run(cx, self);

        let chosen = cx.route.run.clone();
        two_parts_ui(ui, "calibrate_choice", ["Choose and run", "Result"], chosen.as_deref(), |ui, part| {
            match part {
                Part::Choice => {
                    choose_ui(ui, cx, self, &sessions);
                    ui.add_space(12.0);
                    if let Loadable::Ready(runs) = cx.store.runs() {
                        let about = |request: &CalibrationRequest| {
                            let method = request.method.as_deref().unwrap_or("exact");
                            let shared = if request.shared_theta { ", one theta" } else { "" };
                            format!("{method}{shared}")
                        };
                        earlier_runs_ui(ui, cx, &runs, Screen::Calibrate, about);
                    }
                }
                Part::Chosen => match &chosen {
                    Some(run_id) => run_ui(ui, cx, self, run_id),
                    None => intro_ui(ui, cx),
                },
            }
        });
    }
}

fn intro_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>) {
    ui.add_space((ui.available_height() * 0.25).min(180.0));
    ui.vertical_centered(|ui| {
        ui.set_max_width(ui.available_width().min(520.0));
        heading_ui(ui, "Make the simulator feel what the hand felt");
        ui.label(
            "A calibration replays every take, then looks for the three parameters of the sensor model with which \
             simulated touch events differ least from the recorded ones. It is judged on takes it has not seen.",
        );
        ui.add_space(6.0);
        ui.label("Choose a session, and press Start calibration.");
        if let Loadable::Ready(runs) = cx.store.runs() {
            newest_run_ui(ui, cx, &runs, Screen::Calibrate);
        }
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
            *cx.go_to = Some(route_to_run(cx, Screen::Calibrate, run_id));
        }
        Loadable::Failed(_) => state.waits_for_start = false,
        Loadable::Idle | Loadable::Loading => {}
    }
}

fn choose_ui(
    ui: &mut egui::Ui,
    cx: &mut ScreenContext<'_>,
    state: &mut CalibrateState,
    sessions: &[palpate_wire::api::SessionSummary],
) {
    ui.add_space(4.0);
    super::topic_heading_ui(ui, "1  Choose", Screen::Calibrate);
    let session = session_ui(ui, cx, sessions, Screen::Calibrate);
    ui.label("Search");
    ui.radio_value(&mut state.use_grid, false, "Exact: best of all thresholds")
        .on_hover_text("One sort per alpha finds the best threshold over all real values");
    ui.radio_value(&mut state.use_grid, true, "Grid: 20 × 20 × 20, as in the paper");

    let station = cx.store.station(&session);
    let has_several = station.ready().is_some_and(|station| has_streams_of_a_kind(&station.layout));
    if has_several {
        ui.checkbox(&mut state.shared_theta, "One theta for all streams of a kind").on_hover_text(
            "Off, each stream gets a theta of its own: right where skins are of different make. On, they share one: right \
             where they are alike, or hardly touched",
        );
    }

    ui.add_space(4.0);
    ui.label("Takes kept for judging");
    let detail = cx.store.session(&session);
    let hold_out = state.hold_out.of(&session);
    hold_out.ui(ui, &detail, cx.palette.mismatch);
    let problem = detail.ready().and_then(|detail| hold_out.problem(detail));

    ui.add_space(8.0);
    heading_ui(ui, "2  Run");
    let running = running_run(cx);
    let ready = running.is_none() && detail.ready().is_some() && problem.is_none() && !state.waits_for_start;
    let request = CalibrationRequest {
        session,
        method: Some(if state.use_grid { "grid" } else { "exact" }.to_owned()),
        hold_out: state.hold_out.takes(),
        shared_theta: has_several && state.shared_theta,
    };
    let fill = cx.palette.calibrated;
    let starts = start_ui(ui, cx, ready, "Start calibration", fill);
    if problem.is_none() {
        copy_as::copy_ui(ui, &copy_as::calibration(&request, copy_as::DATA_FOLDER));
    }
    if starts {
        state.waits_for_start = true;
        cx.store.start_run(request);
    }
    if let Some(problem) = problem {
        ui.colored_label(cx.palette.warning, problem);
    }
    if let Loadable::Failed(error) = &cx.store.started_run {
        ui.colored_label(cx.palette.mismatch, format!("The run did not start: {error}"));
    }
    if let Some(run) = running
        && progress_ui(ui, cx, &run)
    {
        cx.store.cancel_run(&run.id);
    }
}

/// Whether a calibration fits a theta to each stream unless it is told otherwise.
fn has_streams_of_a_kind(layout: &TactileLayout) -> bool {
    let kinds = layout.streams.iter().map(|stream| stream.kind);
    kinds.enumerate().any(|(idx, kind)| layout.streams[..idx].iter().any(|other| other.kind == kind))
}

fn running_run(cx: &mut ScreenContext<'_>) -> Option<CalibrationRun> {
    let runs = cx.store.runs();
    runs.ready()?.iter().find(|run| run.is_unfinished()).cloned()
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
        JobState::Cancelled => cancelled_ui(ui, "Start calibration"),
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
