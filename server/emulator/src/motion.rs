//! Motions that touch every channel: contact postures, primitives, joint paths.
//!
//! Nothing here knows a particular robot: carriers (an arm, a gantry) bring a taxel to the object's surface, limbs (the
//! joints between carrier and taxel) take a posture and sometimes press by themselves.

mod contact;
mod ik;
mod path;
mod scene;
mod touch;

use palpate_recording::{Span, SpanKind};
use palpate_robot_model::JointKind;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

pub(crate) use ik::{Goal as ReachGoal, chain_dofs, solve as reach};
pub(crate) use path::JointPath;
pub(crate) use scene::Scene;

use crate::EmulationError;
use crate::primitive::{Actuator, Primitive};
use crate::truth::{Emulation, TakeTruth};
use contact::{Postures, find_contacts, limb_dofs};
use path::Segment;
use touch::{Strokes, travel_s};

/// Postures that are tried for one touch before giving up.
const MOST_POSTURES: usize = 12;
/// Every link stays this far from the object between touches, m.
const TRANSIT_CLEARANCE_M: f64 = 0.003;

/// The motion of one take.
#[derive(Clone, Debug)]
pub(crate) struct TakeMotion {
    /// Where the joints are, at any time.
    pub(crate) path: JointPath,
    /// Baseline and repetitions.
    pub(crate) spans: Vec<Span>,
    /// What is being done from which time on, s.
    pub(crate) activities: Vec<(f64, String)>,
}

/// A touch that has a posture, strokes and a way there.
struct PlannedTouch {
    channel: usize,
    /// Index among the touches of the take; the same from both sides.
    touch_idx: usize,
    /// The touching link.
    link: usize,
    /// Whether joints flex that can settle from one side or the other.
    settles: bool,
    strokes: Strokes,
    /// From the end of the touch before to this one's hover.
    way_in: Vec<Segment>,
    /// Whether flexing joints arrive from above their final position.
    from_above: bool,
}

/// Plans the take at `take_idx`. The same truth gives the same motion, whatever the seed of the recording.
pub(crate) fn plan_take(
    emulation: &Emulation,
    scene: &Scene<'_>,
    take_idx: usize,
) -> Result<TakeMotion, EmulationError> {
    let take = &emulation.truth.takes[take_idx];
    let primitive = &emulation.primitives[&take.primitive];
    let planner = Planner { emulation, scene, take_idx, take, primitive, rest: emulation.rest() };
    planner.plan()
}

struct Planner<'a> {
    emulation: &'a Emulation,
    scene: &'a Scene<'a>,
    take_idx: usize,
    take: &'a TakeTruth,
    primitive: &'a Primitive,
    rest: Vec<f64>,
}

