//! The plan of a campaign, before there is one.

use std::collections::BTreeSet;

use egui::RichText;
use palpate_reports::wording::counted;
use palpate_wire::api::{ArtifactSort, CampaignObject, CampaignPlan, CampaignPolicy, TrialOrder};

use crate::{
    screens::{
        ScreenContext,
        controls::{combo_ui, option_ui},
    },
    store::Loadable,
};

/// What has been filled in.
#[derive(Debug)]
pub(super) struct FormState {
    name: String,
    policies: Vec<PolicyRow>,
    objects: BTreeSet<String>,
    starts: u32,
    half_width_mm: f64,
    seed: u64,
    order: TrialOrder,
    is_blind: bool,
    scorers: u32,
    criterion: String,
}

#[derive(Clone, Debug, Default)]
struct PolicyRow {
    id: String,
    source: String,
    is_silenced: bool,
}

impl Default for FormState {
    fn default() -> Self {
        Self {
            name: String::new(),
            policies: vec![PolicyRow::default()],
            objects: BTreeSet::new(),
            starts: 5,
            half_width_mm: 20.0,
            seed: 1,
            order: TrialOrder::default(),
            is_blind: false,
            scorers: 1,
            criterion: "3 cm above the table for 1 s, without a drop".to_owned(),
        }
    }
}

/// The form; true when it is left without a campaign.
pub(super) fn form_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, form: &mut FormState) -> bool {
    let mut left = false;
    egui::ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
        // The bar that scrolls lies over the right edge.
        ui.set_max_width((ui.available_width() - 12.0).min(640.0));
        ui.add_space(4.0);
        ui.heading("Plan a campaign");
        ui.label(
            RichText::new(
                "The plan is fixed once the campaign exists: what is decided after looking at results is worth nothing.",
            )
            .color(cx.palette.text_weak),
        );
        ui.add_space(6.0);
        text_ui(ui, "Name", &mut form.name, "e.g. Pretraining, November");
        policies_ui(ui, cx, form);
        let groups = objects_ui(ui, cx, form);
        numbers_ui(ui, form);
        text_ui(ui, "A success is", &mut form.criterion, "what scorers go by");
        ui.add_space(8.0);
        let planned = form.policies.len() * form.objects.len() * form.starts as usize;
        ui.label(format!(
            "{} \u{d7} {} \u{d7} {} = {}",
            match form.policies.len() {
                1 => "1 policy".to_owned(),
                several => format!("{several} policies"),
            },
            counted(form.objects.len() as u64, "object"),
            counted(u64::from(form.starts), "start"),
            counted(planned as u64, "trial"),
        ));
        if let Loadable::Failed(problem) = &cx.store.campaigns.made {
            ui.colored_label(cx.palette.mismatch, format!("\u{26a0} {problem}"));
        }
        ui.horizontal(|ui| {
            let missing = form.missing();
            let make = egui::Button::new(RichText::new("Make the campaign").strong());
            let is_free = missing.is_none() && !matches!(cx.store.campaigns.made, Loadable::Loading);
            let response = ui.add_enabled(is_free, make);
            let response = match missing {
                Some(missing) => response.on_disabled_hover_text(missing),
                None => response,
            };
            if response.clicked() {
                cx.store.campaigns.make(form.plan(&groups));
            }
            if ui.button("Cancel").clicked() {
                cx.store.campaigns.made = Loadable::Idle;
                left = true;
            }
        });
        if let Some(missing) = form.missing() {
            ui.label(RichText::new(missing).color(cx.palette.text_weak));
        }
        ui.add_space(12.0);
    });
    left
}

fn text_ui(ui: &mut egui::Ui, name: &str, text: &mut String, hint: &str) {
    ui.horizontal_wrapped(|ui| {
        let label = ui.label(name);
        let width = ui.available_width().clamp(120.0, 360.0);
        let field = egui::TextEdit::singleline(text).hint_text(hint).desired_width(width).char_limit(120);
        ui.add(field).labelled_by(label.id);
    });
}

/// Where a policy may come from.
struct KnownSource {
    source: String,
    /// A name for it in the plan.
    id: String,
    words: String,
}

