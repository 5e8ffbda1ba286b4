//! From the command's arguments to outcomes.

use std::cell::Cell;
use std::collections::BTreeMap;
use std::io::IsTerminal as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::{Context as _, bail};
use palpate_robot_model::Station;
use palpate_sim::job::Cancel;
use palpate_terminal::cancel_on_ctrl_c;
use palpate_wire::api::TrialStart;
use palpate_wire::proto::{Arm, control_request::Request, control_state::Phase};
use serde::Serialize;
use serde_json::{Value, json};

use crate::campaign;
use crate::fit::{self, FitArgs, Fitted, Region};
use crate::inject::Injected;
use crate::link::{Frame, Link, switch_reflex_on};
use crate::operator::Operator;
use crate::record::Record;
use crate::studio::Studio;
use crate::take::{RecordArgs, Recorded, Recording};
use crate::trial::{self, Ended, Setting, median_and_p99_ms, targets, wait_until};
use crate::verdict::Verdict;

/// Devices are there, the station is armed, or joints are where they are sent, after this long at the latest.
const PATIENCE: Duration = Duration::from_secs(30);
/// A joint of the hand that is this near has arrived, rad: soft servos carry the fingers' weight.
const NEAR_HAND_RAD: f64 = 0.12;
/// A joint of the arm, rad.
const NEAR_ARM_RAD: f64 = 0.02;
/// Targets of a motion to the start are told again this often.
const TELL_AGAIN: Duration = Duration::from_millis(500);
/// A station that lets go or comes up is done within this.
const SETTLES: Duration = Duration::from_secs(3);
/// It is asked this often meanwhile.
const ASK_AGAIN: Duration = Duration::from_millis(100);
/// Whether the object was placed is asked this often.
const LOOK_AGAIN: Duration = Duration::from_millis(300);
/// Joints that have arrived get this long to come to rest.
const REST: Duration = Duration::from_millis(500);

/// What `palpate tokens create` printed, where people have to log in.
const TOKEN: &str = "PALPATE_TOKEN";

