//! Hidden effects resolved against a station: who has what, by index.

use std::collections::BTreeMap;

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use palpate_robot_model::{Place, Station, ik::chain_dofs};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use crate::hidden::Hidden;
use crate::noise::gaussian;

/// Everything that a list of [`Hidden`] asks for. Without any, each part is what leaves the world as it is.
#[derive(Clone, Debug)]
pub(crate) struct Secrets {
    /// Measured less true position, per degree of freedom.
    pub(crate) joint_offsets: Vec<f64>,
    /// Gear play, per degree of freedom, rad or m.
    pub(crate) play: Vec<f64>,
    /// True less recorded pose by object: shift in the base frame, and turn about the object's origin.
    pub(crate) object_errors: BTreeMap<String, Isometry3<f64>>,
    /// True over nominal size, by object.
    pub(crate) object_scales: BTreeMap<String, f64>,
    /// Pairs of groups whose patches feel each other.
    pub(crate) touching: Vec<[String; 2]>,
    /// One for each patch of the layout.
    pub(crate) patches: Vec<PatchSecrets>,
    /// One for each channel of the layout.
    pub(crate) channels: Vec<ChannelSecrets>,
    /// One for each stream of the layout.
    pub(crate) streams: Vec<StreamSecrets>,
}

#[derive(Clone, Debug)]
pub(crate) struct PatchSecrets {
    /// True less nominal place in the link's frame, turned about the patch's own origin.
    pub(crate) mount: Option<Isometry3<f64>>,
    /// Air between layer and sensor, m.
    pub(crate) gap_m: f64,
    /// More reach of the coupling along the layer, m.
    pub(crate) coupling_m: f64,
}

#[derive(Clone, Debug)]
pub(crate) struct ChannelSecrets {
    pub(crate) gain: f64,
    /// Raw units a second, at first.
    pub(crate) drift_raw_per_s: f64,
    /// Raw units by the speed of the joints that move the patch.
    pub(crate) strain_raw_s: f64,
    pub(crate) dead: bool,
    /// Whether the tared reading is stored unsigned.
    pub(crate) wraps: bool,
    /// Constant rise that the converter gives, raw units.
    pub(crate) stuck_raw: Option<f64>,
    /// Change of gain with a joint.
    pub(crate) bend: Option<Bend>,
    /// Channel of the layout whose line ends here instead of its own.
    pub(crate) line: usize,
}

/// A gain that depends on a joint: `1 + per_rad (q - middle)`, never negative.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Bend {
    pub(crate) dof: usize,
    pub(crate) per_rad: f64,
    pub(crate) middle: f64,
}

#[derive(Clone, Debug, Default)]
pub(crate) struct StreamSecrets {
    /// Dashpot beside the layer's spring, s.
    pub(crate) viscous_s: f64,
    /// Share of a dent that remains, and its time constant, s.
    pub(crate) release: Option<(f64, f64)>,
    /// Off- over on-threshold.
    pub(crate) off_fraction: Option<f64>,
    /// More time constant of the input filter, s.
    pub(crate) low_pass_s: f64,
    /// Share of the difference between neighbouring lines that leaks.
    pub(crate) leak: f64,
    /// Time before a touch is believed, s.
    pub(crate) min_on_s: f64,
    /// More delay, s.
    pub(crate) delay_s: f64,
    /// How fast the clock runs that stamps samples, s per s.
    pub(crate) stamp_skew: f64,
    pub(crate) hold: Option<Hold>,
    /// Amplitude of the mains, raw units.
    pub(crate) hum_raw: f64,
    pub(crate) snags: Vec<Snag>,
}

/// Spans in which a device repeats its last sample.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Hold {
    pub(crate) length_s: f64,
    /// Mean time from one span's end to the next one's start.
    pub(crate) every_s: f64,
}

