//! The side panel "Control": presets, a slider for every joint of the hand, jogging and lead-through for what carries it.

use egui::{Color32, RichText, accesskit::Role};
use palpate_robot_model::JointKind;
use palpate_wire::proto::{ControlState, control_state::Phase};

use super::joints::{Controls, JointControl, JointGroup};
use crate::{
    screens::{ScreenContext, controls::name_button},
    store::{Store, control::Holder},
    theme::Palette,
};

/// A button that is held longer than this moves on and on, s; shorter is one step.
const HOLD_AFTER_S: f64 = 0.3;
/// A held button takes a step this often, s.
const STEP_EVERY_S: f64 = 0.1;
/// A held button never asks for more than so many steps ahead of where the joint is commanded.
const MOST_STEPS_AHEAD: f64 = 3.0;
const LABEL_WIDTH: f32 = 96.0;
const VALUE_WIDTH: f32 = 116.0;

/// Steps on offer for jogging, rad (turning) and m (sliding), and the one that is chosen at first.
const TURNS: [(&str, f64); 4] = [("0.2\u{b0}", 0.2), ("1\u{b0}", 1.0), ("5\u{b0}", 5.0), ("10\u{b0}", 10.0)];
const SLIDES: [(&str, f64); 4] = [("0.1 mm", 0.1), ("1 mm", 1.0), ("5 mm", 5.0), ("10 mm", 10.0)];

/// What the panel remembers between frames.
#[derive(Debug)]
pub struct PanelState {
    part: Part,
    /// Index into the steps on offer.
    step_idx: usize,
    held: Option<Held>,
}

/// Which joints the panel shows: all of them would not fit on a laptop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Part {
    Hand,
    Carrier,
}

impl Default for PanelState {
    fn default() -> Self {
        Self { part: Part::Hand, step_idx: 1, held: None }
    }
}

/// A jog button that is pressed.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Held {
    dof: usize,
    sign: f64,
    since_s: f64,
    /// When the next step is due, once it moves on and on.
    next_s: f64,
}

/// What may be done now, and why not.
struct Allowed {
    moves: bool,
    why_not: &'static str,
}

impl Allowed {
    fn now(store: &Store, now_s: f64) -> Self {
        let (moves, why_not) = match store.control.holder(store.control_state()) {
            _ if store.frozen_since(now_s).is_some() || !store.control.is_open() => {
                (false, "There is no connection to the station.")
            }
            Holder::Nobody => (false, "Take control in the top bar to move joints."),
            Holder::Other(_) => (false, "Somebody else has control: you can watch, and press STOP."),
            Holder::Me => match store.phase() {
                Phase::Armed => (true, ""),
                Phase::Stopped => (false, "The station is stopped. Reset the stop in the top bar, then arm."),
                Phase::Holding => (false, "The station holds; the line below the top bar says why."),
                Phase::Arming | Phase::Disarming => (false, "Wait a moment."),
                Phase::Disarmed | Phase::Unspecified => (false, "Arm in the top bar to move joints."),
            },
        };
        Self { moves, why_not }
    }
}

/// The panel. `measured` has one position for each degree of freedom.
pub fn control_panel_ui(
    ui: &mut egui::Ui,
    cx: &mut ScreenContext<'_>,
    state: &mut PanelState,
    controls: &Controls,
    measured: &[f64],
) {
    let Some(station_state) = cx.store.control_state().cloned() else {
        ui.label("This station takes no commands.");
        return;
    };
    let allowed = Allowed::now(cx.store, cx.now_s);
    if !allowed.moves {
        state.held = None;
        ui.label(RichText::new(allowed.why_not).color(cx.palette.warning));
    }
    legend_ui(ui, &cx.palette);
    let positions = Positions { measured, state: &station_state };
    match part_ui(ui, state, controls) {
        Part::Hand => {
            presets_ui(ui, cx, controls, allowed.moves);
            for group in &controls.hand {
                group_ui(ui, cx, group, &positions, allowed.moves);
            }
        }
        Part::Carrier => carrier_ui(ui, cx, state, &controls.carrier, &positions, allowed.moves),
    }
    ui.add_space(6.0);
    let mine = cx.store.control.holder(Some(&station_state)) == Holder::Me;
    let tare = ui.add_enabled(mine, egui::Button::new("Set zero of touch"));
    if tare.on_hover_text("The mean of the next half second becomes the zero of every taxel").clicked() {
        cx.store.control.tare();
    }
}

/// Which part is shown; there is only a choice where a station has both.
fn part_ui(ui: &mut egui::Ui, state: &mut PanelState, controls: &Controls) -> Part {
    if controls.carrier.is_empty() {
        return Part::Hand;
    }
    if controls.hand.is_empty() {
        return Part::Carrier;
    }
    ui.horizontal(|ui| {
        for (part, name) in [(Part::Hand, "Hand joints"), (Part::Carrier, "Arm joints")] {
            let chosen = state.part == part;
            let response = ui.selectable_label(chosen, name);
            response.widget_info(|| egui::WidgetInfo::selected(Role::Tab, true, chosen, name));
            if response.clicked() {
                state.part = part;
            }
        }
    });
    state.part
}

