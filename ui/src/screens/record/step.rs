//! The step under way, large: what to do with the body, one primary button, a countdown for people two metres away.

use std::{sync::Arc, time::Duration};

use egui::{RichText, accesskit::Role};
use palpate_reports::TakeVerdict;
use palpate_robot_model::Station;
use palpate_wire::api::{RecordingAction, RecordingPhase, RecordingStep, StepState};

use super::{Names, Primary, RecordState, Scene, ask_twice, moves, primary};
use crate::{
    route::{Route, Screen},
    screens::{
        ScreenContext, as_sentence, duration_text,
        hand::{Placement, PlacementView},
        progress_bar,
    },
    store::control::Holder,
    theme::Palette,
};

/// Size of the countdown's digits, points: about 6 cm on a laptop's screen.
const COUNTDOWN_POINTS: f32 = 230.0;
/// Of the picture of where the object goes, points.
const PLACEMENT_HEIGHT: f32 = 260.0;
/// So many names of channels are listed before the rest is counted.
const MAX_NAMES: usize = 12;

/// Whether remarks belong to a take in this phase.
pub(super) fn takes_notes(phase: RecordingPhase) -> bool {
    matches!(phase, RecordingPhase::Baseline | RecordingPhase::Countdown | RecordingPhase::Running)
}

pub(super) fn step_ui(
    ui: &mut egui::Ui,
    cx: &mut ScreenContext<'_>,
    state: &mut RecordState,
    scene: &Scene<'_>,
    station: &Arc<Station>,
    names: &Names,
    actions: &mut Vec<RecordingAction>,
) {
    let step = scene.session.current.and_then(|idx| scene.session.steps.get(idx));
    let (Some(step), Some(idx)) = (step, scene.session.current) else {
        done_ui(ui, cx, scene, names);
        problems_ui(ui, cx, state, scene);
        undo_ui(ui, scene, actions);
        return;
    };
    ui.add_space(8.0);
    let of = scene.session.steps.len();
    ui.label(RichText::new(format!("Take {} of {of}", idx + 1)).color(cx.palette.text_weak).size(16.0));
    ui.label(RichText::new(format!("{}: {}", step.primitive_label, step.object_label)).strong().size(26.0));
    if let Some(why) = &step.added_because {
        ui.label(RichText::new(format!("Added to the plan: {why}")).color(cx.palette.text_weak));
    }
    ui.add_space(10.0);
    // While the robot moves, the page has better things to do than to draw it.
    if matches!(scene.phase, RecordingPhase::PlaceObject | RecordingPhase::StartPose) {
        placement_ui(ui, cx, &mut state.placement, station, step);
    }
    match scene.phase {
        RecordingPhase::PlaceObject => place_ui(ui, state, scene, step),
        RecordingPhase::StartPose => start_pose_ui(ui, cx, state, scene),
        RecordingPhase::GoingToStart => {
            big_ui(ui, "The robot goes to the start pose");
            ui.label(RichText::new("Keep your hands away from it. Space stops it.").size(18.0));
            ui.spinner();
        }
        RecordingPhase::Baseline => {
            big_ui(ui, "Touch nothing");
            ui.label(
                RichText::new("The readings at rest are taken: they become the zero of this take.")
                    .size(18.0),
            );
            countdown_ui(ui, scene.status.countdown_s, &cx.palette);
        }
        RecordingPhase::Countdown => countdown_ui(ui, scene.status.countdown_s, &cx.palette),
        RecordingPhase::Running => running_ui(ui, scene, step),
        RecordingPhase::Checking => {
            big_ui(ui, "Checking the take");
            ui.spinner();
        }
        RecordingPhase::Review => match &step.verdict {
            Some(verdict) => verdict_ui(ui, verdict, names, &cx.palette),
            None => {
                big_ui(ui, "Checking the take");
                ui.spinner();
            }
        },
        RecordingPhase::Done => {}
    }
    ui.add_space(14.0);
    interrupted_ui(ui, cx, state);
    buttons_ui(ui, cx, state, scene, actions);
    doubt_ui(ui, cx, state, scene, actions);
    problems_ui(ui, cx, state, scene);
    undo_ui(ui, scene, actions);
    if takes_notes(scene.phase) || scene.phase == RecordingPhase::Review {
        note_ui(ui, state, scene, actions);
    }
    if !matches!(
        scene.phase,
        RecordingPhase::PlaceObject | RecordingPhase::StartPose | RecordingPhase::Review
    ) {
        ui.ctx().request_repaint_after(Duration::from_millis(50));
    }
}

