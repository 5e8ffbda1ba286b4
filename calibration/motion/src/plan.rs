//! The plan file: what a calibration session touches, and where its objects stand.

use std::collections::BTreeMap;
use std::path::Path;

use palpate_robot_model::{PoseConfig, Station};
use serde::{Deserialize, Serialize};

use crate::error::{not_negative, parse, positive};
use crate::{PlanError, Primitive, Primitives, Scene};

/// A calibration session before it is recorded: its takes, its objects, and how the robot moves.
///
/// ```toml
/// format = 1
/// label = "Nine takes, sphere and cylinder"
/// seed = 20260302              # optional; another seed finds other postures
/// primitives = "../primitives" # optional: folder of the primitives that are not in this file
///
/// [motion]                     # see MotionConfig
///
/// [object.sphere_50mm]         # an object of the station, and its pose in the base frame
/// position_m = [0.47, 0.0, 0.19]
///
/// [primitive.tap]              # optional: a primitive as in its own file, without `format`
///
/// [[take]]
/// object = "sphere_50mm"
/// primitive = "tap"            # of this file, or tap.toml of the folder
/// duration_s = 65.1
/// touch = ["palm_heel", "index_tip.3"]
/// instruction = "Put the sphere on its stand."   # optional: what an operator does first
/// ```
///
/// A plan that holds its primitives needs no other file: stations name such plans, and their texts travel with the
/// station. For others [`Plan::read`] and [`Plan::complete`] bring the primitives in.
#[derive(Clone, Debug)]
pub struct Plan {
    /// Its path, for errors.
    pub file: String,
    /// Stem of the file.
    pub id: String,
    /// Name for people.
    pub label: String,
    /// Draws the postures that are tried: same plan, same motions.
    pub seed: u64,
    /// How the robot moves.
    pub motion: MotionConfig,
    /// Pose of each object in the base frame, by object id.
    pub objects: BTreeMap<String, PoseConfig>,
    /// The takes, in order.
    pub takes: Vec<PlannedTake>,
    /// Primitives that the plan has with it, by id.
    pub primitives: Primitives,
    /// Folder of those that it has not, relative to the plan file.
    pub primitives_dir: Option<String>,
}

/// How the robot moves between and during touches.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MotionConfig {
    /// Position of every moving joint where a take starts and ends, rad or m, by joint name: clear of every object.
    pub rest: BTreeMap<String, f64>,
    /// Positions of joints that are not part of the touching limb, by joint name; `rest` where absent.
    #[serde(default)]
    pub away: BTreeMap<String, f64>,
    /// Fraction of a joint's speed limit that is used between touches, 0..=1.
    pub speed_fraction: f64,
    /// Still time before the first touch; its first part is the take's baseline span, s.
    pub baseline_s: f64,
    /// Distance from the object at which the robot moves from one touch to the next, m.
    pub safe_clearance_m: f64,
    /// How far the orientation at a touch may differ from the one at rest, rad.
    pub tilt_rad: f64,
    /// Flexing joints arrive at a touch from this far above, or below, their final position, rad.
    pub settle_rad: f64,
}

/// One take of a plan.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlannedTake {
    /// Object id.
    pub object: String,
    /// Primitive id.
    pub primitive: String,
    /// Duration, s; longer where limits make the robot slower.
    pub duration_s: f64,
    /// What is touched, in order: channel ids, or patch ids for a patch's middle taxel.
    pub touch: Vec<String>,
    /// What an operator does before the take; empty where nothing but putting the object in place.
    #[serde(default)]
    pub instruction: String,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct PlanFile {
    format: u32,
    label: String,
    #[serde(default)]
    seed: u64,
    primitives: Option<String>,
    motion: MotionConfig,
    #[serde(rename = "object")]
    objects: BTreeMap<String, PoseConfig>,
    #[serde(rename = "primitive", default)]
    own_primitives: Primitives,
    #[serde(rename = "take")]
    takes: Vec<PlannedTake>,
}

impl Plan {
    /// The plan in `text`; `file` names it in errors, and its stem is the plan's id.
    ///
    /// Primitives that the plan does not hold are still missing: [`Plan::needs`] lists them.
    pub fn from_text(file: &str, text: &str) -> Result<Self, PlanError> {
        let read: PlanFile = parse(file, text)?;
        if read.format != 1 {
            return Err(PlanError::new(file, "format", format!("is {}, expected 1", read.format)));
        }
        for (id, primitive) in &read.own_primitives {
            primitive.check_within_plan().map_err(|(place, problem)| {
                PlanError::new(file, format!("primitive {id:?}"), format!("{place}: {problem}"))
            })?;
        }
        let id = Path::new(file).file_stem().map_or_else(String::new, |stem| stem.to_string_lossy().into());
        Ok(Self {
            file: file.to_owned(),
            id,
            label: read.label,
            seed: read.seed,
            motion: read.motion,
            objects: read.objects,
            takes: read.takes,
            primitives: read.own_primitives,
            primitives_dir: read.primitives,
        })
    }

