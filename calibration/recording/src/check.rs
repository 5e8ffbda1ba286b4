//! Rates, gaps, clock order and coverage of a session.

use palpate_reports::wording::counted;
use palpate_reports::{ChannelCoverage, CheckReport, Problem, Severity, StreamCheck, TakeCheck};

use crate::{
    RecordingError, Session, SpanKind, Take, axes, decode::decode, format::OBJECT_POSE_TOPIC, object_poses,
    plausible, session::station_difference,
};

/// A channel should be touched at least so often in each half of the takes: below, a dead, stuck or swapped channel
/// cannot be told from one that was not reached.
const MIN_TOUCHES_PER_HALF: usize = 4;
/// Relative difference from the nominal rate that is worth a warning.
const RATE_TOLERANCE: f64 = 0.1;
/// What the joint log is called among the streams.
pub(crate) const JOINTS: &str = "joints";
/// A gap is longer than this many nominal periods.
const GAP_PERIODS: f64 = 3.0;

/// Checks every take of `session`. A take that cannot be read becomes a problem of the report, not an error.
///
/// Rates and clocks are those of all takes, coverage that of the accepted ones.
pub fn check_session(session: &Session) -> Result<CheckReport, RecordingError> {
    let mut report = CheckReport {
        session: session.id.clone(),
        ok: true,
        frames: 0,
        duration_s: 0.0,
        takes: Vec::new(),
        coverage: Vec::new(),
        problems: Vec::new(),
    };
    let mut first: Option<Take> = None;
    let mut falls: Vec<f64> = Vec::new();
    let num_accepted = session.file.takes.iter().filter(|entry| entry.accepted).count();
    let mut accepted_idx = 0;
    for entry in &session.file.takes {
        // By order: with an odd number the first half has one more.
        let half = usize::from(accepted_idx >= num_accepted.div_ceil(2));
        if entry.accepted {
            accepted_idx += 1;
        } else {
            report.add(Severity::Info, entry.id(), "not accepted, so calibration leaves it out");
        }
        let path = session.take_path(entry);
        let decoded = session.take_bytes(entry).and_then(|bytes| decode(&path, &bytes));
        let decoded = match decoded {
            Ok(decoded) => decoded,
            Err(error) => {
                report.add_error(entry.id(), &error);
                continue;
            }
        };
        let take = decoded.take;
        report.frames += take.num_frames();
        report.duration_s += take.duration_s();
        let take_check = TakeCheck { id: take.id.clone(), streams: stream_checks(&take) };
        if let Some(damage) = decoded.damage {
            report.add_error(&take.id, &damage.into_error(&path));
        }
        if let Err(error) = take.check_order(&path) {
            report.add_error(&take.id, &error);
        }
        if let Err(error) = session.check_belongs(entry, &take) {
            report.add_error(&take.id, &error);
        }
        for stream in &take_check.streams {
            report.judge_stream(&take.id, stream);
        }
        report.judge_take(&take);
        report.takes.push(take_check);
        if let Some(difference) = first.as_ref().and_then(|first| station_difference(first, &take)) {
            report.add(Severity::Error, format!("{}, attached station", take.id), difference);
        } else if entry.accepted {
            report.count_touches(&take, half);
            note_falls(&take, &mut falls);
        }
        first.get_or_insert(take);
    }
    report.judge_coverage(first.as_ref(), &falls);
    report.problems.sort_by_key(|problem| problem.severity);
    report.ok = report.problems.iter().all(|problem| problem.severity != Severity::Error);
    Ok(report)
}

/// The rules; a trait of this module, since the report belongs to `palpate_reports`.
trait Judge {
    fn add(&mut self, severity: Severity, place: impl Into<String>, message: impl Into<String>);
    fn add_error(&mut self, take_id: &str, error: &RecordingError);
    fn judge_stream(&mut self, take_id: &str, stream: &StreamCheck);
    fn judge_take(&mut self, take: &Take);
    fn judge_joints(&mut self, take: &Take);
    fn count_touches(&mut self, take: &Take, half: usize);
    fn judge_coverage(&mut self, first: Option<&Take>, falls: &[f64]);
}

impl Judge for CheckReport {
    fn add(&mut self, severity: Severity, place: impl Into<String>, message: impl Into<String>) {
        self.problems.push(Problem { severity, place: place.into(), message: message.into() });
    }

    fn add_error(&mut self, take_id: &str, error: &RecordingError) {
        let (place, problem) = error.place_and_problem();
        self.add(Severity::Error, format!("{take_id}, {place}"), problem);
    }

