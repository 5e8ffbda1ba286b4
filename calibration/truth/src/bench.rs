//! The blind bench's catalogue: what is hidden, how strongly and where, drawn from a seed.

use std::ops::Range;

use palpate_recording::Take;
use palpate_robot_model::{ObjectShape, Place, SensorKind, Station};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use crate::EmulationError;
use crate::hidden::Hidden;
use crate::noise::gaussian;
use crate::secrets::limb_dofs;
use crate::stage::Stage;

/// How strongly an effect is hidden.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Strength {
    /// Not much above the smallest size that matters.
    Weak,
    /// Two to three times that.
    Medium,
    /// Plain to see; the only strength of effects that are there or not.
    Strong,
}

/// What a case asks of a diagnosis.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Expected {
    /// Nothing is hidden.
    Nothing,
    /// What is hidden is in the library: it should be named.
    Named,
    /// What is hidden is in no library: it should be said that something is there and has no name.
    Unexplained,
}

/// One session of the bench. Whoever diagnoses it sees the takes alone; the rest is for scoring.
#[derive(Clone, Debug, PartialEq)]
pub struct Case {
    /// Name for tables: effects and strength.
    pub label: String,
    /// What is hidden.
    pub hidden: Vec<Hidden>,
    /// `None` without effects and for pairs.
    pub strength: Option<Strength>,
    /// What the right answer is.
    pub expected: Expected,
    /// Seed for [`Stage::record`].
    pub seed: u64,
}

/// Effects with three strengths, in the order of the sensing chain.
const GRADED: &[&str] = &[
    "joint_offset",
    "joint_backlash",
    "object_pose_offset",
    "object_scale",
    "sensor_mount_offset",
    "sensitivity_spread",
    "elastic_crosstalk",
    "rate_dependence",
    "preload",
    "viscoelastic_release",
    "threshold_hysteresis",
    "low_pass",
    "baseline_drift",
    "motion_artifact",
    "electrical_crosstalk",
    "debounce",
    "latency",
    "clock_skew",
    "sample_hold",
];
/// Effects that are there or not. Fingers that feel each other (`self_contact`) are left out: in the motions that are
/// planned here no finger comes near another, so that nobody could find it.
const PLAIN: &[&str] = &["dead_channel", "stuck_channel", "swapped_channels", "integer_wrap"];
const OUTSIDE: &[&str] = &["mains_hum", "snagged_cable", "joint_dependent_gain"];
/// Pairs of different stages of the chain.
const PAIRS: &[[&str; 2]] = &[
    ["latency", "joint_offset"],
    ["low_pass", "sensitivity_spread"],
    ["joint_backlash", "latency"],
    ["object_pose_offset", "threshold_hysteresis"],
    ["electrical_crosstalk", "joint_offset"],
    ["baseline_drift", "latency"],
    ["viscoelastic_release", "sensor_mount_offset"],
    ["dead_channel", "low_pass"],
];

/// One round of the bench on `stage`: every effect at each of its strengths, pairs, effects outside any library, and as
/// many sessions with nothing hidden as `nulls`. Places and noise are drawn from `seed`.
///
/// What sits in one patch or channel is hidden where the session touches often enough for it to show
/// ([`LEAST_TOUCHES`] in [`LEAST_TAKES`]), a spread in streams of which it touches [`LEAST_FELT`] so, backlash in joints that it
/// turns by [`LEAST_TURN_RAD`], a snag beyond an angle that a joint passes in [`LEAST_TAKES`].
pub fn cases(stage: &Stage, nulls: usize, seed: u64) -> Result<Vec<Case>, EmulationError> {
    let mut draw = Draw {
        stage,
        station: stage.station(),
        exercised: Exercised::by(&stage.record(&[], seed)?, stage.station()),
        rng: ChaCha8Rng::seed_from_u64(seed),
    };
    let mut cases = Vec::new();
    let strengths = [Strength::Weak, Strength::Medium, Strength::Strong];
    let singles = [(GRADED, Expected::Named), (PLAIN, Expected::Named), (OUTSIDE, Expected::Unexplained)];
    for (ids, expected) in singles {
        for id in ids {
            for strength in strengths {
                if ids != PLAIN || strength == Strength::Strong {
                    let hidden = vec![draw.effect(id, strength)];
                    let label = format!("{id} {}", format!("{strength:?}").to_lowercase());
                    cases.push(draw.case(label, hidden, Some(strength), expected));
                }
            }
        }
    }
    for pair in PAIRS {
        let hidden = pair.map(|id| draw.effect(id, Strength::Medium)).to_vec();
        cases.push(draw.case(pair.join(" and "), hidden, None, Expected::Named));
    }
    // Last, so that what is hidden elsewhere does not depend on how many there are.
    for _ in 0..nulls {
        cases.push(draw.case("nothing".into(), Vec::new(), None, Expected::Nothing));
    }
    Ok(cases)
}

