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
use palpate_wire::proto::{Arm, Reflex, control_request::Request, control_state::Phase};
use serde::Serialize;
use serde_json::{Value, json};

use crate::fit::{self, FitArgs, Fitted};
use crate::inject::Injected;
use crate::link::{Frame, Link};
use crate::operator::Operator;
use crate::record::Record;
use crate::trial::{self, Ended, Setting, targets, wait_until};
use crate::verdict::Verdict;

/// Devices are there, the station is armed, or joints are where they are sent, after this long at the latest.
const PATIENCE: Duration = Duration::from_secs(30);
/// A joint of the hand that is this near has arrived, rad: soft servos carry the fingers' weight.
const NEAR_HAND_RAD: f64 = 0.12;
/// A joint of the arm, rad.
const NEAR_ARM_RAD: f64 = 0.02;
/// Targets of a motion to the start are told again this often.
const TELL_AGAIN: Duration = Duration::from_millis(500);
/// Joints that have arrived get this long to come to rest.
const REST: Duration = Duration::from_millis(500);

/// Trials of a policy on the hand that a studio drives.
#[derive(Clone, Debug, clap::Args)]
pub struct RolloutArgs {
    /// Address of the studio, as `palpate serve` prints it
    #[arg(long, default_value = "http://127.0.0.1:8080")]
    url: String,
    #[command(flatten)]
    fit: FitArgs,
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
    /// Folder for the records of the trials and `outcomes.jsonl`; it must be new or empty
    #[arg(long)]
    out: PathBuf,
    /// Socket of the operator of `palpate-train station`, who places objects and sees what became of them
    #[arg(long, value_name = "SOCKET")]
    operator: Option<PathBuf>,
    /// The object lies there already: nobody is asked to place it
    #[arg(long, conflicts_with = "operator")]
    placed: bool,
    /// Who has control meanwhile, for everybody else's page
    #[arg(long, default_value = "rollout")]
    name: String,
    /// Take control from whoever has it
    #[arg(long)]
    take_over: bool,
    /// Switch the studio's reflex of the digits on for the rollout, as this file has it (`docs/reflex.md`)
    #[arg(long, value_name = "FILE")]
    reflex: Option<PathBuf>,
    /// A fault on purpose: nan, jumps, slow or hang, and when in each trial, s
    #[arg(long, value_name = "KIND=S")]
    inject: Option<Injected>,
    /// A line of JSON for each trial on standard output
    #[arg(long)]
    json: bool,
}

/// What a trial came to: a line of `outcomes.jsonl`. `docs/rollouts.md` explains the fields; they stay.
#[derive(Clone, Debug, Serialize)]
pub struct Outcome {
    /// Its number.
    pub trial: u64,
    /// Id of the object.
    pub object: String,
    /// What moved the hand.
    pub policy: String,
    /// How the trial began: seed, trial and half width of the starts; `null` where a person placed the object.
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
    let asks = args.operator.is_none() && !args.placed;
    if asks && !std::io::stdin().is_terminal() {
        bail!("nobody is there to place the object: give --operator, or --placed if it lies there already");
    }
    let mut fitted = fit::fit(&args.url, &args.fit)?;
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
    let link = Link::connect(&args.url, &args.name, args.take_over)?;
    // The reflex ends with the lease.
    let reflex = reflex.map(|config_toml| Request::Reflex(Reflex { on: true, config_toml }));
    let done = reflex
        .map_or(Ok(()), |reflex| link.must("switching the reflex on", reflex).map(drop))
        .and_then(|()| trials(args, &mut fitted, &link, operator.as_mut(), &cancel));
    hold(&link, &fitted.station);
    link.release();
    done
}

fn trials(
    args: &RolloutArgs,
    fitted: &mut Fitted,
    link: &Link,
    mut operator: Option<&mut Operator>,
    cancel: &Cancel,
) -> anyhow::Result<()> {
    let frame =
        wait_for(link, "the devices to be ready", cancel, |frame| match fit::not_ready(&frame.live) {
            None => Ok(()),
            Some(problem) => Err(problem),
        })?;
    if frame.live.control.as_ref().is_some_and(|control| control.phase() == Phase::Stopped) {
        bail!("the station is stopped; reset the stop at the studio's page first");
    }
    let file = args.out.join("outcomes.jsonl");
    let mut lines = std::fs::File::create(&file).with_context(|| format!("failed to make {file:?}"))?;
    for trial in args.first..args.first + args.trials {
        let outcome = one(args, fitted, link, operator.as_deref_mut(), cancel, trial);
        let (outcome, is_cancelled) = match outcome {
            Err(_) if cancel.is_cancelled() => break,
            other => other?,
        };
        let line = serde_json::to_string(&outcome)?;
        std::io::Write::write_all(&mut lines, format!("{line}\n").as_bytes())
            .with_context(|| format!("failed to write {file:?}"))?;
        if args.json {
            println!("{line}");
        } else {
            println!("trial {trial}: {:?}: {}", outcome.suggested, outcome.reasons.join("; "));
        }
        if is_cancelled || link.ended().is_some() {
            break;
        }
    }
    Ok(())
}

