//! The audit log: who did what, newest first.

use egui::RichText;

use crate::{
    screens::{ScreenContext, loaded_ui},
    store::people::AuditLine,
};

/// Lines that are shown; a word in the filter finds those behind them.
const MAX_SHOWN: usize = 200;

/// With less room than this, points, what was done stands below who did it.
const NARROW: f32 = 620.0;

/// What was written here.
#[derive(Debug, Default)]
pub(super) struct AuditState {
    words: String,
}

pub(super) fn audit_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, state: &mut AuditState) {
    let lines = cx.store.people.audit();
    let Some(lines) = loaded_ui(ui, cx, lines, "Reading the audit log", "The audit log did not arrive")
    else {
        return;
    };
    ui.horizontal_wrapped(|ui| {
        let label = ui.label("Filter");
        let field = egui::TextEdit::singleline(&mut state.words).desired_width(240.0);
        ui.add(field.hint_text("a person, a device, a word")).labelled_by(label.id);
        if ui.button("Read it again").clicked() {
            cx.store.people.ask_audit_again();
        }
    });
    let found: Vec<_> = lines.iter().filter(|line| line.matches(&state.words)).collect();
    let text = match (lines.len(), found.len()) {
        (0, _) => "Nothing has been done yet.".to_owned(),
        (_, 0) => "No line has these words.".to_owned(),
        (all, found) if found <= MAX_SHOWN => format!("{found} of the newest {all} lines"),
        (all, found) => format!("{found} of the newest {all} lines; {MAX_SHOWN} are shown"),
    };
    ui.label(RichText::new(text).color(cx.palette.text_weak));
    let narrow = ui.available_width() < NARROW;
    let weak = cx.palette.text_weak;
    let row = |ui: &mut egui::Ui, time: String, line: &AuditLine| {
        ui.label(RichText::new(time).color(weak));
        ui.label(&line.who);
    };
    let shown = found.into_iter().take(MAX_SHOWN).map(|line| {
        let time = (cx.local_time)(&line.time).unwrap_or_else(|| line.time.clone());
        (time, line)
    });
    if narrow {
        for (time, line) in shown {
            ui.horizontal_wrapped(|ui| row(ui, time, line));
            ui.add(egui::Label::new(&line.what).wrap().selectable(true));
            ui.add_space(6.0);
        }
        return;
    }
    egui::Grid::new("audit").striped(true).num_columns(3).spacing([18.0, 4.0]).show(ui, |ui| {
        for (time, line) in shown {
            row(ui, time, line);
            ui.add(egui::Label::new(&line.what).wrap().selectable(true));
            ui.end_row();
        }
    });
}
