//! Diagnose: choose, run, see, keep. Find where simulation and hand disagree, name the missing effect, add it, show the
//! gap shrink.

mod bars;
mod details;
mod effects;
mod keep;
mod names;
mod references;
mod residual_map;
mod results;

use std::{collections::BTreeSet, sync::Arc};

use egui::RichText;
use palpate_reports::DiagnosisReport;
use palpate_wire::api::{DiagnosisRequest, DiagnosisRun, SessionSummary};

use super::{
    About, Part, ScreenContext, Subject, View,
    controls::{combo_ui, option_ui},
    copy_as, heading_ui, loaded_ui,
    run_controls::{
        HoldOutChoice, below_start_ui, earlier_runs_ui, follow_started_run, found_ui, intro_ui,
        open_session_ui, session_ui, start_ui, unfinished,
    },
    two_parts_ui, words,
};
use crate::{playback::ModelRef, route::Screen, store::Loadable};

/// Null sessions behind a bar that is set here: as many as hold its 95 % point still.
const NULL_SESSIONS: usize = 200;

/// This screen.
pub const ABOUT: About = About {
    label: "Diagnose",
    slug: "diagnose",
    key: Some(egui::Key::Num8),
    icon: "\u{1f50d}",
    purpose: "Find where simulation and hand disagree, name the missing effect, add it to the model",
    group: Some("Simulator"),
    document: ("diagnosis", None),
    subject: Subject::Session,
    needs_station: false,
    shows_stream: false,
    new: || Box::<DiagnoseState>::default(),
};

/// What stands where no run is shown.
const INTRO: [&str; 3] = [
    "Find out what the simulator lacks",
    "A diagnosis looks for where simulated and recorded touch disagree, tries every effect of the library there, and names \
     one only if it beats what chance gives on sessions with nothing missing. What it names can be added to the model, and \
     taken out again. Where nothing fits, it says so, and where.",
    "Start diagnosis",
];

/// What the operator chose on this screen.
#[derive(Debug, Default)]
struct DiagnoseState {
    hold_out: HoldOutChoice,
    /// Saved model to start from; `None` calibrates first.
    start_from: Option<String>,
    /// Most effects to name; `None` leaves it to the server.
    max_effects: Option<usize>,
    /// Effects left out of the library, by id.
    without: BTreeSet<String>,
    /// Sessions in which nothing is wrong, by id.
    references: BTreeSet<String>,
    sets_bar: bool,
    waits_for_start: bool,
    shown: Shown,
}

/// What the operator did with the result that is shown.
#[derive(Debug, Default)]
struct Shown {
    run: String,
    model_name: String,
    /// Named effects that are not to be added, by position; at first those that help too little.
    unticked: BTreeSet<usize>,
    /// Named effects whose evidence is open.
    open: BTreeSet<usize>,
    all_candidates: bool,
    residual_before: bool,
    /// Its report with names for people, once the station is known.
    named: Option<Arc<DiagnosisReport>>,
    /// What the run was saved as when the compared simulations were last set to it.
    in_use: Option<Option<String>>,
}

impl View for DiagnoseState {
    fn ui(&mut self, ui: &mut egui::Ui, cx: &mut ScreenContext<'_>) {
        let nothing = [
            "Nothing to diagnose",
            "Diagnosis names what the simulator lacks, from recorded takes. It needs a session first.",
        ];
        let Some(sessions) = open_session_ui(ui, cx, nothing) else { return };
        let started = cx.store.started_diagnosis.clone();
        follow_started_run(cx, &mut self.waits_for_start, &started, Screen::Diagnose);

        let chosen = cx.route.run.clone();
        two_parts_ui(ui, "diagnose_choice", ["Choose and run", "Result"], chosen.as_deref(), |ui, part| {
            match part {
                Part::Choice => {
                    choose_ui(ui, cx, self, &sessions);
                    ui.add_space(12.0);
                    if let Loadable::Ready(runs) = cx.store.diagnoses() {
                        earlier_runs_ui(ui, cx, &runs, Screen::Diagnose, about_request);
                    }
                    keep::models_ui(ui, cx);
                }
                Part::Chosen => match &chosen {
                    Some(run_id) => run_ui(ui, cx, self, run_id),
                    None => {
                        let runs = cx.store.diagnoses();
                        intro_ui(ui, cx, INTRO, &runs, Screen::Diagnose);
                    }
                },
            }
        });
    }
}

