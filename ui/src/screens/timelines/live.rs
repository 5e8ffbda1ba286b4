//! The live twin: what the hardware feels now and what the simulator beside it feels, the last seconds of both, and
//! which taxels cannot be believed.

mod rows;

use std::sync::Arc;

use egui::RichText;
use palpate_robot_model::Station;
use palpate_wire::{
    api::{ModelSummary, Source},
    proto::{TaxelWarning, TwinStatus},
};

use super::super::{
    ScreenContext,
    controls::{combo_ui, option_ui},
    empty_ui, loaded_ui, loading_ui, topic_ui,
};
use crate::{
    playback::HandSource,
    route::Screen,
    store::{
        Loadable,
        touch_history::{HISTORY_S, LiveLanes},
    },
};

/// Id of the station's own model in `PUT /api/v1/live/model`.
const NOMINAL: &str = "nominal";
/// Rows change places at most this often, s: a list that jumps cannot be read.
const SORT_EVERY_S: f64 = 2.0;
/// Warnings are given this much room before they scroll, points.
const WARNINGS_HEIGHT: f32 = 110.0;

/// What the screen keeps from frame to frame.
#[derive(Debug, Default)]
pub(super) struct LiveState {
    lanes: Option<(u64, Arc<LiveLanes>)>,
    order: Order,
    worst_first: Vec<usize>,
    sorted_at_s: Option<f64>,
}

/// In which order the channels stand.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
enum Order {
    #[default]
    ByPatch,
    WorstFirst,
}

/// What there is to draw.
struct LivePicture<'a> {
    station: &'a Station,
    lanes: &'a LiveLanes,
    /// Share of the last seconds in which each channel was as simulated; empty where nothing is.
    agreement: &'a [f32],
    warnings: &'a [TaxelWarning],
    /// The right edge, s since the station started.
    now_s: f64,
    simulated_colour: egui::Color32,
    /// Channels in the order of the rows.
    order: &'a [usize],
    by_patch: bool,
}

/// The live station on one time axis that ends now.
pub(super) fn live_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, state: &mut LiveState) {
    if !cx.store.is_live() {
        return no_station_ui(ui, cx);
    }
    source_ui(ui, cx);
    let station = cx.store.live_station();
    let Some(station) =
        loaded_ui(ui, cx, station, "Reading the live station", "The live station could not be read")
    else {
        return;
    };
    let Some(now_s) = cx.store.touch_history.newest_s() else {
        return loading_ui(ui, "Waiting for the first live frame");
    };
    let control = cx.store.control_state();
    let twin = control.and_then(|control| control.twin.clone()).unwrap_or_default();
    let warnings = control.map_or_else(Vec::new, |control| control.taxels.clone());
    let num_channels = station.layout.num_channels();
    let agreement = if twin.agreement.len() == num_channels { twin.agreement.as_slice() } else { &[] };
    let lanes = lanes_of(cx, state, &station);
    let models = cx.store.models();
    let model = models.ready().and_then(|models| models.iter().find(|model| model.name == twin.model));
    let simulated_colour = match model {
        Some(model) if model.id != NOMINAL && !model.effects.is_empty() => cx.palette.diagnosed,
        Some(model) if model.id != NOMINAL => cx.palette.calibrated,
        _ => cx.palette.nominal,
    };

    ui.horizontal_wrapped(|ui| {
        model_ui(ui, cx, &twin, models.ready().map_or(&[][..], |models| models.as_slice()), model);
        ui.separator();
        ui.label("Order");
        ui.selectable_value(&mut state.order, Order::ByPatch, "By patch");
        ui.selectable_value(&mut state.order, Order::WorstFirst, "Worst first")
            .on_hover_text("Taxels that agree least with the simulator come first");
        topic_ui(ui, Screen::Timelines);
    });
    state_ui(ui, cx, &station, &twin, &lanes);
    warnings_ui(ui, cx, &station, &warnings);
    ui.separator();

    let order = order_of(state, agreement, num_channels, cx.now_s);
    let picture = LivePicture {
        station: &station,
        lanes: &lanes,
        agreement,
        warnings: &warnings,
        now_s,
        simulated_colour,
        order: &order,
        by_patch: state.order == Order::ByPatch,
    };
    rows::picture_ui(ui, cx, &picture);
}

