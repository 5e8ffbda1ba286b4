//! Trials of a campaign: which one is next and how it begins comes from the studio, what it came to goes there.
//!
//! The [`Journal`] remembers what was begun and ended, so that a restart of either side makes no trial twice and loses none.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::{Context as _, bail};
use palpate_terminal::{cancel_on_ctrl_c, events};
use palpate_wire::api::{
    Attempt, Campaign, CampaignPlan, CampaignPolicy, RolloutOutcome, Trial, TrialState, TrialVerdict,
};
use serde_json::json;

use crate::args::RolloutArgs;
use crate::attempt::{Begins, Making, Placing, begin, make};
use crate::fit::{self, FitArgs, Fitted, Region, SCRIPTS};
use crate::hand::{Hand, alive_while, hold, ready, still_there};
use crate::journal::{Journal, Stage};
use crate::link::{Link, switch_reflex_on};
use crate::operator::Operator;
use crate::outcome::{Outcome, Outcomes};
use crate::studio::{RequestError, Studio};
use crate::take::Recording;

/// Where policies are looked for that are named without a folder.
const POLICIES: &str = "assets/policies";
/// Stands for the object's id in the source of a policy.
const OBJECT: &str = "{object}";
/// Says that a source is a script.
const SCRIPT: &str = "script:";
/// A studio that is started again is back within this.
const PATIENCE: Duration = Duration::from_secs(60);
/// A lease without heartbeats ends within this.
const LEASE: Duration = Duration::from_secs(8);
/// A trial on an emulated station is prepared at most so often.
const MAX_TRIES: u32 = 3;
/// Longest reason that a studio takes, bytes.
const MAX_REASON_BYTES: usize = 500;

/// Which campaign, and how.
pub(crate) struct Options<'a> {
    pub(crate) id: &'a str,
    pub(crate) repeats_void: bool,
    pub(crate) is_placed_at_page: bool,
    /// ID=SOURCE.
    pub(crate) policies: &'a [String],
    /// Where takes of its trials go.
    pub(crate) recording: Option<&'a Recording>,
}

/// Why no further trial is made.
#[derive(Debug, PartialEq)]
enum Done {
    Complete,
    Paused,
    Closed,
    Cancelled,
    /// The connection is lost, for this reason.
    Lost(String),
}

/// What the trials of a campaign share.
struct Session<'a> {
    args: &'a RolloutArgs,
    studio: &'a Studio,
    options: &'a Options<'a>,
    /// By ids of policy and object.
    arms: BTreeMap<(String, String), Fitted>,
    journal: Journal,
    outcomes: Outcomes,
    operator: Option<Operator>,
    /// Nothing is printed that a blind scorer is not to know.
    is_blind: bool,
    /// Trials that this process has made.
    num_made: u64,
}