/// Where joints are and are told to be.
struct Positions<'a> {
    measured: &'a [f64],
    state: &'a ControlState,
}

impl Positions<'_> {
    fn measured(&self, dof: usize) -> Option<f64> {
        self.measured.get(dof).copied()
    }

    fn commanded(&self, dof: usize) -> Option<f64> {
        self.state.commanded.get(dof).copied().map(f64::from)
    }

    /// Where the next motion of `dof` starts from.
    fn base(&self, store: &Store, dof: usize) -> Option<f64> {
        store.control.wanted(dof).or(self.commanded(dof)).or(self.measured(dof))
    }
}

fn legend_ui(ui: &mut egui::Ui, palette: &Palette) {
    ui.horizontal(|ui| {
        let (rect, _) = ui.allocate_exact_size(egui::vec2(12.0, 14.0), egui::Sense::hover());
        measured_mark(ui.painter(), rect.center_bottom() - egui::vec2(0.0, 2.0), palette.real);
        ui.label(RichText::new("measured; the knob is commanded").color(palette.text_weak));
    });
}

/// A small triangle that points up.
fn measured_mark(painter: &egui::Painter, tip_below: egui::Pos2, color: Color32) {
    let points = vec![
        tip_below + egui::vec2(-4.5, 0.0),
        tip_below + egui::vec2(4.5, 0.0),
        tip_below + egui::vec2(0.0, -8.0),
    ];
    painter.add(egui::Shape::convex_polygon(points, color, egui::Stroke::NONE));
}

fn presets_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, controls: &Controls, may: bool) {
    ui.horizontal_wrapped(|ui| {
        ui.label("Hand");
        for preset in &controls.presets {
            let response = ui.add_enabled(may, egui::Button::new(preset.label)).on_hover_text(preset.hint);
            response.widget_info(|| {
                egui::WidgetInfo::labeled(Role::Button, may, format!("{} hand", preset.label))
            });
            if response.clicked() {
                for &(dof, position) in &preset.positions {
                    cx.store.control.want(dof, position, cx.now_s);
                }
            }
        }
    });
}

fn group_ui(
    ui: &mut egui::Ui,
    cx: &mut ScreenContext<'_>,
    group: &JointGroup,
    positions: &Positions<'_>,
    may: bool,
) {
    egui::CollapsingHeader::new(RichText::new(&group.label).strong()).default_open(true).show(ui, |ui| {
        for joint in &group.joints {
            slider_row_ui(ui, cx, joint, positions, may);
        }
    });
}

/// A joint's name, its slider over the whole range, and where it is and shall be.
fn slider_row_ui(
    ui: &mut egui::Ui,
    cx: &mut ScreenContext<'_>,
    joint: &JointControl,
    positions: &Positions<'_>,
    may: bool,
) {
    ui.horizontal(|ui| {
        name_ui(ui, joint);
        let measured = positions.measured(joint.dof);
        let commanded = positions.commanded(joint.dof);
        let mut position = joint.clamp(positions.base(cx.store, joint.dof).unwrap_or(0.0));
        ui.spacing_mut().slider_width = (ui.available_width() - VALUE_WIDTH - 12.0).max(60.0);
        let slider = egui::Slider::new(&mut position, joint.lower..=joint.upper).show_value(false);
        let response = ui.add_enabled(may, slider);
        if let Some(measured) = measured {
            let rail = response.rect.x_range().shrink(response.rect.height() / 2.5);
            let span = (joint.upper - joint.lower).max(1e-9);
            let share = ((measured - joint.lower) / span).clamp(0.0, 1.0) as f32;
            let at = egui::pos2(egui::lerp(rail, share), response.rect.bottom() + 1.0);
            measured_mark(ui.painter(), at, cx.palette.real);
        }
        let text = value_text(joint, measured, commanded);
        let value = text.clone();
        ui.ctx().accesskit_node_builder(response.id, |node| {
            node.set_label(joint.name.clone());
            node.set_value(value);
        });
        if response.changed() && may {
            cx.store.control.want(joint.dof, joint.clamp(position), cx.now_s);
        }
        response.on_hover_text(format!(
            "{}: {} to {}. Arrow keys move it too.",
            joint.name,
            joint.text(joint.lower),
            joint.text(joint.upper)
        ));
        ui.label(RichText::new(text).monospace().size(13.0));
    });
}

fn name_ui(ui: &mut egui::Ui, joint: &JointControl) {
    let label = egui::Label::new(&joint.label).truncate();
    let size = egui::vec2(LABEL_WIDTH, ui.spacing().interact_size.y);
    ui.allocate_ui_with_layout(size, egui::Layout::left_to_right(egui::Align::Center), |ui| {
        ui.set_min_width(LABEL_WIDTH);
        ui.add(label).on_hover_text(&joint.name);
    });
}

