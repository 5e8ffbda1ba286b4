//! `fetch` and `WebSocket` as an [`Api`].

use std::{
    cell::{Cell, RefCell},
    rc::Rc,
    time::Duration,
};

use wasm_bindgen::{JsCast as _, JsValue};
use wasm_bindgen_futures::JsFuture;

use palpate_wire::{api::LEASE_HEADER, proto::control_request};

use super::{
    control::ControlSocket,
    socket::{Socket, SocketEvents, open_socket},
};
use crate::api_client::{Api, ApiEvent, HttpRequest, Request, problem_text};

/// Status of an answer to a request of whoever is not logged in.
const UNAUTHORIZED: u16 = 401;

const STREAM_EVENTS: SocketEvents = (ApiEvent::SocketOpen, ApiEvent::SocketClosed, ApiEvent::SocketMessage);

type Inbox = Rc<RefCell<Vec<ApiEvent>>>;

/// The server that the page came from.
pub(super) struct WebApi {
    ctx: egui::Context,
    inbox: Inbox,
    socket: Option<Socket>,
    control: ControlSocket,
    stream_within: Rc<Cell<Duration>>,
}

impl WebApi {
    pub(super) fn new(ctx: egui::Context) -> Self {
        Self {
            ctx,
            inbox: Inbox::default(),
            socket: None,
            control: ControlSocket::default(),
            stream_within: Rc::default(),
        }
    }

    fn deliver(&self) -> impl Fn(ApiEvent) + Clone + 'static {
        let (ctx, inbox) = (self.ctx.clone(), self.inbox.clone());
        let stream_within = self.stream_within.clone();
        move |event| {
            let within = match event {
                ApiEvent::SocketMessage(_) => stream_within.get(),
                _ => Duration::ZERO,
            };
            inbox.borrow_mut().push(event);
            ctx.request_repaint_after(within);
        }
    }
}

impl Api for WebApi {
    fn send(&mut self, lease: u64, request: Request) {
        let deliver = self.deliver();
        let http = request.to_http(lease);
        wasm_bindgen_futures::spawn_local(async move {
            let result = fetch(http).await;
            deliver(ApiEvent::Answer { request, result });
        });
    }

    fn open_socket(&mut self) {
        let deliver = self.deliver();
        let connecting = self
            .socket
            .as_ref()
            .is_some_and(|socket| socket.socket.ready_state() == web_sys::WebSocket::CONNECTING);
        if connecting {
            return;
        }
        match open_socket("/api/v1/stream", STREAM_EVENTS, deliver.clone()) {
            Ok(socket) => self.socket = Some(socket),
            Err(_) => deliver(ApiEvent::SocketClosed),
        }
    }

    fn open_control(&mut self) {
        let deliver = self.deliver();
        self.control.open(deliver);
    }

    fn send_control(&mut self, lease: u64, request: control_request::Request) -> Option<u64> {
        self.control.send(lease, request)
    }

    fn beat(&mut self, lease: Option<u64>) {
        self.control.beat(lease);
    }

    fn draw_stream_within(&mut self, within: Duration) {
        self.stream_within.set(within);
    }

    fn poll(&mut self) -> Vec<ApiEvent> {
        std::mem::take(&mut *self.inbox.borrow_mut())
    }
}

async fn fetch(request: HttpRequest) -> Result<Vec<u8>, String> {
    let (status, body) = exchange(&request).await.map_err(|_| {
        "the server did not answer; check that `palpate serve` is running and that the network is up"
            .to_owned()
    })?;
    if status == UNAUTHORIZED {
        // The login has ended; the page comes back after another one.
        if let Some(window) = web_sys::window() {
            // A browser that does not go there shows the error.
            let _ = window.location().set_href("/login");
        }
    }
    if (200..300).contains(&status) { Ok(body) } else { Err(problem_text(status, &body)) }
}

async fn exchange(request: &HttpRequest) -> Result<(u16, Vec<u8>), JsValue> {
    let init = web_sys::RequestInit::new();
    init.set_method(request.method);
    let headers = web_sys::Headers::new()?;
    if let Some((content_type, bytes)) = &request.body {
        headers.set("content-type", content_type)?;
        init.set_body(&js_sys::Uint8Array::from(bytes.as_slice()));
    }
    if let Some(lease) = request.lease {
        headers.set(LEASE_HEADER, &lease.to_string())?;
    }
    init.set_headers(&headers);
    let window = web_sys::window().ok_or(JsValue::NULL)?;
    let answer = JsFuture::from(window.fetch_with_str_and_init(&request.path, &init)).await?;
    let response: web_sys::Response = answer.dyn_into()?;
    let buffer = JsFuture::from(response.array_buffer()?).await?;
    Ok((response.status(), js_sys::Uint8Array::new(&buffer).to_vec()))
}
