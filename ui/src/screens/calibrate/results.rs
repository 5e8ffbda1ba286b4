//! What a finished run found: one sentence, the picture, the numbers, and what to do with it.

use egui::RichText;
use palpate_reports::{CalibrationReport, MetricIntervals, Metrics, StreamFit};
use palpate_wire::api::CalibrationRun;

use super::{CalibrateState, objective, tables};
use crate::{
    route::Screen,
    screens::{ScreenContext, controls::file_link_ui, heading_ui, help_ui},
    store::Loadable,
    theme::Palette,
};

pub(super) fn results_ui(
    ui: &mut egui::Ui,
    cx: &mut ScreenContext<'_>,
    state: &mut CalibrateState,
    run: &CalibrationRun,
    report: &CalibrationReport,
) {
    // What can be done with the result stays in reach, however far one scrolls.
    egui::Panel::bottom("calibrate_keep").resizable(false).show(ui, |ui| {
        ui.add_space(4.0);
        keep_ui(ui, cx, state, run, report);
        ui.add_space(4.0);
    });
    egui::ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
        ui.add_space(4.0);
        ui.horizontal(|ui| {
            heading_ui(ui, "3  See");
            help_ui(ui, "F1");
        });
        let headline = headline(report);
        let response = ui.label(RichText::new(&headline).size(17.0).strong());
        response.widget_info(|| egui::WidgetInfo::labeled(egui::accesskit::Role::Label, true, &headline));
        for note in &report.notes {
            ui.colored_label(cx.palette.warning, format!("\u{26a0} {note}"));
        }
        ui.add_space(6.0);
        objective::objective_ui(ui, &cx.palette, report);
        ui.add_space(10.0);
        metrics_ui(ui, cx, run, report);
        ui.add_space(10.0);
        tables::tables_ui(ui, cx, &mut state.table, &run.request.session, report);
        ui.add_space(12.0);
    });
}

/// What changed on takes that the fit has not seen: what is looked at first, then what got worse, and what did not change
/// beyond chance.
fn headline(report: &CalibrationReport) -> String {
    let (before, after) = (&report.held_out.nominal, &report.held_out.calibrated);
    let mut parts = Vec::new();
    if let (Some(a), Some(b)) = (before.onset_error_ms, after.onset_error_ms) {
        parts.push(format!("onset error from {a:.0} to {b:.0} ms"));
    }
    if let (Some(a), Some(b)) = (before.f1, after.f1) {
        parts.push(format!("F1 from {a:.2} to {b:.2}"));
    }
    if let (Some(a), Some(b)) = (before.fpr, after.fpr) {
        parts.push(format!("false positives from {:.1} to {:.1} %", a * 100.0, b * 100.0));
    }
    if parts.is_empty() {
        return "Calibrated, but the held-out takes hold no touch to judge by.".to_owned();
    }
    let mut text = format!("Calibrated: {} on takes it has not seen.", parts.join(", "));
    for (change, word) in [(Change::Worse, "Worse"), (Change::Unclear, "No clear difference")] {
        let of_kind = ROWS.iter().filter(|row| row.change(report) == Some(change));
        let names: Vec<String> = of_kind.filter_map(|row| row.spoken(report)).collect();
        if !names.is_empty() {
            text += &format!(" {word}: {}.", names.join(", "));
        }
    }
    text
}

/// What a calibration did to a metric.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Change {
    Better,
    Worse,
    /// The 95 % interval of the change holds zero, or nothing changed.
    Unclear,
}

impl Change {
    fn word(self) -> &'static str {
        match self {
            Self::Better => "better",
            Self::Worse => "worse",
            Self::Unclear => "no clear difference",
        }
    }
}

/// A metric as people read it.
struct Row {
    name: &'static str,
    /// In a sentence, with the unit that follows its values.
    spoken: (&'static str, &'static str),
    value: fn(&Metrics) -> Option<f64>,
    of: fn(&MetricIntervals) -> Option<[f64; 2]>,
    factor: f64,
    digits: usize,
    lower_is_better: bool,
}

const ROWS: [Row; 4] = [
    Row {
        name: "Onset error, ms",
        spoken: ("onset timing", " ms"),
        value: |m| m.onset_error_ms,
        of: |i| i.onset_error_ms,
        factor: 1.0,
        digits: 0,
        lower_is_better: true,
    },
    Row {
        name: "Offset error, ms",
        spoken: ("release timing", " ms"),
        value: |m| m.offset_error_ms,
        of: |i| i.offset_error_ms,
        factor: 1.0,
        digits: 0,
        lower_is_better: true,
    },
    Row {
        name: "Activation F1",
        spoken: ("F1", ""),
        value: |m| m.f1,
        of: |i| i.f1,
        factor: 1.0,
        digits: 3,
        lower_is_better: false,
    },
    Row {
        name: "False positive rate, %",
        spoken: ("false positives", " %"),
        value: |m| m.fpr,
        of: |i| i.fpr,
        factor: 100.0,
        digits: 2,
        lower_is_better: true,
    },
];

