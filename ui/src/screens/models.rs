//! Models and policies: what was fitted and trained, what each was made from, and what was made of it.

use std::{collections::BTreeSet, sync::Arc};

use egui::RichText;
use palpate_reports::{ModelEffect, wording};
use palpate_wire::api::{Artifact, ArtifactKey, ArtifactSort, Lineage};

use super::{
    About, Part, ScreenContext, Subject, View, controls::name_button, empty_ui, heading_ui, loaded_ui,
    two_parts_ui, words,
};
use crate::{
    api_client::segment,
    playback::ModelRef,
    route::{Route, Screen},
    store::Loadable,
};

/// What the list has, and its headings. Sessions and campaigns have screens of their own.
const LISTED: [(ArtifactSort, &str); 6] = [
    (ArtifactSort::Model, "Sensor models"),
    (ArtifactSort::Policy, "Policies"),
    (ArtifactSort::Encoder, "Tactile encoders"),
    (ArtifactSort::Demonstrations, "Trials to learn from"),
    (ArtifactSort::Script, "Scripts"),
    (ArtifactSort::Evaluation, "Evaluations in simulation"),
];

/// Where a step of the lineage leads.
#[derive(Clone, Copy)]
enum Towards {
    Origins,
    Uses,
}

/// This screen.
pub const ABOUT: About = About {
    label: "Models",
    slug: "models",
    key: Some(egui::Key::Num9),
    icon: "\u{1f4d0}",
    purpose: "Sensor models and policies: what each was made from, and what was made of it",
    group: Some("Simulator"),
    document: ("artifacts", None),
    subject: Subject::Other,
    needs_station: false,
    shows_stream: false,
    new: || Box::<ModelsState>::default(),
};

/// The screen, which remembers nothing: its address says what is shown.
#[derive(Debug, Default)]
struct ModelsState;

impl View for ModelsState {
    fn ui(&mut self, ui: &mut egui::Ui, cx: &mut ScreenContext<'_>) {
        let lineage = cx.store.lineage();
        let Some(lineage) = loaded_ui(
            ui,
            cx,
            lineage,
            "Looking for models and policies",
            "The list of models did not arrive",
        ) else {
            return;
        };
        let listed = |sort| lineage.artifacts.iter().filter(move |artifact| artifact.key.sort == sort);
        let first = LISTED.iter().find_map(|(sort, _)| listed(*sort).next()).map(|first| first.key.clone());
        let asked = cx.route.artifact.clone();
        let shown = asked.as_deref().map_or(first, ArtifactKey::parse);
        two_parts_ui(ui, "models_list", ["All", "Chosen"], asked.as_deref(), |ui, part| match part {
            Part::Choice => {
                ui.add_space(4.0);
                super::topic_heading_ui(ui, "Models and policies", Screen::Models);
                for (sort, heading) in LISTED {
                    let mut artifacts = listed(sort).peekable();
                    if artifacts.peek().is_none() {
                        continue;
                    }
                    ui.add_space(6.0);
                    ui.label(RichText::new(heading).color(cx.palette.text_weak));
                    artifacts.for_each(|artifact| {
                        entry_ui(ui, cx, artifact, shown.as_ref() == Some(&artifact.key));
                    });
                }
                ui.add_space(12.0);
            }
            Part::Chosen => match &shown {
                Some(key) => chosen_ui(ui, cx, &lineage, key),
                None => nothing_ui(ui, cx),
            },
        });
    }
}

fn nothing_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>) {
    let text = "A calibration that is saved becomes a sensor model, a training that is done a policy. Both are listed \
        here with what they were made from.";
    if empty_ui(ui, "No model and no policy yet", text, "Calibrate a session") {
        cx.go_to_screen(Screen::Calibrate);
    }
}

