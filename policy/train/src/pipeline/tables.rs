//! The paper's tables of policies: what one part of a policy is worth, by two policies that differ in it.

use std::collections::BTreeMap;

use anyhow::Context as _;
use maud::{Markup, html};
use palpate_cloning::PaperPolicy;
use palpate_grasp::trial::Ending;
use palpate_robot_model::ObjectGroup;
use palpate_statistics::{Interval, mcnemar_exact, student};
use serde::Serialize;
use serde_json::Value;

/// Confidence of all intervals.
const CONFIDENCE: f64 = 0.95;

/// A policy of the paper, and how touch is told to it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Kind {
    pub(super) policy: PaperPolicy,
    /// Whether it sees how strongly channels are touched, and not only whether they are.
    pub(super) sees_strengths: bool,
}

/// A part of policies.
struct Part {
    name: &'static str,
    /// The policies that have it and that lack it.
    kinds: [Kind; 2],
    /// What the paper reports of both in its own simulator under its own protocol, percent: seen, unseen and all objects,
    /// where it does.
    paper_percent: [[Option<f64>; 2]; 3],
}

const fn events(policy: PaperPolicy) -> Kind {
    Kind { policy, sees_strengths: false }
}

/// The parts that the paper's appendix looks at.
const PARTS: [Part; 5] = [
    Part {
        name: "encoder, pretrained",
        kinds: [events(PaperPolicy::PretrainedDp), events(PaperPolicy::KinematicDp)],
        paper_percent: [[Some(60.4), Some(36.2)], [Some(43.2), Some(20.0)], [Some(51.8), Some(28.1)]],
    },
    Part {
        name: "places of taxels (FK grounding)",
        kinds: [events(PaperPolicy::KinematicDp), events(PaperPolicy::RawDp)],
        paper_percent: [[Some(36.2), Some(33.8)], [Some(20.0), Some(19.8)], [Some(28.1), Some(26.8)]],
    },
    Part {
        name: "diffusion, not BC",
        kinds: [events(PaperPolicy::PretrainedDp), events(PaperPolicy::PretrainedBc)],
        paper_percent: [[Some(60.4), Some(59.4)], [Some(43.2), Some(30.2)], [Some(51.8), Some(45.8)]],
    },
    Part {
        name: "diffusion, not ACT",
        kinds: [events(PaperPolicy::PretrainedDp), events(PaperPolicy::PretrainedAct)],
        paper_percent: [[Some(60.4), Some(45.0)], [Some(43.2), Some(24.8)], [Some(51.8), Some(34.9)]],
    },
    // The paper's two have an encoder each, pretrained on what they see, and tried on seen objects alone.
    Part {
        name: "events, not strengths of touch",
        kinds: [
            events(PaperPolicy::KinematicDp),
            Kind { policy: PaperPolicy::KinematicDp, sees_strengths: true },
        ],
        paper_percent: [[Some(60.4), Some(59.2)], [None, None], [None, None]],
    },
];

/// Groups of objects, as comparisons name them.
pub(super) const GROUPS: [&str; 3] = ["seen", "unseen", "overall"];

/// The trials of one training in an evaluation.
pub(super) struct Trials {
    kind: Kind,
    seed: u64,
    /// By the object's id, in the order of the starts.
    by_object: BTreeMap<String, Vec<Ending>>,
}

impl Trials {
    /// Those of the arm that `document` is of, which was learned as `kind` says with `seed`.
    ///
    /// # Errors
    /// A document that does not hold single trials.
    pub(super) fn of_arm(kind: Kind, seed: u64, document: &Value) -> anyhow::Result<Self> {
        let by_object = serde_json::from_value(document["trials"].clone())
            .context("a comparison does not hold the single trials of a policy")?;
        Ok(Self { kind, seed, by_object })
    }
}

/// What one part is worth on one group of objects.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Line {
    part: &'static str,
    group: &'static str,
    /// Won by the policies that have the part and that lack it, percent.
    percent: [f64; 2],
    /// The difference of both, points of a hundred.
    points: f64,
    /// Student's interval of the difference at 95 %, over objects and seeds; nothing from one of them alone.
    interval_95: Option<[f64; 2]>,
    /// Pairs of an object and a seed.
    units: usize,
    /// Starts that only the policy with the part won, and only the one without it, over all seeds.
    only: [u64; 2],
    /// Of McNemar's exact test on these, two-sided.
    p_value: f64,
    /// What the paper reports of both policies in its own simulator under its own protocol, percent, where it does.
    paper_percent: [Option<f64>; 2],
}

