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

/// Starts the mirror over `canvas`.
#[cfg(target_arch = "wasm32")]
pub(crate) fn install(ctx: &egui::Context, canvas: &web_sys::HtmlCanvasElement) {
    let inbox = MirrorInbox::default();
    ctx.enable_accesskit();
    let sink = dom::sink(ctx.clone(), canvas.clone(), inbox.clone());
    ctx.add_plugin(MirrorPlugin::new(inbox, sink));
}

/// Seconds between updates of the mirror: while a take plays, numbers change in every frame, and nobody reads so fast.
const UPDATE_EVERY_S: f64 = 0.05;

/// Text on its way into a field: the field must have egui's focus before it takes any.
#[derive(Debug)]
struct PendingText {
    node: u64,
    text: String,
    frames_left: u32,
}

/// See the module.
pub struct MirrorPlugin {
    model: MirrorModel,
    inbox: MirrorInbox,
    sink: MirrorSink,
    /// One field after the other: a frame may take so long that the next one is filled in meanwhile.
    pending_texts: VecDeque<PendingText>,
    updated_s: f64,
}

impl MirrorPlugin {
    /// A mirror that shows nothing yet.
    pub fn new(inbox: MirrorInbox, sink: MirrorSink) -> Self {
        let model = MirrorModel::default();
        Self { model, inbox, sink, pending_texts: VecDeque::new(), updated_s: f64::NEG_INFINITY }
    }

    fn push_pending_text(&mut self, input: &mut egui::RawInput) -> bool {
        let Some(mut pending) = self.pending_texts.pop_front() else { return false };
        if self.model.focus() == Some(pending.node) {
            let select_all = egui::Event::Key {
                key: egui::Key::A,
                physical_key: None,
                pressed: true,
                repeat: false,
                modifiers: egui::Modifiers::COMMAND,
            };
            input.events.push(select_all);
            input.events.push(if pending.text.is_empty() {
                key_event(egui::Key::Backspace, egui::Modifiers::NONE)
            } else {
                egui::Event::Paste(pending.text)
            });
            return !self.pending_texts.is_empty();
        }
        input.events.push(action(pending.node, Action::Focus, None));
        pending.frames_left = pending.frames_left.saturating_sub(1);
        if pending.frames_left > 0 {
            self.pending_texts.push_front(pending);
        }
        true
    }
}

impl egui::Plugin for MirrorPlugin {
    fn debug_name(&self) -> &'static str {
        "accessible mirror"
    }

    fn input_hook(&mut self, ctx: &egui::Context, input: &mut egui::RawInput) {
        let events = std::mem::take(&mut *self.inbox.lock().unwrap_or_else(PoisonError::into_inner));
        for event in events {
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
                    // Of what is typed into one field the newest counts.
                    self.pending_texts.retain(|pending| pending.node != node);
                    self.pending_texts.push_back(PendingText { node, text, frames_left: 10 });
                }
                MirrorEvent::Key(key, modifiers) => input.events.push(key_event(key, modifiers)),
            }
        }
        if self.push_pending_text(input) {
            ctx.request_repaint();
        }
    }

    fn output_hook(&mut self, ctx: &egui::Context, output: &mut egui::FullOutput) {
        let Some(update) = &output.platform_output.accesskit_update else { return };
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

fn key_event(key: egui::Key, modifiers: egui::Modifiers) -> egui::Event {
    egui::Event::Key { key, physical_key: None, pressed: true, repeat: false, modifiers }
}