fn entry_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, artifact: &Artifact, chosen: bool) {
    let fact = match &artifact.made {
        Some(made) => made.get(..10).unwrap_or(made),
        None if artifact.is_shipped => "shipped",
        None => "",
    };
    let button = egui::Button::selectable(chosen, RichText::new(&artifact.name))
        .right_text(RichText::new(fact).color(cx.palette.text_weak))
        .truncate()
        .min_size(egui::vec2(ui.available_width() - 8.0, 32.0));
    let response = ui.add(button);
    response.widget_info(|| {
        let name = called(&artifact.key, &artifact.name);
        egui::WidgetInfo::selected(egui::accesskit::Role::Button, true, chosen, name)
    });
    if response.clicked() {
        *cx.go_to = Some(route_to(&artifact.key));
    }
}

fn chosen_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, lineage: &Lineage, key: &ArtifactKey) {
    let Some(artifact) = lineage.get(key) else {
        let text = "It has been deleted, or the link has a slip in it.";
        if empty_ui(ui, &format!("There is no {}", called(key, &key.id)), text, "All models and policies") {
            *cx.go_to = Some(Route::to(Screen::Models));
        }
        return;
    };
    egui::ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
        ui.add_space(4.0);
        heading_ui(ui, &artifact.name);
        buttons_ui(ui, cx, artifact);
        ui.add_space(8.0);
        facts_ui(ui, cx, artifact);
        ui.add_space(10.0);
        tree_ui(ui, cx, lineage, key, Towards::Origins);
        ui.add_space(10.0);
        tree_ui(ui, cx, lineage, key, Towards::Uses);
        ui.add_space(12.0);
    });
}

fn buttons_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, artifact: &Artifact) {
    ui.horizontal_wrapped(|ui| {
        let session = artifact.made_from.iter().find(|key| key.sort == ArtifactSort::Session);
        if let (ArtifactSort::Model, Some(session)) = (artifact.key.sort, session)
            && ui.button("Compare on Timelines").clicked()
        {
            cx.playback.compared = Some(ModelRef::Saved(artifact.key.id.clone()));
            let model = Some(ModelRef::Saved(artifact.key.id.clone()).key());
            *cx.go_to = Some(Route { model, ..Route::to(Screen::Timelines).with_session(&session.id) });
        }
        if artifact.key.sort == ArtifactSort::Model && !artifact.is_shipped {
            let url = format!("/api/v1/models/{}", segment(&artifact.key.id));
            let link = egui::Hyperlink::from_label_and_url("Model file", url).open_in_new_tab(true);
            ui.add(link).on_hover_text("The file that other studios and `palpate` read");
        }
        for job in &artifact.jobs {
            if ui.button(format!("Job {job}")).on_hover_text("Its request, log and curves").clicked() {
                *cx.go_to = Some(Route { job: Some(job.clone()), ..Route::to(Screen::Jobs) });
            }
        }
    });
}

fn facts_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, artifact: &Artifact) {
    let mut facts = vec![("id".to_owned(), artifact.key.id.clone())];
    if let Some(made) = &artifact.made {
        facts.push(("made".to_owned(), (cx.local_time)(made).unwrap_or_else(|| made.clone())));
    }
    if artifact.is_shipped {
        facts.push(("from".to_owned(), "shipped with the program".to_owned()));
    }
    let models = if artifact.key.sort == ArtifactSort::Model { cx.store.models() } else { Loadable::Idle };
    let models: Option<&Arc<_>> = models.ready();
    if let Some(model) = models.and_then(|models| models.iter().find(|model| model.id == artifact.key.id)) {
        let theta = &model.theta;
        facts.extend([
            ("\u{3bb}_con".to_owned(), format!("{:.3} mm", theta.lambda_con_m * 1000.0)),
            ("\u{3b1}".to_owned(), format!("{:.0} /m", theta.alpha_per_m)),
            ("\u{3bb}_pre".to_owned(), format!("{:.0} Pa", theta.lambda_pre_pa)),
        ]);
        facts.extend(model.streams.iter().map(|(id, own)| (format!("of {id}"), wording::stream_theta(own))));
        let effects: Vec<String> = model.effects.iter().map(effect_text).collect();
        if !effects.is_empty() {
            facts.push(("effects".to_owned(), effects.join("\n")));
        }
    }
    facts.extend(artifact.facts.iter().map(|fact| (fact.name.clone(), fact.value.clone())));
    egui::Grid::new("artifact_facts").num_columns(2).spacing([14.0, 4.0]).show(ui, |ui| {
        for (name, value) in facts {
            ui.label(RichText::new(name).color(cx.palette.text_weak));
            ui.add(egui::Label::new(value).wrap().selectable(true));
            ui.end_row();
        }
    });
}

