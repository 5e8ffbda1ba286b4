//! A first plan for a station that has none: every patch touched with each of its objects, as far as the station can.
//!
//! Nobody said where objects stand, so places are tried: in front of a carried hand, and before the skin of one that nothing
//! carries, also between opposite fingers. What is proposed was planned, take by take; what could not be is left out and
//! named. Same station, same plan.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::{Isometry3, Point3, Translation3, Unit, UnitQuaternion, Vector3};
use palpate_robot_model::{PoseConfig, Station, ik};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;

use crate::closing::{is_carried, try_closing};
use crate::contact::{Postures, limb_dofs, try_contact};
use crate::primitive::{Actuator, Primitive, Primitives};
use crate::text::plan_text;
use crate::{MotionConfig, MotionLimits, Plan, PlannedTake, Scene, plan_in, plan_take};

/// How the shipped plans move.
const SPEED_FRACTION: f64 = 0.65;
const BASELINE_S: f64 = 2.5;
const SAFE_CLEARANCE_M: f64 = 0.03;
const TILT_RAD: f64 = 0.9;
const SETTLE_RAD: f64 = 0.12;
const SEED: u64 = 1;

/// Touches of one take: the shipped plans have 4 to 8, so that a take lasts about a minute.
const MOST_TOUCHES: usize = 6;
/// Touches with one object that are wanted, shared among the patches: some ten minutes of recording.
const WANTED_TOUCHES: usize = 36;
/// Taxels of one patch that are touched.
const TAXELS_OF_PATCH: [usize; 2] = [2, 5];
/// A session of fewer takes has each of them twice, so that some can be kept for judging.
const FEWEST_TAKES: usize = 4;
/// Postures that are drawn for one patch before a place counts as out of its reach, and where it is within.
const TRIALS_OF_PATCH: [usize; 2] = [12, 24];
/// Postures that are drawn for one object and one posture at rest.
const TRIALS_OF_REST: usize = 3000;
/// Postures that are drawn in all while places are looked for, some seconds.
const MOST_TRIALS: usize = 60_000;
/// A planned touch counts as so many of them.
const TRIALS_OF_PLAN: usize = 100;
/// Postures to start from that are drawn besides the plain ones.
const DRAWN_RESTS: usize = 12;
/// Postures in which the hand, or its fingers, may meet an object.
const DRAWN_PLACES: usize = 6;
/// At rest every link is this far from the object, m: as between touches, and a little more.
const REST_CLEARANCE_M: f64 = 0.004;

/// A plan to begin with, and what it leaves out.
#[derive(Clone, Debug, Default)]
pub struct FirstPlan {
    /// The plan file; `None` where nothing can be touched.
    pub text: Option<String>,
    /// Number of its takes.
    pub takes: usize,
    /// How long they last together, s.
    pub duration_s: f64,
    /// What is touched with which object.
    pub objects: Vec<ObjectInPlan>,
    /// What is left out and why, a sentence each.
    pub warnings: Vec<String>,
}

/// An object of a [`FirstPlan`].
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ObjectInPlan {
    /// Its id.
    pub object: String,
    /// Where it stands, m from the robot's base.
    pub position_m: [f64; 3],
    /// Channels that are touched with it.
    pub channels: Vec<String>,
}

/// Where an object can stand, and what reaches it there.
#[derive(Clone, Debug, Default)]
struct Place {
    position_m: [f64; 3],
    /// Taxels that were seen to touch, by patch.
    reached: BTreeMap<usize, BTreeSet<usize>>,
}

impl Place {
    /// More patches first, then more taxels.
    fn worth(&self) -> (usize, usize) {
        (self.reached.len(), self.reached.values().map(BTreeSet::len).sum())
    }
}

