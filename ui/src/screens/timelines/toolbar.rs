//! What to look at: take, simulation to compare with, channels; and playing it.

use egui::{RichText, accesskit::Role};
use palpate_wire::api::JobState;

use super::{ScreenContext, ShownChannels, TimelinesState};
use crate::{
    commands::Command,
    playback::{ModelRef, Playback},
    screens::duration_text,
};

pub(super) fn toolbar_ui(
    ui: &mut egui::Ui,
    cx: &mut ScreenContext<'_>,
    state: &mut TimelinesState,
    session: &str,
    take_id: &str,
) {
    ui.horizontal_wrapped(|ui| {
        take_ui(ui, cx, session, take_id);
        let word = if cx.playback.playing { "\u{23f8} Pause" } else { "\u{25b6} Play" };
        let play = ui.add(egui::Button::new(word).min_size(egui::vec2(84.0, 32.0)));
        name(&play, if cx.playback.playing { "Pause" } else { "Play" });
        if play.clicked() {
            cx.playback.toggle_playing();
        }
        combo(ui, "Speed", &format!("\u{d7} {}", cx.playback.speed), 70.0, |ui| {
            for speed in Playback::SPEEDS {
                option(ui, &mut cx.playback.speed, speed, &format!("\u{d7} {speed}"));
            }
        });
        ui.label(
            RichText::new(format!(
                "{:.3} s of {}",
                cx.playback.time_s,
                duration_text(cx.playback.duration_s)
            ))
            .monospace(),
        );
        compare_ui(ui, cx);
        channels_ui(ui, cx, state, session);
        for (text, label, command) in [
            ("\u{2b05} [", "Previous mismatch", Command::PreviousMismatch),
            ("] \u{27a1}", "Next mismatch", Command::NextMismatch),
            ("Fit", "Show the whole take", Command::FitTake),
        ] {
            let button = ui.button(text).on_hover_text(label);
            name(&button, label);
            if button.clicked() {
                state.push_command(command);
                ui.ctx().request_repaint();
            }
        }
    });
}

/// Names a button by a word where its face shows a symbol.
fn name(response: &egui::Response, label: &str) {
    response.widget_info(|| egui::WidgetInfo::labeled(Role::Button, true, label));
}

fn combo(ui: &mut egui::Ui, label: &str, chosen: &str, width: f32, contents: impl FnOnce(&mut egui::Ui)) {
    let response =
        egui::ComboBox::from_id_salt(label).selected_text(chosen).width(width).show_ui(ui, contents).response;
    response.accessible_name(label);
}

/// A line of a combo box, with the role that belongs there.
fn option<T: PartialEq>(ui: &mut egui::Ui, chosen: &mut T, value: T, text: &str) -> egui::Response {
    let is_chosen = *chosen == value;
    let response = ui.selectable_value(chosen, value, text);
    response.widget_info(|| egui::WidgetInfo::selected(Role::ListBoxOption, true, is_chosen, text));
    response
}

fn take_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, session: &str, take_id: &str) {
    let detail = cx.store.session(session);
    let Some(detail) = detail.ready() else {
        ui.label(take_id);
        return;
    };
    let text = |take: &palpate_wire::api::TakeSummary| {
        let verdict = if take.accepted { "" } else { ", not accepted" };
        format!("{}: {} on {}{verdict}", take.id, take.primitive, take.object)
    };
    let chosen_text =
        detail.takes.iter().find(|take| take.id == take_id).map_or_else(|| take_id.to_owned(), text);
    let mut chosen = take_id.to_owned();
    combo(ui, "Take", &chosen_text, 220.0, |ui| {
        for take in &detail.takes {
            option(ui, &mut chosen, take.id.clone(), &text(take));
        }
    });
    if chosen != take_id {
        cx.playback.open(session, &chosen);
    }
}

fn compare_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>) {
    let mut choices: Vec<ModelRef> = Vec::new();
    if let Some(models) = cx.store.models().ready() {
        let saved = models.iter().filter(|model| model.id != "nominal");
        choices.extend(saved.map(|model| ModelRef::Saved(model.id.clone())));
    }
    if let Some(runs) = cx.store.runs().ready() {
        let done = runs.iter().filter(|run| run.state == JobState::Done && run.saved_as.is_none());
        choices.extend(done.map(|run| ModelRef::Run(run.id.clone())));
    }
    if let Some(current) = &cx.playback.compared
        && !choices.contains(current)
    {
        choices.insert(0, current.clone());
    }
    let mut compared = cx.playback.compared.clone();
    let label_of = |cx: &mut ScreenContext<'_>, model: &Option<ModelRef>| match model {
        Some(model) => cx.store.model_label(model),
        None => "nominal only".to_owned(),
    };
    let chosen_text = label_of(cx, &compared);
    combo(ui, "Compare with", &format!("Compare: {chosen_text}"), 190.0, |ui| {
        option(ui, &mut compared, None, "nominal only");
        for choice in choices.iter().cloned().map(Some) {
            let text = label_of(cx, &choice);
            option(ui, &mut compared, choice, &text);
        }
        if choices.is_empty() {
            ui.label("Calibrate a session to have more to compare with.");
        }
    });
    cx.playback.compared = compared;
}

fn channels_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, state: &mut TimelinesState, session: &str) {
    let text = match state.shown {
        ShownChannels::Touched => "touched".to_owned(),
        ShownChannels::All => "all".to_owned(),
        ShownChannels::Picked => format!("{} picked", cx.playback.selected.len()),
    };
    let station = cx.store.station(session);
    let popup = egui::ComboBox::from_id_salt("channels")
        .selected_text(format!("Channels: {text}"))
        .width(140.0)
        .height(420.0)
        .close_behavior(egui::PopupCloseBehavior::CloseOnClickOutside);
    let response = popup
        .show_ui(ui, |ui| {
            option(ui, &mut state.shown, ShownChannels::Touched, "Touched in this take");
            option(ui, &mut state.shown, ShownChannels::All, "All channels");
            option(ui, &mut state.shown, ShownChannels::Picked, "Only those picked below");
            ui.separator();
            let Some(station) = station.ready() else { return };
            let layout = &station.layout;
            for stream in &layout.streams {
                ui.label(RichText::new(&stream.label).strong());
                pick_ui(ui, cx, state, stream.channels.clone(), &format!("All {}", stream.label));
                for patch in layout.patches.iter().filter(|patch| {
                    stream.channels.start <= patch.channels.start && patch.channels.end <= stream.channels.end
                }) {
                    pick_ui(ui, cx, state, patch.channels.clone(), &patch.label);
                    if patch.channels.len() > 1 {
                        ui.indent(&patch.id, |ui| {
                            ui.horizontal_wrapped(|ui| {
                                for channel in patch.channels.clone() {
                                    let id = &layout.channels[channel].id;
                                    pick_ui(ui, cx, state, channel..channel + 1, id);
                                }
                            });
                        });
                    }
                }
            }
        })
        .response;
    response.accessible_name("Channels");
}

/// A check box for some channels at once.
fn pick_ui(
    ui: &mut egui::Ui,
    cx: &mut ScreenContext<'_>,
    state: &mut TimelinesState,
    channels: std::ops::Range<usize>,
    text: &str,
) {
    let mut picked = !channels.is_empty() && channels.clone().all(|c| cx.playback.selected.contains(&c));
    if ui.checkbox(&mut picked, text).changed() {
        state.shown = ShownChannels::Picked;
        for channel in channels {
            if picked {
                cx.playback.selected.insert(channel);
            } else {
                cx.playback.selected.remove(&channel);
            }
        }
    }
}
