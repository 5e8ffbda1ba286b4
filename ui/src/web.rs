//! The browser: starts the page, and gives it `fetch`, two `WebSocket`s and the address bar.

mod control;
mod document;
mod fetch;
mod file_dialog;
mod picture;
mod socket;
mod window;

use wasm_bindgen::{JsCast as _, prelude::wasm_bindgen};

use crate::{StudioApp, surface::Surface};

const CANVAS_ID: &str = "palpate";
const SKELETON_ID: &str = "skeleton";
const SKELETON_TEXT_ID: &str = "skeleton-text";

/// Starts the page on the canvas of `index.html`.
#[wasm_bindgen(start)]
fn start() {
    wasm_bindgen_futures::spawn_local(async {
        if let Err(error) = run().await {
            document::set_text(
                SKELETON_TEXT_ID,
                &format!("The studio could not start: {error}. It needs a browser with WebGL 2."),
            );
        }
    });
}

async fn run() -> Result<(), String> {
    let canvas = document::document()
        .and_then(|document| document.get_element_by_id(CANVAS_ID))
        .and_then(|element| element.dyn_into::<web_sys::HtmlCanvasElement>().ok())
        .ok_or("the page has no canvas")?;
    let mirror_canvas = canvas.clone();
    eframe::WebRunner::new()
        .start(
            canvas,
            // What dithering smooths, gradients, the page has hardly any of; it costs time for every pixel.
            eframe::WebOptions { dithering: false, ..eframe::WebOptions::default() },
            Box::new(move |cc| {
                let state = cc.wgpu_render_state.as_ref();
                let surface = state.map(|state| Surface::new(state.target_format, &state.adapter));
                crate::mirror::install(&cc.egui_ctx, &mirror_canvas, control::stop_now);
                cc.egui_ctx.add_plugin(crate::pacing::PressPacing::default());
                let api = Box::new(fetch::WebApi::new(cc.egui_ctx.clone()));
                let app = StudioApp::new(
                    &cc.egui_ctx,
                    api,
                    Box::new(window::BrowserWindow::new(&cc.egui_ctx)),
                    surface,
                );
                document::remove(SKELETON_ID);
                Ok(Box::new(WebApp { app }))
            }),
        )
        .await
        .map_err(|error| format!("{error:?}"))
}

struct WebApp {
    app: StudioApp,
}

impl eframe::App for WebApp {
    fn ui(&mut self, ui: &mut egui::Ui, _frame: &mut eframe::Frame) {
        self.app.ui(ui);
    }

    fn clear_color(&self, visuals: &egui::Visuals) -> [f32; 4] {
        visuals.panel_fill.to_normalized_gamma_f32()
    }

    fn persist_egui_memory(&self) -> bool {
        // What is open and where belongs to the address, so that a link shows the same to everybody.
        false
    }
}
