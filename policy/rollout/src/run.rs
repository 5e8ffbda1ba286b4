//! From the command's arguments to outcomes.

use std::io::IsTerminal as _;
use std::path::Path;

use anyhow::{Context as _, bail};
use palpate_terminal::cancel_on_ctrl_c;
use serde_json::{Value, json};

use crate::args::RolloutArgs;
use crate::attempt::{Making, Placing, begin, make};
use crate::campaign;
use crate::fit::{self, Fitted, Region};
use crate::hand::{Hand, hold, ready};
use crate::link::{Link, switch_reflex_on};
use crate::operator::Operator;
use crate::outcome::{Outcome, Outcomes};
use crate::studio::Studio;
use crate::take::Recording;

/// What `palpate tokens create` printed, where people have to log in.
const TOKEN: &str = "PALPATE_TOKEN";

/// Runs the trials.
///
/// # Errors
/// Whatever keeps a trial from beginning, a record from being written; trials that end badly are outcomes.
pub fn run(args: &RolloutArgs) -> anyhow::Result<()> {
    if args.trials == 0 {
        bail!("--trials is 0, expected at least 1");
    }
    let asks = args.operator.is_none() && !args.placed && !args.placed_at_page;
    if asks && !std::io::stdin().is_terminal() {
        let placed = match args.campaign {
            Some(_) => "--placed-at-page if it is placed by somebody at the studio's page",
            None => "--placed if it lies there already",
        };
        bail!("nobody is there to place the object: give --operator, or {placed}");
    }
    let studio = Studio::new(&args.url, std::env::var(TOKEN).ok(), args.ca_file.as_deref())?;
    let is_planned = args.campaign.is_some() && !args.placed;
    let recording = Recording::new(&args.record, &studio, args.operator.as_ref(), is_planned, &args.name)?;
    if let Some(id) = &args.campaign {
        let options = campaign::Options {
            id,
            recording: recording.as_ref(),
            repeats_void: args.repeat_void,
            is_placed_at_page: args.placed_at_page,
            policies: &args.policy,
        };
        return campaign::run(args, &studio, &options);
    }
    let policy = match &args.policy[..] {
        [] => None,
        [policy] => Some(Path::new(policy)),
        _ => {
            bail!("--policy is there {} times; one is tried at a time outside a campaign", args.policy.len())
        }
    };
    let region = Region::told(args.fit.region_cm, args.start_cm, args.operator.is_some())?;
    let mut fitted = fit::fit(&studio, policy, &args.fit, region)?;
    let reflex = args.reflex.as_deref().map(|path| fit::reflex(path, &mut fitted)).transpose()?;
    let is_free = std::fs::read_dir(&args.out).map_or(true, |mut entries| entries.next().is_none());
    if !is_free {
        bail!("--out is {:?}, which is not empty; records of trials are never written over", args.out);
    }
    std::fs::create_dir_all(&args.out)
        .with_context(|| format!("failed to make the folder {:?}", args.out))?;
    let mut operator = args.operator.as_deref().map(Operator::connect).transpose()?;
    for warning in &fitted.warnings {
        eprintln!("rollout: {warning}");
    }
    let cancel = cancel_on_ctrl_c();
    let link = Link::connect(&studio, &args.name, args.take_over)?;
    let hand = Hand { link: &link, cancel: &cancel };
    let done = switch_reflex_on(&link, reflex.as_deref())
        .and_then(|()| trials(args, &mut fitted, &hand, operator.as_mut(), recording.as_ref()));
    hold(&link, &fitted.station);
    link.release();
    done
}

fn trials(
    args: &RolloutArgs,
    fitted: &mut Fitted,
    hand: &Hand<'_>,
    mut operator: Option<&mut Operator>,
    recording: Option<&Recording>,
) -> anyhow::Result<()> {
    ready(hand)?;
    let mut outcomes = Outcomes::open(&args.out, args.json)?;
    for trial in args.first..args.first + args.trials {
        let outcome = one(args, fitted, hand, operator.as_deref_mut(), recording, trial);
        let (outcome, is_cancelled) = match outcome {
            Err(_) if hand.cancel.is_cancelled() => break,
            other => other?,
        };
        outcomes.add(&outcome)?;
        if !args.json {
            println!("trial {trial}: {:?}: {}", outcome.suggested, outcome.reasons.join("; "));
        }
        if is_cancelled || hand.link.ended().is_some() {
            break;
        }
    }
    Ok(())
}

/// One trial, from wherever the robot is; whether somebody wants no further one.
fn one(
    args: &RolloutArgs,
    fitted: &mut Fitted,
    hand: &Hand<'_>,
    mut operator: Option<&mut Operator>,
    recording: Option<&Recording>,
    trial: u64,
) -> anyhow::Result<(Outcome, bool)> {
    let mut start = Value::Null;
    let placing = match operator.as_deref_mut() {
        Some(operator) => {
            let mut request =
                json!({ "act": "start", "object": args.fit.object, "seed": args.seed, "trial": trial });
            if let Some(start_cm) = args.start_cm {
                request["start_cm"] = json!(start_cm);
            }
            start = json!({ "seed": args.seed, "trial": trial, "start_cm": args.start_cm });
            Placing::Operator(operator, request)
        }
        None if args.placed => Placing::Nobody,
        None => Placing::Person(format!("trial {trial}: place the object {:?}", fitted.object)),
    };
    let begins = begin(hand, fitted, placing)?;
    let path = args.out.join(format!("trial-{trial:04}.jsonl"));
    let making = Making {
        campaign: None,
        trial,
        attempt: None,
        path: &path,
        start,
        is_silenced: args.silence_touch,
        inject: args.inject,
        recording,
        planned: None,
    };
    make(hand, fitted, making, &begins, operator)
}