/// Makes trials until none is left, or somebody pauses or closes the campaign.
///
/// # Errors
/// A campaign, policies or a folder that do not belong together; whatever keeps a trial from beginning.
pub(crate) fn run(args: &RolloutArgs, studio: &Studio, options: &Options<'_>) -> anyhow::Result<()> {
    let path = format!("/campaigns/{}", options.id);
    let campaign: Campaign = studio.get(&path)?;
    let sources = sources(&campaign.plan, options.policies)?;
    let journal = Journal::open(&args.out, options.id, &campaign.summary.created)?;
    let outcomes = Outcomes::open(&args.out, args.json)?;
    let is_blind = campaign.plan.is_blind;
    let (operator, arms) = (None, BTreeMap::new());
    let num_made = 0;
    let mut session =
        Session { args, studio, options, arms, journal, outcomes, operator, is_blind, num_made };
    session.tell_untold()?;
    let campaign: Campaign = studio.get(&path)?;
    if let Some(done) = standing(&campaign, options.repeats_void) {
        session.say(&done);
        return Ok(());
    }
    // All before the first motion: a policy that does not fit is not found out in the middle of the night.
    let mut reflex = None;
    for (policy, source) in campaign.plan.policies.iter().zip(&sources) {
        for object in &campaign.plan.objects {
            let region = Region::HalfWidthM(campaign.plan.half_width_m);
            let mut fitted = fit_arm(studio, &args.fit, source, &object.id, region)
                .with_context(|| format!("policy {:?} on the object {:?}", policy.id, object.id))?;
            if let Some(path) = &args.reflex {
                reflex = Some(fit::reflex(path, &mut fitted)?);
            }
            for warning in &fitted.warnings {
                let policy = if is_blind { "a policy" } else { policy.id.as_str() };
                eprintln!("rollout: {policy} on {}: {warning}", object.id);
            }
            session.arms.insert((policy.id.clone(), object.id.clone()), fitted);
        }
    }
    session.operator = args.operator.as_deref().map(Operator::connect).transpose()?;
    let cancel = cancel_on_ctrl_c();
    loop {
        let link = connect(args, studio)?;
        let hand = Hand { link: &link, cancel: &cancel };
        let done = switch_reflex_on(&link, reflex.as_deref()).and_then(|()| session.trials(&hand));
        if let Some(fitted) = session.arms.values().next() {
            hold(&link, &fitted.station);
        }
        link.release();
        let done = match done {
            Err(_) if cancel.is_cancelled() => Done::Cancelled,
            Err(err) => match (link.ended(), err.downcast_ref()) {
                (Some(why), _) => Done::Lost(why),
                // The connection of control may notice a little later.
                (None, Some(unanswered @ RequestError::Unanswered { .. })) => {
                    Done::Lost(unanswered.to_string())
                }
                (None, _) => return Err(err),
            },
            Ok(done) => done,
        };
        session.say(&done);
        match done {
            // Nobody stands beside an emulated station. Beside a real one somebody looks first whether it may move again.
            Done::Lost(_) if session.operator.is_some() => {}
            Done::Lost(why) => bail!(
                "{why}; what was made is told to the studio. Run the same command again when the station may move"
            ),
            Done::Complete | Done::Paused | Done::Closed | Done::Cancelled => return Ok(()),
        }
    }
}

/// Takes control. A studio that is being started again is waited for, and so is the end of a lease whose holder is gone, as that
/// of a rollout that was killed.
fn connect(args: &RolloutArgs, studio: &Studio) -> anyhow::Result<Link> {
    let begun = Instant::now();
    loop {
        let err = match Link::connect(studio, &args.name, args.take_over) {
            Ok(link) => return Ok(link),
            Err(err) => err,
        };
        let answers = studio.get::<serde_json::Value>("/campaigns");
        let is_gone = matches!(answers, Err(RequestError::Unanswered { .. }));
        if begun.elapsed() > if is_gone { PATIENCE } else { LEASE } {
            return Err(err);
        }
        std::thread::sleep(Duration::from_millis(500));
    }
}

