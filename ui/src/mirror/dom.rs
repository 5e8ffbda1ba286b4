//! The mirror's elements in the browser: thin, everything worth testing is in [`super::model`].
//!
//! Elements are transparent and lie over the canvas. A pointer over one is handed on to the canvas, so that egui sees
//! presses, drags and hovering as if nothing lay in between; a press without a pointer (a screen reader, a script)
//! becomes a [`MirrorEvent::Click`]. The canvas keeps the focus; only text fields may take it.

use std::{cell::RefCell, collections::HashMap};

use wasm_bindgen::{JsCast as _, JsValue, closure::Closure};
use web_sys::{Document, HtmlCanvasElement, HtmlElement, HtmlInputElement};

use super::{
    MirrorEvent, MirrorInbox, MirrorSink,
    model::{Change, Checked, Element, MirrorNode},
};

const ROOT_ID: &str = "mirror";
const STYLE: &str = "
#mirror { position: absolute; inset: 0; overflow: hidden; pointer-events: none; }
#mirror > * { position: absolute; box-sizing: border-box; margin: 0; padding: 0; border: 0; outline: none;
  overflow: hidden; white-space: pre; background: transparent; color: transparent; opacity: 0.01; appearance: none;
  caret-color: transparent; font: 13px/1.2 system-ui, sans-serif; pointer-events: none; }
#mirror > .on { pointer-events: auto; }
#mirror.through > .on { pointer-events: none; }
";

thread_local! {
    /// Elements cannot leave the thread that made them, and an egui plugin must be able to: it keeps only a way here.
    static DOM: RefCell<Option<MirrorDom>> = const { RefCell::new(None) };
}

struct MirrorDom {
    document: Document,
    canvas: HtmlCanvasElement,
    root: HtmlElement,
    elements: HashMap<u64, HtmlElement>,
    focus: Option<u64>,
    // The browser calls these as long as the page lives.
    _listeners: Vec<Closure<dyn FnMut(web_sys::Event)>>,
}

/// Makes the root element; the answer applies changes to it.
pub(super) fn sink(
    ctx: egui::Context,
    canvas: HtmlCanvasElement,
    inbox: MirrorInbox,
    stop_now: fn(),
) -> MirrorSink {
    // Without a document there is nothing to mirror into, and nobody who could look.
    if let Ok(dom) = MirrorDom::new(&ctx, canvas, &inbox, stop_now) {
        DOM.with(|slot| *slot.borrow_mut() = Some(dom));
    }
    Box::new(move |changes, focus| {
        let zoom = ctx.zoom_factor();
        DOM.with(|slot| {
            if let Some(dom) = slot.borrow_mut().as_mut() {
                for change in changes {
                    // One element that the browser refuses must not take the others along.
                    let _ = dom.apply(change, zoom);
                }
                dom.show_focus(focus);
            }
        });
    })
}

