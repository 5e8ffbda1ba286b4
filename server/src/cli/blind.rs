//! `palpate blind`.

use std::{
    path::{Path, PathBuf},
    process::ExitCode,
};

use clap::{Args, ValueEnum};
use palpate_blind::{BlindConfig, BlindReport, Scores, World, actuator, tactile};
use palpate_terminal::{Bar, cancel_on_ctrl_c};

use super::{Outcome, output};

#[derive(Args)]
pub(crate) struct BlindArgs {
    /// What to hide effects in
    #[arg(long, value_enum, default_value = "tactile")]
    domain: Domain,
    /// Rounds of the catalogue, each with places and noise of its own
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..))]
    seeds: u64,
    /// Seed of the first round
    #[arg(long, value_name = "SEED", default_value_t = 1)]
    first_seed: u64,
    /// Sessions with nothing hidden in each round
    #[arg(long, value_name = "N", default_value_t = 20)]
    nulls: usize,
    /// Judge touch by N reference sessions, recorded beside the others with nothing hidden: three or more
    #[arg(long, value_name = "N", default_value_t = 0)]
    references: usize,
    /// Whose physics touch has: a, the emulated station's; b, another skin, other boards, a person's pace, imported
    /// from CSV; c, d, e, of b its skin alone, its boards alone, its geometry and pace alone
    #[arg(long, value_enum, default_value = "a")]
    world: Physics,
    /// Station and motions of the touch sessions, and what world a is like [default: assets/truth/blind_report.toml, of
    /// the others assets/truth/blind_b.toml]
    #[arg(long, value_name = "TRUTH.toml")]
    truth: Option<PathBuf>,
    /// Leave out the second diagnosis of each session without its raw readings
    #[arg(long)]
    raw_only: bool,
    /// Leave out the diagnoses with an effect taken out of the library
    #[arg(long)]
    whole_library: bool,
    /// Switch a rule that withholds names off, by its id in docs/diagnosis.md; may be given several times
    #[arg(long, value_name = "ID")]
    without_rule: Vec<String>,
    /// Multiply the limit of a rule, to see whether anything hangs on where it lies; may be given several times
    #[arg(long, value_name = "ID=FACTOR", value_parser = scaled_rule)]
    scale_rule: Vec<(String, f64)>,
    /// Say as well what would be named with each rule by itself switched off, and with its limit times 0.7 and 1.4
    #[arg(long)]
    ablation: bool,
    /// Run only cases whose label contains this; may be given several times
    #[arg(long, value_name = "TEXT")]
    only: Vec<String>,
    /// Keep every answer in this file, one a line, and do not ask again for those that it has: to look into wrong names, and
    /// to go on where a bench was stopped
    #[arg(long, value_name = "ANSWERS.jsonl")]
    answers: Option<PathBuf>,
    /// Print the report as JSON
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, ValueEnum)]
enum Domain {
    Tactile,
    Actuator,
}

#[derive(Clone, Copy, ValueEnum)]
enum Physics {
    A,
    B,
    C,
    D,
    E,
}

pub(super) fn run(args: &BlindArgs) -> Outcome {
    let config = BlindConfig {
        world: match args.world {
            Physics::A => World::A,
            Physics::B => World::B,
            Physics::C => World::C,
            Physics::D => World::D,
            Physics::E => World::E,
        },
        seeds: args.seeds,
        first_seed: args.first_seed,
        nulls: args.nulls,
        references: args.references,
        binary_only: !args.raw_only,
        leave_out: !args.whole_library,
        rule_scales: args
            .scale_rule
            .iter()
            .cloned()
            .chain(args.without_rule.iter().map(|id| (id.clone(), f64::INFINITY)))
            .collect(),
        ablation: args.ablation,
        only: args.only.clone(),
        answers: args.answers.clone(),
    };
    let default = match args.world {
        Physics::A => "assets/truth/blind_report.toml",
        _ => "assets/truth/blind_b.toml",
    };
    let truth = args.truth.as_deref().unwrap_or_else(|| Path::new(default));
    let report = {
        let bar = Bar::new();
        let cancel = cancel_on_ctrl_c();
        match args.domain {
            Domain::Tactile => tactile(truth, &config, &bar, &cancel),
            Domain::Actuator => actuator(&config, &bar, &cancel),
        }?
    };
    if args.json {
        output::json(&report)?;
    } else {
        output::line(&text(&report))?;
    }
    Ok(ExitCode::SUCCESS)
}

