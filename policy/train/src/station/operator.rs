//! What a person does beside a station, over a Unix socket: lines of JSON, each answered by one.

use std::collections::BTreeMap;
use std::io::{BufRead as _, BufReader, Write as _};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use anyhow::{Context as _, bail};
use palpate_emulator::{FeltObject, StationControl};
use palpate_grasp::touch::NoTouch;
use palpate_grasp::{GraspConfig, GraspScene, Start};
use palpate_robot_model::{ObjectModel, Station};
use palpate_truth::TruthSense;
use serde::Deserialize;
use serde_json::{Value, json};

use super::physics::{Placement, Shared};
use crate::files::{self, Sources};

/// Name of the socket in the folder of the devices.
const SOCKET: &str = "operator.sock";
/// Steps of the bodies, s: those of the emulated servos.
const STEP_S: f64 = 1e-3;
/// A request is no longer than this, bytes.
const MAX_REQUEST: u64 = 4096;
/// Two things may be this deep in each other where an object is placed, m: what soft contacts leave.
const MOST_DEEP_M: f64 = 0.002;

/// What can be asked for.
#[derive(Deserialize)]
#[serde(tag = "act", rename_all = "snake_case", deny_unknown_fields)]
enum Request {
    /// Where the object is and what has become of it.
    State {},
    /// Puts an object on the table.
    Place {
        /// Another object than the present one.
        object: Option<String>,
        /// From the middle of the region, m.
        #[serde(default)]
        offset_m: [f64; 2],
        /// About the vertical, rad.
        #[serde(default)]
        yaw_rad: f64,
        /// Which stable side it lies on: 0 to 1, by how likely they are.
        #[serde(default)]
        side: f64,
        /// Draws the physics and the noise on where the hand begins; the nominal world without one.
        seed: Option<u64>,
    },
    /// Puts it where a trial of the grasp world begins, in that trial's physics.
    Start {
        object: Option<String>,
        seed: u64,
        trial: u64,
        /// Half the edge of the region, cm.
        start_cm: Option<f64>,
    },
    /// Does the last of these two again.
    Reset {},
}

/// Objects that can be placed.
pub(super) struct Objects {
    station: Arc<Station>,
    config: GraspConfig,
    sense: TruthSense,
    scenes: BTreeMap<String, (Arc<GraspScene>, FeltObject)>,
    present: String,
    last: Option<Start>,
}

impl Objects {
    pub(super) fn new(station: Arc<Station>, config: GraspConfig, sense: TruthSense) -> Self {
        Self { station, config, sense, scenes: BTreeMap::new(), present: String::new(), last: None }
    }

    /// `object` in the middle of the region.
    pub(super) fn nominal(&mut self, object: &ObjectModel) -> anyhow::Result<Placement> {
        self.add(object)?;
        self.at(&|scene| Start::nominal(scene))
    }

    fn add(&mut self, object: &ObjectModel) -> anyhow::Result<()> {
        let scene = GraspScene::new(Arc::clone(&self.station), self.config.clone(), object, &NoTouch)?;
        let felt = FeltObject::new(&self.sense, object)?;
        self.present.clone_from(&object.id);
        self.scenes.insert(object.id.clone(), (Arc::new(scene), felt));
        Ok(())
    }

    /// Chooses another object.
    fn choose(&mut self, object: Option<&str>) -> anyhow::Result<()> {
        let Some(name) = object.filter(|name| *name != self.present) else { return Ok(()) };
        if self.scenes.contains_key(name) {
            name.clone_into(&mut self.present);
            return Ok(());
        }
        let object = files::object(name, &Sources::default())?;
        self.add(&object)
    }

    fn at(&mut self, start: &dyn Fn(&GraspScene) -> Start) -> anyhow::Result<Placement> {
        let (scene, felt) = self.scenes.get(&self.present).context("there is no object")?;
        let start = start(scene);
        let world = scene.driven_world(&start, STEP_S)?;
        self.last = Some(start);
        Ok(Placement { world, felt: felt.clone() })
    }
}

/// The socket; its file goes when this is dropped.
pub(super) struct Operator {
    path: PathBuf,
}

impl Operator {
    /// Answers everybody on a thread of their own.
    pub(super) fn listen(
        dir: &Path,
        objects: Objects,
        shared: Arc<Shared>,
        control: StationControl,
    ) -> anyhow::Result<Self> {
        let path = dir.join(SOCKET);
        // One that a killed station left behind answers nobody.
        if UnixStream::connect(&path).is_ok() {
            bail!("another station runs in {dir:?}; end it or choose another folder");
        }
        if path.exists() {
            std::fs::remove_file(&path).with_context(|| format!("failed to remove {path:?}"))?;
        }
        let listener =
            UnixListener::bind(&path).with_context(|| format!("failed to make the socket {path:?}"))?;
        let objects = Arc::new(Mutex::new(objects));
        // Somebody who follows the object must not keep others from placing it.
        let answer = move || {
            for client in listener.incoming() {
                let (objects, shared, control) = (Arc::clone(&objects), Arc::clone(&shared), control.clone());
                // One who leaves in the middle of a line hurts nobody else.
                let talk = move |client: UnixStream| drop(converse(&client, &objects, &shared, &control));
                let begun = client.and_then(|client| {
                    std::thread::Builder::new().name("operator".to_owned()).spawn(move || talk(client))
                });
                if let Err(err) = begun {
                    eprintln!("palpate-train: the operator's socket failed: {err}");
                }
            }
        };
        std::thread::Builder::new().name("operator".to_owned()).spawn(answer)?;
        Ok(Self { path })
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }
}

