//! From a take of a plan to joint positions over time.

use palpate_recording::{Span, SpanKind};
use palpate_robot_model::{JointKind, Station, ik};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use crate::closing::{Closing, find_closings, is_carried};
use crate::contact::{Postures, find_contacts, limb_dofs};
use crate::limits::outside;
use crate::path::{JointPath, Segment};
use crate::primitive::{Actuator, Motion, Primitive, Primitives};
use crate::touch::{Strokes, travel_s};
use crate::{MotionLimits, Plan, PlanError, PlannedTake, Scene, channel_named};

/// Postures that are tried for one touch before giving up.
const MOST_POSTURES: usize = 12;
/// Every link stays this far from the object between touches, m.
const TRANSIT_CLEARANCE_M: f64 = 0.003;
/// A way may begin with the skin pressed this far into the object, m: more than a touch presses it in.
const DEEPEST_START_M: f64 = 0.005;

/// The motion of one take, from rest to rest.
#[derive(Clone, Debug)]
pub struct TakeMotion {
    /// Where the joints are, at any time.
    path: JointPath,
    /// Baseline and repetitions.
    pub spans: Vec<Span>,
    /// What is being done from which time on, s.
    pub activities: Vec<(f64, String)>,
    /// Channels that are touched, each once, in order.
    pub touches: Vec<usize>,
}

impl TakeMotion {
    /// Duration, s.
    pub fn duration_s(&self) -> f64 {
        self.path.duration_s()
    }

    /// Fills in the positions at `time_s` since the start, one for each degree of freedom in the station's order.
    /// Before the start and after the end the robot stands still.
    pub fn at(&self, time_s: f64, positions: &mut [f64]) {
        self.path.at(time_s, positions);
    }

    /// Positions at the start.
    pub fn start(&self) -> &[f64] {
        self.path.start()
    }

    /// What is being done at `time_s`, for people.
    pub fn activity(&self, time_s: f64) -> &str {
        let doing = self.activities.partition_point(|(from_s, _)| *from_s <= time_s).saturating_sub(1);
        self.activities.get(doing).map_or("", |(_, activity)| activity)
    }
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
    /// From the last hover to where the next way begins; empty where that is the hover.
    way_out: Vec<Segment>,
    /// Whether flexing joints arrive from above their final position.
    from_above: bool,
}

impl PlannedTouch {
    /// Where the robot is afterwards.
    fn end(&self) -> &[f64] {
        self.way_out.last().map_or(self.strokes.hover(), Segment::end)
    }
}

/// Plans the take at `take_idx` of `plan` on `station`. Primitives that the plan does not hold come from `primitives`.
///
/// With `limits` the motion keeps below nine tenths of every speed and acceleration, lasts at least the take's `duration_s`,
/// and stays within the positions and the workspace of the station's safety section. Without, it is as the plan says, and
/// refused where the time is too short. Same arguments, same motion, to the bit.
pub fn plan_take(
    station: &Station,
    plan: &Plan,
    primitives: &Primitives,
    take_idx: usize,
    limits: Option<&MotionLimits>,
) -> Result<TakeMotion, PlanError> {
    in_scene(station, plan, take_idx, limits, |scene| plan_in(scene, plan, primitives, take_idx, limits))
}

/// Plans the way from `from`, where the robot is, to where the take at `take_idx` starts, clear of the take's object all
/// along: straight, or over a retreat from the object. It has neither spans nor touches. `limits` are kept as
/// [`plan_take`] keeps them, except by what `from` itself is beyond the limits of position.
///
/// Refused where no such way is found, as when the robot touches the object: somebody has to move it away first.
pub fn plan_approach(
    station: &Station,
    plan: &Plan,
    primitives: &Primitives,
    take_idx: usize,
    from: &[f64],
    limits: Option<&MotionLimits>,
) -> Result<TakeMotion, PlanError> {
    in_scene(station, plan, take_idx, limits, |scene| {
        Planner::new(scene, plan, primitives, take_idx, limits)?.approach(from)
    })
}

