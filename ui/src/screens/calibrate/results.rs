//! What a finished run found: one sentence, the picture, the numbers, and what to do with it.

use egui::RichText;
use palpate_wire::api::{CalibrationReport, CalibrationRun, Intervals, Metrics};

use super::{CalibrateState, objective, tables};
use crate::{route::Screen, screens::ScreenContext, store::Loadable};

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
        ui.heading("3  See");
        let headline = headline(report);
        let response = ui.label(RichText::new(&headline).size(17.0).strong());
        response.widget_info(|| egui::WidgetInfo::labeled(egui::accesskit::Role::Label, true, &headline));
        for note in &report.notes {
            ui.colored_label(cx.palette.warning, format!("\u{26a0} {note}"));
        }
        ui.add_space(6.0);
        objective::objective_ui(ui, &cx.palette, report);
        ui.add_space(10.0);
        metrics_ui(ui, cx, report);
        ui.add_space(10.0);
        tables::tables_ui(ui, cx, &mut state.table, &run.request.session, report);
        ui.add_space(12.0);
    });
}

/// One sentence: what changed on takes that the fit has not seen.
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
    format!("Calibrated: {} on takes it has not seen.", parts.join(", "))
}

/// A metric as people read it.
struct Row {
    name: &'static str,
    value: fn(&Metrics) -> Option<f64>,
    intervals: fn(&Intervals) -> [Option<[f64; 2]>; 2],
    factor: f64,
    digits: usize,
}

fn metrics_ui(ui: &mut egui::Ui, cx: &ScreenContext<'_>, report: &CalibrationReport) {
    let rows = [
        Row {
            name: "Onset error, ms",
            value: |m| m.onset_error_ms,
            intervals: |i| [i.nominal.onset_error_ms, i.calibrated.onset_error_ms],
            factor: 1.0,
            digits: 0,
        },
        Row {
            name: "Offset error, ms",
            value: |m| m.offset_error_ms,
            intervals: |i| [i.nominal.offset_error_ms, i.calibrated.offset_error_ms],
            factor: 1.0,
            digits: 0,
        },
        Row {
            name: "Activation F1",
            value: |m| m.f1,
            intervals: |i| [i.nominal.f1, i.calibrated.f1],
            factor: 1.0,
            digits: 3,
        },
        Row {
            name: "False positive rate, %",
            value: |m| m.fpr,
            intervals: |i| [i.nominal.fpr, i.calibrated.fpr],
            factor: 100.0,
            digits: 2,
        },
    ];
    let held = report.held_out_takes.join(", ");
    ui.label(RichText::new(format!("On the held-out takes ({held})")).color(cx.palette.text_weak));
    egui::Grid::new("calibrate_metrics").striped(true).min_row_height(22.0).spacing([28.0, 6.0]).show(
        ui,
        |ui| {
            ui.label("");
            ui.label(RichText::new("Nominal").color(cx.palette.nominal).strong());
            ui.label(RichText::new("95 % interval").color(cx.palette.text_weak));
            ui.label(RichText::new("Calibrated").color(cx.palette.calibrated).strong());
            ui.label(RichText::new("95 % interval").color(cx.palette.text_weak));
            ui.end_row();
            for Row { name, value, intervals, factor, digits } in rows {
                let [before, after] = report.intervals_95.as_ref().map_or([None; 2], intervals);
                let text = |metrics: &Metrics| tables::number(value(metrics), factor, digits);
                ui.label(name);
                ui.label(text(&report.held_out.nominal));
                ui.label(RichText::new(range(before, factor, digits)).color(cx.palette.text_weak));
                ui.label(RichText::new(text(&report.held_out.calibrated)).strong());
                ui.label(RichText::new(range(after, factor, digits)).color(cx.palette.text_weak));
                ui.end_row();
            }
            ui.label("Real contacts with a partner, %");
            ui.label(tables::number(report.held_out.nominal.onset_coverage, 100.0, 0));
            ui.label("");
            ui.label(tables::number(report.held_out.calibrated.onset_coverage, 100.0, 0));
            ui.end_row();
        },
    );
}

fn range(interval: Option<[f64; 2]>, factor: f64, digits: usize) -> String {
    let Some([low, high]) = interval else { return String::new() };
    format!("{:.digits$} to {:.digits$}", low * factor, high * factor)
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
        ui.heading("4  Keep");
        ui.label(format!(
            "\u{3bb}con {} mm, \u{3b1} {} /m, \u{3bb}pre {} kPa; searched in {:.0} ms",
            objective::number(theta.lambda_con_m * 1e3),
            objective::number(theta.alpha_per_m),
            objective::number(theta.lambda_pre_pa / 1e3),
            report.seconds * 1e3,
        ));
    });
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
