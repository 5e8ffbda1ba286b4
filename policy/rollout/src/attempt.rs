//! One attempt at a trial, from a station that is ready to what the trial came to.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::{Context as _, bail};
use palpate_robot_model::Station;
use palpate_wire::api::{TrialStart, TrialVerdict};
use serde_json::{Value, json};

use crate::fit::Fitted;
use crate::hand::{Hand, alive_while, arm, following, go, hold, still_there};
use crate::inject::Injected;
use crate::link::Link;
use crate::operator::Operator;
use crate::outcome::Outcome;
use crate::record::Record;
use crate::take::Recording;
use crate::trial::{self, Ended, Setting, median_and_p99_ms, wait_until};

/// Whether the object was placed is asked this often.
const LOOK_AGAIN: Duration = Duration::from_millis(300);

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
        () if holds("arm_has_hit") => TrialVerdict::EmergencyStop,
        // A step's rounding is no reason for another verdict.
        () if state["longest_held_s"].as_f64().unwrap_or_default() >= hold_s - 0.05 => TrialVerdict::Success,
        () if holds("lifted") => TrialVerdict::Slip,
        () => TrialVerdict::EmptyGrasp,
    };
    state["verdict"] = json!(verdict);
    Ok(state)
}

/// Asks the operator; heartbeats go on meanwhile.
fn ask_alive(link: &Link, operator: &mut Operator, request: &Value) -> anyhow::Result<Value> {
    alive_while(link, || operator.ask(request))
}

/// Asks a person at the keyboard to do what they are `told`; heartbeats go on meanwhile.
fn ask_person(link: &Link, told: &str) -> anyhow::Result<()> {
    eprintln!("rollout: {told}, and press Enter");
    alive_while(link, || match std::io::stdin().read_line(&mut String::new()) {
        Ok(1..) => Ok(()),
        _ => bail!("standard input has ended"),
    })
}
