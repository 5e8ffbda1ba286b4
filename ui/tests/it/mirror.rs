//! The mirror's plugin in a running page: what it shows, and what comes back.

use std::sync::{Arc, Mutex};

use egui_kittest::Harness;
use palpate_ui::mirror::{
    MirrorEvent, MirrorInbox, MirrorPlugin,
    model::{Change, MirrorNode},
};

#[derive(Default)]
struct Form {
    presses: usize,
    share: f64,
    name: String,
    town: String,
    on: bool,
    is_locked: bool,
}

type Seen = Arc<Mutex<Vec<MirrorNode>>>;

/// A form with the mirror over it, and the elements as a browser would hold them.
fn form() -> (Harness<'static, Form>, MirrorInbox, Seen) {
    let (inbox, seen) = (MirrorInbox::default(), Seen::default());
    let plugin = {
        let (inbox, seen) = (inbox.clone(), seen.clone());
        move |ctx: &egui::Context| {
            let sink = move |changes: &[Change], _focus: Option<u64>| {
                let mut seen = seen.lock().expect("no panic so far");
                for change in changes {
                    match change {
                        Change::Remove(id) => seen.retain(|node| node.id != *id),
                        Change::Insert { node, .. } => seen.push(node.clone()),
                        Change::Move { .. } => {}
                        Change::Update(node) => {
                            let known = seen.iter_mut().find(|known| known.id == node.id);
                            known.expect("updates what was inserted").clone_from(node);
                        }
                    }
                }
            };
            ctx.enable_accesskit();
            ctx.add_plugin(MirrorPlugin::new(inbox, Box::new(sink)));
        }
    };
    let mut harness = Harness::builder().with_context_setup(plugin).build_ui_state(
        |ui, form: &mut Form| {
            if ui.button("Press me").clicked() {
                form.presses += 1;
            }
            ui.checkbox(&mut form.on, "Switch");
            ui.add(egui::Slider::new(&mut form.share, 0.0..=10.0).text("Share"));
            let label = ui.label("Your name");
            let name = egui::TextEdit::singleline(&mut form.name).interactive(!form.is_locked);
            ui.add(name).labelled_by(label.id);
            let label = ui.label("Your town");
            ui.text_edit_singleline(&mut form.town).labelled_by(label.id);
        },
        Form::default(),
    );
    harness.run_steps(2);
    (harness, inbox, seen)
}

fn find(seen: &Seen, role: &str, name: &str) -> MirrorNode {
    let seen = seen.lock().expect("no panic so far");
    let found: Vec<_> = seen.iter().filter(|node| node.role == role && node.name == name).collect();
    assert_eq!(found.len(), 1, "{role} {name:?} among {seen:#?}");
    found[0].clone()
}

/// Writes into an element, as whoever fills a field does before the page hears of it.
fn write(seen: &Seen, id: u64, text: &str) {
    for node in seen.lock().expect("no panic so far").iter_mut().filter(|node| node.id == id) {
        text.clone_into(&mut node.text);
    }
}

#[test]
fn controls_have_roles_names_and_places() {
    let (_harness, _inbox, seen) = form();
    for (role, name) in
        [("button", "Press me"), ("checkbox", "Switch"), ("slider", "Share"), ("textbox", "Your name")]
    {
        let node = find(&seen, role, name);
        assert!(node.interactive && node.rect.is_some(), "{node:?}");
    }
    assert_eq!(find(&seen, "slider", "Share").number.map(|number| number.max), Some(Some(10.0)));
}

#[test]
fn click_number_and_text_reach_the_widgets() {
    let (mut harness, inbox, seen) = form();
    let send = |event| inbox.lock().expect("no panic so far").push(event);
    send(MirrorEvent::Click(find(&seen, "button", "Press me").id));
    send(MirrorEvent::Click(find(&seen, "checkbox", "Switch").id));
    send(MirrorEvent::SetNumber(find(&seen, "slider", "Share").id, 7.5));
    harness.run_steps(3);
    assert_eq!((harness.state().presses, harness.state().on, harness.state().share), (1, true, 7.5));

    let field = find(&seen, "textbox", "Your name").id;
    send(MirrorEvent::SetText(field, "Ada".into()));
    harness.run_steps(5);
    assert_eq!(harness.state().name, "Ada");
    write(&seen, field, "Grace");
    send(MirrorEvent::SetText(field, "Grace".into()));
    harness.run_steps(5);
    assert_eq!(harness.state().name, "Grace");
    assert_eq!(find(&seen, "textbox", "Your name").text, "Grace");
    send(MirrorEvent::SetText(field, String::new()));
    harness.run_steps(5);
    assert_eq!(harness.state().name, "");
}

