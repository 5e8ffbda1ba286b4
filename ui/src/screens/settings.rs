//! Settings: people, API tokens, storage, the audit log. It shows what whoever sits here may see, and says what it hides.

mod audit;
mod people;
mod storage;
mod tokens;

use palpate_wire::api::{Me, Via};

use super::{About, ScreenContext, Subject, View, loaded_ui, topic_heading_ui};
use crate::route::{Route, Screen};

/// This screen.
pub const ABOUT: About = About {
    label: "Settings",
    slug: "settings",
    key: None,
    icon: "\u{2699}",
    purpose: "People, API tokens, storage, the audit log",
    group: None,
    document: ("people", None),
    subject: Subject::Other,
    needs_station: false,
    shows_stream: false,
    new: || Box::<SettingsState>::default(),
};

/// What was written on this screen and not sent.
#[derive(Debug, Default)]
struct SettingsState {
    people: people::PeopleState,
    tokens: tokens::TokensState,
    audit: audit::AuditState,
}

/// The parts of the screen, with their slugs.
const PARTS: [(&str, &str); 4] =
    [("people", "People"), ("tokens", "API tokens"), ("storage", "Storage"), ("audit", "Audit log")];

impl View for SettingsState {
    fn ui(&mut self, ui: &mut egui::Ui, cx: &mut ScreenContext<'_>) {
        let me = cx.store.people.me();
        let Some(me) = loaded_ui(ui, cx, me, "Asking who you are", "Who you are did not arrive") else {
            return;
        };
        let part = cx.route.part.clone().unwrap_or_default();
        let part = PARTS.iter().map(|(slug, _)| *slug).find(|slug| *slug == part).unwrap_or("people");
        ui.add_space(4.0);
        topic_heading_ui(ui, "Settings", Screen::Settings);
        me_ui(ui, cx, &me);
        ui.horizontal_wrapped(|ui| {
            for (slug, label) in PARTS {
                let is_chosen = slug == part;
                let response =
                    ui.add(egui::Button::selectable(is_chosen, label).min_size(egui::vec2(72.0, 34.0)));
                response.widget_info(|| {
                    egui::WidgetInfo::selected(egui::accesskit::Role::Tab, true, is_chosen, label)
                });
                if response.clicked() {
                    *cx.go_to = Some(Route { part: Some(slug.to_owned()), ..Route::to(Screen::Settings) });
                }
            }
        });
        ui.separator();
        if let Some(problem) = cx.store.people.problem.clone() {
            ui.horizontal_wrapped(|ui| {
                ui.colored_label(cx.palette.mismatch, format!("\u{26a0} {problem}"));
                if ui.button("Dismiss").clicked() {
                    cx.store.people.problem = None;
                }
            });
        }
        egui::ScrollArea::vertical().id_salt(part).auto_shrink(false).show(ui, |ui| {
            match part {
                "tokens" => tokens::tokens_ui(ui, cx, &mut self.tokens, &me),
                "storage" => storage::storage_ui(ui, cx),
                "audit" => audit::audit_ui(ui, cx, &mut self.audit),
                _ => people::people_ui(ui, cx, &mut self.people, &me),
            }
            ui.add_space(12.0);
        });
    }
}

/// Who sits here, as the server sees it.
fn me_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, me: &Me) {
    if me.via != Via::Local {
        ui.horizontal_wrapped(|ui| {
            ui.label(format!("You are {} ({}).", me.name, me.role));
            ui.hyperlink_to("Log out", "/logout");
        });
        return;
    }
    if cx.store.info.ready().is_some_and(|info| info.insecure) {
        let text = "There is no login (--insecure): whoever reaches this studio over the network may do everything. Start \
            it without --insecure to have people log in.";
        ui.colored_label(cx.palette.mismatch, format!("\u{26a0} {text}"));
        return;
    }
    ui.label(
        "There is no login: this studio can be reached from its own computer only, and whoever sits there may do \
         everything. People and tokens count once it is started with --login, or so that others can reach it.",
    );
}