/// Proposes a plan for `station` with the motions of `shipped` that are called `tap` and `press_hold`.
pub fn first_plan(station: &Station, shipped: &Primitives) -> FirstPlan {
    let mut plan = FirstPlan::default();
    let movable: Vec<usize> = (0..station.layout.patches.len())
        .filter(|&patch| !ik::chain_dofs(&station.robot, station.layout.patches[patch].link).is_empty())
        .collect();
    for patch in (0..station.layout.patches.len()).filter(|patch| !movable.contains(patch)) {
        plan.warnings.push(format!(
            "patch {:?}: no joint moves it, so the plan does not touch it; touch it by hand in a take of its own",
            station.layout.patches[patch].id
        ));
    }
    let mut scenes: Vec<(&str, Scene<'_>)> = Vec::new();
    for (id, object) in &station.objects {
        match Scene::new(station, object, Isometry3::identity()) {
            Ok(scene) => scenes.push((id, scene)),
            Err(problem) => plan.warnings.push(format!("object {id:?} is not in the plan: it {problem}")),
        }
    }
    let Some((_, first)) = scenes.first().filter(|_| !movable.is_empty()) else {
        return nothing(plan);
    };
    let primitives = primitives(first, &movable, shipped);
    let Some(tap) = primitives.get("tap").cloned() else { return nothing(plan) };
    let mut search = Search { station, movable: &movable, tap: &tap, trials: 0 };
    let (rest, places) = search.places(&mut scenes);
    let mut draft = Plan {
        file: "the first plan".to_owned(),
        id: "every_patch".to_owned(),
        label: format!("Every patch of {}", station.label),
        seed: SEED,
        motion: motion(station, &rest),
        objects: places
            .iter()
            .map(|(id, place)| {
                let pose = PoseConfig { position_m: place.position_m, quaternion_wxyz: [1.0, 0.0, 0.0, 0.0] };
                ((*id).to_owned(), pose)
            })
            .collect(),
        takes: takes(station, &primitives, &places),
        primitives,
        primitives_dir: None,
    };
    let problems = keep_what_can_be_planned(station, &mut draft);
    for (id, _) in &scenes {
        let touched: BTreeSet<usize> = draft
            .takes
            .iter()
            .filter(|take| take.object == *id)
            .flat_map(|take| &take.touch)
            .filter_map(|touch| crate::channel_named(station, touch))
            .collect();
        if touched.is_empty() {
            let why = problems.get(*id).map_or_else(String::new, |problem| format!(" ({problem})"));
            plan.warnings.push(format!(
                "object {id:?} is not in the plan: no place was found at which skin can be brought to it{why}"
            ));
            draft.objects.remove(*id);
            continue;
        }
        for &patch in &movable {
            let layout = &station.layout;
            if !touched.iter().any(|&channel| layout.channels[channel].patch == patch) {
                plan.warnings.push(format!(
                    "patch {:?} is not touched with object {id:?}: no way was found to bring it there where the others \
                     are; move the object in the plan, or record that by hand",
                    layout.patches[patch].id
                ));
            }
        }
        plan.objects.push(ObjectInPlan {
            object: (*id).to_owned(),
            position_m: draft.objects.get(*id).map_or([0.0; 3], |pose| pose.position_m),
            channels: touched.iter().map(|&channel| station.layout.channels[channel].id.clone()).collect(),
        });
    }
    if draft.takes.is_empty() {
        return nothing(plan);
    }
    plan.takes = draft.takes.len();
    plan.duration_s = draft.takes.iter().map(|take| take.duration_s).sum();
    let about = [
        "Made by `palpate station new`: every patch is touched with every object, as far as this robot can."
            .to_owned(),
        "Each take was planned; whether objects can stand where it has them, you have to see.".to_owned(),
    ];
    plan.text = Some(plan_text(&draft, station, &about));
    plan
}

/// There is no plan.
fn nothing(mut plan: FirstPlan) -> FirstPlan {
    plan.warnings.push(
        "no plan was written, because no patch can be brought to an object: name the joints of the arm that carries the \
         hand (--carrier), give an object that fits between its fingers (--object), or write a plan by hand \
         (docs/plans.md)"
            .to_owned(),
    );
    plan
}

/// The shipped motions that need no arm, pressed by what the station has.
fn primitives(scene: &Scene<'_>, movable: &[usize], shipped: &Primitives) -> Primitives {
    let patches = &scene.station.layout.patches;
    let has_limb = movable.iter().any(|&patch| !limb_dofs(scene, patches[patch].link).is_empty());
    let pressed_by = match (is_carried(scene), has_limb) {
        (true, true) => vec![Actuator::Carrier, Actuator::Limb],
        (true, false) => vec![Actuator::Carrier],
        (false, _) => vec![Actuator::Limb],
    };
    // In this order: a hold says what lingers, a tap everything else.
    let used = ["tap", "press_hold"].into_iter().filter_map(|id| Some((id, shipped.get(id)?)));
    used.map(|(id, shipped)| {
        let mut primitive = shipped.clone();
        primitive.pressed_by.clone_from(&pressed_by);
        (id.to_owned(), primitive)
    })
    .collect()
}

fn motion(station: &Station, rest: &[f64]) -> MotionConfig {
    let joints = station.robot.dofs().zip(rest).filter(|(joint, _)| joint.mimic.is_none());
    MotionConfig {
        rest: joints.map(|(joint, &position)| (joint.name.clone(), position)).collect(),
        away: BTreeMap::new(),
        speed_fraction: SPEED_FRACTION,
        baseline_s: BASELINE_S,
        safe_clearance_m: SAFE_CLEARANCE_M,
        tilt_rad: TILT_RAD,
        settle_rad: SETTLE_RAD,
    }
}

/// Where the skin of a patch is.
struct Pad {
    /// The middle of its taxels.
    middle: Point3<f64>,
    /// Outward normal near there.
    outward: Vector3<f64>,
    /// A quarter of the way along the patch and across it.
    quarters: [Vector3<f64>; 2],
}

impl Pad {
    fn of(station: &Station, patch_idx: usize, frames: &[Isometry3<f64>]) -> Self {
        let patch = &station.layout.patches[patch_idx];
        let taxel = spread(station, patch_idx).first().copied().unwrap_or(0);
        let count = patch.taxels_in_link.len().max(1) as f64;
        let sum = patch.taxels_in_link.iter().fold(Vector3::zeros(), |sum, pos| sum + pos.coords);
        let frame = &frames[patch.link];
        let turn = (frame * patch.link_from_patch).rotation;
        let nodes = patch.nodes.iter().map(|node| patch.link_from_patch.inverse() * node.pos_in_link);
        let half = nodes.fold(Vector3::zeros(), |most: Vector3<f64>, pos| most.sup(&pos.coords.abs()));
        Self {
            middle: frame * Point3::from(sum / count),
            outward: frame.rotation * patch.taxel_normals_in_link[taxel].into_inner(),
            quarters: [turn * Vector3::x() * (0.5 * half.x), turn * Vector3::y() * (0.5 * half.y)],
        }
    }
}

/// Looks for a posture to start from, and for a place of each object.
struct Search<'a> {
    station: &'a Station,
    movable: &'a [usize],
    tap: &'a Primitive,
    /// Postures that were drawn so far.
    trials: usize,
}

