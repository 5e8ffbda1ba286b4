//! Objects: the gallery of what is touched and grasped.

use std::{collections::BTreeMap, sync::Arc};

use base64::Engine as _;
use egui::RichText;
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};
use palpate_robot_model::{ObjectModel, ObjectShape};
use palpate_wire::api::{ObjectDocument, ObjectEntry, RestPoseDocument};

use super::{
    About, ScreenContext, Subject, View,
    controls::{combo_ui, option_ui},
    empty_ui,
    hand::ObjectView,
    heading_ui, loaded_ui, said_ui, topic_heading_ui, topic_ui,
};
use crate::route::{Route, Screen};

/// Groups in the order of the list, and their headings.
const GROUPS: [(Option<&str>, &str); 3] = [
    (Some("seen"), "Seen in training"),
    (Some("unseen"), "Unseen, for evaluation"),
    (None, "Calibration and others"),
];

/// Less wide than this, points, list, picture and facts do not stand side by side.
const NARROW: f32 = 820.0;
/// Height of the picture there, points.
const PICTURE_HEIGHT: f32 = 300.0;

/// Room for the `?` beside the box of objects there, points.
const HELP_WIDTH: f32 = 48.0;

/// This screen.
pub const ABOUT: About = About {
    label: "Objects",
    slug: "objects",
    key: Some(egui::Key::Num6),
    icon: "\u{1f4e6}",
    purpose: "What is touched and grasped: shape, mass, poses at rest",
    group: Some("Data"),
    document: ("objects", None),
    subject: Subject::Other,
    needs_station: false,
    shows_stream: false,
    new: || Box::<ObjectsState>::default(),
};

/// What the operator chose on this screen.
#[derive(Default)]
struct ObjectsState {
    view: ObjectView,
    /// Pose shown, of the object with this id.
    pose: (String, usize),
    shapes: BTreeMap<String, Result<Arc<ObjectShape>, String>>,
}

impl View for ObjectsState {
    fn ui(&mut self, ui: &mut egui::Ui, cx: &mut ScreenContext<'_>) {
        let objects = cx.store.objects();
        let Some(objects) =
            loaded_ui(ui, cx, objects, "Looking for objects", "The list of objects did not arrive")
        else {
            return;
        };
        let asked = cx.route.object.as_deref();
        let Some(shown) = objects.iter().find(|object| Some(object.id.as_str()) == asked).or(objects.first())
        else {
            let text = "An object is what the hand touches or grasps: convex parts in a file. Put files into the \
                folder objects of the data folder; docs/objects.md shows how they look.";
            if empty_ui(ui, "No object yet", text, "Look again") {
                cx.store.ask_objects_again();
            }
            return;
        };
        if ui.available_width() < NARROW {
            return narrow_ui(ui, cx, self, &objects, shown);
        }
        egui::Panel::left("objects_list").resizable(false).exact_size(292.0).show(ui, |ui| {
            egui::ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
                ui.add_space(4.0);
                topic_heading_ui(ui, "Objects", Screen::Objects);
                for (group, heading) in GROUPS {
                    let members = || objects.iter().filter(|object| group_of(object) == group);
                    if members().next().is_some() {
                        ui.add_space(6.0);
                        ui.label(RichText::new(heading).color(cx.palette.text_weak));
                    }
                    for object in members() {
                        entry_ui(ui, cx, object, object.id == shown.id);
                    }
                }
            });
        });
        match &shown.content {
            Ok(document) => {
                egui::Panel::right("object_facts").resizable(false).exact_size(320.0).show(ui, |ui| {
                    egui::ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
                        facts_ui(ui, cx, shown, document);
                        poses_ui(ui, cx, self, &shown.id, document);
                        takes_ui(ui, cx, shown);
                    });
                });
                egui::CentralPanel::default().show(ui, |ui| picture_ui(ui, cx, self, &shown.id, document));
            }
            Err(problem) => {
                egui::CentralPanel::default().show(ui, |ui| unusable_ui(ui, cx, shown, problem));
            }
        }
    }
}

