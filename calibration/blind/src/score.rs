//! Scores of the blind bench.

use std::collections::BTreeMap;

use palpate_reports::Verdict;
use palpate_truth::Expected;
use serde::{Deserialize, Serialize};

use crate::answers::{Answer, Asked};

/// The result of the bench: `palpate blind --json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BlindReport {
    /// With raw readings.
    #[serde(flatten)]
    pub scores: Scores,
    /// The same sessions without raw readings.
    pub binary_only: Option<Scores>,
}

/// Scores of a set of sessions.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Scores {
    /// Sessions that hide one effect of the library.
    pub cases: usize,
    /// Of those, sessions whose effect was named, and first.
    pub named_correctly: usize,
    /// Of those, sessions in which a reported class holds the effect.
    pub class_correct: usize,
    /// Of those, sessions whose effect was identified and then withheld by a rule.
    pub withheld: usize,
    /// Of those, sessions with a name of another effect.
    pub misnamed: usize,
    /// Names in sessions that hide nothing.
    pub false_alarms: usize,
    /// Sessions that hide nothing and were given a name.
    pub null_named: usize,
    /// Verdicts of sessions that hide nothing.
    pub null_verdicts: BTreeMap<Verdict, usize>,
    /// Sessions that hide nothing.
    pub null_cases: usize,
    /// Sessions that hide something outside the library and were left without a name, as unexplained.
    pub unknown_flagged: usize,
    /// Sessions that hide something outside the library.
    pub unknown_cases: usize,
    /// Sessions that hide two effects.
    pub pairs: Pairs,
    /// Sessions whose effect was left out of the library.
    pub left_out: LeftOut,
    /// Median share of the removable gap that was removed on confirm takes, over sessions that were named correctly.
    pub median_gap_removed: Option<f64>,
    /// How often each rule withheld an effect that is hidden.
    pub withheld_by: BTreeMap<String, usize>,
    /// The first three, by strength.
    pub by_strength: BTreeMap<String, StrengthScores>,
    /// How often each effect (`nothing` for none) was answered with which first name.
    pub confusion: BTreeMap<String, BTreeMap<String, usize>>,
    /// What each rule does by itself, in the order in which they are asked; only of a bench that asked for it.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub ablation: Vec<AblationRow>,
}

/// What is named with one rule changed, beside what is named with the rules as they are.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct AblationRow {
    /// Its id.
    pub rule: String,
    /// Factor of its limit; `None` where it is switched off.
    pub scale: Option<f64>,
    /// Sessions in which other effects are named, or in another order.
    pub changed: usize,
    /// Of [`Scores::cases`], those with the right first name.
    pub named_correctly: usize,
    /// Of [`Scores::cases`], those with the right first name that have it only with this change.
    pub gained: usize,
    /// Of [`Scores::cases`], those with the right first name that lose it with this change.
    pub lost: usize,
    /// Of [`Scores::cases`], those with a name of another effect.
    pub misnamed: usize,
    /// Of sessions that hide nothing, those with a name.
    pub null_named: usize,
    /// Of sessions that hide something outside the library, or left out of it, those with a name.
    pub unknown_named: usize,
}

impl AblationRow {
    /// Adds what `answer` would name with this change.
    fn add(&mut self, answer: &Answer, named: &[String]) {
        let is = answer.named.iter().map(|name| &name.id);
        self.changed += usize::from(!is.eq(named));
        let is_named = usize::from(!named.is_empty());
        match (answer.asked, answer.secret.expected, answer.secret.hidden.as_slice()) {
            (Asked::LeftOut, ..) | (_, Expected::Unexplained, _) => self.unknown_named += is_named,
            (_, Expected::Nothing, _) => self.null_named += is_named,
            (_, Expected::Named, [one]) => {
                let was_right = answer.named.first().is_some_and(|name| name.id == *one);
                let is_right = named.first() == Some(one);
                self.named_correctly += usize::from(is_right);
                self.gained += usize::from(is_right && !was_right);
                self.lost += usize::from(was_right && !is_right);
                self.misnamed += usize::from(named.iter().any(|name| name != one));
            }
            (_, Expected::Named, _) => {}
        }
    }
}

