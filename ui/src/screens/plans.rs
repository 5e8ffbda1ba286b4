//! Plans: what a calibration session touches, before it is recorded.

use egui::{Rect, RichText, vec2};
use palpate_reports::wording;
use palpate_robot_model::Station;
use palpate_wire::api::{PlanDocument, PlanTake};

use super::{
    About, Part, ScreenContext, Subject, View, duration_text, empty_ui, hand::channel_map_ui, heading_ui,
    loaded_ui, topic_heading_ui, two_parts_ui,
};
use crate::{
    route::{Route, Screen},
    store::Loadable,
    theme::{Palette, taxel_scale, taxel_scale_ui},
};

/// Height of the map of the hand, points.
const MAP_HEIGHT: f32 = 340.0;

/// This screen.
pub const ABOUT: About = About {
    label: "Plans",
    slug: "plans",
    key: None,
    icon: "\u{1f4cb}",
    purpose: "What a calibration session touches, before it is recorded",
    group: Some("Data"),
    document: ("plans", None),
    subject: Subject::Other,
    needs_station: true,
    shows_stream: false,
    new: || Box::<PlansState>::default(),
};

/// Nothing is kept from frame to frame: the plan is in the address.
#[derive(Debug, Default)]
struct PlansState;

impl View for PlansState {
    fn ui(&mut self, ui: &mut egui::Ui, cx: &mut ScreenContext<'_>) {
        if !cx.store.is_commandable() {
            let text = "Plans belong to a live station: start `palpate serve --station FILE` on the machine that its \
                        devices are connected to, or `palpate serve --emulate` to try it without hardware.";
            if empty_ui(ui, "No live station", text, "Look at recordings") {
                cx.go_to_screen(Screen::Sessions);
            }
            return;
        }
        let plans = cx.store.plans();
        let Some(plans) = loaded_ui(ui, cx, plans, "Looking for plans", "The plans did not arrive") else {
            return;
        };
        let asked = cx.route.plan.clone();
        let shown = plans.iter().find(|plan| Some(&plan.id) == asked.as_ref());
        let Some(plan) = shown.or(plans.first()) else {
            let text = "Name one in the station's file, e.g. plans = [\"../plans/nine_takes.toml\"], and start the server \
                        again; docs/plans.md shows how it looks.";
            if empty_ui(ui, "This station has no plan", text, "Look at the station") {
                cx.go_to_screen(Screen::Hand);
            }
            return;
        };
        two_parts_ui(ui, "plans_list", ["All plans", "Plan"], asked.as_deref(), |ui, part| match part {
            Part::Choice => {
                ui.add_space(4.0);
                topic_heading_ui(ui, "Plans", Screen::Plans);
                for listed in plans.iter() {
                    entry_ui(ui, cx, listed, listed.id == plan.id);
                }
            }
            Part::Chosen => match (&asked, shown) {
                (Some(id), None) => {
                    ui.label(format!(
                        "The station has no plan {id}. It may have been taken out of its file."
                    ));
                }
                _ => plan_ui(ui, cx, plan),
            },
        });
    }
}

fn entry_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, plan: &PlanDocument, is_chosen: bool) {
    let facts = wording::counted(plan.takes.len() as u64, "take");
    let button = egui::Button::selectable(is_chosen, RichText::new(&plan.label).strong())
        .truncate()
        .right_text(RichText::new(facts).color(cx.palette.text_weak))
        .min_size(vec2(ui.available_width() - 8.0, 36.0));
    let response = ui.add(button).on_hover_text(&plan.label);
    response.widget_info(|| {
        let name = format!("Plan {}", plan.label);
        egui::WidgetInfo::selected(egui::accesskit::Role::Button, true, is_chosen, name)
    });
    if response.clicked() {
        *cx.go_to = Some(Route { plan: Some(plan.id.clone()), ..Route::to(Screen::Plans) });
    }
}

/// How long a plan is. Its motions are planned when a session is started; what it says of a take until then is the least.
pub(super) fn extent_text(takes: usize, duration_s: f64) -> String {
    let takes = wording::counted(takes as u64, "take");
    format!("{takes}, at least {} of motion", duration_text(duration_s))
}

/// Why [`extent_text`] says the least.
pub(super) const EXTENT_HINT: &str = "Motions are planned when a session is started, and last longer where the robot's \
                                      limits make it slower";