#[test]
fn fields_that_are_filled_within_one_frame_both_get_their_text() {
    let (mut harness, inbox, seen) = form();
    let [name, town] = ["Your name", "Your town"].map(|label| find(&seen, "textbox", label).id);
    let texts = [(name, "A"), (town, "Paris"), (name, "Ada")];
    let events = texts.map(|(field, text)| MirrorEvent::SetText(field, text.to_owned()));
    inbox.lock().expect("no panic so far").extend(events);
    harness.run_steps(10);
    assert_eq!((harness.state().name.as_str(), harness.state().town.as_str()), ("Ada", "Paris"));
}

#[test]
fn a_field_gets_its_text_before_what_was_pressed_after_it() {
    // The button is pressed in the frame that fills the field, in the one after it, and so on.
    for num_frames_between in 0..4 {
        let (mut harness, inbox, seen) = form();
        let town = find(&seen, "textbox", "Your town").id;
        let [left, top, width, height] = find(&seen, "button", "Press me").rect.expect("a place");
        let text = MirrorEvent::SetText(town, "Paris".to_owned());
        inbox.lock().expect("no panic so far").push(text);
        harness.run_steps(num_frames_between);
        let pos = egui::pos2(left + width / 2.0, top + height / 2.0);
        // All within one frame, as a page gets it that draws slowly.
        let events = &mut harness.input_mut().events;
        events.push(egui::Event::PointerMoved(pos));
        for pressed in [true, false] {
            let (button, modifiers) = (egui::PointerButton::Primary, egui::Modifiers::NONE);
            events.push(egui::Event::PointerButton { pos, button, pressed, modifiers });
        }
        harness.run_steps(6);
        let form = harness.state();
        assert_eq!((form.town.as_str(), form.presses), ("Paris", 1), "{num_frames_between} frames");
    }
}

#[test]
fn the_end_of_a_press_waits_for_no_text() {
    let (mut harness, inbox, seen) = form();
    let [left, top, width, height] = find(&seen, "button", "Press me").rect.expect("a place");
    let pos = egui::pos2(left + width / 2.0, top + height / 2.0);
    let button = |pressed| {
        let (button, modifiers) = (egui::PointerButton::Primary, egui::Modifiers::NONE);
        egui::Event::PointerButton { pos, button, pressed, modifiers }
    };
    harness.input_mut().events.extend([egui::Event::PointerMoved(pos), button(true)]);
    harness.run_steps(1);
    let town = find(&seen, "textbox", "Your town").id;
    inbox.lock().expect("no panic so far").push(MirrorEvent::SetText(town, "Paris".to_owned()));
    harness.input_mut().events.push(button(false));
    harness.run_steps(1);
    assert!(!harness.ctx.input(|input| input.pointer.any_down()));
    harness.run_steps(6);
    let form = harness.state();
    assert_eq!((form.town.as_str(), form.presses), ("Paris", 1));
}

#[test]
fn a_field_that_takes_no_text_shows_what_it_has() {
    let (mut harness, inbox, seen) = form();
    harness.state_mut().is_locked = true;
    let name = find(&seen, "textbox", "Your name").id;
    inbox.lock().expect("no panic so far").push(MirrorEvent::SetText(name, "Ada".to_owned()));
    // As in a browser, where the element has the text before the page knows.
    let mut was_put_back = false;
    for _ in 0..20 {
        write(&seen, name, "Ada");
        harness.run_steps(1);
        was_put_back |= find(&seen, "textbox", "Your name").text.is_empty();
    }
    assert!(was_put_back);
    assert_eq!(harness.state().name, "");
}

#[test]
fn quiet_page_costs_no_changes() {
    let (mut harness, _inbox, seen) = form();
    let before = seen.lock().expect("no panic so far").clone();
    harness.run_steps(3);
    assert_eq!(*seen.lock().expect("no panic so far"), before);
}