/// The rows of all changes that were asked about.
fn ablation<'a>(answers: impl Iterator<Item = &'a Answer>) -> Vec<AblationRow> {
    let mut rows: Vec<AblationRow> = Vec::new();
    for answer in answers {
        for otherwise in &answer.ablation {
            let is_of = |row: &AblationRow| row.rule == otherwise.rule && row.scale == otherwise.scale;
            let at = rows.iter().position(is_of).unwrap_or_else(|| {
                let (rule, scale) = (otherwise.rule.clone(), otherwise.scale);
                rows.push(AblationRow { rule, scale, ..AblationRow::default() });
                rows.len() - 1
            });
            rows[at].add(answer, &otherwise.named);
        }
    }
    rows
}

/// Sessions that hide two effects.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Pairs {
    /// Sessions.
    pub cases: usize,
    /// Both were named.
    pub both: usize,
    /// At least one was named.
    pub one: usize,
    /// A name that is neither.
    pub extra: usize,
}

/// Sessions whose effect was left out of the library.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LeftOut {
    /// Sessions.
    pub cases: usize,
    /// Left without a name, as unexplained.
    pub flagged: usize,
    /// Something else was named.
    pub misnamed: usize,
}

/// Sessions of one strength.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct StrengthScores {
    /// As [`Scores::cases`].
    pub cases: usize,
    /// As [`Scores::named_correctly`].
    pub named_correctly: usize,
    /// As [`Scores::class_correct`].
    pub class_correct: usize,
}

impl BlindReport {
    pub(crate) fn new(answers: &[Answer]) -> Self {
        let of = |events_only: bool| {
            answers.iter().filter(move |answer| (answer.asked == Asked::EventsOnly) == events_only)
        };
        let any_events_only = of(true).next().is_some();
        Self { scores: scores(of(false)), binary_only: any_events_only.then(|| scores(of(true))) }
    }
}

fn scores<'a>(answers: impl Iterator<Item = &'a Answer> + Clone) -> Scores {
    let mut scores = Scores::default();
    // What calibration leaves where nothing is hidden: no diagnosis can be expected to go below.
    let mut quiet_gaps: Vec<f64> = answers
        .clone()
        .filter(|a| a.secret.expected == Expected::Nothing)
        .map(|a| a.gap.calibrated)
        .collect();
    let floor = median(&mut quiet_gaps);
    scores.ablation = ablation(answers.clone());
    let mut removed = Vec::new();
    for answer in answers {
        let hidden: Vec<&str> = answer.secret.hidden.iter().map(String::as_str).collect();
        let names = |id: &str| answer.named.iter().any(|named| named.id == id);
        if answer.asked == Asked::LeftOut {
            scores.left_out.cases += 1;
            scores.left_out.misnamed += usize::from(!answer.named.is_empty());
            scores.left_out.flagged += usize::from(answer.verdict == Verdict::Unexplained);
            continue;
        }
        let first = answer.named.first().map_or_else(|| verdict_name(answer.verdict), |name| name.id.clone());
        let truth = if hidden.is_empty() { "nothing".to_owned() } else { hidden.join(" + ") };
        *scores.confusion.entry(truth).or_default().entry(first.clone()).or_default() += 1;
        match (answer.secret.expected, hidden.as_slice()) {
            (Expected::Nothing, _) => {
                scores.null_cases += 1;
                scores.false_alarms += answer.named.len();
                scores.null_named += usize::from(!answer.named.is_empty());
                *scores.null_verdicts.entry(answer.verdict).or_default() += 1;
            }
            (Expected::Unexplained, _) => {
                scores.unknown_cases += 1;
                scores.unknown_flagged += usize::from(answer.verdict == Verdict::Unexplained);
            }
            (Expected::Named, [one]) => {
                let named = first == *one;
                let in_class = answer.has_in_class(one);
                let in_doubt = answer.withheld.iter().find(|effect| effect.id == *one);
                let by_rule = in_doubt.and_then(|effect| effect.doubt.first());
                if let Some(by_rule) = by_rule.filter(|_| !named) {
                    scores.withheld += 1;
                    *scores.withheld_by.entry(by_rule.check.clone()).or_default() += 1;
                }
                scores.misnamed += usize::from(answer.named.iter().any(|named| named.id != *one));
                let strength = answer.secret.strength.clone().unwrap_or_default();
                let by_strength = scores.by_strength.entry(strength).or_default();
                for (cases, correct, class) in [
                    (&mut scores.cases, &mut scores.named_correctly, &mut scores.class_correct),
                    (
                        &mut by_strength.cases,
                        &mut by_strength.named_correctly,
                        &mut by_strength.class_correct,
                    ),
                ] {
                    *cases += 1;
                    *correct += usize::from(named);
                    *class += usize::from(in_class);
                }
                if let (true, Some(floor)) = (named, floor)
                    && answer.gap.calibrated > 1.1 * floor
                {
                    let of_names = answer.gap.calibrated - answer.gap.diagnosed;
                    removed.push(of_names / (answer.gap.calibrated - floor));
                }
            }
            (Expected::Named, several) => {
                let found = several.iter().filter(|id| names(id)).count();
                scores.pairs.cases += 1;
                scores.pairs.both += usize::from(found == several.len());
                scores.pairs.one += usize::from(found > 0);
                scores.pairs.extra +=
                    usize::from(answer.named.iter().any(|named| !several.contains(&named.id.as_str())));
            }
        }
    }
    scores.median_gap_removed = median(&mut removed);
    scores
}

