//! The window around the canvas.

use wasm_bindgen::JsValue;

use super::{
    document::{document, is_watched},
    file_dialog::FileDialog,
};
use crate::{Platform, screens::PickedFile};

/// Where the browser keeps the chosen theme; `index.html` reads it too.
const THEME_KEY: &str = "palpate-theme";

/// Where the browser keeps who sat here.
const OPERATOR_KEY: &str = "palpate-operator";

fn local_storage() -> Option<web_sys::Storage> {
    web_sys::window()?.local_storage().ok().flatten()
}

/// The browser's address bar, clock and file dialog.
pub(super) struct BrowserWindow {
    file_dialog: FileDialog,
}

impl BrowserWindow {
    pub(super) fn new(ctx: &egui::Context) -> Self {
        Self { file_dialog: FileDialog::new(ctx) }
    }
}

impl Platform for BrowserWindow {
    fn hash(&self) -> String {
        web_sys::window().and_then(|window| window.location().hash().ok()).unwrap_or_default()
    }

    fn push_hash(&mut self, hash: &str) {
        if let Some(history) = web_sys::window().and_then(|window| window.history().ok()) {
            // Fails only when called hundreds of times in seconds; the address then lags behind for a moment.
            let _ = history.push_state_with_url(&JsValue::NULL, "", Some(hash));
        }
    }

    fn replace_hash(&mut self, hash: &str) {
        if let Some(history) = web_sys::window().and_then(|window| window.history().ok()) {
            let _ = history.replace_state_with_url(&JsValue::NULL, "", Some(hash));
        }
    }

    fn address(&self) -> String {
        web_sys::window().and_then(|window| window.location().href().ok()).unwrap_or_default()
    }

    fn time_of_day(&self) -> String {
        let now = js_sys::Date::new_0();
        format!("{:02}:{:02}:{:02}", now.get_hours(), now.get_minutes(), now.get_seconds())
    }

    fn local_time(&self, rfc3339: &str) -> Option<String> {
        let date = js_sys::Date::new(&JsValue::from_str(rfc3339));
        (!date.get_time().is_nan()).then(|| {
            format!(
                "{:04}-{:02}-{:02} {:02}:{:02}:{:02}",
                date.get_full_year(),
                date.get_month() + 1,
                date.get_date(),
                date.get_hours(),
                date.get_minutes(),
                date.get_seconds()
            )
        })
    }

    fn saved_theme(&self) -> Option<egui::Theme> {
        match local_storage()?.get_item(THEME_KEY).ok()??.as_str() {
            "dark" => Some(egui::Theme::Dark),
            "light" => Some(egui::Theme::Light),
            _ => None,
        }
    }

    fn save_theme(&mut self, theme: egui::Theme) {
        let word = match theme {
            egui::Theme::Dark => "dark",
            egui::Theme::Light => "light",
        };
        if let Some(storage) = local_storage() {
            // A browser that keeps nothing still has the theme until the page is closed.
            let _ = storage.set_item(THEME_KEY, word);
        }
    }

    fn saved_operator(&self) -> String {
        local_storage().and_then(|storage| storage.get_item(OPERATOR_KEY).ok()?).unwrap_or_default()
    }

    fn save_operator(&mut self, operator: &str) {
        if let Some(storage) = local_storage() {
            // As with the theme.
            let _ = storage.set_item(OPERATOR_KEY, operator);
        }
    }

    fn is_watched(&self) -> bool {
        is_watched()
    }

    fn set_title(&mut self, title: &str) {
        if let Some(document) = document() {
            document.set_title(title);
        }
    }

    fn save_picture(&mut self, file_name: &str, picture: &egui::ColorImage) -> bool {
        super::picture::save(file_name, picture)
    }

    fn pick_file(&mut self) {
        self.file_dialog.open();
    }

    fn picked_files(&mut self) -> Vec<PickedFile> {
        self.file_dialog.take_picked()
    }
}
