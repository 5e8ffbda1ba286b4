//! Takes and their replays, kept in memory so that scrubbing and calibrating again cost nothing.

use std::sync::Arc;

use palpate_calibration::PairedTake;
use palpate_messages::bits;
use palpate_recording::{Session, StreamLog, Take};
use palpate_robot_model::{ObjectPath, PoseConfig};
use palpate_sim::{SensorModel, effects::TakeScene, replay::PatchTrace, tactile::Readings};
use palpate_wire::{
    api::{SessionDetail, SessionSummary, TakeSummary},
    proto::{ReplayTrace, SpanTrace, StreamTrace, TakeTrace},
};

use super::{
    cache::{Cache, FileKey},
    index::TakeIndex,
};
use crate::Error;

/// Recorded takes may fill this much memory, and their replays as much again.
const BUDGET_BYTES: usize = 512 << 20;

/// Reads takes once.
pub struct Library {
    takes: Cache<TakeKey, Take>,
    paired: Cache<TakeKey, PairedTake>,
    summaries: Cache<TakeKey, TakeSummary>,
    /// What takes hold, known without decoding them.
    index: Option<TakeIndex>,
}

/// A take as it was when it was read. `session.toml` belongs to it: it says whether the take was accepted.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct TakeKey {
    take: FileKey,
    session: FileKey,
}

impl Default for Library {
    fn default() -> Self {
        Self::new(BUDGET_BYTES)
    }
}

impl Library {
    /// An empty library that keeps takes of about `budget_bytes`, and replays of as many.
    pub fn new(budget_bytes: usize) -> Self {
        Self {
            takes: Cache::new(budget_bytes),
            paired: Cache::new(budget_bytes),
            // A summary is a few hundred bytes: tens of thousands of takes.
            summaries: Cache::new(16 << 20),
            index: None,
        }
    }

    /// An empty one of the usual size that knows what `index` knows.
    pub(crate) fn with_index(index: TakeIndex) -> Self {
        Self { index: Some(index), ..Self::default() }
    }

    /// Take `take_idx` of `session`.
    pub fn take(&self, session: &Session, take_idx: usize) -> Result<Arc<Take>, Error> {
        self.takes.get_or_try_insert(&key(session, take_idx), take_size_bytes, || Ok(session.take(take_idx)?))
    }

    /// The same, replayed beside its real events.
    pub fn paired(&self, session: &Session, take_idx: usize) -> Result<Arc<PairedTake>, Error> {
        self.paired.get_or_try_insert(&key(session, take_idx), paired_size_bytes, || {
            Ok(PairedTake::from_take(&*self.take(session, take_idx)?)?)
        })
    }

    /// What `session` holds, take by take.
    pub fn detail(&self, session: &Session) -> Result<SessionDetail, Error> {
        let takes = (0..session.file.takes.len())
            .map(|take_idx| self.summary(session, take_idx).map(|summary| (*summary).clone()))
            .collect::<Result<Vec<_>, _>>()?;
        let mut objects: Vec<String> = takes.iter().map(|take| take.object.clone()).collect();
        objects.sort();
        objects.dedup();
        let summary = SessionSummary {
            id: session.id.clone(),
            station: session.file.station.clone(),
            takes: takes.len(),
            frames: takes.iter().map(|take| take.frames).sum(),
            // The sum of no numbers at all is -0.
            duration_s: takes.iter().fold(0.0, |sum, take| sum + take.duration_s),
            objects,
            recorded: session.file.recorded.clone(),
            error: None,
        };
        Ok(SessionDetail { summary, takes })
    }

    /// An entry of the list of sessions: what session `id` holds, or why it could not be `opened`.
    pub(crate) fn list_entry(
        &self,
        id: &str,
        opened: Result<Session, Error>,
        show: impl FnOnce(Error) -> Error,
    ) -> SessionSummary {
        match opened.and_then(|session| self.detail(&session)) {
            Ok(detail) => detail.summary,
            Err(err) => SessionSummary {
                id: id.to_owned(),
                station: String::new(),
                takes: 0,
                frames: 0,
                duration_s: 0.0,
                objects: Vec::new(),
                recorded: String::new(),
                error: Some(crate::chain(&show(err))),
            },
        }
    }