impl MirrorDom {
    fn new(
        ctx: &egui::Context,
        canvas: HtmlCanvasElement,
        inbox: &MirrorInbox,
        stop_now: fn(),
    ) -> Result<Self, JsValue> {
        let document = canvas.owner_document().ok_or(JsValue::NULL)?;
        let style = document.create_element("style")?;
        style.set_text_content(Some(STYLE));
        document.head().ok_or(JsValue::NULL)?.append_child(&style)?;
        let root: HtmlElement = document.create_element("div")?.unchecked_into();
        root.set_id(ROOT_ID);
        canvas.parent_node().ok_or(JsValue::NULL)?.insert_before(&root, canvas.next_sibling().as_ref())?;
        // What is typed comes to the canvas through a field of eframe's, which stands after it and has no name.
        if let Some(field) = root.next_element_sibling().filter(|next| next.has_type::<HtmlInputElement>()) {
            field.set_attribute("aria-label", "Keyboard")?;
        }
        canvas.set_attribute("role", "application")?;
        canvas.set_attribute("aria-label", "Palpate")?;
        canvas.set_attribute("aria-owns", ROOT_ID)?;

        let mut listeners = Vec::new();
        let mut listen = |name: &str, handler: Box<dyn FnMut(web_sys::Event)>| -> Result<(), JsValue> {
            let closure = Closure::wrap(handler);
            root.add_event_listener_with_callback(name, closure.as_ref().unchecked_ref())?;
            listeners.push(closure);
            Ok(())
        };
        for name in ["pointerdown", "pointerup", "mousemove", "wheel"] {
            let (canvas, root) = (canvas.clone(), root.clone());
            listen(name, Box::new(move |event| hand_on(&event, &canvas, &root, stop_now)))?;
        }
        {
            let canvas = canvas.clone();
            // The browser would give the focus to the element, or take it from the canvas.
            listen(
                "mousedown",
                Box::new(move |event| {
                    event.prevent_default();
                    focus_canvas(&canvas);
                }),
            )?;
        }
        let deliver = {
            let (ctx, inbox) = (ctx.clone(), inbox.clone());
            move |event: MirrorEvent| {
                if let Ok(mut inbox) = inbox.lock() {
                    inbox.push(event);
                }
                ctx.request_repaint();
            }
        };
        {
            let deliver = deliver.clone();
            listen(
                "click",
                Box::new(move |event| {
                    // A pointer's click counts presses; egui has seen those already.
                    let by_pointer =
                        event.dyn_ref::<web_sys::MouseEvent>().is_some_and(|mouse| mouse.detail() > 0);
                    if let Some(id) = node_of(&event).filter(|_| !by_pointer) {
                        deliver(MirrorEvent::Click(id));
                    }
                }),
            )?;
        }
        {
            let (deliver, canvas) = (deliver.clone(), canvas.clone());
            listen(
                "focusin",
                Box::new(move |event| {
                    let Some(id) = node_of(&event) else { return };
                    deliver(MirrorEvent::Focus(id));
                    if !is_input(&event) {
                        focus_canvas(&canvas);
                    }
                }),
            )?;
        }
        {
            let (deliver, canvas) = (deliver.clone(), canvas.clone());
            listen(
                "input",
                Box::new(move |event| {
                    let Some(id) = node_of(&event) else { return };
                    let Some(input) =
                        event.target().and_then(|target| target.dyn_into::<HtmlInputElement>().ok())
                    else {
                        return;
                    };
                    if input.type_() == "text" {
                        deliver(MirrorEvent::SetText(id, input.value()));
                    } else if let Ok(value) = input.value().parse() {
                        deliver(MirrorEvent::SetNumber(id, value));
                        // A slider needs no caret: keys mean the page again.
                        focus_canvas(&canvas);
                    }
                }),
            )?;
        }
        {
            let canvas = canvas.clone();
            listen(
                "keydown",
                Box::new(move |event| {
                    let Some(keyboard) = event.dyn_ref::<web_sys::KeyboardEvent>() else { return };
                    let key = match keyboard.key().as_str() {
                        "Enter" => egui::Key::Enter,
                        "Escape" => egui::Key::Escape,
                        "Tab" => egui::Key::Tab,
                        "ArrowUp" => egui::Key::ArrowUp,
                        "ArrowDown" => egui::Key::ArrowDown,
                        _ => return,
                    };
                    event.prevent_default();
                    focus_canvas(&canvas);
                    let modifiers = egui::Modifiers { shift: keyboard.shift_key(), ..egui::Modifiers::NONE };
                    deliver(MirrorEvent::Key(key, modifiers));
                }),
            )?;
        }
        // Onto the mirror is not away from the canvas.
        let stay = {
            let root = root.clone();
            Closure::wrap(Box::new(move |event: web_sys::Event| {
                let to = event
                    .dyn_ref::<web_sys::MouseEvent>()
                    .and_then(web_sys::MouseEvent::related_target)
                    .and_then(|target| target.dyn_into::<web_sys::Node>().ok());
                if to.is_some_and(|to| root.contains(Some(&to))) {
                    event.stop_immediate_propagation();
                }
            }) as Box<dyn FnMut(web_sys::Event)>)
        };
        canvas.add_event_listener_with_callback_and_bool(
            "mouseleave",
            stay.as_ref().unchecked_ref(),
            true,
        )?;
        listeners.push(stay);
        Ok(Self { document, canvas, root, elements: HashMap::new(), focus: None, _listeners: listeners })
    }

