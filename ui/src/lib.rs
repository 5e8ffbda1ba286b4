//! The page: egui and wgpu in the browser.