impl Session<'_> {
    /// Why no further trial is made now, for people, and for a program that reads events. Neither learns what trials came to,
    /// which a blind scorer is not to know.
    fn say(&self, done: &Done) {
        let id = self.options.id;
        let (ended, text) = match done {
            Done::Complete => ("complete", format!("campaign {id:?} has no trial left to make")),
            Done::Paused => {
                ("paused", format!("campaign {id:?} is paused; resume it, and run the same command again"))
            }
            Done::Closed => ("closed", format!("campaign {id:?} is closed")),
            Done::Cancelled => {
                ("cancelled", format!("stopped by Ctrl-C; the same command goes on with campaign {id:?}"))
            }
            Done::Lost(why) => ("lost", why.clone()),
        };
        eprintln!("rollout: {text}");
        events::report(&json!({ "campaign": id, "ended": ended, "trials_made": self.num_made }));
    }

    fn trials(&mut self, hand: &Hand<'_>) -> anyhow::Result<Done> {
        let path = format!("/campaigns/{}", self.options.id);
        loop {
            let campaign: Campaign = alive_while(hand.link, || Ok(self.studio.get(&path)?))?;
            if let Some(done) = standing(&campaign, self.options.repeats_void) {
                return Ok(done);
            }
            let trial = next(&campaign, self.options.repeats_void).context("there is no next trial")?;
            tell_progress(&campaign, trial, "is prepared");
            ready(hand)?;
            if let Some(done) = self.trial(hand, &campaign, trial)? {
                return Ok(done);
            }
            if let Some(why) = hand.link.ended() {
                return Ok(Done::Lost(why));
            }
        }
    }

    /// Makes the next attempt of `trial`; why there is to be no further one, if so.
    fn trial(&mut self, hand: &Hand<'_>, campaign: &Campaign, trial: &Trial) -> anyhow::Result<Option<Done>> {
        let (number, is_running) = (trial.number, trial.state == TrialState::Running);
        let attempt = trial.attempts.len() as u32 - u32::from(is_running);
        if is_running
            && self.journal.stage(number, attempt) != Some(&Stage::Begins)
            && !self.options.is_placed_at_page
        {
            let by = trial.attempts.last().map(|last: &Attempt| last.by.as_str()).unwrap_or_default();
            bail!(
                "trial {number} was begun by {by} and not by this rollout; end it at the studio's page, or give the --out of \
                 the rollout that began it"
            );
        }
        let policy = trial.policy.clone().context(
            "the studio does not say which policy is next; whoever runs trials needs the role of operator",
        )?;
        let plan = campaign.plan.policies.iter().find(|known| known.id == policy);
        let is_silenced = plan.is_some_and(|policy| policy.is_silenced);
        let key = (policy.clone(), trial.object.clone());
        let arm = self.arms.get(&key).with_context(|| {
            format!(
                "trial {number} is of policy {policy:?} on {:?}, which the plan does not have",
                trial.object
            )
        })?;
        let mut num_tries = 0;
        let begins = loop {
            let mut look = placed_at_page(self.studio, self.options.id, number);
            let placing = match self.operator.as_mut() {
                Some(operator) => Placing::Operator(operator, place_request(trial)),
                None if self.options.is_placed_at_page => Placing::Elsewhere(&mut look),
                None if self.args.placed => Placing::Nobody,
                None => Placing::Person(told(campaign, trial, arm)),
            };
            if self.options.is_placed_at_page && !is_running {
                tell_progress(campaign, trial, "prepares: the robot moves out of the way, stay clear of it");
            }
            num_tries += 1;
            match begin(hand, arm, placing) {
                Ok(begins) => break begins,
                // An emulated station on a busy computer lets go now and then. Beside a real one somebody looks first.
                Err(err) if self.operator.is_some() && num_tries < MAX_TRIES => {
                    still_there(hand)?;
                    eprintln!("rollout: trial {number} is prepared once more: {err:#}");
                    ready(hand)?;
                }
                // Somebody has taken a break, or closed the campaign, instead of placing the object.
                Err(err) if self.options.is_placed_at_page && hand.link.ended().is_none() => {
                    return self.standing_now(hand)?.map(Some).ok_or(err);
                }
                Err(err) => return Err(err),
            }
        };
        if !is_running {
            self.journal.begins(number, attempt)?;
        }
        if !is_running && !self.options.is_placed_at_page {
            let path = format!("/campaigns/{}/trials/{number}/begin", self.options.id);
            let begun = alive_while(hand.link, || Ok(self.studio.post::<Campaign>(&path, &json!({}))?));
            if let Err(refused) = begun {
                // Somebody may have taken a break, or closed the campaign, while the object was placed.
                return self.standing_now(hand)?.map(Some).ok_or(refused);
            }
        }
        tell_progress(campaign, trial, "runs");
        let is_cancelled = self.make(hand, trial, attempt, &policy, is_silenced, &begins)?;
        Ok(is_cancelled.then_some(Done::Cancelled))
    }

    /// Why no trial is to be made now, as the studio has it.
    fn standing_now(&self, hand: &Hand<'_>) -> anyhow::Result<Option<Done>> {
        let path = format!("/campaigns/{}", self.options.id);
        let campaign: Campaign = alive_while(hand.link, || Ok(self.studio.get(&path)?))?;
        Ok(standing(&campaign, self.options.repeats_void))
    }

    fn make(
        &mut self,
        hand: &Hand<'_>,
        trial: &Trial,
        attempt: u32,
        policy: &str,
        is_silenced: bool,
        begins: &Begins,
    ) -> anyhow::Result<bool> {
        let number = trial.number;
        let path = record_path(&self.args.out, number, attempt);
        let start = trial.start;
        let making = Making {
            campaign: Some(self.options.id),
            trial: u64::from(number),
            attempt: Some(attempt),
            path: &path,
            start: json!({
                "offset_m": [start.x_m, start.y_m], "yaw_rad": start.yaw_rad, "side": start.side, "seed": start.seed,
            }),
            is_silenced,
            inject: None,
            recording: self.options.recording,
            planned: Some(&start),
        };
        let arm = self.arms.get_mut(&(policy.to_owned(), trial.object.clone()));
        let arm = arm.with_context(|| format!("there is no policy {policy:?} on {:?}", trial.object))?;
        self.journal.moves(number, attempt)?;
        self.num_made += 1;
        let (outcome, is_cancelled) = make(hand, arm, making, begins, self.operator.as_mut())?;
        self.journal.ended(number, attempt, to_tell(&outcome))?;
        self.outcomes.add(&outcome)?;
        if !self.args.json {
            match self.is_blind {
                true => println!("trial {number} has ended"),
                false => println!(
                    "trial {number}: {policy} on {}: {:?}: {}",
                    outcome.object,
                    outcome.suggested,
                    outcome.reasons.join("; ")
                ),
            }
        }
        let (studio, id, journal) = (self.studio, self.options.id, &mut self.journal);
        alive_while(hand.link, || tell(studio, id, journal, number, attempt, &to_tell(&outcome)))?;
        Ok(is_cancelled)
    }

    /// Tells the studio what an earlier process left untold.
    fn tell_untold(&mut self) -> anyhow::Result<()> {
        for ((trial, attempt), outcome) in self.journal.untold() {
            let outcome = outcome.unwrap_or_else(|| {
                let path = record_path(&self.args.out, trial, attempt);
                cut_off(&path)
            });
            eprintln!(
                "rollout: telling the studio how trial {trial} ended, which an earlier process left untold"
            );
            self.journal.ended(trial, attempt, outcome.clone())?;
            tell(self.studio, self.options.id, &mut self.journal, trial, attempt, &outcome)?;
        }
        Ok(())
    }
}

