//! What was deleted, to be restored.

use egui::RichText;
use palpate_wire::api::{Role, TrashSort};

use super::super::{ScreenContext, controls::name_button};
use crate::store::Loadable;

/// The list, folded; it is asked for when it is opened.
pub(super) fn deleted_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>) {
    egui::CollapsingHeader::new("Deleted").id_salt("trash").show(ui, |ui| match cx.store.trash() {
        Loadable::Ready(entries) if entries.is_empty() => {
            ui.label("The trash holds no session and no model.");
        }
        Loadable::Ready(entries) => {
            let may = cx.store.people.me().ready().is_none_or(|me| me.role >= Role::Operator);
            if !may {
                ui.label("Operators restore what was deleted.");
            }
            if let Some(error) = cx.store.deleted_model.error() {
                ui.colored_label(cx.palette.mismatch, format!("\u{26a0} {error}"));
            }
            for entry in entries.iter() {
                let sort = match entry.sort {
                    TrashSort::Session => "session",
                    TrashSort::Model => "model",
                };
                ui.horizontal_wrapped(|ui| {
                    let button = ui.add_enabled(may, egui::Button::new("Restore"));
                    name_button(&button, &format!("Restore {sort} {}", entry.id));
                    if button.clicked() {
                        match entry.sort {
                            TrashSort::Session => cx.store.restore_session(&entry.id),
                            TrashSort::Model => cx.store.restore_model(&entry.id),
                        }
                    }
                    ui.label(format!("{sort} {}", entry.id));
                    let when = (cx.local_time)(&entry.deleted).unwrap_or_else(|| entry.deleted.clone());
                    ui.label(RichText::new(format!("deleted {when}")).color(cx.palette.text_weak));
                });
            }
        }
        Loadable::Failed(error) => {
            ui.colored_label(
                cx.palette.mismatch,
                format!("\u{26a0} What was deleted did not arrive: {error}"),
            );
            if ui.button("Try again").clicked() {
                cx.store.retry_failed();
            }
        }
        Loadable::Idle | Loadable::Loading => {
            ui.spinner();
        }
    });
}