fn big_ui(ui: &mut egui::Ui, text: &str) {
    ui.label(RichText::new(text).size(30.0).strong());
}

/// Where the object goes and where the hand will start, in a picture and in numbers.
fn placement_ui(
    ui: &mut egui::Ui,
    cx: &mut ScreenContext<'_>,
    view: &mut PlacementView,
    station: &Arc<Station>,
    step: &RecordingStep,
) {
    let frame = cx.store.live_frame().map(|frame| frame.joint_positions.clone()).unwrap_or_default();
    let positions: Vec<f64> = frame.into_iter().map(f64::from).collect();
    let placement = Placement::new(station, &positions, &step.start, (&step.object, &step.object_pose));
    let Some(placement) = placement else { return };
    let size = egui::vec2(ui.available_width(), PLACEMENT_HEIGHT);
    let (rect, _) = ui.allocate_exact_size(size, egui::Sense::hover());
    view.ui(ui, rect, &placement, &cx.palette, cx.surface);
    let [x, y, z] = [0, 1, 2].map(|axis| 1e3 * placement.base_from_object.translation.vector[axis]);
    let text = format!(
        "{} at x {x:+.0} mm, y {y:+.0} mm, z {z:+.0} mm from the robot's base. The ghost of the hand is where the motion starts.",
        step.object_label
    );
    ui.label(RichText::new(text).color(cx.palette.text_weak));
    ui.add_space(8.0);
}

fn place_ui(ui: &mut egui::Ui, state: &mut RecordState, scene: &Scene<'_>, step: &RecordingStep) {
    ui.label(RichText::new(&step.instruction).size(22.0));
    ui.add_space(8.0);
    let mut trusted = !state.fixture_elsewhere;
    let checkbox = egui::Checkbox::new(&mut trusted, "The fixture holds it where the plan says");
    ui.add_enabled(scene.may_act(), checkbox).on_hover_text(
        "Key P. Off: its place is not trusted, so distances to it will not be used to judge the simulation",
    );
    state.fixture_elsewhere = !trusted;
}

fn start_pose_ui(ui: &mut egui::Ui, cx: &ScreenContext<'_>, state: &RecordState, scene: &Scene<'_>) {
    if scene.is_at_start(state) {
        big_ui(ui, "Ready to run");
        ui.label(
            RichText::new("Step back. A countdown follows, then the robot moves by itself; Space stops it.")
                .size(18.0),
        );
    } else {
        big_ui(ui, "Bring the robot to its start");
        ui.label(
            RichText::new(
                "The button does it, slowly. Or jog or lead it there by hand on Hand, and run from there.",
            )
            .size(18.0),
        );
    }
    if let Some(why) = scene.not_ready {
        ui.add_space(6.0);
        ui.label(RichText::new(why).size(18.0).color(cx.palette.warning));
    }
}

fn countdown_ui(ui: &mut egui::Ui, left_s: f32, palette: &Palette) {
    let seconds = left_s.max(0.0).ceil();
    ui.vertical_centered(|ui| {
        let digits =
            RichText::new(format!("{seconds:.0}")).size(COUNTDOWN_POINTS).strong().color(palette.real);
        let response = ui.label(digits);
        response.widget_info(|| {
            egui::WidgetInfo::labeled(Role::Label, true, format!("Starts in {seconds:.0} s"))
        });
        ui.label(RichText::new("Hands off: the robot is about to move").size(24.0));
    });
}

fn running_ui(ui: &mut egui::Ui, scene: &Scene<'_>, step: &RecordingStep) {
    let status = &scene.status;
    let activity = if status.activity.is_empty() { "Recording" } else { &status.activity };
    big_ui(ui, &as_sentence(activity));
    let fraction = status.fraction.clamp(0.0, 1.0);
    let left_s = step.duration_s * f64::from(1.0 - fraction);
    let text = format!("{:.0} %, {} left", fraction * 100.0, duration_text(left_s));
    ui.add(progress_bar(f64::from(fraction), &text).desired_height(28.0));
    ui.label(format!("Recorded {}", duration_text(f64::from(status.elapsed_s))));
}

