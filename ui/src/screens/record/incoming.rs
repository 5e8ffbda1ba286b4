//! What comes in: rates, losses, room on the disk, and which channels the take and the session have touched.

use std::collections::BTreeSet;

use egui::{Color32, Rect, RichText};
use palpate_messages::bits;
use palpate_robot_model::Station;
use palpate_wire::{
    api::{RecordingSession, StepState},
    proto::device_status::Link,
};

use super::Names;
use crate::screens::{ScreenContext, control::wording::link_word, hand::channel_map_ui};

/// Below this much free space the operator should make room, bytes.
const LOW_SPACE: u64 = 2_000_000_000;

pub(super) fn incoming_ui(
    ui: &mut egui::Ui,
    cx: &mut ScreenContext<'_>,
    station: &Station,
    session: Option<&RecordingSession>,
    names: &Names,
) {
    ui.add_space(4.0);
    match cx.store.frozen_since(cx.now_s) {
        Some((since, _)) => {
            let text = format!("FROZEN SINCE {since}");
            ui.label(RichText::new(text).strong().color(cx.palette.mismatch));
        }
        None => {
            ui.label(RichText::new("Coming in now").strong());
        }
    }
    rates_ui(ui, cx, station);
    ui.separator();
    if let Some(session) = session {
        coverage_ui(ui, cx, station, session, names);
    }
}

fn rates_ui(ui: &mut egui::Ui, cx: &ScreenContext<'_>, station: &Station) {
    let Some(frame) = cx.store.live_frame() else {
        ui.label("Waiting for the first live frame\u{2026}");
        return;
    };
    let streams = station.layout.streams.iter().map(|stream| (stream.label.as_str(), Some(stream.rate_hz)));
    let rates = std::iter::once(("Joints", None)).chain(streams).zip(&frame.rates_hz);
    egui::Grid::new("record rates").num_columns(2).spacing([16.0, 2.0]).show(ui, |ui| {
        for ((name, nominal_hz), &rate_hz) in rates {
            let slow = nominal_hz.is_some_and(|nominal_hz| f64::from(rate_hz) < 0.8 * nominal_hz);
            let color = if slow { cx.palette.warning } else { cx.palette.real };
            ui.label(name);
            let of = nominal_hz.map_or_else(String::new, |nominal_hz| format!(" of {nominal_hz:.0}"));
            ui.label(RichText::new(format!("{rate_hz:.1}{of} Hz")).color(color));
            ui.end_row();
        }
    });
    let Some(state) = &frame.control else { return };
    for device in state.devices.iter().filter(|device| device.link() != Link::Ready) {
        let (word, color) = link_word(device.link(), &cx.palette);
        let text = format!("\u{26a0} {} {word}: {}", device.id, device.problem);
        ui.label(RichText::new(text).color(color));
    }
    let Some(status) = &state.recording else { return };
    let lost = match status.lost_samples {
        0 => RichText::new("No sample lost"),
        lost => RichText::new(format!("\u{26a0} {lost} samples lost: the disk is too slow"))
            .color(cx.palette.mismatch),
    };
    ui.label(lost);
    if status.free_bytes > 0 {
        let free = format!("{:.1} GB free", status.free_bytes as f64 / 1e9);
        let low = status.free_bytes < LOW_SPACE;
        let color = if low { cx.palette.mismatch } else { cx.palette.text_weak };
        let advice = if low { ": make room before the next take" } else { "" };
        ui.label(RichText::new(format!("{free}{advice}")).color(color));
    }
}

/// Which channels were touched: in this take, in an accepted one, or not yet.
fn coverage_ui(
    ui: &mut egui::Ui,
    cx: &mut ScreenContext<'_>,
    station: &Station,
    session: &RecordingSession,
    names: &Names,
) {
    let status = cx.store.control_state().and_then(|state| state.recording.clone()).unwrap_or_default();
    let untouched: BTreeSet<&str> = session.untouched.iter().map(String::as_str).collect();
    let step = session.current.and_then(|idx| session.steps.get(idx));
    let meant: BTreeSet<&str> =
        step.map_or_else(BTreeSet::new, |step| step.touches.iter().map(String::as_str).collect());
    let any_accepted = session.steps.iter().any(|step| step.state == StepState::Accepted);
    let channels = &station.layout.channels;
    let in_take = |channel: usize| bits::get(&status.covered, channel);
    let before = |channel: usize| any_accepted && !untouched.contains(channels[channel].id.as_str());
    let palette = cx.palette;
    let colors: Vec<Color32> = (0..channels.len())
        .map(|channel| match (in_take(channel), before(channel)) {
            (true, _) => palette.real,
            (false, true) => palette.text_weak.gamma_multiply(0.5),
            (false, false) if meant.contains(channels[channel].id.as_str()) => palette.warning,
            (false, false) => palette.surface,
        })
        .collect();
    let name = |channel: usize| {
        let id = &channels[channel].id;
        let what = match (in_take(channel), before(channel)) {
            (true, _) => "touched in this take",
            (false, true) => "touched in an accepted take",
            (false, false) if meant.contains(id.as_str()) => "to be touched in this take",
            (false, false) => "not touched yet",
        };
        format!("{}: {what}", names.get(id).unwrap_or(id))
    };
    let touched = (0..channels.len()).filter(|&channel| in_take(channel)).count();
    let covered = (0..channels.len()).filter(|&channel| in_take(channel) || before(channel)).count();
    ui.label(RichText::new("Coverage").strong());
    ui.label(format!("{touched} channels in this take, {covered} of {} in the session", channels.len()));
    let height = (ui.available_height() - 110.0).clamp(160.0, 380.0);
    let rect = Rect::from_min_size(ui.cursor().min, egui::vec2(ui.available_width(), height));
    channel_map_ui(ui, rect, station, &colors, &name, cx.playback, &palette);
    ui.advance_cursor_after_rect(rect);
    ui.spacing_mut().interact_size.y = 18.0;
    for (color, text) in [
        (palette.real, "touched in this take"),
        (palette.text_weak.gamma_multiply(0.5), "in an accepted take"),
        (palette.warning, "meant to be touched in this take"),
    ] {
        ui.horizontal(|ui| {
            let (rect, _) = ui.allocate_exact_size(egui::vec2(12.0, 12.0), egui::Sense::hover());
            ui.painter().circle_filled(rect.center(), 5.0, color);
            ui.label(RichText::new(text).color(palette.text_weak));
        });
    }
}