/// `12.3°`, and where it is told to be if that is elsewhere: `12.3° → 20.0°`.
fn value_text(joint: &JointControl, measured: Option<f64>, commanded: Option<f64>) -> String {
    let measured = measured.map_or_else(|| "?".to_owned(), |at| joint.text(at));
    match commanded.map(|at| joint.text(at)) {
        Some(commanded) if commanded != measured => format!("{measured} \u{2192} {commanded}"),
        _ => measured,
    }
}

fn carrier_ui(
    ui: &mut egui::Ui,
    cx: &mut ScreenContext<'_>,
    state: &mut PanelState,
    joints: &[JointControl],
    positions: &Positions<'_>,
    may: bool,
) {
    let slides = joints.iter().any(|joint| joint.kind == JointKind::Prismatic);
    ui.horizontal(|ui| {
        ui.label("Step");
        for (idx, ((turn, _), (slide, _))) in TURNS.iter().zip(&SLIDES).enumerate() {
            let text = if slides { format!("{turn}, {slide}") } else { (*turn).to_owned() };
            let chosen = state.step_idx == idx;
            let response = ui.selectable_label(chosen, &text);
            response.widget_info(|| {
                egui::WidgetInfo::selected(Role::RadioButton, true, chosen, format!("Step {text}"))
            });
            if response.clicked() {
                state.step_idx = idx;
            }
        }
    });
    for joint in joints {
        jog_row_ui(ui, cx, state, joint, positions, may);
    }
    let mut on = positions.state.lead_through;
    let checkbox = ui.add_enabled(may || on, egui::Checkbox::new(&mut on, "Lead-through"));
    let hint = "The arm yields to your hands: hold it before you switch this on. Off makes it hold again.";
    if checkbox.on_hover_text(hint).changed() && (may || !on) {
        cx.store.control.lead_through(on);
    }
}

fn jog_row_ui(
    ui: &mut egui::Ui,
    cx: &mut ScreenContext<'_>,
    state: &mut PanelState,
    joint: &JointControl,
    positions: &Positions<'_>,
    may: bool,
) {
    let step = match joint.kind {
        JointKind::Prismatic => SLIDES[state.step_idx].1 * 1e-3,
        JointKind::Revolute | JointKind::Fixed => TURNS[state.step_idx].1.to_radians(),
    };
    ui.horizontal(|ui| {
        name_ui(ui, joint);
        for (sign, face, word) in [(-1.0, "\u{2212}", "less"), (1.0, "+", "more")] {
            let button = egui::Button::new(RichText::new(face).strong().size(17.0))
                .min_size(egui::vec2(44.0, 32.0))
                .sense(egui::Sense::click_and_drag());
            let response = ui.add_enabled(may, button);
            name_button(&response, &format!("{} {word}", joint.name));
            jog(ui, cx, state, joint, positions, (sign, step), &response);
            response.on_hover_text("One step; held, it keeps moving until you let go");
        }
        let (measured, commanded) = (positions.measured(joint.dof), positions.commanded(joint.dof));
        ui.label(RichText::new(value_text(joint, measured, commanded)).monospace().size(13.0));
    });
}

/// A click is one step; a button that is held moves on and on, and stops where the joint is when it is let go.
fn jog(
    ui: &egui::Ui,
    cx: &mut ScreenContext<'_>,
    state: &mut PanelState,
    joint: &JointControl,
    positions: &Positions<'_>,
    (sign, step): (f64, f64),
    response: &egui::Response,
) {
    let (dof, now_s) = (joint.dof, cx.now_s);
    let held = state.held.filter(|held| held.dof == dof && held.sign == sign);
    if response.is_pointer_button_down_on() && response.enabled() {
        ui.ctx().request_repaint();
        let Some(mut held) = held else {
            state.held = Some(Held { dof, sign, since_s: now_s, next_s: now_s + HOLD_AFTER_S });
            return;
        };
        if now_s >= held.next_s {
            held.next_s = now_s + STEP_EVERY_S;
            state.held = Some(held);
            if let (Some(base), Some(at)) = (positions.base(cx.store, dof), positions.commanded(dof)) {
                let reach = MOST_STEPS_AHEAD * step;
                let next = (base + sign * step).clamp(at - reach, at + reach);
                cx.store.control.want(dof, joint.clamp(next), now_s);
            }
        }
        return;
    }
    let long = held.is_some_and(|held| now_s - held.since_s >= HOLD_AFTER_S);
    if held.is_some() {
        state.held = None;
    }
    if long {
        if let Some(at) = positions.commanded(dof) {
            cx.store.control.want(dof, joint.clamp(at), now_s);
        }
    } else if response.clicked()
        && let Some(base) = positions.base(cx.store, dof)
    {
        cx.store.control.want(dof, joint.clamp(base + sign * step), now_s);
    }
}