fn verdict_ui(ui: &mut egui::Ui, verdict: &TakeVerdict, names: &Names, palette: &Palette) {
    let (sign, word, color) = if verdict.good {
        ("\u{2714}", "Good take", palette.diagnosed)
    } else {
        ("\u{26a0}", "Look at this take", palette.warning)
    };
    ui.label(RichText::new(format!("{sign} {word}")).size(30.0).strong().color(color));
    ui.label(RichText::new(&verdict.summary).size(18.0));
    for problem in &verdict.problems {
        ui.label(format!("\u{2022} {problem}"));
    }
    if !verdict.missed.is_empty() {
        ui.label(format!("Not touched: {}", name_list(&verdict.missed, names)));
    }
    ui.label(RichText::new(format!("{} channels touched", verdict.covered.len())).color(palette.text_weak));
    let rates: Vec<String> =
        verdict.rates_hz.iter().map(|(name, rate_hz)| format!("{name} {rate_hz:.1} Hz")).collect();
    if !rates.is_empty() {
        ui.label(RichText::new(rates.join(", ")).color(palette.text_weak));
    }
}

/// Names of channels, the first ones in full.
fn name_list(ids: &[String], names: &Names) -> String {
    let shown: Vec<&str> =
        ids.iter().take(MAX_NAMES).map(|id| names.get(id).map_or(id.as_str(), String::as_str)).collect();
    let more = ids.len().saturating_sub(MAX_NAMES);
    if more == 0 { shown.join(", ") } else { format!("{} and {more} more", shown.join(", ")) }
}

/// Why the robot did not come to its start.
fn interrupted_ui(ui: &mut egui::Ui, cx: &ScreenContext<'_>, state: &RecordState) {
    if let Some((text, _)) = state.interruptions.text() {
        ui.label(RichText::new(format!("\u{26a0} {text}")).size(16.0).color(cx.palette.mismatch));
        ui.add_space(8.0);
    }
}

/// A large button with a strong frame; true when it was clicked.
pub(super) fn primary_button_ui(
    ui: &mut egui::Ui,
    palette: &Palette,
    name: &str,
    face: &str,
    ready: bool,
) -> egui::Response {
    let width = ui.available_width().min(260.0);
    let button = egui::Button::new(RichText::new(face).size(20.0).strong())
        .fill(ui.visuals().selection.bg_fill)
        .stroke(egui::Stroke::new(2.0, palette.real))
        .min_size(egui::vec2(width, 60.0));
    let response = ui.add_enabled(ready, button);
    response.widget_info(|| egui::WidgetInfo::labeled(Role::Button, ready, name));
    response
}

/// Where nobody has control, the step before every other one.
pub(super) fn take_control_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>) {
    let link = &cx.store.control;
    let live = link.is_open() && cx.store.frozen_since(cx.now_s).is_none();
    let ready = live && !link.waits_for("Take control");
    // The bar has a button of the same name; this one does the same.
    if primary_button_ui(ui, &cx.palette, "Take control to go on", "Take control", ready).clicked() {
        cx.store.control.want_control();
    }
}

/// Where somebody else has control, who decides.
pub(super) fn decides_ui(ui: &mut egui::Ui, cx: &ScreenContext<'_>, name: &str) {
    ui.label(RichText::new(format!("{name} decides")).size(20.0).strong());
    ui.label(RichText::new("You can watch, and press STOP.").color(cx.palette.text_weak));
}