    fn judge_stream(&mut self, take_id: &str, stream: &StreamCheck) {
        let place = format!("{take_id}, {}", stream.stream);
        let off = stream.rate_hz / stream.nominal_rate_hz - 1.0;
        // Joints are recorded as fast as the devices say where they are.
        let only_faster = off > 0.0 && stream.stream == JOINTS;
        if stream.samples >= 2 && off.abs() > RATE_TOLERANCE && !only_faster {
            let message = format!(
                "{:.1} Hz, nominal is {:.1} Hz; check the device's settings or the rate in the station's files",
                stream.rate_hz, stream.nominal_rate_hz
            );
            self.add(Severity::Warning, &place, message);
        }
        if stream.gaps > 0 {
            let message = format!(
                "{}, the longest {:.3} s; samples were lost, so check cable and load",
                counted(stream.gaps as u64, "gap"),
                stream.longest_gap_s
            );
            self.add(Severity::Warning, place, message);
        }
    }

    fn judge_take(&mut self, take: &Take) {
        if take.has_raw() && !take.spans.iter().any(|span| span.kind == SpanKind::Baseline) {
            let message =
                "no baseline span, so reference values are the first readings; mark a span without touch";
            self.add(Severity::Warning, &take.id, message);
        }
        if !take.station.objects.contains_key(&take.meta.object) {
            let message = format!("the attached station does not know the object {:?}", take.meta.object);
            self.add(Severity::Error, &take.id, message);
        }
        if let Some(problem) = plausible::out_of_reach(&take.station.robot, &take.meta.base_from_object) {
            self.add(Severity::Error, format!("{}, object_pose", take.id), problem);
        }
        for (severity, problem) in object_poses::problems(take) {
            self.add(severity, format!("{}, {OBJECT_POSE_TOPIC}", take.id), problem);
        }
        for (severity, place, problem) in axes::problems(take) {
            self.add(severity, format!("{}, {place}", take.id), problem);
        }
        self.judge_joints(take);
        let layout = &take.station.layout;
        for ((stream, config), log) in layout.streams.iter().zip(&take.station.streams).zip(&take.streams) {
            let width = stream.channels.len().max(1);
            for (offset, channel) in layout.channels[stream.channels.clone()].iter().enumerate() {
                let readings =
                    || log.raw.iter().skip(offset).step_by(width).map(|&reading| f64::from(reading));
                let place = format!("{}, {}", take.id, channel.id);
                let (below, above) = (
                    readings().filter(|&reading| reading < config.raw_min).count(),
                    readings().filter(|&reading| reading > config.raw_max).count(),
                );
                let lowest = readings().fold(f64::INFINITY, f64::min);
                if let Some(problem) = plausible::below_range(config, lowest, &stream.raw_unit) {
                    let message =
                        format!("{}, the lowest of which is {problem}", counted(below as u64, "reading"));
                    self.add(Severity::Error, &place, message);
                }
                if above > 0 {
                    let message = format!(
                        "{above} readings above {} {}, which the device cannot give; check the units",
                        config.raw_max, stream.raw_unit
                    );
                    self.add(Severity::Warning, place, message);
                }
            }
            let steps_back = log.device_times_s.windows(2).filter(|pair| pair[1] <= pair[0]).count();
            if steps_back > 0 {
                let message =
                    format!("the device's clock does not increase {steps_back} times; did it restart?");
                self.add(Severity::Warning, format!("{}, {}", take.id, stream.id), message);
            }
        }
    }

    fn judge_joints(&mut self, take: &Take) {
        let robot = &take.station.robot;
        if plausible::are_degrees(robot, &take.joints.positions) {
            self.add(Severity::Error, format!("{}, {JOINTS}", take.id), plausible::DEGREES);
            return;
        }
        for (dof, joint) in robot.dofs().enumerate() {
            let positions = take.joints.positions.iter().skip(dof).step_by(robot.num_dofs());
            let outside = positions
                .filter_map(|&position| Some((position, plausible::exceeded_limits(joint, position)?)));
            let num_outside = outside.clone().count();
            if let Some((position, limits)) = outside.max_by(|(a, _), (b, _)| a.abs().total_cmp(&b.abs())) {
                let message = format!(
                    "{} of {}, the farthest: {}",
                    counted(num_outside as u64, "position"),
                    take.num_frames(),
                    plausible::outside_limits(joint, position, &limits)
                );
                self.add(Severity::Error, format!("{}, {}", take.id, joint.name), message);
            }
        }
    }

