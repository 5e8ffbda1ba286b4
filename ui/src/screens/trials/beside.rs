//! The trials of a campaign beside the same starts in simulation: the job that makes them there, and what it found.

mod commands;
mod found;

use std::{collections::BTreeMap, sync::Arc};

use egui::RichText;
use palpate_reports::wording::counted;
use palpate_wire::api::{
    Campaign, ComparisonRequest, Job, JobRequest, JobState, ModelSummary, NOMINAL_MODEL, Role, Scope,
};

use self::{
    commands::{commands_ui, is_empty},
    found::found_ui,
};
use crate::{
    api_client::JobAct,
    route::{Route, Screen},
    screens::{ScreenContext, progress_bar},
    store::Loadable,
};

/// The kind of job.
const KIND: &str = "comparison";

/// What the operator chose.
#[derive(Debug, Default)]
pub(super) struct BesideState {
    /// Saved models that were ticked or unticked, by id; the others are as they are at first.
    ticks: BTreeMap<String, bool>,
    /// Trials on which hand and simulation agree are shown too.
    shows_all: bool,
}

pub(super) fn beside_ui(
    ui: &mut egui::Ui,
    cx: &mut ScreenContext<'_>,
    state: &mut BesideState,
    campaign: &Campaign,
) {
    if is_empty(campaign) {
        return;
    }
    ui.add_space(8.0);
    ui.strong("Beside the simulator");
    let text = "The same policies from the same starts in simulation, felt by each sensor model. Where outcomes or touch differ \
                from the hand, something is missing there.";
    ui.label(RichText::new(text).color(cx.palette.text_weak));
    if campaign.plan.is_blind && campaign.summary.closed.is_none() {
        ui.label("This campaign is blind: it can be compared once it is closed.");
        return;
    }
    job_ui(ui, cx, state, campaign);
    commands_ui(ui, cx, campaign);
    ui.add_space(8.0);
}

fn job_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, state: &mut BesideState, campaign: &Campaign) {
    let Loadable::Ready(jobs) = cx.store.jobs.list() else { return };
    let id = campaign.summary.id.as_str();
    let of_campaign = |job: &&Job| job.kind == KIND && job.spec.request["campaign"] == id;
    let newest = jobs.iter().find(of_campaign);
    if let (Some(job), Loadable::Ready(made)) = (newest, &cx.store.jobs.cloned)
        && job.id == *made
    {
        // It is shown here; the screen of jobs need not open it.
        cx.store.jobs.cloned = Loadable::Idle;
    }
    match newest.filter(|job| job.is_unfinished()) {
        Some(job) => running_ui(ui, cx, job),
        None if cx.store.people.lacks(Role::Operator, Scope::Jobs).is_some() => {
            ui.label("Operators compare trials with the simulator.");
        }
        None => start_ui(ui, cx, state, campaign, newest),
    }
    let Some(done) = jobs.iter().filter(of_campaign).find(|job| job.state == JobState::Done) else { return };
    match cx.store.jobs.comparison(&done.id) {
        Loadable::Ready(report) => found_ui(ui, cx, &mut state.shows_all, &report),
        Loadable::Failed(error) => {
            let text = format!("\u{26a0} What {} found did not arrive: {error}", done.id);
            ui.colored_label(cx.palette.mismatch, text);
        }
        Loadable::Idle | Loadable::Loading => {
            ui.spinner();
        }
    }
}

fn running_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, job: &Job) {
    let words = if job.state == JobState::Queued { "waits for its turn" } else { "compares" };
    ui.label(format!("{} {words}. {}", job.id, job.stage));
    let text = format!("{:.0} %", 100.0 * job.fraction);
    ui.add(progress_bar(job.fraction, &text).desired_width(ui.available_width().min(420.0)));
    ui.horizontal_wrapped(|ui| {
        if ui.add_enabled(!job.cancel_requested, egui::Button::new("Stop comparing")).clicked() {
            cx.store.jobs.act(&job.id, JobAct::Cancel);
        }
        link_ui(ui, cx, job);
    });
}