/// The primary button, and beside it what else can be done.
fn buttons_ui(
    ui: &mut egui::Ui,
    cx: &mut ScreenContext<'_>,
    state: &mut RecordState,
    scene: &Scene<'_>,
    actions: &mut Vec<RecordingAction>,
) {
    if let Holder::Other(name) = &scene.holder {
        return decides_ui(ui, cx, name);
    }
    ui.horizontal_wrapped(|ui| {
        match primary(scene, state, cx.store) {
            Some(Primary::TakeControl) => take_control_ui(ui, cx),
            Some(Primary::Arm) => {
                let ready = scene.may_act() && !cx.store.control.waits_for("Arm");
                let response =
                    primary_button_ui(ui, &cx.palette, "Arm the station", "Arm the station", ready);
                if response.on_hover_text("Torque on, where the joints are now").clicked() {
                    cx.store.control.arm();
                }
            }
            Some(Primary::ResetStop) => {
                let ready = scene.may_act() && !cx.store.control.waits_for("Reset stop");
                let face = "Reset the stop";
                if primary_button_ui(ui, &cx.palette, face, face, ready).clicked() {
                    cx.store.control.reset_stop();
                }
            }
            Some(Primary::Act(name, action)) => {
                let blocked = moves(&action) && scene.not_ready.is_some();
                let face = format!("{name}  (Enter)");
                let ready = scene.may_act() && !blocked;
                let response = primary_button_ui(ui, &cx.palette, name, &face, ready);
                if response.on_hover_text("Enter does the same").clicked() {
                    ask_twice(scene, state, action, actions);
                }
            }
            None => {}
        }
        let second = |ui: &mut egui::Ui, name: &str, keys: &str, enabled: bool| {
            let face = if keys.is_empty() { name.to_owned() } else { format!("{name}  ({keys})") };
            let button = egui::Button::new(RichText::new(face).size(16.0)).min_size(egui::vec2(120.0, 44.0));
            let enabled = enabled && scene.may_act();
            let response = ui.add_enabled(enabled, button);
            response.widget_info(|| egui::WidgetInfo::labeled(Role::Button, enabled, name));
            response.clicked()
        };
        let ready = scene.not_ready.is_none();
        match scene.phase {
            RecordingPhase::StartPose if scene.is_at_start(state) => {
                if second(ui, "Go to start pose", "G", ready) {
                    actions.push(RecordingAction::GoToStart);
                }
            }
            RecordingPhase::StartPose => {
                if second(ui, "Run", "B", ready) {
                    actions.push(RecordingAction::Run);
                }
            }
            RecordingPhase::Review => {
                // The other one of the two is the primary button.
                if scene.verdict().is_some_and(|verdict| !verdict.good) {
                    if second(ui, "Accept", "A", true) {
                        actions.push(RecordingAction::Accept);
                    }
                } else if second(ui, "Record again", "R", true) {
                    ask_twice(scene, state, RecordingAction::Again, actions);
                }
                if second(ui, "Discard", "Del", true) {
                    ask_twice(scene, state, RecordingAction::Discard, actions);
                }
            }
            RecordingPhase::GoingToStart
            | RecordingPhase::Baseline
            | RecordingPhase::Countdown
            | RecordingPhase::Running => {
                if second(ui, "Cancel", "Esc", true) {
                    actions.push(RecordingAction::Cancel);
                }
            }
            RecordingPhase::PlaceObject | RecordingPhase::Checking | RecordingPhase::Done => {}
        }
    });
}

/// The question before an accepted take is set aside. No key answers it: a key that is held down repeats.
fn doubt_ui(
    ui: &mut egui::Ui,
    cx: &ScreenContext<'_>,
    state: &mut RecordState,
    scene: &Scene<'_>,
    actions: &mut Vec<RecordingAction>,
) {
    let Some((step, action)) = state.doubt.clone().filter(|_| scene.may_act()) else { return };
    let what = if action == RecordingAction::Again { "Record it again" } else { "Discard it" };
    ui.add_space(8.0);
    let text = format!("Take {} is accepted and part of the session. {what} all the same?", step + 1);
    ui.label(RichText::new(text).size(16.0).strong().color(cx.palette.warning));
    ui.horizontal_wrapped(|ui| {
        let yes = match action {
            RecordingAction::Again => "Set the accepted take aside",
            _ => "Discard the accepted take",
        };
        if ui.button(yes).clicked() {
            actions.push(action);
        }
        if ui.button("Keep it").clicked() {
            state.doubt = None;
        }
    });
}