/// Everything below one another, on a phone.
fn narrow_ui(
    ui: &mut egui::Ui,
    cx: &mut ScreenContext<'_>,
    state: &mut ObjectsState,
    objects: &[ObjectEntry],
    shown: &ObjectEntry,
) {
    egui::ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
        ui.add_space(4.0);
        let mut chosen = shown.id.clone();
        ui.horizontal(|ui| {
            let width = ui.available_width() - 16.0 - HELP_WIDTH;
            combo_ui(ui, "Object", entry_text(shown).0, width, |ui| {
                for (group, heading) in GROUPS {
                    let mut members = objects.iter().filter(|object| group_of(object) == group).peekable();
                    if members.peek().is_some() {
                        ui.label(RichText::new(heading).color(cx.palette.text_weak));
                    }
                    members.for_each(|object| {
                        option_ui(ui, &mut chosen, object.id.clone(), entry_text(object).0);
                    });
                }
            });
            topic_ui(ui, Screen::Objects);
        });
        if chosen != shown.id {
            *cx.go_to = Some(Route { object: Some(chosen), ..Route::to(Screen::Objects) });
        }
        match &shown.content {
            Ok(document) => {
                let size = egui::vec2(ui.available_width(), PICTURE_HEIGHT);
                ui.allocate_ui(size, |ui| picture_ui(ui, cx, state, &shown.id, document));
                facts_ui(ui, cx, shown, document);
                poses_ui(ui, cx, state, &shown.id, document);
                takes_ui(ui, cx, shown);
            }
            Err(problem) => unusable_ui(ui, cx, shown, problem),
        }
    });
}

fn group_of(object: &ObjectEntry) -> Option<&str> {
    object.content.as_ref().ok().and_then(|document| document.group.as_deref())
}

fn entry_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, object: &ObjectEntry, chosen: bool) {
    let (name, fact) = entry_text(object);
    let button = egui::Button::selectable(chosen, RichText::new(name))
        .right_text(RichText::new(fact).color(cx.palette.text_weak))
        .min_size(egui::vec2(ui.available_width() - 8.0, 32.0));
    let response = ui.add(button);
    response.widget_info(|| {
        let name = format!("Object {}", object.id);
        egui::WidgetInfo::selected(egui::accesskit::Role::Button, true, chosen, name)
    });
    if response.clicked() {
        *cx.go_to = Some(Route { object: Some(object.id.clone()), ..Route::to(Screen::Objects) });
    }
}

/// What an object is called, and one fact about it.
fn entry_text(object: &ObjectEntry) -> (&str, String) {
    match &object.content {
        Ok(document) => (&document.label, document.mass_kg.map(grams).unwrap_or_default()),
        Err(_) => (&object.id, "\u{26a0} cannot be used".to_owned()),
    }
}

fn facts_ui(ui: &mut egui::Ui, cx: &ScreenContext<'_>, object: &ObjectEntry, document: &ObjectDocument) {
    ui.add_space(4.0);
    heading_ui(ui, &document.label);
    let group = match document.group.as_deref() {
        Some("seen") => "seen in training",
        Some(_) => "unseen, held out of training",
        None => "in no group",
    };
    let [x, y, z] = document.size_m.map(|edge_m| format!("{:.0}", edge_m * 1000.0));
    let mass = document.mass_kg.map_or_else(|| "unknown: the file gives no density".to_owned(), grams);
    let [cx_m, cy_m, cz_m] = document.com_m.map(|m| {
        // No "-0.0".
        format!("{:.1}", m * 1000.0 + 0.0).replace("-0.0", "0.0")
    });
    egui::Grid::new("object_facts_grid").num_columns(2).spacing([14.0, 4.0]).show(ui, |ui| {
        for (name, value) in [
            ("Id", object.id.clone()),
            ("Group", group.to_owned()),
            ("Size", format!("{x} x {y} x {z} mm")),
            ("Mass", mass),
            ("Volume", format!("{:.1} cm\u{b3}", document.volume_m3 * 1e6)),
            ("Centre of mass", format!("{cx_m}, {cy_m}, {cz_m} mm")),
            ("From", if object.own { "objects/ of the data folder" } else { "shipped" }.to_owned()),
        ] {
            ui.label(RichText::new(name).color(cx.palette.text_weak));
            ui.label(value);
            ui.end_row();
        }
    });
    ui.add_space(10.0);
}