impl Drop for Operator {
    fn drop(&mut self) {
        // Whoever looks for it finds nobody either way.
        let _ = std::fs::remove_file(&self.path);
    }
}

fn converse(
    client: &UnixStream,
    objects: &Mutex<Objects>,
    shared: &Shared,
    control: &StationControl,
) -> std::io::Result<()> {
    use std::io::Read as _;

    let mut lines = BufReader::new(client);
    loop {
        let mut line = String::new();
        if lines.by_ref().take(MAX_REQUEST).read_line(&mut line)? == 0 {
            return Ok(());
        }
        let reply = match serde_json::from_str(&line) {
            Err(err) => Err(anyhow::anyhow!("not a request: {err}")),
            Ok(request) => act(request, objects, shared, control),
        };
        let reply = reply.unwrap_or_else(|err| json!({ "ok": false, "problem": format!("{err:#}") }));
        let mut client = client;
        writeln!(client, "{reply}")?;
    }
}

fn act(
    request: Request,
    objects: &Mutex<Objects>,
    shared: &Shared,
    control: &StationControl,
) -> anyhow::Result<Value> {
    // Whoever placed an object before and failed has left whole statements behind.
    let objects = &mut *objects.lock().unwrap_or_else(PoisonError::into_inner);
    let placement = match request {
        Request::State {} => return Ok(state(shared, control)),
        Request::Place { object, offset_m, yaw_rad, side, seed } => {
            if ![offset_m[0], offset_m[1], yaw_rad].iter().all(|value| value.is_finite()) {
                bail!("offset_m is {offset_m:?} and yaw_rad {yaw_rad}, expected finite numbers");
            }
            if !(0.0..=1.0).contains(&side) {
                bail!("side is {side}, expected 0 to 1");
            }
            objects.choose(object.as_deref())?;
            objects.at(&|scene| {
                let placed = Start::placed(scene, side, offset_m, yaw_rad);
                match seed {
                    None => placed,
                    Some(seed) => Start {
                        base_from_object: placed.base_from_object,
                        ..Start::of_trial(scene, 0.0, seed, 0)
                    },
                }
            })?
        }
        Request::Start { object, seed, trial, start_cm } => {
            objects.choose(object.as_deref())?;
            let half_width_m = match start_cm {
                None => objects.config.task.half_width_m,
                Some(start_cm) if start_cm.is_finite() && start_cm >= 0.0 => 0.01 * start_cm,
                Some(start_cm) => bail!("start_cm is {start_cm}, expected a number that is not negative"),
            };
            objects.at(&|scene| Start::of_trial(scene, half_width_m, seed, trial))?
        }
        Request::Reset {} => {
            let last = objects.last.clone().context("nothing has been placed yet")?;
            objects.at(&|_| last.clone())?
        }
    };
    place(placement, objects, shared, control)
}

/// Hands a placement over, unless the hand is in the way.
fn place(
    mut placement: Placement,
    objects: &Objects,
    shared: &Shared,
    control: &StationControl,
) -> anyhow::Result<Value> {
    let positions = control.snapshot().positions;
    let lies = placement.world.base_from_object();
    placement.world.set_joints(&positions, &vec![0.0; positions.len()]);
    placement.world.step()?;
    let contacts = placement.world.contacts();
    if contacts.robot_object_n > 0.0 && contacts.deepest_m > MOST_DEEP_M {
        bail!("the hand is where the object is to be put; open it and move it away first");
    }
    placement.world.reset(&positions, &lies);
    let targets = vec![0.0; positions.len()];
    placement.world.set_targets(&targets);
    let before = shared.seen().placements;
    shared.place(placement);
    // The station takes it over at its next step.
    for _ in 0..2000 {
        if shared.seen().placements > before {
            break;
        }
        std::thread::sleep(std::time::Duration::from_millis(1));
    }
    let mut reply = state(shared, control);
    if reply["placements"] == before {
        bail!("the station does not move on; look at its messages");
    }
    if let Some(start) = &objects.last {
        let joints = objects.station.robot.dofs().map(|joint| joint.name.clone());
        let start: BTreeMap<String, f64> = joints.zip(start.positions.iter().copied()).collect();
        reply["start"] = json!(start);
    }
    Ok(reply)
}

fn state(shared: &Shared, control: &StationControl) -> Value {
    let (seen, station) = (shared.seen(), control.snapshot());
    let (at, turned) = (seen.base_from_object.translation.vector, seen.base_from_object.rotation);
    json!({
        "ok": true,
        "time_s": station.device_ns as f64 * 1e-9,
        "placements": seen.placements,
        "object": seen.object,
        "object_pose": [at.x, at.y, at.z, turned.w, turned.i, turned.j, turned.k],
        "since_s": seen.time_s,
        "lift_m": seen.lift_m,
        "touched": seen.was_touched,
        "lifted": seen.was_lifted,
        "held_s": seen.held_s,
        "longest_held_s": seen.longest_held_s,
        "digits": seen.num_digits,
        "most_table_n": seen.most_table_n,
        "arm_has_hit": seen.was_hit,
        "problem": seen.problem,
        "left_out_s": station.left_out_ns as f64 * 1e-9,
        "most_behind_s": station.most_behind_ns as f64 * 1e-9,
    })
}
