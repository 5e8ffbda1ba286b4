//! Lays a document out: headings, paragraphs with links in them, lists, code and tables, as wide as there is room.

use egui::{
    Align, FontFamily, FontId, Label, RichText, TextFormat, TextStyle, TextWrapMode, UiBuilder,
    accesskit::Role, text::LayoutJob,
};
use palpate_wire::markdown::Target;

use super::blocks::{Block, DOT, Look, Row, Span};
use crate::{screens::controls::name_button, theme::Palette};

/// Where pictures of documents are.
const PICTURES: &str = "/api/v1/docs/pictures/";
/// Lines longer than this are hard to read, points. Tables and code may be wider.
const MAX_LINE: f32 = 760.0;
/// Width of a step of a list, points.
const STEP: f32 = 22.0;
/// Points that a letter of a table takes, about: more than most, so that words are not broken.
const LETTER: f32 = 7.6;
/// Between columns of a table, points.
const COLUMN_GAP: f32 = 14.0;
/// Room for the button beside code, points.
const COPY_WIDTH: f32 = 64.0;

/// What reading came to in this frame.
#[derive(Debug, Default, PartialEq)]
pub(super) struct Reading {
    /// The link inside the documents that was followed.
    pub(super) followed: Option<Target>,
    /// The section that was looked for is at the top now.
    pub(super) is_there: bool,
}

/// Lays `blocks` out below one another, and scrolls to the heading with the address `section`.
pub(super) fn document_ui(
    ui: &mut egui::Ui,
    palette: &Palette,
    blocks: &[Block],
    section: Option<&str>,
) -> Reading {
    let mut reading = Reading::default();
    // Rows of text, not of controls.
    ui.spacing_mut().interact_size.y = 18.0;
    for (idx, block) in blocks.iter().enumerate() {
        match block {
            Block::Heading { level, text, slug } => {
                let is_first = idx == 0;
                let response = heading_ui(ui, *level, text, is_first);
                if section == Some(slug) && !reading.is_there && !ui.is_sizing_pass() {
                    response.scroll_to_me_animation(Some(Align::TOP), egui::style::ScrollAnimation::none());
                    reading.is_there = true;
                }
            }
            Block::Paragraph { depth, marker, spans } => {
                indented_ui(ui, *depth, marker.as_deref(), palette, |ui| {
                    spans_ui(ui, palette, spans, false, &mut reading.followed);
                });
            }
            Block::Code { depth, text } => {
                indented_ui(ui, *depth, None, palette, |ui| code_ui(ui, palette, idx, text));
            }
            Block::Table(rows) => table_ui(ui, palette, idx, rows, &mut reading.followed),
            Block::Rule => {
                ui.separator();
            }
        }
        ui.add_space(4.0);
    }
    reading
}

fn heading_ui(ui: &mut egui::Ui, level: usize, text: &str, is_first: bool) -> egui::Response {
    if !is_first {
        ui.add_space(if level <= 2 { 14.0 } else { 8.0 });
    }
    let size = match level {
        1 => 24.0,
        2 => 19.0,
        _ => 16.0,
    };
    let response = ui.add(Label::new(RichText::new(text).size(size).strong()).wrap());
    response.widget_info(|| egui::WidgetInfo::labeled(Role::Heading, true, text));
    response
}

/// `contents` as deep in lists as `depth` says, beside the `marker` of an item.
fn indented_ui(
    ui: &mut egui::Ui,
    depth: usize,
    marker: Option<&str>,
    palette: &Palette,
    contents: impl FnOnce(&mut egui::Ui),
) {
    if depth == 0 {
        contents(ui);
        return;
    }
    let mut rect = ui.available_rect_before_wrap();
    // On a phone deep lists would leave no room for their words.
    let indent = (depth as f32 * STEP).min(rect.width() / 3.0);
    let marker_pos = egui::pos2(rect.left() + indent - STEP + 6.0, rect.top());
    rect.min.x += indent;
    match marker {
        // A dot is decoration; a number is read out.
        Some(DOT) => {
            let size = TextStyle::Body.resolve(ui.style()).size;
            let center = egui::pos2(marker_pos.x + 4.0, marker_pos.y + size * 0.6);
            ui.painter().circle_filled(center, 2.5, palette.real);
        }
        Some(number) => {
            let rect = egui::Rect::from_min_size(marker_pos, egui::vec2(STEP, 18.0));
            ui.scope_builder(UiBuilder::new().max_rect(rect), |ui| ui.label(number));
        }
        None => {}
    }
    ui.scope_builder(UiBuilder::new().max_rect(rect), contents);
}