fn about_request(request: &DiagnosisRequest) -> String {
    let mut about: Vec<String> = request.model.iter().map(|model| format!("from {model}")).collect();
    if !request.without.is_empty() {
        let ids: Vec<String> = request.without.iter().map(|id| words(id)).collect();
        about.push(format!("without {}", ids.join(", ")));
    }
    if !request.references.is_empty() {
        about.push(format!("judged by {} reference sessions", request.references.len()));
    }
    about.join(", ")
}

fn choose_ui(
    ui: &mut egui::Ui,
    cx: &mut ScreenContext<'_>,
    state: &mut DiagnoseState,
    sessions: &[SessionSummary],
) {
    ui.add_space(4.0);
    super::topic_heading_ui(ui, "1  Choose", Screen::Diagnose);
    let session = session_ui(ui, cx, sessions, Screen::Diagnose);
    start_from_ui(ui, cx, state);
    ui.horizontal(|ui| {
        let label = ui.label("Most effects to name");
        let mut most = state.max_effects.unwrap_or(DEFAULT_MAX_EFFECTS);
        let field = egui::DragValue::new(&mut most).range(1..=MAX_EFFECTS);
        if ui.add(field).labelled_by(label.id).changed() {
            state.max_effects = Some(most);
        }
    });
    ui.checkbox(
        &mut state.sets_bar,
        egui::AtomExt::atom_shrink(format!("Set the bar on {NULL_SESSIONS} simulated sessions first"), true),
    )
    .on_hover_text(
        "Runs this whole diagnosis on sessions simulated with nothing missing, to learn what chance gives on this \
         station. Slow once; the bar is kept for the station.",
    );
    let of_references = references::references_ui(ui, &cx.palette, &mut state.references, sessions, &session);
    if !state.without.is_empty() {
        ui.label("Left out of the library");
        let mut brought_back = None;
        ui.horizontal_wrapped(|ui| {
            for id in &state.without {
                let button = ui.button(format!("{}  \u{2716}", words(id))).on_hover_text("Bring it back");
                let name = format!("Bring back {}", words(id));
                super::controls::name_button(&button, &name);
                if button.clicked() {
                    brought_back = Some(id.clone());
                }
            }
        });
        if let Some(id) = brought_back {
            state.without.remove(&id);
        }
    }
    let (may_start, problem) = state.hold_out.ui(ui, cx, &session);
    let (may_start, problem) = (may_start && of_references.is_none(), problem.or(of_references));

    ui.add_space(8.0);
    heading_ui(ui, "2  Run");
    let running = unfinished(&cx.store.diagnoses());
    let ready = running.is_none() && may_start && !state.waits_for_start;
    let fill = cx.palette.diagnosed;
    if start_ui(ui, cx, ready, "Start diagnosis", fill) {
        start(cx, state);
    }
    if problem.is_none()
        && let Some(request) = request(cx, state)
    {
        copy_as::copy_ui(ui, &copy_as::diagnosis(&request, copy_as::DATA_FOLDER));
    }
    let started = cx.store.started_diagnosis.clone();
    if below_start_ui(ui, cx, problem, &started, running.as_ref())
        && let Some(run) = running
    {
        cx.store.cancel_diagnosis(&run.id);
    }
}

/// Effects to name unless the operator says otherwise; the server's own default.
const DEFAULT_MAX_EFFECTS: usize = 8;
const MAX_EFFECTS: usize = 12;

/// Starts a run with what is chosen.
fn start(cx: &mut ScreenContext<'_>, state: &mut DiagnoseState) {
    let Some(request) = request(cx, state) else { return };
    state.waits_for_start = true;
    cx.store.start_diagnosis(request);
}

/// What is chosen.
fn request(cx: &ScreenContext<'_>, state: &mut DiagnoseState) -> Option<DiagnosisRequest> {
    let session = cx.playback.session.clone()?;
    Some(DiagnosisRequest {
        hold_out: state.hold_out.of(&session).takes(),
        session,
        model: state.start_from.clone(),
        max_effects: state.max_effects,
        without: state.without.iter().cloned().collect(),
        null_sessions: state.sets_bar.then_some(NULL_SESSIONS),
        references: state.references.iter().cloned().collect(),
    })
}

fn start_from_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, state: &mut DiagnoseState) {
    let models = cx.store.models();
    let models = models.ready().map_or(&[][..], |models| models.as_slice());
    let name_of = |id: &str| models.iter().find(|model| model.id == id).map(|model| model.name.clone());
    // A model that went to the trash is no start.
    state.start_from = state.start_from.take().filter(|id| models.is_empty() || name_of(id).is_some());
    let calibrate_first = "Calibrate first";
    let chosen = state.start_from.as_deref().and_then(name_of);
    ui.label("Start from");
    let width = ui.available_width() - 8.0;
    combo_ui(ui, "Start from", chosen.as_deref().unwrap_or(calibrate_first), width, |ui| {
        option_ui(ui, &mut state.start_from, None, calibrate_first);
        for model in models {
            option_ui(ui, &mut state.start_from, Some(model.id.clone()), &model.name);
        }
    });
}

