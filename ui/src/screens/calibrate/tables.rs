//! The details of a result: by sensor type, by take, by channel, each metric in numbers and as a line from before to after.

use egui::{Align2, FontId, Pos2, Rect, Sense, Stroke, accesskit::Role, pos2, vec2};
use palpate_reports::{CalibrationReport, Metrics, MetricsPair};

use crate::{
    playback::ShownChannels,
    route::Screen,
    screens::{ScreenContext, channel_label, heading_ui},
    theme::Palette,
};

const NAME_WIDTH: f32 = 136.0;
const NUMBER_WIDTH: f32 = 48.0;
const LINE_WIDTH: f32 = 70.0;
const GAP: f32 = 12.0;
const ROW_HEIGHT: f32 = 24.0;
const FONT_SIZE: f32 = 14.0;

/// Which table is open.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Table {
    #[default]
    Modality,
    Take,
    Channel,
}

/// A metric, before and after.
struct Column {
    name: &'static str,
    value: fn(&Metrics) -> Option<f64>,
    factor: f64,
    digits: usize,
    /// The right end of its line, after scaling; `None` draws no line.
    full_scale: Option<f64>,
}

impl Column {
    fn width(&self) -> f32 {
        2.0 * NUMBER_WIDTH + self.full_scale.map_or(0.0, |_| LINE_WIDTH) + GAP
    }
}

/// A row, and what clicking its name opens.
struct Row<'a> {
    name: String,
    opens: Option<Opens>,
    nominal: &'a Metrics,
    calibrated: &'a Metrics,
}

enum Opens {
    Take(String),
    Channel(usize),
}

/// A number with `digits` decimals after scaling, or a dash where there is none.
pub(super) fn number(value: Option<f64>, factor: f64, digits: usize) -> String {
    value.map_or_else(|| "\u{2013}".to_owned(), |value| format!("{:.digits$}", value * factor))
}

pub(super) fn tables_ui(
    ui: &mut egui::Ui,
    cx: &mut ScreenContext<'_>,
    table: &mut Table,
    session: &str,
    report: &CalibrationReport,
) {
    ui.horizontal(|ui| {
        heading_ui(ui, "Details");
        for (value, name) in
            [(Table::Modality, "By sensor type"), (Table::Take, "By take"), (Table::Channel, "By channel")]
        {
            ui.selectable_value(table, value, name);
        }
    });
    let rows = rows(cx, *table, session, report);
    let slowest = rows
        .iter()
        .flat_map(|row| [row.nominal.onset_error_ms, row.calibrated.onset_error_ms])
        .flatten()
        .fold(1.0, f64::max);
    let columns = [
        Column {
            name: "Onset error, ms",
            value: |m| m.onset_error_ms,
            factor: 1.0,
            digits: 0,
            full_scale: Some(slowest),
        },
        Column { name: "Activation F1", value: |m| m.f1, factor: 1.0, digits: 2, full_scale: Some(1.0) },
        Column { name: "FPR, %", value: |m| m.fpr, factor: 100.0, digits: 2, full_scale: None },
        Column { name: "Mismatches", value: |m| Some(m.l1 as f64), factor: 1.0, digits: 0, full_scale: None },
    ];
    egui::ScrollArea::horizontal().id_salt("calibrate_table_scroll").show(ui, |ui| {
        table_ui(ui, cx, &columns, &rows, session);
    });
}

fn rows<'a>(
    cx: &mut ScreenContext<'_>,
    table: Table,
    session: &str,
    report: &'a CalibrationReport,
) -> Vec<Row<'a>> {
    let of_pair = |name: &str, opens, pair: &'a MetricsPair| Row {
        name: name.to_owned(),
        opens,
        nominal: &pair.nominal,
        calibrated: &pair.calibrated,
    };
    match table {
        Table::Modality => report.by_modality.iter().map(|(name, pair)| of_pair(name, None, pair)).collect(),
        Table::Take => report
            .by_take
            .iter()
            .map(|(id, take)| Row {
                name: if take.held_out { format!("{id} (held out)") } else { id.clone() },
                opens: Some(Opens::Take(id.clone())),
                nominal: &take.nominal,
                calibrated: &take.calibrated,
            })
            .collect(),
        Table::Channel => {
            let station = cx.store.station(session);
            let channel_of =
                |id: &str| station.ready()?.layout.channels.iter().position(|channel| channel.id == id);
            let mut rows: Vec<(Option<usize>, Row<'_>)> = report
                .by_channel
                .iter()
                .map(|(id, pair)| {
                    let channel = channel_of(id);
                    let label = channel_label(station.ready().map(AsRef::as_ref), id);
                    (channel, of_pair(&label, channel.map(Opens::Channel), pair))
                })
                .collect();
            // In the order of the layout, as on the timelines.
            rows.sort_by_key(|(channel, _)| *channel);
            rows.into_iter().map(|(_, row)| row).collect()
        }
    }
}