/// Recorded or live; and how live it is.
pub(super) fn source_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>) {
    ui.horizontal_wrapped(|ui| {
        ui.selectable_value(&mut cx.playback.hand_source, HandSource::Recorded, "Recorded");
        ui.selectable_value(&mut cx.playback.hand_source, HandSource::Live, "Live");
        if cx.playback.hand_source != HandSource::Live {
            return;
        }
        ui.separator();
        let emulated = cx.store.info.ready().is_some_and(|info| info.source == Source::Emulated);
        let (word, colour) = match cx.store.frozen_since(cx.now_s) {
            Some((since, _)) => (format!("FROZEN SINCE {since}"), cx.palette.mismatch),
            None if emulated => ("LIVE (EMULATED)".to_owned(), cx.palette.warning),
            None => ("LIVE".to_owned(), cx.palette.mismatch),
        };
        ui.label(RichText::new(word).strong().color(colour));
        let activity = cx.store.live_frame().map_or("", |frame| frame.activity.as_str());
        if !activity.is_empty() {
            ui.label(activity);
        }
    });
}

fn no_station_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>) {
    match &cx.store.info {
        Loadable::Idle | Loadable::Loading => return loading_ui(ui, "Looking for a station"),
        Loadable::Ready(_) | Loadable::Failed(_) => {}
    }
    let text = "The simulator runs beside a live station and shows at once where the two disagree. Start `palpate serve \
                --station FILE` on the machine that the devices are connected to, or `palpate serve --emulate` to try it \
                without hardware.";
    if empty_ui(ui, "No live station", text, "Look at recordings") {
        cx.playback.hand_source = HandSource::Recorded;
    }
}

fn lanes_of(cx: &ScreenContext<'_>, state: &mut LiveState, station: &Station) -> Arc<LiveLanes> {
    let history = &cx.store.touch_history;
    if let Some((revision, lanes)) = &state.lanes
        && *revision == history.revision()
        && lanes.channels.len() == station.layout.num_channels()
    {
        return Arc::clone(lanes);
    }
    let streams: Vec<_> = station.layout.streams.iter().map(|stream| stream.channels.clone()).collect();
    let lanes = Arc::new(history.lanes(station.layout.num_channels(), &streams));
    state.lanes = Some((history.revision(), Arc::clone(&lanes)));
    lanes
}

/// The model that the twin simulates with, to see and to choose.
fn model_ui(
    ui: &mut egui::Ui,
    cx: &mut ScreenContext<'_>,
    twin: &TwinStatus,
    models: &[ModelSummary],
    model: Option<&ModelSummary>,
) {
    let own = "the station's own (nominal)";
    let in_use = match model {
        Some(model) => model.id.clone(),
        None => NOMINAL.to_owned(),
    };
    let mut chosen = in_use.clone();
    let text = match model {
        Some(model) if model.id != NOMINAL => model.name.as_str(),
        _ if twin.model.is_empty() => "none yet",
        _ => own,
    };
    ui.label("Simulated with");
    combo_ui(ui, "Model of the live twin", text, 220.0, |ui| {
        option_ui(ui, &mut chosen, NOMINAL.to_owned(), own);
        for model in models.iter().filter(|model| model.id != NOMINAL) {
            option_ui(ui, &mut chosen, model.id.clone(), &model.name);
        }
        if models.iter().all(|model| model.id == NOMINAL) {
            ui.label("Calibrate a session and save its model to have more to choose from.");
        }
    });
    if chosen != in_use {
        cx.store.set_live_model(&chosen);
    }
    match &cx.store.live_model {
        Loadable::Loading => {
            ui.spinner();
        }
        Loadable::Failed(why) => {
            let text = format!("\u{26a0} The twin keeps its model: {why}");
            ui.colored_label(cx.palette.mismatch, text);
        }
        Loadable::Idle | Loadable::Ready(_) => {}
    }
}

