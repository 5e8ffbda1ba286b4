//! How trials that were made outside the studio are compared with the simulator: commands to copy.

use std::collections::BTreeMap;

use egui::RichText;
use palpate_wire::api::{Campaign, TrialVerdict};

use crate::screens::{ScreenContext, controls::name_button, copy_as::quoted};

/// The trials of a policy on an object whose records lie in one folder.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Comparison {
    policy: String,
    object: String,
    command: String,
}

/// What can be compared: trials with a record that are not void, of policies that feel something.
fn comparisons(campaign: &Campaign) -> Vec<Comparison> {
    let mut trials: BTreeMap<(&str, &str, &str), Vec<String>> = BTreeMap::new();
    for trial in &campaign.trials {
        let Some(policy) = &trial.policy else { continue };
        let is_silenced = campaign.plan.policies.iter().any(|known| &known.id == policy && known.is_silenced);
        let Some(last) = trial.attempts.last() else { continue };
        let record = last.outcome.as_ref().and_then(|outcome| outcome.record.as_deref());
        // A record without its folder was too long to be told.
        let folder = record.and_then(|record| record.rsplit_once('/')).map(|(folder, _)| folder);
        if let Some(folder) = folder.filter(|_| !is_silenced && last.verdict != Some(TrialVerdict::Void)) {
            trials.entry((policy, &trial.object, folder)).or_default().push(trial.number.to_string());
        }
    }
    let command = |folder: &str, numbers: &[String]| {
        format!("palpate-train compare-rollout --rollout {} --only {}", quoted(folder), numbers.join(","))
    };
    let all = trials.into_iter().map(|((policy, object, folder), numbers)| Comparison {
        policy: policy.to_owned(),
        object: object.to_owned(),
        command: command(folder, &numbers),
    });
    all.collect()
}

/// Whether there is anything to compare in a terminal.
pub(super) fn is_empty(campaign: &Campaign) -> bool {
    comparisons(campaign).is_empty()
}

pub(super) fn commands_ui(ui: &mut egui::Ui, cx: &ScreenContext<'_>, campaign: &Campaign) {
    ui.collapsing("In a terminal instead", |ui| {
        ui.label(
            "This runs outside the studio: in a terminal on the computer that made the trials, in the folder in which \
             the rollout was started. It makes the same trials in the grasp world and says where touch and outcomes \
             differ from the hand. Add --model FILE for a calibrated or diagnosed sensor model beside the nominal one.",
        );
        for Comparison { policy, object, command } in &comparisons(campaign) {
            ui.add_space(4.0);
            ui.horizontal_wrapped(|ui| {
                ui.strong(format!("{policy} on {object}"));
                let copy = ui.button("Copy");
                name_button(&copy, &format!("Copy the command for {policy} on {object}"));
                if copy.clicked() {
                    ui.ctx().copy_text(command.clone());
                }
            });
            let text = RichText::new(command).monospace().color(cx.palette.text_weak);
            ui.add(egui::Label::new(text).wrap().selectable(true));
        }
    });
}
