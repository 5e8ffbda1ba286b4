//! What a comparison of hand and simulation found, as text and as a document.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use palpate_calibration::metrics::{MetricsSum, compare_take};
use palpate_grasp::trial::{Outcome, Score};
use palpate_rollout::verdict::TrialVerdict;
use palpate_statistics::mcnemar_exact;
use serde::Serialize;
use serde_json::{Value, json};

use crate::files::Source;

/// Channels in the text: those that differ most.
const SHOWN_CHANNELS: usize = 8;

/// Numbers of the trials that could not be compared, by why.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(super) struct LeftOut {
    /// Nobody knows where the object was: a person placed it.
    pub(super) unknown_start: Vec<u64>,
    /// The object does not begin here where the record says it did.
    pub(super) another_start: Vec<u64>,
    /// No trial of the policy.
    pub(super) void: Vec<u64>,
    /// The record ends before the trial does.
    pub(super) no_outcome: Vec<u64>,
}

/// A trial on the hand.
#[derive(Clone, Copy, Debug)]
pub(super) struct OnHand {
    pub(super) trial: u64,
    /// Not void.
    pub(super) verdict: TrialVerdict,
    /// Nobody looked: it is what the robot suggested.
    pub(super) is_suggested: bool,
}

/// Touch of the hand beside touch of a simulation, by channel.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Touch {
    channels: Vec<MetricsSum>,
    /// When each channel was first on, by hand and by simulation, s.
    first_on_s: Vec<(Option<f64>, Option<f64>)>,
}

impl Touch {
    /// For as long as both last; `[step * num_channels + channel]`.
    pub(super) fn of(rate_hz: f64, num_channels: usize, hand: &[bool], simulated: &[bool]) -> Self {
        let num_values = hand.len().min(simulated.len());
        let (hand, simulated) = (&hand[..num_values], &simulated[..num_values]);
        let num_steps = num_values / num_channels.max(1);
        let times_s: Vec<f64> = (0..num_steps).map(|step| step as f64 / rate_hz).collect();
        let first_on_s = |active: &[bool], channel: usize| {
            let mut of_channel = active.iter().skip(channel).step_by(num_channels.max(1));
            of_channel.position(|on| *on).map(|step| step as f64 / rate_hz)
        };
        Self {
            channels: compare_take(&times_s, num_channels, hand, simulated),
            first_on_s: (0..num_channels)
                .map(|channel| (first_on_s(hand, channel), first_on_s(simulated, channel)))
                .collect(),
        }
    }
}

/// A trial on the hand beside those of a sensor model.
#[derive(Clone, Debug)]
pub(super) struct Pair {
    /// Of the same policy from the same start.
    pub(super) outcome: Outcome,
    pub(super) touch: Touch,
    /// Of the same commands from the same start.
    pub(super) replayed_outcome: Outcome,
    pub(super) replayed_touch: Touch,
    /// Mean absolute difference of joint positions under the same commands, by joint, rad or m.
    pub(super) joint_difference: Vec<f64>,
}

/// What one sensor model gave, in the order of [`Comparison::hand`].
pub(super) struct Model {
    pub(super) name: String,
    pub(super) sources: Vec<Source>,
    pub(super) pairs: Vec<Pair>,
}

/// Everything that was compared.
pub(super) struct Comparison {
    pub(super) rollout: String,
    pub(super) object: String,
    pub(super) policy: String,
    pub(super) channels: Vec<String>,
    pub(super) control_rate_hz: f64,
    pub(super) num_recorded: usize,
    pub(super) left_out: LeftOut,
    /// Trials that are compared with the object where the campaign's plan has it, because nobody measured where it was.
    pub(super) starts_as_planned: Vec<u64>,
    pub(super) hand: Vec<OnHand>,
    pub(super) models: Vec<Model>,
    pub(super) seconds: f64,
}

/// The hand beside a simulation.
#[derive(Clone, Debug, PartialEq, Serialize)]
struct Paired {
    #[serde(flatten)]
    score: Score,
    /// Trials with the same verdict on both sides.
    same_verdict: usize,
    /// Trials won on the hand alone, and in simulation alone.
    only_hand: u64,
    only_simulation: u64,
    /// McNemar's exact test, two-sided.
    p_value: f64,
    /// Trials by verdict of the hand, then of the simulation.
    verdicts: BTreeMap<&'static str, BTreeMap<&'static str, u64>>,
}

