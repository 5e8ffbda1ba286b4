//! `palpate-train compare-rollout` as a job: the trials of a campaign beside the same starts in simulation.

use std::{
    collections::BTreeMap,
    fs,
    os::unix::fs::symlink,
    path::{Path, PathBuf},
};

use palpate_recording::files::read_text;
use palpate_sim::job::Progress;
use palpate_trials::paired;
use palpate_wire::api::{
    Attempt, Campaign, ComparedModel, ComparedPairing, ComparedTouch, ComparedTrial, ComparisonReport,
    ComparisonRequest, LeftOutTrial, NOMINAL_MODEL, SaidBy, Trial, TrialVerdict,
};
use serde::Deserialize;
use serde_json::Value;

use super::{
    JobKind, JobWork, LONG, parse,
    rollouts::{RECORDS_DIR, bring_objects, campaign, folder},
    training::{Arguments, Workplace, check_object, model_file},
};
use crate::{Class, Error, Store};

/// Compares trials on the hand with simulation.
pub(crate) const COMPARISON: JobKind = JobKind {
    name: "comparison",
    prefix: "comparison-",
    resources: LONG,
    needs_trainer: true,
    makes: None,
    sharding: None,
    check,
    work,
};

/// Longest record that is read, bytes: one of a minute has some megabytes.
const MAX_RECORD_BYTES: u64 = 256 << 20;

/// A trial with a record that can be compared.
struct Recorded<'a> {
    trial: &'a Trial,
    last: &'a Attempt,
    policy: &'a str,
    /// Its record.
    path: PathBuf,
}

fn check(store: &Store, request: &Value) -> Result<Vec<PathBuf>, Error> {
    let request: ComparisonRequest = parse(COMPARISON.name, request)?;
    let campaign = campaign(store, &request.campaign)?;
    if campaign.plan.is_blind && campaign.summary.closed.is_none() {
        return Err(Error::Conflict(format!(
            "campaign {:?} is blind, and a comparison says which policy moved the hand; close the campaign first",
            request.campaign
        )));
    }
    let (recorded, left_out) = recorded(store, &campaign)?;
    if recorded.is_empty() {
        let why = left_out.first().map_or("no trial has ended yet", |trial| &trial.why);
        return Err(Error::Conflict(format!(
            "campaign {:?} has no trial that can be compared: {why}",
            request.campaign
        )));
    }
    let mut files: Vec<PathBuf> = recorded.into_iter().map(|recorded| recorded.path).collect();
    for id in &request.models {
        files.extend(model_file(store, Some(id))?);
    }
    for object in &campaign.plan.objects {
        files.extend(check_object(store, &object.id)?);
    }
    Ok(files)
}

fn work(cx: &JobWork<'_>, request: &Value) -> Result<(), Error> {
    let request: ComparisonRequest = parse(COMPARISON.name, request)?;
    let campaign = campaign(cx.store, &request.campaign)?;
    let (recorded, left_out) = recorded(cx.store, &campaign)?;
    let models = models(cx.store, &request.models)?;
    let workplace = Workplace::make(cx.folder)?;
    bring_objects(cx.store, &campaign, &workplace)?;
    let mut report = ComparisonReport {
        campaign: request.campaign,
        models: models.iter().map(|(model, _)| model.clone()).collect(),
        left_out,
        ..ComparisonReport::default()
    };
    let mut groups: BTreeMap<(&str, &str), Vec<Recorded<'_>>> = BTreeMap::new();
    for trial in recorded {
        groups.entry((trial.policy, trial.trial.object.as_str())).or_default().push(trial);
    }
    let num_groups = groups.len();
    let mut problem = None;
    for (idx, ((policy, object), trials)) in groups.into_iter().enumerate() {
        let progress = PartOf {
            all: cx.progress,
            begins: idx as f64 / num_groups as f64,
            share: 1.0 / num_groups as f64,
            name: format!("{policy} on {object}"),
        };
        let cx = JobWork { progress: &progress, ..*cx };
        match compare(&cx, &workplace, idx, &trials, &models) {
            Ok(found) => add(&mut report, found, &trials)?,
            Err(err) if err.class() == Class::Cancelled => return Err(err),
            // Another policy or object may do all the same.
            Err(err) => {
                let why = cx.store.for_client(Error::Content(crate::chain(&err))).to_string();
                let numbers = trials.iter().map(|recorded| recorded.trial.number);
                report.left_out.extend(numbers.map(|trial| LeftOutTrial { trial, why: why.clone() }));
                problem.get_or_insert(err);
            }
        }
    }
    if let (true, Some(problem)) = (report.trials.is_empty(), problem) {
        return Err(problem);
    }
    if num_groups > 1 {
        add_all(&mut report)?;
    }
    report.trials.sort_by_key(|trial| trial.trial);
    report.left_out.sort_by_key(|trial| trial.trial);
    cx.save_report(&report)
}

