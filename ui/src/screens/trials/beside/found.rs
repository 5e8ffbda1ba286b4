//! What a comparison found: how often each side won, which trials differ, and where to go on from there.

use std::collections::BTreeMap;

use egui::RichText;
use palpate_reports::wording::counted;
use palpate_wire::api::{ComparedTrial, ComparisonReport, SaidBy, SuccessRate, TrialVerdict};

use crate::{
    route::{Route, Screen},
    screens::ScreenContext,
};

pub(super) fn found_ui(
    ui: &mut egui::Ui,
    cx: &mut ScreenContext<'_>,
    shows_all: &mut bool,
    report: &ComparisonReport,
) {
    ui.add_space(8.0);
    let num_trials = report.trials.len() as u64;
    let num_differing = report.trials.iter().filter(|trial| trial.differs()).count() as u64;
    let verdict = match (num_trials, num_differing) {
        (0, _) => "No trial could be compared.".to_owned(),
        (_, 0) => format!(
            "Hand and simulation agree on the outcome of {}; touch may differ all the same.",
            counted(num_trials, "trial")
        ),
        _ => format!("Outcomes differ in {num_differing} of {}.", counted(num_trials, "trial")),
    };
    ui.label(RichText::new(verdict).strong());
    if num_trials > 0 {
        pairings_ui(ui, cx, report);
        ui.add_space(6.0);
        trials_ui(ui, cx, shows_all, report);
        ui.add_space(6.0);
        doubts_ui(ui, cx, report);
        takes_ui(ui, cx, report, num_differing > 0);
    }
    left_out_ui(ui, report);
    ui.add_space(6.0);
}

/// What a model is called.
fn model_name<'a>(report: &'a ComparisonReport, id: &'a str) -> &'a str {
    report.models.iter().find(|model| model.id == id).map_or(id, |model| &model.name)
}

fn rate_text(rate: &SuccessRate) -> String {
    let [low, high] = rate.wilson_95.map(|end| 100.0 * end);
    format!("{}/{} ({low:.0} to {high:.0} %)", rate.successes, rate.trials)
}

fn number(value: Option<f64>, digits: usize) -> String {
    value.map_or_else(|| "-".to_owned(), |value| format!("{value:.digits$}"))
}

fn pairings_ui(ui: &mut egui::Ui, cx: &ScreenContext<'_>, report: &ComparisonReport) {
    egui::ScrollArea::horizontal().id_salt("pairings").show(ui, |ui| {
        egui::Grid::new("pairings").striped(true).spacing([18.0, 4.0]).show(ui, |ui| {
            for name in [
                "Policy and object",
                "Sensor model",
                "Won on the hand",
                "Won in simulation",
                "Same outcome",
                "Touch: F1",
                "Gap",
                "Contacts, hand",
                "simulation",
                "Won by hand alone",
                "by simulation alone",
                "p",
            ] {
                ui.label(RichText::new(name).color(cx.palette.text_weak));
            }
            ui.end_row();
            for pairing in &report.pairings {
                let of = match (&pairing.policy, &pairing.object) {
                    (Some(policy), Some(object)) => format!("{policy} on {object}"),
                    _ => "all together".to_owned(),
                };
                let touch = pairing.touch.as_ref();
                let contacts =
                    |count: Option<u64>| count.map_or_else(|| "-".to_owned(), |count| count.to_string());
                for text in [
                    of,
                    model_name(report, &pairing.model).to_owned(),
                    rate_text(&pairing.hand),
                    rate_text(&pairing.simulated),
                    format!("{} of {}", pairing.same_verdict, pairing.hand.trials),
                    number(touch.and_then(|touch| touch.f1), 2),
                    number(touch.and_then(|touch| touch.gap), 4),
                    contacts(touch.map(|touch| touch.hand_contacts)),
                    contacts(touch.map(|touch| touch.simulated_contacts)),
                    pairing.only_hand.to_string(),
                    pairing.only_simulated.to_string(),
                    format!("{:.2}", pairing.p_mcnemar),
                ] {
                    ui.label(text);
                }
                ui.end_row();
            }
        });
    });
    ui.label(
        RichText::new(
            "In brackets Wilson's 95 % intervals; p is McNemar's exact test. Touch is compared from the same start: the gap is \
             mismatch in seconds a channel-second.",
        )
        .color(cx.palette.text_weak)
        .small(),
    );
}

/// Who says what a trial on the hand came to.
fn said_by(said_by: SaidBy) -> &'static str {
    match said_by {
        SaidBy::Scorers => "scored",
        SaidBy::Operator => "station's operator",
        SaidBy::Robot => "the robot's own",
    }
}

