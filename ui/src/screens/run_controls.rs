//! What screens that start runs share: choose a session and the takes to judge on, watch, cancel, come back.

use std::{collections::BTreeSet, sync::Arc, time::Duration};

use egui::RichText;
use palpate_wire::api::{JobState, Run, SessionDetail, SessionSummary};

use super::{
    ScreenContext, announced_ui,
    controls::{OfSession, may_start_jobs_ui},
    duration_text, empty_ui, failed_ui, heading_ui, is_missing, loading_ui, missing_session_ui, progress_bar,
    sessions_ui, words,
};
use crate::{
    route::{Route, Screen},
    store::Loadable,
};

/// The sessions, one of which is open; `None` where there is none to work on, which the screen says then: `nothing` is a
/// heading and a sentence for where there is no session at all.
pub fn open_session_ui(
    ui: &mut egui::Ui,
    cx: &mut ScreenContext<'_>,
    [nothing, text]: [&str; 2],
) -> Option<Arc<Vec<SessionSummary>>> {
    let sessions = sessions_ui(ui, cx)?;
    if sessions.iter().all(|session| session.error.is_some()) {
        if empty_ui(ui, nothing, text, "Bring in a session") {
            cx.go_to_screen(Screen::Sessions);
        }
        return None;
    }
    if let Some(session) = cx.route.session.clone().filter(|session| is_missing(cx, session)) {
        missing_session_ui(ui, cx, &session);
        return None;
    }
    open_a_session(cx, &sessions);
    Some(sessions)
}

/// Opens the session that is chosen already, else the first that can be opened.
fn open_a_session(cx: &mut ScreenContext<'_>, sessions: &[SessionSummary]) {
    let chosen = cx.playback.session.clone().filter(|id| sessions.iter().any(|session| session.id == *id));
    let first = || sessions.iter().find(|session| session.error.is_none()).map(|session| session.id.clone());
    if let Some(session) = chosen.or_else(first) {
        cx.playback.open_session(&session);
    }
}

/// What stands where no run is shown: what one is for, how to start one with `button`, and a way to the newest result.
pub fn intro_ui<Q: OfSession, R>(
    ui: &mut egui::Ui,
    cx: &mut ScreenContext<'_>,
    [title, text, button]: [&str; 3],
    runs: &Loadable<Arc<Vec<Run<Q, R>>>>,
    screen: Screen,
) {
    ui.add_space((ui.available_height() * 0.25).min(180.0));
    ui.vertical_centered(|ui| {
        ui.set_max_width(ui.available_width().min(540.0));
        heading_ui(ui, title);
        ui.label(text);
        ui.add_space(6.0);
        ui.label(format!("Choose a session, and press {button}."));
        if let Loadable::Ready(runs) = runs {
            newest_run_ui(ui, cx, runs, screen);
        }
    });
}