/// `latency: delay_s 0.06`.
fn effect_text(effect: &ModelEffect) -> String {
    let parameters: Vec<String> =
        effect.parameters.iter().map(|(name, value)| format!("{name} {value:.4}")).collect();
    format!("{}: {}", words(&effect.id), parameters.join(", "))
}

/// Everything that `key` was made from, or that was made of it, as an indented list; nothing is there twice.
fn tree_ui(
    ui: &mut egui::Ui,
    cx: &mut ScreenContext<'_>,
    lineage: &Lineage,
    key: &ArtifactKey,
    towards: Towards,
) {
    let (heading, none) = match towards {
        Towards::Origins => ("Made from", "Nothing that is known of: it was brought in, or it is shipped."),
        Towards::Uses => ("Made of it", "Nothing yet."),
    };
    heading_ui(ui, heading);
    let mut seen = BTreeSet::from([key.clone()]);
    if neighbours(lineage, key, towards).is_empty() {
        ui.label(RichText::new(none).color(cx.palette.text_weak));
    }
    branches_ui(ui, cx, lineage, key, towards, &mut seen);
}

fn branches_ui(
    ui: &mut egui::Ui,
    cx: &mut ScreenContext<'_>,
    lineage: &Lineage,
    key: &ArtifactKey,
    towards: Towards,
    seen: &mut BTreeSet<ArtifactKey>,
) {
    for next in neighbours(lineage, key, towards) {
        let is_new = seen.insert(next.clone());
        let artifact = lineage.get(&next);
        let name = called(&next, artifact.map_or(&next.id, |artifact| &artifact.name));
        let word = RichText::new(if is_new { name.clone() } else { format!("{name}, as above") });
        // A shipped script is in no list; what has been deleted neither.
        let response = ui.add_enabled(artifact.is_some(), egui::Button::new(word).truncate());
        name_button(&response, &name);
        if response.on_disabled_hover_text("Shipped, or deleted since").clicked() {
            *cx.go_to = Some(route_to(&next));
        }
        if is_new && !neighbours(lineage, &next, towards).is_empty() {
            ui.indent(("lineage", &next), |ui| branches_ui(ui, cx, lineage, &next, towards, seen));
        }
    }
}

fn neighbours(lineage: &Lineage, key: &ArtifactKey, towards: Towards) -> Vec<ArtifactKey> {
    match towards {
        Towards::Origins => lineage.get(key).map(|artifact| artifact.made_from.clone()).unwrap_or_default(),
        Towards::Uses => lineage.made_of(key).map(|artifact| artifact.key.clone()).collect(),
    }
}

/// `Policy cube`.
fn called(key: &ArtifactKey, name: &str) -> String {
    let sort = key.sort.name();
    format!("{}{} {name}", sort[..1].to_uppercase(), &sort[1..])
}

/// Where an artifact is shown.
fn route_to(key: &ArtifactKey) -> Route {
    match key.sort {
        ArtifactSort::Session => Route::to(Screen::Sessions).with_session(&key.id),
        ArtifactSort::Campaign => Route { campaign: Some(key.id.clone()), ..Route::to(Screen::Trials) },
        _ => Route { artifact: Some(key.to_string()), ..Route::to(Screen::Models) },
    }
}
