//! Jobs: long work of every kind, what waits, what runs, how it ended.

mod curves;
mod needs;
mod start;
mod trainings;

use egui::RichText;
use palpate_wire::api::{Job, JobState, RolloutsRequest};

use super::{
    About, ScreenContext, Subject, View,
    controls::{combo_ui, may_start_jobs_ui, option_ui},
    copy_as, duration_text, empty_ui, heading_ui, is_missing, loaded_ui, progress_bar, topic_ui,
};
use crate::{
    api_client::JobAct,
    route::{Route, Screen},
    store::Loadable,
};

/// The log of a running job is asked for again after this, s.
const LOG_EVERY_S: f64 = 2.0;
/// Narrower than this, the list goes when a job is open.
const NARROW: f32 = 700.0;

/// This screen.
pub const ABOUT: About = About {
    label: "Jobs",
    slug: "jobs",
    key: None,
    icon: "\u{231b}",
    purpose: "Long work: what waits, what runs, how it ended",
    group: None,
    document: ("jobs", None),
    subject: Subject::Other,
    needs_station: false,
    shows_stream: false,
    new: || Box::<JobsState>::default(),
};

/// What the operator chose on this screen.
#[derive(Debug, Default)]
struct JobsState {
    state: Option<JobState>,
    kind: Option<String>,
    /// Deleting was asked for and waits for a second press.
    deleting: Option<String>,
    log_asked_s: f64,
    shows_all_curves: bool,
    start: start::StartState,
}

/// In place of the id of a job in the address: the form that starts one.
pub const NEW: &str = "new";

impl View for JobsState {
    fn ui(&mut self, ui: &mut egui::Ui, cx: &mut ScreenContext<'_>) {
        let jobs = cx.store.jobs.list();
        let Some(jobs) = loaded_ui(ui, cx, jobs, "Looking for jobs", "The list of jobs did not arrive")
        else {
            return;
        };
        if let Loadable::Ready(id) = &cx.store.jobs.cloned {
            *cx.go_to = Some(Route { job: Some(id.clone()), ..Route::to(Screen::Jobs) });
            cx.store.jobs.cloned = Loadable::Idle;
        }
        if cx.route.job.as_deref() == Some(NEW) {
            new_ui(ui, cx, self, &jobs);
            return;
        }
        if jobs.is_empty() {
            let text = "A job is long work in a process of its own: a calibration, a diagnosis, a training. It goes on when \
                this page is closed and outlives the studio. Calibrate and Diagnose start jobs, scripts start every kind: docs/jobs.md.";
            if empty_ui(ui, "No job yet", text, "Start a job") {
                *cx.go_to = Some(Route { job: Some(NEW.to_owned()), ..Route::to(Screen::Jobs) });
            }
            return;
        }
        let asked = cx.route.job.clone();
        let shown = asked.as_ref().and_then(|id| jobs.iter().find(|job| job.id == *id));
        let is_narrow = ui.available_width() < NARROW;
        if is_narrow {
            match (shown, asked) {
                (Some(job), _) => {
                    if ui.button("Back to all jobs").clicked() {
                        *cx.go_to = Some(Route::to(Screen::Jobs));
                    }
                    job_ui(ui, cx, self, job);
                }
                (None, _) => list_ui(ui, cx, self, &jobs, None),
            }
            return;
        }
        egui::Panel::left("jobs_list").resizable(false).exact_size(380.0).show(ui, |ui| {
            list_ui(ui, cx, self, &jobs, shown.or(jobs.first()));
        });
        egui::CentralPanel::default().show(ui, |ui| match (shown, asked) {
            (None, Some(id)) => {
                ui.label(format!(
                    "Job {id} is not among those that are listed. Older jobs are at the list's end."
                ));
            }
            (job, _) => {
                if let Some(job) = job.or(jobs.first()) {
                    job_ui(ui, cx, self, job);
                }
            }
        });
    }
}

fn new_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, state: &mut JobsState, jobs: &[Job]) {
    egui::ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
        ui.add_space(4.0);
        if ui.button("Back to all jobs").clicked() {
            *cx.go_to = Some(Route::to(Screen::Jobs));
        }
        start::start_ui(ui, cx, &mut state.start, jobs);
        ui.add_space(12.0);
    });
}

