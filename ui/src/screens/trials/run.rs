//! Running a campaign: place the object, let the policy move, go on to the next.

use egui::RichText;
use palpate_wire::api::{
    Campaign, Role, RolloutOutcome, Scope, ScoreRequest, Trial, TrialEnd, TrialState, TrialVerdict,
};

use super::{
    hand::{HandState, hand_ui},
    place::{place_ui, words},
    state_label,
};
use crate::{api_client::CampaignAct, screens::ScreenContext};

/// With less room than this, points, what is to be done stands below the picture.
const BESIDE: f32 = 460.0;

pub(super) fn run_ui(
    ui: &mut egui::Ui,
    cx: &mut ScreenContext<'_>,
    state: &mut HandState,
    campaign: &Campaign,
) {
    let next = campaign.next.and_then(|number| trial(campaign, number));
    if campaign.summary.paused.is_some() {
        ui.label("The campaign is paused: no trial begins, neither here nor from a rollout, until somebody goes on.");
        ui.add_space(4.0);
    }
    if runs(cx) && cx.store.people.lacks(Role::Operator, Scope::Jobs).is_none() {
        hand_ui(ui, cx, state, campaign);
    }
    match next {
        Some(trial) if campaign.summary.paused.is_some() && trial.state != TrialState::Running => {
            ui.label(format!("Next is trial {} of {}.", trial.number, campaign.summary.planned));
        }
        Some(trial) => next_ui(ui, cx, campaign, trial),
        None if campaign.summary.closed.is_some() => {
            ui.label("The campaign is closed. Its results stay.");
        }
        None => {
            ui.label("All trials are made. What is left is to score them, and to close the campaign.");
        }
    }
    ui.add_space(10.0);
    if decides(cx) {
        settle_ui(ui, cx, campaign);
    }
    ui.horizontal_wrapped(|ui| {
        if runs(cx) {
            pause_ui(ui, cx, campaign);
        }
        if decides(cx) {
            close_ui(ui, cx, campaign);
        }
    });
    ui.add_space(10.0);
    list_ui(ui, cx, campaign);
}

/// Whether whoever sits here may run trials.
fn runs(cx: &mut ScreenContext<'_>) -> bool {
    cx.store.people.lacks(Role::Operator, Scope::Control).is_none()
}

/// Whether whoever sits here may close the campaign, and decide where scorers differ.
fn decides(cx: &mut ScreenContext<'_>) -> bool {
    cx.store.people.lacks(Role::Operator, Scope::Data).is_none()
}

fn trial(campaign: &Campaign, number: u32) -> Option<&Trial> {
    campaign.trials.get((number as usize).checked_sub(1)?)
}

fn next_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, campaign: &Campaign, trial: &Trial) {
    let policy = trial.policy.as_ref().map_or_else(String::new, |policy| format!(" with {policy}"));
    ui.strong(format!("Trial {} of {}: {}{policy}", trial.number, campaign.summary.planned, trial.object));
    if ui.available_width() < BESIDE {
        place_ui(ui, &cx.palette, &campaign.plan, &trial.start);
        step_ui(ui, cx, campaign, trial);
        return;
    }
    ui.horizontal_wrapped(|ui| {
        place_ui(ui, &cx.palette, &campaign.plan, &trial.start);
        ui.vertical(|ui| {
            ui.set_max_width((ui.available_width()).clamp(220.0, 460.0));
            step_ui(ui, cx, campaign, trial);
        });
    });
}

/// What is to be done with the trial now.
fn step_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, campaign: &Campaign, trial: &Trial) {
    if let Some(me) = cx.store.people.lacks(Role::Operator, Scope::Control) {
        let begins = words(&trial.start);
        ui.label(match trial.state {
            TrialState::Running => format!("It runs now, with {} at {begins}.", trial.object),
            _ => format!("{} is placed at {begins}; then it begins.", trial.object),
        });
        let may = if me.role < Role::Scorer { "watch" } else { "watch and score" };
        ui.label(
            RichText::new(format!("You are {} ({}): you can {may}. Operators run trials.", me.name, me.role))
                .color(cx.palette.text_weak),
        );
        return;
    }
    if trial.state == TrialState::Running {
        return running_ui(ui, cx, campaign, trial);
    }
    ui.label(format!("Place {} as in the picture: {}.", trial.object, words(&trial.start)));
    ui.label(
        RichText::new("Seen from behind the robot; the arrow is the object's x axis.")
            .color(cx.palette.text_weak),
    );
    ui.add_space(6.0);
    let begin = egui::Button::new(RichText::new("It is placed: begin").strong());
    if ui.add_enabled(!cx.store.campaigns.is_busy, begin).clicked() {
        cx.store.campaigns.act(&campaign.summary.id, false, CampaignAct::Begin(trial.number));
    }
}