/// Every part that two of `trials` differ in, by group of `objects` (id and group). A seed counts where both were
/// learned with it.
pub(super) fn lines(
    trials: &[Trials],
    objects: &[(String, Option<ObjectGroup>)],
) -> anyhow::Result<Vec<Line>> {
    let mut lines = Vec::new();
    for part in &PARTS {
        let of = |kind: Kind| trials.iter().filter(move |one| one.kind == kind);
        let pairs: Vec<[&Trials; 2]> = of(part.kinds[0])
            .filter_map(|with| Some([with, of(part.kinds[1]).find(|without| without.seed == with.seed)?]))
            .collect();
        for (idx, group) in GROUPS.into_iter().enumerate() {
            let is_in = |of_object: Option<ObjectGroup>| match group {
                "seen" => of_object == Some(ObjectGroup::Seen),
                "unseen" => of_object == Some(ObjectGroup::Unseen),
                _ => true,
            };
            let mut counted = Counted::default();
            for (id, _) in objects.iter().filter(|(_, of_object)| is_in(*of_object)) {
                for pair in &pairs {
                    if let [Some(with), Some(without)] = pair.map(|trials| trials.by_object.get(id)) {
                        counted.add(with, without);
                    }
                }
            }
            lines.extend(counted.line(part.name, group, part.paper_percent[idx])?);
        }
    }
    Ok(lines)
}

/// Pairs of trials on the same starts.
#[derive(Default)]
struct Counted {
    won: [u64; 2],
    trials: u64,
    only: [u64; 2],
    /// Differences of objects and seeds, points of a hundred.
    points: Vec<f64>,
}

impl Counted {
    /// Adds the trials of one object and seed.
    fn add(&mut self, with: &[Ending], without: &[Ending]) {
        let (mut won, mut trials) = ([0, 0], 0_u64);
        for (with, without) in with.iter().zip(without) {
            let is_won = [with.is_won(), without.is_won()];
            trials += 1;
            for (side, other) in [(0, 1), (1, 0)] {
                won[side] += u64::from(is_won[side]);
                self.only[side] += u64::from(is_won[side] && !is_won[other]);
            }
        }
        if trials > 0 {
            self.points.push(100.0 * (won[0] as f64 - won[1] as f64) / trials as f64);
        }
        self.trials += trials;
        self.won = [self.won[0] + won[0], self.won[1] + won[1]];
    }

    /// Nothing without trials.
    fn line(
        &self,
        part: &'static str,
        group: &'static str,
        paper_percent: [Option<f64>; 2],
    ) -> anyhow::Result<Option<Line>> {
        let Some(mean) = student(&self.points, CONFIDENCE)? else { return Ok(None) };
        Ok(Some(Line {
            part,
            group,
            percent: self.won.map(|won| 100.0 * won as f64 / self.trials as f64),
            points: mean.mean,
            interval_95: mean.interval.map(|Interval { low, high }| [low, high]),
            units: self.points.len(),
            only: self.only,
            p_value: mcnemar_exact(self.only[0], self.only[1]),
            paper_percent,
        }))
    }
}

impl Line {
    /// What it allows to say.
    fn verdict(&self) -> &'static str {
        match self.interval_95 {
            None => "one object and seed says nothing",
            Some([low, _]) if low > 0.0 => "wins more with it",
            Some([_, high]) if high < 0.0 => "wins less with it",
            Some(_) => "too few trials to tell",
        }
    }
}