impl Row {
    /// What the calibration did to it on takes that the fit has not seen; `None` where it has no meaning there.
    fn change(&self, report: &CalibrationReport) -> Option<Change> {
        let before = (self.value)(&report.held_out.nominal)?;
        let after = (self.value)(&report.held_out.calibrated)?;
        let sign = if self.lower_is_better { -1.0 } else { 1.0 };
        let gain = sign * (after - before);
        let interval = report.intervals_95.as_ref().and_then(|intervals| (self.of)(&intervals.change));
        let is_by_chance = interval.is_some_and(|[low, high]| low <= 0.0 && high >= 0.0);
        Some(match gain {
            _ if is_by_chance => Change::Unclear,
            gain if gain > 0.0 => Change::Better,
            gain if gain < 0.0 => Change::Worse,
            _ => Change::Unclear,
        })
    }

    /// Name and values for a sentence: `release timing (425 to 445 ms)`.
    fn spoken(&self, report: &CalibrationReport) -> Option<String> {
        let before = (self.value)(&report.held_out.nominal)? * self.factor;
        let after = (self.value)(&report.held_out.calibrated)? * self.factor;
        let (name, unit) = self.spoken;
        let digits = self.digits;
        Some(format!("{name} ({before:.digits$} to {after:.digits$}{unit})"))
    }
}

fn metrics_ui(ui: &mut egui::Ui, cx: &ScreenContext<'_>, run: &CalibrationRun, report: &CalibrationReport) {
    let held = report.held_out_takes.join(", ");
    ui.horizontal_wrapped(|ui| {
        ui.label(RichText::new(format!("On the held-out takes ({held})")).color(cx.palette.text_weak));
        for (face, label, file) in [
            ("metrics (CSV)", "Download the metrics", "metrics.csv"),
            ("intervals (CSV)", "Download the intervals", "intervals.csv"),
        ] {
            file_link_ui(ui, face, label, &format!("calibrations/{{}}/tables/{file}"), &[&run.id]);
        }
    });
    let lines = lines(report);
    if ui.available_width() < GRID_WIDTH {
        stacked_ui(ui, &cx.palette, &lines);
    } else {
        grid_ui(ui, &cx.palette, &lines);
    }
}

/// Where the metrics have room beside each other.
const GRID_WIDTH: f32 = 640.0;

/// A metric as it is shown: value and interval of the nominal model, then of the calibrated one.
struct Line {
    name: &'static str,
    nominal: [String; 2],
    calibrated: [String; 2],
    change: Option<Change>,
}

fn lines(report: &CalibrationReport) -> Vec<Line> {
    let intervals = report.intervals_95.as_ref();
    let mut lines: Vec<Line> = ROWS
        .iter()
        .map(|row| {
            let (factor, digits) = (row.factor, row.digits);
            let text = |metrics: &Metrics| tables::number((row.value)(metrics), factor, digits);
            let range = |of: Option<&MetricIntervals>| range(of.and_then(row.of), factor, digits);
            Line {
                name: row.name,
                nominal: [text(&report.held_out.nominal), range(intervals.map(|all| &all.nominal))],
                calibrated: [text(&report.held_out.calibrated), range(intervals.map(|all| &all.calibrated))],
                change: row.change(report),
            }
        })
        .collect();
    let coverage = |metrics: &Metrics| [tables::number(metrics.onset_coverage, 100.0, 0), String::new()];
    lines.push(Line {
        name: "Real contacts with a partner, %",
        nominal: coverage(&report.held_out.nominal),
        calibrated: coverage(&report.held_out.calibrated),
        change: None,
    });
    lines
}

fn change_ui(ui: &mut egui::Ui, palette: &Palette, change: Option<Change>) {
    let Some(change) = change else { return };
    let colour = match change {
        Change::Better => palette.diagnosed,
        Change::Worse => palette.mismatch,
        Change::Unclear => palette.text_weak,
    };
    ui.colored_label(colour, change.word());
}

fn grid_ui(ui: &mut egui::Ui, palette: &Palette, lines: &[Line]) {
    egui::Grid::new("calibrate_metrics").striped(true).min_row_height(22.0).spacing([28.0, 6.0]).show(
        ui,
        |ui| {
            ui.label("");
            ui.label(RichText::new("Nominal").color(palette.nominal_text).strong());
            ui.label(RichText::new("95 % interval").color(palette.text_weak));
            ui.label(RichText::new("Calibrated").color(palette.calibrated).strong());
            ui.label(RichText::new("95 % interval").color(palette.text_weak));
            ui.label("");
            ui.end_row();
            for Line { name, nominal, calibrated, change } in lines {
                ui.label(*name);
                ui.label(&nominal[0]);
                ui.label(RichText::new(&nominal[1]).color(palette.text_weak));
                ui.label(RichText::new(&calibrated[0]).strong());
                ui.label(RichText::new(&calibrated[1]).color(palette.text_weak));
                change_ui(ui, palette, *change);
                ui.end_row();
            }
        },
    );
}

