//! Pictures that the browser keeps as files.

use wasm_bindgen::{Clamped, JsCast as _, closure::Closure};

use super::document::document;

/// Has the browser download `picture` as a PNG file; `false` where it cannot.
pub(super) fn save(file_name: &str, picture: &egui::ColorImage) -> bool {
    try_save(file_name.to_owned(), picture).is_some()
}

fn try_save(file_name: String, picture: &egui::ColorImage) -> Option<()> {
    let [width, height] = picture.size.map(|side| side as u32);
    let canvas = document()?.create_element("canvas").ok()?.dyn_into::<web_sys::HtmlCanvasElement>().ok()?;
    canvas.set_width(width);
    canvas.set_height(height);
    let context = canvas.get_context("2d").ok()??.dyn_into::<web_sys::CanvasRenderingContext2d>().ok()?;
    // What is behind the page does not belong to the picture.
    let opaque: Vec<u8> =
        picture.pixels.iter().flat_map(|pixel| [pixel.r(), pixel.g(), pixel.b(), u8::MAX]).collect();
    let data = web_sys::ImageData::new_with_u8_clamped_array_and_sh(Clamped(&opaque), width, height).ok()?;
    context.put_image_data(&data, 0.0, 0.0).ok()?;
    let keep = Closure::once_into_js(move |png: Option<web_sys::Blob>| {
        let _ = png.and_then(|png| keep(&file_name, &png));
    });
    canvas.to_blob(keep.unchecked_ref()).ok()
}

fn keep(file_name: &str, png: &web_sys::Blob) -> Option<()> {
    let url = web_sys::Url::create_object_url_with_blob(png).ok()?;
    let link = document()?.create_element("a").ok()?.dyn_into::<web_sys::HtmlAnchorElement>().ok()?;
    link.set_href(&url);
    link.set_download(file_name);
    link.click();
    web_sys::Url::revoke_object_url(&url).ok()
}
