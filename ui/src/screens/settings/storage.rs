//! Storage: how much room there is, where data lies, how it is backed up.

use egui::RichText;

use crate::screens::{ScreenContext, copy_as::DATA_FOLDER, loaded_ui};

/// With less room than this a session may not fit, bytes.
const LITTLE: f64 = 5e9;

pub(super) fn storage_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>) {
    let free = cx.store.people.free_bytes();
    let Some(free) = loaded_ui(ui, cx, free, "Asking the disk", "What the disk says did not arrive") else {
        return;
    };
    match free {
        None => {
            ui.label("The disk of the data folder does not say how much room it has.");
        }
        Some(free) if free < LITTLE => {
            let text = format!(
                "\u{26a0} {} are free on the disk of the data folder: a recording may end early.",
                size_text(free)
            );
            ui.colored_label(cx.palette.mismatch, text);
        }
        Some(free) => {
            ui.label(format!("{} are free on the disk of the data folder.", size_text(free)));
        }
    }
    ui.label(
        RichText::new(format!(
            "The data folder is the one that `palpate serve --data` names on the studio's computer, `{DATA_FOLDER}` unless \
             it says otherwise. Sessions, models, campaigns and jobs lie in it as files."
        ))
        .color(cx.palette.text_weak),
    );
    ui.add_space(8.0);
    ui.strong("Backup");
    ui.label("On the studio's computer, also while it runs (the archive must not lie in the data folder):");
    let command = format!("palpate backup --data {DATA_FOLDER} --out palpate.tar");
    ui.add(egui::Label::new(RichText::new(&command).monospace()).wrap().selectable(true));
    if ui.button("Copy the command").clicked() {
        ui.ctx().copy_text(command);
    }
}

/// A size as people read it.
fn size_text(bytes: f64) -> String {
    if bytes >= 1e9 { format!("{:.1} GB", bytes / 1e9) } else { format!("{:.0} MB", bytes / 1e6) }
}

#[cfg(test)]
mod tests {
    use super::size_text;

    #[test]
    fn sizes_are_written_as_people_read_them() {
        assert_eq!([256e6, 41.26e9].map(size_text), ["256 MB", "41.3 GB"]);
    }
}
