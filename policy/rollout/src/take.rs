//! `--record`: each trial becomes a take of the studio, at the devices' own rates, with where the object was.
//!
//! The object's pose is asked of an emulated station's operator on a thread and a connection of its own. The policy sees
//! nothing of it, and that thread stands behind nothing that moves: a policy that hangs brakes the hand all the same.

use std::path::PathBuf;
use std::str::FromStr;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Context as _, bail};
use palpate_grasp::GraspConfig;
use palpate_sim::body::Solid;
use palpate_wire::api::{FreeTake, FreeTakeState, RecordingDocument, TrialStart};
use palpate_wire::proto::{ObjectPose, control_request::Request};
use serde::Serialize;
use serde_json::{Value, json};

use crate::fit::Fitted;
use crate::hand::{Hand, alive_while};
use crate::link::Link;
use crate::operator::Operator;
use crate::studio::Studio;
use crate::trial::wait_until;

/// What a take's metadata has as its primitive.
const PRIMITIVE: &str = "rollout";
/// The hand stands still for so long before the policy begins: the zero of all channels comes from it.
const BASELINE: Duration = Duration::from_secs(1);
/// The object's pose is asked for this often.
const POSE_PERIOD: Duration = Duration::from_millis(50);
/// Of a take that is over the studio is asked this often,
const LOOK_AGAIN: Duration = Duration::from_millis(50);
/// and for so long at most: it reads the take back and checks it.
const CHECKED: Duration = Duration::from_secs(30);

/// What `--record` and what belongs to it say.
#[derive(Clone, Debug, Default, clap::Args)]
pub(crate) struct RecordArgs {
    /// Record each trial as a take of this session of the studio, which is made if there is none (`docs/rollouts.md`)
    #[arg(long, value_name = "SESSION")]
    record: Option<String>,
    /// With --record and without --operator: where the object stands, from the robot's base: x,y,z in m, then its quaternion
    /// w,x,y,z (as the base's without)
    #[arg(long, value_name = "NUMBERS", requires = "record", conflicts_with = "operator")]
    object_pose: Option<Pose>,
    /// A fixture holds the object where --object-pose says, so that nothing can move it
    #[arg(long, requires = "object_pose")]
    fixture: bool,
}

/// Position, m, and quaternion, w first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Pose([f64; 7]);

impl FromStr for Pose {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let expected = || format!("{text:?}, expected x,y,z or x,y,z,w,x,y,z with a quaternion of length 1");
        let numbers: Result<Vec<f64>, _> = text.split(',').map(|word| word.trim().parse::<f64>()).collect();
        let mut numbers = numbers.map_err(|_| expected())?;
        if numbers.len() == 3 {
            numbers.extend([1.0, 0.0, 0.0, 0.0]);
        }
        let pose: [f64; 7] = numbers.try_into().map_err(|_| expected())?;
        let norm = pose[3..].iter().map(|part| part * part).sum::<f64>().sqrt();
        let is_pose = pose.iter().all(|number| number.is_finite()) && (norm - 1.0).abs() <= 1e-3;
        is_pose.then_some(Self(pose)).ok_or_else(expected)
    }
}

/// Where the takes of a rollout's trials go.
#[derive(Clone, Debug)]
pub(crate) struct Recording {
    studio: Studio,
    session: String,
    /// Name of whoever has control.
    name: String,
    object: Object,
}

/// How it is known where the object is.
#[derive(Clone, Debug)]
enum Object {
    /// The operator of an emulated station knows at any time.
    Followed(PathBuf),
    /// It is known where it begins, and whether a fixture keeps it there.
    Stated { pose: Pose, is_fixed: bool },
    /// Somebody places it where the plan of a campaign has it; nobody measures where it is.
    Planned,
}

/// The take that a trial became, as its outcome has it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Recorded {
    /// Session of the studio.
    pub session: String,
    /// Id of the take; `null` where there is none.
    pub take: Option<String>,
    /// Poses of the object that were sent to the studio.
    pub object_poses: u64,
    /// What is wrong with it, in words; empty when all is well.
    pub problems: Vec<String>,
}

