//! Check results of a session: what is wrong, how often each taxel was touched, rates and gaps.

use egui::{Align2, FontId, RichText, Sense, Stroke, pos2, vec2};
use palpate_reports::{ChannelCoverage, CheckReport, Problem, Severity};

use crate::{
    screens::{ScreenContext, channel_label, failed_ui, heading_ui},
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
    problems_ui(ui, cx, &report);
    ui.add_space(8.0);
    coverage_ui(ui, cx, &report);
    ui.add_space(8.0);
    egui::CollapsingHeader::new("Rates and gaps").show(ui, |ui| rates_ui(ui, &cx.palette, &report));
}

fn problems_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, report: &CheckReport) {
    if report.problems.is_empty() {
        ui.label(
            RichText::new("\u{2714} Checked: rates, clocks and coverage are as they should be.").strong(),
        );
        return;
    }
    let verdict = if report.ok { "Usable, with remarks" } else { "Not usable as it is" };
    ui.label(RichText::new(verdict).strong());
    let station = cx.store.station(&report.session);
    let label = |place: &str| channel_label(station.ready().map(AsRef::as_ref), place);
    for group in grouped(report) {
        match group {
            Group::Touched { seldom } => {
                let text = seldom_text(report, &seldom);
                folded_ui(ui, cx, Severity::Warning, "seldom", &text, &seldom, label);
            }
            Group::Alike(problems) => {
                let text = format!("{} places: {}", problems.len(), problems[0].message);
                folded_ui(ui, cx, problems[0].severity, &problems[0].message, &text, &problems, label);
            }
            Group::Single(problem) => {
                let text = format!("{}: {}", label(&problem.place), problem.message);
                problem_ui(ui, &cx.palette, problem.severity, &text);
            }
        }
    }
}

fn problem_ui(ui: &mut egui::Ui, palette: &Palette, severity: Severity, text: &str) {
    let (mark, colour) = mark(palette, severity);
    ui.horizontal_wrapped(|ui| {
        ui.label(RichText::new(mark).color(colour));
        ui.label(text);
    });
}

fn mark(palette: &Palette, severity: Severity) -> (&'static str, egui::Color32) {
    match severity {
        Severity::Error => ("\u{2716} Error", palette.mismatch),
        Severity::Warning => ("\u{26a0} Warning", palette.warning),
        Severity::Info => ("\u{2139} Note", palette.text_weak),
    }
}

/// Many problems as one line, with the list of them folded below.
fn folded_ui(
    ui: &mut egui::Ui,
    cx: &ScreenContext<'_>,
    severity: Severity,
    id: &str,
    text: &str,
    problems: &[&Problem],
    label: impl Fn(&str) -> String,
) {
    problem_ui(ui, &cx.palette, severity, text);
    egui::CollapsingHeader::new(format!("Which {}", problems.len())).id_salt(id).show(ui, |ui| {
        for problem in problems {
            ui.label(format!("{}: {}", label(&problem.place), problem.message));
        }
    });
}

/// So many problems of one kind are told in one line.
const MANY: usize = 3;