/// One trial, from wherever the robot is; whether somebody wants no further one.
fn one(
    args: &RolloutArgs,
    fitted: &mut Fitted,
    link: &Link,
    operator: Option<&mut Operator>,
    cancel: &Cancel,
    trial: u64,
) -> anyhow::Result<(Outcome, bool)> {
    let station = Arc::clone(&fitted.station);
    let waits = fitted.world.start_positions(&station.robot);
    arm(link, cancel)?;
    go(link, cancel, &station, &waits, false)?;
    let mut start = Value::Null;
    let mut begins = waits;
    let mut operator = operator;
    if let Some(operator) = operator.as_deref_mut() {
        let mut request =
            json!({ "act": "start", "object": args.fit.object, "seed": args.seed, "trial": trial });
        if let Some(start_cm) = args.start_cm {
            request["start_cm"] = json!(start_cm);
        }
        let placed = ask_alive(link, operator, &request).context("the object was not placed")?;
        let positions: BTreeMap<String, f64> =
            serde_json::from_value(placed["start"].clone()).context("the operator told no start")?;
        for (at, joint) in begins.iter_mut().zip(station.robot.dofs()) {
            *at = positions.get(&joint.name).copied().unwrap_or(*at);
        }
        let object_pose = &placed["object_pose"];
        start = json!({
            "seed": args.seed, "trial": trial, "start_cm": args.start_cm, "object_pose": object_pose,
        });
        go(link, cancel, &station, &begins, false)?;
    } else if !args.placed {
        ask_person(link, &fitted.object, trial)?;
    }
    let path = args.out.join(format!("trial-{trial:04}.jsonl"));
    let head = json!({
        "trial": trial, "object": fitted.object, "policy": fitted.policy_name, "start": start,
        "station": station.id, "files": fitted.sources, "control_rate_hz": fitted.world.control_rate_hz,
        "joints": station.robot.dofs().map(|joint| joint.name.as_str()).collect::<Vec<_>>(),
        "channels": station.layout.channels.iter().map(|channel| channel.id.as_str()).collect::<Vec<_>>(),
        "begins_at": begins,
    });
    let mut record = Record::create(&path, station.layout.num_channels(), &head)?;
    let setting = Setting { station: &station, world: &fitted.world, link, cancel, inject: args.inject };
    let ended = trial::run(&setting, &mut *fitted.policy, &begins, &mut record)?;
    let truth = operator.map(|operator| truth(link, operator, &fitted.world.task.hold_s)).transpose();
    let truth =
        truth.unwrap_or_else(|err| Some(json!({ "problem": format!("{err:#}") }))).unwrap_or_default();
    let outcome = outcome(trial, fitted, &path, start, truth, &ended);
    record.outcome(&outcome)?;
    hold(link, &station);
    if ended.suggestion.held_s > 0.0 && link.ended().is_none() && !ended.is_cancelled {
        // What was lifted is put down before the hand opens.
        let _ = go(link, cancel, &station, &put_down(link, &station, &ended.lowest), true);
    }
    Ok((outcome, ended.is_cancelled))
}

/// The arm where the hand was lowest, the hand as it is told to be.
fn put_down(link: &Link, station: &Station, lowest: &[f64]) -> Vec<f64> {
    let commanded = link.newest().and_then(|frame| frame.live.control.clone()).unwrap_or_default().commanded;
    let mut down: Vec<f64> = commanded.into_iter().map(f64::from).collect();
    down.resize(lowest.len(), 0.0);
    for &dof in &station.carrier_dofs {
        down[dof] = lowest[dof];
    }
    down
}

