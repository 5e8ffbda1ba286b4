//! The takes of the session, in order, and where each stands.

use egui::{Color32, RichText, Sense, accesskit::Role};
use palpate_wire::api::{RecordingAction, RecordingPhase, RecordingStep, StepState};

use super::{Scene, plan_label};
use crate::{
    route::Screen,
    screens::{ScreenContext, duration_text, progress_bar, topic_ui},
    theme::Palette,
};

/// The object stands below the primitive, not below its sign, points.
const OBJECT_INDENT: f32 = 22.0;
/// Height of the list where it stands below the step, points.
const NARROW_HEIGHT: f32 = 260.0;

pub(super) fn checklist_ui(
    ui: &mut egui::Ui,
    cx: &mut ScreenContext<'_>,
    scene: &Scene<'_>,
    actions: &mut Vec<RecordingAction>,
) {
    let session = scene.session;
    let document = cx.store.recording();
    ui.add_space(4.0);
    ui.horizontal_wrapped(|ui| {
        ui.label(RichText::new(&session.session).strong().size(16.0));
        topic_ui(ui, Screen::Record);
    });
    let plan = document.ready().map_or(session.plan.as_str(), |document| plan_label(document, &session.plan));
    let by = if session.operator.is_empty() { String::new() } else { format!(", by {}", session.operator) };
    ui.label(RichText::new(format!("{plan}{by}")).color(cx.palette.text_weak));
    let accepted = session.steps.iter().filter(|step| step.state == StepState::Accepted).count();
    let share = accepted as f64 / session.steps.len().max(1) as f64;
    ui.add(progress_bar(share, &format!("{accepted} of {} accepted", session.steps.len())));
    let left = session.steps.iter().filter(|step| step.state != StepState::Accepted);
    let left_s: f64 = left.map(|step| step.duration_s).sum();
    if left_s > 0.0 {
        let text = format!("about {} of motion left", duration_text(left_s));
        let hint = "As planned within this robot's limits. Placing objects and deciding come on top.";
        ui.label(RichText::new(text).color(cx.palette.text_weak)).on_hover_text(hint);
    }
    ui.add_space(6.0);
    let bottom = 44.0;
    // In a column that scrolls as a whole there is no end of room.
    let height = Some(ui.available_height() - bottom).filter(|height| height.is_finite());
    let height = height.map_or(NARROW_HEIGHT, |height| height.max(80.0));
    egui::ScrollArea::vertical().id_salt("takes").max_height(height).auto_shrink(false).show(ui, |ui| {
        for (idx, step) in session.steps.iter().enumerate() {
            let current = session.current == Some(idx);
            let standing = standing(step, current.then_some(scene.phase), &cx.palette);
            if step_row_ui(ui, idx, step, current, scene.may_act(), standing) && !current {
                actions.push(RecordingAction::Select { step: idx });
            }
        }
    });
    let leave = ui.add_enabled(scene.may_act(), egui::Button::new("Leave session"));
    if leave
        .on_hover_text("What was accepted stays; the session can be taken up again under its name")
        .clicked()
    {
        actions.push(RecordingAction::Leave);
    }
}

/// Where a step stands: a sign, a word, a colour. `phase` is that of the step under way.
fn standing(
    step: &RecordingStep,
    phase: Option<RecordingPhase>,
    palette: &Palette,
) -> (&'static str, &'static str, Color32) {
    use RecordingPhase::{Baseline, Checking, Countdown, Running};
    match (step.state, phase) {
        // A take that is recorded again has one already, which says nothing about this one.
        (_, Some(Baseline | Countdown | Running)) => ("\u{23fa}", "recording", palette.real),
        (_, Some(Checking)) => ("\u{25b6}", "being checked", palette.real),
        (StepState::Accepted, _) => ("\u{2714}", "accepted", palette.diagnosed),
        (StepState::Review, _) if step.verdict.is_none() => ("?", "being checked", palette.text_weak),
        (StepState::Review, _) => ("?", "to review", palette.warning),
        (StepState::Open, Some(_)) => ("\u{25b6}", "now", palette.real),
        (StepState::Open, None) => ("\u{25cb}", "open", palette.text_weak),
    }
}

/// True when it was clicked. Who only watches reads the list in its colours, and cannot press it.
fn step_row_ui(
    ui: &mut egui::Ui,
    idx: usize,
    step: &RecordingStep,
    current: bool,
    may_act: bool,
    (sign, word, color): (&str, &str, Color32),
) -> bool {
    let title = format!("{sign} {}  {}", idx + 1, step.primitive_label);
    let added = if step.added_because.is_some() { ", added" } else { "" };
    let mut job = egui::text::LayoutJob::default();
    let font = egui::TextStyle::Body.resolve(ui.style());
    let color = if current { ui.visuals().strong_text_color() } else { color };
    let format = egui::TextFormat::simple(font, color);
    job.append(&format!("{title}\n"), 0.0, format.clone());
    // Spaces at the start of a line are lost where it is wrapped.
    job.append(&format!("{}{added}", step.object_label), OBJECT_INDENT, format);
    let button = egui::Button::selectable(current, job)
        .min_size(egui::vec2(ui.available_width(), 46.0))
        .sense(if may_act { Sense::click() } else { Sense::hover() })
        .right_text(RichText::new(word).color(color).small());
    let name = format!("Take {}: {}, {}, {word}", idx + 1, step.primitive_label, step.object_label);
    let why = step.added_because.as_deref().map_or_else(String::new, |why| format!("\nAdded: {why}"));
    let hint = format!("{name}; {}{why}", duration_text(step.duration_s));
    let response = ui.add(button).on_hover_text(hint);
    response.widget_info(|| egui::WidgetInfo::selected(Role::Button, may_act, current, name.clone()));
    response.clicked() && may_act
}
