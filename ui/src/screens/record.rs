//! Recording a calibration session: a checklist on the left, the step under way large in the middle with one primary
//! button, what comes in on the right.
//!
//! The server decides what comes next ([`palpate_wire::api::RecordingPhase`]); the page says it and passes on what the
//! operator does.

mod checklist;
mod free;
mod incoming;
mod interruptions;
mod start;
mod step;

use std::{collections::BTreeMap, sync::Arc};

use egui::{Key, Panel};
use palpate_reports::TakeVerdict;
use palpate_robot_model::Station;
use palpate_wire::{
    api::{RecordingAction, RecordingDocument, RecordingPhase, RecordingSession, StepState},
    proto::{RecordingStatus, control_state::Phase},
};

use self::interruptions::Interruptions;
use super::{About, ScreenContext, Subject, View, empty_ui, hand::PlacementView, loaded_ui};
use crate::{
    route::Screen,
    store::{Store, control::Holder},
    theme::is_narrow,
};

const LIST_WIDTH: f32 = 250.0;
const INCOMING_WIDTH: f32 = 300.0;

/// This screen.
pub const ABOUT: About = About {
    label: "Record",
    slug: "record",
    key: Some(egui::Key::Num3),
    icon: "\u{23fa}",
    purpose: "Record a calibration session, take by take, as a checklist says",
    group: Some("Operate"),
    document: ("recordings", None),
    subject: Subject::Station,
    needs_station: true,
    shows_stream: true,
    new: || Box::<RecordState>::default(),
};

/// What the screen remembers between frames.
#[derive(Default)]
struct RecordState {
    start: start::StartState,
    free: free::FreeState,
    /// The remark that is being typed.
    note: String,
    /// The field of remarks gets the focus in the next frame.
    write_note: bool,
    start_pose: StartPose,
    interruptions: Interruptions,
    /// The step whose accepted take somebody is about to set aside, and how: it is asked once more.
    doubt: Option<(usize, RecordingAction)>,
    /// Whether the object stands where the plan says.
    fixture_elsewhere: bool,
    placement: PlacementView,
}

/// Whether the robot is where the motion of a step starts, as far as this page has seen.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
enum StartPose {
    #[default]
    Unknown,
    /// On its way, for the step.
    Going(usize),
    /// It was to go, and was called off.
    CalledOff,
    /// There.
    Reached(usize),
}

impl StartPose {
    fn next(self, phase: RecordingPhase, step: Option<usize>, problem: bool) -> Self {
        match (phase, self, step) {
            (RecordingPhase::GoingToStart, Self::CalledOff, _) => Self::CalledOff,
            (RecordingPhase::GoingToStart, _, Some(step)) => Self::Going(step),
            (RecordingPhase::StartPose, Self::Going(of) | Self::Reached(of), Some(step))
                if of == step && !problem =>
            {
                Self::Reached(step)
            }
            _ => Self::Unknown,
        }
    }
}

/// What the middle shows and what its keys mean.
struct Scene<'a> {
    session: &'a RecordingSession,
    phase: RecordingPhase,
    status: RecordingStatus,
    /// Who decides: only who has control does.
    holder: Holder,
    /// What the station needs before it may move; `None` if it may.
    not_ready: Option<&'static str>,
    /// Nothing can be done now: something is on its way, or the picture is frozen.
    waits: bool,
}

impl Scene<'_> {
    /// Whether this page may do anything with the recording now.
    fn may_act(&self) -> bool {
        self.holder == Holder::Me && !self.waits
    }

    /// The step under way, if its take is part of the session already.
    fn accepted_step(&self) -> Option<usize> {
        let accepted =
            |idx: &usize| self.session.steps.get(*idx).is_some_and(|step| step.state == StepState::Accepted);
        self.session.current.filter(accepted)
    }

    /// What its check says of the take that is reviewed; `None` until it is there.
    fn verdict(&self) -> Option<&TakeVerdict> {
        self.session.steps.get(self.session.current?)?.verdict.as_ref()
    }

    fn is_at_start(&self, state: &RecordState) -> bool {
        self.session.current.is_some_and(|step| state.start_pose == StartPose::Reached(step))
    }
}