fn list_ui(
    ui: &mut egui::Ui,
    cx: &mut ScreenContext<'_>,
    state: &mut JobsState,
    jobs: &[Job],
    shown: Option<&Job>,
) {
    ui.add_space(4.0);
    ui.horizontal_wrapped(|ui| {
        heading_ui(ui, "Jobs");
        topic_ui(ui, Screen::Jobs);
        if ui.button("Start a job").clicked() {
            *cx.go_to = Some(Route { job: Some(NEW.to_owned()), ..Route::to(Screen::Jobs) });
        }
    });
    filter_ui(ui, state, jobs);
    ui.separator();
    egui::ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
        let is_wanted = |job: &&Job| {
            state.state.is_none_or(|wanted| job.state == wanted)
                && state.kind.as_ref().is_none_or(|wanted| job.kind == *wanted)
        };
        let mut num_listed = 0;
        for job in jobs.iter().filter(is_wanted) {
            num_listed += 1;
            entry_ui(ui, cx, job, shown.is_some_and(|shown| shown.id == job.id));
        }
        if num_listed == 0 {
            ui.label("No job is like that.");
        }
        if cx.store.jobs.has_more() && ui.button("Older jobs").clicked() {
            cx.store.jobs.ask_for_more();
        }
    });
}

fn filter_ui(ui: &mut egui::Ui, state: &mut JobsState, jobs: &[Job]) {
    let mut kinds: Vec<&str> = jobs.iter().map(|job| job.kind.as_str()).collect();
    kinds.sort_unstable();
    kinds.dedup();
    ui.horizontal_wrapped(|ui| {
        let chosen = state.state.map_or("any state", JobState::name);
        combo_ui(ui, "State of jobs", chosen, 110.0, |ui| {
            option_ui(ui, &mut state.state, None, "any state");
            for job_state in
                [JobState::Queued, JobState::Running, JobState::Done, JobState::Failed, JobState::Cancelled]
            {
                option_ui(ui, &mut state.state, Some(job_state), job_state.name());
            }
        });
        let chosen = state.kind.clone().unwrap_or_else(|| "any kind".to_owned());
        combo_ui(ui, "Kind of jobs", &chosen, 120.0, |ui| {
            option_ui(ui, &mut state.kind, None, "any kind");
            for kind in kinds {
                option_ui(ui, &mut state.kind, Some(kind.to_owned()), kind);
            }
        });
    });
}

fn entry_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, job: &Job, is_chosen: bool) {
    let fact = match job.state {
        JobState::Running => format!("{:.0} %", 100.0 * job.fraction),
        other => other.name().to_owned(),
    };
    let text = format!("{} {}", mark(job.state), job.id);
    let button = egui::Button::selectable(is_chosen, RichText::new(text).color(colour(cx, job.state)))
        .right_text(RichText::new(fact.clone()).color(cx.palette.text_weak))
        .min_size(egui::vec2(ui.available_width() - 8.0, 34.0));
    let response = ui.add(button);
    response.widget_info(|| {
        let name = format!("Job {}: {} {fact}", job.id, job.kind);
        egui::WidgetInfo::selected(egui::accesskit::Role::Button, true, is_chosen, name)
    });
    if response.clicked() {
        *cx.go_to = Some(Route { job: Some(job.id.clone()), ..Route::to(Screen::Jobs) });
    }
}

/// State is never colour alone.
pub fn mark(state: JobState) -> &'static str {
    match state {
        JobState::Queued => "\u{2026}",
        JobState::Running => "\u{25b6}",
        JobState::Done => "\u{2714}",
        JobState::Failed => "\u{26a0}",
        JobState::Cancelled => "\u{2716}",
    }
}

fn colour(cx: &ScreenContext<'_>, state: JobState) -> egui::Color32 {
    match state {
        JobState::Failed => cx.palette.mismatch,
        JobState::Done => cx.palette.diagnosed,
        JobState::Running => cx.palette.calibrated,
        JobState::Queued | JobState::Cancelled => cx.palette.text_weak,
    }
}

fn job_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, state: &mut JobsState, job: &Job) {
    egui::ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
        ui.add_space(4.0);
        ui.heading(&job.id);
        if let Some(problem) = cx.store.jobs.problem.clone() {
            ui.colored_label(cx.palette.mismatch, format!("\u{26a0} {problem}"));
        }
        let working = working_now(cx.store.jobs.list().ready().map_or(&[][..], |jobs| jobs.as_slice()));
        progress_ui(ui, cx, job, &working);
        actions_ui(ui, cx, state, job);
        ui.add_space(8.0);
        facts_ui(ui, cx, job);
        files_ui(ui, job);
        ui.add_space(8.0);
        copy_as::copy_ui(ui, &copy_as::job(job, copy_as::DATA_FOLDER));
        ui.add_space(8.0);
        if let Loadable::Ready(found) = cx.store.jobs.curves(&job.id) {
            curves::curves_ui(ui, &cx.palette, &job.id, &found, &mut state.shows_all_curves);
            ui.add_space(8.0);
        }
        log_ui(ui, cx, state, job);
        ui.add_space(12.0);
    });
}