/// Onsets of touch that a channel needs in a session for what is hidden in it to show.
const LEAST_TOUCHES: usize = 4;
/// Takes that must hold some of them: a diagnosis keeps some takes back.
const LEAST_TAKES: usize = 3;
/// Share of the channels of a stream that must be touched so for a spread over them to show.
const LEAST_FELT: f64 = 0.5;
/// Turn of a joint within the session that shows its backlash, rad.
const LEAST_TURN_RAD: f64 = 0.1;
/// How far beyond its angle at rest a joint snags a cable, rad.
const SNAG_BEYOND_REST_RAD: f64 = 0.1;

/// What a session exercises.
struct Exercised {
    /// Per channel.
    touched: Vec<bool>,
    /// Least and highest angle in each take, rad, per degree of freedom.
    angles_rad: Vec<Vec<[f64; 2]>>,
}

impl Exercised {
    fn by(takes: &[Take], station: &Station) -> Self {
        let layout = &station.layout;
        let touched = layout.channels.iter().enumerate().map(|(idx, channel)| {
            let stream = &layout.streams[channel.stream];
            let (width, at) = (stream.channels.len(), idx - stream.channels.start);
            let onsets = |take: &Take| {
                let active = &take.streams[channel.stream].active;
                let own: Vec<bool> = active.iter().skip(at).step_by(width).copied().collect();
                own.windows(2).filter(|pair| !pair[0] && pair[1]).count()
            };
            let onsets: Vec<usize> = takes.iter().map(onsets).collect();
            onsets.iter().sum::<usize>() >= LEAST_TOUCHES
                && onsets.iter().filter(|onsets| **onsets > 0).count() >= LEAST_TAKES
        });
        let num_dofs = station.robot.num_dofs();
        let in_take = |take: &Take, dof: usize| {
            let angles = take.joints.positions.iter().skip(dof).step_by(num_dofs);
            angles.fold([f64::INFINITY, f64::NEG_INFINITY], |[least, most], x| [least.min(*x), most.max(*x)])
        };
        let angles_rad = (0..num_dofs).map(|dof| takes.iter().map(|take| in_take(take, dof)).collect());
        Self { touched: touched.collect(), angles_rad: angles_rad.collect() }
    }

    /// Whether the degree of freedom turns far enough for backlash to show.
    fn is_turned(&self, dof: usize) -> bool {
        let angles = &self.angles_rad[dof];
        let least = angles.iter().map(|[least, _]| *least).fold(f64::INFINITY, f64::min);
        let most = angles.iter().map(|[_, most]| *most).fold(f64::NEG_INFINITY, f64::max);
        most - least >= LEAST_TURN_RAD
    }

    /// Whether the degree of freedom passes an angle in enough takes for what happens there to show.
    fn passes(&self, dof: usize, angle_rad: f64) -> bool {
        self.angles_rad[dof].iter().filter(|[_, most]| *most > angle_rad).count() >= LEAST_TAKES
    }

    /// Those of streams with these `channels` of which enough are touched.
    fn felt(&self, channels: &[Range<usize>]) -> Vec<usize> {
        let is_felt = |idx: &usize| {
            let touched = &self.touched[channels[*idx].clone()];
            touched.iter().filter(|touched| **touched).count() as f64 >= LEAST_FELT * touched.len() as f64
        };
        (0..channels.len()).filter(is_felt).collect()
    }
}

struct Draw<'a> {
    stage: &'a Stage,
    station: &'a Station,
    exercised: Exercised,
    rng: ChaCha8Rng,
}

