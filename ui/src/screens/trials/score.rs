//! Scoring a trial, from the next chair or another room: keys alone are enough.

use egui::{Key, RichText};
use palpate_wire::api::{Campaign, Role, Scope, ScoreBack, ScoreRequest, Trial, TrialState, TrialVerdict};

use super::place::words;
use crate::{
    api_client::CampaignAct,
    playback::HandSource,
    route::{Route, Screen},
    screens::{ScreenContext, as_sentence, duration_text},
};

/// Verdicts, their keys and what they mean.
const KEYS: [(TrialVerdict, Key, &str, &str); 5] = [
    (TrialVerdict::Success, Key::S, "S", "lifted and held as long as asked"),
    (TrialVerdict::EmptyGrasp, Key::E, "E", "the hand never had the object"),
    (TrialVerdict::Slip, Key::L, "L", "the hand had the object and lost it"),
    (TrialVerdict::EmergencyStop, Key::X, "X", "a safety limit or a person ended the trial"),
    (TrialVerdict::Void, Key::V, "V", "it says nothing about the policy, e.g. the object was placed wrongly"),
];

/// What the scorer has written.
#[derive(Debug, Default)]
pub(super) struct ScoreState {
    note: String,
    /// Under which name the campaign was asked for last.
    asked_as: String,
}

pub(super) fn score_ui(
    ui: &mut egui::Ui,
    cx: &mut ScreenContext<'_>,
    state: &mut ScoreState,
    campaign: &Campaign,
) {
    if let Some(me) = cx.store.people.lacks(Role::Scorer, Scope::Score) {
        ui.label(format!(
            "You are {} ({}): you can watch. Scorers and operators score trials.",
            me.name, me.role
        ));
        live_ui(ui, cx);
        return;
    }
    if !name_ui(ui, cx, state, campaign) {
        return;
    }
    if campaign.plan.is_blind && campaign.summary.closed.is_none() {
        ui.label(
            RichText::new("This campaign is blind: which policy moved the hand is shown once it is closed.")
                .color(cx.palette.text_weak),
        );
    }
    match campaign.next_to_score.and_then(|number| campaign.trials.get(number as usize - 1)) {
        Some(trial) => trial_ui(ui, cx, state, campaign, trial),
        None => {
            let running = campaign.trials.iter().find(|trial| trial.state == TrialState::Running);
            let text = match running {
                Some(trial) => {
                    format!("Trial {} is running: watch it, and score it when it has ended.", trial.number)
                }
                None => "Nothing to score now. This page says so as soon as there is.".to_owned(),
            };
            ui.label(text);
            live_ui(ui, cx);
        }
    }
    ui.add_space(10.0);
    own_ui(ui, cx, campaign);
}

/// Asks who scores. `false` until somebody has said.
fn name_ui(
    ui: &mut egui::Ui,
    cx: &mut ScreenContext<'_>,
    state: &mut ScoreState,
    campaign: &Campaign,
) -> bool {
    let has_name = !cx.store.control.operator.trim().is_empty();
    ui.horizontal_wrapped(|ui| {
        if let Some(name) = cx.store.people.login() {
            ui.label(format!("You score as {name}."));
            return;
        }
        let label = ui.label("You score as");
        let field = egui::TextEdit::singleline(&mut cx.store.control.operator)
            .hint_text("your name")
            .desired_width(160.0)
            .char_limit(40);
        ui.add(field).labelled_by(label.id);
    });
    if !has_name {
        ui.label("Write your name to score: it stands beside each of your verdicts.");
        return false;
    }
    let name = cx.store.control.operator.trim().to_owned();
    if state.asked_as != name {
        state.asked_as.clone_from(&name);
        cx.store.campaigns.ask_again(&campaign.summary.id, &name, true);
    }
    true
}

