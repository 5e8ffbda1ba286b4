//! What is left, what to record next, and the figures behind it all.

use egui::RichText;
use palpate_reports::{
    Cell, DiagnosisReport, Metrics, NextExperiment, Purpose, Verdict,
    wording::{self, counted},
};
use palpate_wire::api::{RecordingDocument, StepState, WantedTake};

use super::Start;
use crate::{
    route::Screen,
    screens::{ScreenContext, as_sentence, channel_label, words},
    store::Loadable,
};

/// A part whose p-value is not below this is within chance.
const SIGNIFICANT: f64 = 0.05;

/// Parts of the data of `session`, a line each.
pub(super) fn cells_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, cells: &[Cell], session: &str) {
    let station = cx.store.station(session);
    let label = |id: &String| channel_label(station.ready().map(AsRef::as_ref), id);
    for cell in cells {
        let cell = Cell { channels: cell.channels.iter().map(label).collect(), ..cell.clone() };
        ui.horizontal_wrapped(|ui| {
            ui.label(RichText::new(wording::percent(cell.excess)).strong());
            ui.label(wording::cell(&cell));
            let odds = format!(
                "effect size {}, {}",
                wording::number(cell.effect_size),
                wording::p_value(cell.p_value)
            );
            ui.label(RichText::new(odds).color(cx.palette.text_weak));
        });
    }
}

pub(super) fn unexplained_ui(
    ui: &mut egui::Ui,
    cx: &mut ScreenContext<'_>,
    report: &DiagnosisReport,
    session: &str,
) {
    let left = &report.unexplained;
    let share = wording::percent(left.fraction);
    let text = match (left.significant, report.verdict) {
        (true, _) => format!(
            "{share} of the calibrated model's excess is left, and it repeats between repetitions more than chance \
             would: something is missing that the library does not hold, or that these takes do not show."
        ),
        (false, Verdict::NoDiscrepancy) => "Nothing beyond noise.".to_owned(),
        (false, Verdict::CannotBeJudged) => format!(
            "{share} of the calibrated model's excess is left; no motion is repeated, by which to tell whether it would \
             repeat."
        ),
        (false, _) => format!(
            "{share} of the calibrated model's excess is left; it does not repeat, as noise does not."
        ),
    };
    let colour = if left.significant { cx.palette.warning } else { cx.palette.real };
    ui.colored_label(colour, text);
    for because in &left.because {
        ui.label(as_sentence(&because.sentence));
    }
    if let Some(sentence) = wording::touch_to_touch_sentence(left) {
        ui.label(RichText::new(sentence).color(cx.palette.text_weak));
    }
    // What chance gives as well is nothing to look at.
    let (beyond, within): (Vec<Cell>, Vec<Cell>) =
        left.cells.iter().cloned().partition(|cell| cell.p_value < SIGNIFICANT);
    cells_ui(ui, cx, &beyond, session);
    if !within.is_empty() {
        let text = format!("{} within chance left out.", counted(within.len() as u64, "part"));
        ui.label(RichText::new(text).color(cx.palette.text_weak));
    }
}

pub(super) fn next_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, report: &DiagnosisReport) {
    let Some(next) = &report.next_experiment else {
        ui.label("Nothing that would tell more about what was named.");
        return;
    };
    ui.label(RichText::new(&next.sentence).size(15.5));
    let motion = format!("{} on {}", words(&next.primitive), words(&next.object));
    let gain = wording::number(next.expected_gain);
    let about = match next.purpose {
        Purpose::Separate => {
            let ids: Vec<String> = next.separates.iter().map(|id| words(id)).collect();
            format!(
                "It tells {} apart by {gain} standard deviations of the noise: {motion}.",
                ids.join(" and ")
            )
        }
        Purpose::Repeat => {
            format!("It makes something repeat, by which to tell what is left from noise: {motion}.")
        }
        Purpose::ShowMore => {
            format!(
                "It shows most of what has no name, {gain} standard deviations of the noise a repetition: {motion}."
            )
        }
    };
    ui.label(RichText::new(about).color(cx.palette.text_weak));
    ui.horizontal_wrapped(|ui| {
        if ui.button("Copy the sentence").clicked() {
            ui.ctx().copy_text(next.sentence.clone());
        }
        // Experiments without an object are none that this page's stations record.
        if !next.object.is_empty() {
            record_next_ui(ui, cx, next);
        }
    });
    if let Some(problem) = &cx.store.wanted_problem {
        ui.colored_label(cx.palette.mismatch, format!("\u{26a0} The list was not changed: {problem}"));
    }
}

