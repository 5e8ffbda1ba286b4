//! One press a frame. egui looks once a frame what lies under the pointer, and gives all presses of that frame to it: on a
//! page that draws slowly, of two quick clicks the first would be lost, and a drag would begin where it ended.

use std::collections::VecDeque;

use egui::{Event, Key, RawInput};

/// Lets through what a pointer does up to its next place or press, and the rest in the frames that follow, in order.
#[derive(Debug, Default)]
pub struct PressPacing {
    held: VecDeque<Event>,
}

impl PressPacing {
    fn pace(&mut self, input: &mut RawInput) {
        // The key of STOP waits for nothing.
        let (urgent, new): (Vec<Event>, Vec<Event>) =
            std::mem::take(&mut input.events).into_iter().partition(is_stop_key);
        self.held.extend(new);
        input.events = urgent;
        let mut was_pressed = false;
        while let Some(event) = self.held.pop_front() {
            if was_pressed && begins_elsewhere(&event) {
                self.held.push_front(event);
                return;
            }
            was_pressed |= matches!(event, Event::PointerButton { .. });
            input.events.push(event);
        }
    }
}

impl egui::Plugin for PressPacing {
    fn debug_name(&self) -> &'static str {
        "press pacing"
    }

    fn input_hook(&mut self, ctx: &egui::Context, input: &mut RawInput) {
        self.pace(input);
        if !self.held.is_empty() {
            ctx.request_repaint();
        }
    }
}

fn is_stop_key(event: &Event) -> bool {
    matches!(event, Event::Key { key: Key::Space, .. })
}

/// Whether the pointer leaves where it was, or presses anew.
fn begins_elsewhere(event: &Event) -> bool {
    use egui::TouchPhase::Start;
    matches!(
        event,
        Event::PointerMoved(_)
            | Event::PointerGone
            | Event::PointerButton { pressed: true, .. }
            | Event::Touch { phase: Start, .. }
    )
}

#[cfg(test)]
mod tests {
    use egui::{Modifiers, PointerButton, Pos2, pos2};
    use egui_kittest::{Harness, kittest::Queryable as _};

    use super::*;

    #[derive(Default)]
    struct Page {
        switches: [bool; 2],
        dragged: [f32; 2],
    }

    fn page() -> Harness<'static, Page> {
        let plugin = |ctx: &egui::Context| ctx.add_plugin(PressPacing::default());
        let mut harness = Harness::builder().with_context_setup(plugin).build_ui_state(
            |ui, page: &mut Page| {
                for (idx, (on, dragged)) in page.switches.iter_mut().zip(&mut page.dragged).enumerate() {
                    ui.checkbox(on, format!("Switch {idx}"));
                    let handle =
                        ui.add(egui::Button::new(format!("Handle {idx}")).sense(egui::Sense::drag()));
                    *dragged += handle.drag_delta().x;
                }
            },
            Page::default(),
        );
        harness.run_steps(2);
        harness
    }

    fn center(harness: &Harness<'_, Page>, label: &str) -> Pos2 {
        harness.get_by_label(label).rect().center()
    }

    fn button(pos: Pos2, pressed: bool) -> Event {
        Event::PointerButton { pos, button: PointerButton::Primary, pressed, modifiers: Modifiers::NONE }
    }

    #[test]
    fn clicks_of_one_slow_frame_reach_what_they_were_on() {
        let mut harness = page();
        for label in ["Switch 0", "Switch 1"] {
            let pos = center(&harness, label);
            let click = [Event::PointerMoved(pos), button(pos, true), button(pos, false)];
            harness.input_mut().events.extend(click);
        }
        harness.run_steps(3);
        assert_eq!(harness.state().switches, [true, true]);
        // Twice on the same place is on and off again.
        let pos = center(&harness, "Switch 1");
        for pressed in [true, false, true, false] {
            harness.input_mut().events.push(button(pos, pressed));
        }
        harness.run_steps(3);
        assert_eq!(harness.state().switches, [true, true]);
    }

    #[test]
    fn a_drag_of_one_slow_frame_begins_where_it_was_pressed() {
        let mut harness = page();
        let [from, to] = ["Handle 0", "Handle 1"].map(|label| center(&harness, label));
        let to = pos2(to.x + 100.0, to.y);
        let drag = [Event::PointerMoved(from), button(from, true), Event::PointerMoved(to)];
        harness.input_mut().events.extend(drag);
        harness.run_steps(2);
        harness.input_mut().events.push(button(to, false));
        harness.run_steps(2);
        let [first, second] = harness.state().dragged;
        assert!((first - (to.x - from.x)).abs() < 1.0 && second == 0.0, "{first} {second}");
    }

    #[test]
    fn the_key_of_stop_does_not_wait() {
        let (mut pacing, mut input) = (PressPacing::default(), RawInput::default());
        let key = |key| Event::Key {
            key,
            physical_key: None,
            pressed: true,
            repeat: false,
            modifiers: Modifiers::NONE,
        };
        for x in [1.0, 2.0, 3.0] {
            let pos = pos2(x, 0.0);
            input.events.extend([Event::PointerMoved(pos), button(pos, true), button(pos, false)]);
        }
        input.events.extend([key(Key::Space), key(Key::A)]);
        let mut frames = Vec::new();
        loop {
            pacing.pace(&mut input);
            if input.events.is_empty() {
                break;
            }
            frames.push(std::mem::take(&mut input.events));
        }
        assert_eq!(frames.iter().map(Vec::len).collect::<Vec<_>>(), [4, 3, 4]);
        assert_eq!(frames[0][0], key(Key::Space));
        assert_eq!(frames[2][3], key(Key::A));
    }
}
