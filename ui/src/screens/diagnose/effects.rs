//! The named effects: a sentence each, whether to add it, and the evidence one click away.

use egui::{RichText, accesskit::Role};
use palpate_reports::{DiagnosisReport, NamedEffect, wording};

use super::{DiagnoseState, Shown};
use crate::screens::ScreenContext;

/// True when the operator wants another run without one of them.
pub(super) fn effects_ui(
    ui: &mut egui::Ui,
    cx: &ScreenContext<'_>,
    state: &mut DiagnoseState,
    report: &DiagnosisReport,
) -> bool {
    let mut left_out = None;
    let is_weak = |idx: &usize| weak(report).any(|weak| weak == *idx);
    let (strong, weak): (Vec<usize>, Vec<usize>) = (0..report.effects.len()).partition(|idx| !is_weak(idx));
    let first_weak = weak.first().copied();
    for (idx, effect) in
        strong.into_iter().chain(weak).filter_map(|idx| Some((idx, report.effects.get(idx)?)))
    {
        if first_weak == Some(idx) {
            ui.add_space(8.0);
            ui.label(RichText::new("Weak, not ticked").strong());
            let about = "They do not lower the gap on the takes kept for judging, or help in half of the takes at most.";
            ui.label(RichText::new(about).color(cx.palette.text_weak));
        }
        ui.add_space(4.0);
        egui::Frame::group(ui.style()).fill(cx.palette.surface).show(ui, |ui| {
            ui.set_width(ui.available_width());
            if effect_ui(ui, cx, state, report, idx, effect) {
                left_out = Some(effect.id.clone());
            }
        });
    }
    let again = left_out.is_some();
    state.without.extend(left_out);
    again
}

/// Effects that help too little to be ticked without a look, by position: those that do not lower the gap on the takes
/// kept for judging, and those that lower the mismatch in half of the takes at most.
pub(super) fn weak(report: &DiagnosisReport) -> impl Iterator<Item = usize> {
    report.effects.iter().enumerate().filter(|(_, effect)| !helps(effect)).map(|(idx, _)| idx)
}

fn helps(effect: &NamedEffect) -> bool {
    let counts = effect.takes_improved.split_once('/');
    let counts =
        counts.and_then(|(improved, all)| Some((improved.parse::<u64>().ok()?, all.parse::<u64>().ok()?)));
    effect.gap_after < effect.gap_before && counts.is_none_or(|(improved, all)| 2 * improved > all)
}

/// Room for what can be done with an effect, which stands beside its sentence where both have room.
const ACTIONS_WIDTH: f32 = 400.0;
const SENTENCE_WIDTH: f32 = 720.0;
/// Room for the evidence with names beside values; they stand above them where there is less.
const EVIDENCE_WIDTH: f32 = 480.0;

fn effect_ui(
    ui: &mut egui::Ui,
    cx: &ScreenContext<'_>,
    state: &mut DiagnoseState,
    report: &DiagnosisReport,
    idx: usize,
    effect: &NamedEffect,
) -> bool {
    let shown = &mut state.shown;
    let width = ui.available_width() - ACTIONS_WIDTH;
    let again = if width >= SENTENCE_WIDTH {
        ui.horizontal(|ui| {
            let down = egui::Layout::top_down(egui::Align::LEFT);
            let row = egui::vec2(width, ui.spacing().interact_size.y);
            ui.allocate_ui_with_layout(row, down, |ui| {
                ui.set_width(width);
                // A single line stands in the middle of the row.
                ui.add_space(0.5 * (row.y - ui.text_style_height(&egui::TextStyle::Body)));
                sentence_ui(ui, cx, report, effect);
            });
            actions_ui(ui, shown, idx, effect)
        })
    } else {
        sentence_ui(ui, cx, report, effect);
        ui.horizontal_wrapped(|ui| actions_ui(ui, shown, idx, effect))
    };
    if shown.open.contains(&idx) {
        evidence_ui(ui, cx, report, idx, effect);
    }
    again.inner
}

