//! Where in the take: play, step, scrub, speed.

use egui::RichText;

use crate::{playback::Playback, screens::duration_text, take_data::TakeData, theme::Palette};

/// Seconds of take per second of wall clock.
const SPEEDS: [f64; 5] = [0.25, 0.5, 1.0, 2.0, 4.0];

/// One row of controls. Keys for the same: space, comma, full stop.
pub(super) fn transport_ui(ui: &mut egui::Ui, playback: &mut Playback, take: &TakeData, palette: &Palette) {
    ui.horizontal(|ui| {
        let square = egui::vec2(36.0, 32.0);
        let named = |ui: &mut egui::Ui, text: &str, name: &str, size: egui::Vec2| {
            let response = ui.add_sized(size, egui::Button::new(text)).on_hover_text(name);
            response.widget_info(|| egui::WidgetInfo::labeled(egui::accesskit::Role::Button, true, name));
            response.clicked()
        };
        if named(ui, "\u{23ee}", "One frame back", square) {
            step(playback, take, -1);
        }
        let (sign, word) =
            if playback.playing { ("\u{23f8} Pause", "Pause") } else { ("\u{25b6} Play", "Play") };
        if named(ui, sign, word, egui::vec2(84.0, 32.0)) {
            playback.toggle_playing();
        }
        if named(ui, "\u{23ed}", "One frame on", square) {
            step(playback, take, 1);
        }

        let speed_text = |speed: f64| format!("{speed}\u{d7}");
        ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| {
            let combo = egui::ComboBox::from_id_salt("speed")
                .width(64.0)
                .selected_text(speed_text(playback.speed))
                .show_ui(ui, |ui| {
                    for speed in SPEEDS {
                        ui.selectable_value(&mut playback.speed, speed, speed_text(speed));
                    }
                });
            let current = format!("Speed: {}", speed_text(playback.speed));
            combo.response.widget_info(|| {
                egui::WidgetInfo::labeled(egui::accesskit::Role::ComboBox, true, current.clone())
            });
            let total = duration_text(playback.duration_s);
            ui.label(RichText::new(format!("of {total}")).color(palette.text_weak));
            ui.add_sized(
                [86.0, 20.0],
                egui::Label::new(RichText::new(time_text(playback.time_s)).monospace()),
            );

            ui.spacing_mut().slider_width = (ui.available_width() - 8.0).max(80.0);
            let mut time_s = playback.time_s;
            let slider =
                egui::Slider::new(&mut time_s, 0.0..=playback.duration_s.max(1e-3)).show_value(false);
            let response = ui.add(slider);
            let value = time_text(playback.time_s);
            ui.ctx().accesskit_node_builder(response.id, |node| {
                node.set_label("Time in the take");
                node.set_value(value.clone());
            });
            if response.changed() {
                playback.seek(time_s);
            }
        });
    });
}

/// To the joint frame before or after the cursor.
fn step(playback: &mut Playback, take: &TakeData, by: isize) {
    playback.playing = false;
    if let Some(frame) = take.frame_at(playback.time_s) {
        let frame = frame.saturating_add_signed(by).min(take.num_frames().saturating_sub(1));
        playback.seek(take.trace.frame_times_s[frame]);
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
    use palpate_wire::proto::TakeTrace;

    use super::*;

    #[test]
    fn times_read_as_a_clock() {
        assert_eq!([0.0, 9.994, 59.996, 125.3].map(time_text), ["0.00 s", "9.99 s", "1:00.00", "2:05.30"]);
    }

    #[test]
    fn steps_go_from_frame_to_frame_and_stop_at_the_ends() {
        let trace = TakeTrace {
            frame_times_s: vec![0.0, 0.1, 0.25],
            joint_positions: vec![0.0; 3],
            ..Default::default()
        };
        let take = TakeData::new(trace).expect("a take");
        let mut playback = Playback { duration_s: 0.25, time_s: 0.12, playing: true, ..Default::default() };
        step(&mut playback, &take, 1);
        assert_eq!((playback.time_s, playback.playing), (0.25, false));
        step(&mut playback, &take, 1);
        assert_eq!(playback.time_s, 0.25);
        step(&mut playback, &take, -1);
        step(&mut playback, &take, -1);
        step(&mut playback, &take, -1);
        assert_eq!(playback.time_s, 0.0);
    }
}
