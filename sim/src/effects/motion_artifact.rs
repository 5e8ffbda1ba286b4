//! A sensor that answers to the motion of the hand.

use std::collections::BTreeMap;

use palpate_robot_model::{JointKind, Place, Station};

use super::{
    DynFrameEffect, Effect, EffectKind, Frame, FrameEffect, Load, Parameter, Stage, TakeScene, places,
};

/// The reading gains `load_s_per_rad` of the load that switches the channel on, for every rad/s of the fastest joint that
/// moves the channel's link: cables that pull, skin that inertia or a neighbouring link bends.
pub(super) struct MotionArtifact;

impl EffectKind for MotionArtifact {
    fn id(&self) -> &'static str {
        "motion_artifact"
    }

    fn stage(&self) -> Stage {
        Stage::Sensor
    }

    fn explain(&self, effect: &Effect, station: &Station) -> String {
        format!(
            "The {} reads {:.0} % of its threshold for every rad/s of its joints, without any touch.",
            places::name(&effect.place, station),
            effect.parameter("load_s_per_rad") * 1e2
        )
    }

    fn signature(&self) -> &'static str {
        "activations without contact that follow the speed of joints and stop with them"
    }

    fn uses_on_loads(&self) -> bool {
        true
    }

    fn parameters(&self, _place: &Place, _station: &Station) -> Vec<Parameter> {
        vec![Parameter::new("load_s_per_rad", 0.0..=10.0, 0.0, 0.15, 0.5)]
    }

    fn places(&self, station: &Station) -> Vec<Place> {
        let moves = |stream: &usize| {
            let mut patches = station.layout.patches.iter().filter(|patch| patch.stream == *stream);
            patches.any(|patch| !turning_dofs(patch.link, station).is_empty())
        };
        let streams = (0..station.layout.streams.len()).filter(moves);
        streams.map(|stream| Place::Stream(station.layout.streams[stream].id.clone())).collect()
    }

    fn load(&self, effect: &Effect, scene: &TakeScene<'_>, state: &mut Load) {
        let load_s_per_rad = effect.parameter("load_s_per_rad");
        if load_s_per_rad == 0.0 {
            return;
        }
        let layout = &scene.station.layout;
        let mut speeds_by_link = vec![None; scene.station.robot.links.len()];
        for patch in places::patches_of(&effect.place, layout) {
            let patch = &layout.patches[patch];
            let speeds = speeds_by_link[patch.link].get_or_insert_with(|| fastest(patch.link, scene));
            for channel in patch.channels.clone() {
                let per_speed = load_s_per_rad * state.on_loads[channel];
                let loads = state.of_channel_mut(channel).iter_mut().zip(speeds.iter());
                loads.for_each(|(load, speed)| *load += per_speed * speed);
            }
        }
    }

    fn looks_ahead(&self) -> bool {
        true
    }

    fn load_by_frame(&self, effect: &Effect, station: &Station, on_loads: &[f64]) -> Option<DynFrameEffect> {
        let load_s_per_rad = effect.parameter("load_s_per_rad");
        if load_s_per_rad == 0.0 {
            return None;
        }
        let mut by_link: BTreeMap<usize, MovedLink> = BTreeMap::new();
        for patch in places::patches_of(&effect.place, &station.layout) {
            let patch = &station.layout.patches[patch];
            let moved = by_link.entry(patch.link).or_insert_with(|| MovedLink {
                dofs: turning_dofs(patch.link, station),
                channels: Vec::new(),
            });
            let per_speed = |channel: usize| (channel, load_s_per_rad * on_loads[channel]);
            moved.channels.extend(patch.channels.clone().map(per_speed));
        }
        Some(Box::new(Pull(by_link.into_values().collect())))
    }
}

/// A link that carries patches.
#[derive(Debug)]
struct MovedLink {
    /// That move it.
    dofs: Vec<usize>,
    /// On it, and what each reads more for every rad/s.
    channels: Vec<(usize, f64)>,
}

#[derive(Debug)]
struct Pull(Vec<MovedLink>);

impl FrameEffect for Pull {
    fn step(&self, frame: &Frame<'_>, _memory: &mut [f64], loads: &mut [f64]) {
        let gap_s = frame.time_s - frame.before_s;
        let travel = |dof: usize| frame.positions[dof] - frame.positions_before[dof];
        for link in &self.0 {
            let furthest = link.dofs.iter().map(|&dof| travel(dof).abs()).fold(0.0, f64::max);
            let speed = if gap_s > 0.0 { furthest / gap_s } else { 0.0 };
            for &(channel, per_speed) in &link.channels {
                loads[channel] += per_speed * speed;
            }
        }
    }
}

/// Degrees of freedom between the root and `link` that turn.
fn turning_dofs(link: usize, station: &Station) -> Vec<usize> {
    let joints = &station.robot.joints;
    // A joint moves the link after it in the list; the root has none.
    let up = |&link: &usize| link.checked_sub(1).map(|joint| joints[joint].parent_link);
    std::iter::successors(Some(link), up)
        .filter_map(|link| joints.get(link.checked_sub(1)?))
        .filter(|joint| joint.kind == JointKind::Revolute)
        .filter_map(|joint| joint.dof)
        .collect()
}

/// Speed of the fastest joint that moves `link`, rad/s, frame by frame: central differences over the measured path.
fn fastest(link: usize, scene: &TakeScene<'_>) -> Vec<f64> {
    let dofs = turning_dofs(link, scene.station);
    let (times_s, num_dofs) = (scene.frame_times_s, scene.station.robot.num_dofs());
    (0..times_s.len())
        .map(|frame| {
            let (before, after) = (frame.saturating_sub(1), (frame + 1).min(times_s.len() - 1));
            let gap_s = times_s[after] - times_s[before];
            let travel = |dof: usize| {
                scene.positions[after * num_dofs + dof] - scene.positions[before * num_dofs + dof]
            };
            let furthest = dofs.iter().map(|&dof| travel(dof).abs()).fold(0.0, f64::max);
            if gap_s > 0.0 { furthest / gap_s } else { 0.0 }
        })
        .collect()
}