/// `ID=FACTOR`, a factor above 0.
fn scaled_rule(text: &str) -> Result<(String, f64), String> {
    let (id, factor) = text.split_once('=').ok_or("expected ID=FACTOR, as in size_by_take=1.4")?;
    let factor: f64 = factor.parse().map_err(|_| format!("{factor:?} is no number"))?;
    if factor > 0.0 { Ok((id.to_owned(), factor)) } else { Err("the factor must be above 0".to_owned()) }
}

fn text(report: &BlindReport) -> String {
    let mut lines = vec!["with raw readings".to_owned()];
    lines.extend(scores(&report.scores));
    if let Some(binary) = &report.binary_only {
        lines.push("\nevents only".to_owned());
        lines.extend(scores(binary));
    }
    lines.push("\nhidden -> first name".to_owned());
    for (hidden, answers) in &report.scores.confusion {
        let answers: Vec<String> = answers.iter().map(|(name, count)| format!("{name} {count}")).collect();
        lines.push(format!("  {hidden}: {}", answers.join(", ")));
    }
    lines.join("\n")
}

fn by_rule(scores: &Scores) -> String {
    let of_rules: Vec<String> =
        scores.withheld_by.iter().map(|(rule, count)| format!("{rule} {count}")).collect();
    if of_rules.is_empty() { String::new() } else { format!(" ({})", of_rules.join(", ")) }
}

fn verdicts(scores: &Scores) -> String {
    let counts: Vec<String> =
        scores.null_verdicts.iter().map(|(verdict, count)| format!("{verdict:?} {count}")).collect();
    counts.join(", ")
}

fn scores(scores: &Scores) -> Vec<String> {
    let mut lines = vec![
        format!(
            "  one effect hidden: {} of {} named, {} in the reported class",
            scores.named_correctly, scores.cases, scores.class_correct
        ),
        format!(
            "  of the others, {} identified and withheld{}; {} sessions with another name",
            scores.withheld,
            by_rule(scores),
            scores.misnamed
        ),
        format!(
            "  nothing hidden: {} names in {} of {} sessions; verdicts {}",
            scores.false_alarms,
            scores.null_named,
            scores.null_cases,
            verdicts(scores)
        ),
        format!(
            "  hidden outside the library: {} of {} unexplained",
            scores.unknown_flagged, scores.unknown_cases
        ),
        format!(
            "  two hidden: both named in {} of {}, one in {}, another name in {}",
            scores.pairs.both, scores.pairs.cases, scores.pairs.one, scores.pairs.extra
        ),
        format!(
            "  left out of the library: {} of {} unexplained, {} misnamed",
            scores.left_out.flagged, scores.left_out.cases, scores.left_out.misnamed
        ),
    ];
    for (strength, of_strength) in &scores.by_strength {
        lines.push(format!(
            "  {strength}: {} of {} named, {} in the class",
            of_strength.named_correctly, of_strength.cases, of_strength.class_correct
        ));
    }
    if let Some(removed) = scores.median_gap_removed {
        lines.push(format!("  median share of the removable gap that was removed: {:.0} %", 100.0 * removed));
    }
    if !scores.ablation.is_empty() {
        let columns =
            "right first names (gained, lost), another name, a name where nothing is hidden, of no library";
        lines.push(format!("  rule, its limit: {columns}; sessions changed"));
    }
    lines.extend(scores.ablation.iter().map(|row| {
        let limit = row.scale.map_or_else(|| "off".to_owned(), |scale| format!("x {scale}"));
        format!(
            "    {:<16} {limit:<6} {} (+{} -{}), {}, {}, {}; {}",
            row.rule,
            row.named_correctly,
            row.gained,
            row.lost,
            row.misnamed,
            row.null_named,
            row.unknown_named,
            row.changed
        )
    }));
    lines
}