fn run_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, state: &mut DiagnoseState, run_id: &str) {
    let run = cx.store.diagnosis(run_id);
    let Some(run) = loaded_ui(ui, cx, run, "Opening the run", &format!("Run {run_id} did not open")) else {
        return;
    };
    let Some(report) = found_ui(ui, cx, &run, "diagnosis") else {
        if run.is_unfinished() {
            steps_ui(ui, cx);
        }
        return;
    };
    if state.shown.run != run_id {
        mirror(state, &run.request);
        state.shown = Shown {
            run: run_id.to_owned(),
            model_name: format!("{} diagnosed", run.request.session),
            unticked: effects::weak(report).collect(),
            ..Shown::default()
        };
    }
    use_result(cx, &mut state.shown, &run);
    if state.shown.named.is_none()
        && let Loadable::Ready(station) = cx.store.station(&run.request.session)
    {
        state.shown.named = Some(Arc::new(names::named(report, &station)));
    }
    let named = state.shown.named.clone();
    let report = named.as_deref().unwrap_or(report);
    let begun = started_from(cx, &run);
    if results::results_ui(ui, cx, state, &run, report, &begun) {
        start(cx, state);
    }
}

/// The form says what the run that is open was asked for, so that "again" means that.
fn mirror(state: &mut DiagnoseState, request: &DiagnosisRequest) {
    state.start_from.clone_from(&request.model);
    state.max_effects = request.max_effects;
    state.without = request.without.iter().cloned().collect();
    state.sets_bar = request.null_sessions.is_some();
    state.references = request.references.iter().cloned().collect();
}

/// The model that a run started from, as its first step is called: only the station's own is nominal.
fn started_from(cx: &mut ScreenContext<'_>, run: &DiagnosisRun) -> Start {
    let Some(id) = run.request.model.as_deref().filter(|id| *id != ModelRef::Nominal.key()) else {
        return Start::Nominal;
    };
    let models = cx.store.models();
    let known = models.ready().and_then(|models| models.iter().find(|model| model.id == id));
    Start::Saved(known.map_or_else(|| id.to_owned(), |model| model.name.clone()))
}

/// What a diagnosis started from.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Start {
    /// The station's nominal model.
    Nominal,
    /// A saved model, by its name.
    Saved(String),
}

impl Start {
    /// In the middle of a sentence.
    fn word(&self) -> String {
        match self {
            Self::Nominal => "nominal".to_owned(),
            Self::Saved(name) => format!("at the start ({name})"),
        }
    }

    /// As a heading.
    fn title(&self) -> String {
        match self {
            Self::Nominal => "Nominal".to_owned(),
            Self::Saved(name) => format!("Start: {name}"),
        }
    }

    /// Orange is the nominal simulation and nothing else.
    fn colour(&self, palette: &crate::theme::Palette) -> egui::Color32 {
        match self {
            Self::Nominal => palette.nominal,
            Self::Saved(_) => palette.text_weak,
        }
    }
}

/// The steps of a run, below what is being tried now; the bar with Cancel is on the left.
fn steps_ui(ui: &mut egui::Ui, cx: &ScreenContext<'_>) {
    ui.vertical_centered(|ui| {
        ui.set_max_width(ui.available_width().min(480.0));
        ui.label(
            RichText::new(
                "Find: where they differ. Name: one small dose of every effect at every place, then fits of the \
                 best. Show: judged on takes that nothing was fitted to.",
            )
            .color(cx.palette.text_weak),
        );
    });
}

/// Puts the simulations of this result beside the recording, whenever what it is saved as changes.
fn use_result(cx: &mut ScreenContext<'_>, shown: &mut Shown, run: &DiagnosisRun) {
    if shown.in_use.as_ref() == Some(&run.saved_as) {
        return;
    }
    shown.in_use = Some(run.saved_as.clone());
    cx.playback.compared = Some(ModelRef::Calibrated(run.id.clone()));
    cx.playback.diagnosed = Some(match &run.saved_as {
        Some(model) => ModelRef::Saved(model.clone()),
        None => ModelRef::Diagnosis(run.id.clone()),
    });
}