impl Recording {
    /// What the arguments ask for. Asks the studio whether it could record now. `is_planned`: somebody places each object where
    /// the plan of a campaign has it.
    ///
    /// # Errors
    /// An object of which nobody knows where it is; a studio that records something else.
    pub(crate) fn new(
        args: &RecordArgs,
        studio: &Studio,
        operator: Option<&PathBuf>,
        is_planned: bool,
        name: &str,
    ) -> anyhow::Result<Option<Self>> {
        let Some(session) = args.record.clone() else { return Ok(None) };
        let object = match (operator, args.object_pose) {
            (Some(socket), _) => Object::Followed(socket.clone()),
            (None, Some(pose)) => Object::Stated { pose, is_fixed: args.fixture },
            (None, None) if is_planned => Object::Planned,
            (None, None) => bail!(
                "--record needs to know where the object is: give --operator of an emulated station, or --object-pose"
            ),
        };
        let document: RecordingDocument =
            studio.get("/recording").context("the studio does not say what it records")?;
        if let Some(running) = document.session {
            bail!("--record: the guided session {:?} is under way; leave it first", running.session);
        }
        Ok(Some(Self { studio: studio.clone(), session, name: name.to_owned(), object }))
    }

    /// Begins the take of a trial that is about to begin, with the object at `placed` (as an operator says), or where a campaign
    /// has it. The hand stands still meanwhile.
    pub(crate) fn begin(
        &self,
        hand: &Hand<'_>,
        fitted: &Fitted,
        placed: &Value,
        planned: Option<&TrialStart>,
    ) -> anyhow::Result<Take<'_>> {
        let link = hand.link;
        // A connection of its own: the other one is the trial's.
        let (operator, object_pose, is_trusted) = match &self.object {
            Object::Followed(socket) => (Some(Operator::connect(socket)?), placed.clone(), true),
            Object::Stated { pose, is_fixed } => (None, json!(pose.0), *is_fixed),
            Object::Planned => {
                let start = planned.context("--record: only a campaign says where the object is placed")?;
                (None, json!(planned_pose(fitted, start)?), false)
            }
        };
        let start = json!({
            "session": self.session, "object": fitted.object, "object_pose": object_pose, "primitive": PRIMITIVE,
            "fixture_trusted": is_trusted, "operator": self.name, "surroundings": [table(&fitted.world)],
        });
        let (studio, lease) = (&self.studio, link.lease());
        let begun: RecordingDocument =
            alive_while(link, || Ok(studio.post_as(lease, "/recording/take", &start)?))
                .context("--record: the take was not begun")?;
        drop(begun);
        Ok(Take { recording: self, operator, sent: 0, problem: None })
    }
}

/// Where the plan of a campaign has the object: x y z, m, then the quaternion, w first.
fn planned_pose(fitted: &Fitted, start: &TrialStart) -> anyhow::Result<[f64; 7]> {
    let solid = Solid::new(&fitted.object_model.shape).map_err(anyhow::Error::msg)?;
    let rest_poses = solid.rest_poses().map_err(anyhow::Error::msg)?;
    let pose = fitted.world.on_table(&rest_poses, start.side, [start.x_m, start.y_m], start.yaw_rad);
    let (at, turned) = (pose.translation.vector, pose.rotation);
    Ok([at.x, at.y, at.z, turned.w, turned.i, turned.j, turned.k])
}

/// The table of the grasp world, as the studio has boxes.
fn table(world: &GraspConfig) -> Value {
    let table = &world.table;
    let middle_m = table.top_m - 0.5 * table.size_m[2];
    json!({ "pose": [table.center_m[0], table.center_m[1], middle_m, 1.0, 0.0, 0.0, 0.0], "size_m": table.size_m })
}

/// A take that is being recorded.
pub(crate) struct Take<'a> {
    recording: &'a Recording,
    operator: Option<Operator>,
    sent: u64,
    problem: Option<String>,
}

