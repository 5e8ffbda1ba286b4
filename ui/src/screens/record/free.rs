//! A take outside guided sessions: what whoever has control does now, recorded from Start to Stop.

use std::collections::BTreeSet;

use egui::RichText;
use palpate_robot_model::Station;
use palpate_wire::api::{FreeTake, FreeTakeState, RecordingDocument, StartTake, TakeAction};

use super::start::{free_name, name_problem};
use crate::{
    route::Screen,
    screens::{
        ScreenContext, announced_ui,
        controls::{combo_ui, option_ui},
        duration_text,
    },
    store::{Loadable, control::Holder},
};

/// What was chosen so far.
#[derive(Debug, Default)]
pub(super) struct FreeState {
    /// `None` until somebody types: then the name is made up.
    name: Option<String>,
    object: Option<String>,
    /// Where the object stands, from the robot's base, mm.
    at_mm: [f64; 3],
    /// How far it is turned about the vertical, degrees.
    yaw_deg: f64,
    is_fixed: bool,
}

/// The panel; it says what is being recorded to everybody, and lets whoever has control begin and end it.
pub(super) fn free_ui(
    ui: &mut egui::Ui,
    cx: &mut ScreenContext<'_>,
    state: &mut FreeState,
    document: &RecordingDocument,
    station: &Station,
) {
    let is_recording = document.free.as_ref().is_some_and(|free| free.state == FreeTakeState::Recording);
    let title = "Record a take of what you do now";
    egui::CollapsingHeader::new(title).default_open(document.free.is_some()).show(ui, |ui| {
        ui.label(
            "Everything is recorded while you move the robot as you like: by the sliders of Hand, by leading the arm, by a \
             script. Keep the hand still and free of touch for the first second: that is the zero of all channels.",
        );
        if let Some(free) = &document.free {
            free_take_ui(ui, cx, free);
        }
        let holder = cx.store.control.holder(cx.store.control_state());
        match holder {
            Holder::Other(name) => {
                ui.label(format!("{name} has control: they begin and end takes, and you can watch."));
            }
            Holder::Nobody => {
                ui.label("Take control to record a take: whoever has control begins and ends it.");
            }
            Holder::Me if is_recording => stop_ui(ui, cx),
            Holder::Me => form_ui(ui, cx, state, station),
        }
        if let Some(problem) = &cx.store.free_take_problem {
            ui.colored_label(cx.palette.mismatch, format!("\u{26a0} {problem}"));
        }
    });
}

/// Where the take stands that is recorded, or was recorded last.
fn free_take_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, free: &FreeTake) {
    let FreeTake { session, object, primitive, problem, .. } = free;
    let take = free.take.as_deref().unwrap_or("the take");
    let text = match free.state {
        FreeTakeState::Recording => {
            let status = cx.store.control_state().and_then(|state| state.recording.as_ref());
            let elapsed = status.map_or_else(String::new, |status| {
                format!(", {}", duration_text(f64::from(status.elapsed_s).floor()))
            });
            format!("\u{23fa} Recording {take} of {session}: {primitive} on {object}{elapsed}")
        }
        FreeTakeState::Checking => format!("{take} of {session} is over, and is being checked."),
        FreeTakeState::Accepted => format!("{take} is part of session {session}."),
        FreeTakeState::SetAside => format!("{take} of {session} was set aside."),
        FreeTakeState::Lost => format!("{take} of {session} could not be kept."),
    };
    let text = RichText::new(text).strong();
    match free.state {
        FreeTakeState::Recording => ui.label(text.color(cx.palette.real)),
        // The time above changes; this does not.
        _ => announced_ui(ui, text, false),
    };
    if !problem.is_empty() {
        ui.colored_label(cx.palette.warning, problem);
    }
    if let Some(verdict) = &free.verdict {
        ui.label(&verdict.summary);
        let is_said = |known: &&String| !problem.is_empty() && known.contains(problem.as_str());
        for problem in verdict.problems.iter().filter(|known| !is_said(known)) {
            ui.label(format!("\u{2022} {problem}"));
        }
    }
    if let (FreeTakeState::Accepted, Some(take)) = (free.state, &free.take)
        && ui.button(format!("Look at {take}")).clicked()
    {
        cx.playback.open(session, take);
        cx.go_to_screen(Screen::Timelines);
    }
}