/// What can be tried: policies that jobs have learned or that come with the program, and scripts.
fn known_sources(cx: &mut ScreenContext<'_>) -> Vec<KnownSource> {
    let (lineage, objects) = (cx.store.lineage(), cx.store.objects());
    let artifacts = lineage.ready().map_or(&[][..], |lineage| lineage.artifacts.as_slice());
    let of_one_object =
        |id: &str| objects.ready().is_some_and(|objects| objects.iter().any(|object| object.id == id));
    let mut known = Vec::new();
    let mut add = |source: &str, id: &str, words: String| {
        known.push(KnownSource { source: source.to_owned(), id: id.to_owned(), words });
    };
    for artifact in artifacts.iter().filter(|artifact| artifact.key.sort == ArtifactSort::Policy) {
        let id = &artifact.key.id;
        match artifact.is_shipped {
            // Those of one object each are tried together, below.
            true if of_one_object(id) => {}
            true => add(id, id, format!("{id}, comes with the program")),
            false => add(id, id, artifact.name.clone()),
        }
    }
    if artifacts.iter().any(|artifact| artifact.is_shipped && of_one_object(&artifact.key.id)) {
        add("{object}", "experts", "the expert that comes with the program for each object".to_owned());
    }
    add("script:{object}", "script", "the script of each object, which feels nothing".to_owned());
    for artifact in artifacts.iter().filter(|artifact| artifact.key.sort == ArtifactSort::Script) {
        let id = &artifact.key.id;
        add(&format!("script:{id}"), id, format!("script {id}, which feels nothing"));
    }
    known
}

fn policies_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, form: &mut FormState) {
    ui.add_space(6.0);
    ui.strong("Policies");
    let known = known_sources(cx);
    if let Loadable::Failed(error) = cx.store.lineage() {
        let text = format!("\u{26a0} The list of policies did not arrive: {error}");
        ui.colored_label(cx.palette.mismatch, text);
    }
    let mut removed = None;
    let num_rows = form.policies.len();
    for (idx, row) in form.policies.iter_mut().enumerate() {
        ui.horizontal_wrapped(|ui| {
            let number = idx + 1;
            let name = egui::TextEdit::singleline(&mut row.id).hint_text("short name").desired_width(130.0);
            ui.add(name).accessible_name(format!("Name of policy {number}"));
            let source = egui::TextEdit::singleline(&mut row.source)
                .hint_text("policy file or script:NAME")
                .desired_width(230.0);
            ui.add(source).accessible_name(format!("Source of policy {number}"));
            let mut chosen = known.iter().position(|known| known.source == row.source);
            let before = chosen;
            combo_ui(ui, &format!("Choose policy {number}"), "Choose", 90.0, |ui| {
                for (idx, known) in known.iter().enumerate() {
                    option_ui(ui, &mut chosen, Some(idx), &known.words);
                }
            });
            if let Some(known) = chosen.filter(|_| chosen != before).map(|idx| &known[idx]) {
                row.source.clone_from(&known.source);
                if row.id.is_empty() {
                    row.id.clone_from(&known.id);
                }
            }
            ui.checkbox(&mut row.is_silenced, "touch silenced");
            if num_rows > 1 && ui.button("Remove").clicked() {
                removed = Some(idx);
            }
        });
    }
    if let Some(idx) = removed {
        form.policies.remove(idx);
    }
    if ui.button("Add a policy").clicked() {
        form.policies.push(PolicyRow::default());
    }
}