    fn summary(&self, session: &Session, take_idx: usize) -> Result<Arc<TakeSummary>, Error> {
        self.summaries.get_or_try_insert(
            &key(session, take_idx),
            |_| size_of::<TakeSummary>() + 256,
            || {
                let entry = &session.file.takes[take_idx];
                let path = session.take_path(entry);
                let known = self.index.as_ref().and_then(|index| index.get(&path));
                if let Some(known) = known.filter(|known| known.id == entry.id()) {
                    // The session says whether it was accepted.
                    return Ok(TakeSummary { accepted: entry.accepted, ..known });
                }
                let take = self.take(session, take_idx)?;
                let summary = TakeSummary {
                    id: take.id.clone(),
                    object: take.meta.object.clone(),
                    object_pose: pose_numbers(&PoseConfig::from_isometry(&take.meta.base_from_object)),
                    primitive: take.meta.primitive.clone(),
                    frames: take.num_frames(),
                    duration_s: take.duration_s(),
                    accepted: entry.accepted,
                    has_raw: take.has_raw(),
                };
                if let Some(index) = &self.index {
                    index.put(&path, &summary);
                }
                Ok(summary)
            },
        )
    }
}

/// Index of the take called `id`.
pub fn take_index(session: &Session, id: &str) -> Result<usize, Error> {
    session.file.takes.iter().position(|take| take.id() == id).ok_or_else(|| Error::NotFound {
        what: "take",
        id: id.to_owned(),
        hint: "the session's page lists its takes",
    })
}

/// The nominal model of the station that `take` was recorded on.
pub fn nominal_model(take: &Take) -> Result<SensorModel, Error> {
    Ok(SensorModel::from_toml("nominal model of the station", &take.station.nominal_model_toml)?)
}

/// `take`, ready to draw.
pub fn take_trace(take: &Take) -> TakeTrace {
    let streams = take.station.layout.streams.iter().zip(&take.streams).map(|(stream, log)| StreamTrace {
        stream: stream.id.clone(),
        times_s: log.times_s.clone(),
        raw: log
            .times_s
            .iter()
            .zip(log.raw.chunks_exact(stream.channels.len().max(1)))
            .flat_map(|(&time_s, readings)| readings.iter().zip(log.reference_at(time_s)))
            .map(|(raw, reference)| raw - reference)
            .collect(),
        active: bits::pack(log.active.iter().copied()),
        axes: axes_at_samples(log, stream.channels.len() * stream.axes.count()),
    });
    let spans = take.spans.iter().map(|span| SpanTrace {
        kind: match span.kind {
            palpate_recording::SpanKind::Baseline => "baseline",
            palpate_recording::SpanKind::Repetition => "repetition",
            palpate_recording::SpanKind::Note => "note",
        }
        .to_owned(),
        start_s: span.start_s,
        end_s: span.end_s,
        label: span.label.clone(),
    });
    let object_poses = match take.object_path() {
        ObjectPath::Still(_) => Vec::new(),
        ObjectPath::Moving(poses) => {
            let numbers = poses.iter().map(PoseConfig::from_isometry).flat_map(|pose| pose_numbers(&pose));
            numbers.map(|number| number as f32).collect()
        }
    };
    let surroundings = take.meta.surroundings.iter().flat_map(|fixed| {
        let [x, y, z, w, i, j, k] = pose_numbers(&PoseConfig::from_isometry(&fixed.base_from_box));
        let [length, width, height] = fixed.size_m;
        [x, y, z, w, i, j, k, length, width, height].map(|number| number as f32)
    });
    TakeTrace {
        frame_times_s: take.joints.times_s.clone(),
        joint_positions: take.joints.positions.iter().map(|&position| position as f32).collect(),
        real_active: bits::pack(take.active_at_frames()),
        streams: streams.collect(),
        spans: spans.collect(),
        object_poses,
        surroundings: surroundings.collect(),
    }
}

