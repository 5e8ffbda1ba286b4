//! Trigger events over time: in which frames any channel of a stream is active.

use palpate_robot_model::{SensorKind, TactileLayout};

use crate::PairedTake;

/// Trigger events of one take, as in the paper's figure.
#[derive(Clone, Debug, PartialEq)]
pub struct TakeTimeline {
    /// Id of the take.
    pub take: String,
    /// Id of the object.
    pub object: String,
    /// Whether the fit has not seen this take.
    pub held_out: bool,
    /// Time of each frame since the take's start, s.
    pub frame_times_s: Vec<f64>,
    /// Per stream: proximity streams first, then pressure streams.
    pub streams: Vec<StreamEvents>,
}

/// Frames in which any channel of one stream is active.
#[derive(Clone, Debug, PartialEq)]
pub struct StreamEvents {
    /// Name for people.
    pub label: String,
    /// In reality, one per frame.
    pub real: Vec<bool>,
    /// With the nominal model.
    pub nominal: Vec<bool>,
    /// With the calibrated model.
    pub calibrated: Vec<bool>,
}

impl TakeTimeline {
    pub(crate) fn new(
        layout: &TactileLayout,
        take: &PairedTake,
        held_out: bool,
        nominal: &[bool],
        calibrated: &[bool],
    ) -> Self {
        let num_channels = layout.num_channels().max(1);
        let mut streams: Vec<_> = layout.streams.iter().collect();
        streams.sort_by_key(|stream| stream.kind == SensorKind::Pressure);
        let streams = streams
            .into_iter()
            .map(|stream| {
                let any_active = |active: &[bool]| {
                    let frames = active.chunks_exact(num_channels);
                    frames.map(|frame| frame[stream.channels.clone()].contains(&true)).collect()
                };
                StreamEvents {
                    label: stream.label.clone(),
                    real: any_active(&take.real_active),
                    nominal: any_active(nominal),
                    calibrated: any_active(calibrated),
                }
            })
            .collect();
        Self {
            take: take.id.clone(),
            object: take.object.clone(),
            held_out,
            frame_times_s: take.frame_times_s.clone(),
            streams,
        }
    }
}