impl Paired {
    fn of(hand: &[Outcome], simulated: &[Outcome]) -> Self {
        let (mut same_verdict, mut only_hand, mut only_simulation) = (0, 0, 0);
        let mut verdicts: BTreeMap<_, BTreeMap<_, u64>> = BTreeMap::new();
        for (hand, simulated) in hand.iter().zip(simulated) {
            let (won, simulated_won) = (*hand == Outcome::Success, *simulated == Outcome::Success);
            same_verdict += usize::from(hand == simulated);
            only_hand += u64::from(won && !simulated_won);
            only_simulation += u64::from(!won && simulated_won);
            *verdicts.entry(word(*hand)).or_default().entry(word(*simulated)).or_default() += 1;
        }
        Self {
            score: Score::of(simulated),
            same_verdict,
            only_hand,
            only_simulation,
            p_value: mcnemar_exact(only_hand, only_simulation),
            verdicts,
        }
    }
}

/// A verdict as records of rollouts have it.
fn word(outcome: Outcome) -> &'static str {
    match outcome {
        Outcome::Success => "success",
        Outcome::EmptyGrasp => "EG",
        Outcome::Slip => "SL",
        Outcome::EmergencyStop => "ES",
    }
}

/// A verdict of the hand as the grasp world has it; a void one is left out before.
fn outcome(verdict: TrialVerdict) -> Outcome {
    match verdict {
        TrialVerdict::Success => Outcome::Success,
        TrialVerdict::EmptyGrasp => Outcome::EmptyGrasp,
        TrialVerdict::Slip => Outcome::Slip,
        TrialVerdict::EmergencyStop | TrialVerdict::Void => Outcome::EmergencyStop,
    }
}

/// Touch of all trials.
#[derive(Clone, Debug, PartialEq, Serialize)]
struct TouchReport {
    /// `2 TP / (2 TP + FP + FN)` over channel-steps; `null` where nobody felt anything.
    f1: Option<f64>,
    /// Mismatch, seconds a channel-second.
    gap: Option<f64>,
    /// Mean absolute difference of onsets that belong together, ms.
    onset_error_ms: Option<f64>,
    /// Contacts of the hand that have a partner in simulation, of all.
    onset_coverage: Option<f64>,
    hand_contacts: u64,
    simulated_contacts: u64,
    /// Those that felt anything on either side, the largest mismatch first.
    channels: Vec<ChannelReport>,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
struct ChannelReport {
    channel: String,
    f1: Option<f64>,
    gap: Option<f64>,
    onset_error_ms: Option<f64>,
    onset_coverage: Option<f64>,
    /// Trials in which only the hand felt something, only the simulation, and both.
    trials_hand_only: u64,
    trials_simulation_only: u64,
    trials_both: u64,
    /// Median over the trials in which both felt something: first onset in simulation minus that on the hand, ms.
    first_onset_later_ms: Option<f64>,
}

impl TouchReport {
    fn of<'a>(names: &[String], trials: impl Iterator<Item = &'a Touch>) -> Self {
        let trials: Vec<&Touch> = trials.collect();
        let mut channels: Vec<(u64, ChannelReport)> = Vec::new();
        let mut all = MetricsSum::default();
        for (channel, name) in names.iter().enumerate() {
            let sum: MetricsSum = trials.iter().map(|trial| trial.channels[channel]).sum();
            all += sum;
            let firsts = || trials.iter().map(|trial| trial.first_on_s[channel]);
            let count = |wanted: (bool, bool)| {
                firsts().filter(|(hand, simulated)| (hand.is_some(), simulated.is_some()) == wanted).count()
                    as u64
            };
            let later_ms: Vec<f64> =
                firsts().filter_map(|(hand, simulated)| Some(1e3 * (simulated? - hand?))).collect();
            let report = ChannelReport {
                channel: name.clone(),
                f1: sum.f1(),
                gap: gap(&sum),
                onset_error_ms: sum.onset_error_ms(),
                onset_coverage: sum.coverage(),
                trials_hand_only: count((true, false)),
                trials_simulation_only: count((false, true)),
                trials_both: count((true, true)),
                first_onset_later_ms: median(later_ms),
            };
            if sum.f1().is_some() {
                channels.push((sum.l1(), report));
            }
        }
        // The sort is stable: channels that differ as much stay in the layout's order.
        channels.sort_by_key(|(l1, _)| std::cmp::Reverse(*l1));
        Self {
            f1: all.f1(),
            gap: gap(&all),
            onset_error_ms: all.onset_error_ms(),
            onset_coverage: all.coverage(),
            hand_contacts: all.real_contacts,
            simulated_contacts: all.simulated_contacts,
            channels: channels.into_iter().map(|(_, report)| report).collect(),
        }
    }