/// Tells whoever reads events how far `campaign` is, and what becomes of `trial`.
fn tell_progress(campaign: &Campaign, trial: &Trial, what: &str) {
    let made = campaign
        .trials
        .iter()
        .filter(|trial| !trial.attempts.is_empty() && trial.state != TrialState::Running);
    let (number, planned) = (trial.number, campaign.summary.planned);
    events::progress(
        made.count() as f64 / f64::from(planned.max(1)),
        &format!("trial {number} of {planned} {what}"),
    );
}

fn record_path(folder: &Path, trial: u32, attempt: u32) -> PathBuf {
    folder.join(format!("trial-{trial:04}-{attempt}.jsonl"))
}

/// Of a trial in whose middle the process was gone.
fn cut_off(record: &Path) -> RolloutOutcome {
    let reason = "the rollout's process was gone in the middle of the trial; its record has no end";
    RolloutOutcome {
        suggested: Some(TrialVerdict::Void),
        reasons: vec![reason.to_owned()],
        time_to_grasp_s: None,
        held_s: None,
        take: None,
        record: Some(shown(record)),
    }
}

/// What the studio is told of an outcome.
fn to_tell(outcome: &Outcome) -> RolloutOutcome {
    RolloutOutcome {
        suggested: Some(outcome.suggested),
        reasons: outcome.reasons.iter().map(|reason| cut(reason).to_owned()).collect(),
        time_to_grasp_s: outcome.time_to_grasp_s,
        held_s: Some(outcome.held_s),
        take: outcome
            .recorded
            .as_ref()
            .and_then(|recorded| recorded.take.as_ref().map(|take| format!("{}/{take}", recorded.session))),
        record: Some(shown(Path::new(&outcome.take))),
    }
}