fn sentence_ui(ui: &mut egui::Ui, cx: &ScreenContext<'_>, report: &DiagnosisReport, effect: &NamedEffect) {
    let sentence = wording::effect_sentences(effect, report);
    let response = ui.label(RichText::new(&sentence).size(15.5));
    response.widget_info(|| egui::WidgetInfo::labeled(Role::Label, true, &sentence));
    if let Some(rivals) = wording::rivals_sentence(effect) {
        let next = report.next_experiment.as_ref().filter(|next| next.separates.contains(&effect.id));
        let next = next.map_or_else(String::new, |next| format!(" {}", next.sentence));
        ui.colored_label(cx.palette.warning, format!("\u{26a0} {rivals}{next}"));
    }
}

/// True when the operator wants another run without it.
fn actions_ui(ui: &mut egui::Ui, shown: &mut Shown, idx: usize, effect: &NamedEffect) -> bool {
    let mut ticked = !shown.unticked.contains(&idx);
    let name = wording::effect_at(&effect.id, &effect.place);
    let tick = ui.checkbox(&mut ticked, "Add it");
    tick.widget_info(|| egui::WidgetInfo::selected(Role::CheckBox, true, ticked, format!("Add {name}")));
    if tick.changed() {
        if ticked {
            shown.unticked.remove(&idx);
        } else {
            shown.unticked.insert(idx);
        }
    }
    let open = shown.open.contains(&idx);
    let button = ui.selectable_label(open, if open { "Hide the evidence" } else { "Evidence" });
    button
        .widget_info(|| egui::WidgetInfo::selected(Role::Button, true, open, format!("Evidence for {name}")));
    if button.clicked() && !shown.open.remove(&idx) {
        shown.open.insert(idx);
    }
    let leave = ui.button("Run again without it").on_hover_text(
        "Leaves this effect out of the library and diagnoses again: what else could explain the data?",
    );
    leave.widget_info(|| {
        let name = format!("Run again without {}", wording::words(&effect.id));
        egui::WidgetInfo::labeled(Role::Button, true, name)
    });
    leave.clicked()
}

fn evidence_ui(
    ui: &mut egui::Ui,
    cx: &ScreenContext<'_>,
    report: &DiagnosisReport,
    idx: usize,
    effect: &NamedEffect,
) {
    let mut rows = vec![("Effect".to_owned(), wording::effect_at(&effect.id, &effect.place))];
    for (name, &value) in &effect.parameters {
        let interval = effect.interval.get(name).map_or_else(String::new, |&interval| {
            format!(" (95 % interval {})", wording::range(name, interval))
        });
        rows.push((wording::parameter_name(name), format!("{}{interval}", wording::quantity(name, value))));
    }
    rows.push((
        "Evidence".to_owned(),
        format!(
            "{}, the bar is {} ({})",
            wording::number(effect.evidence),
            wording::number(report.bar.evidence),
            wording::chance(effect.p_value)
        ),
    ));
    if let Some((improved, all)) = effect.takes_improved.split_once('/') {
        rows.push(("Takes that it improves".to_owned(), format!("{improved} of {all}")));
    }
    rows.push((
        "Gap on the judging takes".to_owned(),
        format!("{} to {}", wording::number(effect.gap_before), wording::number(effect.gap_after)),
    ));
    for rival in &effect.rivals {
        let name = wording::effect_at(&rival.id, &rival.place);
        rows.push(("Instead of it".to_owned(), format!("{name}: gap {}", wording::number(rival.gap_after))));
    }
    let weak = |name: String| RichText::new(name).color(cx.palette.text_weak);
    let width = ui.available_width();
    if width < EVIDENCE_WIDTH {
        for (name, value) in rows {
            ui.label(weak(name));
            ui.label(value);
        }
        return;
    }
    // Cells of a grid wrap where they have a width.
    let grid = egui::Grid::new(("evidence", idx)).num_columns(2).min_row_height(20.0);
    grid.spacing([20.0, 4.0]).max_col_width(width - 200.0).show(ui, |ui| {
        for (name, value) in rows {
            ui.label(weak(name));
            ui.label(value);
            ui.end_row();
        }
    });
}