    fn text(&self, name: &str, text: &mut String) {
        // A string takes every line.
        let _ = writeln!(
            text,
            "touch, {name}: F1 {}, gap {}, onsets {} ms apart, {} of {} contacts of the hand found, {} simulated",
            number(self.f1, 2),
            number(self.gap, 4),
            number(self.onset_error_ms, 0),
            self.onset_coverage.map_or(0, |share| (share * self.hand_contacts as f64).round() as u64),
            self.hand_contacts,
            self.simulated_contacts
        );
        for channel in self.channels.iter().take(SHOWN_CHANNELS) {
            let _ = writeln!(
                text,
                "  {:<24} F1 {:>5}  gap {:>6}  hand only {:<3} simulation only {:<3} both {:<3} simulation later by {:>5} ms",
                channel.channel,
                number(channel.f1, 2),
                number(channel.gap, 3),
                channel.trials_hand_only,
                channel.trials_simulation_only,
                channel.trials_both,
                number(channel.first_onset_later_ms, 0)
            );
        }
        let more = self.channels.len().saturating_sub(SHOWN_CHANNELS);
        if more > 0 {
            let _ = writeln!(text, "  and {more} more that felt something");
        }
    }
}

/// Mismatch, seconds a channel-second.
fn gap(sum: &MetricsSum) -> Option<f64> {
    let all = sum.true_positives + sum.true_negatives + sum.l1();
    (all > 0).then(|| sum.l1() as f64 / all as f64)
}

/// The middle value; the mean of the two in the middle of an even number.
fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    let middle = values.len() / 2;
    match values.len() {
        0 => None,
        count if count % 2 == 1 => Some(values[middle]),
        _ => Some(0.5 * (values[middle - 1] + values[middle])),
    }
}

fn number(value: Option<f64>, digits: usize) -> String {
    value.map_or_else(|| "-".to_owned(), |value| format!("{value:.digits$}"))
}

impl Comparison {
    fn hand_outcomes(&self) -> Vec<Outcome> {
        self.hand.iter().map(|trial| outcome(trial.verdict)).collect()
    }

    fn num_suggested(&self) -> usize {
        self.hand.iter().filter(|trial| trial.is_suggested).count()
    }

    fn touch(&self, model: &Model, of: fn(&Pair) -> &Touch) -> TouchReport {
        TouchReport::of(&self.channels, model.pairs.iter().map(of))
    }

    fn paired(&self, model: &Model, of: fn(&Pair) -> Outcome) -> Paired {
        let simulated: Vec<Outcome> = model.pairs.iter().map(of).collect();
        Paired::of(&self.hand_outcomes(), &simulated)
    }

    /// As JSON, with every trial or without.
    pub(super) fn document(&self, with_trials: bool) -> Value {
        let models: Vec<Value> = self.models.iter().map(|model| self.model(model, with_trials)).collect();
        let mut hand = json!(Score::of(&self.hand_outcomes()));
        hand["seen_by_operator"] = json!(self.hand.len() - self.num_suggested());
        hand["suggested_by_robot"] = json!(self.num_suggested());
        if with_trials {
            let trials = self.hand.iter().map(|trial| {
                json!({ "trial": trial.trial, "verdict": trial.verdict, "is_suggested": trial.is_suggested })
            });
            hand["each"] = trials.collect();
        }
        json!({
            "rollout": self.rollout,
            "object": self.object,
            "policy": self.policy,
            "recorded": self.num_recorded,
            "compared": self.hand.len(),
            "left_out": self.left_out,
            "starts_as_planned": self.starts_as_planned,
            "control_rate_hz": self.control_rate_hz,
            "hand": hand,
            "models": models,
            "seconds": self.seconds,
        })
    }