fn poses_ui(
    ui: &mut egui::Ui,
    cx: &ScreenContext<'_>,
    state: &mut ObjectsState,
    id: &str,
    document: &ObjectDocument,
) {
    heading_ui(ui, "Poses at rest");
    ui.label(
        RichText::new(
            "How often a slow drop ends there, and how far the centre of mass must rise to tip over",
        )
        .color(cx.palette.text_weak),
    );
    let shown = state.shown_pose(id, document);
    for (idx, pose) in document.rest_poses.iter().enumerate() {
        let share = format!("{:.0} %", pose.weight * 100.0);
        let barrier = pose.barrier_m.map_or_else(
            || "the only one".to_owned(),
            |barrier_m| format!("tips at +{:.1} mm", barrier_m * 1000.0),
        );
        let button = egui::Button::selectable(idx == shown, format!("Pose {}   {share}", idx + 1))
            .right_text(RichText::new(barrier.clone()).color(cx.palette.text_weak))
            .min_size(egui::vec2(ui.available_width() - 8.0, 32.0));
        let response = ui.add(button);
        response.widget_info(|| {
            let name = format!("Pose {}: {share}, {barrier}", idx + 1);
            egui::WidgetInfo::selected(egui::accesskit::Role::Button, true, idx == shown, name)
        });
        if response.clicked() {
            state.pose = (id.to_owned(), idx);
            state.view.reset();
        }
    }
    ui.add_space(10.0);
}

fn takes_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, object: &ObjectEntry) {
    heading_ui(ui, "Used in takes");
    if object.takes.is_empty() {
        ui.label("No take has touched it yet.");
    }
    for used in &object.takes {
        let name = format!("{} {}", used.session, used.take);
        if ui.button(name).on_hover_text("Open on Timelines").clicked() {
            cx.playback.open(&used.session, &used.take);
            cx.go_to_screen(Screen::Timelines);
        }
    }
    ui.add_space(12.0);
}

fn picture_ui(
    ui: &mut egui::Ui,
    cx: &ScreenContext<'_>,
    state: &mut ObjectsState,
    id: &str,
    document: &ObjectDocument,
) {
    let shown = state.shown_pose(id, document);
    let shape = state.shapes.entry(id.to_owned()).or_insert_with(|| shape_of(id, document).map(Arc::new));
    match shape {
        Ok(shape) => {
            let pose = document.rest_poses.get(shown).map_or_else(Isometry3::identity, table_from_object);
            let rect = ui.available_rect_before_wrap();
            state.view.ui(ui, rect, (id, shape), &pose, &cx.palette, cx.surface);
            ui.advance_cursor_after_rect(rect);
        }
        Err(problem) => {
            ui.colored_label(cx.palette.mismatch, format!("\u{26a0} It cannot be drawn: {problem}"));
        }
    }
}

fn unusable_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, object: &ObjectEntry, problem: &str) {
    ui.add_space((ui.available_height() * 0.25).min(180.0));
    ui.vertical_centered(|ui| {
        ui.set_max_width(560.0);
        let title = format!("\u{26a0} Object {} cannot be used", object.id);
        heading_ui(ui, RichText::new(title).color(cx.palette.mismatch));
        said_ui(ui, problem);
        said_ui(ui, "Mend the file, then look again; docs/objects.md shows how object files look.");
        ui.add_space(8.0);
        if ui.button("Look again").clicked() {
            cx.store.ask_objects_again();
        }
    });
}

impl ObjectsState {
    fn shown_pose(&self, id: &str, document: &ObjectDocument) -> usize {
        let (of, idx) = &self.pose;
        if of == id && *idx < document.rest_poses.len() { *idx } else { 0 }
    }
}

fn table_from_object(pose: &RestPoseDocument) -> Isometry3<f64> {
    let [w, x, y, z] = pose.quaternion_wxyz;
    Isometry3::from_parts(
        Translation3::new(0.0, 0.0, pose.origin_height_m),
        UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z)),
    )
}

fn shape_of(id: &str, document: &ObjectDocument) -> Result<ObjectShape, String> {
    let object = ObjectModel::from_toml(id, &document.object_toml, |mesh| {
        let text = document.meshes_base64.get(mesh).ok_or_else(|| "the server did not send it".to_owned())?;
        base64::engine::general_purpose::STANDARD.decode(text).map_err(|err| err.to_string())
    });
    object.map(|object| object.shape).map_err(|err| err.to_string())
}

fn grams(mass_kg: f64) -> String {
    format!("{:.0} g", mass_kg * 1000.0)
}
