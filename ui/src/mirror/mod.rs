//! The accessible mirror: egui's AccessKit tree as elements of the page, for screen readers and browser tests alike.
//!
//! egui paints a canvas, in which a browser finds nothing to name or press. [`MirrorPlugin`] takes the tree that egui
//! builds each frame, [`model`] turns it into a flat list of elements and the differences to the last one, and `dom`
//! (browser only) applies them to transparent elements that lie over the canvas. What is done to an element comes back
//! as a [`MirrorEvent`] and becomes an AccessKit action request, or plain input where egui knows no such action.

#[cfg(target_arch = "wasm32")]
mod dom;
pub mod model;

use std::{
    collections::{HashMap, VecDeque},
    sync::{Arc, Mutex, PoisonError},
};

use egui::accesskit::{Action, ActionData, ActionRequest, NodeId, TreeId};
use model::{Change, MirrorModel, Place};

/// Something done to an element of the mirror, by the id of its node.
#[derive(Clone, Debug, PartialEq)]
pub enum MirrorEvent {
    /// Pressed, other than by a pointer (which egui sees itself).
    Click(u64),
    /// Given the focus.
    Focus(u64),
    /// A slider or number was set.
    SetNumber(u64, f64),
    /// A text field was filled.
    SetText(u64, String),
    /// A key was pressed in a text field that means something to the page: Enter, Escape, Tab, arrows.
    Key(egui::Key, egui::Modifiers),
}

/// Where elements leave what was done to them.
pub type MirrorInbox = Arc<Mutex<Vec<MirrorEvent>>>;

/// Applies changes to whatever holds the elements.
pub type MirrorSink = Box<dyn FnMut(&[Change], Option<u64>) + Send + Sync>;

/// Starts the mirror over `canvas`. A press on STOP calls `stop_now` before a frame is drawn.
#[cfg(target_arch = "wasm32")]
pub(crate) fn install(ctx: &egui::Context, canvas: &web_sys::HtmlCanvasElement, stop_now: fn()) {
    let inbox = MirrorInbox::default();
    ctx.enable_accesskit();
    let sink = dom::sink(ctx.clone(), canvas.clone(), inbox.clone(), stop_now);
    ctx.add_plugin(MirrorPlugin::new(inbox, sink));
}

/// Seconds between updates of the mirror: while a take plays, numbers change in every frame, and nobody reads so fast.
const UPDATE_EVERY_S: f64 = 0.05;

/// So many frames a text waits for its field to take egui's focus.
const MAX_FRAMES_TO_FOCUS: u32 = 10;

/// See the module.
pub struct MirrorPlugin {
    model: MirrorModel,
    inbox: MirrorInbox,
    sink: MirrorSink,
    /// What was done and egui does not know yet, oldest first. A text takes two frames, and what comes after it waits:
    /// a page may draw so slowly that the next field is filled, or a button is pressed, meanwhile.
    queue: VecDeque<MirrorEvent>,
    /// What a pointer did after a text that waits. STOP does not wait: the browser sends it by itself.
    held: Vec<egui::Event>,
    /// Whether a press is on whose end is still to come. An end never waits: a hand may move until then.
    is_pressed: bool,
    frames_to_focus_left: u32,
    focus: Option<u64>,
    updated_s: f64,
}

impl MirrorPlugin {
    /// A mirror that shows nothing yet.
    pub fn new(inbox: MirrorInbox, sink: MirrorSink) -> Self {
        Self {
            model: MirrorModel::default(),
            inbox,
            sink,
            queue: VecDeque::new(),
            held: Vec::new(),
            is_pressed: false,
            frames_to_focus_left: MAX_FRAMES_TO_FOCUS,
            focus: None,
            updated_s: f64::NEG_INFINITY,
        }
    }

    /// Puts `text` into the field `node` if egui's focus is there, and asks for the focus otherwise. Whether the text
    /// needs no further frame.
    fn push_text(&mut self, node: u64, text: &str, input: &mut egui::RawInput) -> bool {
        if self.focus == Some(node) {
            self.model.written(node, text);
            input.events.push(key_event(egui::Key::A, egui::Modifiers::COMMAND));
            input.events.push(if text.is_empty() {
                key_event(egui::Key::Backspace, egui::Modifiers::NONE)
            } else {
                egui::Event::Paste(text.to_owned())
            });
            return true;
        }
        input.events.push(action(node, Action::Focus, None));
        self.frames_to_focus_left -= 1;
        if self.frames_to_focus_left == 0 {
            // The element shows again what egui has.
            self.model.written(node, text);
        }
        self.frames_to_focus_left == 0
    }

