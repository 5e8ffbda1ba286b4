//! What a contact map is worth.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::{MetricIntervals, Metrics};

/// What a contact map was learned from, and how well hardware and simulation agree with it and without it:
/// `palpate contact-map fit --json` and `judge --json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ContactMapReport {
    /// Id of the session whose takes judge.
    pub session: String,
    /// Id of the station.
    pub station: String,
    /// Name of the sensor model whose contacts the map was learned to give.
    pub target: String,
    /// Ids of the takes that the map was fitted to. Where each take was left out in turn, those of the map that is written.
    pub fitted_takes: Vec<String>,
    /// Ids of the takes that judge, none of which the map that judges them has seen.
    pub judged_takes: Vec<String>,
    /// Whether each take was judged by a map that was fitted to all others.
    pub leave_one_out: bool,
    /// What hardware and simulation say, pair by pair; the map's is the last.
    pub rows: Vec<ContactRow>,
    /// By stream id, how the map fits the takes that it was fitted to; empty where a map from a file was judged.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub streams: BTreeMap<String, ContactMapStream>,
    /// Resamples of takes behind the intervals.
    pub resamples: usize,
    /// Seed of first weights, of the order of samples and of resampling.
    pub seed: u64,
    /// What a reader of the numbers should know.
    #[serde(default)]
    pub notes: Vec<String>,
}

/// Events of the hardware beside events of a simulation, on the takes that judge.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ContactRow {
    /// What makes events of raw readings: `thresholds` or `contact map`.
    pub hardware: String,
    /// What makes events of geometry: `nominal`, `calibrated`, `diagnosed` or the name of a sensor model.
    pub simulation: String,
    /// How well they agree.
    pub metrics: Metrics,
    /// The same by stream id.
    pub by_stream: BTreeMap<String, Metrics>,
    /// 95 % intervals from resampling takes; none with a single take.
    pub intervals_95: Option<MetricIntervals>,
    /// 95 % intervals of the metrics of the map's row less those of this one; none of the map's own.
    pub map_less_this_95: Option<MetricIntervals>,
}

/// How a contact map fits one stream of the takes that it was fitted to.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ContactMapStream {
    /// Channel-frames.
    pub samples: usize,
    /// Share of them in contact.
    pub contact: f64,
    /// Mean logistic loss.
    pub loss: f64,
    /// F1 over channel-frames.
    pub f1: f64,
}
