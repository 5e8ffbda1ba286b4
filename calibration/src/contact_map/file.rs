//! The map's file.

use serde::{Deserialize, Serialize};

use palpate_sim::SensorModel;

use super::network::Network;
use super::{ContactMap, FittedTake, StreamMap, Switching};
use crate::CalibrationError;

/// Version of the file; another one is refused.
const FORMAT: u32 = 1;
/// No map has more units in a hidden layer, or looks back more often.
const MOST: usize = 4096;

#[derive(Deserialize)]
struct FormatText {
    format: u32,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct MapText {
    format: u32,
    name: String,
    station: String,
    lags_s: Vec<f64>,
    #[serde(default)]
    provenance: Vec<String>,
    target: String,
    #[serde(rename = "take", default)]
    takes: Vec<TakeText>,
    #[serde(rename = "stream")]
    streams: Vec<StreamText>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct TakeText {
    id: String,
    fingerprint: String,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct StreamText {
    id: String,
    channels: Vec<String>,
    scales_raw: Vec<f64>,
    offsets: Vec<f64>,
    on: f64,
    off: f64,
    inputs: usize,
    hidden: usize,
    weights: Vec<f64>,
}

impl ContactMap {
    /// The file's text, whose numbers come back with the same bits.
    pub fn to_toml(&self) -> String {
        let takes = self.takes.iter();
        let streams = self.streams.iter();
        let text = MapText {
            format: FORMAT,
            name: self.name.clone(),
            station: self.station.clone(),
            lags_s: self.lags_s.clone(),
            provenance: self.provenance.clone(),
            target: self.target.clone(),
            takes: takes
                .map(|take| TakeText { id: take.id.clone(), fingerprint: take.fingerprint.clone() })
                .collect(),
            streams: streams
                .map(|stream| StreamText {
                    id: stream.id.clone(),
                    channels: stream.channels.clone(),
                    scales_raw: stream.scales_raw.clone(),
                    offsets: stream.offsets.clone(),
                    on: stream.switching.on,
                    off: stream.switching.off,
                    inputs: stream.network.num_inputs(),
                    hidden: stream.network.num_hidden(),
                    weights: stream.network.weights.clone(),
                })
                .collect(),
        };
        toml::to_string(&text).expect("numbers, texts and lists of them have a TOML form")
    }

    /// Reads the text of a file; `file` names it in errors.
    ///
    /// # Errors
    /// Other files, other versions, numbers that do not fit each other or are not finite.
    pub fn from_toml(file: &str, text: &str) -> Result<Self, CalibrationError> {
        let error = |problem: String| CalibrationError::Input(format!("{file}: {problem}"));
        let wrong = |err: toml::de::Error| {
            let line =
                err.span().and_then(|span| text.get(..span.start)).map(|before| before.lines().count());
            let line = line.map_or_else(String::new, |line| format!("line {}: ", line.max(1)));
            error(format!("{line}no contact map that palpate wrote: {}", err.message()))
        };
        let FormatText { format } = toml::from_str(text).map_err(wrong)?;
        if format != FORMAT {
            return Err(error(format!(
                "format {format}, expected {FORMAT}; read it with the palpate that wrote it"
            )));
        }
        let map: MapText = toml::from_str(text).map_err(wrong)?;
        let ascending = map.lags_s.windows(2).all(|two| two[0] < two[1]);
        let within = map.lags_s.iter().all(|lag_s| (0.0..=10.0).contains(lag_s));
        if map.lags_s.first() != Some(&0.0) || !ascending || !within || map.lags_s.len() > MOST {
            return Err(error(format!(
                "lags_s is {:?}, expected times that go up from 0, at most 10 s",
                map.lags_s
            )));
        }
        SensorModel::from_toml(&format!("{file}, target"), &map.target)
            .map_err(|err| error(err.to_string()))?;
        let num_lags = map.lags_s.len();
        let streams = map
            .streams
            .into_iter()
            .map(|stream| {
                let id = stream.id.clone();
                stream.read(num_lags).map_err(|problem| error(format!("stream {id:?}: {problem}")))
            })
            .collect::<Result<_, CalibrationError>>()?;
        Ok(Self {
            name: map.name,
            station: map.station,
            lags_s: map.lags_s,
            target: map.target,
            provenance: map.provenance,
            takes: map
                .takes
                .into_iter()
                .map(|TakeText { id, fingerprint }| FittedTake { id, fingerprint })
                .collect(),
            streams,
        })
    }
}

impl StreamText {
    /// What it says, of windows of `num_lags` readings.
    fn read(self, num_lags: usize) -> Result<StreamMap, String> {
        let num_channels = self.channels.len();
        for (what, numbers) in [("scales_raw", &self.scales_raw), ("offsets", &self.offsets)] {
            if numbers.len() != num_channels {
                return Err(format!("{what} has {} numbers for {num_channels} channels", numbers.len()));
            }
        }
        let numbers = [&self.scales_raw, &self.offsets, &self.weights].into_iter().flatten();
        if let Some(number) = numbers.chain([&self.on, &self.off]).find(|number| !number.is_finite()) {
            return Err(format!("it holds {number}, expected finite numbers"));
        }
        if let Some(scale) = self.scales_raw.iter().find(|scale| **scale <= 0.0) {
            return Err(format!("a scale is {scale}, expected more than 0"));
        }
        if self.off > self.on {
            return Err(format!("off is {}, expected at most on, {}", self.off, self.on));
        }
        if ![num_lags, 2 * num_lags].contains(&self.inputs) || self.hidden > MOST {
            return Err(format!(
                "{} inputs and {} hidden units, expected {num_lags} or {} inputs and at most {MOST} units",
                self.inputs,
                self.hidden,
                2 * num_lags
            ));
        }
        let expected = Network::num_weights(self.inputs, self.hidden);
        let found = self.weights.len();
        let network = Network::new(self.inputs, self.hidden, self.weights)
            .ok_or_else(|| format!("{found} weights, expected {expected}"))?;
        Ok(StreamMap {
            id: self.id,
            channels: self.channels,
            scales_raw: self.scales_raw,
            offsets: self.offsets,
            switching: Switching { on: self.on, off: self.off },
            network,
        })
    }
}
