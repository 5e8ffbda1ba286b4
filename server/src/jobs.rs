//! Long work, the same for the command line and the server: inputs, progress and a way to stop it come from the caller.

pub(crate) mod board;
mod contact_map;
mod diagnose;
pub(crate) mod kinds;
mod legacy;
pub(crate) mod lineage;
mod next_plan;
pub(crate) mod runs;
pub(crate) mod tables;
pub(crate) mod trainer;
pub(crate) mod way_in;
mod work;

use std::{path::Path, sync::Arc, time::Instant};

pub use board::{JobSource, submit_job};
pub use contact_map::{
    ContactMapArtifacts, ContactMapConfig, ContactTarget, fit_contact_map, judge_contact_map,
};
pub use diagnose::{BarConfig, DiagnosisArtifacts, check_diagnosis, diagnose_sessions, take_of_session};
pub use next_plan::next_plan;
use palpate_calibration::{CalibrationConfig, PairedTake, calibrate, report};
use palpate_recording::{Session, TactileSampleRef, Take, TakeMeta, TakeWriter};
use palpate_reports::CalibrationReport;
use palpate_sim::{
    SensorModel,
    job::{Cancel, Progress},
};
pub use work::run_job;

use crate::{
    Error,
    data::{
        files,
        library::{Library, model_readings, nominal_model},
    },
};

/// Name and version of this program.
pub(crate) fn software() -> String {
    format!("palpate {}", env!("CARGO_PKG_VERSION"))
}

/// What a calibration leaves.
#[derive(Clone, Debug)]
pub struct CalibrationArtifacts {
    /// The numbers.
    pub report: CalibrationReport,
    /// The fitted model.
    pub model: SensorModel,
    /// The self-contained report for people.
    pub html: String,
}

/// Fits the sensor model to the accepted takes of `session`.
pub fn calibrate_session(
    library: &Library,
    session: &Session,
    config: &CalibrationConfig,
    progress: &dyn Progress,
    cancel: &Cancel,
) -> Result<CalibrationArtifacts, Error> {
    let mut takes: Vec<Arc<Take>> = Vec::new();
    let mut paired: Vec<PairedTake> = Vec::new();
    accepted_takes(library, session, cancel, |take_idx, share| {
        let take = library.take(session, take_idx)?;
        progress.report(0.6 * share, &format!("replaying {}", take.id));
        paired.push((*library.paired(session, take_idx)?).clone());
        takes.push(take);
        Ok(())
    })?;
    let first = &takes[0];
    let nominal = nominal_model(first)?;
    let search = Section { whole: progress, start: 0.6, end: 0.97 };
    let start = Instant::now();
    let clock_s = || start.elapsed().as_secs_f64();
    let layout = &first.station.layout;
    let outcome = calibrate(config, layout, &nominal, &paired, &search, cancel, &clock_s)?;
    progress.report(0.97, "writing the report");
    let source = report::ReportSource { session: &session.id, station: &session.file.station, created: "" };
    let html = report::html(source, &outcome);
    let mut model = outcome.model;
    model.name = format!("{} ({})", session.id, config.method.name());
    model.provenance.push(format!("session {}, station {}", session.id, session.file.station));
    model.provenance.push(format!("palpate {}", env!("CARGO_PKG_VERSION")));
    Ok(CalibrationArtifacts { report: outcome.report, model, html })
}

/// Calls `read` with the index of every accepted take of `session` (at least one) and how far that is through them,
/// having made sure that they belong together.
fn accepted_takes(
    library: &Library,
    session: &Session,
    cancel: &Cancel,
    mut read: impl FnMut(usize, f64) -> Result<(), Error>,
) -> Result<(), Error> {
    let accepted: Vec<usize> =
        (0..session.file.takes.len()).filter(|&take_idx| session.file.takes[take_idx].accepted).collect();
    let Some(&first_idx) = accepted.first() else {
        // Says what is wrong in the words of the session.
        return Err(session.accepted_takes().map_or_else(Error::from, |_| Error::Cancelled));
    };
    let first = library.take(session, first_idx)?;
    for (done, &take_idx) in accepted.iter().enumerate() {
        if cancel.is_cancelled() {
            return Err(Error::Cancelled);
        }
        // Stations of one session have the same texts as a rule; where not, the session knows what may differ.
        if library.take(session, take_idx)?.station.files != first.station.files {
            session.accepted_takes()?;
        }
        read(take_idx, done as f64 / accepted.len() as f64)?;
    }
    Ok(())
}

/// Writes `take` to `out` with the events that `model` gives in place of the recorded ones, on the take's joint frames.
///
/// Raw readings are the signals that the model compares with its thresholds: propagated pressure in Pa, signed distance
/// in m. `out` appears only when it is complete.
pub fn write_replay(
    take: &Take,
    contact: &PairedTake,
    model: &SensorModel,
    out: &Path,
    progress: &dyn Progress,
) -> Result<(), Error> {
    let layout = &take.station.layout;
    let readings = model_readings(take, contact, model)?;
    let meta = TakeMeta {
        software: format!("palpate {}, replay with model {:?}", env!("CARGO_PKG_VERSION"), model.name),
        ..take.meta.clone()
    };
    files::write_with(out, |sink| {
        let mut writer = TakeWriter::new(sink, &take.station, &meta, take.start_unix_ns)?;
        for span in &take.spans {
            writer.span(span)?;
        }
        let num_dofs = take.station.robot.num_dofs();
        let num_frames = readings.num_frames;
        let poses = &take.object_poses;
        let mut poses = poses.times_s.iter().zip(&poses.poses).peekable();
        for (frame, &time_s) in take.joints.times_s.iter().enumerate() {
            let time_ns = (time_s * 1e9).round() as u64;
            let is_last = frame + 1 == num_frames;
            while let Some((&pose_s, pose)) = poses.next_if(|(pose_s, _)| **pose_s <= time_s || is_last) {
                writer.object_pose((pose_s * 1e9).round() as u64, pose)?;
            }
            writer.joints(time_ns, &take.joints.positions[frame * num_dofs..(frame + 1) * num_dofs])?;
            let row = frame * readings.num_channels;
            for (stream_idx, stream) in layout.streams.iter().enumerate() {
                let channels = row + stream.channels.start..row + stream.channels.end;
                let raw: Vec<f32> = readings.raw[channels.clone()].iter().map(|&raw| raw as f32).collect();
                let sample =
                    TactileSampleRef { raw: &raw, active: &readings.active[channels], device_time_ns: 0 };
                writer.tactile(stream_idx, time_ns, sample)?;
            }
            if frame % 256 == 0 {
                progress.report(frame as f64 / num_frames as f64, "writing the take");
            }
        }
        writer.finish()?;
        Ok(())
    })
}

/// A part of a larger job's progress.
struct Section<'a> {
    whole: &'a dyn Progress,
    start: f64,
    end: f64,
}

impl Progress for Section<'_> {
    fn report(&self, fraction: f64, stage: &str) {
        self.whole.report(self.start + (self.end - self.start) * fraction.clamp(0.0, 1.0), stage);
    }
}