impl View for RecordState {
    fn ui(&mut self, ui: &mut egui::Ui, cx: &mut ScreenContext<'_>) {
        if !cx.store.is_commandable() {
            let text = "Recording needs a live station: start `palpate serve --station FILE` on the machine that its \
                        devices are connected to, or `palpate serve --emulate` to try it without hardware. docs/hardware.md says \
                        how a station is set up.";
            if empty_ui(ui, "No live station", text, "Look at recordings") {
                cx.go_to_screen(Screen::Sessions);
            }
            return;
        }
        let station = cx.store.live_station();
        let Some(station) =
            loaded_ui(ui, cx, station, "Reading the live station", "The live station could not be read")
        else {
            return;
        };
        let document = cx.store.recording();
        let Some(document) =
            loaded_ui(ui, cx, document, "Reading the checklist", "The checklist did not arrive")
        else {
            return;
        };
        let names = channel_names(&station);
        if !is_narrow(ui.ctx()) {
            Panel::right("record_incoming")
                .frame(egui::Frame::NONE.inner_margin(egui::Margin::symmetric(8, 0)))
                .resizable(false)
                .exact_size(INCOMING_WIDTH)
                .show(ui, |ui| incoming::incoming_ui(ui, cx, &station, document.session.as_ref(), &names));
        }
        match &document.session {
            Some(session) => session_ui(ui, cx, self, session, &station, &names),
            None => {
                self.start_pose = StartPose::Unknown;
                egui::CentralPanel::default().show(ui, |ui| {
                    egui::ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
                        // What comes first may widen it; the bar that scrolls lies over the right edge.
                        let width = (ui.available_width() - 24.0).min(520.0);
                        start::start_ui(ui, cx, &mut self.start, &document);
                        ui.add_space(16.0);
                        ui.vertical_centered(|ui| {
                            ui.set_max_width(width);
                            ui.with_layout(egui::Layout::top_down(egui::Align::Min), |ui| {
                                free::free_ui(ui, cx, &mut self.free, &document, &station);
                            });
                        });
                        ui.add_space(12.0);
                    });
                });
            }
        }
    }
}

/// Names of channels for people, by id.
type Names = BTreeMap<String, String>;

fn channel_names(station: &Arc<Station>) -> Names {
    station
        .layout
        .channels
        .iter()
        .enumerate()
        .map(|(idx, channel)| (channel.id.clone(), station.layout.channel_label(idx)))
        .collect()
}

