//! One trial: a policy at its own rate until it has the object, time is up, or something ends it.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::{Duration, Instant};

use palpate_grasp::GraspConfig;
use palpate_messages::bits;
use palpate_robot_model::Station;
use palpate_sim::job::Cancel;
use palpate_wire::proto::{LiveFrame, Targets, control_request::Request};

use crate::inject::Injected;
use crate::link::{Frame, Link};
use crate::policy::{Policy, Seen, Step};
use crate::record::Record;
use crate::verdict::{Break, Suggestion, Watch, lost_device, not_following};

/// Without anything new of the station for so long, a policy would act on what is no longer so.
const STALE: Duration = Duration::from_millis(250);
/// So many targets in a row may be refused, which is half a second; a station that holds for a moment follows again.
const MOST_REFUSED: u32 = 10;

/// What trials share.
pub struct Setting<'a> {
    /// The station, as its studio has it.
    pub station: &'a Arc<Station>,
    /// The world file of its robot.
    pub world: &'a GraspConfig,
    /// Control of it.
    pub link: &'a Link,
    /// Says when somebody wants to stop.
    pub cancel: &'a Cancel,
    /// The policy is told that it feels nothing.
    pub is_silenced: bool,
    /// What goes wrong on purpose.
    pub inject: Option<Injected>,
}

/// What a trial came to.
#[derive(Clone, Debug)]
pub struct Ended {
    /// How the robot itself would count it.
    pub suggestion: Suggestion,
    /// Where all joints were when the hand was lowest.
    pub lowest: Vec<f64>,
    /// Somebody wants no further trial.
    pub is_cancelled: bool,
    /// Steps of the policy.
    pub steps: u64,
    /// Steps whose targets came after the next step was due.
    pub deadline_misses: u64,
    /// Steps that were left out because of that.
    pub skipped_steps: u64,
    /// Targets that the safety layer refused.
    pub refused: u64,
    /// How long the policy took for each plan, s.
    pub plan_s: Vec<f64>,
    /// Age of what a step acted on, s.
    pub age_s: Vec<f64>,
}

/// The request for all joints.
pub(crate) fn targets(positions: &[f64]) -> Request {
    let dofs = (0..positions.len() as u32).collect();
    Request::Targets(Targets { dofs, positions: positions.to_vec() })
}

/// What a policy may know of a frame, at `time_s` of its trial; `None` before every joint was seen.
pub fn seen(station: &Station, time_s: f64, live: &LiveFrame) -> Option<Seen> {
    let positions: Vec<f64> = live.joint_positions.iter().map(|&position| f64::from(position)).collect();
    let num_channels = station.layout.num_channels();
    let active = (0..num_channels).map(|channel| bits::get(&live.active, channel)).collect();
    (positions.len() == station.robot.num_dofs()).then_some(Seen { time_s, positions, active })
}

