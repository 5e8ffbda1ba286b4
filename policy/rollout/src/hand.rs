//! The hand of a station under control: armed, moved, held, and waited for.

use std::cell::Cell;
use std::time::{Duration, Instant};

use anyhow::bail;
use palpate_robot_model::Station;
use palpate_sim::job::Cancel;
use palpate_wire::proto::{Arm, control_request::Request, control_state::Phase};

use crate::fit;
use crate::link::{Frame, Link};
use crate::trial::{targets, wait_until};

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
/// Joints that have arrived get this long to come to rest.
const REST: Duration = Duration::from_millis(500);

/// Control of the station, and whether somebody wants to stop.
#[derive(Clone, Copy)]
pub(crate) struct Hand<'a> {
    pub(crate) link: &'a Link,
    pub(crate) cancel: &'a Cancel,
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
pub(crate) fn following(hand: &Hand<'_>) -> anyhow::Result<()> {
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
pub(crate) fn arm(hand: &Hand<'_>) -> anyhow::Result<()> {
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
pub(crate) fn go(
    hand: &Hand<'_>,
    station: &Station,
    positions: &[f64],
    is_holding: bool,
) -> anyhow::Result<()> {
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