impl Search<'_> {
    /// The posture at rest and the places with which most patches reach most objects.
    fn places<'b>(&mut self, scenes: &mut [(&'b str, Scene<'_>)]) -> (Vec<f64>, Vec<(&'b str, Place)>) {
        let mut best: (Vec<f64>, Vec<(&str, Place)>) = (Vec::new(), Vec::new());
        let mut best_worth = (0, 0);
        let wanted = self.movable.len() * scenes.len();
        for rest in rests(self.station) {
            let mut places = Vec::new();
            for (id, scene) in scenes.iter_mut() {
                if let Some(place) = self.place(scene, &rest) {
                    places.push((*id, place));
                }
            }
            let worth = places.iter().map(|(_, place)| place.worth());
            let worth = worth.fold((0, 0), |sum, worth| (sum.0 + worth.0, sum.1 + worth.1));
            if best.0.is_empty() || worth > best_worth {
                (best, best_worth) = ((rest, places), worth);
            }
            if best_worth.0 >= wanted || self.trials > MOST_TRIALS {
                break;
            }
        }
        best
    }

    /// The best place for the object of `scene`, `None` if nothing reaches it anywhere.
    fn place(&mut self, scene: &mut Scene<'_>, rest: &[f64]) -> Option<Place> {
        let mut frames = Vec::new();
        self.station.robot.forward_kinematics(rest, &mut frames);
        let mut best: Option<Place> = None;
        let until = self.trials + TRIALS_OF_REST;
        for position in self.positions(scene, rest, &frames) {
            scene.place(Isometry3::from_parts(
                Translation3::from(position.coords),
                UnitQuaternion::identity(),
            ));
            let room_m = if is_carried(scene) { SAFE_CLEARANCE_M } else { REST_CLEARANCE_M };
            let moving_m = scene.least_m(&frames, |link| scene.rigid_root[link] != 0);
            let standing_m = scene.least_m(&frames, |link| scene.rigid_root[link] == 0);
            if moving_m < room_m || standing_m < 0.0 {
                continue;
            }
            let mut place = Place { position_m: position.coords.into(), reached: BTreeMap::new() };
            let best_worth = best.as_ref().map_or((0, 0), Place::worth);
            for (idx, &patch) in self.movable.iter().enumerate() {
                // A place that cannot become the best is left.
                if place.reached.len() + (self.movable.len() - idx) < best_worth.0.max(1) {
                    break;
                }
                let taxels = self.reach(scene, patch, rest);
                if self.is_planned(scene, patch, &taxels, rest) {
                    place.reached.insert(patch, taxels);
                }
            }
            if place.worth() > best_worth {
                best = Some(place);
            }
            let all = best.as_ref().is_some_and(|best| best.reached.len() == self.movable.len());
            if all || self.trials > until {
                break;
            }
        }
        best
    }

    /// Taxels of `patch` that reach the object where it is now.
    fn reach(&mut self, scene: &Scene<'_>, patch: usize, rest: &[f64]) -> BTreeSet<usize> {
        let station = self.station;
        let postures = Postures {
            rest,
            away: rest,
            tilt_rad: TILT_RAD,
            retreat_m: SAFE_CLEARANCE_M,
            depth_m: self.tap.depth_m,
        };
        let channels = station.layout.patches[patch].channels.clone();
        let middle = spread(station, patch).first().copied().unwrap_or(0);
        let mut reached = BTreeSet::new();
        let mut rng = ChaCha8Rng::seed_from_u64(SEED);
        for trial in 0..TRIALS_OF_PATCH[1] {
            if trial >= TRIALS_OF_PATCH[0] && reached.is_empty() {
                break;
            }
            self.trials += 1;
            if is_carried(scene) {
                if try_contact(scene, channels.start + middle, &postures, &mut rng).is_some() {
                    // A hand that is carried brings the others there too.
                    return (0..channels.len()).collect();
                }
            } else if let Some(closing) = try_closing(scene, patch, None, self.tap, &postures, &mut rng) {
                reached.extend(closing.taxels);
            }
        }
        reached
    }

    /// Whether a touch of one of `taxels` of `patch` can be planned with the object where it is now, there and back.
    fn is_planned(
        &mut self,
        scene: &Scene<'_>,
        patch: usize,
        taxels: &BTreeSet<usize>,
        rest: &[f64],
    ) -> bool {
        let layout = &self.station.layout;
        let Some(taxel) = spread(self.station, patch).into_iter().find(|taxel| taxels.contains(taxel)) else {
            return false;
        };
        // As much work as so many postures.
        self.trials += TRIALS_OF_PLAN;
        let take = PlannedTake {
            object: String::new(),
            primitive: "tap".to_owned(),
            duration_s: 2.0 * BASELINE_S,
            touch: vec![layout.channels[layout.patches[patch].channels.start + taxel].id.clone()],
            instruction: String::new(),
        };
        let plan = Plan {
            file: String::new(),
            id: String::new(),
            label: String::new(),
            seed: SEED,
            motion: motion(self.station, rest),
            objects: BTreeMap::new(),
            takes: vec![take],
            primitives: [("tap".to_owned(), self.tap.clone())].into(),
            primitives_dir: None,
        };
        plan_in(scene, &plan, &Primitives::new(), 0, Some(&MotionLimits::of(self.station))).is_ok()
    }

    /// The links where the degrees of freedom `dofs` are anywhere in their ranges and the others at `rest`, some times.
    fn elsewhere(&self, rest: &[f64], dofs: &[usize]) -> Vec<Vec<Isometry3<f64>>> {
        let robot = &self.station.robot;
        let mut rng = ChaCha8Rng::seed_from_u64(SEED);
        let drawn = (0..DRAWN_PLACES).map(|idx| {
            let mut positions = rest.to_vec();
            for &dof in dofs {
                let (lower, upper) = ik::range(robot, dof);
                let [lower, upper] = [lower, upper].map(|end| if end.is_finite() { end } else { rest[dof] });
                // The middle first.
                let share = if idx == 0 { 0.5 } else { rng.random::<f64>() };
                positions[dof] = lower + (upper - lower) * share;
            }
            robot.follow(&mut positions);
            let mut frames = Vec::new();
            robot.forward_kinematics(&positions, &mut frames);
            frames
        });
        drawn.collect()
    }

    /// Where the middle of the object may be, likeliest first, for links at `frames`.
    fn positions(&self, scene: &Scene<'_>, rest: &[f64], frames: &[Isometry3<f64>]) -> Vec<Point3<f64>> {
        let from_base = scene.base_from_object().translation.vector;
        // How far the object reaches from its middle.
        let reaches_m = |direction: &Vector3<f64>| {
            scene.surface.iter().map(|(pos, _)| (pos.coords - from_base).dot(direction)).fold(0.0, f64::max)
        };
        let patches: Vec<Pad> = self.movable.iter().map(|&idx| Pad::of(self.station, idx, frames)).collect();
        let count = patches.len().max(1) as f64;
        let middle =
            Point3::from(patches.iter().fold(Vector3::zeros(), |sum, pad| sum + pad.middle.coords) / count);
        let mut positions = Vec::new();
        if is_carried(scene) {
            let mean = patches.iter().fold(Vector3::zeros(), |sum, pad| sum + pad.outward);
            let mut directions = vec![-Vector3::z()];
            directions.extend(Unit::try_new(mean, 0.3).map(Unit::into_inner));
            directions.extend(patches.iter().take(2).map(|pad| pad.outward));
            for room_m in [0.1, 0.15] {
                let place =
                    |way: &Vector3<f64>| middle + way * (reaches_m(&-way) + SAFE_CLEARANCE_M + room_m);
                positions.extend(directions.iter().map(place));
            }
            // Where the hand can be, it can be all around.
            positions.extend(self.elsewhere(rest, &scene.station.carrier_dofs).iter().map(|frames| {
                let pads = self.movable.iter().map(|&idx| Pad::of(self.station, idx, frames).middle.coords);
                Point3::from(pads.sum::<Vector3<f64>>() / count)
            }));
            // Objects usually stand on what the robot stands on, not under it.
            let below_m = reaches_m(&-Vector3::z());
            positions.sort_by_key(|pos| pos.z < below_m);
        } else {
            // Between opposite fingers first, then where a finger meets it in some posture.
            let pairs = patches.iter().enumerate().flat_map(|(idx, one)| {
                let others =
                    patches[idx + 1..].iter().filter(move |other| one.outward.dot(&other.outward) < -0.7);
                others.map(move |other| nalgebra::center(&one.middle, &other.middle))
            });
            let pairs: Vec<Point3<f64>> = pairs.take(3).collect();
            let shifts = patches.first().map_or([Vector3::zeros(); 2], |pad| pad.quarters);
            let [along, across] = shifts;
            for shift in [Vector3::zeros(), along, -along, across, -across, 2.0 * along, -2.0 * along] {
                positions.extend(pairs.iter().map(|place| place + shift));
            }
            let limbs: Vec<usize> =
                (0..rest.len()).filter(|dof| !scene.station.carrier_dofs.contains(dof)).collect();
            for frames in self.elsewhere(rest, &limbs) {
                let pads = self.movable.iter().map(|&idx| Pad::of(self.station, idx, &frames));
                let met = pads.map(|pad| pad.middle + pad.outward * reaches_m(&-pad.outward));
                positions.extend(met.take(6));
            }
        }
        positions.iter_mut().for_each(|pos| pos.coords.apply(|metres| *metres = rounded(*metres)));
        positions
    }
}