fn progress_ui(ui: &mut egui::Ui, cx: &ScreenContext<'_>, job: &Job, working: &[String]) {
    match job.state {
        JobState::Running => {
            ui.add(
                progress_bar(job.fraction, &progress_text(job))
                    .desired_width(ui.available_width().min(420.0)),
            );
            let asked = if job.cancel_requested { "It has been asked to stop. " } else { "" };
            ui.label(format!("{asked}{}", job.stage));
        }
        JobState::Queued => {
            ui.add(egui::Label::new(waits_text("It", working)).wrap());
        }
        JobState::Failed => {
            let problem = job.problem.as_deref().unwrap_or("it failed without saying why; its log may tell");
            ui.colored_label(cx.palette.mismatch, format!("\u{26a0} {problem}"));
        }
        JobState::Done | JobState::Cancelled => {
            ui.colored_label(colour(cx, job.state), format!("{} {}", mark(job.state), job.state.name()));
        }
    }
}

/// How far a running job is, and how long it still takes.
pub fn progress_text(job: &Job) -> String {
    let left = job
        .seconds_left
        .map_or_else(String::new, |seconds| format!(", about {} left", duration_text(seconds)));
    format!("{:.0} %{left}", 100.0 * job.fraction)
}

/// Ids of the jobs that have begun and not ended.
pub(super) fn working_now(jobs: &[Job]) -> Vec<String> {
    let working = jobs.iter().filter(|job| job.state == JobState::Running);
    working.map(|job| job.id.clone()).collect()
}

/// That `who` waits, and what works meanwhile.
pub(super) fn waits_text(who: &str, working: &[String]) -> String {
    match working {
        [] => format!("{who} waits for its turn."),
        [one] => format!("{who} waits for its turn: {one} works."),
        [one, other] => format!("{who} waits for its turn: {one} and {other} work."),
        [one, others @ ..] => format!("{who} waits for its turn: {one} and {} others work.", others.len()),
    }
}

fn actions_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, state: &mut JobsState, job: &Job) {
    ui.horizontal_wrapped(|ui| {
        trials_ui(ui, cx, job);
        if let Some((route, name)) = outcome_of(job)
            && ui.button(name).clicked()
        {
            *cx.go_to = Some(route);
        }
        if !may_start_jobs_ui(ui, cx) {
            return;
        }
        if job.is_unfinished() {
            let can = !job.cancel_requested;
            if ui.add_enabled(can, egui::Button::new("Cancel")).clicked() {
                cx.store.jobs.act(&job.id, JobAct::Cancel);
            }
            return;
        }
        if matches!(job.state, JobState::Failed | JobState::Cancelled) && ui.button("Try again").clicked() {
            cx.store.jobs.act(&job.id, JobAct::Retry);
        }
        let clone = ui
            .button("Run the same anew")
            .on_hover_text("A new job that is asked the same, on the data as it is now");
        if clone.clicked() {
            cx.store.jobs.act(&job.id, JobAct::Clone);
        }
        if state.deleting.as_deref() == Some(job.id.as_str()) {
            if ui.button("Yes, to the trash").clicked() {
                cx.store.jobs.act(&job.id, JobAct::Delete);
                state.deleting = None;
                *cx.go_to = Some(Route::to(Screen::Jobs));
            }
            if ui.button("Keep it").clicked() {
                state.deleting = None;
            }
        } else if ui
            .button("Delete")
            .on_hover_text("Its folder moves to the trash of the data folder")
            .clicked()
        {
            state.deleting = Some(job.id.clone());
        }
    });
}

/// Leads to the campaign of a job on trials, and to the takes that they became.
fn trials_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, job: &Job) {
    let Some(campaign) = job.spec.request["campaign"].as_str() else { return };
    let part = if job.kind == "comparison" { "results" } else { "run" };
    if ui.button("Open the campaign").clicked() {
        *cx.go_to = Some(Route {
            campaign: Some(campaign.to_owned()),
            part: Some(part.to_owned()),
            ..Route::to(Screen::Trials)
        });
    }
    if job.kind != "rollouts" {
        return;
    }
    let request: Option<RolloutsRequest> = serde_json::from_value(job.spec.request.clone()).ok();
    let session = request.and_then(|request| request.recorded_into());
    if let Some(session) = session.filter(|session| !is_missing(cx, session))
        && ui.button(format!("Open session {session}")).clicked()
    {
        *cx.go_to = Some(Route::to(Screen::Sessions).with_session(session));
    }
}

