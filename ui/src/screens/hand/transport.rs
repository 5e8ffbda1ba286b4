//! Where in the take: play, step, scrub, speed.

use egui::RichText;

use crate::{
    playback::Playback,
    screens::{
        controls::{name_button, speed_ui},
        duration_text,
    },
    take_data::TakeData,
    theme::{Palette, is_narrow},
};

/// One row of controls; on a narrow page the slider has a row of its own. Keys for the same: space, comma, full stop.
pub(super) fn transport_ui(ui: &mut egui::Ui, playback: &mut Playback, take: &TakeData, palette: &Palette) {
    let narrow = is_narrow(ui.ctx());
    if narrow {
        slider_ui(ui, playback);
    }
    ui.horizontal(|ui| {
        let square = egui::vec2(36.0, 32.0);
        let named = |ui: &mut egui::Ui, text: &str, name: &str, size: egui::Vec2| {
            let response = ui.add_sized(size, egui::Button::new(text)).on_hover_text(name);
            name_button(&response, name);
            response.clicked()
        };
        if named(ui, "\u{23ee}", "One frame back", square) {
            playback.step_frames(take, -1);
        }
        let (sign, word) =
            if playback.playing { ("\u{23f8} Pause", "Pause") } else { ("\u{25b6} Play", "Play") };
        if named(ui, sign, word, egui::vec2(84.0, 32.0)) {
            playback.toggle_playing();
        }
        if named(ui, "\u{23ed}", "One frame on", square) {
            playback.step_frames(take, 1);
        }

        ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| {
            speed_ui(ui, playback);
            if !narrow {
                let total = duration_text(playback.duration_s);
                ui.label(RichText::new(format!("of {total}")).color(palette.text_weak));
            }
            ui.add_sized(
                [if narrow { 64.0 } else { 86.0 }, 20.0],
                egui::Label::new(RichText::new(time_text(playback.time_s)).monospace()),
            );
            if !narrow {
                slider_ui(ui, playback);
            }
        });
    });
}

/// Drags the time in the take, as wide as there is room.
fn slider_ui(ui: &mut egui::Ui, playback: &mut Playback) {
    ui.spacing_mut().slider_width = (ui.available_width() - 8.0).max(80.0);
    let mut time_s = playback.time_s;
    let slider = egui::Slider::new(&mut time_s, 0.0..=playback.duration_s.max(1e-3)).show_value(false);
    let response = ui.add(slider);
    let value = time_text(playback.time_s);
    ui.ctx().accesskit_node_builder(response.id, |node| {
        node.set_label("Time in the take");
        node.set_value(value.clone());
    });
    if response.changed() {
        playback.seek(time_s);
    }
}

/// `12.34 s`, or `2:05.30` from a minute on: the same width while it runs.
fn time_text(time_s: f64) -> String {
    let hundredths = (time_s.max(0.0) * 100.0).round() as u64;
    let (minutes, rest) = (hundredths / 6000, hundredths % 6000);
    if minutes == 0 {
        format!("{}.{:02} s", rest / 100, rest % 100)
    } else {
        format!("{minutes}:{:02}.{:02}", rest / 100, rest % 100)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_read_as_a_clock() {
        assert_eq!([0.0, 9.994, 59.996, 125.3].map(time_text), ["0.00 s", "9.99 s", "1:00.00", "2:05.30"]);
    }
}