/// Text with links in it, in as many lines as it needs. `strong` is the look of a table's head.
fn spans_ui(
    ui: &mut egui::Ui,
    palette: &Palette,
    spans: &[Span],
    strong: bool,
    followed: &mut Option<Target>,
) {
    if spans.is_empty() {
        return;
    }
    ui.scope(|ui| {
        ui.set_max_width(ui.available_width().min(MAX_LINE));
        if !spans.iter().any(is_link) {
            ui.add(Label::new(job(ui, palette, spans, strong)).wrap());
            return;
        }
        ui.spacing_mut().item_spacing = egui::Vec2::ZERO;
        ui.horizontal_wrapped(|ui| {
            for run in spans.chunk_by(|a, b| !is_link(a) && !is_link(b)) {
                let text = job(ui, palette, run, strong);
                match run.first().and_then(|span| span.target.as_ref()) {
                    Some(target) => link_ui(ui, text, target, followed),
                    None => {
                        ui.add(Label::new(text));
                    }
                }
            }
        });
    });
}

/// Files of the sources are not served, so that their names are only words.
fn is_link(span: &Span) -> bool {
    !matches!(span.target, None | Some(Target::Source(_)))
}

fn link_ui(ui: &mut egui::Ui, text: LayoutJob, target: &Target, followed: &mut Option<Target>) {
    match target {
        Target::Outside(url) => {
            ui.add(egui::Hyperlink::from_label_and_url(text, url).open_in_new_tab(true)).on_hover_text(url);
        }
        Target::Picture(file) => {
            let url = format!("{PICTURES}{file}");
            ui.add(egui::Hyperlink::from_label_and_url(text, url).open_in_new_tab(true));
        }
        Target::Source(path) => {
            ui.add(Label::new(text)).on_hover_text(format!("{path} of the sources"));
        }
        Target::Doc { .. } | Target::Section(_) => {
            if ui.link(text).clicked() {
                *followed = Some(target.clone());
            }
        }
    }
}

fn job(ui: &egui::Ui, palette: &Palette, spans: &[Span], strong: bool) -> LayoutJob {
    let mut job = LayoutJob::default();
    for span in spans {
        job.append(&span.text, 0.0, format(ui, palette, span.look, strong, is_link(span)));
    }
    job
}

fn format(ui: &egui::Ui, palette: &Palette, look: Look, strong: bool, is_link: bool) -> TextFormat {
    let size = TextStyle::Body.resolve(ui.style()).size;
    let family = if look.code { FontFamily::Monospace } else { FontFamily::Proportional };
    // Monospaced letters look larger than others of their size.
    let size = if look.code { size - 1.0 } else { size };
    let visuals = ui.visuals();
    TextFormat {
        font_id: FontId::new(size, family),
        color: match is_link {
            true => visuals.hyperlink_color,
            false if look.strong || strong => visuals.strong_text_color(),
            false => palette.real,
        },
        background: if look.code && !is_link {
            palette.line.gamma_multiply(0.5)
        } else {
            egui::Color32::TRANSPARENT
        },
        italics: look.emphasis,
        underline: if is_link { egui::Stroke::new(1.0, visuals.hyperlink_color) } else { egui::Stroke::NONE },
        ..TextFormat::default()
    }
}

fn code_ui(ui: &mut egui::Ui, palette: &Palette, idx: usize, text: &str) {
    let text = text.trim_end();
    egui::Frame::new().fill(palette.background).corner_radius(4).inner_margin(8).show(ui, |ui| {
        ui.horizontal_top(|ui| {
            let width = (ui.available_width() - COPY_WIDTH).max(80.0);
            egui::ScrollArea::horizontal().id_salt(("code", idx)).max_width(width).show(ui, |ui| {
                ui.set_min_width(width);
                ui.style_mut().wrap_mode = Some(TextWrapMode::Extend);
                ui.label(RichText::new(text).monospace());
            });
            let copy = ui.small_button("Copy");
            name_button(&copy, "Copy code");
            if copy.clicked() {
                ui.ctx().copy_text(text.to_owned());
            }
        });
    });
}

