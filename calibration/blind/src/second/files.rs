//! Recordings as CSV files, and what the importer makes of them.

use std::fmt::Write as _;
use std::path::Path;

use nalgebra::Isometry3;
use palpate_motion::PlannedTake;
use palpate_recording::import::import_csv;
use palpate_recording::{Session, Span, SpanKind, Take};
use palpate_robot_model::{PoseConfig, Station};
use rand_chacha::ChaCha8Rng;

use super::electronics::Samples;
use super::imperfections::{Marks, OperatorConfig};
use super::operator::Pacing;
use super::{Kept, normal};
use crate::BlindError;

/// The files of one take, as somebody's logger would write them.
pub(super) struct TakeFiles {
    config: String,
    joints: String,
    /// Id of each stream, and its file.
    streams: Vec<(String, String)>,
    kept: Kept,
}

impl TakeFiles {
    pub(super) fn new(station: &Station, take: &PlannedTake, pose: &Isometry3<f64>, kept: Kept) -> Self {
        let pose = PoseConfig::from_isometry(pose);
        let mut config = String::new();
        let rotation = pose.quaternion_wxyz;
        let _ = writeln!(config, "object = {:?}\nprimitive = {:?}", take.object, take.primitive);
        let _ = writeln!(
            config,
            "object_pose = {{ position_m = {:?}, quaternion_wxyz = {rotation:?} }}",
            pose.position_m
        );
        if kept == Kept::Events {
            config.push_str("binary = true\n");
        }
        let columns = |prefix: char, count: usize| {
            (0..count).fold("t_s".to_owned(), |header, idx| header + &format!(",{prefix}{idx}")) + "\n"
        };
        let streams = station.layout.streams.iter();
        Self {
            config,
            joints: columns('q', station.robot.num_dofs()),
            streams: streams.map(|stream| (stream.id.clone(), columns('v', stream.channels.len()))).collect(),
            kept,
        }
    }

    /// Marks what is done when, by hand.
    pub(super) fn mark(
        &mut self,
        spans: &[Span],
        pacing: &Pacing,
        operator: &OperatorConfig,
        rng: &mut ChaCha8Rng,
    ) {
        let mut by_hand = |span: &Span| {
            let mut at = |time_s: f64| pacing.real_s(time_s) + operator.mark_s * normal(rng);
            let (start_s, end_s) = (at(span.start_s), at(span.end_s));
            [start_s.max(0.0), end_s.min(pacing.duration_s())]
        };
        let of = |kind: SpanKind| spans.iter().filter(move |span| span.kind == kind);
        let mut repetitions: Vec<([f64; 2], &str)> =
            of(SpanKind::Repetition).map(|span| (by_hand(span), span.label.as_str())).collect();
        repetitions.retain(|([start_s, end_s], _)| end_s > start_s);
        if operator.marks != Marks::None {
            let times: Vec<String> =
                repetitions.iter().map(|([a, b], _)| format!("[{a:.3}, {b:.3}]")).collect();
            let _ = writeln!(self.config, "repetitions_s = [{}]", times.join(", "));
        }
        if operator.marks == Marks::Labelled {
            let labels: Vec<&str> = repetitions.iter().map(|(_, label)| *label).collect();
            let _ = writeln!(self.config, "repetition_labels = {labels:?}");
        }
        if let (Kept::Readings, Some(span)) = (self.kept, of(SpanKind::Baseline).next()) {
            let [start_s, end_s] = [pacing.real_s(span.start_s) + 0.1, pacing.real_s(span.end_s) - 0.1];
            let _ = writeln!(self.config, "baseline_s = [{start_s:.3}, {end_s:.3}]");
        }
    }

    pub(super) fn joints(&mut self, time_s: f64, positions: Vec<f64>) {
        row(&mut self.joints, time_s, &positions);
    }

    pub(super) fn samples(&mut self, stream: usize, samples: Samples) {
        let width = samples.values.len() / samples.times_s.len().max(1);
        for (&time_s, values) in samples.times_s.iter().zip(samples.values.chunks_exact(width.max(1))) {
            row(&mut self.streams[stream].1, time_s, values);
        }
    }

    fn write(&self, dir: &Path) -> std::io::Result<()> {
        std::fs::create_dir(dir)?;
        std::fs::write(dir.join("take.toml"), &self.config)?;
        std::fs::write(dir.join("joints.csv"), &self.joints)?;
        self.streams.iter().try_for_each(|(id, text)| std::fs::write(dir.join(format!("{id}.csv")), text))
    }
}

fn row(text: &mut String, time_s: f64, values: &[f64]) {
    let _ = write!(text, "{time_s:.6}");
    for value in values {
        // Positions to a tenth of a microradian; readings are whole.
        let _ = if value.fract() == 0.0 { write!(text, ",{value}") } else { write!(text, ",{value:.7}") };
    }
    text.push('\n');
}

/// The takes that the importer makes of `files`.
pub(super) fn imported(station: &Station, files: &[TakeFiles]) -> Result<Vec<Take>, BlindError> {
    let dir = tempfile::tempdir().map_err(BlindError::Disk)?;
    let csv = dir.path().join("csv");
    std::fs::create_dir(&csv).map_err(BlindError::Disk)?;
    for (idx, take) in files.iter().enumerate() {
        take.write(&csv.join(format!("take-{:02}", idx + 1))).map_err(BlindError::Disk)?;
    }
    let session = import_csv(station, &csv, &dir.path().join("session"))?;
    Ok(Session::open(&session)?.accepted_takes()?)
}