/// Postures to start from: plain ones first, then ones that are drawn.
fn rests(station: &Station) -> impl Iterator<Item = Vec<f64>> {
    let robot = &station.robot;
    let ranges: Vec<(f64, f64)> = (0..robot.num_dofs()).map(|dof| ik::range(robot, dof)).collect();
    let ends = |(lower, upper): (f64, f64)| {
        let [lower, upper] = [lower, upper].map(|end| if end.is_finite() { end } else { 0.0 });
        (lower, upper)
    };
    let zero = |range: (f64, f64)| 0.0_f64.clamp(range.0, range.1);
    let middle = move |range| {
        let (lower, upper) = ends(range);
        0.5 * (lower + upper)
    };
    let carriers = station.carrier_dofs.clone();
    let mut rng = ChaCha8Rng::seed_from_u64(SEED);
    (0..5 + DRAWN_RESTS).map(move |idx| {
        let mut rest: Vec<f64> = ranges
            .iter()
            .enumerate()
            .map(|(dof, &range)| {
                let (lower, upper) = ends(range);
                let is_carrier = carriers.contains(&dof);
                let position = match idx {
                    0 => zero(range),
                    1 => middle(range),
                    2 if !is_carrier => upper,
                    3 if !is_carrier => lower,
                    4 if !is_carrier => zero(range),
                    2..=4 => middle(range),
                    _ if is_carrier => middle(range) + (rng.random::<f64>() - 0.5) * 0.7 * (upper - lower),
                    _ => match rng.random_range(0..4_u8) {
                        0 => zero(range),
                        1 => lower,
                        2 => upper,
                        _ => lower + (upper - lower) * rng.random::<f64>(),
                    },
                };
                // Rounding must not lead out of the range.
                let inside = rounded(position);
                if (range.0..=range.1).contains(&inside) { inside } else { position }
            })
            .collect();
        robot.follow(&mut rest);
        rest
    })
}