fn session_ui(
    ui: &mut egui::Ui,
    cx: &mut ScreenContext<'_>,
    state: &mut RecordState,
    session: &RecordingSession,
    station: &Arc<Station>,
    names: &Names,
) {
    let phase = cx.store.recording_phase().unwrap_or(session.phase);
    let streamed = cx.store.control_state().and_then(|state| state.recording.clone());
    let frozen = cx.store.frozen_since(cx.now_s).is_some() || !cx.store.control.is_open();
    let scene = Scene {
        session,
        phase,
        status: streamed.unwrap_or_default(),
        holder: cx.store.control.holder(cx.store.control_state()),
        not_ready: not_ready(cx.store),
        waits: cx.store.recording_busy || frozen,
    };
    let problem = !session.problem.is_empty() || cx.store.recording_problem.is_some();
    state.start_pose = state.start_pose.next(phase, session.current, problem);
    let called_off = state.start_pose == StartPose::CalledOff;
    state.interruptions.follow(&scene, cx.store, called_off);
    if state.interruptions.is_fresh() && matches!(state.start_pose, StartPose::Reached(_)) {
        // The checklist with the reason may come later than the news that the way ended.
        state.start_pose = StartPose::Unknown;
    }
    if state.doubt.as_ref().is_some_and(|(step, _)| scene.accepted_step() != Some(*step)) {
        state.doubt = None;
    }
    let mut actions = Vec::new();
    if is_narrow(ui.ctx()) {
        // One column: the step under way, then what a wide page has beside it.
        egui::CentralPanel::default().show(ui, |ui| {
            egui::ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
                step::step_ui(ui, cx, state, &scene, station, names, &mut actions);
                ui.separator();
                checklist::checklist_ui(ui, cx, &scene, &mut actions);
                ui.separator();
                incoming::incoming_ui(ui, cx, station, Some(session), names);
            });
        });
    } else {
        Panel::left("record_checklist")
            .frame(egui::Frame::NONE.inner_margin(egui::Margin::symmetric(8, 0)))
            .resizable(false)
            .exact_size(LIST_WIDTH)
            .show(ui, |ui| checklist::checklist_ui(ui, cx, &scene, &mut actions));
        egui::CentralPanel::default().show(ui, |ui| {
            egui::ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
                step::step_ui(ui, cx, state, &scene, station, names, &mut actions);
            });
        });
    }
    keys(ui, &scene, state, &mut actions, cx.store);
    // One thing at a time: a second one would be meant for another step.
    if let Some(action) = actions.into_iter().next().filter(|_| scene.may_act()) {
        if action == RecordingAction::Cancel {
            state.start_pose = StartPose::CalledOff;
        }
        if !matches!(action, RecordingAction::Note { .. }) {
            state.interruptions.pressed();
            state.doubt = None;
        }
        cx.store.act_on_recording(action);
    }
}

/// Asks for the action `action`, or once more first if it sets an accepted take aside.
fn ask_twice(
    scene: &Scene<'_>,
    state: &mut RecordState,
    action: RecordingAction,
    actions: &mut Vec<RecordingAction>,
) {
    let sets_aside = matches!(action, RecordingAction::Again | RecordingAction::Discard);
    match scene.accepted_step().filter(|_| sets_aside) {
        Some(step) => state.doubt = Some((step, action)),
        None => actions.push(action),
    }
}

/// What the station still needs before it may move by itself.
fn not_ready(store: &Store) -> Option<&'static str> {
    match store.control.holder(store.control_state()) {
        Holder::Nobody => Some("Take control, then arm."),
        Holder::Other(_) => Some("Somebody else has control: you can watch."),
        Holder::Me => match store.phase() {
            Phase::Armed => None,
            Phase::Holding => Some("The station holds; the line below the top bar says why."),
            Phase::Stopped => {
                Some("The station is stopped. Before you reset that, see why, and that nobody is in the way.")
            }
            Phase::Arming | Phase::Disarming => Some("Wait a moment."),
            Phase::Disarmed | Phase::Unspecified => Some("The motors are off: arm the station."),
        },
    }
}