/// A cable that catches beyond a joint position and lets go `release` before it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Snag {
    pub(crate) dof: usize,
    pub(crate) beyond: f64,
    pub(crate) release: f64,
    pub(crate) offset_raw: f64,
}

impl Secrets {
    /// Resolves `hidden`, or says which entry (from 0) cannot be and why.
    pub(crate) fn new(
        hidden: &[Hidden],
        station: &Station,
        world_seed: u64,
    ) -> Result<Self, (usize, String)> {
        let layout = &station.layout;
        let num_dofs = station.robot.num_dofs();
        let channel = |line| ChannelSecrets {
            gain: 1.0,
            drift_raw_per_s: 0.0,
            strain_raw_s: 0.0,
            dead: false,
            wraps: false,
            stuck_raw: None,
            bend: None,
            line,
        };
        let mut secrets = Self {
            joint_offsets: vec![0.0; num_dofs],
            play: vec![0.0; num_dofs],
            object_errors: BTreeMap::new(),
            object_scales: BTreeMap::new(),
            touching: Vec::new(),
            patches: vec![PatchSecrets { mount: None, gap_m: 0.0, coupling_m: 0.0 }; layout.patches.len()],
            channels: (0..layout.num_channels()).map(channel).collect(),
            streams: vec![StreamSecrets::default(); layout.streams.len()],
        };
        for (entry, effect) in hidden.iter().enumerate() {
            effect.check(station).map_err(|problem| (entry, problem))?;
            secrets.add(effect, station, world_seed);
        }
        Ok(secrets)
    }

    /// Adds one effect, which has been checked. Effects of the same kind add up where they can.
    fn add(&mut self, effect: &Hidden, station: &Station, world_seed: u64) {
        let value = |name| effect.value(name);
        let layout = &station.layout;
        let channels = effect.channels(station);
        let dof_of = |name: &String| station.robot.dofs().position(|joint| joint.name == *name);
        let driving = effect.joint.as_ref().and_then(dof_of).unwrap_or(0);
        let mut patches: Vec<usize> = channels.iter().map(|&idx| layout.channels[idx].patch).collect();
        patches.dedup();
        // Effects of a stream are only ever at streams, so the first channel tells which.
        let stream = channels.first().map_or(0, |&idx| layout.channels[idx].stream);
        let stream = &mut self.streams[stream];
        match effect.id.as_str() {
            "joint_offset" | "joint_backlash" => {
                let dofs: Vec<usize> = match &effect.place {
                    Place::Joint(name) => dof_of(name).into_iter().collect(),
                    _ => limb_dofs(station, &patches),
                };
                for dof in dofs {
                    self.joint_offsets[dof] += value("offset");
                    self.play[dof] += value("width");
                }
            }
            "object_pose_offset" => {
                if let Place::Object(id) = &effect.place {
                    let before = self.object_errors.get(id).copied().unwrap_or_else(Isometry3::identity);
                    self.object_errors.insert(id.clone(), motion(effect) * before);
                }
            }
            "object_scale" => {
                if let Place::Object(id) = &effect.place {
                    *self.object_scales.entry(id.clone()).or_insert(1.0) *= value("factor");
                }
            }
            "sensor_mount_offset" => {
                for patch in patches {
                    let mount = &mut self.patches[patch].mount;
                    *mount = Some(motion(effect) * mount.unwrap_or_else(Isometry3::identity));
                }
            }
            "self_contact" => {
                if let Place::Groups(groups) = &effect.place
                    && let [first, second] = &groups[..]
                {
                    self.touching.push([first.clone(), second.clone()]);
                }
            }
            "sensitivity_spread" => {
                let mut rng = ChaCha8Rng::seed_from_u64(world_seed);
                rng.set_stream(SPREAD_STREAM + value("draw") as u64);
                for channel in channels {
                    let own = (value("spread") * gaussian(&mut rng)).exp();
                    self.channels[channel].gain *= value("gain") * own;
                }
            }
            "elastic_crosstalk" => {
                patches.iter().for_each(|&patch| self.patches[patch].coupling_m += value("added_m"));
            }
            "rate_dependence" => stream.viscous_s += value("damping_s"),
            "preload" => patches.iter().for_each(|&patch| self.patches[patch].gap_m += value("depth_m")),
            "viscoelastic_release" => stream.release = Some((value("fraction"), value("time_s"))),
            "threshold_hysteresis" => stream.off_fraction = Some(value("off_fraction")),
            "low_pass" => stream.low_pass_s += value("time_s"),
            "baseline_drift" => {
                for channel in channels {
                    self.channels[channel].drift_raw_per_s += value("rate_raw_per_s");
                }
            }
            "motion_artifact" => {
                for channel in channels {
                    self.channels[channel].strain_raw_s += value("raw_s_per_rad");
                }
            }
            "electrical_crosstalk" => stream.leak += value("leak"),
            "dead_channel" => channels.iter().for_each(|&channel| self.channels[channel].dead = true),
            "stuck_channel" => {
                channels.iter().for_each(|&idx| self.channels[idx].stuck_raw = Some(value("rise_raw")));
            }
            "swapped_channels" => {
                if let [first, second] = channels[..] {
                    let line = self.channels[first].line;
                    self.channels[first].line = self.channels[second].line;
                    self.channels[second].line = line;
                }
            }
            "integer_wrap" => channels.iter().for_each(|&channel| self.channels[channel].wraps = true),
            "debounce" => stream.min_on_s += value("min_on_s"),
            "latency" => stream.delay_s += value("delay_s"),
            "clock_skew" => stream.stamp_skew += value("skew"),
            "sample_hold" => {
                stream.hold = Some(Hold { length_s: value("hold_s"), every_s: value("every_s") });
            }
            "mains_hum" => stream.hum_raw += value("amplitude_raw"),
            "snagged_cable" => stream.snags.push(Snag {
                dof: driving,
                beyond: value("beyond"),
                release: value("release"),
                offset_raw: value("offset_raw"),
            }),
            "joint_dependent_gain" => {
                let bend = Bend { dof: driving, per_rad: value("per_rad"), middle: value("middle") };
                channels.iter().for_each(|&channel| self.channels[channel].bend = Some(bend));
            }
            other => unreachable!("{other:?} was checked against the table of effects"),
        }
    }