fn running_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, campaign: &Campaign, trial: &Trial) {
    let policy = campaign.plan.policies.iter().find(|policy| Some(&policy.id) == trial.policy.as_ref());
    let (source, silenced) =
        policy.map_or(("", false), |policy| (policy.source.as_str(), policy.is_silenced));
    ui.label(format!(
        "Let {source}{} run now. A rollout that is told the campaign ends the trial itself; otherwise say here when it \
         has ended.",
        if silenced { " with its touch silenced" } else { "" }
    ));
    ui.add_space(6.0);
    let attempt = trial.attempts.len() as u32 - 1;
    let id = &campaign.summary.id;
    ui.horizontal_wrapped(|ui| {
        let ended = egui::Button::new(RichText::new("It has ended").strong());
        if ui.add_enabled(!cx.store.campaigns.is_busy, ended).clicked() {
            let outcome = RolloutOutcome {
                suggested: None,
                reasons: Vec::new(),
                time_to_grasp_s: None,
                held_s: None,
                take: None,
                record: None,
            };
            let end = TrialEnd { attempt, outcome };
            cx.store.campaigns.act(id, false, CampaignAct::End(trial.number, end));
        }
    });
}

/// Trials on which scorers differ.
fn settle_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, campaign: &Campaign) {
    let unsettled: Vec<&Trial> =
        campaign.trials.iter().filter(|trial| trial.state == TrialState::Unsettled).collect();
    if unsettled.is_empty() {
        return;
    }
    ui.strong("Scorers differ");
    for trial in unsettled {
        let Some(last) = trial.attempts.last() else { continue };
        let said: Vec<String> =
            last.scores.iter().map(|score| format!("{}: {}", score.scorer, score.verdict.label())).collect();
        ui.label(format!("Trial {} ({}): {}. What counts?", trial.number, trial.object, said.join(", ")));
        ui.horizontal_wrapped(|ui| {
            for verdict in TrialVerdict::ALL {
                let name = format!("Settle trial {} as {}", trial.number, verdict.label());
                let response = ui.button(verdict.label());
                response
                    .widget_info(|| egui::WidgetInfo::labeled(egui::accesskit::Role::Button, true, &name));
                if response.clicked() {
                    let settled = ScoreRequest {
                        scorer: cx.store.control.operator.trim().to_owned(),
                        attempt: trial.attempts.len() as u32 - 1,
                        verdict,
                        note: String::new(),
                    };
                    let act = CampaignAct::Settle(trial.number, settled);
                    cx.store.campaigns.act(&campaign.summary.id, false, act);
                }
            }
        });
    }
    ui.add_space(8.0);
}

/// A break, from which a restart of the studio does not wake the campaign.
fn pause_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, campaign: &Campaign) {
    if campaign.summary.closed.is_some() || campaign.next.is_none() {
        return;
    }
    let (text, hint, act) = match campaign.summary.paused {
        Some(_) => ("Go on", "Trials begin again", CampaignAct::Resume),
        None => (
            "Take a break",
            "No trial begins until somebody goes on; one that runs goes to its end",
            CampaignAct::Pause,
        ),
    };
    let free = !cx.store.campaigns.is_busy;
    if ui.add_enabled(free, egui::Button::new(text)).on_hover_text(hint).clicked() {
        cx.store.campaigns.act(&campaign.summary.id, false, act);
    }
}

fn close_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, campaign: &Campaign) {
    let id = &campaign.summary.id;
    let free = !cx.store.campaigns.is_busy;
    match &campaign.summary.closed {
        None => {
            let hint = match campaign.plan.is_blind {
                true => {
                    "No more trials. Everybody may know then which policy was which, so it cannot be opened again"
                }
                false => "No more trials; it can be opened again",
            };
            let close = ui.add_enabled(free, egui::Button::new("Close the campaign")).on_hover_text(hint);
            if close.clicked() {
                cx.store.campaigns.act(id, false, CampaignAct::Close);
            }
        }
        Some(_) if campaign.plan.is_blind => {}
        Some(_) => {
            if ui.add_enabled(free, egui::Button::new("Open it again")).clicked() {
                cx.store.campaigns.act(id, false, CampaignAct::Reopen);
            }
        }
    }
}

fn list_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, campaign: &Campaign) {
    ui.strong("Trials, in order");
    egui::ScrollArea::horizontal().show(ui, |ui| {
        egui::Grid::new("trials").striped(true).num_columns(6).spacing([14.0, 4.0]).show(ui, |ui| {
            for name in ["", "Object", "Start", "Policy", "State", "Verdict"] {
                ui.label(RichText::new(name).color(cx.palette.text_weak));
            }
            ui.end_row();
            for trial in &campaign.trials {
                let last = trial.attempts.last();
                ui.label(trial.number.to_string());
                ui.label(&trial.object);
                ui.label(trial.start_number.to_string());
                ui.label(trial.policy.as_deref().unwrap_or("hidden"));
                ui.label(state_label(trial.state));
                let verdict = last.and_then(|last| last.verdict);
                ui.horizontal(|ui| {
                    ui.label(verdict.map_or("", TrialVerdict::label));
                    let can_repeat = verdict == Some(TrialVerdict::Void)
                        && runs(cx)
                        && campaign.summary.closed.is_none()
                        && !cx.store.campaigns.is_busy;
                    if can_repeat && ui.small_button(format!("Repeat trial {}", trial.number)).clicked() {
                        cx.store.campaigns.act(&campaign.summary.id, false, CampaignAct::Begin(trial.number));
                    }
                    let take =
                        last.and_then(|last| last.take.as_deref()).and_then(|take| take.split_once('/'));
                    if let Some((session, take)) = take
                        && ui.small_button(format!("Look at {take}")).clicked()
                    {
                        cx.playback.open(session, take);
                        cx.go_to_screen(crate::route::Screen::Timelines);
                    }
                });
                ui.end_row();
            }
        });
    });
}