    fn model(&self, model: &Model, with_trials: bool) -> Value {
        let mut same_start = json!(self.paired(model, |pair| pair.outcome));
        same_start["touch"] = json!(self.touch(model, |pair| &pair.touch));
        let mut same_commands = json!(self.paired(model, |pair| pair.replayed_outcome));
        same_commands["touch"] = json!(self.touch(model, |pair| &pair.replayed_touch));
        same_commands["joint_difference"] = json!(mean_by_joint(&model.pairs));
        if with_trials {
            let each = |of: fn(&Pair) -> Outcome| -> Value {
                let trials = self.hand.iter().zip(&model.pairs);
                trials.map(|(hand, pair)| json!({ "trial": hand.trial, "verdict": word(of(pair)) })).collect()
            };
            same_start["each"] = each(|pair| pair.outcome);
            same_commands["each"] = each(|pair| pair.replayed_outcome);
        }
        json!({
            "model": model.name, "same_start": same_start, "same_commands": same_commands, "sources": model.sources,
        })
    }

    /// As lines for people.
    pub(super) fn text(&self) -> String {
        let mut text = format!(
            "{}: {}, {}; {} of {} trials compared\n",
            self.rollout,
            self.object,
            self.policy,
            self.hand.len(),
            self.num_recorded
        );
        let LeftOut { unknown_start, another_start, void, no_outcome } = &self.left_out;
        for (numbers, why) in [
            (unknown_start, "a person placed the object, so nobody knows where it began"),
            (another_start, "the object does not begin here where the record says that it did"),
            (void, "void"),
            (no_outcome, "the record ends before the trial does"),
        ] {
            if !numbers.is_empty() {
                let shown: Vec<String> = numbers.iter().map(u64::to_string).collect();
                let _ = writeln!(text, "left out, {why}: trial {}", shown.join(", "));
            }
        }
        if !self.starts_as_planned.is_empty() {
            let shown: Vec<String> = self.starts_as_planned.iter().map(u64::to_string).collect();
            let _ = writeln!(
                text,
                "the object begins where the plan has it, as nobody measured where it was: trial {}",
                shown.join(", ")
            );
        }
        if self.hand.is_empty() {
            return text;
        }
        let score = Score::of(&self.hand_outcomes());
        let [low, high] = score.interval_95;
        let _ = writeln!(
            text,
            "\nhand: won {} of {} ({low:.2} to {high:.2}); verdicts of the station's operator {}, of the robot {}",
            score.successes,
            score.trials,
            self.hand.len() - self.num_suggested(),
            self.num_suggested()
        );
        for model in &self.models {
            let _ = writeln!(text, "\n{}", model.name);
            for (what, paired) in [
                ("same start", self.paired(model, |pair| pair.outcome)),
                ("same commands", self.paired(model, |pair| pair.replayed_outcome)),
            ] {
                let [low, high] = paired.score.interval_95;
                let _ = writeln!(
                    text,
                    "{what:<14} won {} of {} ({low:.2} to {high:.2}); same verdict {}; only hand {}, only simulation {}, p {:.2}",
                    paired.score.successes,
                    paired.score.trials,
                    paired.same_verdict,
                    paired.only_hand,
                    paired.only_simulation,
                    paired.p_value
                );
            }
            self.touch(model, |pair| &pair.touch).text("same start", &mut text);
            self.touch(model, |pair| &pair.replayed_touch).text("same commands", &mut text);
            let difference = mean_by_joint(&model.pairs).into_iter().fold(0.0, f64::max);
            let _ = writeln!(
                text,
                "joints under the same commands: {difference:.3} rad apart at most, in the mean over time"
            );
        }
        text
    }
}

/// Mean over trials of the joints' differences, by joint.
fn mean_by_joint(pairs: &[Pair]) -> Vec<f64> {
    let num_joints = pairs.first().map_or(0, |pair| pair.joint_difference.len());
    let mean = |joint: usize| {
        pairs.iter().map(|pair| pair.joint_difference[joint]).sum::<f64>() / pairs.len() as f64
    };
    (0..num_joints).map(mean).collect()
}
