//! Two pictures in rows of bars: the gap step by step, and the evidence for what was tried against the bar.

use egui::{Align2, Color32, FontId, Rect, Sense, Stroke, Ui, accesskit::Role, pos2, vec2};
use palpate_reports::{DiagnosisReport, WaterfallStep, wording};
use palpate_robot_model::Place;

use super::Start;
use crate::{screens::as_sentence, theme::Palette};

const NAME_WIDTH: f32 = 290.0;
const NUMBER_WIDTH: f32 = 132.0;
const ROW_HEIGHT: f32 = 26.0;
const FONT_SIZE: f32 = 14.0;
/// A bar that is shorter than this between its name and its number stands below them.
const LEAST_PLOT_WIDTH: f32 = 120.0;
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

/// Where bars were drawn, from top to bottom: one rectangle where their names stand beside them, one for each where the
/// names stand above.
struct Plot(Vec<Rect>);

impl Plot {
    /// All of it.
    fn whole(&self) -> Rect {
        self.0.iter().fold(Rect::NOTHING, |whole, area| whole.union(*area))
    }
}

/// Draws `bars` on one scale; `place` turns a value into its share of the width.
fn bars_ui(ui: &mut Ui, palette: &Palette, bars: &[Bar<'_>], place: impl Fn(f64) -> f32) -> Plot {
    ui.scope(|ui| {
        ui.spacing_mut().item_spacing.y = 0.0;
        let width = ui.available_width() - 12.0;
        if width >= NAME_WIDTH + NUMBER_WIDTH + LEAST_PLOT_WIDTH {
            let areas = bars.iter().map(|bar| row_ui(ui, palette, bar, width, &place));
            Plot(vec![areas.fold(Rect::NOTHING, |whole, area| whole.union(area))])
        } else {
            Plot(bars.iter().map(|bar| narrow_row_ui(ui, palette, bar, width, &place)).collect())
        }
    })
    .inner
}

/// Name, bar and number beside one another.
fn row_ui(ui: &mut Ui, palette: &Palette, bar: &Bar<'_>, width: f32, place: impl Fn(f64) -> f32) -> Rect {
    let (row, response) = bar.allocate(ui, vec2(width, ROW_HEIGHT));
    let area = Rect::from_x_y_ranges(row.left() + NAME_WIDTH..=row.right() - NUMBER_WIDTH, row.y_range());
    if ui.is_rect_visible(row) {
        let font = FontId::proportional(FONT_SIZE);
        let names = Rect::from_min_max(row.min, pos2(area.left() - 8.0, row.bottom()));
        let clipped = ui.painter().with_clip_rect(names.intersect(ui.clip_rect()));
        clipped.text(names.left_center(), Align2::LEFT_CENTER, bar.name, font.clone(), palette.real);
        bar.paint(ui.painter(), palette, area, place);
        let at = pos2(area.right() + 10.0, row.center().y);
        ui.painter().text(at, Align2::LEFT_CENTER, &bar.number, font, palette.real);
        response.on_hover_text(&bar.about);
    }
    area
}

/// Name and number above the bar, the name on as many lines as it needs.
fn narrow_row_ui(
    ui: &mut Ui,
    palette: &Palette,
    bar: &Bar<'_>,
    width: f32,
    place: impl Fn(f64) -> f32,
) -> Rect {
    let font = FontId::proportional(FONT_SIZE);
    let number = ui.painter().layout_no_wrap(bar.number.clone(), font.clone(), palette.real);
    let name_width = width - number.size().x - 10.0;
    let name = ui.painter().layout(bar.name.to_owned(), font, palette.real, name_width);
    let text_height = name.size().y.max(number.size().y) + 2.0;
    let (row, response) = bar.allocate(ui, vec2(width, text_height + ROW_HEIGHT));
    let area = Rect::from_x_y_ranges(row.x_range(), row.top() + text_height..=row.bottom() - 4.0);
    if ui.is_rect_visible(row) {
        let painter = ui.painter();
        painter.galley(row.min, name, palette.real);
        painter.galley(pos2(row.right() - number.size().x, row.top()), number, palette.real);
        bar.paint(painter, palette, area, place);
        response.on_hover_text(&bar.about);
    }
    area
}

impl Bar<'_> {
    /// Room for its row, under the words that say it.
    fn allocate(&self, ui: &mut Ui, size: egui::Vec2) -> (Rect, egui::Response) {
        let (row, response) = ui.allocate_exact_size(size, Sense::hover());
        response.widget_info(|| egui::WidgetInfo::labeled(Role::Image, true, &self.about));
        (row, response)
    }

    /// The bar in `area`, and its interval.
    fn paint(&self, painter: &egui::Painter, palette: &Palette, area: Rect, place: impl Fn(f64) -> f32) {
        painter.rect_filled(area.shrink2(vec2(0.0, 2.0)), 0.0, palette.surface);
        let x_of = |value: f64| egui::lerp(area.x_range(), place(value).clamp(0.0, 1.0));
        let end = x_of(self.value).max(area.left() + 1.5);
        let filled = Rect::from_x_y_ranges(area.left()..=end, area.y_range());
        painter.rect_filled(filled.shrink2(vec2(0.0, 5.0)), 1.0, self.colour);
        if let Some([low, high]) = self.interval {
            let (y, stroke) = (area.center().y, Stroke::new(1.5, palette.real));
            painter.hline(x_of(low)..=x_of(high), y, stroke);
            for x in [x_of(low), x_of(high)] {
                painter.vline(x, y - 4.0..=y + 4.0, stroke);
            }
        }
    }
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
        _ => as_sentence(&wording::step_name(report, idx)),
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
        for area in &plot.0 {
            let x = egui::lerp(area.x_range(), place(floor));
            let line = [pos2(x, area.top()), pos2(x, area.bottom())];
            let stroke = Stroke::new(1.5, palette.text_weak);
            ui.painter().extend(egui::Shape::dashed_line(&line, stroke, 4.0, 3.0));
        }
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
    let whole = plot.whole();
    let x_of = |value: f64| egui::lerp(whole.x_range(), place(value).clamp(0.0, 1.0));
    let painter = ui.painter();
    for area in &plot.0 {
        painter.vline(x_of(bar), area.y_range(), Stroke::new(2.0, palette.mismatch));
    }
    // What chance gave, session by session.
    for &chance in &report.bar.null_maxima {
        let y = whole.bottom();
        painter.vline(x_of(chance), y..=y + 7.0, Stroke::new(1.0, palette.text_weak));
    }
    let font = FontId::proportional(13.0);
    let (x, right) = (x_of(bar), x_of(bar) > whole.center().x);
    let (align, offset) = if right { (Align2::RIGHT_TOP, -5.0) } else { (Align2::LEFT_TOP, 5.0) };
    let text = format!("the bar, {}", wording::number(bar));
    painter.text(pos2(x + offset, whole.bottom() + 8.0), align, text, font, palette.mismatch);
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