/// How far one of several parts is.
struct PartOf<'a> {
    all: &'a dyn Progress,
    begins: f64,
    share: f64,
    name: String,
}

impl Progress for PartOf<'_> {
    fn report(&self, fraction: f64, stage: &str) {
        self.all.report(self.begins + self.share * fraction, &format!("{}: {stage}", self.name));
    }
}

/// Trials of `campaign` that have ended: those with a record in its folder that can be compared, and why others cannot.
fn recorded<'a>(
    store: &Store,
    campaign: &'a Campaign,
) -> Result<(Vec<Recorded<'a>>, Vec<LeftOutTrial>), Error> {
    // Only this folder: who tells what came of a trial names its record too, and must not choose a file of this computer.
    let records = folder(store, &campaign.summary.id)?.join(RECORDS_DIR);
    let (mut recorded, mut left_out) = (Vec::new(), Vec::new());
    for trial in &campaign.trials {
        let Some(last) = trial.attempts.last().filter(|last| last.has_ended) else { continue };
        let path = records.join(format!("trial-{:04}-{}.jsonl", trial.number, trial.attempts.len() - 1));
        let suggested = last.outcome.as_ref().and_then(|outcome| outcome.suggested);
        let is_void = [last.verdict, suggested].contains(&Some(TrialVerdict::Void));
        let policy = campaign.plan.policies.iter().find(|policy| Some(&policy.id) == trial.policy.as_ref());
        let why = match policy {
            _ if is_void => "it is void",
            Some(policy) if policy.is_silenced => {
                "its policy was told that it feels nothing; it compares with itself with touch"
            }
            Some(policy) if path.is_file() => {
                recorded.push(Recorded { trial, last, policy: &policy.id, path });
                continue;
            }
            _ => "its record is not in this studio's folder, because no job of this studio made the trial",
        };
        left_out.push(LeftOutTrial { trial: trial.number, why: why.to_owned() });
    }
    Ok((recorded, left_out))
}

/// The models of a request, each once, and what the program is told of each.
fn models(store: &Store, ids: &[String]) -> Result<Vec<(ComparedModel, PathBuf)>, Error> {
    let usual = [NOMINAL_MODEL.to_owned()];
    let mut models: Vec<(ComparedModel, PathBuf)> = Vec::new();
    for id in if ids.is_empty() { &usual[..] } else { ids } {
        if models.iter().any(|(model, _)| model.id == *id) {
            continue;
        }
        let (name, path) = match model_file(store, Some(id))? {
            Some(path) => (store.model_summary(id)?.name, path),
            None => ("Nominal".to_owned(), PathBuf::from(NOMINAL_MODEL)),
        };
        models.push((ComparedModel { id: id.clone(), name }, path));
    }
    Ok(models)
}

/// What the program found of the trials of one policy and object.
#[derive(Deserialize)]
struct Found {
    left_out: BTreeMap<String, Vec<u32>>,
    /// Trials that begin where the plan has the object, because nobody measured it.
    starts_as_planned: Vec<u32>,
    hand: FoundEach,
    models: Vec<FoundModel>,
}

#[derive(Deserialize)]
struct FoundModel {
    same_start: FoundSimulated,
}

#[derive(Deserialize)]
struct FoundSimulated {
    touch: ComparedTouch,
    each: Vec<FoundTrial>,
}

#[derive(Deserialize)]
struct FoundEach {
    each: Vec<FoundTrial>,
}

#[derive(Deserialize)]
struct FoundTrial {
    trial: u32,
    verdict: TrialVerdict,
    /// On the hand: nobody looked.
    #[serde(default)]
    is_suggested: bool,
}