impl Take<'_> {
    /// Does `trial` once the hand has stood still for the zero, while the studio is told where the object is.
    pub(crate) fn during<T>(&mut self, link: &Link, trial: impl FnOnce() -> T) -> T {
        let is_over = &AtomicBool::new(false);
        let Self { operator, sent, problem, .. } = self;
        std::thread::scope(|scope| {
            let follows =
                operator.as_mut().map(|operator| scope.spawn(move || follow(link, operator, is_over)));
            wait_until(link, Instant::now() + BASELINE);
            let ended = trial();
            is_over.store(true, Ordering::Relaxed);
            if let Some(follows) = follows {
                // It waits for one answer of the operator at most, which comes at once.
                let (num_sent, stopped) = follows.join().unwrap_or_else(|_| {
                    (0, Err(anyhow::anyhow!("the thread that follows the object failed")))
                });
                *sent = num_sent;
                *problem =
                    stopped.err().map(|err| format!("the object was not followed to the end: {err:#}"));
            }
            ended
        })
    }

    /// Ends the take and waits for its check.
    pub(crate) fn end(self, link: &Link) -> Recorded {
        let Self { recording: Recording { studio, session, .. }, sent, problem, .. } = self;
        let lease = link.lease();
        let ended = alive_while(link, || {
            // A take that the studio has ended by itself is refused here, and found below.
            let _refused = studio.post_as::<Value>(lease, "/recording/take/act", &json!({ "action": "end" }));
            checked(studio)
        });
        let mut problems: Vec<String> = problem.into_iter().collect();
        problems.extend(link.refused_poses());
        let take = match ended {
            Ok(free) => {
                let is_kept = free.state == FreeTakeState::Accepted;
                let found = free.verdict.map(|verdict| verdict.problems).unwrap_or_default();
                // The check says why a take ended early, where there is one.
                let is_said = found.iter().any(|problem| problem.contains(&free.problem));
                problems.extend((!is_said && !free.problem.is_empty()).then_some(free.problem));
                problems.extend(found);
                free.take.filter(|_| is_kept)
            }
            Err(err) => {
                problems.push(format!("{err:#}"));
                None
            }
        };
        Recorded { session: session.clone(), take, object_poses: sent, problems }
    }
}

/// The newest take outside guided sessions, once the studio is through with it.
fn checked(studio: &Studio) -> anyhow::Result<FreeTake> {
    let begun = Instant::now();
    loop {
        let document: RecordingDocument = studio.get("/recording")?;
        match document.free {
            Some(free) if !matches!(free.state, FreeTakeState::Recording | FreeTakeState::Checking) => {
                return Ok(free);
            }
            Some(_) if begun.elapsed() < CHECKED => std::thread::sleep(LOOK_AGAIN),
            Some(_) => bail!("the studio did not end the take within {} s", CHECKED.as_secs()),
            None => bail!("the studio knows of no take; was it started again?"),
        }
    }
}

/// Tells the studio where the object is until `is_over`; gives how often, and why it stopped before.
fn follow(link: &Link, operator: &mut Operator, is_over: &AtomicBool) -> (u64, anyhow::Result<()>) {
    let mut num_sent = 0;
    let mut due = Instant::now();
    loop {
        // Asked first: the last pose is of the end.
        let is_last = is_over.load(Ordering::Relaxed);
        let asked = Instant::now();
        let pose = match operator.ask(&json!({ "act": "state" })).and_then(|state| pose_of(&state)) {
            Ok(pose) => pose,
            Err(err) => return (num_sent, Err(err)),
        };
        // Halfway between question and answer.
        let seen = asked + asked.elapsed() / 2;
        let time_s = link.station_time_s(seen).unwrap_or_default();
        if link.ended().is_none() {
            let (position_m, quaternion_wxyz) = (pose[..3].to_vec(), pose[3..].to_vec());
            link.tell_pose(Request::ObjectPose(ObjectPose { position_m, quaternion_wxyz, time_s }));
            num_sent += 1;
        }
        if is_last {
            return (num_sent, Ok(()));
        }
        due = (due + POSE_PERIOD).max(Instant::now());
        while Instant::now() < due && !is_over.load(Ordering::Relaxed) {
            std::thread::sleep(due.saturating_duration_since(Instant::now()).min(Duration::from_millis(10)));
        }
    }
}

fn pose_of(state: &Value) -> anyhow::Result<[f64; 7]> {
    serde_json::from_value(state["object_pose"].clone())
        .context("the station's operator does not say where the object is")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pose_is_read_and_what_is_none_is_refused() {
        assert_eq!("0.4, 0, 0.03".parse(), Ok(Pose([0.4, 0.0, 0.03, 1.0, 0.0, 0.0, 0.0])));
        assert_eq!("0.4,0,0.03,0,0,0,1".parse(), Ok(Pose([0.4, 0.0, 0.03, 0.0, 0.0, 0.0, 1.0])));
        for wrong in ["", "0.4,0", "0.4,0,x", "0.4,0,nan", "0.4,0,0.03,0,0,0,0.5", "0.4,0,0.03,1,0,0,0,0"] {
            let said = wrong.parse::<Pose>().expect_err(wrong);
            assert!(said.contains("expected x,y,z"), "{wrong}: {said}");
        }
    }
}