    fn apply(&mut self, change: &Change, zoom: f32) -> Result<(), JsValue> {
        match change {
            Change::Remove(id) => {
                if let Some(element) = self.elements.remove(id) {
                    let had_focus = self.document.active_element().is_some_and(|active| active == *element);
                    element.remove();
                    if had_focus {
                        focus_canvas(&self.canvas);
                    }
                }
            }
            Change::Insert { node, after } => {
                let element = self.make(node)?;
                self.place(&element, *after)?;
                write(&element, node, zoom)?;
                self.elements.insert(node.id, element);
            }
            Change::Move { id, after } => {
                if let Some(element) = self.elements.get(id).cloned() {
                    self.place(&element, *after)?;
                }
            }
            Change::Update(node) => {
                if let Some(element) = self.elements.get(&node.id) {
                    write(element, node, zoom)?;
                }
            }
        }
        Ok(())
    }

    fn make(&self, node: &MirrorNode) -> Result<HtmlElement, JsValue> {
        let input_type = match node.element {
            Element::Text | Element::Box => None,
            Element::TextField => Some("text"),
            Element::Range => Some("range"),
            Element::Number => Some("number"),
        };
        let element: HtmlElement = match input_type {
            None => self.document.create_element("div")?.unchecked_into(),
            Some(input_type) => {
                let input: HtmlInputElement = self.document.create_element("input")?.unchecked_into();
                input.set_type(input_type);
                input.unchecked_into()
            }
        };
        element.set_id(&element_id(node.id));
        element.set_attribute("data-node", &node.id.to_string())?;
        if node.interactive {
            element.set_attribute("tabindex", "-1")?;
        }
        Ok(element)
    }

    fn place(&self, element: &HtmlElement, after: Option<u64>) -> Result<(), JsValue> {
        let next = match after.and_then(|id| self.elements.get(&id)) {
            Some(neighbour) => neighbour.next_sibling(),
            None => self.root.first_child(),
        };
        self.root.insert_before(element, next.as_ref()).map(|_| ())
    }

    /// Tells screen readers which element egui's focus is on, while the canvas holds the browser's.
    fn show_focus(&mut self, focus: Option<u64>) {
        if self.focus == focus {
            return;
        }
        self.focus = focus;
        let _ = match focus {
            Some(id) => self.canvas.set_attribute("aria-activedescendant", &element_id(id)),
            None => self.canvas.remove_attribute("aria-activedescendant"),
        };
    }
}

fn element_id(id: u64) -> String {
    format!("node-{id:x}")
}

fn write(element: &HtmlElement, node: &MirrorNode, zoom: f32) -> Result<(), JsValue> {
    let attribute = |name: &str, value: Option<&str>| match value {
        Some(value) => element.set_attribute(name, value),
        None => element.remove_attribute(name),
    };
    let word = |on: bool| if on { "true" } else { "false" };
    // Fields and sliders have their role by nature.
    let explicit_role = Some(node.role)
        .filter(|role| matches!(node.element, Element::Box | Element::Text) && !role.is_empty());
    attribute("role", explicit_role)?;
    attribute("aria-level", (node.role == "heading").then_some("2"))?;
    attribute("aria-label", Some(node.name.as_str()).filter(|name| !name.is_empty()))?;
    let owned: Vec<String> = node.owns.iter().map(|id| element_id(*id)).collect();
    attribute("aria-owns", Some(owned.join(" ")).as_deref().filter(|owned| !owned.is_empty()))?;
    attribute("aria-controls", node.controls.map(element_id).as_deref())?;
    attribute("aria-disabled", node.disabled.then_some("true"))?;
    attribute("aria-expanded", node.expanded.map(word))?;
    attribute("aria-selected", node.selected.map(word))?;
    let checked = node.checked.map(|checked| match checked {
        Checked::No => "false",
        Checked::Yes => "true",
        Checked::Mixed => "mixed",
    });
    let is_button = node.role == "button";
    attribute("aria-pressed", checked.filter(|_| is_button))?;
    attribute("aria-checked", checked.filter(|_| !is_button))?;

    match element.dyn_ref::<HtmlInputElement>() {
        Some(input) => {
            input.set_disabled(node.disabled);
            if let Some(number) = node.number {
                let text = |value: Option<f64>| value.map(|value| value.to_string());
                attribute("min", text(number.min).as_deref())?;
                attribute("max", text(number.max).as_deref())?;
                // A browser rounds to steps counted from `min`; egui rounds as it sees fit.
                attribute("step", Some("any"))?;
                set_input(input, &number.value.to_string());
            } else {
                set_input(input, &node.text);
            }
        }
        None => {
            if let Some(number) = node.number {
                attribute("aria-valuenow", Some(&number.value.to_string()))?;
                attribute("aria-valuemin", number.min.map(|value| value.to_string()).as_deref())?;
                attribute("aria-valuemax", number.max.map(|value| value.to_string()).as_deref())?;
            }
            // A button or a picture is called by its name; what it shows beside is read out after it.
            let is_beside = matches!(node.role, "button" | "img") && !node.name.is_empty();
            let (text, beside) = if is_beside { ("", node.text.as_str()) } else { (node.text.as_str(), "") };
            attribute("aria-description", Some(beside).filter(|beside| !beside.is_empty()))?;
            element.set_text_content(Some(text));
        }
    }

    let style = element.style();
    let [x, y, width, height] = node.rect.unwrap_or([0.0, 0.0, 1.0, 1.0]).map(|value| value * zoom);
    style.set_property("transform", &format!("translate({x}px, {y}px)"))?;
    style.set_property("width", &format!("{width}px"))?;
    style.set_property("height", &format!("{height}px"))?;
    style.set_property("z-index", &node.layer.to_string())?;
    let on = node.interactive && node.rect.is_some();
    element.set_class_name(if on { "on" } else { "" });
    Ok(())
}