fn plan_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, plan: &PlanDocument) {
    let station = cx.store.live_station();
    egui::ScrollArea::vertical().id_salt(&plan.id).auto_shrink(false).show(ui, |ui| {
        ui.add_space(4.0);
        heading_ui(ui, &plan.label);
        let duration_s: f64 = plan.takes.iter().map(|take| take.duration_s).sum();
        let extent = extent_text(plan.takes.len(), duration_s);
        ui.label(format!("{extent}. File {}.toml", plan.id)).on_hover_text(EXTENT_HINT);
        if ui.button("Record it").on_hover_text("To the screen that leads through its takes").clicked() {
            *cx.go_to = Some(Route { plan: Some(plan.id.clone()), ..Route::to(Screen::Record) });
        }
        ui.add_space(10.0);
        heading_ui(ui, "What it means to touch");
        match &station {
            Loadable::Ready(station) => coverage_ui(ui, cx, station, plan),
            Loadable::Failed(error) => {
                ui.colored_label(
                    cx.palette.mismatch,
                    format!("\u{26a0} The station could not be read: {error}"),
                );
            }
            Loadable::Idle | Loadable::Loading => {
                ui.spinner();
            }
        }
        ui.add_space(10.0);
        heading_ui(ui, "Takes");
        egui::ScrollArea::horizontal().id_salt("plan_takes").show(ui, |ui| takes_ui(ui, &cx.palette, plan));
        ui.add_space(12.0);
    });
}

/// How often each channel is named, on the map of the hand.
fn coverage_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, station: &Station, plan: &PlanDocument) {
    let counts = touch_counts(station, plan);
    let most = counts.iter().copied().max().unwrap_or(0).max(1);
    let touched = counts.iter().filter(|&&count| count > 0).count();
    ui.label(format!(
        "{touched} of {} channels, the most often touched {}. A touch usually reaches the taxels beside it too.",
        counts.len(),
        times(most),
    ));
    let palette = cx.palette;
    let colors: Vec<egui::Color32> = counts
        .iter()
        .map(|&count| match count {
            0 => palette.dead,
            _ if most == 1 => taxel_scale(1.0),
            _ => taxel_scale((count - 1) as f32 / (most - 1) as f32),
        })
        .collect();
    let name = |channel: usize| {
        let count = counts.get(channel).copied().unwrap_or(0);
        let label = station.layout.channel_label(channel);
        if count == 0 {
            format!("{label}: not touched")
        } else {
            format!("{label}: touched {}", times(count))
        }
    };
    let rect = Rect::from_min_size(ui.cursor().min, vec2(ui.available_width().min(560.0), MAP_HEIGHT));
    channel_map_ui(ui, rect, station, &colors, &name, cx.playback, &palette);
    ui.advance_cursor_after_rect(rect);
    ui.horizontal(|ui| {
        ui.label(RichText::new("once").color(palette.text_weak));
        taxel_scale_ui(ui, 120.0);
        ui.label(RichText::new(times(most)).color(palette.text_weak));
    });
}

/// How often the plan means to touch each channel of the layout.
fn touch_counts(station: &Station, plan: &PlanDocument) -> Vec<usize> {
    let touches = || plan.takes.iter().flat_map(|take| &take.touches);
    let channels = station.layout.channels.iter();
    channels.map(|channel| touches().filter(|id| **id == channel.id).count()).collect()
}

fn times(count: usize) -> String {
    if count == 1 { "once".to_owned() } else { format!("{count} times") }
}

fn takes_ui(ui: &mut egui::Ui, palette: &Palette, plan: &PlanDocument) {
    egui::Grid::new("plan_takes").striped(true).min_row_height(22.0).spacing([22.0, 4.0]).show(ui, |ui| {
        for name in ["Take", "Motion", "Object", "At x, y, z, mm", "Duration", "Touches", "What to do first"]
        {
            ui.label(RichText::new(name).strong());
        }
        ui.end_row();
        for (idx, take) in plan.takes.iter().enumerate() {
            take_ui(ui, palette, idx, take);
            ui.end_row();
        }
    });
}

fn take_ui(ui: &mut egui::Ui, palette: &Palette, idx: usize, take: &PlanTake) {
    ui.label((idx + 1).to_string());
    ui.label(&take.primitive_label);
    ui.label(&take.object_label);
    let [x, y, z] =
        take.object_position_m.map(|position_m| format!("{:.0}", 1e3 * position_m).replace('-', "\u{2212}"));
    ui.label(format!("{x}, {y}, {z}"));
    ui.label(duration_text(take.duration_s));
    ui.label(take.touches.len().to_string());
    let instruction =
        if take.instruction.is_empty() { "Put the object in its place." } else { &take.instruction };
    ui.label(RichText::new(instruction).color(palette.text_weak));
}
