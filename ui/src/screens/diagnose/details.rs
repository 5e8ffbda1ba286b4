//! What is left, what to record next, and the figures behind it all.

use egui::RichText;
use palpate_wire::{
    api::{Cell, DiagnosisReport, Metrics, Verdict},
    wording,
};

use crate::screens::{ScreenContext, words};

/// Parts of the data, a line each.
pub(super) fn cells_ui(ui: &mut egui::Ui, cx: &ScreenContext<'_>, cells: &[Cell]) {
    for cell in cells {
        ui.horizontal_wrapped(|ui| {
            ui.label(RichText::new(wording::percent(cell.excess)).strong());
            ui.label(wording::cell(cell));
            let odds = format!(
                "effect size {}, {}",
                wording::number(cell.effect_size),
                wording::p_value(cell.p_value)
            );
            ui.label(RichText::new(odds).color(cx.palette.text_weak));
        });
    }
}

pub(super) fn unexplained_ui(ui: &mut egui::Ui, cx: &ScreenContext<'_>, report: &DiagnosisReport) {
    let left = &report.unexplained;
    let share = wording::percent(left.fraction);
    let text = match (left.significant, report.verdict) {
        (true, _) => format!(
            "{share} of the calibrated model's excess is left, and it repeats between repetitions more than chance \
             would: something is missing that the library does not hold, or that these takes do not show."
        ),
        (false, Verdict::NoDiscrepancy) => "Nothing beyond noise.".to_owned(),
        (false, _) => format!(
            "{share} of the calibrated model's excess is left; it does not repeat, as noise does not."
        ),
    };
    let colour = if left.significant { cx.palette.warning } else { cx.palette.real };
    ui.colored_label(colour, text);
    cells_ui(ui, cx, &left.cells);
}

pub(super) fn next_ui(ui: &mut egui::Ui, cx: &ScreenContext<'_>, report: &DiagnosisReport) {
    let Some(next) = &report.next_experiment else {
        ui.label("Nothing that would tell more about what was named.");
        return;
    };
    ui.label(RichText::new(&next.sentence).size(15.5));
    let ids: Vec<String> = next.separates.iter().map(|id| words(id)).collect();
    let about = format!(
        "It tells {} apart by {} standard deviations of the noise: {} on {}.",
        ids.join(" and "),
        wording::number(next.expected_gain),
        words(&next.primitive),
        words(&next.object)
    );
    ui.label(RichText::new(about).color(cx.palette.text_weak));
    ui.horizontal_wrapped(|ui| {
        if ui.button("Copy the sentence").clicked() {
            ui.ctx().copy_text(next.sentence.clone());
        }
        ui.label(
            RichText::new("This page does not record yet: record it with your own tools, then import it.")
                .color(cx.palette.text_weak),
        );
    });
}

/// Event metrics on confirm takes, and which takes did what.
pub(super) fn metrics_ui(ui: &mut egui::Ui, cx: &ScreenContext<'_>, report: &DiagnosisReport) {
    let columns = [
        ("nominal", "Nominal", cx.palette.nominal),
        ("calibrated", "Calibrated", cx.palette.calibrated),
        ("diagnosed", "Diagnosed", cx.palette.diagnosed),
    ];
    type Value = fn(&Metrics) -> Option<f64>;
    let rows: [(&str, Value, f64, usize); 5] = [
        ("Onset error, ms", |m| m.onset_error_ms, 1.0, 0),
        ("Offset error, ms", |m| m.offset_error_ms, 1.0, 0),
        ("Activation F1", |m| m.f1, 1.0, 3),
        ("False positive rate, %", |m| m.fpr, 100.0, 2),
        ("Real contacts with a partner, %", |m| m.onset_coverage, 100.0, 0),
    ];
    if !report.metrics.is_empty() {
        egui::Grid::new("diagnose_metrics").striped(true).min_row_height(22.0).spacing([28.0, 6.0]).show(
            ui,
            |ui| {
                ui.label("");
                for (_, name, colour) in columns {
                    ui.label(RichText::new(name).color(colour).strong());
                }
                ui.end_row();
                for (name, value, factor, digits) in rows {
                    ui.label(name);
                    for (key, ..) in columns {
                        let value = report.metrics.get(key).and_then(value);
                        ui.label(value.map_or_else(
                            || "\u{2013}".to_owned(),
                            |value| format!("{:.digits$}", value * factor),
                        ));
                    }
                    ui.end_row();
                }
            },
        );
    }
    for (part, about) in [
        ("fit", "fitted on"),
        ("select", "chosen among candidates on"),
        ("confirm", "judged on, opened once"),
    ] {
        if let Some(takes) = report.takes.get(part).filter(|takes| !takes.is_empty()) {
            ui.label(RichText::new(format!("{about}: {}", takes.join(", "))).color(cx.palette.text_weak));
        }
    }
}