    fn count_touches(&mut self, take: &Take, half: usize) {
        let layout = &take.station.layout;
        if self.coverage.is_empty() {
            self.coverage = layout
                .channels
                .iter()
                .map(|channel| ChannelCoverage {
                    channel: channel.id.clone(),
                    touches: 0,
                    touches_by_half: [0, 0],
                    active_s: 0.0,
                })
                .collect();
        }
        for (stream, log) in layout.streams.iter().zip(&take.streams) {
            let width = stream.channels.len();
            for (offset, channel) in stream.channels.clone().enumerate() {
                let coverage = &mut self.coverage[channel];
                let mut was_active = false;
                for (sample, &time_s) in log.times_s.iter().enumerate() {
                    let active = log.active[sample * width + offset];
                    if active && !was_active {
                        coverage.touches += 1;
                        coverage.touches_by_half[half] += 1;
                    }
                    // A reading holds until the next one.
                    if active && let Some(&next_s) = log.times_s.get(sample + 1) {
                        coverage.active_s += (next_s - time_s).max(0.0);
                    }
                    was_active = active;
                }
            }
        }
    }

    /// `falls`: how far each channel falls under load, 0 where it does not.
    fn judge_coverage(&mut self, first: Option<&Take>, falls: &[f64]) {
        let mut problems = Vec::new();
        let streams = first
            .map(|take| &take.station.layout)
            .into_iter()
            .flat_map(|layout| layout.channels.iter().map(|channel| &layout.streams[channel.stream]));
        for ((coverage, fall), stream) in self.coverage.iter().zip(falls).zip(streams) {
            let [first, second] = coverage.touches_by_half;
            let message = if coverage.touches == 0 && *fall > 0.0 {
                plausible::falls(*fall, stream)
            } else if coverage.touches == 0 {
                "never touched; is it connected, and does a primitive reach it?".to_owned()
            } else if first.min(second) < MIN_TOUCHES_PER_HALF {
                format!(
                    "touched {first} times in the first half of the takes and {second} times in the second; \
                     {MIN_TOUCHES_PER_HALF} in each are needed to judge it"
                )
            } else {
                continue;
            };
            problems.push((coverage.channel.clone(), message));
        }
        for (channel, message) in problems {
            self.add(Severity::Warning, channel, message);
        }
    }
}

/// Adds to `falls`, by channel, how far readings of `take` fall as far as touches make others rise.
fn note_falls(take: &Take, falls: &mut Vec<f64>) {
    let layout = &take.station.layout;
    falls.resize(layout.num_channels(), 0.0);
    for ((stream, config), log) in layout.streams.iter().zip(&take.station.streams).zip(&take.streams) {
        let width = stream.channels.len().max(1);
        for (offset, channel) in stream.channels.clone().enumerate() {
            if let Some(fall) = plausible::fall_under_load(config, log.above_reference(offset, width)) {
                falls[channel] = falls[channel].max(fall);
            }
        }
    }
}

fn stream_checks(take: &Take) -> Vec<StreamCheck> {
    let joints = stream_check(JOINTS, &take.joints.times_s, take.station.joint_rate_hz);
    let streams = take.station.layout.streams.iter().zip(&take.streams);
    std::iter::once(joints)
        .chain(streams.map(|(stream, log)| stream_check(&stream.id, &log.times_s, stream.rate_hz)))
        .collect()
}

pub(crate) fn stream_check(stream: &str, times_s: &[f64], nominal_rate_hz: f64) -> StreamCheck {
    let steps_s = || times_s.windows(2).map(|pair| pair[1] - pair[0]);
    let span_s: f64 = match (times_s.first(), times_s.last()) {
        (Some(first), Some(last)) => last - first,
        _ => 0.0,
    };
    let rate_hz = if span_s > 0.0 { (times_s.len() - 1) as f64 / span_s } else { 0.0 };
    StreamCheck {
        stream: stream.to_owned(),
        samples: times_s.len(),
        rate_hz,
        nominal_rate_hz,
        longest_gap_s: steps_s().fold(0.0, f64::max),
        gaps: steps_s().filter(|&step_s| step_s > GAP_PERIODS / nominal_rate_hz).count(),
        clock_steps_back: steps_s().filter(|&step_s| step_s <= 0.0).count(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rate_gaps_and_steps_back_are_counted() {
        let times_s = [0.0, 0.1, 0.2, 0.15, 0.25, 0.8, 0.9];
        let check = stream_check("pad", &times_s, 10.0);
        assert_eq!((check.samples, check.gaps, check.clock_steps_back), (7, 1, 1));
        assert!((check.rate_hz - 6.0 / 0.9).abs() < 1e-12);
        assert!((check.longest_gap_s - 0.55).abs() < 1e-12);
    }

    #[test]
    fn one_sample_has_no_rate_and_no_gap() {
        let check = stream_check("pad", &[3.0], 10.0);
        assert_eq!((check.rate_hz, check.gaps, check.longest_gap_s), (0.0, 0, 0.0));
    }
}
