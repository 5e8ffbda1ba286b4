//! Sessions: what has been recorded, whether it can be used, and bringing in more.

mod check;
mod deleted;
mod import;

use egui::RichText;
use palpate_wire::api::{ArtifactKey, ArtifactSort, SessionDetail, SessionSummary};

use super::{
    About, Part, ScreenContext, Subject, View, controls::file_link_ui, duration_text, heading_ui, loaded_ui,
    missing_session_ui, sessions_ui, two_parts_ui, words,
};
use crate::{
    route::{Route, Screen},
    store::Loadable,
};

/// This screen.
pub const ABOUT: About = About {
    label: "Sessions",
    slug: "sessions",
    key: Some(egui::Key::Num4),
    icon: "\u{1f5c0}",
    purpose: "What has been recorded, and whether it can be used",
    group: Some("Data"),
    document: ("recordings", None),
    subject: Subject::Session,
    needs_station: false,
    shows_stream: false,
    new: || Box::<SessionsState>::default(),
};

/// What the operator chose on this screen.
#[derive(Debug, Default)]
struct SessionsState {
    import: import::ImportState,
}

impl View for SessionsState {
    fn ui(&mut self, ui: &mut egui::Ui, cx: &mut ScreenContext<'_>) {
        let Some(sessions) = sessions_ui(ui, cx) else { return };
        import::take_picked_files(cx, &mut self.import);
        let is_known = |id: &String| sessions.iter().any(|session| session.id == *id);
        // One that was just imported may not be on the list yet.
        let imported = cx.store.imported.ready().map(|detail| detail.summary.id.clone());
        let missing = cx.route.session.clone().filter(|id| !is_known(id) && imported.as_ref() != Some(id));
        let shown = cx.route.session.clone().or_else(|| cx.playback.session.clone());
        let shown = shown.filter(is_known);
        let shown = shown.or_else(|| sessions.first().map(|session| session.id.clone()));

        let chosen = cx.route.session.clone();
        two_parts_ui(ui, "sessions_list", ["All sessions", "Session"], chosen.as_deref(), |ui, part| {
            match part {
                Part::Choice => {
                    ui.add_space(4.0);
                    super::topic_heading_ui(ui, "Sessions", Screen::Sessions);
                    undo_ui(ui, cx);
                    for session in sessions.iter() {
                        entry_ui(ui, cx, session, shown.as_ref() == Some(&session.id));
                    }
                    ui.add_space(8.0);
                    import::import_ui(ui, cx, &mut self.import);
                    ui.add_space(8.0);
                    deleted::deleted_ui(ui, cx);
                }
                Part::Chosen => match (&missing, &shown) {
                    (Some(missing), _) => missing_session_ui(ui, cx, missing),
                    (None, Some(id)) => session_ui(ui, cx, id),
                    (None, None) => nothing_ui(ui),
                },
            }
        });
    }
}

fn nothing_ui(ui: &mut egui::Ui) {
    ui.add_space((ui.available_height() * 0.25).min(180.0));
    ui.vertical_centered(|ui| {
        ui.set_max_width(ui.available_width().min(480.0));
        heading_ui(ui, "No session yet");
        ui.label(
            "A session is a set of takes: recordings of the hand touching a known object. Import one from the list of \
             sessions, or record one on the emulated station with `palpate emulate`.",
        );
    });
}

fn undo_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>) {
    match cx.store.deleted_session.clone() {
        Loadable::Ready(id) => {
            ui.horizontal(|ui| {
                ui.label(format!("{id} is in the trash."));
                if ui.button("Undo").clicked() {
                    cx.store.restore_session(&id);
                }
            });
        }
        Loadable::Failed(error) => {
            ui.colored_label(cx.palette.mismatch, error);
        }
        Loadable::Idle | Loadable::Loading => {}
    }
}

fn entry_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, session: &SessionSummary, chosen: bool) {
    let facts = match &session.error {
        Some(_) => "cannot be opened".to_owned(),
        None => format!("{} takes, {}", session.takes, duration_text(session.duration_s)),
    };
    let width = ui.available_width() - 8.0;
    let button = egui::Button::selectable(chosen, RichText::new(&session.id).strong())
        .truncate()
        .right_text(RichText::new(facts).color(cx.palette.text_weak))
        .min_size(egui::vec2(width, 36.0));
    let response = ui.add(button).on_hover_text(&session.id);
    response.widget_info(|| {
        let name = format!("Session {}", session.id);
        egui::WidgetInfo::selected(egui::accesskit::Role::Button, true, chosen, name)
    });
    if response.clicked() {
        cx.playback.open_session(&session.id);
        *cx.go_to = Some(Route::to(Screen::Sessions).with_session(session.id.clone()));
    }
}