/// Has the trials of a policy and an object simulated.
fn compare(
    cx: &JobWork<'_>,
    workplace: &Workplace,
    idx: usize,
    trials: &[Recorded<'_>],
    models: &[(ComparedModel, PathBuf)],
) -> Result<Found, Error> {
    // Only the attempts that count, which the program could not tell from those before.
    let records = workplace.path().join(format!("records-{idx}"));
    fs::create_dir(&records).map_err(Error::io("make", &records))?;
    for Recorded { path, .. } in trials {
        let name = path.file_name().unwrap_or_default();
        let path = path.canonicalize().map_err(Error::io("find", path))?;
        symlink(&path, records.join(name)).map_err(Error::io("link", &records))?;
    }
    let out = workplace.path().join(format!("compared-{idx}.json"));
    let mut arguments = Arguments::of("compare-rollout").with("rollout", &records).with("out", &out);
    for (_, model) in models {
        arguments = arguments.with("model", model);
    }
    arguments.log();
    cx.run_trainer_in(workplace, arguments)?;
    let found: Found = serde_json::from_str(&read_text(&out, MAX_RECORD_BYTES)?).map_err(|err| {
        Error::Internal(format!(
            "what palpate-train found cannot be read ({err}); is it of the same version as palpate?"
        ))
    })?;
    if found.models.len() != models.len() {
        return Err(Error::Internal(format!(
            "palpate-train compared with {} models, expected {}; is it of the same version as palpate?",
            found.models.len(),
            models.len()
        )));
    }
    Ok(found)
}

/// Adds what was found of the trials of a policy and an object.
fn add(report: &mut ComparisonReport, found: Found, trials: &[Recorded<'_>]) -> Result<(), Error> {
    let Some(first) = trials.first() else { return Ok(()) };
    let begin = report.trials.len();
    for recorded in trials {
        let number = recorded.trial.number;
        if let Some((why, _)) = found.left_out.iter().find(|(_, numbers)| numbers.contains(&number)) {
            report.left_out.push(LeftOutTrial { trial: number, why: words(why) });
            continue;
        }
        let of_trial = |each: &'_ [FoundTrial]| {
            each.iter().find(|trial| trial.trial == number).map(|trial| (trial.verdict, trial.is_suggested))
        };
        let simulated =
            found.models.iter().map(|model| of_trial(&model.same_start.each).map(|(verdict, _)| verdict));
        let simulated: Option<Vec<TrialVerdict>> = simulated.collect();
        let (Some(on_hand), Some(simulated)) = (of_trial(&found.hand.each), simulated) else {
            let why = "the simulation says nothing of it".to_owned();
            report.left_out.push(LeftOutTrial { trial: number, why });
            continue;
        };
        let (hand, said_by) = match (recorded.last.verdict, on_hand) {
            (Some(verdict), _) => (verdict, SaidBy::Scorers),
            (None, (verdict, false)) => (verdict, SaidBy::Operator),
            (None, (verdict, true)) => (verdict, SaidBy::Robot),
        };
        report.trials.push(ComparedTrial {
            trial: number,
            policy: recorded.policy.to_owned(),
            object: recorded.trial.object.clone(),
            hand,
            said_by,
            simulated,
            take: recorded.last.take.clone(),
            is_followed: is_followed(&recorded.path),
            is_start_planned: found.starts_as_planned.contains(&number),
        });
    }
    let compared = &report.trials[begin..];
    for (idx, model) in found.models.into_iter().enumerate() {
        let of_group = pairing(compared, &report.models, idx)?;
        report.pairings.push(ComparedPairing {
            policy: Some(first.policy.to_owned()),
            object: Some(first.trial.object.clone()),
            touch: Some(model.same_start.touch),
            ..of_group
        });
    }
    Ok(())
}

/// Counts the trials of all policies and objects together, by model.
fn add_all(report: &mut ComparisonReport) -> Result<(), Error> {
    for idx in 0..report.models.len() {
        let together = pairing(&report.trials, &report.models, idx)?;
        report.pairings.push(together);
    }
    Ok(())
}

fn pairing(trials: &[ComparedTrial], models: &[ComparedModel], idx: usize) -> Result<ComparedPairing, Error> {
    let hand: Vec<TrialVerdict> = trials.iter().map(|trial| trial.hand).collect();
    let simulated: Vec<TrialVerdict> =
        trials.iter().filter_map(|trial| trial.simulated.get(idx).copied()).collect();
    let model = models.get(idx).map(|model| model.id.as_str()).unwrap_or_default();
    Ok(paired(&hand, &simulated, model)?)
}

/// Why the program leaves a trial out, for people.
fn words(why: &str) -> String {
    match why {
        "unknown_start" => "a person placed the object, so nobody knows where it began",
        "another_start" => "the object does not begin in simulation where the record says that it did",
        "void" => "it is void",
        "no_outcome" => "its record ends before the trial does",
        other => other,
    }
    .to_owned()
}

/// Whether the take of the trial with this record has where the object was, as the record's last line says.
fn is_followed(record: &Path) -> bool {
    let Ok(text) = read_text(record, MAX_RECORD_BYTES) else { return false };
    let last = text.lines().next_back().unwrap_or_default();
    let line: Value = serde_json::from_str(last).unwrap_or_default();
    line["outcome"]["recorded"]["object_poses"].as_u64().is_some_and(|poses| poses > 0)
}
