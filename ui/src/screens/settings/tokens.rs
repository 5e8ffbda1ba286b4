//! API tokens: what scripts show instead of a password.

use std::collections::BTreeSet;

use egui::{RichText, accesskit::Role as Accessible};
use palpate_wire::api::{Me, NewToken, Role, Scope, Token, Via};

use crate::screens::{
    ScreenContext,
    controls::{combo_ui, option_ui},
    loaded_ui,
};

/// Days that a token is good for, at most and unless somebody says otherwise.
const MAX_DAYS: u32 = 730;
const DEFAULT_DAYS: u32 = 90;

/// The form.
#[derive(Debug)]
pub(super) struct TokensState {
    name: String,
    /// In whose name it acts; empty for oneself.
    person: String,
    role: Role,
    scopes: BTreeSet<Scope>,
    days: u32,
    /// Revoking was asked for and waits for a second press.
    revoking: Option<u64>,
}

impl Default for TokensState {
    fn default() -> Self {
        Self {
            name: String::new(),
            person: String::new(),
            role: Role::Viewer,
            scopes: [Scope::Read].into(),
            days: DEFAULT_DAYS,
            revoking: None,
        }
    }
}

pub(super) fn tokens_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, state: &mut TokensState, me: &Me) {
    if !cx.store.people.may(Role::Viewer, Scope::People) {
        ui.label("What you are logged in with is not good for tokens.");
        return;
    }
    ui.label(
        RichText::new("A script sends a token instead of a password. It acts in a person's name, and may never do more.")
            .color(cx.palette.text_weak),
    );
    created_ui(ui, cx);
    let tokens = cx.store.people.tokens();
    let Some(tokens) = loaded_ui(ui, cx, tokens, "Looking for tokens", "The list of tokens did not arrive")
    else {
        return;
    };
    if tokens.is_empty() {
        ui.label("There is no token yet.");
    } else {
        egui::ScrollArea::horizontal().id_salt("tokens").show(ui, |ui| {
            egui::Grid::new("tokens").striped(true).num_columns(7).spacing([18.0, 4.0]).show(ui, |ui| {
                for name in ["Name", "Acts as", "Role", "Good for", "Ends", "Used last", ""] {
                    ui.label(RichText::new(name).color(cx.palette.text_weak));
                }
                ui.end_row();
                for token in tokens.iter() {
                    token_ui(ui, cx, state, token);
                    ui.end_row();
                }
            });
        });
    }
    ui.add_space(12.0);
    make_ui(ui, cx, state, me);
}

/// The secret of the token that was just made, once.
fn created_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>) {
    let Some(created) = cx.store.people.created.clone() else { return };
    egui::Frame::group(ui.style()).fill(cx.palette.surface).show(ui, |ui| {
        ui.strong(format!("Token {:?} is made. It is shown now and never again.", created.token.name));
        ui.add(egui::Label::new(RichText::new(&created.secret).monospace()).wrap().selectable(true));
        ui.horizontal_wrapped(|ui| {
            if ui.button("Copy the token").clicked() {
                ui.ctx().copy_text(created.secret.clone());
            }
            if ui.button("I have kept it").clicked() {
                cx.store.people.forget_created();
            }
        });
    });
    ui.add_space(8.0);
}

fn token_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, state: &mut TokensState, token: &Token) {
    let time = |text: &str| (cx.local_time)(text).unwrap_or_else(|| text.to_owned());
    ui.label(&token.name);
    ui.label(&token.person);
    ui.label(token.role.name());
    let scopes: Vec<&str> = token.scopes.iter().map(|scope| scope.name()).collect();
    ui.label(scopes.join(", "));
    ui.label(time(&token.expires));
    ui.label(token.last_used.as_deref().map_or_else(|| "never".to_owned(), time));
    ui.horizontal(|ui| {
        if state.revoking == Some(token.id) {
            if ui.button(format!("Yes, revoke {}", token.name)).clicked() {
                state.revoking = None;
                cx.store.people.revoke_token(token.id);
            }
            if ui.button("Keep").clicked() {
                state.revoking = None;
            }
        } else {
            let revoke = ui.button("Revoke").on_hover_text("It ends now; cannot be undone");
            revoke.widget_info(|| {
                egui::WidgetInfo::labeled(Accessible::Button, true, format!("Revoke {}", token.name))
            });
            if revoke.clicked() {
                state.revoking = Some(token.id);
            }
        }
    });
}

fn make_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, state: &mut TokensState, me: &Me) {
    ui.strong("Make a token");
    // Only admins act in other names; who is not logged in has none of their own.
    let people = if cx.store.people.may(Role::Admin, Scope::People) {
        cx.store.people.people().ready().cloned().unwrap_or_default()
    } else {
        Default::default()
    };
    let most = people.iter().find(|person| person.name == state.person).map_or(me.role, |person| person.role);
    state.role = state.role.min(most);
    egui::Grid::new("make_token").num_columns(2).spacing([14.0, 6.0]).show(ui, |ui| {
        let label = ui.label("What for");
        let field = egui::TextEdit::singleline(&mut state.name).desired_width(240.0).char_limit(64);
        ui.add(field.hint_text("e.g. nightly jobs")).labelled_by(label.id);
        ui.end_row();
        if !people.is_empty() {
            ui.label("Acts as");
            let own = if me.via == Via::Local { "choose somebody" } else { me.name.as_str() };
            let chosen = if state.person.is_empty() { own.to_owned() } else { state.person.clone() };
            combo_ui(ui, "In whose name the token acts", &chosen, 160.0, |ui| {
                for person in people.iter() {
                    option_ui(ui, &mut state.person, person.name.clone(), &person.name);
                }
            });
            ui.end_row();
        }
        ui.label("Role");
        combo_ui(ui, "Role of the token", state.role.name(), 120.0, |ui| {
            for known in Role::ALL.into_iter().filter(|role| *role <= most) {
                option_ui(ui, &mut state.role, known, known.name());
            }
        });
        ui.end_row();
        ui.label("Good for");
        ui.horizontal_wrapped(|ui| {
            for scope in Scope::ALL {
                let mut chosen = state.scopes.contains(&scope);
                if ui.checkbox(&mut chosen, scope.name()).changed() {
                    if chosen {
                        state.scopes.insert(scope)
                    } else {
                        state.scopes.remove(&scope)
                    };
                }
            }
        });
        ui.end_row();
        let label = ui.label("Ends after");
        ui.add(egui::DragValue::new(&mut state.days).range(1..=MAX_DAYS).suffix(" days"))
            .labelled_by(label.id);
        ui.end_row();
    });
    let missing = if state.name.trim().is_empty() {
        Some("Say what it is for.")
    } else if state.scopes.is_empty() {
        Some("Tick what it is good for.")
    } else if me.via == Via::Local && people.is_empty() {
        Some("A token acts in a person's name, and there is nobody yet: add somebody under People.")
    } else if me.via == Via::Local && state.person.is_empty() {
        Some("Choose in whose name it acts.")
    } else {
        None
    };
    let ready = missing.is_none() && !cx.store.people.is_busy && cx.store.people.created.is_none();
    if ui.add_enabled(ready, egui::Button::new("Make the token")).clicked() {
        cx.store.people.create_token(NewToken {
            name: std::mem::take(&mut state.name).trim().to_owned(),
            person: Some(state.person.clone()).filter(|person| !person.is_empty()),
            role: Some(state.role),
            scopes: Some(state.scopes.iter().copied().collect()),
            expires_days: Some(state.days),
        });
    }
    if let Some(missing) = missing {
        ui.label(RichText::new(missing).color(cx.palette.text_weak));
    }
}