/// What the axes of `log` measured at each of its samples, `width` numbers each; NaN where a sample has none. Empty for
/// streams of one axis.
fn axes_at_samples(log: &StreamLog, width: usize) -> Vec<f32> {
    let axes = &log.axes;
    if axes.values.is_empty() || axes.times_s == log.times_s {
        return axes.values.clone();
    }
    let mut values = Vec::with_capacity(log.times_s.len() * width);
    for time_s in &log.times_s {
        let sample = axes.times_s.binary_search_by(|other| other.total_cmp(time_s)).ok();
        match sample.and_then(|sample| axes.values.get(sample * width..(sample + 1) * width)) {
            Some(measured) => values.extend_from_slice(measured),
            None => values.extend(std::iter::repeat_n(f32::NAN, width)),
        }
    }
    values
}

/// x, y, z in m, then w, x, y, z.
fn pose_numbers(pose: &PoseConfig) -> [f64; 7] {
    let ([x, y, z], [w, i, j, k]) = (pose.position_m, pose.quaternion_wxyz);
    [x, y, z, w, i, j, k]
}

/// `take` as the hardware would have read it if `model` were right, effects and all.
pub fn model_readings(take: &Take, paired: &PairedTake, model: &SensorModel) -> Result<Readings, Error> {
    let object = take.station.objects.get(&take.meta.object).ok_or_else(|| Error::NotFound {
        what: "object",
        id: take.meta.object.clone(),
        hint: "the station file lists its objects",
    })?;
    let scene = TakeScene {
        station: &take.station,
        object,
        base_from_object: &take.object_path(),
        surroundings: &take.meta.surroundings,
        frame_times_s: &take.joints.times_s,
        positions: &take.joints.positions,
        arrival_times_s: &[],
        frozen_for_s: &[],
        tares: &take.tares(),
    };
    model.readings(&scene, &paired.contact).map_err(|err| Error::Content(err.to_string()))
}

/// `take` as `model` replays it.
pub fn replay_trace(take: &Take, paired: &PairedTake, model: &SensorModel) -> Result<ReplayTrace, Error> {
    let layout = &take.station.layout;
    let readings = model_readings(take, paired, model)?;
    let thresholds = palpate_sim::tactile::thresholds(layout, &model.thetas());
    Ok(ReplayTrace {
        model: model.name.clone(),
        active: bits::pack(readings.active.iter().copied()),
        raw: readings.raw.iter().map(|&raw| raw as f32).collect(),
        thresholds: thresholds.into_iter().map(|threshold| threshold as f32).collect(),
    })
}

fn key(session: &Session, take_idx: usize) -> TakeKey {
    // A take beyond the end has no file; reading it says so.
    let entry = session.file.takes.get(take_idx);
    TakeKey {
        take: FileKey::of(&entry.map(|entry| session.take_path(entry)).unwrap_or_default()),
        session: FileKey::of(&session.dir.join("session.toml")),
    }
}

fn take_size_bytes(take: &Take) -> usize {
    let logs = [&take.joints, &take.commands];
    let joints: usize = logs.iter().map(|log| 8 * (log.times_s.len() + log.positions.len())).sum();
    let streams: usize = take
        .streams
        .iter()
        .map(|log| {
            let times = log.times_s.len() + log.device_times_s.len() + log.axes.times_s.len();
            8 * times + 4 * (log.raw.len() + log.axes.values.len()) + log.active.len()
        })
        .sum();
    let station: usize = take.station.files.files.values().map(Vec::len).sum();
    let poses = 64 * take.object_poses.poses.len();
    // The parsed layout is about as large as the texts, several times over.
    joints + poses + streams + 4 * station
}

fn paired_size_bytes(paired: &PairedTake) -> usize {
    let patches = paired.contact.patches.iter().map(|patch| match &**patch {
        // A paired take is replayed with hard pads, which have no gaps.
        PatchTrace::Proximity { min_distance_m, .. } => 8 * min_distance_m.len(),
        PatchTrace::Pressure { offsets, entries } => {
            4 * offsets.len() + size_of::<(u32, f64)>() * entries.len()
        }
    });
    8 * paired.frame_times_s.len() + paired.real_active.len() + patches.sum::<usize>()
}