/// The same, each metric below the last, for a narrow window.
fn stacked_ui(ui: &mut egui::Ui, palette: &Palette, lines: &[Line]) {
    for Line { name, nominal, calibrated, change } in lines {
        ui.add_space(4.0);
        ui.horizontal_wrapped(|ui| {
            ui.label(RichText::new(*name).strong());
            change_ui(ui, palette, *change);
        });
        for (whose, colour, [value, range]) in
            [("Nominal", palette.nominal_text, nominal), ("Calibrated", palette.calibrated, calibrated)]
        {
            ui.horizontal_wrapped(|ui| {
                ui.colored_label(colour, whose);
                ui.label(value);
                if !range.is_empty() {
                    ui.label(RichText::new(format!("(95 % interval {range})")).color(palette.text_weak));
                }
            });
        }
    }
}

fn range(interval: Option<[f64; 2]>, factor: f64, digits: usize) -> String {
    let Some([low, high]) = interval else { return String::new() };
    format!("{:.digits$} to {:.digits$}", low * factor, high * factor)
}

/// The parameters of every stream, nominal and calibrated.
fn streams_ui(ui: &mut egui::Ui, report: &CalibrationReport) {
    egui::Grid::new("streams").num_columns(4).spacing([18.0, 4.0]).striped(true).show(ui, |ui| {
        for head in ["Stream", "\u{3bb}con, mm", "\u{3b1}, 1/m", "\u{3bb}pre, kPa"] {
            ui.label(head);
        }
        ui.end_row();
        for (id, StreamFit { theta, nominal_theta, .. }) in &report.streams {
            ui.label(id);
            for (before, after, factor) in [
                (nominal_theta.lambda_con_m, theta.lambda_con_m, 1e3),
                (nominal_theta.alpha_per_m, theta.alpha_per_m, 1.0),
                (nominal_theta.lambda_pre_pa, theta.lambda_pre_pa, 1e-3),
            ] {
                ui.label(match (before, after) {
                    (Some(before), Some(after)) => format!(
                        "{} (was {})",
                        objective::number(after * factor),
                        objective::number(before * factor)
                    ),
                    _ => String::new(),
                });
            }
            ui.end_row();
        }
    });
}

fn keep_ui(
    ui: &mut egui::Ui,
    cx: &mut ScreenContext<'_>,
    state: &mut CalibrateState,
    run: &CalibrationRun,
    report: &CalibrationReport,
) {
    let theta = &report.theta;
    ui.horizontal_wrapped(|ui| {
        heading_ui(ui, "4  Keep");
        let milliseconds = report.seconds * 1e3;
        if report.streams.is_empty() {
            ui.label(format!(
                "\u{3bb}con {} mm, \u{3b1} {} /m, \u{3bb}pre {} kPa; searched in {milliseconds:.0} ms",
                objective::number(theta.lambda_con_m * 1e3),
                objective::number(theta.alpha_per_m),
                objective::number(theta.lambda_pre_pa / 1e3),
            ));
        } else {
            ui.label(format!("Each stream has its own parameters; searched in {milliseconds:.0} ms"));
        }
    });
    if !report.streams.is_empty() {
        egui::ScrollArea::horizontal().id_salt("streams_scroll").show(ui, |ui| streams_ui(ui, report));
    }
    ui.horizontal_wrapped(|ui| {
        let label = ui.label("Model name");
        let field = egui::TextEdit::singleline(&mut state.model_name).desired_width(200.0);
        ui.add(field).labelled_by(label.id);
        let named = !state.model_name.trim().is_empty();
        if ui.add_enabled(named, egui::Button::new("Save model")).clicked() {
            cx.store.save_model(&run.id, state.model_name.trim());
        }
        if ui.button("Compare on Timelines").clicked() {
            cx.go_to_screen(Screen::Timelines);
        }
        ui.hyperlink_to("Open the report", format!("/api/v1/calibrations/{}/report.html", run.id));
        file_link_ui(ui, "Model (TOML)", "Download the model", "jobs/{}/files/model.toml", &[&run.id]);
    });
    match (&cx.store.saved_model, &run.saved_as) {
        (Loadable::Failed(error), _) => {
            ui.colored_label(cx.palette.mismatch, format!("The model was not saved: {error}"));
        }
        (_, Some(id)) => {
            ui.label(format!("\u{2714} Saved as {id}."));
        }
        (Loadable::Loading, None) => {
            ui.spinner();
        }
        _ => {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn intervals_read_with_sensible_digits() {
        assert_eq!(range(Some([0.012, 0.04]), 100.0, 2), "1.20 to 4.00");
        assert_eq!(range(Some([180.4, 251.0]), 1.0, 0), "180 to 251");
        assert_eq!(range(None, 1.0, 0), "");
    }
}