/// Taxels of a patch, by index: the middle one first, then each as far as can be from those before.
fn spread(station: &Station, patch: usize) -> Vec<usize> {
    let patch = &station.layout.patches[patch];
    let taxels = &patch.taxels_in_link;
    let count = taxels.len().max(1) as f64;
    let middle = Point3::from(taxels.iter().fold(Vector3::zeros(), |sum, pos| sum + pos.coords) / count);
    let mut order: Vec<usize> = Vec::with_capacity(taxels.len());
    while order.len() < taxels.len() {
        let left = (0..taxels.len()).filter(|taxel| !order.contains(taxel));
        let apart_m = |taxel: usize| {
            order.iter().map(|&other| (taxels[taxel] - taxels[other]).norm()).fold(f64::INFINITY, f64::min)
        };
        let next = if order.is_empty() {
            left.min_by(|&a, &b| (taxels[a] - middle).norm().total_cmp(&(taxels[b] - middle).norm()))
        } else {
            // The first of several that are as far.
            left.rev().max_by(|&a, &b| apart_m(a).total_cmp(&apart_m(b)))
        };
        let Some(next) = next else { break };
        order.push(next);
        // Skins of thousands of taxels need no more than are touched.
        if order.len() >= TAXELS_OF_PATCH[1].max(1) * 4 {
            break;
        }
    }
    order
}

