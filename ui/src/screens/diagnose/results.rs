//! What a finished diagnosis says: the sentence, the picture, the names, what is left, what to do next.

use egui::{RichText, accesskit::Role};
use palpate_reports::{DiagnosisReport, Verdict, wording};
use palpate_wire::api::DiagnosisRun;

use super::{DiagnoseState, Start, bars, details, effects, keep, residual_map};
use crate::screens::{ScreenContext, controls::file_link_ui, heading_ui, help_ui};

/// True when the operator asks for another run with the choices as they are now.
pub(super) fn results_ui(
    ui: &mut egui::Ui,
    cx: &mut ScreenContext<'_>,
    state: &mut DiagnoseState,
    run: &DiagnosisRun,
    report: &DiagnosisReport,
    start: &Start,
) -> bool {
    // What can be done with the result stays in reach, however far one scrolls.
    egui::Panel::bottom("diagnose_keep").resizable(false).show(ui, |ui| {
        ui.add_space(4.0);
        keep::keep_ui(ui, cx, &mut state.shown, run, report);
        ui.add_space(4.0);
    });
    let mut again = false;
    egui::ScrollArea::vertical().id_salt(&run.id).auto_shrink(false).show(ui, |ui| {
        ui.add_space(4.0);
        lead_ui(ui, cx, report, start);
        section(ui, "The gap, step by step", "gap", |ui| {
            table_ui(ui, "CSV", "Download the gap", "waterfall.csv", run);
            table_ui(ui, "metrics (CSV)", "Download the metrics", "metrics.csv", run);
        });
        bars::waterfall_ui(ui, &cx.palette, report, start);
        if !report.effects.is_empty() {
            section(ui, "What is missing", "effect", |ui| {
                table_ui(ui, "CSV", "Download the effects", "effects.csv", run);
            });
            again = effects::effects_ui(ui, cx, state, report);
        }
        section(ui, "What was tried", "evidence", |_| ());
        bars::evidence_ui(ui, &cx.palette, report, &mut state.shown.all_candidates);
        section(ui, "Where simulation and hand disagree", "channel-second", |_| ());
        residual_map::residual_map_ui(ui, cx, &mut state.shown.residual_before, run, report);
        section(ui, "What stays unexplained", "null session", |_| ());
        details::unexplained_ui(ui, cx, report, &run.request.session);
        section(ui, "What to record next", "wanted take", |_| ());
        details::next_ui(ui, cx, report);
        section(ui, "How it was judged", "F1", |_| ());
        details::metrics_ui(ui, cx, report, start);
        ui.add_space(12.0);
    });
    again
}

/// A heading with help about the `word` that what is below it turns on, and `more` beside it.
fn section(ui: &mut egui::Ui, title: &str, word: &'static str, more: impl FnOnce(&mut egui::Ui)) {
    ui.add_space(14.0);
    ui.horizontal_wrapped(|ui| {
        heading_ui(ui, title);
        help_ui(ui, word);
        more(ui);
    });
}

/// A link to the numbers of `run` in `file`.
fn table_ui(ui: &mut egui::Ui, face: &str, label: &str, file: &str, run: &DiagnosisRun) {
    file_link_ui(ui, face, label, &format!("diagnoses/{{}}/tables/{file}"), &[&run.id]);
}

fn lead_ui(ui: &mut egui::Ui, cx: &ScreenContext<'_>, report: &DiagnosisReport, start: &Start) {
    ui.horizontal_wrapped(|ui| {
        heading_ui(ui, "3  See");
        let (word, colour) = match report.verdict {
            Verdict::Explained => ("EXPLAINED", cx.palette.diagnosed),
            Verdict::PartlyExplained => ("PARTLY EXPLAINED", cx.palette.warning),
            Verdict::Unexplained => ("UNEXPLAINED", cx.palette.mismatch),
            Verdict::NoDiscrepancy => ("NO DISCREPANCY", cx.palette.text_weak),
            Verdict::CannotBeJudged => ("CANNOT BE JUDGED", cx.palette.warning),
        };
        ui.label(RichText::new(word).strong().color(colour));
        let seconds = crate::screens::duration_text(report.seconds);
        ui.label(RichText::new(format!("in {seconds}")).color(cx.palette.text_weak));
    });
    let response = ui.label(RichText::new(&report.sentence).size(17.0).strong());
    response.widget_info(|| egui::WidgetInfo::labeled(Role::Label, true, &report.sentence));
    if report.effects.is_empty() {
        let text = match report.verdict {
            Verdict::Unexplained => {
                "Nothing was named: every effect that was tried stays below the bar, or does not account for what \
                 repeats. Where it is stands below; nothing is added to the model."
            }
            _ => "Nothing to add: no effect beats what chance gives on sessions with nothing missing.",
        };
        ui.label(RichText::new(text).color(cx.palette.text_weak));
    } else {
        let gap = &report.held_out;
        let floor = gap.noise_floor.map_or_else(String::new, |floor| {
            format!("; repetitions of one motion differ by {}", wording::number(floor))
        });
        let text = format!(
            "Gap on takes that nothing was fitted to: {} {}, calibrated {}, with the named effects {}{floor}.",
            start.word(),
            wording::number(gap.nominal),
            wording::number(gap.calibrated),
            wording::number(gap.diagnosed),
        );
        ui.label(RichText::new(text).color(cx.palette.text_weak));
    }
    for effect in &report.in_doubt {
        ui.colored_label(cx.palette.text_weak, wording::in_doubt_sentence(effect));
    }
    for note in &report.notes {
        ui.colored_label(cx.palette.warning, format!("\u{26a0} {note}"));
    }
}
