//! Home: what the station does, what runs, what to do next, and what was made last.

pub mod next;

use egui::{RichText, accesskit::Role as Accessible};
use palpate_reports::wording::counted;
use palpate_wire::{
    api::{
        CalibrationRequest, CampaignSummary, DiagnosisRequest, Job, JobState, ModelSummary, Role,
        SessionSummary, Source,
    },
    markdown,
    proto::device_status::Link,
};

use self::next::{CampaignFacts, Facts, SessionFacts, Step};
use super::{
    About, ScreenContext, Subject, View,
    control::wording::{link_word, phase_color, phase_mark_ui, phase_word},
    duration_text, heading_ui,
    jobs::{NEW, working_now},
    progress_bar, topic_heading_ui,
};
use crate::{
    playback::HandSource,
    route::{Route, Screen},
    store::{Loadable, control::Holder},
};

/// From here on, points, cards stand in two columns.
const TWO_COLUMNS: f32 = 900.0;
/// Nothing is wider than this, points: lines that long are hard to read.
const MAX_WIDTH: f32 = 1240.0;
/// Width of the button that does what is next, points.
const PRIMARY_WIDTH: f32 = 320.0;
/// Heading of the first card, which stands for that of the screen.
const NEXT: &str = "What next";
/// Lists show so many entries; their screens have the rest.
const MAX_LISTED: usize = 5;

/// This screen.
pub const ABOUT: About = About {
    label: "Home",
    slug: "home",
    key: Some(egui::Key::Num1),
    icon: "\u{1f3e0}",
    purpose: "What the station does, what runs, and what to do next",
    group: None,
    document: (markdown::TOUR, Some("a-five-minute-tour")),
    subject: Subject::Other,
    needs_station: false,
    shows_stream: false,
    new: || Box::<HomeState>::default(),
};

/// What was started here and has not been taken yet.
#[derive(Debug, Default)]
struct HomeState {
    waits_for: Option<Screen>,
}

impl View for HomeState {
    fn ui(&mut self, ui: &mut egui::Ui, cx: &mut ScreenContext<'_>) {
        follow_started(cx, self);
        egui::ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
            ui.set_max_width(ui.available_width().min(MAX_WIDTH));
            ui.add_space(4.0);
            next_ui(ui, cx, self);
            if ui.available_width() < TWO_COLUMNS {
                station_ui(ui, cx);
                running_ui(ui, cx);
                sessions_ui(ui, cx);
                models_ui(ui, cx);
                campaigns_ui(ui, cx);
                return;
            }
            ui.columns(2, |columns| {
                let [left, right] = columns else { return };
                station_ui(left, cx);
                running_ui(left, cx);
                sessions_ui(right, cx);
                models_ui(right, cx);
                campaigns_ui(right, cx);
            });
        });
    }
}