fn session_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, id: &str) {
    let detail = cx.store.session(id);
    let Some(detail) = loaded_ui(
        ui,
        cx,
        detail,
        &format!("Opening session {id}"),
        &format!("Session {id} cannot be opened"),
    ) else {
        return;
    };
    egui::ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
        ui.add_space(4.0);
        heading_ui(ui, id);
        let summary = &detail.summary;
        let recorded = (cx.local_time)(&summary.recorded)
            .map_or_else(|| "recording time unknown".to_owned(), |time| format!("recorded {time}"));
        ui.label(format!(
            "Station {}, {} takes, {} frames, {}, {recorded}",
            summary.station,
            summary.takes,
            summary.frames,
            duration_text(summary.duration_s),
        ));
        origin_ui(ui, cx, id);
        actions_ui(ui, cx, id);
        ui.add_space(8.0);
        check::check_ui(ui, cx, id);
        ui.add_space(10.0);
        takes_ui(ui, cx, id, &detail);
        ui.add_space(12.0);
    });
}

/// Which campaigns the takes are trials of, if they are of any.
fn origin_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, id: &str) {
    let Loadable::Ready(lineage) = cx.store.lineage() else { return };
    let made_from = lineage
        .get(&ArtifactKey::new(ArtifactSort::Session, id))
        .map(|artifact| artifact.made_from.as_slice());
    let campaigns = made_from.unwrap_or_default().iter().filter(|key| key.sort == ArtifactSort::Campaign);
    for key in campaigns {
        let campaign = lineage.get(key);
        let policies = campaign.map_or(&[][..], |campaign| campaign.made_from.as_slice()).iter();
        let policies: Vec<&str> = policies.map(|policy| policy.id.as_str()).collect();
        ui.horizontal_wrapped(|ui| {
            ui.label("Takes are trials of the campaign");
            if ui.button(campaign.map_or(key.id.as_str(), |campaign| &campaign.name)).clicked() {
                *cx.go_to = Some(Route { campaign: Some(key.id.clone()), ..Route::to(Screen::Trials) });
            }
            if !policies.is_empty() {
                ui.label(format!("which tries {}.", policies.join(", ")));
            }
        });
    }
}

fn actions_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, id: &str) {
    ui.horizontal_wrapped(|ui| {
        for (name, screen) in [
            ("Watch on the hand", Screen::Hand),
            ("Compare on Timelines", Screen::Timelines),
            ("Calibrate on it", Screen::Calibrate),
        ] {
            if ui.button(name).clicked() {
                cx.playback.open_session(id);
                cx.go_to_screen(screen);
            }
        }
        file_link_ui(ui, "Download", "Download session", "sessions/{}/session.zip", &[id])
            .on_hover_text("All takes as a zip, which any studio imports");
        if ui.button("Move to trash").on_hover_text("Can be undone").clicked() {
            cx.store.delete_session(id);
            if cx.playback.session.as_deref() == Some(id) {
                cx.playback.session = None;
                cx.playback.take = None;
            }
            *cx.go_to = Some(Route::to(Screen::Sessions));
        }
    });
}

fn takes_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, id: &str, detail: &SessionDetail) {
    heading_ui(ui, "Takes");
    egui::ScrollArea::horizontal().id_salt("takes").show(ui, |ui| table_ui(ui, cx, id, detail));
}

fn table_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, id: &str, detail: &SessionDetail) {
    egui::Grid::new("session_takes").striped(true).min_row_height(22.0).spacing([22.0, 4.0]).show(ui, |ui| {
        for name in ["Take", "Primitive", "Object", "Frames", "Duration", "Readings", "File", ""] {
            ui.label(RichText::new(name).strong());
        }
        ui.end_row();
        for take in &detail.takes {
            let open = ui.button(&take.id).on_hover_text("Open on Timelines");
            if open.clicked() {
                cx.playback.open(id, &take.id);
                cx.go_to_screen(Screen::Timelines);
            }
            ui.label(words(&take.primitive));
            ui.label(&take.object);
            ui.label(take.frames.to_string());
            ui.label(duration_text(take.duration_s));
            ui.label(if take.has_raw { "raw and events" } else { "events only" });
            let label = format!("Download {}", take.id);
            file_link_ui(ui, "MCAP", &label, "sessions/{}/takes/{}/take.mcap", &[id, &take.id])
                .on_hover_text("For Foxglove, Rerun, PlotJuggler or the mcap package");
            ui.label(if take.accepted { "" } else { "not accepted" });
            ui.end_row();
        }
    });
}
