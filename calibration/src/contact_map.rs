//! The contact map: a small network from a channel's raw readings to contact, learned on calibration takes.
//!
//! The paper names it in one sentence (Real2Sim tactile alignment system, C): paired sequences "are used to learn the tactile
//! alignment network g_phi, which maps raw real tactile readings to simulation-compatible contact features". It gives no
//! architecture and no loss; what this module chooses is:
//!
//! - **Input**: the readings of one channel above their reference at the moments [`LAGS_S`] before now, in units of the
//!   channel, compressed by arsinh; where patches have several channels also the mean of the others on the same patch, because
//!   a soft layer presses on neighbours. All of it is in the past, so the map runs on a robot.
//! - **Target**: the contacts that a sensor model sees in the geometry of the take, at the frames of its joint log.
//! - **Network**: one for each stream, shared by its channels: a linear layer beside a hidden one ([`Network`]), and an offset
//!   for each channel. The loss is the logistic one, minimised by AdamW.
//! - **Switching**: two thresholds, on and off, with the largest F1 on the fitted takes.
//!
//! The network and its AdamW are this module's own, although `policy/training` has an AdamW too, because calibration comes before
//! policy and may not use its crates.
//!
//! [`MapTake`] is what the map reads of a take, [`fit`] learns, [`ContactMap`] is the file, [`LiveMap`] runs it reading by
//! reading, [`judge`] compares it with the station's thresholds.

mod file;
pub mod judge;
mod live;
mod network;
mod samples;
mod train;

use std::ops::Range;

pub use live::LiveMap;
use palpate_robot_model::Station;
pub use samples::{LAGS_S, MapTake};
pub use train::{MapConfig, MapFit, StreamFitted, fit};

use crate::CalibrationError;
use network::Network;
use samples::num_inputs;

/// A map from raw readings to contact, as its file has it.
#[derive(Clone, Debug, PartialEq)]
pub struct ContactMap {
    /// Name for people.
    pub name: String,
    /// Id of the station whose hand it was learned on: scales and offsets are those of single sensors.
    pub station: String,
    /// How long before now each reading of a window was in effect, s; ascending, the first is 0.
    pub lags_s: Vec<f64>,
    /// The sensor model whose contacts it was learned to give, as its file.
    pub target: String,
    /// Where it came from, for people.
    pub provenance: Vec<String>,
    /// The takes that it was fitted to.
    pub takes: Vec<FittedTake>,
    /// What was learned of each stream, in the layout's order. Streams that are not among them keep the station's thresholds.
    pub streams: Vec<StreamMap>,
}

/// A take that a map was fitted to.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FittedTake {
    /// Its id within its session.
    pub id: String,
    /// Of its contents ([`MapTake::fingerprint`]), which a copy under another name has as well.
    pub fingerprint: String,
}

/// What was learned of one stream.
#[derive(Clone, Debug, PartialEq)]
pub struct StreamMap {
    /// Id of the stream.
    pub id: String,
    /// Ids of its channels, in the layout's order.
    pub channels: Vec<String>,
    /// Raw units that are one unit of each channel's inputs.
    pub scales_raw: Vec<f64>,
    /// Added to what the network says of each channel.
    pub offsets: Vec<f64>,
    /// From what network and offset say on, channels switch.
    pub switching: Switching,
    network: Network,
}

/// When channels switch on and off: logarithms of the odds that they are in contact.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Switching {
    /// A channel that is off switches on above this.
    pub on: f64,
    /// A channel that is on switches off at or below this.
    pub off: f64,
}

impl Switching {
    fn is_active(self, logit: f64, was_active: bool) -> bool {
        logit > if was_active { self.off } else { self.on }
    }
}

impl ContactMap {
    /// Refuses stations that it was not learned on, naming the first difference.
    ///
    /// # Errors
    /// Another station, or other streams and channels.
    pub fn check(&self, station: &Station) -> Result<(), CalibrationError> {
        let fail = |problem: String| {
            Err(CalibrationError::Input(format!(
                "contact map {:?} {problem}; fit one to a session of this station",
                self.name
            )))
        };
        if station.id != self.station {
            return fail(format!(
                "was learned on station {:?}, but this is station {:?}, whose sensors are others",
                self.station, station.id
            ));
        }
        let layout = &station.layout;
        for stream in &self.streams {
            let Some(idx) = layout.stream_index(&stream.id) else {
                return fail(format!(
                    "knows stream {:?}, which station {:?} does not have",
                    stream.id, station.id
                ));
            };
            let found = &layout.channels[layout.streams[idx].channels.clone()];
            if found.len() != stream.channels.len() {
                return fail(format!(
                    "knows {} channels of stream {:?}, but station {:?} has {}",
                    stream.channels.len(),
                    stream.id,
                    station.id,
                    found.len()
                ));
            }
            if let Some((channel, known)) =
                found.iter().zip(&stream.channels).find(|(found, known)| found.id != **known)
            {
                return fail(format!(
                    "has channel {known:?} of stream {:?} where station {:?} has {:?}",
                    stream.id, station.id, channel.id
                ));
            }
            let expected = num_inputs(&patch_columns(station, idx), self.lags_s.len());
            if stream.network.num_inputs() != expected {
                return fail(format!(
                    "reads {} numbers of a channel of stream {:?}, but the patches of station {:?} make {expected}",
                    stream.network.num_inputs(),
                    stream.id,
                    station.id
                ));
            }
        }
        Ok(())
    }

    /// Whether each channel is in contact at each frame of `take`, `[frame * num_channels + channel]`.
    ///
    /// # Errors
    /// A take without raw readings of a stream that the map reads. Whether the take is of the map's station is for
    /// [`ContactMap::check`].
    pub fn contacts(&self, take: &MapTake) -> Result<Vec<bool>, CalibrationError> {
        let mut active = take.thresholded.clone();
        let num_channels = take.num_channels();
        for stream in &self.streams {
            let inputs = take.stream_inputs(&stream.id, &stream.scales_raw)?;
            let first = inputs.channels.start;
            let mut input = vec![0.0; inputs.len()];
            let mut is_active = vec![false; inputs.channels.len()];
            for frame in 0..take.num_frames() {
                for (column, is_active) in is_active.iter_mut().enumerate() {
                    inputs.read(frame, column, &mut input);
                    *is_active = stream.is_contact(column, &input, *is_active);
                    active[frame * num_channels + first + column] = *is_active;
                }
            }
        }
        Ok(active)
    }

    /// The fitted take that has the contents of `take`.
    pub fn fitted(&self, take: &MapTake) -> Option<&FittedTake> {
        self.takes.iter().find(|fitted| fitted.fingerprint == take.fingerprint)
    }
}

impl StreamMap {
    /// Whether the channel in `column` is in contact, by its window and by whether it was before.
    fn is_contact(&self, column: usize, input: &[f64], was_active: bool) -> bool {
        self.switching.is_active(self.network.logit(input) + self.offsets[column], was_active)
    }
}

/// Columns of a stream that lie on one patch.
fn patch_columns(station: &Station, stream: usize) -> Vec<Range<usize>> {
    let first = station.layout.streams[stream].channels.start;
    let patches = station.layout.patches.iter().filter(|patch| patch.stream == stream);
    patches.map(|patch| patch.channels.start - first..patch.channels.end - first).collect()
}
