//! A station, its studio and its operator, as tests of live stations need them.

use std::path::Path;

use anyhow::Context as _;
use e2e::{Bench, Operator, Studio, Tools, Turn, Watcher, beside_a_station, targets};
use palpate_wire::proto::{ControlState, RecordingStatus, control_state::Phase, device_status::Link};
use serde_json::{Value, json};

/// Devices, the studio on them, and an operator who has armed.
pub(crate) struct Scene {
    // Dropped in this order: nobody talks to what is gone.
    pub(crate) operator: Operator,
    pub(crate) watcher: Watcher,
    pub(crate) studio: Studio,
    pub(crate) data: tempfile::TempDir,
    pub(crate) bench: Bench,
}

impl Scene {
    /// A station with an operator who has armed it, beside another one.
    pub(crate) fn armed(tools: &Tools) -> anyhow::Result<Self> {
        Self::armed_with(beside_a_station(), |data, station| Studio::serve(tools, data, station))
    }

    /// The same with a studio that `serve` starts on a data folder, with the arguments that name the station.
    pub(crate) fn armed_with(
        turn: Turn,
        serve: impl FnOnce(&Path, Vec<String>) -> anyhow::Result<Studio>,
    ) -> anyhow::Result<Self> {
        let bench = Bench::start(turn)?;
        let data = tempfile::tempdir()?;
        let studio = serve(data.path(), bench.station_args())?;
        let watcher = Watcher::connect(&studio)?;
        watcher.wait_for("every device to be ready", all_ready)?;
        let mut operator = Operator::connect(&studio)?;
        operator.take_control("Ada")?;
        operator.arm(&watcher)?;
        Ok(Self { operator, watcher, studio, data, bench })
    }

    /// Kills the studio as when the machine loses its power, and starts another one on the same data, with an operator who
    /// has armed and goes on with the session.
    pub(crate) fn killed_and_started_again(self, tools: &Tools) -> anyhow::Result<Self> {
        let Self { operator, watcher, studio, data, bench } = self;
        studio.kill()?;
        drop((operator, watcher));
        let studio = Studio::serve(tools, data.path(), bench.station_args())?;
        let watcher = Watcher::connect(&studio)?;
        watcher.wait_for("every device to be ready", all_ready)?;
        let mut operator = Operator::connect(&studio)?;
        operator.take_control("Ada")?;
        operator.arm(&watcher)?;
        let scene = Self { operator, watcher, studio, data, bench };
        scene.begin_session()?;
        Ok(scene)
    }

    /// Starts a motion that would take seconds, to where there is room for it, and waits until it goes.
    pub(crate) fn set_in_motion(&self) -> anyhow::Result<()> {
        set_in_motion(&self.bench, &self.operator)
    }

    /// Begins the session `monday` of the short plan and puts its first object in place.
    pub(crate) fn begin_session(&self) -> anyhow::Result<()> {
        let document = self.studio.post_under(self.operator.lease(), "/recording", &session_request())?;
        let object = document["session"]["steps"][0]["object"].as_str().context("the step has no object")?;
        Ok(self.bench.control.place_object(Some(object))?)
    }

    /// Lets the first take of the session begin: its motion runs, and is recorded.
    ///
    /// `None` if the station held or disarmed meanwhile, which it must where the machine is too slow for it; else the
    /// station's own time at which the take began.
    pub(crate) fn begin_take(&self) -> anyhow::Result<Option<u64>> {
        let lease = self.operator.lease();
        let act = |action: Value| self.studio.post_under(lease, "/recording/act", &action);
        if self.watcher.wait_for("any state", |_| true)?.phase() != Phase::Armed {
            self.operator.arm(&self.watcher)?;
        }
        act(json!({ "action": "confirm_object", "fixture_trusted": true }))?;
        let begun = act(json!({ "action": "go_to_start" })).and_then(|_| {
            self.watcher.wait_for("at the start", |state| recording(state).phase == "start_pose")?;
            act(json!({ "action": "run" }))?;
            self.watcher.wait_for("begun", |state| recording(state).phase != "start_pose")?;
            Ok(self.bench.now_ns())
        });
        Ok(begun.ok())
    }

    /// Makes the first step of the session start over, whatever has become of its take.
    pub(crate) fn start_over(&self) -> anyhow::Result<()> {
        let lease = self.operator.lease();
        let act = |action: Value| self.studio.post_under(lease, "/recording/act", &action);
        self.watcher.wait_for("to start over", |state| {
            matches!(recording(state).phase.as_str(), "review" | "place_object" | "start_pose")
        })?;
        if recording(&self.watcher.wait_for("any state", |_| true)?).phase == "review" {
            self.watcher.wait_for("checked", |_| {
                let document = self.studio.get("/recording");
                document.is_ok_and(|document| !document["session"]["steps"][0]["verdict"].is_null())
            })?;
            act(json!({ "action": "again" }))?;
            self.watcher.wait_for("to start over after a take", |state| {
                matches!(recording(state).phase.as_str(), "place_object" | "start_pose")
            })?;
        }
        act(json!({ "action": "select", "step": 0 })).map(drop)
    }

    /// All joints, and those of the hand.
    pub(crate) fn dofs(&self) -> (Vec<usize>, Vec<usize>) {
        let station = self.bench.control.station();
        let all: Vec<usize> = (0..station.robot.num_dofs()).collect();
        let hand = all.iter().copied().filter(|dof| !station.carrier_dofs.contains(dof)).collect();
        (all, hand)
    }
}

/// Starts a motion that would take seconds, to where there is room for it, and waits until it goes.
pub(crate) fn set_in_motion(bench: &Bench, operator: &Operator) -> anyhow::Result<()> {
    let wanted = far_targets(bench)?;
    bench.control.log_motion(60_000);
    operator.must(targets(&wanted))?;
    let arm = wanted[0].0;
    bench.wait_until("moving", |now| now.velocities[arm].abs() > 0.3)?;
    Ok(())
}

/// Where there is room for joints of the arm and of the hand, and where they get to only after seconds, or a good part of
/// one; the arm's is the first.
pub(crate) fn far_targets(bench: &Bench) -> anyhow::Result<Vec<(usize, f64)>> {
    let now = bench.control.snapshot().positions;
    let joints: Vec<_> = bench.control.station().robot.dofs().collect();
    let wanted = [("joint1", 1.5), ("index_pip", 1.0), ("middle_mcp_forward", 1.0)].map(|(joint, by)| {
        let dof = bench.dof(joint)?;
        let highest = joints[dof].limits.map_or(f64::INFINITY, |limits| limits.upper);
        Ok((dof, if now[dof] + by < highest { now[dof] + by } else { now[dof] - by }))
    });
    wanted.into_iter().collect()
}

/// Whether every device is there and works.
pub(crate) fn all_ready(state: &ControlState) -> bool {
    !state.devices.is_empty() && state.devices.iter().all(|device| device.link() == Link::Ready)
}

/// What the station says of the recording.
pub(crate) fn recording(state: &ControlState) -> RecordingStatus {
    state.recording.clone().unwrap_or_default()
}

/// Begins or resumes the session that these tests record.
pub(crate) fn session_request() -> Value {
    json!({ "plan": "quick_check", "session": "monday", "operator": "Ada" })
}

/// The arguments of a device's fault.
pub(crate) fn fault(kind: &str, device: &str, more: &str) -> String {
    format!("[[fault]]\nkind = \"{kind}\"\ndevice = \"{device}\"\n{more}\n")
}