/// Runs a trial that begins now, the station armed and its joints told to be at `start`.
///
/// # Errors
/// A record that cannot be written. Everything that ends the trial is part of what it came to.
pub fn run(
    setting: &Setting<'_>,
    policy: &mut dyn Policy,
    start: &[f64],
    record: &mut Record,
) -> anyhow::Result<Ended> {
    let Setting { station, world, link, cancel, is_silenced, inject } = setting;
    let period = Duration::from_secs_f64(1.0 / world.control_rate_hz);
    let num_steps = (world.task.episode_s * world.control_rate_hz).round() as u64;
    let horizon = policy.horizon();
    let limits: Vec<(f64, f64)> =
        station.safety.joints.iter().map(|limits| (limits.lower, limits.upper)).collect();
    policy.begin(start);
    let mut watch = Watch::new(station, world);
    let mut ended = Ended {
        suggestion: watch.suggest(None),
        lowest: start.to_vec(),
        is_cancelled: false,
        steps: 0,
        deadline_misses: 0,
        skipped_steps: 0,
        refused: 0,
        plan_s: Vec::new(),
        age_s: Vec::new(),
    };
    let (mut history, mut planned): (VecDeque<Seen>, VecDeque<Step>) = (VecDeque::new(), VecDeque::new());
    let (mut step, mut refused_in_row, mut problem) = (0_u64, 0_u32, String::new());
    // What came before the trial is none of its business.
    drop((link.frames(), link.answers()));
    let begun = Instant::now();
    let broken = loop {
        let due = begun + period.mul_f64(step as f64);
        wait_until(link, due);
        link.alive();
        let mut has_it = false;
        for frame in link.frames() {
            let at_s = frame.received.saturating_duration_since(begun).as_secs_f64();
            let lowest_m = watch.lowest_m();
            has_it |= watch.look(station, at_s, &frame.live);
            if watch.lowest_m() < lowest_m {
                ended.lowest =
                    frame.live.joint_positions.iter().map(|&position| f64::from(position)).collect();
            }
            record.frame(&frame)?;
        }
        for answered in link.answers() {
            record.answer(&answered)?;
            refused_in_row = if answered.reply.accepted { 0 } else { refused_in_row + 1 };
            ended.refused += u64::from(!answered.reply.accepted);
            if !answered.reply.accepted {
                problem = answered.reply.problem;
            }
        }
        if let Some(why) = link.ended() {
            break Some(Break::Void(why));
        }
        let newest = link.newest();
        if let Some(why) = newest.as_ref().and_then(|frame| not_following(&frame.live)) {
            break Some(Break::Station(why));
        }
        if let Some(why) = newest.as_ref().and_then(|frame| lost_device(&frame.live)) {
            break Some(Break::Void(why));
        }
        if refused_in_row >= MOST_REFUSED {
            break Some(Break::Station(format!("the safety layer refused: {problem}")));
        }
        if cancel.is_cancelled() {
            ended.is_cancelled = true;
            break Some(Break::Void("stopped by Ctrl-C".to_owned()));
        }
        if has_it || step >= num_steps {
            break None;
        }
        let time_s = step as f64 / world.control_rate_hz;
        let now = Instant::now();
        let Some((frame, mut now_seen)) = fresh(newest, station, time_s, now) else {
            break Some(Break::Void(format!(
                "nothing new was heard of the station for {:.2} s",
                STALE.as_secs_f64()
            )));
        };
        ended.age_s.push(now.saturating_duration_since(frame.received).as_secs_f64());
        if *is_silenced {
            now_seen.active.fill(false);
        }
        history.push_back(now_seen);
        while history.len() > horizon.observations {
            history.pop_front();
        }
        if planned.is_empty() {
            match policy.plan(&history) {
                Ok(plan) => planned = plan.into_iter().take(horizon.executed.max(1)).collect(),
                Err(err) => break Some(Break::Station(format!("the policy failed: {err:#}"))),
            }
            ended.plan_s.push(now.elapsed().as_secs_f64());
        }
        let Some(mut wanted) = planned.pop_front() else {
            break Some(Break::Station("the policy planned nothing".to_owned()));
        };
        if let Some(inject) = inject {
            std::thread::sleep(inject.delay(time_s, period));
            inject.spoil(time_s, step, &limits, &mut wanted.targets);
        }
        let number = link.send(targets(&wanted.targets));
        let late_s = now.saturating_duration_since(due).as_secs_f64();
        if let Some(seen) = history.back() {
            record.step(number, late_s, &frame, seen, &wanted)?;
        }
        ended.steps += 1;
        // A step that comes too late is not made up for: time goes on for a script as for the object.
        let elapsed_steps = (begun.elapsed().as_secs_f64() * world.control_rate_hz).floor() as u64;
        if elapsed_steps > step {
            ended.deadline_misses += 1;
        }
        let next = elapsed_steps.max(step + 1);
        ended.skipped_steps += next - step - 1;
        step = next;
    };
    record.flush()?;
    ended.suggestion = watch.suggest(broken.as_ref());
    Ok(ended)
}

/// The newest frame and what a policy may know of it, unless it is too old.
fn fresh(newest: Option<Frame>, station: &Station, time_s: f64, now: Instant) -> Option<(Frame, Seen)> {
    let frame = newest.filter(|frame| now.saturating_duration_since(frame.received) <= STALE)?;
    let seen = seen(station, time_s, &frame.live)?;
    Some((frame, seen))
}

/// Sleeps until `due`, alive.
pub(crate) fn wait_until(link: &Link, due: Instant) {
    loop {
        link.alive();
        let left = due.saturating_duration_since(Instant::now());
        if left.is_zero() {
            return;
        }
        std::thread::sleep(left.min(Duration::from_millis(20)));
    }
}

/// Median and 99th percentile of `seconds`, ms.
pub(crate) fn median_and_p99_ms(seconds: &[f64]) -> [f64; 2] {
    let mut sorted = seconds.to_vec();
    sorted.sort_by(f64::total_cmp);
    let at = |share: f64| {
        let idx = (share * sorted.len().saturating_sub(1) as f64).round() as usize;
        sorted.get(idx).map_or(0.0, |seconds| 1e3 * seconds)
    };
    [at(0.5), at(0.99)]
}