/// Plans `motion` in the scene of the take at `take_idx`, within `limits`.
fn in_scene(
    station: &Station,
    plan: &Plan,
    take_idx: usize,
    limits: Option<&MotionLimits>,
    motion: impl FnOnce(&Scene<'_>) -> Result<TakeMotion, PlanError>,
) -> Result<TakeMotion, PlanError> {
    let narrowed = limits.map(|limits| limits.narrow(station, &plan.file)).transpose()?;
    let station = narrowed.as_ref().unwrap_or(station);
    plan.check(station)?;
    motion(&plan.scene(station, &take_at(plan, take_idx)?.object)?)
}

/// [`plan_take`] in a scene that is there already, with the object of the take, for a plan that was
/// [checked](Plan::check). Positions stay within the limits of the scene's robot.
pub fn plan_in(
    scene: &Scene<'_>,
    plan: &Plan,
    primitives: &Primitives,
    take_idx: usize,
    limits: Option<&MotionLimits>,
) -> Result<TakeMotion, PlanError> {
    Planner::new(scene, plan, primitives, take_idx, limits)?.plan()
}

fn take_at(plan: &Plan, take_idx: usize) -> Result<&PlannedTake, PlanError> {
    plan.takes.get(take_idx).ok_or_else(|| {
        let place = format!("take {}", take_idx + 1);
        PlanError::new(&plan.file, place, format!("the plan has {} takes", plan.takes.len()))
    })
}

struct Planner<'a> {
    plan: &'a Plan,
    scene: &'a Scene<'a>,
    take_idx: usize,
    take: &'a PlannedTake,
    primitive: &'a Primitive,
    limits: Option<&'a MotionLimits>,
    rest: Vec<f64>,
    away: Vec<f64>,
}

impl<'a> Planner<'a> {
    fn new(
        scene: &'a Scene<'a>,
        plan: &'a Plan,
        primitives: &'a Primitives,
        take_idx: usize,
        limits: Option<&'a MotionLimits>,
    ) -> Result<Self, PlanError> {
        let take = take_at(plan, take_idx)?;
        let primitive = plan.primitive(&take.primitive, primitives)?;
        let (rest, away) = (plan.rest(scene.station), plan.away(scene.station));
        Ok(Self { plan, scene, take_idx, take, primitive, limits, rest, away })
    }

    fn approach(&self, from: &[f64]) -> Result<TakeMotion, PlanError> {
        if from.len() != self.rest.len() {
            let problem = format!("{} positions to start from, expected {}", from.len(), self.rest.len());
            return Err(self.error(problem));
        }
        for (joint, position) in self.scene.station.robot.dofs().zip(from) {
            if !position.is_finite() {
                let problem = format!("joint {:?} is at {position}: wait for its first reading", joint.name);
                return Err(self.error(problem));
            }
        }
        let way = self.way(from, &self.rest).ok_or_else(|| {
            self.error(format!(
                "found no way to the start that stays {:.0} mm clear of {:?}: move the robot away from it by hand or \
                 by jogging, then try again",
                TRANSIT_CLEARANCE_M * 1e3,
                self.take.object
            ))
        })?;
        let mut motion = TakeMotion {
            path: JointPath::default(),
            spans: Vec::new(),
            activities: vec![(0.0, "to the start".to_owned())],
            touches: Vec::new(),
        };
        for segment in way {
            self.add(&mut motion.path, segment);
        }
        self.within_workspace(motion)
    }

    /// Adds a segment, as slow as the limits want it.
    fn add(&self, path: &mut JointPath, segment: Segment) {
        path.push(match self.limits {
            Some(limits) => limits.slowed(segment),
            None => segment,
        });
    }

    fn within_workspace(&self, motion: TakeMotion) -> Result<TakeMotion, PlanError> {
        match self.limits.and_then(|_| outside(self.scene.station, &motion)) {
            Some(problem) => Err(self.error(problem)),
            None => Ok(motion),
        }
    }

