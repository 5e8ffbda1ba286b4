//! Calibrate: choose, run, see, keep.

mod objective;
mod results;
mod tables;

use palpate_robot_model::TactileLayout;
use palpate_wire::api::CalibrationRequest;

use super::{
    About, Part, ScreenContext, Subject, View, copy_as, heading_ui, loaded_ui,
    run_controls::{
        HoldOutChoice, below_start_ui, earlier_runs_ui, follow_started_run, found_ui, intro_ui,
        open_session_ui, session_ui, start_ui, unfinished,
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

/// What stands where no run is shown.
const INTRO: [&str; 3] = [
    "Make the simulator feel what the hand felt",
    "A calibration replays every take, then looks for the three parameters of the sensor model with which simulated touch \
     events differ least from the recorded ones. It is judged on takes it has not seen.",
    "Start calibration",
];

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
        let nothing = [
            "Nothing to calibrate on",
            "Calibration fits the simulator's sense of touch to recorded takes. It needs a session first.",
        ];
        let Some(sessions) = open_session_ui(ui, cx, nothing) else { return };
        let started = cx.store.started_run.clone();
        follow_started_run(cx, &mut self.waits_for_start, &started, Screen::Calibrate);

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
                    None => {
                        let runs = cx.store.runs();
                        intro_ui(ui, cx, INTRO, &runs, Screen::Calibrate);
                    }
                },
            }
        });
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

    let (may_start, problem) = state.hold_out.ui(ui, cx, &session);

    ui.add_space(8.0);
    heading_ui(ui, "2  Run");
    let running = unfinished(&cx.store.runs());
    let ready = running.is_none() && may_start && !state.waits_for_start;
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
    let started = cx.store.started_run.clone();
    if below_start_ui(ui, cx, problem, &started, running.as_ref())
        && let Some(run) = running
    {
        cx.store.cancel_run(&run.id);
    }
}

/// Whether a calibration fits a theta to each stream unless it is told otherwise.
fn has_streams_of_a_kind(layout: &TactileLayout) -> bool {
    let kinds = layout.streams.iter().map(|stream| stream.kind);
    kinds.enumerate().any(|(idx, kind)| layout.streams[..idx].iter().any(|other| other.kind == kind))
}

fn run_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, state: &mut CalibrateState, run_id: &str) {
    let run = cx.store.run(run_id);
    let Some(run) = loaded_ui(ui, cx, run, "Opening the run", &format!("Run {run_id} did not open")) else {
        return;
    };
    let Some(report) = found_ui(ui, cx, &run, "calibration") else { return };
    if state.taken_over.as_deref() != Some(run_id) {
        state.taken_over = Some(run_id.to_owned());
        state.model_name = format!("{} {}", run.request.session, report.method);
        cx.playback.compared = Some(ModelRef::Run(run_id.to_owned()));
    }
    results::results_ui(ui, cx, state, &run, report);
}
