//! The job that lets the policies of a campaign move the robot of this studio.

use std::sync::Arc;

use egui::RichText;
use palpate_wire::api::{Campaign, Job, JobRequest, JobState, RolloutsRequest, SessionSummary};
use serde_json::{Value, json};

use super::super::{ScreenContext, progress_bar};
use crate::{
    api_client::JobAct,
    route::{Route, Screen},
    store::Loadable,
};

/// The kind of job.
const KIND: &str = "rollouts";

/// What the operator chose.
#[derive(Debug, Default)]
pub(super) struct HandState {
    /// Trials are not recorded as takes.
    without_recording: bool,
    /// The session that they are recorded into; `None` until somebody types: then the usual one.
    session: Option<String>,
}

/// Says what moves the robot in this campaign, and starts and stops it.
pub(super) fn hand_ui(
    ui: &mut egui::Ui,
    cx: &mut ScreenContext<'_>,
    state: &mut HandState,
    campaign: &Campaign,
) {
    let Loadable::Ready(jobs) = cx.store.jobs.list() else { return };
    let id = campaign.summary.id.as_str();
    let job = jobs.iter().find(|job| job.kind == KIND && job.spec.request["campaign"] == id);
    if let (Some(job), Loadable::Ready(made)) = (job, &cx.store.jobs.cloned)
        && job.id == *made
    {
        // It is shown here; the screen of jobs need not open it.
        cx.store.jobs.cloned = Loadable::Idle;
    }
    match job.filter(|job| job.is_unfinished()) {
        Some(job) => running_ui(ui, cx, job),
        None => start_ui(ui, cx, state, campaign, job),
    }
    if let Some(job) = job {
        takes_ui(ui, cx, job);
    }
    ui.add_space(10.0);
}

fn running_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, job: &Job) {
    ui.strong(format!("{} moves the robot", job.id));
    ui.label(&job.stage);
    ui.add(progress_bar(job.fraction, "").desired_width(ui.available_width().min(460.0)));
    ui.horizontal_wrapped(|ui| {
        let stop = ui
            .add_enabled(!job.cancel_requested, egui::Button::new("Stop running trials"))
            .on_hover_text("The trial that runs becomes void; the robot holds, and control is given back");
        if stop.clicked() {
            cx.store.jobs.act(&job.id, JobAct::Cancel);
        }
        link_ui(ui, cx, job);
    });
}

fn start_ui(
    ui: &mut egui::Ui,
    cx: &mut ScreenContext<'_>,
    state: &mut HandState,
    campaign: &Campaign,
    last: Option<&Job>,
) {
    if campaign.summary.closed.is_some() || campaign.summary.paused.is_some() || campaign.next.is_none() {
        return;
    }
    let Loadable::Ready(kinds) = cx.store.jobs.kinds() else { return };
    let Some(kind) = Arc::clone(&kinds).iter().find(|kind| kind.kind == KIND).cloned() else { return };
    if let Some(problem) = kind.problem {
        let text = format!("This studio cannot run policies itself: {problem}.");
        ui.label(RichText::new(text).color(cx.palette.text_weak));
        return;
    }
    if let Some(last) = last.filter(|job| job.state == JobState::Failed) {
        let why = last.problem.as_deref().unwrap_or("it does not say why");
        ui.label(RichText::new(format!("{} failed: {why}", last.id)).color(cx.palette.warning));
        link_ui(ui, cx, last);
    }
    if let Some(problem) = cx.store.jobs.problem.clone() {
        ui.label(RichText::new(problem).color(cx.palette.warning));
    }
    let request = recording_ui(ui, cx, state, &campaign.summary.id);
    let start = egui::Button::new("Let the policies run here");
    let is_free = !matches!(cx.store.jobs.cloned, Loadable::Loading);
    if ui.add_enabled(is_free, start).clicked() {
        cx.store.jobs.submit(JobRequest {
            kind: KIND.to_owned(),
            request,
            seed: 0,
            priority: 0,
            resources: None,
            runner: None,
        });
    }
    let text = "The studio takes control and moves the robot out of the way at once; each trial moves when you have placed \
                its object and begun it here, or by itself where the operator of an emulated station places it.";
    ui.label(RichText::new(text).color(cx.palette.text_weak));
}

/// Whether trials are recorded as takes, and into which session; gives what is asked for.
fn recording_ui(ui: &mut egui::Ui, cx: &ScreenContext<'_>, state: &mut HandState, id: &str) -> Value {
    let usual = RolloutsRequest { campaign: id.to_owned(), ..RolloutsRequest::default() };
    let usual = usual.recorded_into().unwrap_or_default();
    let mut records = !state.without_recording;
    ui.checkbox(&mut records, "Record each trial as a take");
    state.without_recording = !records;
    if !records {
        let text = "Without takes there is nothing to diagnose where a trial differs from simulation.";
        ui.label(RichText::new(text).color(cx.palette.text_weak));
        return json!({ "campaign": id, "without_recording": true });
    }
    let mut session = state.session.clone().unwrap_or_else(|| usual.clone());
    ui.horizontal_wrapped(|ui| {
        let label = ui.label("in session");
        let width = ui.available_width().clamp(120.0, 260.0);
        let field = egui::TextEdit::singleline(&mut session).desired_width(width).char_limit(60);
        if ui.add(field).labelled_by(label.id).changed() {
            state.session = Some(session.clone());
        }
    });
    match session.trim() {
        session if session.is_empty() || session == usual => json!({ "campaign": id }),
        session => json!({ "campaign": id, "session": session }),
    }
}

/// Leads to the takes that a job records, once there are some.
fn takes_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, job: &Job) {
    let request: Option<RolloutsRequest> = serde_json::from_value(job.spec.request.clone()).ok();
    let Some(session) = request.and_then(|request| request.recorded_into()) else { return };
    let is_there = |sessions: &Arc<Vec<SessionSummary>>| sessions.iter().any(|known| known.id == session);
    if cx.store.sessions().ready().is_some_and(is_there)
        && ui.button(format!("Open session {session}")).clicked()
    {
        cx.playback.open_session(&session);
        *cx.go_to = Some(Route::to(Screen::Sessions).with_session(session));
    }
}

fn link_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, job: &Job) {
    if ui.button(format!("Open {}", job.id)).clicked() {
        *cx.go_to = Some(Route { job: Some(job.id.clone()), ..Route::to(Screen::Jobs) });
    }
}