    fn plan(&self) -> Result<TakeMotion, PlanError> {
        let mut rng = ChaCha8Rng::seed_from_u64(self.plan.seed);
        rng.set_stream(1 + self.take_idx as u64);
        let mut touches: Vec<PlannedTouch> = Vec::new();
        let mut here = self.rest.clone();
        for (touch_idx, name) in self.take.touch.iter().enumerate() {
            let channel = channel_named(self.scene.station, name)
                .ok_or_else(|| self.error(format!("touch: the layout has no channel or patch {name:?}")))?;
            let touch = self.plan_touch(channel, touch_idx, &here, &mut rng).ok_or_else(|| {
                self.error(format!(
                    "found no way to touch {:?} with {name:?} without other links touching: move the object, or \
                     change motion.rest, motion.away or motion.tilt_rad",
                    self.take.object
                ))
            })?;
            here = touch.end().to_vec();
            let other_side = (self.primitive.both_sides && touch.settles).then(|| {
                let from_above = !touch.from_above;
                let way_in = self.way_in(&here, touch.link, &touch.strokes, from_above)?;
                let (strokes, way_out) = (touch.strokes.clone(), Vec::new());
                Some(PlannedTouch { strokes, way_in, way_out, from_above, ..touch })
            });
            touches.push(touch);
            touches.extend(other_side.flatten());
        }
        let way_home =
            self.way(&here, &self.rest).ok_or_else(|| self.error("found no way back to rest".into()))?;

        // First without pauses, to see how much time is left for them.
        let needed_s = self.assemble(&touches, &way_home, 0.0).path.duration_s();
        let spare_s = self.take.duration_s - needed_s;
        if spare_s < 0.0 && self.limits.is_none() {
            return Err(self.error(format!(
                "{} touches need {needed_s:.1} s, duration_s is {}: touch less, or make the primitive faster",
                touches.len(),
                self.take.duration_s
            )));
        }
        self.within_workspace(self.assemble(
            &touches,
            &way_home,
            spare_s.max(0.0) / (touches.len() + 1) as f64,
        ))
    }