/// What did not work: the server's reason, and the answer to the last thing that was tried.
fn problems_ui(ui: &mut egui::Ui, cx: &ScreenContext<'_>, state: &RecordState, scene: &Scene<'_>) {
    let refused = cx.store.recording_problem.as_deref();
    // What interrupted the way to the start is on the screen already.
    let told = state.interruptions.text().map_or("", |(_, reason)| reason);
    let reported =
        Some(scene.session.problem.as_str()).filter(|problem| !problem.is_empty() && *problem != told);
    let mut shown: Vec<&str> = reported.into_iter().chain(refused).collect();
    shown.dedup();
    for problem in shown {
        ui.add_space(6.0);
        ui.label(RichText::new(format!("\u{26a0} {problem}")).size(16.0).color(cx.palette.mismatch));
    }
}

fn undo_ui(ui: &mut egui::Ui, scene: &Scene<'_>, actions: &mut Vec<RecordingAction>) {
    if !scene.session.can_undo {
        return;
    }
    ui.add_space(8.0);
    ui.horizontal(|ui| {
        ui.label("A take was discarded.");
        let undo = ui.add_enabled(scene.may_act(), egui::Button::new("Undo discard  (U)"));
        undo.widget_info(|| egui::WidgetInfo::labeled(Role::Button, scene.may_act(), "Undo discard"));
        if undo.clicked() {
            actions.push(RecordingAction::Undo);
        }
    });
}

fn note_ui(
    ui: &mut egui::Ui,
    state: &mut RecordState,
    scene: &Scene<'_>,
    actions: &mut Vec<RecordingAction>,
) {
    ui.add_space(12.0);
    ui.horizontal(|ui| {
        let field = egui::TextEdit::singleline(&mut state.note)
            .hint_text("A remark, e.g. \"the ball slipped\"")
            .desired_width(320.0)
            .min_size(egui::vec2(0.0, 32.0));
        let response = ui.add_enabled(scene.holder == Holder::Me, field).accessible_name("Note");
        if std::mem::take(&mut state.write_note) {
            response.request_focus();
        }
        let enter = response.lost_focus() && ui.input(|input| input.key_pressed(egui::Key::Enter));
        let text = state.note.trim();
        // A bare mark belongs to a moment, and a take that is reviewed has none.
        let may_mark = takes_notes(scene.phase);
        let (name, face) =
            if text.is_empty() && may_mark { ("Mark", "Mark  (M)") } else { ("Add note", "Add note") };
        let ready = scene.may_act() && (may_mark || !text.is_empty());
        let button = ui.add_enabled(ready, egui::Button::new(face));
        button.widget_info(|| egui::WidgetInfo::labeled(Role::Button, ready, name));
        if ready && (button.clicked() || (enter && !text.is_empty())) {
            actions.push(RecordingAction::Note { text: text.to_owned() });
            state.note.clear();
        }
    });
    if ui.ctx().text_edit_focused() && takes_notes(scene.phase) {
        ui.label("While you type, the space bar writes spaces. Esc, then Space stops; so does STOP.");
    }
}

fn done_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, scene: &Scene<'_>, names: &Names) {
    let session = scene.session;
    let accepted = session.steps.iter().filter(|step| step.state == StepState::Accepted).count();
    ui.add_space(30.0);
    ui.label(
        RichText::new("\u{2714} Every take is recorded").size(30.0).strong().color(cx.palette.diagnosed),
    );
    let takes = if accepted == 1 { "1 take is".to_owned() } else { format!("{accepted} takes are") };
    ui.label(RichText::new(format!("{takes} accepted and part of session {}.", session.session)).size(18.0));
    if !session.untouched.is_empty() {
        ui.label(
            RichText::new(format!(
                "No take has touched: {}. They cannot be calibrated; choose a take on the left to record it again.",
                name_list(&session.untouched, names)
            ))
            .color(cx.palette.warning),
        );
    }
    ui.add_space(10.0);
    let button = egui::Button::new(RichText::new("Calibrate on it").size(20.0).strong())
        .min_size(egui::vec2(260.0, 60.0));
    if ui.add(button).clicked() {
        *cx.go_to = Some(Route::to(Screen::Calibrate).with_session(&session.session));
    }
}
