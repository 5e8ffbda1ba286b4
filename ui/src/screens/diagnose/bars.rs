//! Two pictures in rows of bars: the gap step by step, and the evidence for what was tried against the bar.

use egui::{Align2, Color32, FontId, Rect, Sense, Stroke, Ui, accesskit::Role, pos2, vec2};
use palpate_reports::{DiagnosisReport, WaterfallStep, wording};
use palpate_robot_model::Place;

use super::Start;
use crate::theme::Palette;

const NAME_WIDTH: f32 = 290.0;
const NUMBER_WIDTH: f32 = 132.0;
const ROW_HEIGHT: f32 = 26.0;
/// Candidates shown until the operator wants them all.
const FEW: usize = 8;

/// A row with a bar from zero.
struct Bar<'a> {
    name: &'a str,
    /// What it says, for those who do not see it.
    about: String,
    value: f64,
    interval: Option<[f64; 2]>,
    number: String,
    colour: Color32,
}

/// Draws `bars` on one scale that ends at `full`; `place` turns a value into its share of the width. Gives the rectangle
/// of the plot.
fn bars_ui(ui: &mut Ui, palette: &Palette, bars: &[Bar<'_>], place: impl Fn(f64) -> f32) -> Rect {
    ui.scope(|ui| rows_ui(ui, palette, bars, place)).inner
}

fn rows_ui(ui: &mut Ui, palette: &Palette, bars: &[Bar<'_>], place: impl Fn(f64) -> f32) -> Rect {
    ui.spacing_mut().item_spacing.y = 0.0;
    let width = (ui.available_width() - 12.0).max(NAME_WIDTH + NUMBER_WIDTH + 80.0);
    let mut plot = Rect::NOTHING;
    for bar in bars {
        let (row, response) = ui.allocate_exact_size(vec2(width, ROW_HEIGHT), Sense::hover());
        response.widget_info(|| egui::WidgetInfo::labeled(Role::Image, true, &bar.about));
        let area = Rect::from_x_y_ranges(row.left() + NAME_WIDTH..=row.right() - NUMBER_WIDTH, row.y_range());
        plot = if plot.is_positive() { plot.union(area) } else { area };
        if !ui.is_rect_visible(row) {
            continue;
        }
        let font = FontId::proportional(14.0);
        let names = Rect::from_min_max(row.min, pos2(area.left() - 8.0, row.bottom()));
        let clipped = ui.painter().with_clip_rect(names.intersect(ui.clip_rect()));
        clipped.text(names.left_center(), Align2::LEFT_CENTER, bar.name, font.clone(), palette.real);
        let painter = ui.painter();
        painter.rect_filled(area.shrink2(vec2(0.0, 2.0)), 0.0, palette.surface);
        let x_of = |value: f64| egui::lerp(area.x_range(), place(value).clamp(0.0, 1.0));
        let filled =
            Rect::from_x_y_ranges(area.left()..=x_of(bar.value).max(area.left() + 1.5), row.y_range());
        painter.rect_filled(filled.shrink2(vec2(0.0, 5.0)), 1.0, bar.colour);
        if let Some([low, high]) = bar.interval {
            let (y, stroke) = (row.center().y, Stroke::new(1.5, palette.real));
            painter.hline(x_of(low)..=x_of(high), y, stroke);
            for x in [x_of(low), x_of(high)] {
                painter.vline(x, y - 4.0..=y + 4.0, stroke);
            }
        }
        let at = pos2(area.right() + 10.0, row.center().y);
        painter.text(at, Align2::LEFT_CENTER, &bar.number, font, palette.real);
        response.on_hover_text(&bar.about);
    }
    plot
}

/// The gap on confirm takes: nominal, calibrated, then one more effect each.
pub(super) fn waterfall_ui(ui: &mut Ui, palette: &Palette, report: &DiagnosisReport, start: &Start) {
    if report.waterfall.is_empty() {
        ui.label("This report holds no steps.");
        return;
    }
    let calibrated = report.waterfall.iter().find(|step| step.step == "calibrated").map(|step| step.gap);
    let name = |(idx, step): (usize, &WaterfallStep)| match step.step.as_str() {
        "nominal" => start.title(),
        _ => wording::step_name(report, idx),
    };
    let names: Vec<String> = report.waterfall.iter().enumerate().map(name).collect();
    let bars: Vec<Bar<'_>> = report
        .waterfall
        .iter()
        .zip(&names)
        .map(|(step, name)| {
            let colour = match step.step.as_str() {
                "nominal" => start.colour(palette),
                "calibrated" => palette.calibrated,
                _ => palette.diagnosed,
            };
            let is_effect = !matches!(step.step.as_str(), "nominal" | "calibrated");
            let change =
                calibrated.filter(|&whole| is_effect && whole > 0.0).map_or_else(String::new, |whole| {
                    format!("  ({:+.0} %)", (step.gap / whole - 1.0) * 100.0).replace('-', "\u{2212}")
                });
            let interval = step.interval_95.map_or_else(String::new, |[low, high]| {
                format!(", 95 % interval {} to {}", wording::number(low), wording::number(high))
            });
            let number = format!("{}{change}", wording::number(step.gap));
            Bar {
                name,
                about: format!("{name}: gap {number}{interval}"),
                value: step.gap,
                interval: step.interval_95,
                number,
                colour,
            }
        })
        .collect();
    let reach = |bar: &Bar<'_>| bar.interval.map_or(bar.value, |[_, high]| high.max(bar.value));
    let full = bars.iter().map(reach).fold(f64::MIN_POSITIVE, f64::max) * 1.02;
    let place = |value: f64| (value / full) as f32;
    let plot = bars_ui(ui, palette, &bars, place);
    let floor = report.held_out.noise_floor.filter(|floor| *floor <= full);
    if let Some(floor) = floor {
        let x = egui::lerp(plot.x_range(), place(floor));
        let line = [pos2(x, plot.top()), pos2(x, plot.bottom())];
        ui.painter().extend(egui::Shape::dashed_line(&line, Stroke::new(1.5, palette.text_weak), 4.0, 3.0));
    }
    ui.add_space(4.0);
    let floor = if floor.is_some() { " Dashed: what repetitions of one motion differ by." } else { "" };
    weak(
        ui,
        palette,
        &format!(
            "Mismatch a channel-second on the judging takes, with 95 % intervals over repetitions.{floor}"
        ),
    );
}

/// Evidence for what was named and what was tried, against the bar.
pub(super) fn evidence_ui(ui: &mut Ui, palette: &Palette, report: &DiagnosisReport, all: &mut bool) {
    let named = report.effects.iter().map(|effect| {
        (wording::effect_at(&effect.id, &effect.place), effect.evidence, None, palette.diagnosed)
    });
    let is_named =
        |id: &str, place: &Place| report.effects.iter().any(|named| named.id == id && named.place == *place);
    let tried = report.candidates.iter().filter(|tried| !is_named(&tried.id, &tried.place)).map(|tried| {
        let name = wording::effect_at(&tried.id, &tried.place);
        (name, tried.evidence, Some(tried.share_removed), palette.dead)
    });
    let mut rows: Vec<(String, f64, Option<f64>, Color32)> = named.chain(tried).collect();
    rows.sort_by(|a, b| b.1.total_cmp(&a.1));
    let num_rows = rows.len();
    if !*all {
        rows.truncate(FEW.max(report.effects.len()));
    }
    if rows.is_empty() {
        ui.label("Nothing was tried: every effect was left out, or the takes hold no touch.");
        return;
    }
    let bar = report.bar.evidence;
    let bars: Vec<Bar<'_>> = rows
        .iter()
        .map(|(name, evidence, share, colour)| {
            let above = if *evidence >= bar { "above" } else { "below" };
            let share = share.map_or_else(
                || ", named".to_owned(),
                |share| format!(", removes {} to first order", wording::percent(share)),
            );
            Bar {
                name,
                about: format!(
                    "{name}: evidence {}, {above} the bar of {}{share}",
                    wording::number(*evidence),
                    wording::number(bar)
                ),
                value: *evidence,
                interval: None,
                number: format!(
                    "{}{}",
                    wording::number(*evidence),
                    if share == ", named" { "  named" } else { "" }
                ),
                colour: *colour,
            }
        })
        .collect();
    let highest = bars.iter().map(|bar| bar.value).chain([bar, 1.0]).fold(0.0, f64::max);
    // Evidence is a square: its root spreads the candidates near the bar over the picture.
    let place = |value: f64| (value.max(0.0) / (highest * 1.05)).sqrt() as f32;
    let plot = bars_ui(ui, palette, &bars, place);
    let x_of = |value: f64| egui::lerp(plot.x_range(), place(value).clamp(0.0, 1.0));
    let painter = ui.painter();
    painter.vline(x_of(bar), plot.y_range(), Stroke::new(2.0, palette.mismatch));
    // What chance gave, session by session.
    for &chance in &report.bar.null_maxima {
        let y = plot.bottom();
        painter.vline(x_of(chance), y..=y + 7.0, Stroke::new(1.0, palette.text_weak));
    }
    let font = FontId::proportional(13.0);
    let (x, right) = (x_of(bar), x_of(bar) > plot.center().x);
    let (align, offset) = if right { (Align2::RIGHT_TOP, -5.0) } else { (Align2::LEFT_TOP, 5.0) };
    let text = format!("the bar, {}", wording::number(bar));
    painter.text(pos2(x + offset, plot.bottom() + 8.0), align, text, font, palette.mismatch);
    ui.add_space(26.0);
    let sessions = report.bar.null_sessions;
    let source = if sessions == 0 {
        "The bar is the shipped default: tick \u{201c}Set the bar\u{201d} on the left to set it for this station."
            .to_owned()
    } else {
        format!(
            "The bar comes from {sessions} simulated sessions with nothing missing; a tick is the most that chance gave in one."
        )
    };
    weak(ui, palette, &source);
    if num_rows > FEW {
        let text = if *all { "Show fewer".to_owned() } else { format!("Show all {num_rows}") };
        if ui.button(text).clicked() {
            *all = !*all;
        }
    }
}

fn weak(ui: &mut Ui, palette: &Palette, text: &str) {
    ui.label(egui::RichText::new(text).color(palette.text_weak).size(13.5));
}