fn table_ui(
    ui: &mut egui::Ui,
    cx: &mut ScreenContext<'_>,
    columns: &[Column],
    rows: &[Row<'_>],
    session: &str,
) {
    ui.spacing_mut().item_spacing.y = 0.0;
    let width = NAME_WIDTH + columns.iter().map(Column::width).sum::<f32>() + 2.0 * NUMBER_WIDTH;
    let (header, _) = ui.allocate_exact_size(vec2(width, ROW_HEIGHT + 4.0), Sense::hover());
    for (idx, row) in rows.iter().enumerate() {
        let (rect, _) = ui.allocate_exact_size(vec2(width, ROW_HEIGHT), Sense::hover());
        row_ui(ui, cx, columns, row, session, rect, idx % 2 == 0);
    }
    // The header stays in sight while its rows are.
    let lowest = (ui.min_rect().bottom() - 2.0 * ROW_HEIGHT).max(header.top());
    let top = header.top().max(ui.clip_rect().top()).min(lowest);
    let header = Rect::from_min_size(pos2(header.left(), top), header.size());
    let painter = ui.painter();
    painter.rect_filled(header, 0.0, cx.palette.background);
    painter.hline(header.x_range(), header.bottom(), Stroke::new(1.0, cx.palette.line));
    let text = |x: f32, text: &str| {
        let at = pos2(x, header.center().y);
        painter.text(at, Align2::LEFT_CENTER, text, FontId::proportional(FONT_SIZE), cx.palette.text_weak);
    };
    let mut x = header.left() + NAME_WIDTH;
    for column in columns {
        text(x, column.name);
        x += column.width();
    }
    text(x, "Real contacts");
}

fn row_ui(
    ui: &egui::Ui,
    cx: &mut ScreenContext<'_>,
    columns: &[Column],
    row: &Row<'_>,
    session: &str,
    rect: Rect,
    striped: bool,
) {
    let palette = cx.palette;
    let sense = if row.opens.is_some() { Sense::click() } else { Sense::hover() };
    let response = ui.interact(rect, ui.scope_id().with(("metrics of", &row.name)), sense);
    let role = if row.opens.is_some() { Role::Button } else { Role::Label };
    response.widget_info(|| {
        let values = columns.iter().map(|column| {
            let text = |metrics| number((column.value)(metrics), column.factor, column.digits);
            format!("{} {} to {}", column.name, text(row.nominal), text(row.calibrated))
        });
        let mut info = egui::WidgetInfo::labeled(role, true, &row.name);
        info.current_text_value = Some(values.collect::<Vec<_>>().join("; "));
        info
    });
    if response.clicked() {
        open(cx, session, row.opens.as_ref());
    }
    if !ui.is_rect_visible(rect) {
        return;
    }
    let painter = ui.painter();
    let lit = row.opens.is_some() && (response.hovered() || response.has_focus());
    if lit || striped {
        painter.rect_filled(rect, 0.0, if lit { palette.line } else { palette.surface });
    }
    let font = FontId::proportional(FONT_SIZE);
    let y = rect.center().y;
    let name_colour = if row.opens.is_some() { palette.calibrated } else { palette.real };
    painter.text(pos2(rect.left() + 4.0, y), Align2::LEFT_CENTER, &row.name, font.clone(), name_colour);
    let mut x = rect.left() + NAME_WIDTH;
    for column in columns {
        let values = [row.nominal, row.calibrated].map(|metrics| (column.value)(metrics));
        let colours = [palette.nominal, palette.calibrated];
        for (idx, (value, colour)) in values.into_iter().zip(colours).enumerate() {
            let text = number(value, column.factor, column.digits);
            let at = pos2(x + NUMBER_WIDTH * idx as f32, y);
            painter.text(at, Align2::LEFT_CENTER, text, font.clone(), colour);
        }
        if let Some(full_scale) = column.full_scale {
            let from = pos2(x + 2.0 * NUMBER_WIDTH, y);
            line(painter, &palette, from, values.map(|value| value.map(|v| v * column.factor / full_scale)));
        }
        x += column.width();
    }
    painter.text(pos2(x, y), Align2::LEFT_CENTER, row.nominal.real_contacts.to_string(), font, palette.real);
    if row.opens.is_some() {
        response.on_hover_text("Open on Timelines");
    }
}

/// From before to after on a scale from 0 to 1.
fn line(painter: &egui::Painter, palette: &Palette, left: Pos2, shares: [Option<f64>; 2]) {
    let x_of = |share: f64| left.x + 5.0 + (LINE_WIDTH - 10.0) * share.clamp(0.0, 1.0) as f32;
    painter.hline(x_of(0.0)..=x_of(1.0), left.y, Stroke::new(1.0, palette.line));
    if let [Some(before), Some(after)] = shares {
        painter.hline(
            x_of(before.min(after))..=x_of(before.max(after)),
            left.y,
            Stroke::new(2.0, palette.dead),
        );
    }
    let [before, after] = shares.map(|share| share.map(|share| pos2(x_of(share), left.y)));
    if let Some(at) = before {
        painter.circle(at, 4.0, palette.background, Stroke::new(1.5, palette.nominal));
    }
    if let Some(at) = after {
        painter.circle_filled(at, 4.5, palette.calibrated);
    }
}

fn open(cx: &mut ScreenContext<'_>, session: &str, opens: Option<&Opens>) {
    cx.playback.open_session(session);
    match opens {
        Some(Opens::Take(take)) => cx.playback.open(session, take),
        Some(Opens::Channel(channel)) => {
            cx.playback.selected.insert(*channel);
            cx.playback.pinned = Some(*channel);
            cx.playback.shown = ShownChannels::Picked;
        }
        None => return,
    }
    cx.go_to_screen(Screen::Timelines);
}