    /// Puts the take together with a pause of `pause_s` before each touch.
    fn assemble(&self, touches: &[PlannedTouch], way_home: &[Segment], pause_s: f64) -> TakeMotion {
        let baseline_s = self.plan.motion.baseline_s;
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
            touches: Vec::new(),
        };
        self.add(&mut take.path, Segment::still(&self.rest, baseline_s));
        for touch in touches {
            let layout = &self.scene.station.layout;
            let (place, name) = (&layout.channels[touch.channel].id, layout.channel_label(touch.channel));
            take.activities.push((take.path.duration_s(), format!("to {name}")));
            if let Some(first) = touch.way_in.first() {
                self.add(&mut take.path, Segment::still(&first.waypoints[0], pause_s));
            }
            for segment in &touch.way_in {
                self.add(&mut take.path, segment.clone());
            }
            take.activities.push((take.path.duration_s(), format!("{}, {name}", self.primitive.label)));
            if !take.touches.contains(&touch.channel) {
                take.touches.push(touch.channel);
            }
            for speed in self.primitive.speeds_of(touch.touch_idx) {
                let by = match touch.strokes.actuator {
                    Actuator::Carrier => "carrier",
                    Actuator::Limb => "limb",
                };
                let side = if touch.from_above { "above" } else { "below" };
                let label = format!("{} {place} {} by {by} from {side}", self.take.primitive, speed.id);
                for _ in 0..self.primitive.repetitions {
                    let start_s = take.path.duration_s();
                    for segment in touch.strokes.repetition(self.primitive, speed) {
                        self.add(&mut take.path, segment);
                    }
                    self.add(&mut take.path, Segment::still(touch.strokes.hover(), self.primitive.gap_s));
                    let end_s = take.path.duration_s();
                    take.spans.push(Span {
                        kind: SpanKind::Repetition,
                        start_s,
                        end_s,
                        label: label.clone(),
                    });
                }
            }
            for segment in &touch.way_out {
                self.add(&mut take.path, segment.clone());
            }
        }
        take.activities.push((take.path.duration_s(), "to rest".to_owned()));
        for segment in way_home {
            self.add(&mut take.path, segment.clone());
        }
        self.add(&mut take.path, Segment::still(&self.rest, pause_s));
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
        let motion = &self.plan.motion;
        let postures = Postures {
            rest: &self.rest,
            away: &self.away,
            tilt_rad: motion.tilt_rad,
            retreat_m: motion.safe_clearance_m,
            depth_m: self.primitive.depth_m,
        };
        let actuators = &self.primitive.pressed_by;
        // Sides alternate from touch to touch and from take to take, and what presses does so half as often.
        let turn = touch_idx + self.take_idx;
        let from_above = turn % 2 == 1;
        let preferred = actuators[(turn / 2) % actuators.len()];
        let contacts = match is_carried(self.scene) {
            true => find_contacts(self.scene, channel, &postures, rng),
            false => Vec::new(),
        };
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
                        way_out: Vec::new(),
                        from_above,
                    });
                }
            }
            if actuator == Actuator::Carrier {
                break;
            }
        }
        self.close_on(channel, touch_idx, here, &postures, rng)
    }

    /// A touch for which nothing has to carry the hand: its limb closes on the object.
    fn close_on(
        &self,
        channel: usize,
        touch_idx: usize,
        here: &[f64],
        postures: &Postures<'_>,
        rng: &mut ChaCha8Rng,
    ) -> Option<PlannedTouch> {
        if self.primitive.motion != Motion::Press || !self.primitive.pressed_by.contains(&Actuator::Limb) {
            return None;
        }
        let closings = find_closings(self.scene, channel, self.primitive, postures, rng);
        closings.into_iter().find_map(|closing| {
            let hover = closing.strokes.hover();
            let closes = self.straight_if_clear(&closing.apart, hover)?;
            let mut way_in = self.way(here, &closing.apart)?;
            self.way(&closing.apart, &self.rest)?;
            let way_out = vec![closes.reversed()];
            way_in.push(closes);
            let Closing { link, strokes, from_above, .. } = closing;
            Some(PlannedTouch {
                channel,
                touch_idx,
                link,
                settles: false,
                strokes,
                way_in,
                way_out,
                from_above,
            })
        })
    }

    /// From `here` to the hover of `strokes`, arriving from one side of the flexing joints.
    fn way_in(&self, here: &[f64], link: usize, strokes: &Strokes, from_above: bool) -> Option<Vec<Segment>> {
        let motion = &self.plan.motion;
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
            robot.follow(&mut side);
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
        let lift = nalgebra::Translation3::from(outward.into_inner() * self.plan.motion.safe_clearance_m);
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
        let duration_s = travel_s(self.scene, from, to, self.plan.motion.speed_fraction);
        Some(Segment { duration_s, waypoints: vec![from.to_vec(), to.to_vec()] })
    }

    /// The straight way, if it is clear all along. One that begins too close to the object, as where a touch was broken
    /// off, has to get away from it at every step until it is clear; deep inside there is no telling which way is out.
    fn straight_if_clear(&self, from: &[f64], to: &[f64]) -> Option<Segment> {
        let robot = &self.scene.station.robot;
        let farthest = from.iter().zip(to).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        let steps = ((farthest / 0.06).ceil() as usize).clamp(8, 60);
        let mut frames = Vec::new();
        let mut needed_m = None;
        for step in 0..=steps {
            let fraction = step as f64 / steps as f64;
            let positions: Vec<f64> = from.iter().zip(to).map(|(a, b)| a + (b - a) * fraction).collect();
            robot.forward_kinematics(&positions, &mut frames);
            let clearance_m = self.scene.clearance(&frames, None).others_m;
            if clearance_m < needed_m.unwrap_or(-DEEPEST_START_M) {
                return None;
            }
            needed_m = Some(clearance_m.min(TRANSIT_CLEARANCE_M));
        }
        needed_m.filter(|ends_m| *ends_m >= TRANSIT_CLEARANCE_M)?;
        self.straight(from, to)
    }

    fn error(&self, problem: String) -> PlanError {
        PlanError::new(&self.plan.file, format!("take {}", self.take_idx + 1), problem)
    }
}

#[cfg(test)]
mod tests;
