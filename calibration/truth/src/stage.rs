//! Sessions in memory: motions planned once, recorded as often as wanted with other things hidden.

use std::path::Path;

use nalgebra::Isometry3;
use palpate_motion::{Plan, TakeMotion};
use palpate_recording::{JointLog, PoseLog, Span, SpanKind, StreamLog, Take};
use palpate_robot_model::Station;
use rayon::prelude::*;

use crate::hidden::Hidden;
use crate::motion::plan_take;
use crate::session::{scenes, start_unix_ns, take_meta};
use crate::truth::{Emulation, Truth};
use crate::world::Event;
use crate::{EmulationError, TruthWorld};

/// A truth file with its motions planned.
///
/// What is hidden changes neither the motions nor what they were planned for, so one stage serves for any number of
/// recordings: planning takes seconds, a recording a fraction of one.
#[derive(Clone, Debug)]
pub struct Stage {
    emulation: Emulation,
    motions: Vec<TakeMotion>,
    /// Where the object of each take really stands.
    poses: Vec<Isometry3<f64>>,
}

impl Stage {
    /// Reads the truth file at `truth_path` and plans all its motions.
    pub fn read(truth_path: &Path) -> Result<Self, EmulationError> {
        let emulation = Emulation::read(truth_path)?;
        let scenes = scenes(&emulation)?;
        let takes = &emulation.plan.takes;
        let motions: Vec<TakeMotion> = (0..takes.len())
            .into_par_iter()
            .map(|take_idx| plan_take(&emulation, &scenes[&takes[take_idx].object], take_idx))
            .collect::<Result<_, _>>()?;
        let poses = takes.iter().map(|take| scenes[&take.object].base_from_object()).collect();
        drop(scenes);
        Ok(Self { emulation, motions, poses })
    }

    /// The truth that was read.
    pub fn truth(&self) -> &Truth {
        &self.emulation.truth
    }

    /// Its plan.
    pub fn plan(&self) -> &Plan {
        &self.emulation.plan
    }

    /// The planned motion of each take.
    pub fn motions(&self) -> &[TakeMotion] {
        &self.motions
    }

    /// Where the object of each take is planned to stand, in the base frame.
    pub fn poses(&self) -> &[Isometry3<f64>] {
        &self.poses
    }

    /// The station.
    pub fn station(&self) -> &Station {
        &self.emulation.station
    }

    /// Records the session with `hidden` in the world, beside what the truth file hides: the takes that
    /// [`record_session`](crate::record_session) would write, without the disk. Same seed, same bits, for any number
    /// of threads of rayon's current pool.
    pub fn record(&self, hidden: &[Hidden], seed: u64) -> Result<Vec<Take>, EmulationError> {
        let emulation = self.emulation.hiding(hidden)?;
        (0..self.motions.len())
            .into_par_iter()
            .map(|take_idx| self.record_take(&emulation, seed, take_idx))
            .collect()
    }

    fn record_take(&self, emulation: &Emulation, seed: u64, take_idx: usize) -> Result<Take, EmulationError> {
        let planned = &emulation.plan.takes[take_idx];
        let motion = &self.motions[take_idx];
        let base_from_object = self.poses[take_idx];
        let station = &emulation.station;
        let object = &station.objects[&planned.object];
        let mut world = TruthWorld::new(emulation, object, &base_from_object, seed, take_idx as u64)?;
        let mut joints = JointLog::default();
        let mut streams = vec![StreamLog::default(); station.layout.streams.len()];
        world.advance(planned.duration_s, |time_s, at| motion.at(time_s, at), &mut |event| {
            match event {
                Event::Joints { host_ns, positions } => {
                    joints.times_s.push(secs_from_ns(host_ns.unsigned_abs()));
                    joints.positions.extend(positions);
                }
                Event::Tactile { stream, sample } => {
                    let log = &mut streams[stream];
                    log.times_s.push(secs_from_ns(sample.host_ns.unsigned_abs()));
                    log.device_times_s.push(secs_from_ns(sample.device_ns));
                    log.raw.extend(sample.raw);
                    log.active.extend(sample.active);
                }
            }
            Ok(())
        })?;
        for (stream, log) in station.layout.streams.iter().zip(&mut streams) {
            log.reference = reference(log, stream.channels.len(), &motion.spans);
        }
        Ok(Take {
            id: format!("take-{:02}", take_idx + 1),
            meta: take_meta(emulation, planned, &base_from_object),
            start_unix_ns: start_unix_ns(emulation, take_idx),
            station: Station::clone(station),
            joints,
            commands: JointLog::default(),
            object_poses: PoseLog::default(),
            streams,
            spans: motion.spans.iter().map(as_written).collect(),
        })
    }
}

/// Seconds as a reader of takes makes them from ns.
fn secs_from_ns(time_ns: u64) -> f64 {
    time_ns as f64 / 1e9
}

/// A span with its times rounded to ns, as takes hold them.
fn as_written(span: &Span) -> Span {
    let rounded = |time_s: f64| secs_from_ns((time_s * 1e9).round() as u64);
    Span { start_s: rounded(span.start_s), end_s: rounded(span.end_s), ..span.clone() }
}

/// Mean reading of each channel over the baseline, as a reader of takes finds it.
fn reference(log: &StreamLog, width: usize, spans: &[Span]) -> Vec<f32> {
    let quiet = |time_s: f64| {
        let holds = |span: &Span| span.start_s <= time_s && time_s <= span.end_s;
        spans.iter().map(as_written).any(|span| span.kind == SpanKind::Baseline && holds(&span))
    };
    let mut sums = vec![0.0_f64; width];
    let mut count = 0_usize;
    for (&time_s, readings) in log.times_s.iter().zip(log.raw.chunks_exact(width.max(1))) {
        if quiet(time_s) {
            count += 1;
            sums.iter_mut().zip(readings).for_each(|(sum, &reading)| *sum += f64::from(reading));
        }
    }
    if count == 0 {
        return log.raw.get(..width).unwrap_or_default().to_vec();
    }
    sums.iter().map(|sum| (sum / count as f64) as f32).collect()
}