/// A combo box with the sessions; gives the chosen one.
pub fn session_ui(
    ui: &mut egui::Ui,
    cx: &mut ScreenContext<'_>,
    sessions: &[SessionSummary],
    screen: Screen,
) -> String {
    let mut session = cx.playback.session.clone().unwrap_or_default();
    ui.horizontal(|ui| {
        let label = ui.label("Session");
        egui::ComboBox::from_id_salt((screen, "session"))
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
        *cx.go_to = Some(Route::to(screen).with_session(session.clone()));
    }
    session
}

/// Which takes are kept for judging.
#[derive(Debug, Default)]
pub struct HoldOutChoice {
    /// Chosen by hand; `None` leaves the choice to the server.
    takes: Option<BTreeSet<String>>,
    /// The session that they belong to.
    session: Option<String>,
}

impl HoldOutChoice {
    /// The choice for `session`; that for another one is forgotten.
    pub fn of(&mut self, session: &str) -> &mut Self {
        if self.session.as_deref() != Some(session) {
            *self = Self { takes: None, session: Some(session.to_owned()) };
        }
        self
    }

    /// Check boxes for the takes of `session`, or what stands in for them. Gives whether a run may start with what is
    /// chosen, and what is wrong with the choice.
    pub fn ui(
        &mut self,
        ui: &mut egui::Ui,
        cx: &mut ScreenContext<'_>,
        session: &str,
    ) -> (bool, Option<String>) {
        ui.add_space(4.0);
        ui.label("Takes kept for judging");
        let hold_out = self.of(session);
        match cx.store.session(session) {
            Loadable::Ready(detail) => {
                hold_out.takes_ui(ui, &detail);
                let problem = hold_out.problem(&detail);
                return (problem.is_none(), problem);
            }
            Loadable::Failed(why) => {
                ui.colored_label(cx.palette.mismatch, why);
            }
            Loadable::Idle | Loadable::Loading => {
                ui.spinner();
            }
        }
        (false, None)
    }

    fn takes_ui(&mut self, ui: &mut egui::Ui, detail: &SessionDetail) {
        let mut automatic = self.takes.is_none();
        if ui.checkbox(&mut automatic, "Choose for me (about a third)").changed() {
            self.takes = (!automatic).then(BTreeSet::new);
        }
        let Some(held_out) = &mut self.takes else { return };
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
    fn problem(&self, detail: &SessionDetail) -> Option<String> {
        let held_out = self.takes.as_ref()?;
        if held_out.is_empty() {
            Some("Tick at least one take to judge on.".to_owned())
        } else if held_out.len() >= detail.takes.len() {
            Some("Leave at least one take to fit on.".to_owned())
        } else {
            None
        }
    }

    /// For the request.
    pub fn takes(&self) -> Option<Vec<String>> {
        self.takes.as_ref().map(|takes| takes.iter().cloned().collect())
    }
}

/// The large button that starts a run: `text` on it in `fill`. True when pressed.
pub fn start_ui(
    ui: &mut egui::Ui,
    cx: &mut ScreenContext<'_>,
    ready: bool,
    text: &str,
    fill: egui::Color32,
) -> bool {
    let ready = may_start_jobs_ui(ui, cx) && ready;
    let size = egui::vec2(ui.available_width() - 8.0, 40.0);
    let text = RichText::new(text).strong().size(16.0).color(cx.palette.surface);
    let button = egui::Button::new(text).fill(fill);
    ui.add_enabled_ui(ready, |ui| ui.add_sized(size, button)).inner.clicked()
}

/// Goes to the run that the button started, once the server has it, and stops waiting for it.
pub fn follow_started_run(
    cx: &mut ScreenContext<'_>,
    waits: &mut bool,
    started: &Loadable<String>,
    screen: Screen,
) {
    if !*waits {
        return;
    }
    *waits = started.is_loading();
    if let Loadable::Ready(run_id) = started {
        *cx.go_to = Some(route_to_run(cx, screen, run_id));
    }
}

/// The run that is under way or waits for its turn.
pub fn unfinished<Q: Clone, R: Clone>(runs: &Loadable<Arc<Vec<Run<Q, R>>>>) -> Option<Run<Q, R>> {
    runs.ready()?.iter().find(|run| run.is_unfinished()).cloned()
}

/// What stands below the button that starts a run: why it cannot, why the last one did not, and how the one that is
/// `running` gets on. True when the operator cancels that.
pub fn below_start_ui<Q, R>(
    ui: &mut egui::Ui,
    cx: &ScreenContext<'_>,
    problem: Option<String>,
    started: &Loadable<String>,
    running: Option<&Run<Q, R>>,
) -> bool {
    if let Some(problem) = problem {
        ui.colored_label(cx.palette.warning, problem);
    }
    if let Loadable::Failed(error) = started {
        ui.colored_label(cx.palette.mismatch, format!("The run did not start: {error}"));
    }
    running.is_some_and(|run| progress_ui(ui, cx, run))
}

/// What the run found, if it is done; if not, the screen says how it stands. `what` it is, e.g. "calibration".
pub fn found_ui<'r, Q, R>(
    ui: &mut egui::Ui,
    cx: &mut ScreenContext<'_>,
    run: &'r Run<Q, R>,
    what: &str,
) -> Option<&'r R> {
    match run.state {
        JobState::Queued | JobState::Running => loading_ui(ui, &run.stage),
        JobState::Failed => {
            let why = run.error.as_deref().unwrap_or("the server gave no reason");
            failed_ui(ui, cx, &format!("The {what} failed"), why);
        }
        JobState::Cancelled => cancelled_ui(ui, &format!("Start {what}")),
        JobState::Done => {
            if run.report.is_none() {
                loading_ui(ui, "Fetching the result");
            }
            return run.report.as_ref();
        }
    }
    None
}