fn card(
    ui: &mut egui::Ui,
    cx: &mut ScreenContext<'_>,
    title: &str,
    contents: impl FnOnce(&mut egui::Ui, &mut ScreenContext<'_>),
) {
    egui::Frame::group(ui.style()).fill(cx.palette.surface).inner_margin(12).show(ui, |ui| {
        ui.set_width(ui.available_width());
        if title == NEXT {
            topic_heading_ui(ui, title, Screen::Home);
        } else {
            heading_ui(ui, title);
        }
        // Columns would stretch whatever stands in them.
        ui.with_layout(egui::Layout::top_down(egui::Align::Min), |ui| contents(ui, cx));
    });
    ui.add_space(8.0);
}

/// Why a list is not there. True when it is not.
fn missing_ui<T>(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, what: &str, list: &Loadable<T>) -> bool {
    match list {
        Loadable::Ready(_) => return false,
        Loadable::Failed(error) => {
            ui.colored_label(cx.palette.mismatch, format!("\u{26a0} {what} did not arrive: {error}"));
            let again = ui.button("Try again");
            again.widget_info(|| {
                egui::WidgetInfo::labeled(Accessible::Button, true, format!("Try again: {what}"))
            });
            if again.clicked() {
                cx.store.retry_failed();
            }
        }
        Loadable::Idle | Loadable::Loading => {
            ui.spinner();
        }
    }
    true
}

fn next_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, state: &mut HomeState) {
    card(ui, cx, NEXT, |ui, cx| {
        let facts = match facts(cx) {
            Loadable::Ready(facts) => facts,
            other => {
                missing_ui(ui, cx, "What there is", &other);
                return;
            }
        };
        let steps = next::steps(&facts);
        let Some((first, others)) = steps.split_first() else {
            let role = facts.role.map_or("viewer", Role::name);
            ui.label(format!(
                "You are logged in as {role}: watch, and press STOP if you must. Nothing waits for you."
            ));
            return;
        };
        ui.label(first.sentence());
        let started = [cx.store.started_run.error(), cx.store.started_diagnosis.error()];
        if let Some(error) = started.into_iter().flatten().next() {
            ui.colored_label(cx.palette.mismatch, format!("\u{26a0} It did not start: {error}"));
        }
        let text = RichText::new(first.button()).strong().size(16.0).color(cx.palette.surface);
        let size = egui::vec2(ui.available_width().min(PRIMARY_WIDTH), 40.0);
        let button = egui::Button::new(text).fill(cx.palette.calibrated).truncate();
        let is_free = state.waits_for.is_none();
        let pressed = ui.add_enabled_ui(is_free, |ui| ui.add_sized(size, button)).inner;
        if pressed.clicked() {
            do_step(cx, state, first);
        }
        if !others.is_empty() {
            ui.add_space(4.0);
            ui.label(RichText::new("After that, or instead:").color(cx.palette.text_weak));
        }
        for step in others.iter().take(MAX_LISTED) {
            ui.horizontal_wrapped(|ui| {
                if ui.button(step.button()).clicked() {
                    do_step(cx, state, step);
                }
                ui.label(RichText::new(step.sentence()).color(cx.palette.text_weak));
            });
        }
    });
}

/// Does `step`, or opens where it is done.
fn do_step(cx: &mut ScreenContext<'_>, state: &mut HomeState, step: &Step) {
    if let Some(session) = &step.route().session {
        cx.playback.open_session(session);
    }
    match step {
        Step::Calibrate { session } => {
            state.waits_for = Some(Screen::Calibrate);
            let (method, hold_out, shared_theta) = (None, None, false);
            let session = session.clone();
            cx.store.start_run(CalibrationRequest { session, method, hold_out, shared_theta });
        }
        Step::Diagnose { session, model } => {
            state.waits_for = Some(Screen::Diagnose);
            cx.store.start_diagnosis(DiagnosisRequest {
                session: session.clone(),
                model: model.clone(),
                hold_out: None,
                max_effects: None,
                without: Vec::new(),
                null_sessions: None,
                references: Vec::new(),
            });
        }
        other => *cx.go_to = Some(other.route()),
    }
}

/// Goes to the run that the button started, once the server has it.
fn follow_started(cx: &mut ScreenContext<'_>, state: &mut HomeState) {
    let Some(screen) = state.waits_for else { return };
    let started = match screen {
        Screen::Calibrate => &cx.store.started_run,
        _ => &cx.store.started_diagnosis,
    };
    match started {
        Loadable::Ready(run) => {
            state.waits_for = None;
            *cx.go_to = Some(super::run_controls::route_to_run(cx, screen, run));
        }
        Loadable::Failed(_) => state.waits_for = None,
        Loadable::Idle | Loadable::Loading => {}
    }
}