/// Puts the experiment on the list of what is recorded next, or says where on the list it is and takes it off again.
fn record_next_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, next: &NextExperiment) {
    let document = if cx.store.is_commandable() { cx.store.recording() } else { Loadable::Idle };
    let Some(document) = document.ready() else {
        let why = match &document {
            Loadable::Failed(error) => format!("The checklist did not arrive: {error}"),
            Loadable::Loading => "Reading the checklist\u{2026}".to_owned(),
            _ => "No station is live: start `palpate serve --station FILE` where its devices are, or record it with your \
                  own tools and import it."
                .to_owned(),
        };
        ui.add_enabled(false, egui::Button::new("Record this next")).on_disabled_hover_text(&why);
        ui.label(RichText::new(why).color(cx.palette.text_weak));
        return;
    };
    let ready = !cx.store.wanted_busy;
    let Some(place) = place_on_list(document, next) else {
        let button = egui::Button::new(RichText::new("Record this next").strong());
        let hint = match &document.session {
            Some(session) => format!("Puts it at the end of the checklist of session {}", session.session),
            None => "Puts it on the list of the station: the next session that is recorded ends with it"
                .to_owned(),
        };
        if ui.add_enabled(ready, button).on_hover_text(hint).clicked() {
            cx.store.want(WantedTake {
                object: next.object.clone(),
                primitive: next.primitive.clone(),
                because: next.sentence.clone(),
            });
        }
        return;
    };
    ui.label(RichText::new(format!("\u{2714} {place}")).strong());
    if ui.add_enabled(ready, egui::Button::new("Undo")).on_hover_text("Takes it off the list again").clicked()
    {
        cx.store.unwant(&next.object, &next.primitive);
    }
    if ui.button("Go to Record").clicked() {
        cx.go_to_screen(Screen::Record);
    }
}

/// Where on the list of what is recorded next the experiment is, in words; `None` if it is not.
fn place_on_list(document: &RecordingDocument, next: &NextExperiment) -> Option<String> {
    let same = |object: &str, primitive: &str| object == next.object && primitive == next.primitive;
    if document.wanted.iter().any(|wanted| same(&wanted.object, &wanted.primitive)) {
        return Some("On the list: the next session that is recorded has it.".to_owned());
    }
    let session = document.session.as_ref()?;
    let step = session.steps.iter().position(|step| {
        step.added_because.is_some() && step.state == StepState::Open && same(&step.object, &step.primitive)
    })?;
    Some(format!("Take {} of session {} records it.", step + 1, session.session))
}

/// Room for a row of the metrics; where there is less, the name of each stands above its numbers.
const TABLE_WIDTH: f32 = 560.0;

/// Event metrics on confirm takes, and which takes did what.
pub(super) fn metrics_ui(ui: &mut egui::Ui, cx: &ScreenContext<'_>, report: &DiagnosisReport, start: &Start) {
    let columns = [
        ("nominal", start.title(), start.colour(&cx.palette)),
        ("calibrated", "Calibrated".to_owned(), cx.palette.calibrated),
        ("diagnosed", "Diagnosed".to_owned(), cx.palette.diagnosed),
    ];
    type Value = fn(&Metrics) -> Option<f64>;
    let rows: [(&str, Value, f64, usize); 5] = [
        ("Onset error, ms", |m| m.onset_error_ms, 1.0, 0),
        ("Offset error, ms", |m| m.offset_error_ms, 1.0, 0),
        ("Activation F1", |m| m.f1, 1.0, 3),
        ("False positive rate, %", |m| m.fpr, 100.0, 2),
        ("Real contacts with a partner, %", |m| m.onset_coverage, 100.0, 0),
    ];
    let text = |key: &str, value: Value, factor: f64, digits: usize| {
        let value = report.metrics.get(key).and_then(value);
        value.map_or_else(|| "\u{2013}".to_owned(), |value| format!("{:.digits$}", value * factor))
    };
    let head = |ui: &mut egui::Ui, name: &str, colour| {
        ui.label(RichText::new(name).color(cx.palette.text_of(colour)).strong());
    };
    if !report.metrics.is_empty() && ui.available_width() < TABLE_WIDTH {
        ui.columns(columns.len(), |uis| {
            for (ui, (_, name, colour)) in uis.iter_mut().zip(&columns) {
                head(ui, name, *colour);
            }
        });
        for (name, value, factor, digits) in rows {
            ui.label(RichText::new(name).color(cx.palette.text_weak));
            ui.columns(columns.len(), |uis| {
                for (ui, (key, ..)) in uis.iter_mut().zip(&columns) {
                    ui.label(text(key, value, factor, digits));
                }
            });
        }
    } else if !report.metrics.is_empty() {
        let grid = egui::Grid::new("diagnose_metrics").striped(true).min_row_height(22.0);
        grid.spacing([28.0, 6.0]).show(ui, |ui| {
            ui.label("");
            for (_, name, colour) in &columns {
                head(ui, name, *colour);
            }
            ui.end_row();
            for (name, value, factor, digits) in rows {
                ui.label(name);
                for (key, ..) in &columns {
                    ui.label(text(key, value, factor, digits));
                }
                ui.end_row();
            }
        });
    }
    for (part, about) in [("fit", "fitted on"), ("confirm", "judged on, opened once")] {
        if let Some(takes) = report.takes.get(part).filter(|takes| !takes.is_empty()) {
            ui.label(RichText::new(format!("{about}: {}", takes.join(", "))).color(cx.palette.text_weak));
        }
    }
}