    /// The plans that `station` names, in its order.
    pub fn of_station(station: &Station) -> Result<Vec<Self>, PlanError> {
        let named = station.plans.iter();
        named.map(|(id, text)| Self::from_text(&format!("{id}.toml"), text)).collect()
    }

    /// Reads the plan file at `path`, and the primitives that it names.
    pub fn read(path: &Path) -> Result<Self, PlanError> {
        let read_file = |path: &Path| {
            std::fs::read_to_string(path).map_err(|error| format!("failed to read it: {error}"))
        };
        let file = path.display().to_string();
        let text = read_file(path).map_err(|problem| PlanError::new(&file, "file", problem))?;
        let mut plan = Self::from_text(&file, &text)?;
        let dir = path.parent().unwrap_or(Path::new(""));
        plan.complete(|name| read_file(&dir.join(name)))?;
        Ok(plan)
    }

    /// Ids of the primitives that takes name and the plan does not hold, each once.
    pub fn needs(&self) -> Vec<&str> {
        let mut ids: Vec<&str> = self.takes.iter().map(|take| take.primitive.as_str()).collect();
        ids.sort_unstable();
        ids.dedup();
        ids.retain(|id| !self.primitives.contains_key(*id));
        ids
    }

    /// Brings in the primitives that the plan [needs](Self::needs). `read_file` turns a path relative to the plan file,
    /// such as `../primitives/tap.toml`, into its text, or says why it cannot.
    pub fn complete(
        &mut self,
        mut read_file: impl FnMut(&str) -> Result<String, String>,
    ) -> Result<(), PlanError> {
        let missing: Vec<String> = self.needs().into_iter().map(str::to_owned).collect();
        for id in missing {
            let Some(dir) = &self.primitives_dir else {
                return Err(self.no_primitive(&id));
            };
            let path = format!("{}/{id}.toml", dir.trim_end_matches('/'));
            let text = read_file(&path).map_err(|problem| {
                PlanError::new(&self.file, format!("primitive {id:?}"), format!("{path}: {problem}"))
            })?;
            self.primitives.insert(id, Primitive::from_text(&path, &text)?);
        }
        Ok(())
    }

    /// The primitive `id`: the plan's own, or else the one of `library`.
    pub fn primitive<'a>(&'a self, id: &str, library: &'a Primitives) -> Result<&'a Primitive, PlanError> {
        self.primitives.get(id).or_else(|| library.get(id)).ok_or_else(|| self.no_primitive(id))
    }

    /// Refuses what cannot be on `station`: joints, objects, channels that it has not, numbers out of range.
    pub fn check(&self, station: &Station) -> Result<(), PlanError> {
        self.find_problem(station).map_err(|(place, problem)| PlanError::new(&self.file, place, problem))
    }

    /// The station in front of the object of a take, as motions are planned for it.
    pub fn scene<'a>(&self, station: &'a Station, object: &str) -> Result<Scene<'a>, PlanError> {
        let fail = |problem: String| PlanError::new(&self.file, format!("object {object:?}"), problem);
        let pose = self.objects.get(object).ok_or_else(|| fail(no_pose(object)))?;
        let model =
            station.objects.get(object).ok_or_else(|| fail("the station has no such object".into()))?;
        Scene::new(station, model, pose.to_isometry().map_err(fail)?).map_err(fail)
    }

    /// Where takes start and end, in the station's order. Joints that follow others are where they follow them to.
    pub fn rest(&self, station: &Station) -> Vec<f64> {
        let named = |name: &str| self.motion.rest.get(name).copied().unwrap_or(0.0);
        let mut rest: Vec<f64> = station.robot.dofs().map(|joint| named(&joint.name)).collect();
        station.robot.follow(&mut rest);
        rest
    }

    /// Where joints are that take no part in a touch, in the station's order.
    pub fn away(&self, station: &Station) -> Vec<f64> {
        let rest = self.rest(station);
        let named = |(joint, rest): (&palpate_robot_model::Joint, f64)| {
            self.motion.away.get(&joint.name).copied().unwrap_or(rest)
        };
        let mut away: Vec<f64> = station.robot.dofs().zip(rest).map(named).collect();
        station.robot.follow(&mut away);
        away
    }

    fn no_primitive(&self, id: &str) -> PlanError {
        let problem = format!(
            "there is no such primitive: add [primitive.{id}] to the plan, or name the folder of {id}.toml with \
             primitives = \"...\""
        );
        PlanError::new(&self.file, format!("primitive {id:?}"), problem)
    }

    /// `(place, problem)` of the first thing that cannot be.
    fn find_problem(&self, station: &Station) -> Result<(), (String, String)> {
        let motion = &self.motion;
        check_positions(station, &motion.rest, "motion.rest")?;
        check_positions(station, &motion.away, "motion.away")?;
        let mut moved = station.robot.dofs().filter(|joint| joint.mimic.is_none());
        if let Some(missing) = moved.find(|joint| !motion.rest.contains_key(&joint.name)) {
            return Err(("motion.rest".into(), format!("joint {:?} is missing", missing.name)));
        }
        check_followers(station, &motion.rest, &self.rest(station), "motion.rest")?;
        check_followers(station, &motion.away, &self.away(station), "motion.away")?;
        positive(
            "motion",
            &[
                ("speed_fraction", motion.speed_fraction),
                ("baseline_s", motion.baseline_s),
                ("safe_clearance_m", motion.safe_clearance_m),
            ],
        )?;
        not_negative("motion", &[("tilt_rad", motion.tilt_rad), ("settle_rad", motion.settle_rad)])?;
        if motion.speed_fraction > 1.0 {
            let problem = format!("speed_fraction = {} must be at most 1", motion.speed_fraction);
            return Err(("motion".into(), problem));
        }
        for (id, pose) in &self.objects {
            let place = format!("object {id:?}");
            if !station.objects.contains_key(id) {
                return Err((place, "the station has no such object".into()));
            }
            pose.to_isometry().map_err(|problem| (place, problem))?;
        }
        if self.takes.is_empty() {
            return Err(("take".into(), "there are no takes: add a [[take]]".into()));
        }
        for (take_idx, take) in self.takes.iter().enumerate() {
            let place = format!("take {}", take_idx + 1);
            if !self.objects.contains_key(&take.object) {
                return Err((
                    place,
                    format!("object {:?} has no pose: {}", take.object, no_pose(&take.object)),
                ));
            }
            if !(take.duration_s.is_finite() && take.duration_s > motion.baseline_s) {
                let problem =
                    format!("duration_s = {} must be longer than motion.baseline_s", take.duration_s);
                return Err((place, problem));
            }
            if take.touch.is_empty() {
                return Err((place, "touch is empty: name channels or patches".into()));
            }
            if let Some(unknown) = take.touch.iter().find(|touch| channel_named(station, touch).is_none()) {
                return Err((place, format!("touch: the layout has no channel or patch {unknown:?}")));
            }
        }
        Ok(())
    }
}