/// How a run gets on. True when the operator cancels it.
fn progress_ui<Q, R>(ui: &mut egui::Ui, cx: &ScreenContext<'_>, run: &Run<Q, R>) -> bool {
    let left = run.seconds_left.map(|s| format!(", {} left", duration_text(s))).unwrap_or_default();
    let bar = progress_bar(run.fraction, &format!("{:.0} %{left}", run.fraction * 100.0));
    ui.add(bar.desired_width(ui.available_width() - 8.0));
    announced_ui(ui, RichText::new(&run.stage).color(cx.palette.text_weak), false);
    ui.ctx().request_repaint_after(Duration::from_millis(200));
    ui.button("Cancel").on_hover_text("Stop the run; nothing is saved").clicked()
}

/// The finished runs of this session, each a step away. `about` says what sets one apart.
pub fn earlier_runs_ui<Q: OfSession, R>(
    ui: &mut egui::Ui,
    cx: &mut ScreenContext<'_>,
    runs: &[Run<Q, R>],
    screen: Screen,
    about: impl Fn(&Q) -> String,
) {
    let mine: Vec<&Run<Q, R>> = runs
        .iter()
        .filter(|run| Some(run.request.session()) == cx.playback.session.as_deref() && !run.is_unfinished())
        .collect();
    if mine.is_empty() {
        return;
    }
    ui.separator();
    ui.label(RichText::new("Earlier runs").strong());
    for run in mine {
        let chosen = cx.route.run.as_ref() == Some(&run.id);
        let saved = run.saved_as.as_ref().map_or(String::new(), |model| format!(", saved as {model}"));
        let about = about(&run.request);
        let about = if about.is_empty() { about } else { format!("{about}, ") };
        let text = format!("{}  {about}{}{saved}", run.id, state_text(run.state));
        let width = ui.available_width() - 8.0;
        let button = egui::Button::selectable(chosen, text).min_size(egui::vec2(width, 32.0)).right_text("");
        if ui.add(button.wrap()).clicked() && !chosen {
            *cx.go_to = Some(route_to_run(cx, screen, &run.id));
        }
    }
}

/// Where no run is shown: a way to the newest finished one of this session, if there is one.
fn newest_run_ui<Q: OfSession, R>(
    ui: &mut egui::Ui,
    cx: &mut ScreenContext<'_>,
    runs: &[Run<Q, R>],
    screen: Screen,
) {
    let newest = runs.iter().find(|run| {
        run.state == JobState::Done && Some(run.request.session()) == cx.playback.session.as_deref()
    });
    let Some(newest) = newest else { return };
    ui.add_space(12.0);
    if ui.button(format!("Show the last result ({})", newest.id)).clicked() {
        *cx.go_to = Some(route_to_run(cx, screen, &newest.id));
    }
}

/// Where a run is looked at.
pub fn route_to_run(cx: &ScreenContext<'_>, screen: Screen, run_id: &str) -> Route {
    Route { session: cx.playback.session.clone(), run: Some(run_id.to_owned()), ..Route::to(screen) }
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

/// A run that was stopped before it was done; `button` starts another.
fn cancelled_ui(ui: &mut egui::Ui, button: &str) {
    ui.add_space(80.0);
    ui.vertical_centered(|ui| {
        heading_ui(ui, "Cancelled");
        ui.label(format!("This run was stopped before it was done. Press {button} to run it again."));
    });
}