/// What the primary button of a scene does.
#[derive(Clone, Debug, PartialEq)]
enum Primary {
    /// Takes control for this page.
    TakeControl,
    /// Switches the motors on.
    Arm,
    /// Ends a latched stop; the motors stay off.
    ResetStop,
    /// Does something with the step under way: its name, and what.
    Act(&'static str, RecordingAction),
}

/// The next step of the operator; `None` while the station is at work, or where somebody else decides.
fn primary(scene: &Scene<'_>, state: &RecordState, store: &Store) -> Option<Primary> {
    let (name, action) = match scene.phase {
        RecordingPhase::Checking | RecordingPhase::Done => return None,
        _ if scene.holder == Holder::Nobody => return Some(Primary::TakeControl),
        _ if scene.holder != Holder::Me => return None,
        RecordingPhase::PlaceObject => (
            "Object is in place",
            RecordingAction::ConfirmObject { fixture_trusted: !state.fixture_elsewhere },
        ),
        RecordingPhase::StartPose if matches!(store.phase(), Phase::Disarmed | Phase::Unspecified) => {
            return Some(Primary::Arm);
        }
        RecordingPhase::StartPose if store.phase() == Phase::Stopped => return Some(Primary::ResetStop),
        RecordingPhase::StartPose if scene.is_at_start(state) => ("Run", RecordingAction::Run),
        RecordingPhase::StartPose => ("Go to start pose", RecordingAction::GoToStart),
        RecordingPhase::Review => {
            // Its check has the last word, and says what is best done with it.
            if scene.verdict()?.good {
                ("Accept", RecordingAction::Accept)
            } else {
                ("Record again", RecordingAction::Again)
            }
        }
        RecordingPhase::GoingToStart
        | RecordingPhase::Baseline
        | RecordingPhase::Countdown
        | RecordingPhase::Running => return None,
    };
    Some(Primary::Act(name, action))
}

/// Whether an action moves the robot, which needs an armed station.
fn moves(action: &RecordingAction) -> bool {
    matches!(action, RecordingAction::GoToStart | RecordingAction::Run)
}

/// The keys do what the buttons do, under the same rule: without control, nothing. Control is not taken and motors are not
/// switched on by a key.
fn keys(
    ui: &egui::Ui,
    scene: &Scene<'_>,
    state: &mut RecordState,
    actions: &mut Vec<RecordingAction>,
    store: &Store,
) {
    // A focused control has its own Enter, and a text field its own letters.
    if !scene.may_act() || ui.ctx().text_edit_focused() {
        return;
    }
    let focused = ui.memory(|memory| memory.focused().is_some());
    let key = |key| ui.input(|input| input.modifiers.is_none() && input.key_pressed(key));
    if key(Key::Enter)
        && !focused
        && let Some(Primary::Act(_, action)) = primary(scene, state, store)
        && !(moves(&action) && scene.not_ready.is_some())
    {
        ask_twice(scene, state, action, actions);
    }
    match scene.phase {
        RecordingPhase::PlaceObject if key(Key::P) => state.fixture_elsewhere ^= true,
        RecordingPhase::StartPose if scene.not_ready.is_none() => {
            if key(Key::G) {
                actions.push(RecordingAction::GoToStart);
            }
            if key(Key::B) {
                actions.push(RecordingAction::Run);
            }
        }
        RecordingPhase::GoingToStart
        | RecordingPhase::Baseline
        | RecordingPhase::Countdown
        | RecordingPhase::Running
            if key(Key::Escape) =>
        {
            actions.push(RecordingAction::Cancel);
        }
        _ => {}
    }
    if scene.session.can_undo && key(Key::U) {
        actions.push(RecordingAction::Undo);
    }
    if !focused && let Some(step) = neighbour(scene, key(Key::ArrowUp), key(Key::ArrowDown)) {
        actions.push(RecordingAction::Select { step });
    }
    if (step::takes_notes(scene.phase) || scene.phase == RecordingPhase::Review) && key(Key::N) {
        state.write_note = true;
    }
    if scene.phase == RecordingPhase::Review {
        if key(Key::A) && scene.verdict().is_some() {
            actions.push(RecordingAction::Accept);
        }
        if key(Key::R) {
            ask_twice(scene, state, RecordingAction::Again, actions);
        }
        if key(Key::Delete) {
            ask_twice(scene, state, RecordingAction::Discard, actions);
        }
    }
    if step::takes_notes(scene.phase) && key(Key::M) {
        actions.push(RecordingAction::Note { text: String::new() });
    }
}

/// The step above or below the one under way, if one was asked for and is there.
fn neighbour(scene: &Scene<'_>, up: bool, down: bool) -> Option<usize> {
    let count = scene.session.steps.len();
    match (scene.session.current, up, down) {
        (Some(step), true, false) => step.checked_sub(1),
        (Some(step), false, true) => Some(step + 1).filter(|&step| step < count),
        (None, true, false) => count.checked_sub(1),
        (None, false, true) => Some(0).filter(|_| count > 0),
        _ => None,
    }
}

/// The plan's name for people.
fn plan_label<'a>(document: &'a RecordingDocument, plan: &'a str) -> &'a str {
    document.plans.iter().find(|known| known.id == plan).map_or(plan, |known| &known.label)
}
