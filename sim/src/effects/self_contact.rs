//! Fingers that touch each other.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

use nalgebra::{Isometry3, Point3};
use palpate_robot_model::{LinkTracker, Patch, Place, Robot, SensorKind, Station, TactileLayout};

use super::{Contact, Effect, EffectKind, Parameter, Stage, TakeScene, places};
use crate::geometry::SignedDistance;
use crate::replay::{NEAR_M, PatchTrace, Probe, ROUNDING_M};

/// Patches of one group also feel the collision shapes of the other's links, and the other way round. Links that a joint
/// connects do not count: they always touch.
pub(super) struct SelfContact;

impl EffectKind for SelfContact {
    fn id(&self) -> &'static str {
        "self_contact"
    }

    fn stage(&self) -> Stage {
        Stage::Contact
    }

    fn explain(&self, effect: &Effect, station: &Station) -> String {
        let likely = places::likely(effect.parameter("presence"));
        format!("{} feel each other where they touch{likely}.", places::title(&effect.place, station))
    }

    fn signature(&self) -> &'static str {
        "activations away from the object, only in postures that bring two fingers together"
    }

    fn mixes_channels(&self) -> bool {
        true
    }

    fn parameters(&self, _place: &Place, _station: &Station) -> Vec<Parameter> {
        Parameter::presence()
    }

    fn places(&self, station: &Station) -> Vec<Place> {
        let layout = &station.layout;
        let mut groups: Vec<&String> = Vec::new();
        for patch in &layout.patches {
            if !groups.contains(&&patch.group) {
                groups.push(&patch.group);
            }
        }
        let pairs = groups
            .iter()
            .enumerate()
            .flat_map(|(i, one)| groups[i + 1..].iter().map(move |other| (*one, *other)));
        let both =
            |(one, other): &(&String, &String)| !meetings(&station.robot, layout, one, other).is_empty();
        pairs.filter(both).map(|(one, other)| Place::Groups(vec![one.clone(), other.clone()])).collect()
    }

    fn contact(&self, effect: &Effect, scene: &TakeScene<'_>, state: &mut Contact<'_>) {
        let presence = effect.parameter("presence");
        let Place::Groups(groups) = &effect.place else { return };
        let [one, other] = &groups[..] else { return };
        if presence == 0.0 {
            return;
        }
        let mut meetings = meetings(&scene.station.robot, state.layout, one, other);
        meetings.retain(|meeting| state.needed[meeting.patch]);
        for (meeting, felt) in meetings.iter().zip(touches(&meetings, groups, scene, state)) {
            if felt.changes(&state.trace.patches[meeting.patch]) {
                let stiffness_pa_per_m = state.layout.patches[meeting.patch].stiffness_pa_per_m;
                let trace = Arc::make_mut(&mut state.trace.to_mut().patches[meeting.patch]);
                felt.add_to(trace, presence, stiffness_pa_per_m);
            }
        }
    }
}

/// What is felt at each of `meetings` between two `groups`.
fn touches(
    meetings: &[Meeting],
    groups: &[String],
    scene: &TakeScene<'_>,
    state: &Contact<'_>,
) -> Vec<Arc<Touches>> {
    let known = |meeting: &Meeting| state.touches.and_then(|touches| touches.get(groups, meeting.patch));
    if let Some(known) = meetings.iter().map(known).collect::<Option<Vec<_>>>() {
        return known;
    }
    let robot = &scene.station.robot;
    let prepared: Vec<PreparedMeeting> =
        meetings.iter().map(|meeting| PreparedMeeting::new(robot, state.layout, meeting)).collect();
    let mut felt: Vec<Touches> = prepared.iter().map(|_| Touches::new()).collect();
    let links = prepared
        .iter()
        .flat_map(|meeting| meeting.bodies.iter().map(|body| body.link).chain([meeting.probe.link]));
    let mut tracker = LinkTracker::new(robot, links, None);
    for (frame, positions) in state.positions.chunks_exact(robot.num_dofs().max(1)).enumerate() {
        let root_from_link = tracker.at(frame, positions);
        for (meeting, felt) in prepared.iter().zip(&mut felt) {
            meeting.feel(root_from_link, felt);
        }
    }
    let felt: Vec<Arc<Touches>> = felt.into_iter().map(Arc::new).collect();
    if let Some(touches) = state.touches {
        meetings.iter().zip(&felt).for_each(|(meeting, felt)| touches.put(groups, meeting.patch, felt));
    }
    felt
}