    /// The pose that a session records for an object which stands at `base_from_object`.
    pub(crate) fn recorded_pose(&self, object: &str, base_from_object: &Isometry3<f64>) -> Isometry3<f64> {
        let Some(error) = self.object_errors.get(object) else { return *base_from_object };
        let turned = error.rotation.inverse() * base_from_object.rotation;
        let shifted = base_from_object.translation.vector - error.translation.vector;
        Isometry3::from_parts(Translation3::from(shifted), turned)
    }
}

/// Draws of spreads come from their own part of the world's numbers.
const SPREAD_STREAM: u64 = 1 << 56;

fn motion(effect: &Hidden) -> Isometry3<f64> {
    let vector = |names: [&str; 3]| Vector3::from(names.map(|name| effect.value(name)));
    Isometry3::from_parts(
        Translation3::from(vector(["x_m", "y_m", "z_m"])),
        UnitQuaternion::new(vector(["rx_rad", "ry_rad", "rz_rad"])),
    )
}

/// Degrees of freedom that move any of `patches` and do not carry the hand.
pub(crate) fn limb_dofs(station: &Station, patches: &[usize]) -> Vec<usize> {
    let mut dofs: Vec<usize> = patches
        .iter()
        .flat_map(|&patch| chain_dofs(&station.robot, station.layout.patches[patch].link))
        .collect();
    dofs.retain(|dof| !station.carrier_dofs.contains(dof));
    dofs.sort_unstable();
    dofs.dedup();
    dofs
}
