//! Trials: campaigns of policies on the hand, run, scored and counted.

mod beside;
mod form;
mod hand;
mod place;
mod results;
mod run;
mod score;

use egui::RichText;
use palpate_wire::api::{Campaign, CampaignSummary, Role, Scope, TrialState};

use super::{
    About, ScreenContext, Subject, View,
    controls::{combo_ui, option_ui},
    empty_ui, loaded_ui, progress_bar, said_ui, topic_heading_ui, topic_ui,
};
use crate::{
    route::{Route, Screen},
    store::Loadable,
};

/// Narrower than this, the list of campaigns is a box on top.
const NARROW: f32 = 700.0;

/// This screen.
pub const ABOUT: About = About {
    label: "Trials",
    slug: "trials",
    key: Some(egui::Key::Num0),
    icon: "\u{1f3af}",
    purpose: "Try policies on the hand, score each trial, compare success rates",
    group: Some("Learn"),
    document: ("campaigns", None),
    subject: Subject::Other,
    needs_station: false,
    shows_stream: false,
    new: || Box::<TrialsState>::default(),
};

/// What the operator chose on this screen.
#[derive(Debug, Default)]
struct TrialsState {
    /// The plan that is being written.
    form: Option<form::FormState>,
    score: score::ScoreState,
    hand: hand::HandState,
    beside: beside::BesideState,
}

/// The parts of a campaign.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Part {
    Run,
    Score,
    Results,
}

impl Part {
    const ALL: [(Self, &'static str, &'static str); 3] =
        [(Self::Run, "run", "Run"), (Self::Score, "score", "Score"), (Self::Results, "results", "Results")];

    /// The part that the address names; otherwise what whoever sits here is there for.
    fn of(cx: &mut ScreenContext<'_>) -> Self {
        let named = cx.route.part.as_deref();
        if let Some((part, ..)) = Self::ALL.iter().find(|(_, slug, _)| Some(*slug) == named) {
            return *part;
        }
        let people = &mut cx.store.people;
        let runs = people.lacks(Role::Operator, Scope::Control).is_none();
        if runs || people.lacks(Role::Scorer, Scope::Score).is_some() { Self::Run } else { Self::Score }
    }
}

impl View for TrialsState {
    fn ui(&mut self, ui: &mut egui::Ui, cx: &mut ScreenContext<'_>) {
        let campaigns = cx.store.campaigns.list();
        let Some(campaigns) =
            loaded_ui(ui, cx, campaigns, "Looking for campaigns", "The list of campaigns did not arrive")
        else {
            return;
        };
        if let Loadable::Ready(id) = cx.store.campaigns.made.clone() {
            cx.store.campaigns.made = Loadable::Idle;
            self.form = None;
            *cx.go_to = Some(to(&id, Part::Run));
        }
        if let Some(form) = &mut self.form {
            if form::form_ui(ui, cx, form) {
                self.form = None;
            }
            return;
        }
        let asked = cx.route.campaign.clone();
        let Some(shown) = asked.or_else(|| campaigns.first().map(|campaign| campaign.id.clone())) else {
            let text = "A campaign tries policies on the hand, object by object, from the same starts for each. People score \
                every trial, also from another room; success rates with intervals and comparisons come out: docs/campaigns.md.";
            if !plans(cx) {
                egui::CentralPanel::default().show(ui, |ui| {
                    ui.heading("No campaign yet");
                    said_ui(ui, text);
                    ui.label("Operators plan campaigns.");
                });
                return;
            }
            if empty_ui(ui, "No campaign yet", text, "Plan a campaign") {
                self.form = Some(form::FormState::default());
            }
            return;
        };
        if ui.available_width() < NARROW {
            if narrow_list_ui(ui, cx, &campaigns, &shown) {
                self.form = Some(form::FormState::default());
            }
            campaign_ui(ui, cx, self, &shown);
            return;
        }
        egui::Panel::left("campaigns_list").resizable(false).exact_size(260.0).show(ui, |ui| {
            egui::ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
                ui.add_space(4.0);
                topic_heading_ui(ui, "Campaigns", Screen::Trials);
                for campaign in campaigns.iter() {
                    entry_ui(ui, cx, campaign, campaign.id == shown);
                }
                ui.add_space(8.0);
                if plans(cx) && ui.button("Plan a campaign").clicked() {
                    self.form = Some(form::FormState::default());
                }
            });
        });
        egui::CentralPanel::default().show(ui, |ui| campaign_ui(ui, cx, self, &shown));
    }
}

/// Whether whoever sits here may make campaigns.
fn plans(cx: &mut ScreenContext<'_>) -> bool {
    cx.store.people.lacks(Role::Operator, Scope::Data).is_none()
}

fn to(id: &str, part: Part) -> Route {
    let slug = Part::ALL.iter().find(|(known, ..)| *known == part).map(|(_, slug, _)| (*slug).to_owned());
    Route { campaign: Some(id.to_owned()), part: slug, ..Route::to(Screen::Trials) }
}