impl Draw<'_> {
    fn case(
        &mut self,
        label: String,
        hidden: Vec<Hidden>,
        strength: Option<Strength>,
        expected: Expected,
    ) -> Case {
        Case { label, hidden, strength, expected, seed: self.rng.random::<u64>() }
    }

    fn effect(&mut self, id: &str, strength: Strength) -> Hidden {
        let [weak, medium, strong] =
            [Strength::Weak, Strength::Medium, Strength::Strong].map(|s| s == strength);
        let of = |sizes: [f64; 3]| {
            let picked = sizes.into_iter().zip([weak, medium, strong]).find(|(_, picked)| *picked);
            picked.map_or(sizes[2], |(size, _)| size)
        };
        let (stream, on_threshold) = self.stream();
        let one = |name, value| vec![(name, value)];
        let (place, sizes): (Place, Vec<(&str, f64)>) = match id {
            "joint_offset" => {
                let size = self.sign() * of([0.006, 0.012, 0.025]);
                (Place::Joint(self.joint()), one("offset", size))
            }
            "joint_backlash" => (Place::Joint(self.turned_joint()), one("width", of([0.010, 0.020, 0.040]))),
            "object_pose_offset" => {
                let object = self.object();
                let shift = self.shift(&object, of([0.0005, 0.001, 0.002]));
                (Place::Object(object), shift)
            }
            "object_scale" => {
                (Place::Object(self.object()), one("factor", 1.0 + self.sign() * of([0.01, 0.02, 0.04])))
            }
            "sensor_mount_offset" => {
                let patch = self.patch(Some(SensorKind::Pressure));
                let shift = self.along(patch, of([0.0008, 0.0016, 0.003]));
                (Place::Patch(self.station.layout.patches[patch].id.clone()), shift)
            }
            "sensitivity_spread" => {
                let draw = f64::from(self.rng.random::<u32>());
                (
                    Place::Stream(self.felt_stream(stream)),
                    vec![("spread", of([0.1, 0.2, 0.4])), ("draw", draw)],
                )
            }
            "elastic_crosstalk" => {
                // In one patch: along all of a stream it is what calibration fits anyway.
                let patch = self.patch(Some(SensorKind::Pressure));
                let id = self.station.layout.patches[patch].id.clone();
                (Place::Patch(id), one("added_m", of([0.0012, 0.0018, 0.0025])))
            }
            "rate_dependence" => {
                // It belongs to the penalty force, which only pressure patches have.
                (Place::Stream(self.pressure_stream()), one("damping_s", of([0.02, 0.05, 0.1])))
            }
            "preload" => {
                let patch = self.patch(None);
                let id = self.station.layout.patches[patch].id.clone();
                (Place::Patch(id), one("depth_m", of([0.0003, 0.0006, 0.001])))
            }
            "viscoelastic_release" => (
                Place::Stream(stream),
                vec![("fraction", of([0.15, 0.3, 0.5])), ("time_s", of([0.15, 0.25, 0.4]))],
            ),
            "threshold_hysteresis" => (Place::Stream(stream), one("off_fraction", of([0.55, 0.4, 0.25]))),
            "low_pass" => (Place::Stream(stream), one("time_s", of([0.025, 0.060, 0.120]))),
            // In units of the threshold: after a minute half of it, all of it, twice.
            "baseline_drift" => {
                (Place::Stream(stream), one("rate_raw_per_s", of([0.008, 0.016, 0.032]) * on_threshold))
            }
            "motion_artifact" => {
                (Place::Stream(stream), one("raw_s_per_rad", of([0.6, 1.2, 2.4]) * on_threshold))
            }
            "electrical_crosstalk" => (Place::Stream(stream), one("leak", of([0.05, 0.1, 0.2]))),
            "dead_channel" | "integer_wrap" => (Place::Channel(self.channel()), Vec::new()),
            "stuck_channel" => {
                let idx = self.channel_idx();
                let stream = self.station.layout.channels[idx].stream;
                let rise = 2.0 * self.station.streams[stream].on_threshold;
                (Place::Channel(self.station.layout.channels[idx].id.clone()), one("rise_raw", rise))
            }
            "swapped_channels" => (Place::Channels(self.pair()), Vec::new()),
            "debounce" => (Place::Stream(stream), one("min_on_s", of([0.05, 0.1, 0.2]))),
            "latency" => (Place::Stream(stream), one("delay_s", of([0.025, 0.050, 0.100]))),
            "clock_skew" => (Place::Stream(stream), one("skew", self.sign() * of([0.0008, 0.0016, 0.003]))),
            "sample_hold" => (
                Place::Stream(stream),
                vec![("hold_s", of([0.15, 0.3, 0.6])), ("every_s", of([2.0, 2.0, 1.5]))],
            ),
            "mains_hum" => (Place::Stream(stream), one("amplitude_raw", of([0.1, 0.25, 0.5]) * on_threshold)),
            "snagged_cable" => {
                let (joint, beyond_rad) = self.snagging_joint();
                let sizes = [("beyond", beyond_rad), ("offset_raw", of([0.3, 0.7, 1.5]) * on_threshold)];
                return Hidden::new(id, Place::Stream(stream), &sizes).driven_by(&joint);
            }
            _ => {
                let (joint, group) = self.bending();
                let sizes = [("per_rad", self.sign() * of([0.3, 0.6, 1.2])), ("middle", self.rest(&joint))];
                return Hidden::new(id, Place::Group(group), &sizes).driven_by(&joint);
            }
        };
        Hidden::new(id, place, &sizes)
    }

    fn below(&mut self, count: usize) -> usize {
        ((self.rng.random::<f64>() * count as f64) as usize).min(count.saturating_sub(1))
    }

    fn sign(&mut self) -> f64 {
        if self.rng.random::<f64>() < 0.5 { -1.0 } else { 1.0 }
    }

    /// A stream, and its on-threshold in raw units.
    fn stream(&mut self) -> (String, f64) {
        let idx = self.below(self.station.layout.streams.len());
        (self.station.layout.streams[idx].id.clone(), self.station.streams[idx].on_threshold)
    }

    /// The stream `drawn`, or another one of which the session touches enough to tell its channels apart.
    fn felt_stream(&self, drawn: String) -> String {
        let streams = &self.station.layout.streams;
        let channels: Vec<Range<usize>> = streams.iter().map(|stream| stream.channels.clone()).collect();
        let felt = self.exercised.felt(&channels);
        let felt: Vec<&String> = felt.into_iter().map(|idx| &streams[idx].id).collect();
        if felt.contains(&&drawn) { drawn } else { felt.first().map_or(drawn, |id| (*id).clone()) }
    }

    fn pressure_stream(&mut self) -> String {
        let streams = &self.station.layout.streams;
        let stream = streams.iter().find(|stream| stream.kind == SensorKind::Pressure).or(streams.first());
        stream.map_or_else(String::new, |stream| stream.id.clone())
    }

    /// A patch, of one kind of sensor where that is asked for.
    fn patch(&mut self, kind: Option<SensorKind>) -> usize {
        let layout = &self.station.layout;
        let fits =
            |&idx: &usize| kind.is_none_or(|kind| layout.streams[layout.patches[idx].stream].kind == kind);
        let touched = |&idx: &usize| {
            layout.patches[idx].channels.clone().any(|channel| self.exercised.touched[channel])
        };
        let fitting: Vec<usize> = (0..layout.patches.len()).filter(fits).filter(touched).collect();
        fitting.get(self.below(fitting.len())).copied().unwrap_or(0)
    }

    fn channel(&mut self) -> String {
        let idx = self.channel_idx();
        self.station.layout.channels[idx].id.clone()
    }

    fn channel_idx(&mut self) -> usize {
        let touched: Vec<usize> =
            (0..self.station.layout.num_channels()).filter(|&idx| self.exercised.touched[idx]).collect();
        touched.get(self.below(touched.len())).copied().unwrap_or(0)
    }

    /// Two channels at one connector: taxels of a patch, or patches of one taxel each that share a board.
    fn pair(&mut self) -> Vec<String> {
        let layout = &self.station.layout;
        let channels = &layout.channels;
        let first = self.channel_idx();
        let alone = |idx: usize| layout.patches[channels[idx].patch].channels.len() == 1;
        let mates: Vec<usize> = (0..channels.len())
            .filter(|&idx| idx != first && self.exercised.touched[idx])
            .filter(|&idx| channels[idx].stream == channels[first].stream)
            .filter(|&idx| channels[idx].patch == channels[first].patch || (alone(idx) && alone(first)))
            .collect();
        // A channel that is touched alone of its connector changes places with one beside it.
        let beside = if first + 1 < channels.len() { first + 1 } else { first.saturating_sub(1) };
        let second = mates.get(self.below(mates.len())).copied().unwrap_or(beside);
        vec![channels[first].id.clone(), channels[second].id.clone()]
    }

    /// A joint of a limb that has pressure sensors, and the group that it moves.
    fn bending(&mut self) -> (String, String) {
        self.joint_of_limb(|_, _| true)
    }

    fn turned_joint(&mut self) -> String {
        self.joint_of_limb(|draw, dof| draw.exercised.is_turned(dof)).0
    }

    /// A joint that snags a cable, and the angle beyond which it does, rad.
    fn snagging_joint(&mut self) -> (String, f64) {
        let joint = self.joint_of_limb(|draw, dof| draw.exercised.passes(dof, draw.snag_rad(dof))).0;
        let beyond_rad = self.rest(&joint) + SNAG_BEYOND_REST_RAD;
        (joint, beyond_rad)
    }

    fn snag_rad(&self, dof: usize) -> f64 {
        let joint = self.station.robot.dofs().nth(dof);
        joint.map_or(0.0, |joint| self.rest(&joint.name)) + SNAG_BEYOND_REST_RAD
    }

    /// A joint of a limb that has pressure sensors, of those that fit if any does, and the group that it moves.
    fn joint_of_limb(&mut self, fits: impl Fn(&Self, usize) -> bool) -> (String, String) {
        let patch = self.patch(Some(SensorKind::Pressure));
        let dofs = limb_dofs(self.station, &[patch]);
        let fitting: Vec<usize> = dofs.iter().copied().filter(|&dof| fits(self, dof)).collect();
        let dofs = if fitting.is_empty() { dofs } else { fitting };
        let joints: Vec<&str> = self.station.robot.dofs().map(|joint| joint.name.as_str()).collect();
        let dof = dofs.get(self.below(dofs.len())).copied().unwrap_or(0);
        (joints[dof].to_owned(), self.station.layout.patches[patch].group.clone())
    }

    fn joint(&mut self) -> String {
        self.bending().0
    }

    fn rest(&self, joint: &str) -> f64 {
        self.stage.plan().motion.rest.get(joint).copied().unwrap_or(0.0)
    }

    fn object(&mut self) -> String {
        let takes = &self.stage.plan().takes;
        takes[self.below(takes.len())].object.clone()
    }

    /// A shift of `size_m` in a direction that shows: a cylinder moved along its axis is where it was.
    fn shift(&mut self, object: &str, size_m: f64) -> Vec<(&'static str, f64)> {
        let mut at = nalgebra::Vector3::from_fn(|_, _| gaussian(&mut self.rng));
        let pose = self.stage.plan().objects.get(object).and_then(|pose| pose.to_isometry().ok());
        if let (Some(pose), ObjectShape::Cylinder { .. }) = (pose, &self.station.objects[object].shape) {
            let axis = pose.rotation * nalgebra::Vector3::z();
            at -= axis * at.dot(&axis);
        }
        let at = at.normalize() * size_m;
        vec![("x_m", at.x), ("y_m", at.y), ("z_m", at.z)]
    }

    /// A shift of `size_m` of a patch along its surface: one across it is the same as a preload.
    fn along(&mut self, patch: usize, size_m: f64) -> Vec<(&'static str, f64)> {
        let patch = &self.station.layout.patches[patch];
        let at = patch.link_from_patch.rotation * (nalgebra::Vector3::x() * (self.sign() * size_m));
        vec![("x_m", at.x), ("y_m", at.y), ("z_m", at.z)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stream_is_felt_where_half_of_its_channels_are_touched() {
        let touched = vec![true, true, false, true, false, false, true, false];
        let exercised = Exercised { touched, angles_rad: Vec::new() };
        assert_eq!(exercised.felt(&[0..3, 3..6, 6..8]), [0, 2]);
        assert_eq!(exercised.felt(std::slice::from_ref(&(4..6))), [] as [usize; 0]);
    }

    #[test]
    fn a_joint_turns_over_all_takes_and_passes_an_angle_in_enough_of_them() {
        let angles_rad = vec![
            vec![[0.0, 0.02], [0.05, 0.12], [0.0, 0.05], [0.0, 0.01]],
            vec![[-0.5, 0.3], [0.2, 0.5], [0.3, 0.45], [0.1, 0.42]],
        ];
        let exercised = Exercised { touched: Vec::new(), angles_rad };
        assert_eq!([0, 1].map(|dof| exercised.is_turned(dof)), [true, true]);
        assert_eq!([0, 1].map(|dof| exercised.passes(dof, 0.4)), [false, true]);
        assert!(!exercised.passes(1, 0.43), "in two takes");
        assert!(!Exercised { touched: Vec::new(), angles_rad: vec![vec![[0.0, 0.04]; 3]] }.is_turned(0));
    }
}