fn outcome(trial: u64, fitted: &Fitted, path: &Path, start: Value, truth: Value, ended: &Ended) -> Outcome {
    let suggestion = ended.suggestion.clone();
    Outcome {
        trial,
        object: fitted.object.clone(),
        policy: fitted.policy_name.clone(),
        start,
        suggested: suggestion.verdict,
        reasons: suggestion.reasons,
        time_to_grasp_s: suggestion.time_to_grasp_s,
        held_s: suggestion.held_s,
        take: path.display().to_string(),
        truth,
        steps: ended.steps,
        deadline_misses: ended.deadline_misses,
        skipped_steps: ended.skipped_steps,
        refused: ended.refused,
        plan_ms: median_and_p99_ms(&ended.plan_s),
        age_ms: median_and_p99_ms(&ended.age_s),
    }
}

fn median_and_p99_ms(seconds: &[f64]) -> [f64; 2] {
    let mut sorted = seconds.to_vec();
    sorted.sort_by(f64::total_cmp);
    let at = |share: f64| {
        let idx = (share * sorted.len().saturating_sub(1) as f64).round() as usize;
        sorted.get(idx).map_or(0.0, |seconds| 1e3 * seconds)
    };
    [at(0.5), at(0.99)]
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
    std::thread::scope(|scope| {
        let asked = scope.spawn(move || operator.ask(request));
        while !asked.is_finished() {
            link.alive();
            std::thread::sleep(Duration::from_millis(5));
        }
        asked.join().unwrap_or_else(|_| bail!("asking the operator failed"))
    })
}

/// Asks a person at the keyboard to place the object; heartbeats go on meanwhile.
fn ask_person(link: &Link, object: &str, trial: u64) -> anyhow::Result<()> {
    eprintln!("rollout: trial {trial}: place the object {object:?} and press Enter");
    std::thread::scope(|scope| {
        let asked = scope.spawn(|| std::io::stdin().read_line(&mut String::new()));
        while !asked.is_finished() {
            link.alive();
            std::thread::sleep(Duration::from_millis(5));
        }
        match asked.join() {
            Ok(Ok(1..)) => Ok(()),
            _ => bail!("standard input has ended"),
        }
    })
}

/// Joints stay where they are told to be now.
fn hold(link: &Link, station: &Station) {
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

fn arm(link: &Link, cancel: &Cancel) -> anyhow::Result<()> {
    let is_armed = |frame: &Frame| match frame.live.control.as_ref().map(|control| control.phase()) {
        Some(Phase::Armed) => Ok(()),
        _ => Err(frame.live.control.as_ref().map(|control| control.reason.clone()).unwrap_or_default()),
    };
    if link.newest().is_none_or(|frame| is_armed(&frame).is_err()) {
        link.must("arming", Request::Arm(Arm {}))?;
    }
    wait_for(link, "the station to be armed", cancel, is_armed).map(drop)
}

/// Moves all joints to `positions`, and waits until they are there, or until those of the arm are where the hand holds
/// something that keeps its own from it.
fn go(
    link: &Link,
    cancel: &Cancel,
    station: &Station,
    positions: &[f64],
    is_holding: bool,
) -> anyhow::Result<()> {
    let is_arm = |dof: usize| station.carrier_dofs.contains(&dof);
    let wanted = within_limits(station, positions);
    link.must("a motion to the start", targets(&wanted))?;
    let told = Cell::new(Instant::now());
    let arrived = |frame: &Frame| {
        if told.get().elapsed() >= TELL_AGAIN {
            // The station forgets targets when it holds.
            told.set(Instant::now());
            link.send(targets(&wanted));
        }
        if let Some(why) = crate::verdict::not_following(&frame.live) {
            return Err(why);
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
                Err(format!("{} {reason}", away.join(", ")))
            }
        }
    };
    wait_for(link, "the robot to be where the trial begins", cancel, arrived)?;
    wait_until(link, Instant::now() + REST);
    Ok(())
}

/// Limits of the safety layer may be a little tighter than where a world begins, or than what the stream rounds.
fn within_limits(station: &Station, positions: &[f64]) -> Vec<f64> {
    let joints = positions.iter().zip(&station.safety.joints);
    joints.map(|(at, limits)| at.clamp(limits.lower, limits.upper)).collect()
}

/// Waits for a frame that is as wanted; `wanted` says what is not so yet.
fn wait_for(
    link: &Link,
    what: &str,
    cancel: &Cancel,
    wanted: impl Fn(&Frame) -> Result<(), String>,
) -> anyhow::Result<Frame> {
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
                Err(why) => problem = why,
            }
        }
        if begun.elapsed() > PATIENCE {
            bail!("waited {} s in vain for {what}: {problem}", PATIENCE.as_secs());
        }
    }
}