fn trials_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, shows_all: &mut bool, report: &ComparisonReport) {
    if report.trials.iter().any(|trial| !trial.differs()) {
        ui.checkbox(shows_all, "Show trials that agree too");
    }
    let shown: Vec<&ComparedTrial> =
        report.trials.iter().filter(|trial| *shows_all || trial.differs()).collect();
    if shown.is_empty() {
        return;
    }
    egui::ScrollArea::horizontal().id_salt("compared_trials").show(ui, |ui| {
        egui::Grid::new("compared_trials").striped(true).spacing([18.0, 4.0]).show(ui, |ui| {
            for name in ["Trial", "Object", "Policy", "On the hand"] {
                ui.label(RichText::new(name).color(cx.palette.text_weak));
            }
            for model in &report.models {
                ui.label(RichText::new(&model.name).color(cx.palette.text_weak));
            }
            ui.end_row();
            for trial in shown {
                ui.label(trial.trial.to_string());
                ui.label(&trial.object);
                ui.label(&trial.policy);
                ui.label(format!("{} ({})", trial.hand.label(), said_by(trial.said_by)));
                for verdict in &trial.simulated {
                    verdict_ui(ui, cx, *verdict, trial.hand);
                }
                if let Some((session, take)) = trial.take.as_deref().and_then(|take| take.split_once('/'))
                    && ui.small_button(format!("Look at {take}")).clicked()
                {
                    cx.playback.open(session, take);
                    cx.go_to_screen(Screen::Timelines);
                }
                ui.end_row();
            }
        });
    });
}

/// What a simulated trial came to; a sign says whether the hand agrees, which colour alone would not.
fn verdict_ui(ui: &mut egui::Ui, cx: &ScreenContext<'_>, verdict: TrialVerdict, hand: TrialVerdict) {
    match verdict == hand {
        true => ui.label(format!("\u{2714} {}", verdict.label())),
        false => ui.colored_label(cx.palette.mismatch, format!("\u{2716} {}", verdict.label())),
    };
}

/// What makes the comparison worth less.
fn doubts_ui(ui: &mut egui::Ui, cx: &ScreenContext<'_>, report: &ComparisonReport) {
    let count =
        |is: fn(&ComparedTrial) -> bool| report.trials.iter().filter(|trial| is(trial)).count() as u64;
    let num_planned = count(|trial| trial.is_start_planned);
    if num_planned > 0 {
        let text = format!(
            "In {} nobody measured where the object began; the simulation has it where the plan says.",
            counted(num_planned, "trial")
        );
        ui.label(RichText::new(text).color(cx.palette.text_weak));
    }
    let num_own = count(|trial| trial.said_by == SaidBy::Robot);
    if num_own > 0 {
        let text = format!(
            "In {} the robot's own suggestion counts, because nobody has scored them; it cannot see an object that slides.",
            counted(num_own, "trial")
        );
        ui.label(RichText::new(text).color(cx.palette.text_weak));
    }
}

/// Where the takes of the trials are, and what can be done with them.
fn takes_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, report: &ComparisonReport, is_differing: bool) {
    // By session: takes, and those in which the object was followed.
    let mut sessions: BTreeMap<&str, [u64; 2]> = BTreeMap::new();
    for trial in &report.trials {
        if let Some((session, _)) = trial.take.as_deref().and_then(|take| take.split_once('/')) {
            let counts = sessions.entry(session).or_default();
            counts[0] += 1;
            counts[1] += u64::from(trial.is_followed);
        }
    }
    if sessions.is_empty() {
        ui.label(
            "These trials were not recorded as takes, so a diagnosis has nothing to look at. Next time leave \u{201c}Record \
             each trial as a take\u{201d} ticked before the policies run.",
        );
        return;
    }
    let several = sessions.len() > 1;
    for (session, [num_takes, num_followed]) in sessions {
        ui.horizontal_wrapped(|ui| {
            ui.label(format!("{} of these trials are in session {session}.", counted(num_takes, "take")));
            let which = if several { format!(" of {session}") } else { String::new() };
            let text = RichText::new(format!("Diagnose these takes{which}"));
            let text = if is_differing { text.strong() } else { text };
            if ui.button(text).clicked() {
                cx.playback.open_session(session);
                *cx.go_to = Some(Route::to(Screen::Diagnose).with_session(session));
            }
            if ui.button(format!("Open session {session}")).clicked() {
                cx.playback.open_session(session);
                *cx.go_to = Some(Route::to(Screen::Sessions).with_session(session));
            }
        });
        if num_followed < num_takes {
            let text = format!(
                "In {} nobody followed the object: it counts as standing where the plan put it, though a hand that grasps \
                 moves it. What a diagnosis names may stand for that.",
                counted(num_takes - num_followed, "take")
            );
            ui.label(RichText::new(text).color(cx.palette.warning));
        }
    }
}

fn left_out_ui(ui: &mut egui::Ui, report: &ComparisonReport) {
    if report.left_out.is_empty() {
        return;
    }
    let mut by_why: BTreeMap<&str, Vec<String>> = BTreeMap::new();
    for trial in &report.left_out {
        by_why.entry(&trial.why).or_default().push(trial.trial.to_string());
    }
    let title = format!("{} left out", counted(report.left_out.len() as u64, "trial"));
    ui.collapsing(title, |ui| {
        for (why, numbers) in by_why {
            ui.add(egui::Label::new(format!("Trial {}: {why}.", numbers.join(", "))).wrap());
        }
    });
}