/// Touches by the groups that meet and the patch that feels it.
type ByMeeting = BTreeMap<(Vec<String>, usize), Arc<Touches>>;

/// What fingers feel of each other while joints and patches stay where they are, remembered.
#[derive(Clone, Debug, Default)]
pub struct FingerTouches(Arc<Mutex<ByMeeting>>);

impl FingerTouches {
    fn get(&self, groups: &[String], patch: usize) -> Option<Arc<Touches>> {
        let known = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        known.get(&(groups.to_vec(), patch)).cloned()
    }

    fn put(&self, groups: &[String], patch: usize, felt: &Arc<Touches>) {
        let mut known = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        known.insert((groups.to_vec(), patch), Arc::clone(felt));
    }
}

/// A patch and the links of the other group that it can meet.
struct Meeting {
    patch: usize,
    links: Vec<usize>,
}

fn meetings(robot: &Robot, layout: &TactileLayout, one: &str, other: &str) -> Vec<Meeting> {
    let links_of = |group: &str| -> Vec<usize> {
        let mut links: Vec<usize> =
            layout.patches.iter().filter(|patch| patch.group == group).map(|patch| patch.link).collect();
        links.sort_unstable();
        links.dedup();
        links
    };
    let joined = |a: usize, b: usize| {
        robot.joints.iter().any(|joint| [(a, b), (b, a)].contains(&(joint.parent_link, joint.child_link)))
    };
    let met_by = |(idx, patch): (usize, &Patch)| {
        let others = if patch.group == one {
            links_of(other)
        } else if patch.group == other {
            links_of(one)
        } else {
            return None;
        };
        let can_meet = |link: &usize| {
            *link != patch.link && !joined(*link, patch.link) && !robot.links[*link].collisions.is_empty()
        };
        let links: Vec<usize> = others.into_iter().filter(can_meet).collect();
        (!links.is_empty() && !patch.nodes.is_empty()).then_some(Meeting { patch: idx, links })
    };
    layout.patches.iter().enumerate().filter_map(met_by).collect()
}

/// A patch and what it can meet, prepared for many frames.
struct PreparedMeeting {
    probe: Probe,
    bodies: Vec<Body>,
}

/// A collision shape.
struct Body {
    link: usize,
    shape_from_link: Isometry3<f64>,
    center_in_link: Point3<f64>,
    distance: SignedDistance,
}

impl PreparedMeeting {
    fn new(robot: &Robot, layout: &TactileLayout, meeting: &Meeting) -> Self {
        let bodies_of = |&link: &usize| {
            robot.links[link].collisions.iter().map(move |body| Body {
                link,
                shape_from_link: body.link_from_shape.inverse(),
                center_in_link: body.link_from_shape.translation.vector.into(),
                distance: SignedDistance::of_link_shape(&body.shape),
            })
        };
        let probe = Probe::new(layout, &layout.patches[meeting.patch], f64::NEG_INFINITY);
        Self { probe, bodies: meeting.links.iter().flat_map(bodies_of).collect() }
    }