/// True when another campaign is to be planned.
fn narrow_list_ui(
    ui: &mut egui::Ui,
    cx: &mut ScreenContext<'_>,
    campaigns: &[CampaignSummary],
    shown: &str,
) -> bool {
    let mut chosen = shown.to_owned();
    let name = |id: &str| {
        campaigns
            .iter()
            .find(|campaign| campaign.id == id)
            .map_or(id.to_owned(), |campaign| campaign.name.clone())
    };
    combo_ui(ui, "Campaign", &name(shown), ui.available_width() - 16.0, |ui| {
        for campaign in campaigns {
            option_ui(ui, &mut chosen, campaign.id.clone(), &campaign.name);
        }
    });
    if chosen != shown {
        let part = Part::of(cx);
        *cx.go_to = Some(to(&chosen, part));
    }
    ui.horizontal_wrapped(|ui| {
        topic_ui(ui, Screen::Trials);
        plans(cx) && ui.button("Plan a campaign").clicked()
    })
    .inner
}

fn entry_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, campaign: &CampaignSummary, is_chosen: bool) {
    let fact = match (&campaign.error, &campaign.closed) {
        (Some(_), _) => "cannot be read".to_owned(),
        (None, Some(_)) => format!("closed, {}/{}", campaign.scored, campaign.planned),
        (None, None) if campaign.paused.is_some() => {
            format!("paused, {}/{}", campaign.scored, campaign.planned)
        }
        (None, None) => format!("{}/{}", campaign.scored, campaign.planned),
    };
    let button = egui::Button::selectable(is_chosen, RichText::new(&campaign.name).strong())
        .right_text(RichText::new(fact).color(cx.palette.text_weak))
        .min_size(egui::vec2(ui.available_width() - 8.0, 36.0))
        .truncate();
    let response = ui.add(button);
    response.widget_info(|| {
        let name = format!("Campaign {}", campaign.name);
        egui::WidgetInfo::selected(egui::accesskit::Role::Button, true, is_chosen, name)
    });
    if response.clicked() {
        let part = Part::of(cx);
        *cx.go_to = Some(to(&campaign.id, part));
    }
}

fn campaign_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, state: &mut TrialsState, id: &str) {
    let part = Part::of(cx);
    let as_scorer = part == Part::Score;
    let name = cx.store.control.operator.clone();
    let campaign = cx.store.campaigns.campaign(id, &name, as_scorer);
    let Some(campaign) = loaded_ui(ui, cx, campaign, "Opening the campaign", "The campaign cannot be opened")
    else {
        return;
    };
    ui.add_space(4.0);
    ui.add(egui::Label::new(RichText::new(&campaign.summary.name).heading()).truncate());
    progress_ui(ui, &campaign);
    ui.horizontal_wrapped(|ui| {
        for (known, _, label) in Part::ALL {
            let text = match known {
                Part::Score if campaign.summary.to_score > 0 => {
                    format!("{label} ({})", campaign.summary.to_score)
                }
                _ => label.to_owned(),
            };
            let response =
                ui.add(egui::Button::selectable(known == part, text).min_size(egui::vec2(72.0, 34.0)));
            response.widget_info(|| {
                egui::WidgetInfo::selected(egui::accesskit::Role::Tab, true, known == part, label)
            });
            if response.clicked() {
                *cx.go_to = Some(to(id, known));
            }
        }
    });
    ui.separator();
    if let Some(problem) = cx.store.campaigns.problem.clone() {
        ui.horizontal_wrapped(|ui| {
            ui.colored_label(cx.palette.mismatch, format!("\u{26a0} {problem}"));
            if ui.button("Dismiss").clicked() {
                cx.store.campaigns.problem = None;
            }
        });
    }
    egui::ScrollArea::vertical().auto_shrink(false).show(ui, |ui| match part {
        Part::Run => run::run_ui(ui, cx, &mut state.hand, &campaign),
        Part::Score => score::score_ui(ui, cx, &mut state.score, &campaign),
        Part::Results => results::results_ui(ui, cx, &mut state.beside, &campaign),
    });
}

fn progress_ui(ui: &mut egui::Ui, campaign: &Campaign) {
    let summary = &campaign.summary;
    let share = f64::from(summary.scored) / f64::from(summary.planned.max(1));
    let width = ui.available_width().min(420.0);
    let text = match &summary.closed {
        Some(_) => format!("closed: {} of {} trials have a verdict", summary.scored, summary.planned),
        None => format!("{} of {} trials have a verdict", summary.scored, summary.planned),
    };
    ui.add(progress_bar(share, &text).desired_width(width));
}

/// What a state is called.
fn state_label(state: TrialState) -> &'static str {
    match state {
        TrialState::Waiting => "waits",
        TrialState::Running => "runs",
        TrialState::Unscored => "to score",
        TrialState::Unsettled => "scorers differ",
        TrialState::Scored => "scored",
    }
}
