//! A `WebSocket` for binary messages.

use wasm_bindgen::{JsCast as _, JsValue, closure::Closure};

use crate::api_client::ApiEvent;

/// What a socket reports when it opens, when it closes, and for each message.
pub(super) type SocketEvents = (ApiEvent, ApiEvent, fn(Vec<u8>) -> ApiEvent);

/// An open socket with the closures that it calls; they must live as long as it does.
pub(super) struct Socket {
    pub(super) socket: web_sys::WebSocket,
    _on_open: Closure<dyn FnMut()>,
    _on_close: Closure<dyn FnMut()>,
    _on_message: Closure<dyn FnMut(web_sys::MessageEvent)>,
}

impl Drop for Socket {
    fn drop(&mut self) {
        self.socket.set_onopen(None);
        self.socket.set_onclose(None);
        self.socket.set_onmessage(None);
        // Closing what is closed already is no error worth a word.
        let _ = self.socket.close();
    }
}

/// Opens a socket for binary messages at `path` of the page's server.
pub(super) fn open_socket(
    path: &str,
    (opened, closed, message): SocketEvents,
    deliver: impl Fn(ApiEvent) + Clone + 'static,
) -> Result<Socket, JsValue> {
    let location = web_sys::window().ok_or(JsValue::NULL)?.location();
    let scheme = if location.protocol()? == "https:" { "wss" } else { "ws" };
    let socket = web_sys::WebSocket::new(&format!("{scheme}://{}{path}", location.host()?))?;
    socket.set_binary_type(web_sys::BinaryType::Arraybuffer);
    let on_open = {
        let deliver = deliver.clone();
        Closure::<dyn FnMut()>::new(move || deliver(opened.clone()))
    };
    let on_close = {
        let deliver = deliver.clone();
        Closure::<dyn FnMut()>::new(move || deliver(closed.clone()))
    };
    let on_message = Closure::<dyn FnMut(web_sys::MessageEvent)>::new(move |event: web_sys::MessageEvent| {
        if let Ok(buffer) = event.data().dyn_into::<js_sys::ArrayBuffer>() {
            deliver(message(js_sys::Uint8Array::new(&buffer).to_vec()));
        }
    });
    socket.set_onopen(Some(on_open.as_ref().unchecked_ref()));
    socket.set_onclose(Some(on_close.as_ref().unchecked_ref()));
    socket.set_onmessage(Some(on_message.as_ref().unchecked_ref()));
    Ok(Socket { socket, _on_open: on_open, _on_close: on_close, _on_message: on_message })
}