/// Objects to choose from; gives their groups.
fn objects_ui(
    ui: &mut egui::Ui,
    cx: &mut ScreenContext<'_>,
    form: &mut FormState,
) -> Vec<(String, Option<String>)> {
    ui.add_space(6.0);
    ui.strong("Objects");
    let objects = match cx.store.objects() {
        Loadable::Ready(objects) => objects,
        Loadable::Failed(error) => {
            ui.colored_label(
                cx.palette.mismatch,
                format!("\u{26a0} The list of objects did not arrive: {error}"),
            );
            return Vec::new();
        }
        Loadable::Idle | Loadable::Loading => {
            ui.spinner();
            return Vec::new();
        }
    };
    let known: Vec<(String, Option<String>)> = objects
        .iter()
        .filter_map(|object| Some((object.id.clone(), object.content.as_ref().ok()?.group.clone())))
        .collect();
    for (group, heading) in [("seen", "seen in training"), ("unseen", "unseen")] {
        let members: Vec<&String> =
            known.iter().filter(|(_, of)| of.as_deref() == Some(group)).map(|(id, _)| id).collect();
        if members.is_empty() {
            continue;
        }
        ui.horizontal_wrapped(|ui| {
            ui.label(RichText::new(heading).color(cx.palette.text_weak));
            let all = members.iter().all(|id| form.objects.contains(*id));
            if ui.button(if all { format!("No {group}") } else { format!("All {group}") }).clicked() {
                for id in &members {
                    if all {
                        form.objects.remove(*id)
                    } else {
                        form.objects.insert((*id).clone())
                    };
                }
            }
        });
        ui.horizontal_wrapped(|ui| {
            for id in members {
                let is_chosen = form.objects.contains(id);
                let response = ui.add(egui::Button::new(id).selected(is_chosen));
                response.widget_info(|| {
                    egui::WidgetInfo::selected(egui::accesskit::Role::Button, true, is_chosen, id)
                });
                if response.clicked() {
                    if is_chosen {
                        form.objects.remove(id)
                    } else {
                        form.objects.insert(id.clone())
                    };
                }
            }
        });
    }
    known
}

fn numbers_ui(ui: &mut egui::Ui, form: &mut FormState) {
    ui.add_space(6.0);
    egui::Grid::new("campaign_numbers").num_columns(2).spacing([14.0, 6.0]).show(ui, |ui| {
        let label = ui.label("Starts of each object");
        ui.add(egui::DragValue::new(&mut form.starts).range(1..=100)).labelled_by(label.id);
        ui.end_row();
        let label = ui.label("Region, half its edge");
        ui.add(egui::DragValue::new(&mut form.half_width_mm).range(0.0..=200.0).suffix(" mm"))
            .labelled_by(label.id);
        ui.end_row();
        let label = ui.label("Scorers of each trial");
        ui.add(egui::DragValue::new(&mut form.scorers).range(1..=2)).labelled_by(label.id);
        ui.end_row();
        let label = ui.label("Seed of starts and order");
        ui.add(egui::DragValue::new(&mut form.seed)).labelled_by(label.id);
        ui.end_row();
    });
    let weak = ui.visuals().weak_text_color();
    ui.checkbox(&mut form.is_blind, "Blind");
    ui.label(
        RichText::new("Scorers do not learn which policy they see until the campaign is closed.").color(weak),
    );
    let mut by_object = form.order == TrialOrder::ByObject;
    ui.checkbox(&mut by_object, "One object after the other");
    ui.label(RichText::new("Fewer changes by hand, but what drifts hits objects unequally.").color(weak));
    form.order = if by_object { TrialOrder::ByObject } else { TrialOrder::Interleaved };
}

impl FormState {
    /// What has to be filled in still.
    fn missing(&self) -> Option<&'static str> {
        let ids: BTreeSet<&str> = self.policies.iter().map(|row| row.id.trim()).collect();
        if self.name.trim().is_empty() {
            Some("Give the campaign a name.")
        } else if self.policies.iter().any(|row| row.id.trim().is_empty() || row.source.trim().is_empty()) {
            Some("Give every policy a name and say what it is.")
        } else if ids.len() < self.policies.len() {
            Some("Give every policy a name of its own.")
        } else if self.objects.is_empty() {
            Some("Choose at least one object.")
        } else {
            None
        }
    }

    fn plan(&self, groups: &[(String, Option<String>)]) -> CampaignPlan {
        let group =
            |id: &String| groups.iter().find(|(known, _)| known == id).and_then(|(_, group)| group.clone());
        CampaignPlan {
            name: self.name.trim().to_owned(),
            policies: self
                .policies
                .iter()
                .map(|row| CampaignPolicy {
                    id: row.id.trim().to_owned(),
                    source: row.source.trim().to_owned(),
                    is_silenced: row.is_silenced,
                })
                .collect(),
            objects: self
                .objects
                .iter()
                .map(|id| CampaignObject { id: id.clone(), group: group(id) })
                .collect(),
            starts: self.starts,
            half_width_m: self.half_width_mm / 1000.0,
            seed: self.seed,
            order: self.order,
            is_blind: self.is_blind,
            scorers: self.scorers,
            alpha: 0.05,
            criterion: self.criterion.trim().to_owned(),
        }
    }
}
