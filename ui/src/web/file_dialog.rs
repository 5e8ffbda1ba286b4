//! Files from the operator: dropped on the page, or chosen in the browser's dialog (an `<input type="file">` that nobody
//! sees).

use std::{cell::RefCell, rc::Rc};

use wasm_bindgen::{JsCast as _, JsValue, closure::Closure};
use wasm_bindgen_futures::JsFuture;

use crate::screens::PickedFile;

/// Opens the dialog and collects what was chosen, which arrives some frames later.
pub(super) struct FileDialog {
    ctx: egui::Context,
    picked: Rc<RefCell<Vec<PickedFile>>>,
    /// The input of the dialog that was opened last, and its listener; both must outlive the dialog.
    open: Option<(web_sys::HtmlInputElement, Closure<dyn FnMut()>)>,
}

impl FileDialog {
    pub(super) fn new(ctx: &egui::Context) -> Self {
        Self { ctx: ctx.clone(), picked: Rc::default(), open: None }
    }

    /// What has been read since the last call. Called once a frame: it also takes in what was dropped in this frame.
    pub(super) fn take_picked(&mut self) -> Vec<PickedFile> {
        for file in self.ctx.input(|input| input.raw.dropped_files.clone()) {
            let (ctx, picked) = (self.ctx.clone(), Rc::clone(&self.picked));
            wasm_bindgen_futures::spawn_local(async move {
                let name = file.path().to_string_lossy().into_owned();
                let bytes = file.bytes_async().await.unwrap_or_default();
                picked.borrow_mut().push(PickedFile { name, bytes });
                ctx.request_repaint();
            });
        }
        self.picked.take()
    }

    pub(super) fn open(&mut self) {
        let element = super::document::document().and_then(|document| document.create_element("input").ok());
        let Some(input) = element.and_then(|element| element.dyn_into::<web_sys::HtmlInputElement>().ok())
        else {
            return;
        };
        input.set_type("file");
        input.set_accept(".zip,application/zip");
        let listener = {
            let (input, ctx, picked) = (input.clone(), self.ctx.clone(), Rc::clone(&self.picked));
            Closure::new(move || {
                let Some(file) = input.files().and_then(|files| files.get(0)) else { return };
                let (ctx, picked) = (ctx.clone(), Rc::clone(&picked));
                wasm_bindgen_futures::spawn_local(async move {
                    // A file that cannot be read comes in empty, which the screen refuses by name.
                    let bytes = read(&file).await.unwrap_or_default();
                    picked.borrow_mut().push(PickedFile { name: file.name(), bytes });
                    ctx.request_repaint();
                });
            })
        };
        input.set_onchange(Some(listener.as_ref().unchecked_ref()));
        input.click();
        self.open = Some((input, listener));
    }
}

async fn read(file: &web_sys::File) -> Result<Vec<u8>, JsValue> {
    let buffer = JsFuture::from(file.array_buffer()).await?;
    Ok(js_sys::Uint8Array::new(&buffer).to_vec())
}
