//! What to look at: take, simulation to compare with, channels; and playing it.

use egui::RichText;

use super::{ScreenContext, ShownChannels, TimelinesState};
use crate::{
    commands::Command,
    route::Screen,
    screens::{
        controls::{combo_ui, compared_ui, diagnosed_ui, name_button, option_ui, speed_ui},
        duration_text, topic_ui, words,
    },
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
        name_button(&play, if cx.playback.playing { "Pause" } else { "Play" });
        if play.clicked() {
            cx.playback.toggle_playing();
        }
        speed_ui(ui, cx.playback);
        let time = format!("{:.3} s of {}", cx.playback.time_s, duration_text(cx.playback.duration_s));
        // On a row of its own where it does not fit, and not broken into two.
        ui.add(egui::Label::new(RichText::new(time).monospace()).extend());
        compared_ui(ui, cx);
        if cx.playback.diagnosed.is_some() {
            diagnosed_ui(ui, cx);
        }
        channels_ui(ui, cx, session);
        for (text, label, command) in [
            ("\u{2b05} [", "Previous mismatch", Command::PreviousMismatch),
            ("] \u{27a1}", "Next mismatch", Command::NextMismatch),
            ("Fit", "Show the whole take", Command::FitTake),
        ] {
            let button = ui.button(text).on_hover_text(label);
            name_button(&button, label);
            if button.clicked() {
                state.commands.push(command);
                ui.ctx().request_repaint();
            }
        }
        topic_ui(ui, Screen::Timelines);
    });
}

fn take_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, session: &str, take_id: &str) {
    let detail = cx.store.session(session);
    let Some(detail) = detail.ready() else {
        ui.label(take_id);
        return;
    };
    let text = |take: &palpate_wire::api::TakeSummary| {
        let verdict = if take.accepted { "" } else { ", not accepted" };
        format!("{}: {} on {}{verdict}", take.id, words(&take.primitive), take.object)
    };
    let chosen_text =
        detail.takes.iter().find(|take| take.id == take_id).map_or_else(|| take_id.to_owned(), text);
    let mut chosen = take_id.to_owned();
    combo_ui(ui, "Take", &chosen_text, 220.0, |ui| {
        for take in &detail.takes {
            option_ui(ui, &mut chosen, take.id.clone(), &text(take));
        }
    });
    if chosen != take_id {
        cx.playback.open(session, &chosen);
    }
}

fn channels_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, session: &str) {
    let text = match cx.playback.shown {
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
            option_ui(ui, &mut cx.playback.shown, ShownChannels::Touched, "Touched in this take");
            option_ui(ui, &mut cx.playback.shown, ShownChannels::All, "All channels");
            option_ui(ui, &mut cx.playback.shown, ShownChannels::Picked, "Only those picked below");
            ui.separator();
            let Some(station) = station.ready() else { return };
            let layout = &station.layout;
            for stream in &layout.streams {
                ui.label(RichText::new(&stream.label).strong());
                pick_ui(ui, cx, stream.channels.clone(), &format!("All {}", stream.label));
                for patch in layout.patches.iter().filter(|patch| {
                    stream.channels.start <= patch.channels.start && patch.channels.end <= stream.channels.end
                }) {
                    pick_ui(ui, cx, patch.channels.clone(), &patch.label);
                    if patch.channels.len() > 1 {
                        ui.indent(&patch.id, |ui| {
                            ui.horizontal_wrapped(|ui| {
                                for channel in patch.channels.clone() {
                                    let label = layout.channel_label(channel);
                                    pick_ui(ui, cx, channel..channel + 1, &label);
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
fn pick_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, channels: std::ops::Range<usize>, text: &str) {
    let mut picked = !channels.is_empty() && channels.clone().all(|c| cx.playback.selected.contains(&c));
    if ui.checkbox(&mut picked, text).changed() {
        cx.playback.shown = ShownChannels::Picked;
        for channel in channels {
            if picked {
                cx.playback.selected.insert(channel);
            } else {
                cx.playback.selected.remove(&channel);
            }
        }
    }
}