    /// Adds what is felt in one frame to `felt`.
    fn feel(&self, root_from_link: &[Isometry3<f64>], felt: &mut Touches) {
        let Probe { kind, nodes_in_link, center_in_link, radius_m, .. } = &self.probe;
        let first = felt.nodes.len();
        // A node that presses counts however deep others are; of those that do not, the nearest.
        let mut nearest_m = match kind {
            SensorKind::Pressure => 0.0,
            SensorKind::Proximity => NEAR_M,
        };
        let root_from_own = &root_from_link[self.probe.link];
        let center = root_from_own * center_in_link;
        for body in &self.bodies {
            let root_from_body = &root_from_link[body.link];
            let reach_m = nearest_m + radius_m + ROUNDING_M;
            let balls_reach_m = reach_m + body.distance.bounding_radius_m();
            let between = root_from_body * body.center_in_link - center;
            if between.norm_squared() >= balls_reach_m * balls_reach_m {
                continue;
            }
            let shape_from_own = body.shape_from_link * (root_from_body.inverse() * root_from_own);
            if body.distance.distance_m(&(shape_from_own * center_in_link)) >= reach_m {
                continue;
            }
            match kind {
                SensorKind::Proximity => {
                    nearest_m = body.distance.min_distance_below_m(&shape_from_own, nodes_in_link, nearest_m);
                }
                SensorKind::Pressure => {
                    let press = |node: usize, distance_m: f64| {
                        if distance_m < 0.0 {
                            felt.nodes.push((node as u32, -distance_m));
                        }
                    };
                    body.distance.for_each_distance_below(&shape_from_own, nodes_in_link, 0.0, press);
                }
            }
        }
        // A node inside of two bodies is as deep as in the deeper one.
        felt.nodes[first..].sort_unstable_by(|a, b| a.0.cmp(&b.0).then(b.1.total_cmp(&a.1)));
        let mut kept = first;
        for at in first..felt.nodes.len() {
            if kept == first || felt.nodes[kept - 1].0 != felt.nodes[at].0 {
                felt.nodes[kept] = felt.nodes[at];
                kept += 1;
            }
        }
        felt.nodes.truncate(kept);
        felt.ends.push(kept);
        felt.nearest_m.push(nearest_m);
    }
}

/// What a patch feels of another finger, frame by frame.
#[derive(Debug)]
struct Touches {
    /// Of a proximity patch, the smallest distance of its nodes, m; [`NEAR_M`] beyond that.
    nearest_m: Vec<f64>,
    /// Of a pressure patch, nodes inside of the other and how deep, m, nodes ascending within a frame.
    nodes: Vec<(u32, f64)>,
    /// Where each frame's nodes end.
    ends: Vec<usize>,
}

impl Touches {
    fn new() -> Self {
        Self { nearest_m: Vec::new(), nodes: Vec::new(), ends: Vec::new() }
    }

    /// Whether [`Self::add_to`] does anything. Most fingers never meet.
    fn changes(&self, trace: &PatchTrace) -> bool {
        match trace {
            PatchTrace::Proximity { min_distance_m, .. } => {
                min_distance_m.iter().zip(&self.nearest_m).any(|(distance_m, other_m)| distance_m > other_m)
            }
            PatchTrace::Pressure { .. } => !self.nodes.is_empty(),
        }
    }

    /// The nearer of the object and the other finger counts.
    fn add_to(&self, trace: &mut PatchTrace, presence: f64, stiffness_pa_per_m: f64) {
        match trace {
            PatchTrace::Proximity { min_distance_m, .. } => {
                for (distance_m, other_m) in min_distance_m.iter_mut().zip(&self.nearest_m) {
                    *distance_m -= presence * (*distance_m - other_m).max(0.0);
                }
            }
            PatchTrace::Pressure { offsets, entries } => {
                let mut merged_offsets = vec![0];
                let mut merged: Vec<(u32, f64)> = Vec::with_capacity(entries.len() + self.nodes.len());
                let mut from = 0;
                for (frame, &end) in self.ends.iter().enumerate() {
                    let own = &entries[PatchTrace::entry_range(offsets, frame)];
                    let pressed = self.nodes[from..end]
                        .iter()
                        .map(|&(node, depth_m)| (node, presence * depth_m * stiffness_pa_per_m));
                    let first = merged.len();
                    merged.extend(own.iter().copied().chain(pressed));
                    merged[first..].sort_unstable_by(|a, b| a.0.cmp(&b.0).then(b.1.total_cmp(&a.1)));
                    let mut kept = first;
                    for at in first..merged.len() {
                        if kept == first || merged[kept - 1].0 != merged[at].0 {
                            merged[kept] = merged[at];
                            kept += 1;
                        }
                    }
                    merged.truncate(kept);
                    merged_offsets.push(merged.len() as u32);
                    from = end;
                }
                (*offsets, *entries) = (merged_offsets, merged);
            }
        }
    }
}
