//! Check results of a session: what is wrong, how often each taxel was touched, rates and gaps.

use egui::{Align2, FontId, RichText, Sense, Stroke, pos2, vec2};
use palpate_wire::api::{ChannelCoverage, CheckReport, Severity};

use crate::{
    screens::{ScreenContext, failed_ui},
    store::Loadable,
    theme::Palette,
};

/// Touches per half of the takes below which dead, stuck and swapped channels cannot be told apart.
const ENOUGH_TOUCHES: usize = 4;

pub(super) fn check_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, id: &str) {
    let report = match cx.store.check(id) {
        Loadable::Ready(report) => report,
        Loadable::Failed(error) => return failed_ui(ui, cx, "The session could not be checked", &error),
        Loadable::Idle | Loadable::Loading => {
            ui.horizontal(|ui| {
                ui.spinner();
                ui.label("Checking rates, clocks and coverage\u{2026}");
            });
            return;
        }
    };
    problems_ui(ui, &cx.palette, &report);
    ui.add_space(8.0);
    coverage_ui(ui, cx, &report);
    ui.add_space(8.0);
    egui::CollapsingHeader::new("Rates and gaps").show(ui, |ui| rates_ui(ui, &cx.palette, &report));
}

fn problems_ui(ui: &mut egui::Ui, palette: &Palette, report: &CheckReport) {
    if report.problems.is_empty() {
        ui.label(
            RichText::new("\u{2714} Checked: rates, clocks and coverage are as they should be.").strong(),
        );
        return;
    }
    let verdict = if report.ok { "Usable, with remarks" } else { "Not usable as it is" };
    ui.label(RichText::new(verdict).strong());
    for problem in &report.problems {
        let (mark, colour) = match problem.severity {
            Severity::Error => ("\u{2716} Error", palette.mismatch),
            Severity::Warning => ("\u{26a0} Warning", palette.warning),
            Severity::Info => ("\u{2139} Note", palette.text_weak),
        };
        ui.horizontal_wrapped(|ui| {
            ui.label(RichText::new(mark).color(colour));
            ui.label(format!("{}: {}", problem.place, problem.message));
        });
    }
}

/// A bar per channel: contacts in the first and the second half of the takes.
fn coverage_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, report: &CheckReport) {
    let palette = cx.palette;
    ui.heading("Coverage");
    ui.horizontal(|ui| {
        ui.label(RichText::new("Contacts of each channel:").color(palette.text_weak));
        legend_ui(ui, palette.real, "first half of the takes");
        legend_ui(ui, palette.text_weak, "second half");
    });
    let num_channels = report.coverage.len().max(1);
    let size = vec2(ui.available_width() - 8.0, 150.0);
    let (rect, response) = ui.allocate_exact_size(size, Sense::hover());
    let summary = coverage_text(&report.coverage);
    response.widget_info(|| egui::WidgetInfo::labeled(egui::accesskit::Role::Image, true, &summary));
    let painter = ui.painter_at(rect);
    let plot = egui::Rect::from_min_max(rect.min + vec2(34.0, 6.0), rect.max - vec2(2.0, 22.0));
    let most = report.coverage.iter().flat_map(|c| c.touches_by_half).max().unwrap_or(0).max(ENOUGH_TOUCHES);
    let y_of = |touches: usize| plot.bottom() - plot.height() * touches as f32 / most as f32;
    let font = FontId::proportional(13.0);
    for touches in [0, ENOUGH_TOUCHES, most] {
        let y = y_of(touches);
        painter.hline(plot.x_range(), y, Stroke::new(1.0, palette.line));
        painter.text(
            pos2(plot.left() - 4.0, y),
            Align2::RIGHT_CENTER,
            touches.to_string(),
            font.clone(),
            palette.text_weak,
        );
    }
    let step = plot.width() / num_channels as f32;
    let hovered = response
        .hover_pos()
        .filter(|pointer| plot.x_range().contains(pointer.x))
        .map(|pointer| (((pointer.x - plot.left()) / step) as usize).min(num_channels - 1));
    for (channel_idx, channel) in report.coverage.iter().enumerate() {
        let left = plot.left() + channel_idx as f32 * step;
        if hovered == Some(channel_idx) {
            let column = egui::Rect::from_x_y_ranges(left..=left + step, plot.y_range());
            painter.rect_filled(column, 0.0, palette.line);
        }
        for (half, &touches) in channel.touches_by_half.iter().enumerate() {
            let colour = match (touches < ENOUGH_TOUCHES, half) {
                (true, _) => palette.mismatch,
                (false, 0) => palette.real,
                (false, _) => palette.text_weak,
            };
            let x = left + step * (0.15 + 0.37 * half as f32);
            let bar = egui::Rect::from_x_y_ranges(x..=x + step * 0.33, y_of(touches)..=plot.bottom());
            painter.rect_filled(bar, 0.0, colour);
        }
    }
    painter.text(
        pos2(plot.center().x, rect.bottom()),
        Align2::CENTER_BOTTOM,
        &summary,
        font,
        palette.text_weak,
    );
    if let Some(channel_idx) = hovered {
        cx.playback.hovered = Some(channel_idx);
        if let Some(channel) = report.coverage.get(channel_idx) {
            let [first, second] = channel.touches_by_half;
            response.on_hover_text_at_pointer(format!(
                "{}: {first} + {second} contacts, active {:.1} s",
                channel.channel, channel.active_s
            ));
        }
    }
}

fn legend_ui(ui: &mut egui::Ui, colour: egui::Color32, text: &str) {
    let (rect, _) = ui.allocate_exact_size(vec2(12.0, 12.0), Sense::hover());
    ui.painter().rect_filled(rect, 0.0, colour);
    ui.label(text);
}

fn coverage_text(coverage: &[ChannelCoverage]) -> String {
    let enough = coverage
        .iter()
        .filter(|channel| channel.touches_by_half.iter().all(|&t| t >= ENOUGH_TOUCHES))
        .count();
    format!("{enough} of {} channels touched at least {ENOUGH_TOUCHES} times in each half", coverage.len())
}

fn rates_ui(ui: &mut egui::Ui, palette: &Palette, report: &CheckReport) {
    egui::Grid::new("session_rates").striped(true).min_row_height(22.0).spacing([22.0, 4.0]).show(ui, |ui| {
        for name in ["Take", "Stream", "Samples", "Rate, Hz", "Nominal, Hz", "Longest gap, ms", "Gaps"] {
            ui.label(RichText::new(name).strong());
        }
        ui.end_row();
        for take in &report.takes {
            for stream in &take.streams {
                ui.label(&take.id);
                ui.label(&stream.stream);
                ui.label(stream.samples.to_string());
                ui.label(format!("{:.2}", stream.rate_hz));
                ui.label(RichText::new(format!("{:.1}", stream.nominal_rate_hz)).color(palette.text_weak));
                ui.label(format!("{:.0}", stream.longest_gap_s * 1e3));
                ui.label(stream.gaps.to_string());
                ui.end_row();
            }
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coverage_counts_channels_that_are_touched_enough_in_both_halves() {
        let channel = |halves: [usize; 2]| ChannelCoverage {
            channel: "c".into(),
            touches: halves[0] + halves[1],
            touches_by_half: halves,
            active_s: 1.0,
        };
        let text = coverage_text(&[channel([4, 9]), channel([3, 9]), channel([5, 4])]);
        assert_eq!(text, "2 of 3 channels touched at least 4 times in each half");
    }
}