fn start_ui(
    ui: &mut egui::Ui,
    cx: &mut ScreenContext<'_>,
    state: &mut BesideState,
    campaign: &Campaign,
    last: Option<&Job>,
) {
    let Loadable::Ready(kinds) = cx.store.jobs.kinds() else { return };
    let kind = Arc::clone(&kinds).iter().find(|kind| kind.kind == KIND).cloned();
    if let Some(problem) = kind.and_then(|kind| kind.problem) {
        ui.label(format!("This studio cannot simulate trials: {problem}."));
        return;
    }
    let [own, elsewhere] = num_records(campaign);
    if own == 0 {
        ui.label(format!(
            "These trials were made outside the studio, so it has no record of them; the command below compares them. It \
             has the records of trials that a job makes (Run, \u{201c}Let the policies run here\u{201d}), or that a \
             rollout leaves in campaigns/{}/rollout of its data folder (--out).",
            campaign.summary.id
        ));
        return;
    }
    if elsewhere > 0 {
        ui.label(format!("{} made outside the studio cannot be compared here.", counted(elsewhere, "trial")));
    }
    let models = models_ui(ui, cx, state);
    if let Some(last) = last.filter(|job| job.state == JobState::Failed) {
        let why = last.problem.as_deref().unwrap_or("it does not say why");
        ui.label(RichText::new(format!("{} failed: {why}", last.id)).color(cx.palette.warning));
        link_ui(ui, cx, last);
    }
    if let Some(problem) = cx.store.jobs.problem.clone() {
        ui.label(RichText::new(problem).color(cx.palette.warning));
    }
    let is_free = !matches!(cx.store.jobs.cloned, Loadable::Loading);
    if ui.add_enabled(is_free, egui::Button::new("Compare with the simulator")).clicked() {
        let request = ComparisonRequest { campaign: campaign.summary.id.clone(), models };
        cx.store.jobs.submit(JobRequest {
            kind: KIND.to_owned(),
            request: serde_json::to_value(request).unwrap_or_default(),
            seed: 0,
            priority: 0,
            resources: None,
            runner: None,
        });
    }
}

/// Trials whose record is in the campaign's own folder, and those whose is elsewhere.
fn num_records(campaign: &Campaign) -> [u64; 2] {
    let folder = format!("campaigns/{}/rollout/", campaign.summary.id);
    let outcomes = campaign.trials.iter().filter_map(|trial| trial.attempts.last()?.outcome.as_ref());
    let mut num = [0, 0];
    for record in outcomes.filter_map(|outcome| outcome.record.as_ref()) {
        num[usize::from(!record.contains(&folder))] += 1;
    }
    num
}

/// Boxes to tick for the saved models; gives the ids of all that are compared.
fn models_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, state: &mut BesideState) -> Vec<String> {
    let mut chosen = vec![NOMINAL_MODEL.to_owned()];
    let Loadable::Ready(models) = cx.store.models() else { return chosen };
    let made: BTreeMap<String, String> = match cx.store.lineage() {
        Loadable::Ready(lineage) => lineage
            .artifacts
            .iter()
            .filter_map(|artifact| Some((artifact.key.to_string(), artifact.made.clone()?)))
            .collect(),
        _ => BTreeMap::new(),
    };
    let mut newest_first: Vec<&ModelSummary> = models.iter().collect();
    // The sort is stable: of those without a time the list's order counts.
    newest_first.sort_by_key(|model| std::cmp::Reverse(made.get(&format!("model:{}", model.id))));
    ui.label("With the nominal sensor model, and with");
    for (what, is_diagnosed, screen) in
        [("calibrated", false, Screen::Calibrate), ("diagnosed", true, Screen::Diagnose)]
    {
        let mut of_kind =
            newest_first.iter().filter(|model| model.effects.is_empty() != is_diagnosed).peekable();
        if of_kind.peek().is_none() {
            ui.horizontal_wrapped(|ui| {
                ui.label(
                    RichText::new(format!("no {what} one: none is saved yet")).color(cx.palette.text_weak),
                );
                if ui.small_button(screen.label()).clicked() {
                    cx.go_to_screen(screen);
                }
            });
        }
        for (idx, model) in of_kind.enumerate() {
            let mut ticked = state.ticks.get(&model.id).copied().unwrap_or(idx == 0);
            let text = format!("{what}: {}", model.name);
            if ui.checkbox(&mut ticked, egui::AtomExt::atom_shrink(text, true)).changed() {
                state.ticks.insert(model.id.clone(), ticked);
            }
            if ticked {
                chosen.push(model.id.clone());
            }
        }
    }
    chosen
}

fn link_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, job: &Job) {
    if ui.button(format!("Open {}", job.id)).clicked() {
        *cx.go_to = Some(Route { job: Some(job.id.clone()), ..Route::to(Screen::Jobs) });
    }
}