pub(crate) fn verdict_name(verdict: Verdict) -> String {
    match verdict {
        Verdict::Unexplained | Verdict::PartlyExplained => "unexplained",
        Verdict::NoDiscrepancy | Verdict::Explained => "no_discrepancy",
        Verdict::CannotBeJudged => "cannot_be_judged",
    }
    .to_owned()
}

fn median(values: &mut [f64]) -> Option<f64> {
    values.sort_unstable_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use palpate_reports::{Doubt, EffectInDoubt, Gap, NamedEffect};
    use palpate_robot_model::Place;

    use super::*;
    use crate::answers::{Otherwise, Secret};

    fn name(id: &str) -> NamedEffect {
        NamedEffect {
            id: id.to_owned(),
            place: Place::Stream("all".to_owned()),
            parameters: BTreeMap::new(),
            interval: BTreeMap::new(),
            gap_before: 0.02,
            gap_after: 0.01,
            p_value: None,
            evidence: 50.0,
            takes_improved: "8/9".to_owned(),
            class: vec![id.to_owned()],
            rivals: Vec::new(),
            explanation: String::new(),
        }
    }

    fn answer(hidden: &[&str], expected: Expected, strength: Option<&str>, named: &[&str]) -> Answer {
        Answer {
            secret: Secret {
                world: String::new(),
                label: String::new(),
                seed: 1,
                hidden: hidden.iter().map(|id| (*id).to_owned()).collect(),
                details: Vec::new(),
                strength: strength.map(str::to_owned),
                expected,
            },
            asked: Asked::AsRecorded,
            verdict: if named.is_empty() { Verdict::Unexplained } else { Verdict::Explained },
            named: named.iter().map(|id| name(id)).collect(),
            gap: Gap { calibrated: 0.02, diagnosed: 0.01, ..Gap::default() },
            withheld: Vec::new(),
            candidates: Vec::new(),
            unexplained: palpate_reports::Unexplained::default(),
            notes: Vec::new(),
            ablation: Vec::new(),
        }
    }

    #[test]
    fn a_right_name_counts_only_if_it_comes_first() {
        let single = |named: &[&str]| answer(&["latency"], Expected::Named, Some("weak"), named);
        let report = BlindReport::new(&[
            single(&["latency"]),
            single(&["low_pass", "latency"]),
            single(&["low_pass"]),
        ]);
        let scores = report.scores;
        assert_eq!((scores.cases, scores.named_correctly, scores.class_correct), (3, 1, 2));
        assert_eq!(scores.by_strength["weak"].named_correctly, 1);
        assert_eq!(scores.confusion["latency"]["low_pass"], 2);
        assert!(report.binary_only.is_none());
    }

    #[test]
    fn a_right_name_that_was_withheld_counts_for_its_rule() {
        let mut withheld = answer(&["latency"], Expected::Named, Some("strong"), &[]);
        withheld.withheld.push(EffectInDoubt {
            id: "latency".to_owned(),
            place: Place::Stream("all".to_owned()),
            parameters: BTreeMap::new(),
            doubt: vec![Doubt { check: "posture".to_owned(), measured: 2.0, limit: 1.0 }],
        });
        let mut beside = answer(&["latency"], Expected::Named, Some("strong"), &["low_pass"]);
        beside.withheld = withheld.withheld.clone();
        beside.withheld[0].id = "preload".to_owned();
        let scores = BlindReport::new(&[withheld, beside]).scores;
        assert_eq!((scores.withheld, scores.misnamed), (1, 1));
        assert_eq!(scores.withheld_by, BTreeMap::from([("posture".to_owned(), 1)]));
    }

    #[test]
    fn what_a_rule_is_good_for_is_told_by_pairs_of_the_same_session() {
        let otherwise = |mut answer: Answer, named: &[&str]| {
            let named = named.iter().map(|id| (*id).to_owned()).collect();
            answer.ablation = vec![Otherwise { rule: "alike".to_owned(), scale: None, named }];
            answer
        };
        let single = |named: &[&str]| answer(&["latency"], Expected::Named, Some("strong"), named);
        let left_out = Answer { asked: Asked::LeftOut, ..single(&[]) };
        let rows = BlindReport::new(&[
            otherwise(single(&[]), &["latency"]),
            otherwise(single(&["latency"]), &["low_pass", "latency"]),
            otherwise(single(&["latency"]), &["latency"]),
            otherwise(answer(&[], Expected::Nothing, None, &[]), &["preload"]),
            otherwise(left_out, &["low_pass"]),
        ])
        .scores
        .ablation;
        let row = AblationRow {
            rule: "alike".to_owned(),
            scale: None,
            changed: 4,
            named_correctly: 2,
            gained: 1,
            lost: 1,
            misnamed: 1,
            null_named: 1,
            unknown_named: 1,
        };
        assert_eq!(rows, [row]);
    }

    #[test]
    fn names_where_nothing_is_hidden_are_false_alarms_and_a_name_for_the_unknown_is_no_flag() {
        let scores = BlindReport::new(&[
            answer(&[], Expected::Nothing, None, &["latency", "low_pass"]),
            answer(&[], Expected::Nothing, None, &[]),
            answer(&["mains_hum"], Expected::Unexplained, Some("weak"), &[]),
            answer(&["mains_hum"], Expected::Unexplained, Some("strong"), &["baseline_drift"]),
        ])
        .scores;
        assert_eq!((scores.false_alarms, scores.null_cases, scores.null_named), (2, 2, 1));
        let verdicts = BTreeMap::from([(Verdict::Explained, 1), (Verdict::Unexplained, 1)]);
        assert_eq!(scores.null_verdicts, verdicts);
        assert_eq!((scores.unknown_flagged, scores.unknown_cases), (1, 2));
    }

    #[test]
    fn pairs_count_both_one_and_extra_names() {
        let pair = |named: &[&str]| answer(&["latency", "preload"], Expected::Named, None, named);
        let scores = BlindReport::new(&[
            pair(&["preload", "latency"]),
            pair(&["latency", "low_pass"]),
            pair(&["low_pass"]),
        ])
        .scores;
        assert_eq!(scores.pairs, Pairs { cases: 3, both: 1, one: 2, extra: 2 });
    }
}
