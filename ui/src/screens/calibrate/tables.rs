//! The details of a result: by sensor type, by take, by channel.

use egui::RichText;
use palpate_wire::api::{CalibrationReport, Metrics};

use crate::screens::ScreenContext;

/// Which table is open.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Table {
    #[default]
    Modality,
    Take,
    Channel,
}

/// A column: its name, and its text for a set of metrics.
type Column = (&'static str, fn(&Metrics) -> String);

/// A number with `digits` decimals after scaling, or a dash where there is none.
pub(super) fn number(value: Option<f64>, factor: f64, digits: usize) -> String {
    value.map_or_else(|| "\u{2013}".to_owned(), |value| format!("{:.digits$}", value * factor))
}

pub(super) fn tables_ui(
    ui: &mut egui::Ui,
    cx: &ScreenContext<'_>,
    table: &mut Table,
    report: &CalibrationReport,
) {
    ui.horizontal(|ui| {
        ui.heading("Details");
        for (value, name) in
            [(Table::Modality, "By sensor type"), (Table::Take, "By take"), (Table::Channel, "By channel")]
        {
            ui.selectable_value(table, value, name);
        }
    });
    let rows: Vec<(String, &Metrics, &Metrics)> = match table {
        Table::Modality => report
            .by_modality
            .iter()
            .map(|(name, pair)| (name.clone(), &pair.nominal, &pair.calibrated))
            .collect(),
        Table::Take => report
            .by_take
            .iter()
            .map(|(name, take)| {
                let name = if take.held_out { format!("{name} (held out)") } else { name.clone() };
                (name, &take.nominal, &take.calibrated)
            })
            .collect(),
        Table::Channel => report
            .by_channel
            .iter()
            .map(|(name, pair)| (name.clone(), &pair.nominal, &pair.calibrated))
            .collect(),
    };
    let columns: [Column; 4] = [
        ("Onset, ms", |m| number(m.onset_error_ms, 1.0, 0)),
        ("F1, %", |m| number(m.f1, 100.0, 1)),
        ("FPR, %", |m| number(m.fpr, 100.0, 2)),
        ("Mismatch, frames", |m| m.l1.to_string()),
    ];
    egui::ScrollArea::horizontal().id_salt("calibrate_table_scroll").show(ui, |ui| {
        egui::Grid::new(("calibrate_table", *table as u8))
            .striped(true)
            .min_row_height(22.0)
            .spacing([20.0, 4.0])
            .show(ui, |ui| {
                ui.label("");
                for (name, _) in columns {
                    ui.label(RichText::new(name).strong());
                    ui.label("");
                }
                ui.label(RichText::new("Real contacts").strong());
                ui.end_row();
                for (name, nominal, calibrated) in rows {
                    ui.label(name);
                    for (_, text) in columns {
                        ui.label(RichText::new(text(nominal)).color(cx.palette.nominal));
                        ui.label(RichText::new(text(calibrated)).color(cx.palette.calibrated));
                    }
                    ui.label(nominal.real_contacts.to_string());
                    ui.end_row();
                }
            });
    });
}
