//! Records a whole calibration session from the truth world.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

use nalgebra::Isometry3;
use palpate_motion::{PlanError, PlannedTake, Scene};
use palpate_recording::{
    RecordingError, Session, SessionDraft, SessionFile, SessionTake, TactileSampleRef, TakeMeta, TakeWriter,
};
use palpate_sim::job::{Cancel, Progress};
use rayon::prelude::*;

use crate::TruthWorld;
use crate::motion::plan_take;
use crate::truth::Emulation;
use crate::world::Event;

/// Time between the end of one take and the start of the next, s.
const BETWEEN_TAKES_S: f64 = 30.0;
/// Progress and cancellation are looked at this often, s of the take.
const SLICE_S: f64 = 1.0;

/// An emulation that cannot be run.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum EmulationError {
    /// The truth file, its plan or a primitive is wrong, or a motion cannot be.
    #[error("{file}: {place}: {problem}")]
    Truth {
        /// Which file.
        file: String,
        /// Where in it.
        place: String,
        /// What is wrong and what to do.
        problem: String,
    },
    /// The station or the disk.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// Somebody cancelled.
    #[error("cancelled")]
    Cancelled,
}

impl From<PlanError> for EmulationError {
    fn from(error: PlanError) -> Self {
        let PlanError { file, place, problem } = error;
        Self::Truth { file, place, problem }
    }
}

/// Records the session that the truth file at `truth_path` describes into `out_dir`, which must not exist.
/// Same truth, same seed: same bytes.
///
/// Takes are recorded side by side on rayon's current pool; on an error, or when cancelled, nothing stays on disk.
pub fn record_session(
    truth_path: &Path,
    out_dir: &Path,
    seed: u64,
    progress: &dyn Progress,
    cancel: &Cancel,
) -> Result<Session, EmulationError> {
    let emulation = Emulation::read(truth_path)?;
    let draft = SessionDraft::new(out_dir)?;
    let scenes = scenes(&emulation)?;
    let takes = &emulation.plan.takes;
    let total_s: f64 = takes.iter().map(|take| take.duration_s).sum();
    // Milliseconds of take that are done: a number that threads can add to.
    let done_ms = AtomicU64::new(0);
    progress.report(0.0, "planning motions");
    let recorded: Result<Vec<SessionTake>, EmulationError> = (0..takes.len())
        .into_par_iter()
        .map(|take_idx| {
            let name = format!("take-{:02}.mcap", take_idx + 1);
            let recorder =
                Recorder { emulation: &emulation, scene: &scenes[&takes[take_idx].object], take_idx, cancel };
            recorder.record(&draft.partial_dir().join(&name), seed, &mut |slice_s| {
                let done =
                    done_ms.fetch_add((slice_s * 1e3) as u64, Ordering::Relaxed) as f64 * 1e-3 + slice_s;
                progress.report(
                    (done / total_s).min(1.0),
                    &format!("recording take {} of {}", take_idx + 1, takes.len()),
                );
            })?;
            Ok(SessionTake { file: name, object: takes[take_idx].object.clone(), accepted: true })
        })
        .collect();
    let file = SessionFile {
        format: 1,
        station: emulation.station.id.clone(),
        recorded: emulation.truth.recorded.to_string(),
        takes: recorded?,
    };
    progress.report(1.0, "done");
    Ok(draft.commit(file)?)
}

/// A scene for each object that the plan poses.
pub(crate) fn scenes(emulation: &Emulation) -> Result<BTreeMap<String, Scene<'_>>, EmulationError> {
    let plan = &emulation.plan;
    let scene = |id: &String| Ok((id.clone(), plan.scene(&emulation.station, id)?));
    plan.objects.keys().map(scene).collect()
}

struct Recorder<'a> {
    emulation: &'a Emulation,
    scene: &'a Scene<'a>,
    take_idx: usize,
    cancel: &'a Cancel,
}

impl Recorder<'_> {
    fn record(&self, path: &Path, seed: u64, done: &mut dyn FnMut(f64)) -> Result<(), EmulationError> {
        self.check_cancel()?;
        let take = &self.emulation.plan.takes[self.take_idx];
        let object = &self.emulation.station.objects[&take.object];
        let base_from_object = self.scene.base_from_object();
        // The world first: it refuses impossible elastomers at once, while planning takes a moment.
        let mut world =
            TruthWorld::new(self.emulation, object, &base_from_object, seed, self.take_idx as u64)?;
        let motion = plan_take(self.emulation, self.scene, self.take_idx)?;
        self.check_cancel()?;
        let meta = take_meta(self.emulation, take, &base_from_object);
        let sink = File::create(path).map_err(|source| io_error("write", path, source))?;
        let mut writer = TakeWriter::new(
            BufWriter::new(sink),
            &self.emulation.station,
            &meta,
            start_unix_ns(self.emulation, self.take_idx),
        )?;
        for span in &motion.spans {
            writer.span(span)?;
        }
        let mut now_s = 0.0_f64;
        while now_s < take.duration_s {
            self.check_cancel()?;
            let slice_s = SLICE_S.min(take.duration_s - now_s);
            now_s += slice_s;
            world.advance(now_s, |time_s, positions| motion.at(time_s, positions), &mut |event| {
                match event {
                    Event::Joints { host_ns, positions } => {
                        writer.joints(host_ns.unsigned_abs(), &positions)?;
                    }
                    Event::Tactile { stream, sample } => {
                        let device_time_ns = sample.device_ns;
                        let contents =
                            TactileSampleRef { raw: &sample.raw, active: &sample.active, device_time_ns };
                        writer.tactile(stream, sample.host_ns.unsigned_abs(), contents)?;
                    }
                }
                Ok(())
            })?;
            done(slice_s);
        }
        let sink = writer.finish()?;
        sink.into_inner().map_err(|error| io_error("write", path, error.into_error()))?;
        Ok(())
    }

    fn check_cancel(&self) -> Result<(), EmulationError> {
        if self.cancel.is_cancelled() { Err(EmulationError::Cancelled) } else { Ok(()) }
    }
}

/// What is written about a take whose object stands at `base_from_object`.
pub(crate) fn take_meta(
    emulation: &Emulation,
    take: &PlannedTake,
    base_from_object: &Isometry3<f64>,
) -> TakeMeta {
    TakeMeta {
        object: take.object.clone(),
        base_from_object: emulation.secrets.recorded_pose(&take.object, base_from_object),
        primitive: take.primitive.clone(),
        fixture_trusted: true,
        operator: emulation.truth.operator.clone(),
        software: concat!("palpate emulator ", env!("CARGO_PKG_VERSION")).to_owned(),
        surroundings: Vec::new(),
    }
}

/// When a take starts, ns since 1970: takes follow one another with a fixed break.
pub(crate) fn start_unix_ns(emulation: &Emulation, take_idx: usize) -> u64 {
    let before = &emulation.plan.takes[..take_idx];
    let after_s: f64 = before.iter().map(|take| take.duration_s + BETWEEN_TAKES_S).sum();
    emulation.start_unix_ns + (after_s * 1e9).round() as u64
}

fn io_error(action: &'static str, path: &Path, source: std::io::Error) -> EmulationError {
    RecordingError::Io { action, path: path.to_path_buf(), source }.into()
}