/// Trials of a policy on the hand that a studio drives.
#[derive(Clone, Debug, clap::Args)]
pub struct RolloutArgs {
    /// Address of the studio, as `palpate serve` prints it
    #[arg(long, default_value = "http://127.0.0.1:8080")]
    url: String,
    /// Certificates in PEM that vouch for a studio that speaks TLS, as a copy of `tls/cert.pem` in its data folder does
    #[arg(long, value_name = "FILE")]
    ca_file: Option<PathBuf>,
    /// A learned policy: a training's folder, a checkpoint or an exported file; without one the script alone runs. With
    /// `--campaign`, ID=PATH for a policy of the campaign whose own source is not to be used; may be repeated
    #[arg(long)]
    policy: Vec<String>,
    #[command(flatten)]
    pub(crate) fit: FitArgs,
    /// Make the trials of this campaign of the studio, one after the other, until none is left or somebody pauses it
    #[arg(long, value_name = "ID", conflicts_with_all = ["script", "without_script", "object", "silence_touch", "trials", "first", "seed", "start_cm", "inject"])]
    campaign: Option<String>,
    /// Make trials of the campaign that were scored void once more
    #[arg(long, requires = "campaign")]
    repeat_void: bool,
    /// Whoever places the object says so on the studio's page, where they begin each trial of the campaign
    #[arg(long, requires = "campaign", conflicts_with_all = ["operator", "placed"])]
    placed_at_page: bool,
    /// Tell the policy that it feels nothing, to see what touch is worth
    #[arg(long)]
    silence_touch: bool,
    /// Number of trials
    #[arg(long, default_value_t = 1)]
    trials: u64,
    /// Number of the first of them
    #[arg(long, default_value_t = 0)]
    first: u64,
    /// Seed of the starts that an emulated station's operator places
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Half the edge length of the square that objects start in, cm [default: as the world's file says]
    #[arg(long)]
    start_cm: Option<f64>,
    /// Folder for the records of the trials and `outcomes.jsonl`; it must be new or empty, or hold the same campaign
    #[arg(long)]
    pub(crate) out: PathBuf,
    /// Socket of the operator of `palpate-train station`, who places objects and sees what became of them
    #[arg(long, value_name = "SOCKET")]
    pub(crate) operator: Option<PathBuf>,
    /// The object lies there already: nobody is asked to place it
    #[arg(long, conflicts_with = "operator")]
    pub(crate) placed: bool,
    /// Who has control meanwhile, for everybody else's page
    #[arg(long, default_value = "rollout")]
    pub(crate) name: String,
    /// Take control from whoever has it
    #[arg(long)]
    pub(crate) take_over: bool,
    /// Switch the studio's reflex of the digits on for the rollout, as this file has it (`docs/reflex.md`)
    #[arg(long, value_name = "FILE")]
    pub(crate) reflex: Option<PathBuf>,
    /// A fault on purpose: nan, jumps, slow or hang, and when in each trial, s
    #[arg(long, value_name = "KIND=S")]
    inject: Option<Injected>,
    #[command(flatten)]
    record: RecordArgs,
    /// A line of JSON for each trial on standard output
    #[arg(long)]
    pub(crate) json: bool,
}

/// What a trial came to: a line of `outcomes.jsonl`. `docs/rollouts.md` explains the fields; they stay.
#[derive(Clone, Debug, Serialize)]
pub struct Outcome {
    /// Its campaign; absent without one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub campaign: Option<String>,
    /// Its number; in a campaign, that of its plan.
    pub trial: u64,
    /// Which try of the campaign's trial it is, from 0; absent without a campaign.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub attempt: Option<u32>,
    /// Id of the object.
    pub object: String,
    /// What moved the hand.
    pub policy: String,
    /// The policy was told that it feels nothing.
    pub is_silenced: bool,
    /// How the trial began: what the object's place was made of, and where it was; `null` where a person placed the
    /// object outside a campaign.
    pub start: Value,
    /// What the robot itself takes it for.
    pub suggested: Verdict,
    /// Why.
    pub reasons: Vec<String>,
    /// When enough digits were first stopped on something, s.
    pub time_to_grasp_s: Option<f64>,
    /// For how long something was held in the air, s.
    pub held_s: f64,
    /// The record of the trial.
    pub take: String,
    /// The take of the studio that it became; absent without `--record`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub recorded: Option<Recorded>,
    /// What the emulated station's operator saw; `null` where nobody looks.
    pub truth: Value,
    /// Steps of the policy, those whose targets came after the next was due, and those left out because of that.
    pub steps: u64,
    /// See `steps`.
    pub deadline_misses: u64,
    /// See `steps`.
    pub skipped_steps: u64,
    /// Targets that the safety layer refused.
    pub refused: u64,
    /// Time of a plan, ms: median and 99th percentile.
    pub plan_ms: [f64; 2],
    /// Age of what a step acted on when it began, ms: median and 99th percentile.
    pub age_ms: [f64; 2],
}

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

/// Control of the station, and whether somebody wants to stop.
#[derive(Clone, Copy)]
pub(crate) struct Hand<'a> {
    pub(crate) link: &'a Link,
    pub(crate) cancel: &'a Cancel,
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

/// Waits until every device is ready; refuses a station that somebody stopped.
pub(crate) fn ready(hand: &Hand<'_>) -> anyhow::Result<()> {
    let wanted = |frame: &Frame| fit::not_ready(&frame.live).map_or(Ok(()), |why| Err(Not::Yet(why)));
    let frame = wait_for(hand, "the devices to be ready", wanted)?;
    if frame.live.control.as_ref().is_some_and(|control| control.phase() == Phase::Stopped) {
        bail!("the station is stopped; reset the stop at the studio's page first");
    }
    Ok(())
}

/// `outcomes.jsonl`, to which lines are only added.
pub(crate) struct Outcomes {
    file: std::fs::File,
    path: PathBuf,
    prints: bool,
}

impl Outcomes {
    /// The file in `folder`; each line is printed too with `prints`.
    pub(crate) fn open(folder: &Path, prints: bool) -> anyhow::Result<Self> {
        let path = folder.join("outcomes.jsonl");
        let file = std::fs::OpenOptions::new().create(true).append(true).open(&path);
        let file = file.with_context(|| format!("failed to open {path:?}"))?;
        Ok(Self { file, path, prints })
    }