fn stop_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>) {
    let ready = !cx.store.free_take_busy && cx.store.control.is_open();
    ui.horizontal_wrapped(|ui| {
        let stop =
            egui::Button::new(RichText::new("Stop recording").strong()).min_size(egui::vec2(0.0, 40.0));
        if ui.add_enabled(ready, stop).clicked() {
            cx.store.act_on_take(TakeAction::End { set_aside: false });
        }
        let discard = ui
            .add_enabled(ready, egui::Button::new("Stop and set aside").min_size(egui::vec2(0.0, 40.0)))
            .on_hover_text("The take goes to the session's folder of takes that were set aside");
        if discard.clicked() {
            cx.store.act_on_take(TakeAction::End { set_aside: true });
        }
    });
}

fn form_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, state: &mut FreeState, station: &Station) {
    let mut objects: BTreeSet<String> = station.objects.keys().cloned().collect();
    if let Loadable::Ready(more) = cx.store.objects() {
        objects.extend(more.iter().filter(|object| object.content.is_ok()).map(|object| object.id.clone()));
    }
    let Some(first) = objects.first().cloned() else {
        ui.label("A take is of an object, and this station has none; add one under Objects.");
        return;
    };
    let mut object = state.object.clone().filter(|object| objects.contains(object)).unwrap_or(first);
    ui.horizontal_wrapped(|ui| {
        ui.label("Object");
        combo_ui(ui, "Object of the take", &object.clone(), 200.0, |ui| {
            for known in &objects {
                option_ui(ui, &mut object, known.clone(), known);
            }
        });
    });
    state.object = Some(object.clone());
    ui.label("Where it stands, from the robot's base");
    ui.horizontal_wrapped(|ui| {
        for (axis, value) in ["x", "y", "z"].into_iter().zip(&mut state.at_mm) {
            let label = ui.label(axis);
            ui.add(egui::DragValue::new(value).speed(1.0).range(-5000.0..=5000.0).suffix(" mm"))
                .labelled_by(label.id);
        }
        let label = ui.label("turned");
        ui.add(egui::DragValue::new(&mut state.yaw_deg).speed(1.0).range(-180.0..=180.0).suffix("\u{b0}"))
            .labelled_by(label.id);
    });
    if state.at_mm == [0.0; 3] {
        let text = "0, 0, 0 is the robot's base itself. Without the real place the take is good for looking at alone.";
        ui.label(RichText::new(text).color(cx.palette.text_weak));
    }
    ui.checkbox(&mut state.is_fixed, "A fixture holds it there")
        .on_hover_text("Without, a calibration or a diagnosis cannot rely on where the object was");
    let sessions = cx.store.sessions();
    let known: Vec<&str> = sessions
        .ready()
        .map_or_else(Vec::new, |sessions| sessions.iter().map(|session| session.id.as_str()).collect());
    let mut name = state.name.clone().unwrap_or_else(|| free_name("by-hand", &known));
    ui.horizontal_wrapped(|ui| {
        ui.label("Session");
        let field = egui::TextEdit::singleline(&mut name).desired_width(200.0).char_limit(60);
        if ui.add(field).accessible_name("Session of the take").changed() {
            state.name = Some(name.clone());
        }
    });
    let name = name.trim();
    let problem = name_problem(name);
    if let Some(problem) = problem {
        ui.colored_label(cx.palette.warning, problem);
    }
    let live = cx.store.control.is_open() && cx.store.frozen_since(cx.now_s).is_none();
    let ready = problem.is_none() && live && !cx.store.free_take_busy;
    let start = egui::Button::new(RichText::new("Start recording").strong()).min_size(egui::vec2(0.0, 40.0));
    if ui.add_enabled(ready, start).clicked() {
        // The next take goes into the same session.
        state.name = Some(name.to_owned());
        let (sin, cos) = (0.5 * state.yaw_deg.to_radians()).sin_cos();
        let [x, y, z] = state.at_mm.map(|mm| mm / 1000.0);
        cx.store.start_take(StartTake {
            session: name.to_owned(),
            object,
            object_pose: vec![x, y, z, cos, 0.0, 0.0, sin],
            primitive: "free".to_owned(),
            fixture_trusted: state.is_fixed,
            operator: cx.store.control.operator.trim().to_owned(),
            surroundings: Vec::new(),
            marks_baseline: false,
        });
    }
}
