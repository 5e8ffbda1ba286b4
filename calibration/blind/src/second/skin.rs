//! Soft skin: nonlinear, spreading, creeping, with hysteresis.

use std::collections::BTreeMap;

use nalgebra::{Isometry3, Point3, Vector3};
use palpate_robot_model::{Patch, SensorKind, Station};
use palpate_sim::geometry::SignedDistance;
use palpate_truth::Hidden;

use super::imperfections::{Imperfections, SkinConfig, Spread};
use super::{motion_of, value};

/// All skin of the hand.
pub(super) struct Skin {
    pads: Vec<Pad>,
    /// What each channel feels, as a share of what switches it in a usual contact.
    pub(super) felt: Vec<f64>,
}

/// The skin of one patch.
struct Pad {
    link: usize,
    nodes: Vec<Point3<f64>>,
    middle: Point3<f64>,
    radius_m: f64,
    /// By channel of the patch, the share of each node in what it feels.
    shares: Vec<Vec<f64>>,
    skin: SkinConfig,
    /// How deep the surface must give before anything is felt, m.
    gap_m: f64,
    /// Seconds by which a speed of denting adds to the dent.
    damping_s: f64,
    /// Share of a dent that stays after a release, and the time in which it goes, s.
    lingering: [f64; 2],
    unit: f64,
    dents_m: Vec<f64>,
    channels: Vec<Felt>,
    first_channel: usize,
}

/// What one channel feels, over time.
#[derive(Clone, Copy, Default)]
struct Felt {
    load: f64,
    late: [f64; 2],
    /// The load behind which unloading lags.
    played: f64,
    lingering: f64,
}

/// Loads, in units of the pressure at a strain of one, at which a channel switches: a taxel right under a ball that has
/// sunk in by about 0.4 mm, and a pad of which a sixth is touched so.
const TAXEL_LOAD: f64 = 0.03;
const PAD_LOAD: f64 = 0.006;
/// Looks at a patch whose object is nearer than this, m.
const NEAR_M: f64 = 0.004;

impl Skin {
    pub(super) fn new(station: &Station, imperfections: &Imperfections, hidden: &[Hidden]) -> Self {
        let layout = &station.layout;
        let pads = layout.patches.iter().enumerate();
        let pads = pads.map(|(idx, patch)| {
            let stream = &layout.streams[patch.stream];
            let skin = imperfections.skins[patch.stream];
            let of = |id: &str, size: &str| {
                value(hidden, id, size, &patch.id).or_else(|| value(hidden, id, size, &stream.id))
            };
            let mut pad =
                Pad::new(patch, stream.kind, skin, of("elastic_crosstalk", "added_m").unwrap_or(0.0));
            pad.mount(&imperfections.mounts[idx], motion_of(hidden, "sensor_mount_offset", &patch.id), patch);
            pad.gap_m = of("preload", "depth_m").unwrap_or(0.0);
            pad.damping_s = of("rate_dependence", "damping_s").unwrap_or(0.0);
            let lingering = |size: &str| of("viscoelastic_release", size);
            pad.lingering = [lingering("fraction").unwrap_or(0.0), lingering("time_s").unwrap_or(1.0)];
            pad
        });
        Self { pads: pads.collect(), felt: vec![0.0; layout.num_channels()] }
    }

    /// Looks where the object is, after `since_s`.
    pub(super) fn look(
        &mut self,
        station: &Station,
        surface: &SignedDistance,
        object_from_base: &Isometry3<f64>,
        base_from_link: &[Isometry3<f64>],
        since_s: f64,
    ) {
        debug_assert_eq!(self.pads.len(), station.layout.patches.len());
        for pad in &mut self.pads {
            pad.look(surface, &(object_from_base * base_from_link[pad.link]), since_s);
        }
    }

    /// Goes on by `step_s`.
    pub(super) fn step(&mut self, step_s: f64) {
        for pad in &mut self.pads {
            for (idx, channel) in pad.channels.iter_mut().enumerate() {
                self.felt[pad.first_channel + idx] =
                    channel.step(&pad.skin, pad.lingering, step_s) / pad.unit;
            }
        }
    }
}