/// What the simulator is up to: why it simulates nothing, that nothing touches, or how well the two agree.
fn state_ui(
    ui: &mut egui::Ui,
    cx: &mut ScreenContext<'_>,
    station: &Station,
    twin: &TwinStatus,
    lanes: &LiveLanes,
) {
    let frozen = cx.store.frozen_since(cx.now_s).is_some();
    if !twin.problem.is_empty() {
        let text = format!("\u{26a0} The simulator cannot follow: {}", twin.problem);
        ui.colored_label(cx.palette.mismatch, text);
        return;
    }
    if twin.active.is_empty() {
        ui.horizontal_wrapped(|ui| {
            ui.label(RichText::new("Only the real touch is shown.").strong());
            ui.label(
                "The simulator does not know yet what the hand touches: it begins once the object of a take is \
                 confirmed on Record.",
            );
            if !frozen && ui.button("Go to Record").clicked() {
                cx.go_to_screen(Screen::Record);
            }
        });
        return;
    }
    let object = cx.store.live_frame().map_or("", |frame| frame.object.as_str());
    let object = station.objects.get(object).map_or(object, |object| &object.label);
    let still =
        |lane: &crate::store::touch_history::LiveLane| lane.real.is_empty() && lane.simulated_only.is_empty();
    let mut text = format!("Simulated before: {object}.");
    if twin.agreement.is_empty() {
        text.push_str(" Agreement counts from the next moment on.");
    } else {
        let count = twin.agreement.len() as f32;
        let mean = twin.agreement.iter().sum::<f32>() / count;
        text.push_str(&format!(
            " Real and simulated touch agree for {:.1} % of the last ten seconds, all channels together.",
            100.0 * mean
        ));
    }
    if lanes.streams.iter().all(still) {
        text.push_str(&format!(
            " Nothing touched in the last {HISTORY_S:.0} s, real or simulated: move the hand to compare the two."
        ));
    }
    ui.label(text);
}

/// Taxels that cannot be believed, by name, with what to do.
fn warnings_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, station: &Station, warnings: &[TaxelWarning]) {
    if warnings.is_empty() {
        return;
    }
    egui::ScrollArea::vertical().id_salt("live warnings").max_height(WARNINGS_HEIGHT).show(ui, |ui| {
        for warning in warnings {
            let channel = warning.channel as usize;
            if channel >= station.layout.num_channels() {
                continue;
            }
            let colour = match warning.kind.as_str() {
                "dead" => cx.palette.text_weak,
                "stuck" => cx.palette.stuck,
                _ => cx.palette.warning,
            };
            let name = station.layout.channel_label(channel);
            let id = &station.layout.channels[channel].id;
            let text = warning.text.strip_prefix(id.as_str()).unwrap_or(&warning.text).trim_start();
            let text = format!("\u{26a0} {name}, {}: {text}", warning.kind);
            let button = egui::Button::new(RichText::new(text).color(colour)).wrap().frame(false);
            if ui.add(button).on_hover_text("Marks the taxel here and on Hand").clicked() {
                cx.playback.pinned = Some(channel);
            }
        }
    });
}

/// Channels in the order of the rows.
fn order_of(state: &mut LiveState, agreement: &[f32], num_channels: usize, now_s: f64) -> Vec<usize> {
    if state.order == Order::ByPatch {
        return (0..num_channels).collect();
    }
    let due = state.sorted_at_s.is_none_or(|sorted_at_s| now_s - sorted_at_s >= SORT_EVERY_S);
    if due || state.worst_first.len() != num_channels {
        state.sorted_at_s = Some(now_s);
        state.worst_first = (0..num_channels).collect();
        let of = |channel: usize| agreement.get(channel).copied().unwrap_or(1.0);
        state.worst_first.sort_by(|&a, &b| of(a).total_cmp(&of(b)));
    }
    state.worst_first.clone()
}