/// The path, or only the name where a studio takes no path that long.
fn shown(record: &Path) -> String {
    let path = record.display().to_string();
    match path.len() <= MAX_REASON_BYTES {
        true => path,
        false => record.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default(),
    }
}

/// As much of `text` as a studio takes.
fn cut(text: &str) -> &str {
    let end = (0..=text.len().min(MAX_REASON_BYTES)).rev().find(|&end| text.is_char_boundary(end));
    text.get(..end.unwrap_or(0)).unwrap_or_default()
}

/// Tells the studio what a trial came to, once it can be reached. It keeps what it is told twice once.
fn tell(
    studio: &Studio,
    id: &str,
    journal: &mut Journal,
    trial: u32,
    attempt: u32,
    outcome: &RolloutOutcome,
) -> anyhow::Result<()> {
    let path = format!("/campaigns/{id}/trials/{trial}/outcome");
    let body = json!({ "attempt": attempt, "outcome": outcome });
    let told = studio.until_answered(PATIENCE, |studio| studio.post::<Campaign>(&path, &body));
    match told {
        Ok(_) => {}
        // Somebody has ended it at the page, and said what it came to.
        Err(RequestError::Refused { status: 409, detail, .. }) => {
            eprintln!("rollout: the studio does not take what trial {trial} came to: {detail}");
        }
        Err(err) => {
            return Err(err).with_context(|| {
                format!("trial {trial} is made and recorded, but not told; the same command tells it later")
            });
        }
    }
    journal.told(trial, attempt)
}

/// Why no trial of `campaign` is to be made now, if none is.
fn standing(campaign: &Campaign, repeats_void: bool) -> Option<Done> {
    if campaign.summary.closed.is_some() {
        return Some(Done::Closed);
    }
    if campaign.summary.paused.is_some() {
        return Some(Done::Paused);
    }
    next(campaign, repeats_void).is_none().then_some(Done::Complete)
}

/// The trial whose turn it is, or with `repeats_void` the first that was scored void where no other is left.
fn next(campaign: &Campaign, repeats_void: bool) -> Option<&Trial> {
    let next = campaign.next.and_then(|next| campaign.trials.iter().find(|trial| trial.number == next));
    let is_void = |trial: &&Trial| {
        trial.state == TrialState::Scored
            && trial.attempts.last().and_then(|last| last.verdict) == Some(TrialVerdict::Void)
    };
    next.or_else(|| campaign.trials.iter().find(is_void).filter(|_| repeats_void))
}

/// Looks whether somebody has begun trial `number` at the studio's page. Who looks first says that it waits: before,
/// the robot moves, and nobody may place anything.
fn placed_at_page<'a>(
    studio: &'a Studio,
    id: &'a str,
    number: u32,
) -> impl FnMut() -> anyhow::Result<bool> + Send + 'a {
    let mut is_told = false;
    move || {
        let campaign: Campaign = studio.get(&format!("/campaigns/{id}"))?;
        if campaign.summary.closed.is_some() || campaign.summary.paused.is_some() {
            bail!("the campaign was paused or closed while the object was being placed");
        }
        let trial = campaign.trials.iter().find(|trial| trial.number == number);
        let is_running = trial.is_some_and(|trial| trial.state == TrialState::Running);
        if let Some(trial) = trial.filter(|_| !is_running && !is_told) {
            is_told = true;
            tell_progress(&campaign, trial, "waits: place its object and begin it at the page");
            eprintln!(
                "rollout: trial {number} waits; begin it at the studio's page once its object is placed"
            );
        }
        Ok(is_running)
    }
}

