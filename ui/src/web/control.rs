//! The socket of commands, and the heartbeats on it.
//!
//! Heartbeats come from a timer and not from painted frames: a picture that takes long to draw must not make the robot
//! hold. They come from this thread and not from a worker: a page that hangs, is hidden or has lost the focus must.

use std::{cell::RefCell, rc::Rc};

use palpate_wire::proto::{Heartbeat, Stop, control_request};
use prost::Message as _;
use wasm_bindgen::{JsCast as _, closure::Closure};

use super::socket::{Socket, SocketEvents, open_socket};
use crate::api_client::{ApiEvent, ControlCounter};

/// Twenty heartbeats a second.
const BEAT_EVERY_MS: i32 = 50;
/// A beat is due again after this: a timer may come a little early, and frames come between.
const DUE_AFTER_MS: f64 = 35.0;

const EVENTS: SocketEvents = (ApiEvent::ControlOpen, ApiEvent::ControlClosed, ApiEvent::ControlMessage);

thread_local! {
    /// Sends a stop on the socket that is open, if one is.
    static STOP_NOW: RefCell<Option<Box<dyn Fn()>>> = const { RefCell::new(None) };
}

/// Sends a stop at once, where a frame may take long to draw. The frame sends one of its own, which does no harm, and
/// keeps it where there is no connection.
pub(super) fn stop_now() {
    STOP_NOW.with(|slot| {
        if let Ok(slot) = slot.try_borrow()
            && let Some(stop) = slot.as_ref()
        {
            stop();
        }
    });
}

/// See the module.
#[derive(Default)]
pub(super) struct ControlSocket {
    channel: Rc<RefCell<Channel>>,
    /// The timer and what it calls, once somebody has held a lease.
    timer: Option<Timer>,
}

/// What commands and heartbeats share: one socket, one count.
#[derive(Default)]
struct Channel {
    socket: Option<Socket>,
    counter: ControlCounter,
    lease: Option<u64>,
    last_beat_ms: f64,
}

impl Channel {
    /// A heartbeat, if one is due and somebody can be looking.
    fn beat(&mut self) {
        let now_ms = js_sys::Date::now();
        if let Some(lease) = self.lease
            && (now_ms - self.last_beat_ms).abs() >= DUE_AFTER_MS
            && super::document::is_watched()
        {
            self.last_beat_ms = now_ms;
            self.send(lease, control_request::Request::Heartbeat(Heartbeat {}));
        }
    }

    fn send(&mut self, lease: u64, request: control_request::Request) -> Option<u64> {
        let socket = &self.socket.as_ref()?.socket;
        if socket.ready_state() != web_sys::WebSocket::OPEN {
            return None;
        }
        let request = self.counter.number(lease, request);
        socket.send_with_u8_array(&request.encode_to_vec()).ok()?;
        Some(request.sequence)
    }
}

struct Timer {
    id: i32,
    _on_beat: Closure<dyn FnMut()>,
}

impl Drop for Timer {
    fn drop(&mut self) {
        if let Some(window) = web_sys::window() {
            window.clear_interval_with_handle(self.id);
        }
    }
}

impl ControlSocket {
    pub(super) fn open(&mut self, deliver: impl Fn(ApiEvent) + Clone + 'static) {
        let mut channel = self.channel.borrow_mut();
        let connecting = channel
            .socket
            .as_ref()
            .is_some_and(|socket| socket.socket.ready_state() == web_sys::WebSocket::CONNECTING);
        if connecting {
            return;
        }
        channel.counter = ControlCounter::default();
        channel.lease = None;
        let (shared, told) = (Rc::clone(&self.channel), deliver.clone());
        let stop = move || {
            // The page is never in the middle of a command when an event comes; were it ever, its frame stops.
            let Ok(mut channel) = shared.try_borrow_mut() else { return };
            let sequence = channel.send(0, control_request::Request::Stop(Stop {}));
            drop(channel);
            if let Some(sequence) = sequence {
                told(ApiEvent::StopSent(sequence));
            }
        };
        STOP_NOW.with(|slot| *slot.borrow_mut() = Some(Box::new(stop)));
        match open_socket("/api/v1/control", EVENTS, deliver.clone()) {
            Ok(socket) => channel.socket = Some(socket),
            Err(_) => {
                channel.socket = None;
                deliver(ApiEvent::ControlClosed);
            }
        }
    }

    pub(super) fn send(&mut self, lease: u64, request: control_request::Request) -> Option<u64> {
        self.channel.borrow_mut().send(lease, request)
    }

    pub(super) fn beat(&mut self, lease: Option<u64>) {
        let mut channel = self.channel.borrow_mut();
        channel.lease = lease;
        // Where frames take long, a timer comes late: a painted frame shows as well that the page is alive.
        channel.beat();
        drop(channel);
        if lease.is_none() {
            self.timer = None;
        } else if self.timer.is_none() {
            self.timer = start_timer(&self.channel);
        }
    }
}

fn start_timer(channel: &Rc<RefCell<Channel>>) -> Option<Timer> {
    let channel = Rc::clone(channel);
    let on_beat = Closure::<dyn FnMut()>::new(move || {
        // The page is never in the middle of a command when a timer fires; were it ever, the next beat is soon.
        let Ok(mut channel) = channel.try_borrow_mut() else { return };
        channel.beat();
    });
    let window = web_sys::window()?;
    let id = window
        .set_interval_with_callback_and_timeout_and_arguments_0(
            on_beat.as_ref().unchecked_ref(),
            BEAT_EVERY_MS,
        )
        .ok()?;
    Some(Timer { id, _on_beat: on_beat })
}