fn trial_ui(
    ui: &mut egui::Ui,
    cx: &mut ScreenContext<'_>,
    state: &mut ScoreState,
    campaign: &Campaign,
    trial: &Trial,
) {
    ui.add_space(4.0);
    ui.heading(format!("Trial {}: {}", trial.number, trial.object));
    if !campaign.plan.criterion.is_empty() {
        ui.label(format!("A success is: {}.", campaign.plan.criterion));
    }
    ui.label(RichText::new(format!("It began at {}.", words(&trial.start))).color(cx.palette.text_weak));
    let Some(last) = trial.attempts.last() else { return };
    if let Some(outcome) = &last.outcome {
        if let Some(suggested) = outcome.suggested {
            ui.label(format!("The rollout suggests: {}.", suggested.label()));
        }
        for reason in &outcome.reasons {
            ui.label(format!("\u{2022} {reason}"));
        }
        if let Some(held_s) = outcome.held_s {
            ui.label(format!("\u{2022} held for {}", duration_text(held_s)));
        }
    }
    ui.horizontal_wrapped(|ui| {
        if let Some((session, take)) = last.take.as_deref().and_then(|take| take.split_once('/'))
            && ui.button("Look at the recording").clicked()
        {
            cx.playback.open(session, take);
            cx.go_to_screen(Screen::Timelines);
        }
        live_ui(ui, cx);
    });
    ui.add_space(6.0);
    let label = ui.label("Note (optional)");
    let note =
        ui.add(egui::TextEdit::singleline(&mut state.note).desired_width(f32::INFINITY).char_limit(500));
    let is_writing = note.labelled_by(label.id).has_focus() || ui.ctx().text_edit_focused();
    ui.add_space(6.0);
    let free = !cx.store.campaigns.is_busy;
    for (verdict, key, letter, meaning) in KEYS {
        let text = RichText::new(format!("{letter}   {}", as_sentence(verdict.label()))).strong();
        let button = egui::Button::new(text)
            .right_text(RichText::new(""))
            .min_size(egui::vec2(ui.available_width().min(420.0), 44.0));
        let response = ui.add_enabled(free, button).on_hover_text(meaning);
        response.widget_info(|| {
            egui::WidgetInfo::labeled(
                egui::accesskit::Role::Button,
                free,
                format!("Score: {}", verdict.label()),
            )
        });
        let by_key =
            free && !is_writing && ui.input(|input| input.key_pressed(key) && input.modifiers.is_none());
        if response.clicked() || by_key {
            let request = ScoreRequest {
                scorer: cx.store.control.operator.trim().to_owned(),
                attempt: trial.attempts.len() as u32 - 1,
                verdict,
                note: std::mem::take(&mut state.note),
            };
            cx.store.campaigns.act(&campaign.summary.id, true, CampaignAct::Score(trial.number, request));
            break;
        }
    }
}

fn live_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>) {
    if cx.store.live_frame().is_some() && ui.button("Watch the live hand").clicked() {
        cx.playback.hand_source = HandSource::Live;
        *cx.go_to = Some(Route { live: true, ..Route::to(Screen::Hand) });
    }
}

/// What this scorer said, newest first, to take back.
fn own_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, campaign: &Campaign) {
    const MAX_SHOWN: usize = 10;
    let name = cx.store.control.operator.trim().to_owned();
    let mut own: Vec<_> = campaign
        .trials
        .iter()
        .filter_map(|trial| {
            let last = trial.attempts.last()?;
            let score = last.scores.iter().find(|score| score.scorer == name)?;
            Some((score.time.clone(), trial, score.verdict, last.settled.is_some()))
        })
        .collect();
    own.sort_by(|a, b| b.0.cmp(&a.0));
    if own.is_empty() {
        return;
    }
    ui.strong("Your verdicts");
    for (_, trial, verdict, is_settled) in own.into_iter().take(MAX_SHOWN) {
        ui.horizontal_wrapped(|ui| {
            ui.label(format!("Trial {} ({}): {}", trial.number, trial.object, verdict.label()));
            let can = !is_settled && campaign.summary.closed.is_none() && !cx.store.campaigns.is_busy;
            if can && ui.button(format!("Take back {}", trial.number)).clicked() {
                let back = ScoreBack { scorer: name.clone(), attempt: trial.attempts.len() as u32 - 1 };
                cx.store.campaigns.act(&campaign.summary.id, true, CampaignAct::Unscore(trial.number, back));
            }
        });
    }
}