/// Where the outcome of a job that is done is shown best, and what a button that leads there says.
pub fn outcome_of(job: &Job) -> Option<(Route, &'static str)> {
    let (screen, name) = match job.kind.as_str() {
        _ if job.state != JobState::Done => return None,
        "calibrate" => (Screen::Calibrate, "Open the result"),
        "diagnose" => (Screen::Diagnose, "Open the result"),
        "emulate" => (Screen::Sessions, "Open the session"),
        _ => return None,
    };
    let session = job.spec.request["session"].as_str().map(str::to_owned);
    Some((Route { run: Some(job.id.clone()), session, ..Route::to(screen) }, name))
}

/// Links to what a job has left.
fn files_ui(ui: &mut egui::Ui, job: &Job) {
    let files = files_of(job);
    if files.is_empty() {
        return;
    }
    ui.horizontal_wrapped(|ui| {
        ui.label("Files");
        for name in files {
            let url = format!("/api/v1/jobs/{}/files/{name}", job.id);
            ui.add(egui::Hyperlink::from_label_and_url(name, url).open_in_new_tab(true));
        }
    });
}

/// Names of the files that a job of this kind has left once it is done.
fn files_of(job: &Job) -> Vec<&'static str> {
    if job.state != JobState::Done {
        return Vec::new();
    }
    let others: &[&str] = match job.kind.as_str() {
        "calibrate" => &["report.html", "model.toml"],
        "diagnose" => &["report.html", "model.toml", "calibrated.toml", "base.toml"],
        "blind" => &["answers.jsonl"],
        "tune" => &["script.toml"],
        "expert" => &["policy.safetensors", "script.toml"],
        "evaluation" if job.spec.request["protocol"].is_string() => &["comparison.json"],
        "pretraining" => &["encoder.safetensors"],
        "imitation" => &["policy.safetensors"],
        "pipeline" => &["report.html", "policy.safetensors"],
        _ => &[],
    };
    std::iter::once("report.json").chain(others.iter().copied()).collect()
}

fn facts_ui(ui: &mut egui::Ui, cx: &ScreenContext<'_>, job: &Job) {
    let time = |text: &Option<String>| {
        text.as_deref()
            .map_or_else(|| "-".to_owned(), |text| (cx.local_time)(text).unwrap_or_else(|| text.to_owned()))
    };
    let request = serde_json::to_string(&job.spec.request).unwrap_or_default();
    egui::Grid::new("job_facts").num_columns(2).spacing([14.0, 4.0]).show(ui, |ui| {
        for (name, value) in [
            ("Kind", job.kind.clone()),
            ("Asked for", time(&Some(job.created.clone()))),
            ("By", job.owner.clone()),
            ("Began", time(&job.started)),
            ("Ended", time(&job.ended)),
            ("Attempts", job.attempts.to_string()),
            ("Runs on", job.runner.clone()),
            ("Parts and graphics card", needs::words(job).unwrap_or_else(|| "-".to_owned())),
            ("Seed", job.spec.seed.to_string()),
            ("Software", job.spec.software.clone()),
            ("Input files", job.spec.inputs.len().to_string()),
            ("Saved as", job.saved_as.clone().unwrap_or_else(|| "-".to_owned())),
        ] {
            ui.label(RichText::new(name).color(cx.palette.text_weak));
            ui.add(egui::Label::new(value).wrap().selectable(true));
            ui.end_row();
        }
    });
    ui.label(RichText::new("Request").color(cx.palette.text_weak));
    ui.add(egui::Label::new(RichText::new(request).monospace()).wrap().selectable(true));
}

fn log_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, state: &mut JobsState, job: &Job) {
    ui.strong("Log");
    if job.state == JobState::Running && cx.now_s - state.log_asked_s > LOG_EVERY_S {
        state.log_asked_s = cx.now_s;
        cx.store.jobs.ask_log_again(&job.id);
        cx.store.jobs.ask_curves_again(&job.id);
        ui.ctx().request_repaint_after_secs(LOG_EVERY_S as f32);
    }
    match cx.store.jobs.log(&job.id) {
        Loadable::Ready(log) if log.trim().is_empty() => {
            ui.label("It has printed nothing.");
        }
        Loadable::Ready(log) => {
            ui.add(egui::Label::new(RichText::new(log.trim_end()).monospace()).wrap().selectable(true));
        }
        Loadable::Failed(error) => {
            ui.label(format!("There is no log: {error}"));
        }
        Loadable::Idle | Loadable::Loading => {
            ui.spinner();
        }
    }
}