impl Pad {
    fn new(patch: &Patch, kind: SensorKind, skin: SkinConfig, added_m: f64) -> Self {
        let nodes: Vec<Point3<f64>> = patch.nodes.iter().map(|node| node.pos_in_link).collect();
        let spread_m = skin.spread_m.hypot(added_m);
        let share = |taxel: &Point3<f64>, node: &Point3<f64>| match kind {
            SensorKind::Pressure => {
                let distance = (taxel - node).norm() / spread_m;
                match skin.spread {
                    Spread::Gaussian => (-0.5 * distance * distance).exp(),
                    Spread::Exponential => (-distance).exp(),
                }
            }
            // A pad is one electrode.
            SensorKind::Proximity => 1.0,
        };
        let shares = patch.taxels_in_link.iter().map(|taxel| {
            let shares: Vec<f64> = nodes.iter().map(|node| share(taxel, node)).collect();
            let sum: f64 = shares.iter().sum();
            shares.into_iter().map(|share| share / sum).collect()
        });
        let sum = nodes.iter().fold(Vector3::zeros(), |sum, node| sum + node.coords);
        let middle = Point3::from(sum / nodes.len().max(1) as f64);
        let radius_m = nodes.iter().map(|node| (node - middle).norm()).fold(0.0, f64::max);
        Self {
            link: patch.link,
            middle,
            radius_m,
            shares: shares.collect(),
            skin,
            gap_m: 0.0,
            damping_s: 0.0,
            lingering: [0.0, 1.0],
            unit: if kind == SensorKind::Pressure { TAXEL_LOAD } else { PAD_LOAD },
            dents_m: vec![0.0; nodes.len()],
            channels: vec![Felt::default(); patch.channels.len()],
            first_channel: patch.channels.start,
            nodes,
        }
    }

    /// Moves the patch from its place: by `shift_m`, and about its origin as is hidden.
    fn mount(
        &mut self,
        shift_m: &Vector3<f64>,
        hidden: Option<(Vector3<f64>, nalgebra::UnitQuaternion<f64>)>,
        patch: &Patch,
    ) {
        let (more_m, turn) = hidden.unwrap_or((Vector3::zeros(), nalgebra::UnitQuaternion::identity()));
        let origin = patch.link_from_patch.translation.vector;
        for node in self.nodes.iter_mut().chain([&mut self.middle]) {
            *node = Point3::from(turn * (node.coords - origin) + origin + shift_m + more_m);
        }
    }

    fn look(&mut self, surface: &SignedDistance, object_from_link: &Isometry3<f64>, since_s: f64) {
        let middle_m = surface.distance_m(&(object_from_link * self.middle));
        if middle_m > self.radius_m + NEAR_M {
            self.dents_m.fill(0.0);
            self.channels.iter_mut().for_each(|channel| channel.load = 0.0);
            return;
        }
        let mut pressures = BTreeMap::new();
        for (idx, (node, dent_m)) in self.nodes.iter().zip(&mut self.dents_m).enumerate() {
            let depth_m = (-surface.distance_m(&(object_from_link * node)) - self.gap_m).max(0.0);
            let speed_m_per_s = (depth_m - *dent_m) / since_s;
            *dent_m = depth_m;
            if depth_m > 0.0 {
                let strain = (depth_m + self.damping_s * speed_m_per_s).max(0.0) / self.skin.thickness_m;
                let stiffer = 1.0 + self.skin.stiffening * strain * strain;
                pressures.insert(idx, strain.powf(self.skin.exponent) * stiffer);
            }
        }
        for (channel, shares) in self.channels.iter_mut().zip(&self.shares) {
            channel.load = pressures.iter().map(|(&node, pressure)| shares[node] * pressure).sum();
        }
    }
}

impl Felt {
    fn step(&mut self, skin: &SkinConfig, [fraction, lingers_s]: [f64; 2], step_s: f64) -> f64 {
        let mut load = self.load;
        for ((share, time_s), late) in skin.creep.iter().zip(&mut self.late) {
            *late += (self.load - *late) * (1.0 - (-step_s / time_s).exp());
            load += share * (*late - self.load);
        }
        let lag = skin.hysteresis * load;
        self.played = self.played.clamp(load - lag, load + lag);
        // A dent that goes slowly is felt where nothing presses any more.
        self.lingering = (self.lingering * (-step_s / lingers_s).exp()).max(fraction * self.played);
        self.played.max(self.lingering)
    }
}
