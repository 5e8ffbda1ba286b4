//! The layout file as it is written.

use serde::Deserialize;
use toml::Spanned;

use super::{SensorKind, surface::Surface};
use crate::PoseConfig;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct LayoutConfig {
    pub(super) name: String,
    #[serde(default)]
    pub(super) stream: Vec<Spanned<LayoutStreamConfig>>,
    #[serde(default)]
    pub(super) patch: Vec<Spanned<PatchConfig>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct LayoutStreamConfig {
    pub(super) id: String,
    pub(super) label: String,
    pub(super) kind: SensorKindConfig,
    pub(super) rate_hz: f64,
    pub(super) raw_unit: String,
    /// How many numbers each taxel measures: 1 if left out.
    pub(super) axes: Option<usize>,
    /// How several become one.
    pub(super) reading: Option<AxesReading>,
    /// For `normal`: the axis along the outward normal, with a minus where pressing makes it fall.
    pub(super) normal_axis: Option<String>,
}

/// How the axes of a taxel become its one reading.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AxesReading {
    /// How far they are from where they are without touch.
    Norm,
    /// The one along the outward normal.
    Normal,
}

#[derive(Clone, Copy, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum SensorKindConfig {
    Proximity,
    Pressure,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct PatchConfig {
    pub(super) id: String,
    pub(super) label: String,
    pub(super) group: String,
    pub(super) stream: String,
    pub(super) link: String,
    pub(super) pose: PoseConfig,
    pub(super) shape: Surface,
    pub(super) node_spacing_m: f64,
    pub(super) stiffness_pa_per_m: Option<f64>,
    /// Taxel positions as seen down the patch's z axis; they are moved along z onto the surface.
    #[serde(default)]
    pub(super) taxels_m: Vec<[f64; 2]>,
    pub(super) map: Option<MapConfig>,
}

impl PatchConfig {
    /// Taxels, with the one in the middle that a patch with a single reading need not spell out.
    pub(super) fn taxels(&self, kind: SensorKind) -> Vec<[f64; 2]> {
        match kind {
            SensorKind::Proximity if self.taxels_m.is_empty() => vec![[0.0, 0.0]],
            SensorKind::Proximity | SensorKind::Pressure => self.taxels_m.clone(),
        }
    }
}

/// Where a patch goes on the map: its origin (and how far it is turned), or each taxel by itself.
#[derive(Deserialize)]
#[serde(untagged, deny_unknown_fields)]
pub(super) enum MapConfig {
    /// The patch's origin is drawn at `at`, its x axis up, turned left by `turn_rad`.
    At {
        at: [f64; 2],
        #[serde(default)]
        turn_rad: f64,
    },
    /// One position a taxel.
    Positions { positions: Vec<[f64; 2]> },
}