/// The channel that `touch` names: a channel id, or a patch id for the taxel nearest to the patch's middle.
pub fn channel_named(station: &Station, touch: &str) -> Option<usize> {
    let layout = &station.layout;
    if let Some(channel) = layout.channels.iter().position(|channel| channel.id == touch) {
        return Some(channel);
    }
    let patch = layout.patches.iter().find(|patch| patch.id == touch)?;
    let count = patch.taxels_in_link.len() as f64;
    let middle =
        patch.taxels_in_link.iter().fold(nalgebra::Vector3::zeros(), |sum, pos| sum + pos.coords) / count;
    let nearest = patch
        .taxels_in_link
        .iter()
        .enumerate()
        .min_by(|(_, a), (_, b)| (a.coords - middle).norm().total_cmp(&(b.coords - middle).norm()))?;
    Some(patch.channels.start + nearest.0)
}

fn no_pose(object: &str) -> String {
    format!("add [object.{object}]")
}

/// How far the position that a plan states for a joint may be from where it follows another to, rad or m.
const FOLLOWING_TOLERANCE: f64 = 1e-6;

/// Refuses joints that follow others and are stated to be elsewhere, or would be outside of their limits at
/// `positions`.
fn check_followers(
    station: &Station,
    named: &BTreeMap<String, f64>,
    positions: &[f64],
    place: &str,
) -> Result<(), (String, String)> {
    let robot = &station.robot;
    for (joint, &position) in robot.dofs().zip(positions) {
        let Some(mimic) = joint.mimic else { continue };
        let followed = &robot.joints[mimic.joint].name;
        if let Some(stated) =
            named.get(&joint.name).filter(|stated| (**stated - position).abs() > FOLLOWING_TOLERANCE)
        {
            let problem = format!(
                "joint {:?} follows {followed:?} to {position}, expected no other position than that, not {stated}; leave it out",
                joint.name
            );
            return Err((place.to_owned(), problem));
        }
        if let Some(limits) = joint.limits.filter(|limits| {
            position < limits.lower - FOLLOWING_TOLERANCE || position > limits.upper + FOLLOWING_TOLERANCE
        }) {
            let problem = format!(
                "joint {:?} follows {followed:?} to {position}, outside its limits {}..{}; move {followed:?} elsewhere",
                joint.name, limits.lower, limits.upper
            );
            return Err((place.to_owned(), problem));
        }
    }
    Ok(())
}

fn check_positions(
    station: &Station,
    named: &BTreeMap<String, f64>,
    place: &str,
) -> Result<(), (String, String)> {
    for (name, value) in named {
        let Some(joint) = station.robot.dofs().find(|joint| joint.name == *name) else {
            return Err((place.to_owned(), format!("the station has no moving joint {name:?}")));
        };
        if !value.is_finite() {
            return Err((place.to_owned(), format!("joint {name:?}: {value} must be finite")));
        }
        if let Some(limits) = joint.limits
            && !(limits.lower..=limits.upper).contains(value)
        {
            let range = format!("{}..{}", limits.lower, limits.upper);
            return Err((place.to_owned(), format!("joint {name:?}: {value} is outside its limits {range}")));
        }
    }
    Ok(())
}
