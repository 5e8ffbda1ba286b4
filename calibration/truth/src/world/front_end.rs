//! From the deformation of a layer to the voltage or count that a converter sees.

use nalgebra::{Isometry3, Point3};
use palpate_robot_model::Patch;

use super::elastomer::Layer;
use crate::truth::{Elastomer, FrontEnd};

/// The sensors of one patch.
#[derive(Clone, Debug)]
pub(crate) struct Sensors {
    front_end: FrontEnd,
    /// Pa per m of displacement.
    stiffness_pa_per_m: f64,
    /// Share of each element in each taxel, `[taxel][element]`; for a force resistor each counts by its area.
    weights: Vec<Vec<f64>>,
    /// Factor of each channel, about 1.
    gains: Vec<f64>,
    /// Filtered reading of each channel, raw units before noise and quantisation.
    pub(crate) analog_raw: Vec<f64>,
}

impl Sensors {
    /// Sensors under `layer`; taxels move with the layer by `mount_offset`.
    pub(crate) fn new(
        patch: &Patch,
        layer: &Layer,
        elastomer: &Elastomer,
        front_end: FrontEnd,
        mount_offset: &Isometry3<f64>,
        gains: Vec<f64>,
    ) -> Self {
        let origin = patch.link_from_patch.translation.vector;
        let weights = patch
            .taxels_in_link
            .iter()
            .map(|taxel| {
                let moved = mount_offset.rotation * (taxel.coords - origin)
                    + origin
                    + mount_offset.translation.vector;
                let taxel = Point3::from(moved);
                let share = |pos: &Point3<f64>| match front_end {
                    // Vertical stress under a point load on a half space (Boussinesq): 3 h^3 / (2 pi (r^2 + h^2)^(5/2)).
                    FrontEnd::Barometer { depth_m, .. } => {
                        let squared = (pos - taxel).norm_squared() + depth_m * depth_m;
                        3.0 * depth_m.powi(3) / (std::f64::consts::TAU * squared.powf(2.5)) * layer.area_m2
                    }
                    FrontEnd::ForceResistor { .. } => layer.area_m2,
                };
                layer.pos_in_link.iter().map(share).collect()
            })
            .collect();
        let mut sensors = Self {
            front_end,
            stiffness_pa_per_m: elastomer.modulus_pa / elastomer.thickness_m,
            weights,
            gains,
            analog_raw: Vec::new(),
        };
        sensors.analog_raw = (0..sensors.weights.len()).map(|taxel| sensors.target(layer, taxel)).collect();
        sensors
    }

    /// Lets the filters follow the layer for `dt_s`.
    pub(crate) fn step(&mut self, layer: &Layer, dt_s: f64) {
        let low_pass_s = match self.front_end {
            FrontEnd::Barometer { low_pass_s, .. } | FrontEnd::ForceResistor { low_pass_s, .. } => low_pass_s,
        };
        let blend = 1.0 - (-dt_s / low_pass_s).exp();
        for taxel in 0..self.analog_raw.len() {
            let target = self.target(layer, taxel);
            self.analog_raw[taxel] += blend * (target - self.analog_raw[taxel]);
        }
    }

    fn target(&self, layer: &Layer, taxel: usize) -> f64 {
        let load: f64 = if layer.awake {
            self.weights[taxel].iter().zip(layer.felt_m()).map(|(weight, x)| weight * x).sum()
        } else {
            0.0
        };
        // Pa under a barometer, N on a force resistor.
        let load = load * self.stiffness_pa_per_m;
        match self.front_end {
            FrontEnd::Barometer { raw_per_pa, offset_raw, .. } => {
                offset_raw + self.gains[taxel] * raw_per_pa * load
            }
            FrontEnd::ForceResistor {
                preload_n, conductance_s_per_n, divider_ohm, full_scale_raw, ..
            } => {
                let force_n = (load - preload_n).max(0.0);
                let ratio = self.gains[taxel] * conductance_s_per_n * force_n * divider_ohm;
                full_scale_raw * ratio / (1.0 + ratio)
            }
        }
    }
}