    pub(crate) fn add(&mut self, outcome: &Outcome) -> anyhow::Result<()> {
        let line = serde_json::to_string(outcome)?;
        std::io::Write::write_all(&mut self.file, format!("{line}\n").as_bytes())
            .with_context(|| format!("failed to write {:?}", self.path))?;
        if self.prints {
            println!("{line}");
        }
        Ok(())
    }
}

/// Whoever puts the object where a trial begins.
pub(crate) enum Placing<'a> {
    /// The operator of an emulated station, asked for this.
    Operator(&'a mut Operator, Value),
    /// A person at the keyboard, told this.
    Person(String),
    /// Somebody who says so elsewhere: `Ok(true)` once they have.
    Elsewhere(&'a mut (dyn FnMut() -> anyhow::Result<bool> + Send)),
    /// Nobody: it lies there.
    Nobody,
}

/// The robot and the object are where a trial begins.
pub(crate) struct Begins {
    /// By degree of freedom.
    positions: Vec<f64>,
    /// Where the operator of an emulated station says that the object is; `null` elsewhere.
    object_pose: Value,
}

/// Arms the station, moves it out of the way, has the object placed, and moves to where the trial begins.
pub(crate) fn begin(hand: &Hand<'_>, fitted: &Fitted, placing: Placing<'_>) -> anyhow::Result<Begins> {
    let station = &fitted.station;
    let waits = fitted.world.start_positions(&station.robot);
    arm(hand)?;
    go(hand, station, &waits, false)?;
    let mut begins = Begins { positions: waits, object_pose: Value::Null };
    match placing {
        Placing::Operator(operator, request) => {
            let placed = ask_alive(hand.link, operator, &request).context("the object was not placed")?;
            let positions: BTreeMap<String, f64> =
                serde_json::from_value(placed["start"].clone()).context("the operator told no start")?;
            for (at, joint) in begins.positions.iter_mut().zip(station.robot.dofs()) {
                *at = positions.get(&joint.name).copied().unwrap_or(*at);
            }
            begins.object_pose = placed["object_pose"].clone();
            go(hand, station, &begins.positions, false)?;
        }
        Placing::Person(told) => ask_person(hand.link, &told)?,
        Placing::Elsewhere(is_placed) => {
            while !alive_while(hand.link, &mut *is_placed)? {
                still_there(hand)?;
                following(hand)?;
                wait_until(hand.link, Instant::now() + LOOK_AGAIN);
            }
        }
        Placing::Nobody => {}
    }
    Ok(begins)
}

/// Which trial is made, and with what.
pub(crate) struct Making<'a> {
    pub(crate) campaign: Option<&'a str>,
    pub(crate) trial: u64,
    pub(crate) attempt: Option<u32>,
    /// File of its record.
    pub(crate) path: &'a Path,
    /// How it begins, as its outcome says.
    pub(crate) start: Value,
    pub(crate) is_silenced: bool,
    pub(crate) inject: Option<Injected>,
    /// Where its take goes.
    pub(crate) recording: Option<&'a Recording>,
    /// Where the plan of a campaign has its object.
    pub(crate) planned: Option<&'a TrialStart>,
}

/// Runs a trial that [`begin`] prepared; gives what it came to, and whether somebody wants no further one.
pub(crate) fn make(
    hand: &Hand<'_>,
    fitted: &mut Fitted,
    making: Making<'_>,
    begins: &Begins,
    operator: Option<&mut Operator>,
) -> anyhow::Result<(Outcome, bool)> {
    let Making { campaign, trial, attempt, path, mut start, is_silenced, inject, recording, planned } =
        making;
    let Hand { link, cancel } = *hand;
    let station = Arc::clone(&fitted.station);
    if start.is_object() {
        start["object_pose"] = begins.object_pose.clone();
    }
    let mut head = json!({
        "trial": trial, "object": fitted.object, "policy": fitted.policy_name, "is_silenced": is_silenced, "start": start,
        "station": station.id, "files": fitted.sources, "control_rate_hz": fitted.world.control_rate_hz,
        "joints": station.robot.dofs().map(|joint| joint.name.as_str()).collect::<Vec<_>>(),
        "channels": station.layout.channels.iter().map(|channel| channel.id.as_str()).collect::<Vec<_>>(),
        "begins_at": begins.positions,
    });
    if let Some(half_width_m) = fitted.half_width_m {
        head["half_width_m"] = json!(half_width_m);
    }
    if let Some(campaign) = campaign {
        head["campaign"] = json!(campaign);
        head["attempt"] = json!(attempt);
    }
    let mut take =
        recording.map(|recording| recording.begin(hand, fitted, &begins.object_pose, planned)).transpose()?;
    let setting = Setting { station: &station, world: &fitted.world, link, cancel, is_silenced, inject };
    let policy = &mut *fitted.policy;
    let mut trial_runs = || {
        // Its times count from here.
        let mut record = Record::create(path, station.layout.num_channels(), &head)?;
        let ended = trial::run(&setting, policy, &begins.positions, &mut record)?;
        anyhow::Ok((record, ended))
    };
    let ended = match &mut take {
        Some(take) => take.during(link, trial_runs),
        None => trial_runs(),
    };
    let recorded = take.map(|take| take.end(link));
    let (record, ended) = ended?;
    let truth = operator.map(|operator| truth(link, operator, &fitted.world.task.hold_s)).transpose();
    let truth =
        truth.unwrap_or_else(|err| Some(json!({ "problem": format!("{err:#}") }))).unwrap_or_default();
    let suggestion = ended.suggestion.clone();
    let outcome = Outcome {
        campaign: campaign.map(str::to_owned),
        trial,
        attempt,
        object: fitted.object.clone(),
        policy: fitted.policy_name.clone(),
        is_silenced,
        start,
        suggested: suggestion.verdict,
        reasons: suggestion.reasons,
        time_to_grasp_s: suggestion.time_to_grasp_s,
        held_s: suggestion.held_s,
        take: path.display().to_string(),
        recorded,
        truth,
        steps: ended.steps,
        deadline_misses: ended.deadline_misses,
        skipped_steps: ended.skipped_steps,
        refused: ended.refused,
        plan_ms: median_and_p99_ms(&ended.plan_s),
        age_ms: median_and_p99_ms(&ended.age_s),
    };
    record.outcome(&outcome)?;
    hold(link, &station);
    if ended.suggestion.held_s > 0.0 && link.ended().is_none() && !ended.is_cancelled {
        // What was lifted is put down before the hand opens.
        let _ = go(hand, &station, &put_down(link, &station, &ended), true);
    }
    Ok((outcome, ended.is_cancelled))
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

/// The arm where the hand was lowest, the hand as it is told to be.
fn put_down(link: &Link, station: &Station, ended: &Ended) -> Vec<f64> {
    let lowest = &ended.lowest;
    let commanded = link.newest().and_then(|frame| frame.live.control.clone()).unwrap_or_default().commanded;
    let mut down: Vec<f64> = commanded.into_iter().map(f64::from).collect();
    down.resize(lowest.len(), 0.0);
    for &dof in &station.carrier_dofs {
        down[dof] = lowest[dof];
    }
    down
}

/// What the operator of an emulated station saw, and how the grasp world would count that.
fn truth(link: &Link, operator: &mut Operator, hold_s: &f64) -> anyhow::Result<Value> {
    let mut state = ask_alive(link, operator, &json!({ "act": "state" }))?;
    let holds = |key: &str| state[key] == true;
    let verdict = match () {
        () if holds("arm_has_hit") => Verdict::EmergencyStop,
        // A step's rounding is no reason for another verdict.
        () if state["longest_held_s"].as_f64().unwrap_or_default() >= hold_s - 0.05 => Verdict::Success,
        () if holds("lifted") => Verdict::Slip,
        () => Verdict::EmptyGrasp,
    };
    state["verdict"] = json!(verdict);
    Ok(state)
}

/// Asks the operator; heartbeats go on meanwhile.
fn ask_alive(link: &Link, operator: &mut Operator, request: &Value) -> anyhow::Result<Value> {
    alive_while(link, || operator.ask(request))
}

/// Does `work`, which takes its time but ends; heartbeats go on meanwhile.
pub(crate) fn alive_while<T: Send>(
    link: &Link,
    work: impl FnOnce() -> anyhow::Result<T> + Send,
) -> anyhow::Result<T> {
    std::thread::scope(|scope| {
        let done = scope.spawn(work);
        while !done.is_finished() {
            link.alive();
            std::thread::sleep(Duration::from_millis(5));
        }
        done.join().unwrap_or_else(|_| bail!("a thread of the rollout failed"))
    })
}

/// Asks a person at the keyboard to do what they are `told`; heartbeats go on meanwhile.
fn ask_person(link: &Link, told: &str) -> anyhow::Result<()> {
    eprintln!("rollout: {told}, and press Enter");
    alive_while(link, || match std::io::stdin().read_line(&mut String::new()) {
        Ok(1..) => Ok(()),
        _ => bail!("standard input has ended"),
    })
}

/// Refuses to go on where control is lost, or somebody wants to stop.
pub(crate) fn still_there(hand: &Hand<'_>) -> anyhow::Result<()> {
    if let Some(why) = hand.link.ended() {
        bail!("{why}");
    }
    if hand.cancel.is_cancelled() {
        bail!("stopped by Ctrl-C");
    }
    Ok(())
}

/// Refuses to go on where the station does not follow.
fn following(hand: &Hand<'_>) -> anyhow::Result<()> {
    let newest = hand.link.newest();
    newest.and_then(|frame| crate::verdict::not_following(&frame.live)).map_or(Ok(()), |why| bail!("{why}"))
}

/// Joints stay where they are told to be now.
pub(crate) fn hold(link: &Link, station: &Station) {
    let Some(frame) = link.newest().filter(|_| link.ended().is_none()) else { return };
    let commanded = frame.live.control.as_ref().map(|control| control.commanded.clone()).unwrap_or_default();
    if commanded.is_empty() {
        return;
    }
    let commanded: Vec<f64> = commanded.into_iter().map(f64::from).collect();
    // A station that has stopped stands by itself.
    let _ = link.ask(targets(&within_limits(station, &commanded)));
    wait_until(link, Instant::now() + REST);
}

/// Arms the station. It is asked whatever the newest frame says: that may still show it as whoever had control before
/// left it.
fn arm(hand: &Hand<'_>) -> anyhow::Result<()> {
    let link = hand.link;
    // One that has just been given back lets go first.
    insist(link, "arming", || Request::Arm(Arm {}))?;
    let asked = link.newest().map_or(0, |frame| frame.number);
    let was_arming = Cell::new(false);
    let is_armed = |frame: &Frame| {
        let Some(control) = &frame.live.control else { return Err(Not::Yet(String::new())) };
        match control.phase() {
            Phase::Armed if frame.number > asked => Ok(()),
            // It has tried, and says why it could not.
            Phase::Disarmed if was_arming.get() => Err(Not::Ever(control.reason.clone())),
            phase => {
                was_arming.set(was_arming.get() || phase == Phase::Arming && frame.number > asked);
                Err(Not::Yet(control.reason.clone()))
            }
        }
    };
    wait_for(hand, "the station to be armed", is_armed).map(drop)
}

/// Asks for the same again for [`SETTLES`] while it is refused: what is refused in one moment may be right in the next.
fn insist(link: &Link, what: &str, request: impl Fn() -> Request) -> anyhow::Result<()> {
    let until = Instant::now() + SETTLES;
    loop {
        let reply = link.ask(request())?;
        if reply.accepted {
            return Ok(());
        }
        if Instant::now() >= until {
            bail!("{what} was refused: {}", reply.problem);
        }
        wait_until(link, Instant::now() + ASK_AGAIN);
    }
}

/// Moves all joints to `positions`, and waits until they are there, or until those of the arm are where the hand holds
/// something that keeps its own from it.
fn go(hand: &Hand<'_>, station: &Station, positions: &[f64], is_holding: bool) -> anyhow::Result<()> {
    let link = hand.link;
    let is_arm = |dof: usize| station.carrier_dofs.contains(&dof);
    let wanted = within_limits(station, positions);
    // A frame from before it was armed may have said that it is.
    insist(link, "a motion to the start", || targets(&wanted))?;
    let told = Cell::new(Instant::now());
    let told_arm_alone = Cell::new(false);
    let arrived = |frame: &Frame| {
        if told.get().elapsed() >= TELL_AGAIN {
            // The station forgets targets when it holds.
            told.set(Instant::now());
            let control = frame.live.control.clone().unwrap_or_default();
            // Fingers that open beside the table would leave the workspace, and that holds the arm too: it goes on
            // alone for a moment, away from there.
            let arm_alone = control.phase() == Phase::Holding && !told_arm_alone.get();
            told_arm_alone.set(arm_alone);
            let mut now = wanted.clone();
            if arm_alone {
                let told = now.iter_mut().zip(&control.commanded).enumerate();
                told.filter(|(dof, _)| !is_arm(*dof)).for_each(|(_, (now, &at))| *now = f64::from(at));
            }
            link.send(targets(&now));
        }
        if let Some(why) = crate::verdict::not_following(&frame.live) {
            return Err(Not::Ever(why));
        }
        let joints = station.robot.dofs().zip(frame.live.joint_positions.iter().zip(&wanted)).enumerate();
        let away = joints.filter_map(|(dof, (joint, (&at, to)))| {
            let near = if is_arm(dof) { NEAR_ARM_RAD } else { NEAR_HAND_RAD };
            let away = (f64::from(at) - to).abs();
            (away > near && (is_arm(dof) || !is_holding))
                .then(|| format!("joint {:?} is {away:.2} rad away", joint.name))
        });
        match away.collect::<Vec<_>>() {
            away if away.is_empty() => Ok(()),
            away => {
                let reason =
                    frame.live.control.as_ref().map(|control| control.reason.as_str()).unwrap_or_default();
                Err(Not::Yet(format!("{} {reason}", away.join(", "))))
            }
        }
    };
    wait_for(hand, "the robot to be where the trial begins", arrived)?;
    wait_until(link, Instant::now() + REST);
    Ok(())
}

/// Limits of the safety layer may be a little tighter than where a world begins, or than what the stream rounds.
fn within_limits(station: &Station, positions: &[f64]) -> Vec<f64> {
    let joints = positions.iter().zip(&station.safety.joints);
    joints.map(|(at, limits)| at.clamp(limits.lower, limits.upper)).collect()
}

/// Why a frame is not as wanted.
enum Not {
    /// It may become so.
    Yet(String),
    /// It does not become so by itself.
    Ever(String),
}

/// Waits for a frame that is as wanted; `wanted` says what is not so yet.
fn wait_for(
    hand: &Hand<'_>,
    what: &str,
    wanted: impl Fn(&Frame) -> Result<(), Not>,
) -> anyhow::Result<Frame> {
    let Hand { link, cancel } = *hand;
    let begun = Instant::now();
    let (mut number, mut problem) = (0, "nothing was heard of the station".to_owned());
    loop {
        link.alive();
        if let Some(why) = link.ended() {
            bail!("{why}");
        }
        if cancel.is_cancelled() {
            bail!("stopped by Ctrl-C");
        }
        if let Some(frame) = link.frame_after(number, Duration::from_millis(20)) {
            number = frame.number;
            match wanted(&frame) {
                Ok(()) => return Ok(frame),
                Err(Not::Yet(why)) => problem = why,
                Err(Not::Ever(why)) => bail!("waited in vain for {what}: {why}"),
            }
        }
        if begun.elapsed() > PATIENCE {
            bail!("waited {} s in vain for {what}: {problem}", PATIENCE.as_secs());
        }
    }
}