/// What the decision needs, once all of it is here.
fn facts(cx: &mut ScreenContext<'_>) -> Loadable<Facts> {
    let commandable = cx.store.is_commandable();
    let (me, sessions, models) = (cx.store.people.me(), cx.store.sessions(), cx.store.models());
    let (runs, diagnoses, campaigns) = (cx.store.runs(), cx.store.diagnoses(), cx.store.campaigns.list());
    let errors =
        [me.error(), sessions.error(), models.error(), runs.error(), diagnoses.error(), campaigns.error()];
    if let Some(error) = errors.into_iter().flatten().next() {
        return Loadable::Failed(error.to_owned());
    }
    let all =
        (me.ready(), sessions.ready(), models.ready(), runs.ready(), diagnoses.ready(), campaigns.ready());
    let (Some(me), Some(sessions), Some(models), Some(runs), Some(diagnoses), Some(campaigns)) = all else {
        return Loadable::Loading;
    };
    let recording = if commandable { cx.store.recording() } else { Loadable::Idle };
    let recording = recording.ready();
    let recorded = recording.and_then(|document| document.session.as_ref());
    let recorded = recorded.filter(|session| session.current.is_some());
    let recorded_id = recorded.map(|session| session.session.as_str());
    let newest = next::newest_session(sessions, recorded_id).map(|session| {
        let diagnosis = next::newest_run(diagnoses, &session.id);
        // Only of the one that may be waiting to be looked at.
        let unsaved = diagnosis.as_ref().filter(|run| run.state == JobState::Done && run.saved_as.is_none());
        let report = unsaved.map(|run| cx.store.diagnosis(&run.id));
        let num_named = report
            .as_ref()
            .and_then(|report| report.ready())
            .and_then(|run| Some(run.report.as_ref()?.effects.len()));
        SessionFacts {
            id: session.id.clone(),
            calibration: next::newest_run(runs, &session.id),
            diagnosis,
            model: next::model_of(models, &session.id),
            num_named,
        }
    });
    // What is next does not wait for it.
    let working = cx.store.jobs.list().ready().map_or_else(Vec::new, |jobs| working_now(jobs));
    Loadable::Ready(Facts {
        role: Some(me.role),
        commandable,
        recording: recorded.is_some(),
        wanted: recording.map_or(0, |document| document.wanted.len()),
        newest,
        campaigns: campaigns.iter().filter_map(CampaignFacts::of).collect(),
        working,
    })
}

fn station_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>) {
    card(ui, cx, "Station", |ui, cx| {
        let info = cx.store.info.clone();
        if missing_ui(ui, cx, "What the studio is", &info) {
            return;
        }
        let Some(info) = info.ready() else { return };
        let Some(station) = &info.station else {
            ui.label("No hand is connected: this studio shows recordings.");
            ui.label(
                RichText::new(
                    "Start it with `palpate serve --emulate demo` for an emulated station, or with `--station FILE` for a \
                     real one.",
                )
                .color(cx.palette.text_weak),
            );
            return;
        };
        let source = match info.source {
            Source::Real => "real",
            Source::Emulated => "emulated",
            Source::Replay => "replay",
        };
        ui.label(format!("{station} ({source})"));
        live_ui(ui, cx);
        ui.add_space(4.0);
        ui.horizontal_wrapped(|ui| {
            if ui.button("Watch it live").clicked() {
                cx.playback.hand_source = HandSource::Live;
                *cx.go_to = Some(Route { live: true, ..Route::to(Screen::Hand) });
            }
        });
    });
}