/// Setting an equal value would move the caret of whoever types.
fn set_input(input: &HtmlInputElement, value: &str) {
    if input.value() != value {
        input.set_value(value);
    }
}

fn node_of(event: &web_sys::Event) -> Option<u64> {
    let element = event.target()?.dyn_into::<web_sys::Element>().ok()?;
    element.get_attribute("data-node")?.parse().ok()
}

/// Whether the main button, a finger or a pen came down on STOP.
fn is_stop(event: &web_sys::Event) -> bool {
    let main = event.dyn_ref::<web_sys::MouseEvent>().is_some_and(|mouse| mouse.button() == 0);
    let element = event.target().and_then(|target| target.dyn_into::<web_sys::Element>().ok());
    main && element
        .and_then(|element| element.get_attribute("aria-label"))
        .is_some_and(|name| name == crate::app::STOP_NAME)
}

fn is_input(event: &web_sys::Event) -> bool {
    event.target().is_some_and(|target| target.has_type::<HtmlInputElement>())
}

fn focus_canvas(canvas: &HtmlCanvasElement) {
    let options = web_sys::FocusOptions::new();
    options.set_prevent_scroll(true);
    // Fails only for an element that cannot be focused; a canvas with a tab index can.
    let _ = canvas.focus_with_options(&options);
}

/// Repeats a pointer's event on the canvas, out of the mirror's way.
fn hand_on(event: &web_sys::Event, canvas: &HtmlCanvasElement, root: &HtmlElement, stop_now: fn()) {
    if !event.is_trusted() {
        return;
    }
    // A page that draws slowly must not keep a stop waiting for its next frame.
    if event.type_() == "pointerdown" && is_stop(event) {
        stop_now();
    }
    event.stop_propagation();
    if event.type_() == "wheel" {
        event.prevent_default();
    }
    let Ok(copy) = copy_of(event) else { return };
    // eframe asks the document what lies under the pointer: it must be the canvas while it asks. Otherwise it would take
    // no release of a press that still waits for its frame.
    root.set_class_name("through");
    let _ = canvas.dispatch_event(&copy);
    root.set_class_name("");
}

fn copy_of(event: &web_sys::Event) -> Result<web_sys::Event, JsValue> {
    // Every constructor takes the event itself as its dictionary: the names are the same, inherited ones included.
    let init: &JsValue = event.as_ref();
    let name = event.type_();
    Ok(match name.as_str() {
        "wheel" => web_sys::WheelEvent::new_with_event_init_dict(&name, init.unchecked_ref())?.into(),
        "pointerdown" | "pointerup" => {
            web_sys::PointerEvent::new_with_event_init_dict(&name, init.unchecked_ref())?.into()
        }
        _ => web_sys::MouseEvent::new_with_mouse_event_init_dict(&name, init.unchecked_ref())?.into(),
    })
}