    /// Adds to `input` what was done, up to a text and without what comes after it.
    fn take_in(&mut self, input: &mut egui::RawInput) {
        self.queue.extend(std::mem::take(&mut *self.inbox.lock().unwrap_or_else(PoisonError::into_inner)));
        let has_text = self.queue.iter().any(|event| matches!(event, MirrorEvent::SetText(..)));
        if (has_text || !self.held.is_empty()) && !self.is_pressed {
            self.held.extend(input.events.extract_if(.., |event| is_of_pointer(event)));
        }
        while let Some(event) = self.queue.pop_front() {
            match event {
                MirrorEvent::Click(node) => input.events.push(action(node, Action::Click, None)),
                MirrorEvent::Focus(node) => {
                    input.events.push(action(node, Action::ScrollIntoView, None));
                    input.events.push(action(node, Action::Focus, None));
                }
                MirrorEvent::SetNumber(node, value) => {
                    let data = Some(ActionData::NumericValue(value));
                    input.events.push(action(node, Action::SetValue, data));
                }
                MirrorEvent::SetText(node, text) => {
                    if self.push_text(node, &text, input) {
                        self.frames_to_focus_left = MAX_FRAMES_TO_FOCUS;
                    } else {
                        self.queue.push_front(MirrorEvent::SetText(node, text));
                    }
                    return;
                }
                MirrorEvent::Key(key, modifiers) => input.events.push(key_event(key, modifiers)),
            }
        }
        input.events.append(&mut self.held);
    }
}

impl egui::Plugin for MirrorPlugin {
    fn debug_name(&self) -> &'static str {
        "accessible mirror"
    }

    fn input_hook(&mut self, ctx: &egui::Context, input: &mut egui::RawInput) {
        self.take_in(input);
        let press = |event: &egui::Event| match event {
            egui::Event::PointerButton { pressed, .. } => Some(*pressed),
            _ => None,
        };
        self.is_pressed = input.events.iter().filter_map(press).next_back().unwrap_or(self.is_pressed);
        if !self.queue.is_empty() || !self.held.is_empty() {
            ctx.request_repaint();
        }
    }

    fn output_hook(&mut self, ctx: &egui::Context, output: &mut egui::FullOutput) {
        let Some(update) = &output.platform_output.accesskit_update else { return };
        self.focus = Some(update.focus.0);
        let now_s = ctx.input(|input| input.time);
        let early_s = self.updated_s + UPDATE_EVERY_S - now_s;
        if early_s > 0.0 {
            ctx.request_repaint_after(std::time::Duration::from_secs_f64(early_s));
            return;
        }
        self.updated_s = now_s;
        // A widget that is scrolled out of sight keeps its place in the tree, but nobody can point at it.
        let places: HashMap<u64, Place> = ctx.viewport_for(egui::ViewportId::ROOT, |viewport| {
            let layers = viewport.this_pass.widgets.layers();
            layers
                .flat_map(|(layer_id, widgets)| widgets.iter().map(|widget| (layer_id.order, widget)))
                .map(|(order, widget)| {
                    let place = Place { rect: widget.interact_rect, layer: order as u8 };
                    (widget.id.value(), place)
                })
                .collect()
        });
        let changes = self.model.update(update, |node| places.get(&node).copied());
        (self.sink)(&changes, self.model.focus());
    }
}

fn action(node: u64, action: Action, data: Option<ActionData>) -> egui::Event {
    egui::Event::AccessKitActionRequest(ActionRequest {
        action,
        target_tree: TreeId::ROOT,
        target_node: NodeId(node),
        data,
    })
}

/// Whether `event` is of a mouse, a finger or a pen.
fn is_of_pointer(event: &egui::Event) -> bool {
    use egui::Event;
    matches!(
        event,
        Event::PointerMoved(_)
            | Event::MouseMoved(_)
            | Event::PointerButton { .. }
            | Event::PointerGone
            | Event::MouseWheel { .. }
            | Event::Zoom(_)
            | Event::Touch { .. }
    )
}

fn key_event(key: egui::Key, modifiers: egui::Modifiers) -> egui::Event {
    egui::Event::Key { key, physical_key: None, pressed: true, repeat: false, modifiers }
}