/// `lines` as a table; nothing without any.
pub(super) fn section(lines: &[Line]) -> Markup {
    let percents = |[with, without]: [f64; 2]| format!("{with:.1} and {without:.1}");
    html! {
        @if !lines.is_empty() {
            h3 { "What each part is worth" }
            p { "Two policies that differ in one part, on the same starts: won with it and without it, percent; the difference in points "
                "of a hundred, in brackets the 95 % interval (Student's, of the differences of single objects and seeds); starts that "
                "only one of them won, McNemar's exact p. Starts are the same for all seeds, so the interval says more than p. The last "
                "column is what the paper reports (its own simulator, objects and protocol; of strengths it compares policies with "
                "encoders)." }
            div.wide { table {
                thead { tr {
                    th { "part" } th { "objects" } th { "with, without" } th { "difference" } th { "objects × seeds" }
                    th { "only with, only without" } th { "so" } th { "paper" }
                } }
                tbody {
                    @for line in lines {
                        tr {
                            td { (line.part) }
                            td { (line.group) }
                            td { (percents(line.percent)) }
                            td {
                                (format!("{:+.1}", line.points))
                                @if let Some([low, high]) = line.interval_95 { (format!(" ({low:+.1} to {high:+.1})")) }
                            }
                            td.number { (line.units) }
                            td { (line.only[0]) " and " (line.only[1]) (format!(", p {:.2e}", line.p_value)) }
                            td { (line.verdict()) }
                            td {
                                @if let [Some(with), Some(without)] = line.paper_percent { (percents([with, without])) }
                            }
                        }
                    }
                }
            } }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use palpate_grasp::trial::Outcome;

    fn trials(policy: PaperPolicy, seed: u64, won: &[(&str, &[bool])]) -> Trials {
        let ending = |&is_won: &bool| Ending {
            outcome: if is_won { Outcome::Success } else { Outcome::Slip },
            time_s: 1.0,
            claimed: false,
        };
        let by_object = won.iter().map(|(id, won)| ((*id).to_owned(), won.iter().map(ending).collect()));
        Trials { kind: events(policy), seed, by_object: by_object.collect() }
    }

    fn objects() -> Vec<(String, Option<ObjectGroup>)> {
        [("cube", ObjectGroup::Seen), ("ring", ObjectGroup::Unseen)]
            .map(|(id, group)| (id.to_owned(), Some(group)))
            .to_vec()
    }

    #[test]
    fn a_part_is_what_two_policies_differ_in_by_object_and_seed() {
        let (with, without) = (PaperPolicy::KinematicDp, PaperPolicy::RawDp);
        let all = [
            trials(with, 0, &[("cube", &[true, true, true, false]), ("ring", &[true, false, false, false])]),
            trials(without, 0, &[("cube", &[true, false, false, true]), ("ring", &[false; 4])]),
            trials(with, 1, &[("cube", &[true; 4]), ("ring", &[false; 4])]),
            trials(without, 1, &[("cube", &[true, true, true, false]), ("ring", &[false; 4])]),
            // Nobody lacks what this one has under the same seed.
            trials(with, 2, &[("cube", &[false; 4]), ("ring", &[false; 4])]),
        ];
        let lines = lines(&all, &objects()).expect("lines");
        let found: Vec<_> =
            lines.iter().map(|line| (line.group, line.percent, line.points, line.units)).collect();
        assert_eq!(
            found,
            [
                ("seen", [87.5, 62.5], 25.0, 2),
                ("unseen", [12.5, 0.0], 12.5, 2),
                ("overall", [50.0, 31.25], 18.75, 4),
            ]
        );
        let overall = lines.last().expect("a line");
        assert_eq!((overall.only, overall.paper_percent), ([4, 1], [Some(28.1), Some(26.8)]));
        assert!((overall.p_value - 0.375).abs() < 1e-9, "{}", overall.p_value);
        // Both units of seen objects differ by as much.
        assert_eq!(lines[0].interval_95, Some([25.0, 25.0]));
        assert_eq!((lines[0].verdict(), overall.verdict()), ("wins more with it", "too few trials to tell"));
    }

    #[test]
    fn events_are_compared_with_strengths_of_the_same_policy() {
        let events =
            trials(PaperPolicy::KinematicDp, 0, &[("cube", &[true, true]), ("ring", &[false, true])]);
        let mut strengths =
            trials(PaperPolicy::KinematicDp, 0, &[("cube", &[true, false]), ("ring", &[true, true])]);
        strengths.kind.sees_strengths = true;
        let lines = lines(&[events, strengths], &objects()).expect("lines");
        let found: Vec<_> = lines.iter().map(|line| (line.part, line.points, line.paper_percent)).collect();
        let part = "events, not strengths of touch";
        assert_eq!(
            found,
            [(part, 50.0, [Some(60.4), Some(59.2)]), (part, -50.0, [None, None]), (part, 0.0, [None, None])]
        );
    }

    #[test]
    fn without_a_counterpart_nothing_is_said() {
        let alone = [trials(PaperPolicy::PretrainedDp, 0, &[("cube", &[true])])];
        assert_eq!(lines(&alone, &objects()).expect("lines"), []);
        assert_eq!(section(&[]).into_string(), "");
        let [alone] = alone;
        let two = [alone, trials(PaperPolicy::PretrainedBc, 0, &[("cube", &[false])])];
        let lines = lines(&two, &objects()).expect("lines");
        assert_eq!(lines[0].verdict(), "one object and seed says nothing");
        let page = section(&lines).into_string();
        assert!(page.contains("60.4 and 59.4") && page.contains("+100.0"), "{page}");
    }
}