/// State, holder, problems.
fn live_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>) {
    let palette = cx.palette;
    if let Some((since, _)) = cx.store.frozen_since(cx.now_s) {
        ui.colored_label(
            palette.mismatch,
            format!("\u{26a0} Nothing has come from it since {since}; what stands here is as of then."),
        );
    }
    let Some(control) = cx.store.control_state().cloned() else {
        let text = if cx.store.live_frame().is_some() {
            "It is watched only: nothing commands it from here."
        } else {
            "Nothing has come from it yet."
        };
        ui.label(RichText::new(text).color(palette.text_weak));
        return;
    };
    let phase = control.phase();
    ui.horizontal_wrapped(|ui| {
        let color = phase_color(phase, &palette);
        phase_mark_ui(ui, phase, color);
        ui.label(RichText::new(phase_word(phase)).strong().color(color));
        let holder = match cx.store.control.holder(Some(&control)) {
            Holder::Me => "You have control.".to_owned(),
            Holder::Nobody => "Nobody has control.".to_owned(),
            Holder::Other(name) => format!("{name} has control."),
        };
        ui.label(holder);
    });
    if !control.reason.is_empty() {
        ui.colored_label(palette.warning, format!("\u{26a0} {}", control.reason));
    }
    let troubled: Vec<_> = control
        .devices
        .iter()
        .filter(|device| device.link() != Link::Ready || !device.problem.is_empty())
        .collect();
    if troubled.is_empty() && !control.devices.is_empty() {
        ui.label(format!("\u{2714} {} ready", counted(control.devices.len() as u64, "device")));
    }
    for device in troubled {
        let (word, color) = link_word(device.link(), &palette);
        let problem = if device.problem.is_empty() { String::new() } else { format!(": {}", device.problem) };
        ui.colored_label(color, format!("\u{26a0} {} is {word}{problem}", device.id));
    }
    if control.loop_hz > 0.0 {
        let text =
            format!("Control loop {:.0} Hz, {:.0} ms from byte to page", control.loop_hz, control.latency_ms);
        ui.label(RichText::new(text).color(palette.text_weak));
    }
}

fn running_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>) {
    card(ui, cx, "What runs", |ui, cx| {
        let jobs = cx.store.jobs.list();
        if missing_ui(ui, cx, "The list of jobs", &jobs) {
            return;
        }
        let Some(jobs) = jobs.ready() else { return };
        let unfinished: Vec<&Job> = jobs.iter().filter(|job| job.is_unfinished()).collect();
        if unfinished.is_empty() {
            ui.label("Nothing runs.");
        }
        for job in unfinished.iter().take(MAX_LISTED) {
            job_ui(ui, cx, job);
        }
        if unfinished.len() > MAX_LISTED {
            ui.label(format!("and {} more", unfinished.len() - MAX_LISTED));
        }
        if let Some(last) = jobs.iter().find(|job| !job.is_unfinished()) {
            let (text, color) = match (last.state, &last.problem) {
                (JobState::Failed, Some(problem)) => {
                    (format!("\u{26a0} {} failed: {problem}", last.id), cx.palette.mismatch)
                }
                (state, _) => (format!("Last: {} {}", last.id, state.name()), cx.palette.text_weak),
            };
            ui.add(egui::Label::new(RichText::new(text).color(color)).wrap());
        }
        ui.horizontal_wrapped(|ui| {
            if !jobs.is_empty() && ui.button("All jobs").clicked() {
                *cx.go_to = Some(Route::to(Screen::Jobs));
            }
            if ui.button("Start a job").clicked() {
                *cx.go_to = Some(Route { job: Some(NEW.to_owned()), ..Route::to(Screen::Jobs) });
            }
        });
    });
}

fn job_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, job: &Job) {
    let left =
        job.seconds_left.map_or_else(String::new, |left| format!(", about {} left", duration_text(left)));
    let text = match job.state {
        JobState::Queued => "waits for its turn".to_owned(),
        _ => format!("{:.0} %{left}", 100.0 * job.fraction),
    };
    ui.horizontal_wrapped(|ui| {
        let open = ui.button(&job.id).on_hover_text(&job.stage);
        open.widget_info(|| {
            egui::WidgetInfo::labeled(Accessible::Button, true, format!("{}: {} {text}", job.id, job.kind))
        });
        if open.clicked() {
            *cx.go_to = Some(Route { job: Some(job.id.clone()), ..Route::to(Screen::Jobs) });
        }
        // The card is as white as the part of a bar that is left.
        ui.visuals_mut().extreme_bg_color = cx.palette.background;
        let width = (ui.available_width() - 8.0).clamp(120.0, 320.0);
        ui.add(progress_bar(job.fraction, &text).desired_width(width));
    });
}