impl Planner<'_> {
    fn plan(&self) -> Result<TakeMotion, EmulationError> {
        let mut rng = ChaCha8Rng::seed_from_u64(self.emulation.truth.world_seed);
        rng.set_stream(1 + self.take_idx as u64);
        let mut touches: Vec<PlannedTouch> = Vec::new();
        let mut here = self.rest.clone();
        for (touch_idx, name) in self.take.touch.iter().enumerate() {
            let channel = self.emulation.channel(name).unwrap_or_default();
            let touch = self.plan_touch(channel, touch_idx, &here, &mut rng).ok_or_else(|| {
                self.error(format!(
                    "found no way to touch {:?} with {name:?} without other links touching: move the object, or \
                     change motion.rest, motion.away or motion.tilt_rad",
                    self.take.object
                ))
            })?;
            here = touch.strokes.hover().to_vec();
            let other_side = (self.primitive.both_sides && touch.settles).then(|| {
                let from_above = !touch.from_above;
                let way_in = self.way_in(&here, touch.link, &touch.strokes, from_above)?;
                Some(PlannedTouch { strokes: touch.strokes.clone(), way_in, from_above, ..touch })
            });
            touches.push(touch);
            touches.extend(other_side.flatten());
        }
        let way_home =
            self.way(&here, &self.rest).ok_or_else(|| self.error("found no way back to rest".into()))?;

        // First without pauses, to see how much time is left for them.
        let needed_s = self.assemble(&touches, &way_home, 0.0).path.duration_s();
        let spare_s = self.take.duration_s - needed_s;
        if spare_s < 0.0 {
            return Err(self.error(format!(
                "{} touches need {needed_s:.1} s, duration_s is {}: touch less, or make the primitive faster",
                touches.len(),
                self.take.duration_s
            )));
        }
        Ok(self.assemble(&touches, &way_home, spare_s / (touches.len() + 1) as f64))
    }

    /// Puts the take together with a pause of `pause_s` before each touch.
    fn assemble(&self, touches: &[PlannedTouch], way_home: &[Segment], pause_s: f64) -> TakeMotion {
        let baseline_s = self.emulation.truth.motion.baseline_s;
        let mut take = TakeMotion {
            path: JointPath::default(),
            spans: vec![Span {
                kind: SpanKind::Baseline,
                start_s: 0.0,
                // Ends before the robot moves, so that late samples still belong to it.
                end_s: 0.8 * baseline_s,
                label: String::new(),
            }],
            activities: vec![(0.0, "baseline".to_owned())],
        };
        take.path.push(Segment::still(&self.rest, baseline_s));
        for touch in touches {
            let place = &self.scene.station.layout.channels[touch.channel].id;
            take.activities.push((take.path.duration_s(), format!("to {place}")));
            if let Some(first) = touch.way_in.first() {
                take.path.push(Segment::still(&first.waypoints[0], pause_s));
            }
            for segment in &touch.way_in {
                take.path.push(segment.clone());
            }
            take.activities.push((take.path.duration_s(), format!("{}, {place}", self.primitive.label)));
            for (speed_idx, speed) in self.primitive.speeds.iter().enumerate() {
                if self.primitive.speeds_in_turn && speed_idx != touch.touch_idx % self.primitive.speeds.len()
                {
                    continue;
                }
                let by = match touch.strokes.actuator {
                    Actuator::Carrier => "carrier",
                    Actuator::Limb => "limb",
                };
                let side = if touch.from_above { "above" } else { "below" };
                let label = format!("{} {place} {} by {by} from {side}", self.take.primitive, speed.id);
                for _ in 0..self.primitive.repetitions {
                    let start_s = take.path.duration_s();
                    for segment in touch.strokes.repetition(self.primitive, speed) {
                        take.path.push(segment);
                    }
                    take.path.push(Segment::still(touch.strokes.hover(), self.primitive.gap_s));
                    let end_s = take.path.duration_s();
                    take.spans.push(Span {
                        kind: SpanKind::Repetition,
                        start_s,
                        end_s,
                        label: label.clone(),
                    });
                }
            }
        }
        take.activities.push((take.path.duration_s(), "to rest".to_owned()));
        for segment in way_home {
            take.path.push(segment.clone());
        }
        take.path.push(Segment::still(&self.rest, pause_s));
        take.activities.push((take.path.duration_s(), "at rest".to_owned()));
        take
    }

    fn plan_touch(
        &self,
        channel: usize,
        touch_idx: usize,
        here: &[f64],
        rng: &mut ChaCha8Rng,
    ) -> Option<PlannedTouch> {
        let motion = &self.emulation.truth.motion;
        let postures = Postures {
            rest: &self.rest,
            away: &self.emulation.positions(&motion.away, &self.rest),
            tilt_rad: motion.tilt_rad,
            retreat_m: motion.safe_clearance_m,
            depth_m: self.primitive.depth_m,
        };
        let actuators = &self.primitive.pressed_by;
        // Sides alternate from touch to touch and from take to take, and what presses does so half as often.
        let turn = touch_idx + self.take_idx;
        let from_above = turn % 2 == 1;
        let preferred = actuators[(turn / 2) % actuators.len()];
        let contacts = find_contacts(self.scene, channel, &postures, rng);
        // Every posture with the actuator whose turn it is, before any with another.
        for actuator in [preferred, Actuator::Carrier] {
            for contact in contacts.iter().take(MOST_POSTURES) {
                let Some(strokes) = Strokes::plan(self.scene, contact, self.primitive, actuator) else {
                    continue;
                };
                if let Some(way_in) = self.way_in(here, contact.link, &strokes, from_above) {
                    let link = contact.link;
                    let settles = !limb_dofs(self.scene, link).is_empty() && motion.settle_rad > 0.0;
                    return Some(PlannedTouch {
                        channel,
                        touch_idx,
                        link,
                        settles,
                        strokes,
                        way_in,
                        from_above,
                    });
                }
            }
            if actuator == Actuator::Carrier {
                break;
            }
        }
        None
    }

    /// From `here` to the hover of `strokes`, arriving from one side of the flexing joints.
    fn way_in(&self, here: &[f64], link: usize, strokes: &Strokes, from_above: bool) -> Option<Vec<Segment>> {
        let motion = &self.emulation.truth.motion;
        let robot = &self.scene.station.robot;
        let hover = strokes.hover();
        let apart = self.retreat(hover)?;
        // A smaller offset where the full one would touch something.
        for share in [1.0, 0.5, 0.0] {
            let settle = share * if from_above { motion.settle_rad } else { -motion.settle_rad };
            let mut side = apart.clone();
            for dof in limb_dofs(self.scene, link) {
                if robot.dofs().nth(dof).is_some_and(|joint| joint.kind == JointKind::Revolute) {
                    let (lower, upper) = ik::range(robot, dof);
                    side[dof] = (side[dof] + settle).clamp(lower, upper);
                }
            }
            let Some(last) = self.straight_if_clear(&side, hover) else { continue };
            if let Some(mut way) = self.way(here, &side) {
                way.push(last);
                return Some(way);
            }
        }
        None
    }

    /// A way between two positions on which every link stays clear: straight, over retreats, or over rest.
    fn way(&self, from: &[f64], to: &[f64]) -> Option<Vec<Segment>> {
        if let Some(direct) = self.straight_if_clear(from, to) {
            return Some(vec![direct]);
        }
        let (out, back) = (self.retreat(from), self.retreat(to));
        let over = |points: &[&[f64]]| -> Option<Vec<Segment>> {
            points.windows(2).map(|pair| self.straight_if_clear(pair[0], pair[1])).collect()
        };
        match (&out, &back) {
            (Some(out), Some(back)) => over(&[from, out, back, to])
                .or_else(|| over(&[from, out, &self.rest, back, to]))
                .or_else(|| over(&[from, &self.rest, back, to])),
            (None, Some(back)) => over(&[from, &self.rest, back, to]),
            (Some(out), None) => over(&[from, out, &self.rest, to]),
            (None, None) => over(&[from, &self.rest, to]),
        }
    }

    /// The same posture farther from the object: away from it as seen from the link that is nearest.
    fn retreat(&self, from: &[f64]) -> Option<Vec<f64>> {
        let robot = &self.scene.station.robot;
        let mut frames = Vec::new();
        robot.forward_kinematics(from, &mut frames);
        let layout = &self.scene.station.layout;
        let nearest = (0..layout.patches.len())
            .map(|patch| (patch, self.scene.patch_distance_m(patch, &frames[layout.patches[patch].link])))
            .min_by(|a, b| a.1.total_cmp(&b.1))?;
        let patch = &layout.patches[nearest.0];
        let pos = frames[patch.link] * patch.taxels_in_link[0];
        let outward = self
            .scene
            .surface
            .iter()
            .min_by(|a, b| (a.0 - pos).norm_squared().total_cmp(&(b.0 - pos).norm_squared()))?
            .1;
        let lift =
            nalgebra::Translation3::from(outward.into_inner() * self.emulation.truth.motion.safe_clearance_m);
        let pose = lift * frames[patch.link];
        let goal = ik::Goal {
            link: patch.link,
            pos_in_link: &patch.taxels_in_link[0],
            base_from_link: &pose,
            oriented: true,
        };
        let mut positions = from.to_vec();
        ik::solve(robot, &self.scene.station.carrier_dofs, &goal, &mut positions, &mut frames)
            .then_some(positions)
    }

    fn straight(&self, from: &[f64], to: &[f64]) -> Option<Segment> {
        let duration_s = travel_s(self.scene, from, to, self.emulation.truth.motion.speed_fraction);
        Some(Segment { duration_s, waypoints: vec![from.to_vec(), to.to_vec()] })
    }

    fn straight_if_clear(&self, from: &[f64], to: &[f64]) -> Option<Segment> {
        let robot = &self.scene.station.robot;
        let farthest = from.iter().zip(to).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        let steps = ((farthest / 0.06).ceil() as usize).clamp(4, 60);
        let mut frames = Vec::new();
        for step in 0..=steps {
            let fraction = step as f64 / steps as f64;
            let positions: Vec<f64> = from.iter().zip(to).map(|(a, b)| a + (b - a) * fraction).collect();
            robot.forward_kinematics(&positions, &mut frames);
            let clearance = self.scene.clearance(&frames, None);
            if clearance.others_m < TRANSIT_CLEARANCE_M {
                return None;
            }
        }
        self.straight(from, to)
    }

    fn error(&self, problem: String) -> EmulationError {
        self.emulation.error(format!("take {}", self.take_idx + 1), problem)
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use nalgebra::Isometry3;

    use super::*;
    use crate::session::scenes;
    use contact::NORMAL_TOLERANCE_RAD;

    fn emulation(name: &str) -> Emulation {
        let assets = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../assets/truth");
        Emulation::read(&assets.join(name)).expect("the shipped truth reads")
    }

    /// At each contact the taxel lies on the surface, facing it, and only its own links are near.
    #[test]
    fn contacts_meet_the_surface_squarely_within_limits() {
        for (truth, object, channels) in [
            ("demo.toml", "sphere_50mm", ["index_tip.4", "thumb_tip.5", "palm_ring", "thumb_distal"]),
            (
                "demo.toml",
                "cylinder_25x100mm",
                ["ring_tip.0", "middle_tip.6", "index_medial", "ring_proximal"],
            ),
            ("bench.toml", "sphere_50mm", ["cap.4", "cap.0", "film_2", "film_5"]),
        ] {
            let emulation = emulation(truth);
            let scenes = scenes(&emulation).expect("scenes");
            let scene = &scenes[object];
            let (robot, layout) = (&emulation.station.robot, &emulation.station.layout);
            let rest = emulation.rest();
            let motion = &emulation.truth.motion;
            for name in channels {
                let channel = emulation.channel(name).expect("a channel");
                let postures = Postures {
                    rest: &rest,
                    away: &emulation.positions(&motion.away, &rest),
                    tilt_rad: motion.tilt_rad,
                    retreat_m: motion.safe_clearance_m,
                    depth_m: 0.002,
                };
                let mut rng = ChaCha8Rng::seed_from_u64(1);
                let contacts = find_contacts(scene, channel, &postures, &mut rng);
                assert!(!contacts.is_empty(), "{truth}: no contact of {name}");
                for contact in contacts {
                    let mut frames: Vec<Isometry3<f64>> = Vec::new();
                    robot.forward_kinematics(&contact.positions, &mut frames);
                    let patch = &layout.patches[contact.patch];
                    let taxel = layout.channels[channel].taxel;
                    let taxel_pos = frames[patch.link] * patch.taxels_in_link[taxel];
                    let distance_m = scene.object.distance_m(&(scene.base_from_object.inverse() * taxel_pos));
                    assert!(distance_m.abs() < 0.2e-3, "{name}: {distance_m} m off the surface");
                    let facing =
                        frames[patch.link].rotation * patch.taxel_normals_in_link[taxel].into_inner();
                    let angle = facing.angle(&-contact.normal.into_inner());
                    assert!(angle <= NORMAL_TOLERANCE_RAD + 1e-3, "{name}: normals {angle} rad apart");
                    let clearance = scene.clearance(&frames, Some(patch.link));
                    assert!(clearance.others_m > 0.002, "{name}: {clearance:?}");
                    for (joint, position) in robot.dofs().zip(&contact.positions) {
                        let limits = joint.limits.expect("every joint has limits");
                        assert!((limits.lower..=limits.upper).contains(position), "{name}: {}", joint.name);
                    }
                }
            }
        }
    }

    /// Whole takes stay within limits of position and speed, and nothing but the pressed patch enters the object.
    #[test]
    fn takes_keep_limits_and_never_sweep_through_the_object() {
        for (truth, take_idx) in [("demo.toml", 0), ("demo.toml", 1), ("demo.toml", 3), ("bench.toml", 0)] {
            let emulation = emulation(truth);
            let take = &emulation.truth.takes[take_idx];
            let scenes = scenes(&emulation).expect("scenes");
            let scene = &scenes[&take.object];
            let plan = plan_take(&emulation, scene, take_idx).expect("the take can be planned");
            assert!((plan.path.duration_s() - take.duration_s).abs() < 1e-6);
            let robot = &emulation.station.robot;
            let mut now = vec![0.0; robot.num_dofs()];
            let mut before = emulation.rest();
            let mut frames = Vec::new();
            let dt_s = 0.02;
            for step in 0..(take.duration_s / dt_s) as usize {
                plan.path.at(step as f64 * dt_s, &mut now);
                for ((joint, now), before) in robot.dofs().zip(&now).zip(&before) {
                    let limits = joint.limits.expect("every joint has limits");
                    assert!((limits.lower..=limits.upper).contains(now), "{}: {now}", joint.name);
                    let speed = (now - before).abs() / dt_s;
                    assert!(speed <= limits.velocity, "{truth} take {take_idx}: {} at {speed}", joint.name);
                }
                robot.forward_kinematics(&now, &mut frames);
                let time_s = step as f64 * dt_s;
                let touching = plan.spans.iter().any(|span| {
                    span.kind == SpanKind::Repetition && (span.start_s..=span.end_s).contains(&time_s)
                });
                // A touching link enters by the depth of the press, and by as much as its collision shape is coarser
                // than its patch.
                let least_m = if touching { -0.0095 } else { 0.0 };
                let nearest_m = scene.clearance(&frames, None).others_m;
                assert!(nearest_m > least_m, "{truth} take {take_idx} at {time_s} s: {nearest_m} m");
                before.clone_from(&now);
            }
        }
    }
}
