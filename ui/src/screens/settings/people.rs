//! People: who may log in, with which role.

use egui::{RichText, accesskit::Role as Accessible};
use palpate_wire::api::{Me, NewPerson, Person, Role, Scope, Via};

use crate::screens::{
    ScreenContext,
    controls::{combo_ui, option_ui},
    loaded_ui,
};

/// As the server asks for.
const MIN_PASSWORD: usize = 10;
const MAX_NAME: usize = 32;

/// The form.
#[derive(Debug)]
pub(super) struct PeopleState {
    name: String,
    role: Role,
    password: String,
    /// Removing was asked for and waits for a second press.
    removing: Option<String>,
}

impl Default for PeopleState {
    fn default() -> Self {
        Self { name: String::new(), role: Role::Viewer, password: String::new(), removing: None }
    }
}

/// What a role may, in words.
pub(super) fn may(role: Role) -> &'static str {
    match role {
        Role::Viewer => "sees everything, and may press STOP",
        Role::Scorer => "also scores trials",
        Role::Operator => "also takes control, records, starts jobs, changes and deletes data",
        Role::Admin => "also adds and removes people",
    }
}

pub(super) fn people_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, state: &mut PeopleState, me: &Me) {
    if !cx.store.people.may(Role::Admin, Scope::People) {
        ui.label(format!("People are managed by admins. Your role is {}: it {}.", me.role, may(me.role)));
        return;
    }
    let people = cx.store.people.people();
    let Some(people) = loaded_ui(ui, cx, people, "Looking for people", "The list of people did not arrive")
    else {
        return;
    };
    if people.is_empty() {
        ui.label("Nobody can log in yet. Add an admin first: without one, nobody could add others.");
    } else {
        egui::ScrollArea::horizontal().id_salt("people").show(ui, |ui| {
            egui::Grid::new("people").striped(true).num_columns(5).spacing([18.0, 4.0]).show(ui, |ui| {
                for name in ["Name", "Role", "Added", "Logged in last", ""] {
                    ui.label(RichText::new(name).color(cx.palette.text_weak));
                }
                ui.end_row();
                for person in people.iter() {
                    person_ui(ui, cx, state, me, person);
                    ui.end_row();
                }
            });
        });
    }
    ui.add_space(12.0);
    add_ui(ui, cx, state);
    ui.add_space(8.0);
    for role in Role::ALL {
        ui.label(RichText::new(format!("{role}: {}", may(role))).color(cx.palette.text_weak));
    }
}

fn person_ui(
    ui: &mut egui::Ui,
    cx: &mut ScreenContext<'_>,
    state: &mut PeopleState,
    me: &Me,
    person: &Person,
) {
    let time = |text: &str| (cx.local_time)(text).unwrap_or_else(|| text.to_owned());
    let (created, last) = (time(&person.created), person.last_login.as_deref().map(time));
    ui.label(&person.name);
    let mut role = person.role;
    ui.add_enabled_ui(!cx.store.people.is_busy, |ui| {
        combo_ui(ui, &format!("Role of {}", person.name), role.name(), 100.0, |ui| {
            for known in Role::ALL {
                option_ui(ui, &mut role, known, known.name());
            }
        });
    });
    if role != person.role {
        cx.store.people.set_role(&person.name, role);
    }
    ui.label(created);
    ui.label(last.unwrap_or_else(|| "never".to_owned()));
    ui.horizontal(|ui| {
        if me.via != Via::Local && me.name == person.name {
            ui.label(RichText::new("you").color(cx.palette.text_weak));
        } else if state.removing.as_deref() == Some(person.name.as_str()) {
            if ui.button(format!("Yes, remove {}", person.name)).clicked() {
                state.removing = None;
                cx.store.people.remove(&person.name);
            }
            if ui.button("Keep").clicked() {
                state.removing = None;
            }
        } else {
            let remove = ui.button("Remove").on_hover_text("Ends their logins and tokens; cannot be undone");
            remove.widget_info(|| {
                egui::WidgetInfo::labeled(Accessible::Button, true, format!("Remove {}", person.name))
            });
            if remove.clicked() {
                state.removing = Some(person.name.clone());
            }
        }
    });
}

fn add_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, state: &mut PeopleState) {
    ui.strong("Add somebody");
    egui::Grid::new("add_person").num_columns(2).spacing([14.0, 6.0]).show(ui, |ui| {
        let label = ui.label("Name");
        let field = egui::TextEdit::singleline(&mut state.name).desired_width(220.0).char_limit(MAX_NAME);
        ui.add(field.hint_text("a-z, 0-9, dot, dash")).labelled_by(label.id);
        ui.end_row();
        ui.label("Role");
        combo_ui(ui, "Role of the new person", state.role.name(), 120.0, |ui| {
            for known in Role::ALL {
                option_ui(ui, &mut state.role, known, known.name());
            }
        });
        ui.end_row();
        let label = ui.label("Password");
        let field = egui::TextEdit::singleline(&mut state.password).desired_width(220.0).password(true);
        ui.add(field.hint_text(format!("at least {MIN_PASSWORD} characters"))).labelled_by(label.id);
        ui.end_row();
    });
    let missing = missing(&state.name, &state.password);
    let ready = missing.is_none() && !cx.store.people.is_busy;
    if ui.add_enabled(ready, egui::Button::new("Add")).clicked() {
        let (name, password) = (std::mem::take(&mut state.name), std::mem::take(&mut state.password));
        cx.store.people.add(NewPerson { name, role: state.role, password });
    }
    if let Some(missing) = missing {
        ui.label(RichText::new(missing).color(cx.palette.text_weak));
    }
}

/// What has to be filled in still, as the server asks for it.
fn missing(name: &str, password: &str) -> Option<String> {
    let mut letters = name.chars();
    let begins = letters.next().is_some_and(|c| c.is_ascii_lowercase() || c.is_ascii_digit());
    let goes_on =
        letters.all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || matches!(c, '.' | '-' | '_'));
    if !begins || !goes_on {
        return Some(
            "A name has a-z, 0-9, dot, dash and underscore, and begins with a letter or digit.".into(),
        );
    }
    (password.chars().count() < MIN_PASSWORD)
        .then(|| format!("A password has at least {MIN_PASSWORD} characters."))
}

#[cfg(test)]
mod tests {
    use super::missing;

    #[test]
    fn names_and_passwords_are_asked_for_as_the_server_takes_them() {
        let password = "correct horse";
        for name in ["ada", "0x", "a.b-c_d"] {
            assert_eq!(missing(name, password), None, "{name}");
        }
        for name in ["", "Ada", "-ada", "a b", "\u{e4}da"] {
            assert!(missing(name, password).is_some(), "{name}");
        }
        assert!(missing("ada", "short").is_some_and(|text| text.contains("10 characters")));
    }
}