/// What is told in one line.
#[derive(Debug, PartialEq)]
enum Group<'a> {
    /// Channels that were touched too seldom, or never.
    Touched { seldom: Vec<&'a Problem> },
    /// Problems that differ in their place and in numbers only.
    Alike(Vec<&'a Problem>),
    /// A problem by itself.
    Single(&'a Problem),
}

/// The problems in the order of the first of each group.
fn grouped(report: &CheckReport) -> Vec<Group<'_>> {
    let is_channel = |problem: &Problem| {
        problem.severity == Severity::Warning
            && report.coverage.iter().any(|channel| channel.channel == problem.place)
    };
    let key = |problem: &Problem| {
        let words: String = problem.message.chars().filter(|c| !c.is_ascii_digit()).collect();
        (is_channel(problem), problem.severity, if is_channel(problem) { String::new() } else { words })
    };
    let mut groups: Vec<Vec<&Problem>> = Vec::new();
    for problem in &report.problems {
        match groups.iter_mut().find(|group| key(group[0]) == key(problem)) {
            Some(group) => group.push(problem),
            None => groups.push(vec![problem]),
        }
    }
    let mut told = Vec::new();
    for group in groups {
        match group.len() {
            0..MANY => told.extend(group.into_iter().map(Group::Single)),
            _ if is_channel(group[0]) => told.push(Group::Touched { seldom: group }),
            _ => told.push(Group::Alike(group)),
        }
    }
    told
}

fn seldom_text(report: &CheckReport, seldom: &[&Problem]) -> String {
    let is_untouched = |problem: &&&Problem| {
        report.coverage.iter().any(|channel| channel.channel == problem.place && channel.touches == 0)
    };
    let never = match seldom.iter().filter(is_untouched).count() {
        0 => String::new(),
        never => format!(", {never} of them never"),
    };
    format!("{} of {} taxels were touched too seldom{never}", seldom.len(), report.coverage.len())
}

/// A bar per channel: contacts in the first and the second half of the takes.
fn coverage_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, report: &CheckReport) {
    let palette = cx.palette;
    heading_ui(ui, "Coverage");
    ui.horizontal_wrapped(|ui| {
        ui.label(RichText::new("Contacts of each channel:").color(palette.text_weak));
        legend_ui(ui, palette.real, "first half of the takes");
        legend_ui(ui, palette.text_weak, "second half");
    });
    let num_channels = report.coverage.len().max(1);
    let size = vec2(ui.available_width() - 8.0, 132.0);
    let (rect, response) = ui.allocate_exact_size(size, Sense::hover());
    let summary = coverage_text(&report.coverage);
    let about = "Bars: contacts of each channel in either half of the takes";
    response.widget_info(|| egui::WidgetInfo::labeled(egui::accesskit::Role::Image, true, about));
    let painter = ui.painter_at(rect);
    let plot = egui::Rect::from_min_max(rect.min + vec2(34.0, 6.0), rect.max - vec2(2.0, 6.0));
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
    // Below the picture and not in it: on a phone it takes two lines.
    ui.label(RichText::new(&summary).color(palette.text_weak));
    if let Some(channel_idx) = hovered {
        cx.playback.hovered = Some(channel_idx);
        let station = cx.store.station(&report.session);
        if let Some(channel) = report.coverage.get(channel_idx) {
            let [first, second] = channel.touches_by_half;
            let label = channel_label(station.ready().map(AsRef::as_ref), &channel.channel);
            response.on_hover_text_at_pointer(format!(
                "{label}: {first} + {second} contacts, active {:.1} s",
                channel.active_s
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
    fn many_warnings_become_one_line() {
        let problem = |severity, place: &str, message: &str| Problem {
            severity,
            place: place.into(),
            message: message.into(),
        };
        let warning = Severity::Warning;
        let channel = |id: &str, touches| ChannelCoverage {
            channel: id.into(),
            touches,
            touches_by_half: [touches, 0],
            active_s: 1.0,
        };
        let report = CheckReport {
            session: "s".into(),
            ok: true,
            frames: 1,
            duration_s: 1.0,
            takes: Vec::new(),
            coverage: vec![channel("a", 0), channel("b", 1), channel("c", 2), channel("d", 9)],
            problems: vec![
                problem(warning, "a", "never touched"),
                problem(Severity::Error, "take-01, joints", "17 readings missing"),
                problem(warning, "b", "touched 1 times"),
                problem(warning, "take-01, fsr", "3 gaps"),
                problem(warning, "c", "touched 2 times"),
                problem(warning, "take-02, fsr", "14 gaps"),
                problem(warning, "take-03, fsr", "5 gaps"),
            ],
        };
        let groups = grouped(&report);
        assert_eq!(groups.len(), 3, "{groups:?}");
        let Group::Touched { seldom } = &groups[0] else { panic!("{groups:?}") };
        assert_eq!(seldom_text(&report, seldom), "3 of 4 taxels were touched too seldom, 1 of them never");
        assert_eq!(groups[1], Group::Single(&report.problems[1]));
        assert!(matches!(&groups[2], Group::Alike(gaps) if gaps.len() == 3), "{groups:?}");
    }

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