/// The takes that are wanted: taps on taxels all over each patch, holds on one of each.
fn takes(station: &Station, primitives: &Primitives, places: &[(&str, Place)]) -> Vec<PlannedTake> {
    let layout = &station.layout;
    let [fewest, most] = TAXELS_OF_PATCH;
    let mut takes = Vec::new();
    for (object, place) in places {
        let of_patch = (WANTED_TOUCHES / place.reached.len().max(1)).clamp(fewest, most);
        for primitive in ["tap", "press_hold"].iter().filter(|id| primitives.contains_key(**id)) {
            let of_patch = if *primitive == "tap" { of_patch } else { 1 };
            let touches: Vec<String> = place
                .reached
                .iter()
                .flat_map(|(&patch, reached)| {
                    let order = spread(station, patch).into_iter().filter(|taxel| reached.contains(taxel));
                    let first = layout.patches[patch].channels.start;
                    order.take(of_patch).map(move |taxel| layout.channels[first + taxel].id.clone())
                })
                .collect();
            takes.extend(touches.chunks(MOST_TOUCHES).map(|touch| PlannedTake {
                object: (*object).to_owned(),
                primitive: (*primitive).to_owned(),
                duration_s: 2.0 * BASELINE_S,
                touch: touch.to_vec(),
                instruction: instruction(station, object, place),
            }));
        }
    }
    if takes.len() < FEWEST_TAKES {
        takes.extend(takes.clone());
    }
    takes
}

