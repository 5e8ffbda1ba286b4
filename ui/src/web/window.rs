//! The window around the canvas.

use wasm_bindgen::JsValue;

use super::file_dialog::FileDialog;
use crate::{Platform, screens::PickedFile};

pub(super) fn document() -> Option<web_sys::Document> {
    web_sys::window().and_then(|window| window.document())
}

pub(super) fn set_text(id: &str, text: &str) {
    if let Some(element) = document().and_then(|document| document.get_element_by_id(id)) {
        element.set_text_content(Some(text));
    }
}

pub(super) fn remove(id: &str) {
    if let Some(element) = document().and_then(|document| document.get_element_by_id(id)) {
        element.remove();
    }
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

    fn time_of_day(&self) -> String {
        let now = js_sys::Date::new_0();
        format!("{:02}:{:02}:{:02}", now.get_hours(), now.get_minutes(), now.get_seconds())
    }

    fn pick_file(&mut self) {
        self.file_dialog.open();
    }

    fn picked_files(&mut self) -> Vec<PickedFile> {
        self.file_dialog.take_picked()
    }
}