fn table_ui(ui: &mut egui::Ui, palette: &Palette, idx: usize, rows: &[Row], followed: &mut Option<Target>) {
    let Some((head, body)) = rows.split_first() else { return };
    let Some(widths) = column_widths(rows, ui.available_width()) else {
        for row in body {
            card_ui(ui, palette, head, row, followed);
        }
        return;
    };
    for (row_idx, row) in rows.iter().enumerate() {
        // A table whose head is empty has none.
        if row_idx == 0 && head.iter().all(Vec::is_empty) {
            continue;
        }
        let (top, mut bottom) = (ui.cursor().min, ui.cursor().min.y);
        let mut left = top.x;
        for (column, (cell, width)) in row.iter().zip(&widths).enumerate() {
            let rect = egui::Rect::from_min_size(egui::pos2(left, top.y), egui::vec2(*width, f32::INFINITY));
            let builder = UiBuilder::new().id_salt((idx, row_idx, column)).max_rect(rect);
            let mut child = ui.new_child(builder.layout(egui::Layout::top_down(Align::Min)));
            spans_ui(&mut child, palette, cell, row_idx == 0, followed);
            bottom = bottom.max(child.min_rect().bottom());
            left += width + COLUMN_GAP;
        }
        let rect = egui::Rect::from_min_max(top, egui::pos2(left - COLUMN_GAP, bottom + 3.0));
        ui.advance_cursor_after_rect(rect);
        let line = egui::Stroke::new(1.0, palette.line);
        ui.painter().hline(rect.x_range(), rect.bottom() + ui.spacing().item_spacing.y / 2.0, line);
    }
}

/// A row where columns have no room beside one another: below each other, each after what its column is called.
fn card_ui(ui: &mut egui::Ui, palette: &Palette, head: &Row, row: &Row, followed: &mut Option<Target>) {
    for (column, cell) in row.iter().enumerate().filter(|(_, cell)| !cell.is_empty()) {
        let name: String = head.get(column).into_iter().flatten().map(|span| span.text.as_str()).collect();
        // The first column says what the row is about.
        if column > 0 && !name.is_empty() {
            ui.label(RichText::new(name).color(palette.text_weak).small());
        }
        spans_ui(ui, palette, cell, column == 0, followed);
    }
    ui.separator();
}

/// A width for each column, so that all of them have `room`; `None` if they would have to break words for that. Words that
/// are wider than a line are broken anyhow.
fn column_widths(rows: &[Row], room: f32) -> Option<Vec<f32>> {
    let num_columns = rows.iter().map(Vec::len).max().unwrap_or(0);
    let longest = |column: usize, length: fn(&str) -> usize| {
        let cells = rows.iter().filter_map(|row| row.get(column));
        let texts = cells.map(|cell| cell.iter().map(|span| span.text.as_str()).collect::<String>());
        texts.map(|text| length(&text)).max().unwrap_or(0).max(1) as f32 * LETTER
    };
    let wanted: Vec<f32> =
        (0..num_columns).map(|column| longest(column, |text| text.chars().count())).collect();
    let needed: Vec<f32> = (0..num_columns)
        .map(|column| {
            let word =
                |text: &str| text.split([' ', '/']).map(|word| word.chars().count()).max().unwrap_or(0);
            longest(column, word).min(MAX_LINE / 3.0)
        })
        .collect();
    let room = room - COLUMN_GAP * num_columns.saturating_sub(1) as f32;
    let (all_wanted, all_needed): (f32, f32) = (wanted.iter().sum(), needed.iter().sum());
    if all_wanted <= room {
        return Some(wanted);
    }
    if all_needed > room {
        return None;
    }
    // What is left goes to columns by how much they lack.
    let share = (room - all_needed) / (all_wanted - all_needed).max(1.0);
    let width = |(wanted, needed): (&f32, &f32)| needed + (wanted - needed).max(0.0) * share;
    Some(wanted.iter().zip(&needed).map(width).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(cells: &[&str]) -> Row {
        let span = |text: &&str| vec![Span { text: (*text).to_owned(), look: Look::default(), target: None }];
        cells.iter().map(span).collect()
    }

    #[test]
    fn columns_have_what_they_want_or_share_what_there_is_or_stand_below_each_other() {
        let long = "many words that can stand in several lines if they must, and these are so many of them";
        let rows = [row(&["word", "meaning"]), row(&["taxel", long])];
        let wide = column_widths(&rows, 2000.0).expect("there is room");
        assert!((wide[1] - long.len() as f32 * LETTER).abs() < 0.01, "{wide:?}");
        let shared = column_widths(&rows, 300.0).expect("there is room for words");
        let sum: f32 = shared.iter().sum();
        assert!(shared[0] >= 5.0 * LETTER && (sum + COLUMN_GAP - 300.0).abs() < 1.0, "{shared:?}");
        assert_eq!(column_widths(&rows, 90.0), None);
        assert_eq!(column_widths(&[], 90.0), Some(Vec::new()));
    }
}