/// What an operator does first.
fn instruction(station: &Station, object: &str, place: &Place) -> String {
    let label = station.objects.get(object).map_or(object, |object| object.label.as_str());
    let [x, y, z] = place.position_m;
    let base = &station.robot.links[0].name;
    format!("{label}: its middle {x:?}, {y:?}, {z:?} m from {base}, not turned; nothing else near it.")
}

/// Leaves out of the takes of `plan` what cannot be planned, and sets how long each lasts; returns the last problem by object.
fn keep_what_can_be_planned(station: &Station, plan: &mut Plan) -> BTreeMap<String, String> {
    let limits = MotionLimits::of(station);
    let none = Primitives::new();
    let mut problems = BTreeMap::new();
    let mut take_idx = 0;
    while take_idx < plan.takes.len() {
        // Alone first: what is out of reach is so in every order.
        match plan_take(station, plan, &none, take_idx, Some(&limits)) {
            Ok(motion) => {
                plan.takes[take_idx].duration_s = motion.duration_s().ceil() + 1.0;
                take_idx += 1;
            }
            Err(error) => {
                let object = plan.takes[take_idx].object.clone();
                problems.insert(object, error.problem);
                let wanted = plan.takes[take_idx].touch.clone();
                let mut kept: Vec<String> = Vec::new();
                for touch in &wanted {
                    plan.takes[take_idx].touch = vec![touch.clone()];
                    if plan_take(station, plan, &none, take_idx, Some(&limits)).is_ok() {
                        kept.push(touch.clone());
                    }
                }
                if kept.len() == wanted.len() {
                    // Each by itself, but not one after another.
                    kept.pop();
                }
                if kept.is_empty() {
                    // The next take has this one's index now, and is planned as such.
                    plan.takes.remove(take_idx);
                } else {
                    plan.takes[take_idx].touch = kept;
                }
            }
        }
    }
    problems
}

/// To a tenth of a millimetre or of a milliradian.
fn rounded(value: f64) -> f64 {
    (value * 1e4).round() / 1e4 + 0.0
}