/// What the operator of an emulated station is asked for.
fn place_request(trial: &Trial) -> serde_json::Value {
    let start = trial.start;
    json!({
        "act": "place", "object": trial.object, "offset_m": [start.x_m, start.y_m], "yaw_rad": start.yaw_rad,
        "side": start.side, "seed": start.seed,
    })
}

/// What a person is told to do.
fn told(campaign: &Campaign, trial: &Trial, fitted: &Fitted) -> String {
    let (start, [x_m, y_m]) = (trial.start, fitted.world.task.center_m);
    format!(
        "trial {} of {}: place the object {:?} at x = {:.0} mm, y = {:.0} mm of the robot's base ({:+.0} and {:+.0} mm from the \
         middle), turned by {:.0} degrees about the vertical",
        trial.number,
        campaign.summary.planned,
        trial.object,
        1e3 * (x_m + start.x_m),
        1e3 * (y_m + start.y_m),
        1e3 * start.x_m,
        1e3 * start.y_m,
        start.yaw_rad.to_degrees(),
    )
}

/// Where the policies of a campaign come from: its own word, or what the command line says instead.
fn sources(plan: &CampaignPlan, given: &[String]) -> anyhow::Result<Vec<String>> {
    let mut own: BTreeMap<&str, &str> = BTreeMap::new();
    for text in given {
        let (id, source) = text.split_once('=').with_context(|| {
            format!("--policy is {text:?}; with --campaign it is ID=PATH, e.g. {}=...", first_id(plan))
        })?;
        if !plan.policies.iter().any(|policy| policy.id == id) {
            let known: Vec<&str> = plan.policies.iter().map(|policy| policy.id.as_str()).collect();
            bail!("--policy {text:?}: the campaign has no policy {id:?}; it has {}", known.join(", "));
        }
        if own.insert(id, source).is_some() {
            bail!("--policy is there twice for {id:?}");
        }
    }
    let source =
        |policy: &CampaignPolicy| own.get(policy.id.as_str()).copied().unwrap_or(&policy.source).to_owned();
    Ok(plan.policies.iter().map(source).collect())
}

fn first_id(plan: &CampaignPlan) -> &str {
    plan.policies.first().map(|policy| policy.id.as_str()).unwrap_or_default()
}

/// Reads the policy that `source` names, for the object with this id, and checks that everything belongs together.
fn fit_arm(
    studio: &Studio,
    shared: &FitArgs,
    source: &str,
    object: &str,
    region: Region,
) -> anyhow::Result<Fitted> {
    let source = source.replace(OBJECT, object);
    let mut args = shared.clone();
    object.clone_into(&mut args.object);
    if let Some(script) = source.strip_prefix(SCRIPT) {
        args.script = Some(script.to_owned());
        return fit::fit(studio, None, &args, region);
    }
    let path = policy_path(&source)?;
    args.without_script = fit::is_without_script(&path)?;
    fit::fit(studio, Some(&path), &args, region)
}

/// A file or folder, or a file of the shipped policies by its name.
fn policy_path(source: &str) -> anyhow::Result<PathBuf> {
    // One that imitates an expert is looked for when it is read.
    let given = PathBuf::from(source);
    if source.starts_with(fit::CLONE) {
        return Ok(given);
    }
    let shipped = Path::new(POLICIES).join(source);
    match () {
        () if given.exists() => Ok(given),
        () if shipped.exists() => Ok(shipped),
        () => bail!(
            "{source:?} is no file, nothing in {POLICIES} and no {SCRIPT}NAME of {SCRIPTS}; give --policy ID=PATH"
        ),
    }
}

#[cfg(test)]
mod tests;