/// A line of a list: a name to press, and a fact.
fn entry_ui(ui: &mut egui::Ui, cx: &ScreenContext<'_>, kind: &str, name: &str, fact: &str) -> bool {
    let button = egui::Button::new(name)
        .right_text(RichText::new(fact).color(cx.palette.text_weak))
        .frame_when_inactive(false)
        .min_size(egui::vec2(ui.available_width(), 32.0))
        .truncate();
    let response = ui.add(button);
    response.widget_info(|| {
        egui::WidgetInfo::labeled(Accessible::Button, true, format!("{kind} {name}: {fact}"))
    });
    response.clicked()
}

fn sessions_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>) {
    card(ui, cx, "Sessions", |ui, cx| {
        let sessions = cx.store.sessions();
        if missing_ui(ui, cx, "The list of sessions", &sessions) {
            return;
        }
        let Some(sessions) = sessions.ready() else { return };
        if sessions.is_empty() {
            ui.label(
                "None yet. A session is a set of takes: recordings of the hand touching a known object.",
            );
        }
        let mut newest: Vec<&SessionSummary> = sessions.iter().collect();
        newest.sort_by(|a, b| b.recorded.cmp(&a.recorded));
        for session in newest.into_iter().take(MAX_LISTED) {
            let fact = match &session.error {
                Some(_) => "cannot be opened".to_owned(),
                None => format!(
                    "{}, {}",
                    counted(session.takes as u64, "take"),
                    duration_text(session.duration_s)
                ),
            };
            if entry_ui(ui, cx, "Session", &session.id, &fact) {
                cx.playback.open_session(&session.id);
                *cx.go_to = Some(Route::to(Screen::Sessions).with_session(session.id.clone()));
            }
        }
        if sessions.len() > MAX_LISTED && ui.button(format!("All {} sessions", sessions.len())).clicked() {
            *cx.go_to = Some(Route::to(Screen::Sessions));
        }
    });
}

fn models_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>) {
    card(ui, cx, "Sensor models", |ui, cx| {
        let models = cx.store.models();
        if missing_ui(ui, cx, "The list of models", &models) {
            return;
        }
        let Some(models) = models.ready() else { return };
        let saved: Vec<&ModelSummary> = models.iter().filter(|model| model.id != "nominal").collect();
        if saved.is_empty() {
            ui.label("None yet. A calibration makes one, and a diagnosis adds to it.");
        }
        for model in saved.iter().take(MAX_LISTED) {
            let fact = match model.effects.len() {
                0 => "calibrated".to_owned(),
                effects => format!("calibrated, {}", counted(effects as u64, "effect")),
            };
            if entry_ui(ui, cx, "Model", &model.name, &fact) {
                *cx.go_to = Some(Route::to(Screen::Diagnose));
            }
        }
        if saved.len() > MAX_LISTED {
            ui.label(format!("and {} more, on Diagnose", saved.len() - MAX_LISTED));
        }
    });
}

fn campaigns_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>) {
    let campaigns = cx.store.campaigns.list();
    if campaigns.ready().is_some_and(|campaigns| campaigns.is_empty()) {
        return;
    }
    card(ui, cx, "Campaigns", |ui, cx| {
        if missing_ui(ui, cx, "The list of campaigns", &campaigns) {
            return;
        }
        let Some(campaigns) = campaigns.ready() else { return };
        for campaign in campaigns.iter().take(MAX_LISTED) {
            if entry_ui(ui, cx, "Campaign", &campaign.name, &campaign_fact(campaign)) {
                *cx.go_to = Some(Route { campaign: Some(campaign.id.clone()), ..Route::to(Screen::Trials) });
            }
        }
    });
}

fn campaign_fact(campaign: &CampaignSummary) -> String {
    match (&campaign.error, &campaign.closed) {
        (Some(_), _) => "cannot be read".to_owned(),
        (None, Some(_)) => format!("closed, {} of {}", campaign.scored, campaign.planned),
        (None, None) => format!("{} of {} scored", campaign.scored, campaign.planned),
    }
}
