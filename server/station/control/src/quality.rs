//! Whether a take can be trusted: what is in the file is compared with what was meant to be.

use palpate_recording::{JointLog, Span, SpanKind, StreamLog, Take};
use palpate_reports::{TakeVerdict, wording::counted};
use palpate_robot_model::{JointKind, StreamConfig};

/// Relative difference from a nominal rate that is no cause for doubt.
const RATE_TOLERANCE: f64 = 0.1;
/// A gap is longer than this many nominal periods ...
const GAP_PERIODS: f64 = 5.0;
/// ... and all gaps together may be this share of the take,
const MOST_GAPS_SHARE: f64 = 0.01;
/// ... none of them longer than this, s: events of a whole touch could be missing.
const LONGEST_GAP_S: f64 = 0.25;
/// Share of a baseline during which a quiet channel may be active.
const MOST_ACTIVE_IN_BASELINE: f64 = 0.02;
/// Spread of a quiet reading, as a share of the threshold: above, noise alone makes events.
const MOST_NOISE: f64 = 0.25;
/// Share of the readings that may be at the end of the range.
const MOST_AT_TOP: f64 = 0.02;
/// How far a joint may be from its command: root of the mean square, and at most; rad and m.
const TRACKING_RAD: [f64; 2] = [0.12, 0.35];
const TRACKING_M: [f64; 2] = [0.006, 0.02];
/// Names that a sentence can bear.
const MOST_NAMES: usize = 6;

/// What the file does not say.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Circumstances<'a> {
    /// Channels that the motion meant to touch.
    pub(crate) planned: &'a [usize],
    /// Nobody planned how joints follow: what a hand holds keeps its fingers from where they are told to be.
    pub(crate) is_free: bool,
    /// Samples that could not be written.
    pub(crate) lost_samples: u64,
    /// The first sample that was refused, in words; empty if none was.
    pub(crate) refusal: &'a str,
    /// Why the take ended early; empty if it did not.
    pub(crate) broken_off: &'a str,
}

/// Judges a take. Whatever is wrong is named with what to do about it.
pub(crate) fn verdict(take: &Take, circumstances: &Circumstances<'_>) -> TakeVerdict {
    let mut problems = Vec::new();
    judge_circumstances(circumstances, &mut problems);
    let joint_rate_hz = rate_hz(&take.joints.times_s);
    let mut rates_hz = vec![("joints".to_owned(), joint_rate_hz)];
    // Joints are recorded as fast as the devices say where they are, which may be faster than the station promises.
    let nominal_hz = take.station.joint_rate_hz.max(joint_rate_hz);
    judge_rate("joints", &take.joints.times_s, nominal_hz, &mut problems);
    let layout = &take.station.layout;
    let mut channels = Vec::with_capacity(layout.num_channels());
    for ((stream, config), log) in layout.streams.iter().zip(&take.station.streams).zip(&take.streams) {
        rates_hz.push((stream.id.clone(), rate_hz(&log.times_s)));
        judge_rate(&stream.id, &log.times_s, stream.rate_hz, &mut problems);
        judge_clock(&stream.id, log, &mut problems);
        let width = stream.channels.len();
        channels.extend((0..width).map(|offset| Channel::of(log, config, offset, width, &take.spans)));
    }
    // Sentences have the names that people use, lists the ids.
    let named = |wanted: &dyn Fn(usize, &Channel) -> bool| -> Vec<String> {
        let found = channels.iter().enumerate().filter(|(channel, seen)| wanted(*channel, seen));
        found.map(|(channel, _)| layout.channel_label(channel)).collect()
    };
    let ids = |wanted: &dyn Fn(usize, &Channel) -> bool| -> Vec<String> {
        let found = channels.iter().zip(&layout.channels).enumerate();
        let found = found.filter(|(channel, (seen, _))| wanted(*channel, seen));
        found.map(|(_, (_, channel))| channel.id.clone()).collect()
    };
    let planned = |channel: usize| circumstances.planned.contains(&channel);

    judge_baseline(take, &named, &mut problems);
    say(&mut problems, &named(&|_, seen| seen.at_top > MOST_AT_TOP), |names, one| {
        format!(
            "{names} {} at the top of the range, so that stronger touches look the same; press less, or check the gain",
            if one { "is" } else { "are" }
        )
    });
    let covered = ids(&|_, seen| seen.touches > 0);
    let missed = ids(&|channel, seen| planned(channel) && seen.touches == 0);
    say(
        &mut problems,
        &named(&|channel, seen| planned(channel) && seen.touches == 0 && seen.constant),
        |names, one| {
            format!(
                "{names} {} the same value throughout: dead or not connected; check cable and board",
                if one { "reads" } else { "read" }
            )
        },
    );
    say(
        &mut problems,
        &named(&|channel, seen| planned(channel) && seen.touches == 0 && !seen.constant),
        |names, one| {
            format!(
                "{names} {} not touched though the motion meant to; check where the object stands, then record again",
                if one { "was" } else { "were" }
            )
        },
    );
    if !circumstances.is_free {
        judge_tracking(take, &mut problems);
    }

    let good = problems.is_empty();
    let summary = match problems.as_slice() {
        [] if circumstances.planned.is_empty() => "rates, clocks and baseline are right".to_owned(),
        [] => format!(
            "all {} planned channels were touched; rates, clocks and baseline are right",
            circumstances.planned.len()
        ),
        [problem] => problem.clone(),
        [first, rest @ ..] => format!("{first} (and {} more)", rest.len()),
    };
    TakeVerdict { good, summary, problems, covered, missed, rates_hz }
}

/// What is said about a take that cannot be read back.
pub(crate) fn unreadable(problem: &str, circumstances: &Circumstances<'_>) -> TakeVerdict {
    let mut problems = vec![format!("the take cannot be used: {problem}; record it again")];
    judge_circumstances(circumstances, &mut problems);
    TakeVerdict {
        good: false,
        summary: problems[0].clone(),
        problems,
        covered: Vec::new(),
        missed: Vec::new(),
        rates_hz: Vec::new(),
    }
}

fn judge_circumstances(circumstances: &Circumstances<'_>, problems: &mut Vec<String>) {
    if !circumstances.broken_off.is_empty() {
        problems.push(format!("the take ended early: {}", circumstances.broken_off));
    }
    if circumstances.lost_samples > 0 {
        let because = match circumstances.refusal {
            "" => "the disk was too slow for them; record to a faster one, or close what else uses it"
                .to_owned(),
            refusal => format!("the first one: {refusal}"),
        };
        problems.push(format!("{} samples were lost: {because}", circumstances.lost_samples));
    }
}

/// What one channel did.
struct Channel {
    /// Times it became active outside baselines.
    touches: usize,
    /// Share of the baseline samples in which it was active.
    active_in_baseline: f64,
    /// Spread of its readings in the baseline over the threshold.
    noise: f64,
    /// Share of its readings at the end of the range.
    at_top: f64,
    /// Whether its reading never changed; false where there are no readings.
    constant: bool,
    /// Whether it was active from the first sample to the last.
    stuck: bool,
}

impl Channel {
    fn of(log: &StreamLog, config: &StreamConfig, offset: usize, width: usize, spans: &[Span]) -> Self {
        let in_baseline: Vec<bool> = log.times_s.iter().map(|&time_s| is_baseline(spans, time_s)).collect();
        let active: Vec<bool> = log.active.iter().skip(offset).step_by(width).copied().collect();
        let touches = (0..active.len())
            .filter(|&sample| {
                // What is active from the start was not touched by this take.
                sample > 0 && active[sample] && !active[sample - 1] && !in_baseline[sample]
            })
            .count();
        let quiet = || active.iter().zip(&in_baseline).filter(|(_, in_baseline)| **in_baseline);
        let raw: Vec<f64> = log.raw.iter().skip(offset).step_by(width).map(|&raw| f64::from(raw)).collect();
        let quiet_raw: Vec<f64> = raw
            .iter()
            .zip(&in_baseline)
            .filter(|(_, in_baseline)| **in_baseline)
            .map(|(raw, _)| *raw)
            .collect();
        Self {
            touches,
            active_in_baseline: share(quiet().filter(|(active, _)| **active).count(), quiet().count()),
            noise: spread(&quiet_raw) / config.on_threshold,
            at_top: share(raw.iter().filter(|&&raw| raw >= config.raw_max).count(), raw.len()),
            constant: raw.len() > 1 && raw.windows(2).all(|pair| pair[0] == pair[1]),
            stuck: !active.is_empty() && active.iter().all(|&active| active),
        }
    }
}

/// Ids of the channels that something is true of.
type Named<'a> = dyn Fn(&dyn Fn(usize, &Channel) -> bool) -> Vec<String> + 'a;

fn judge_baseline(take: &Take, named: &Named<'_>, problems: &mut Vec<String>) {
    if !take.spans.iter().any(|span| span.kind == SpanKind::Baseline) {
        problems
            .push("there is no baseline, so nothing says how quiet channels read; record again".to_owned());
    }
    say(problems, &named(&|_, seen| seen.stuck), |names, one| {
        format!(
            "{names} {} active throughout; tare with nothing in contact, or check the board",
            if one { "was" } else { "were" }
        )
    });
    let touched = named(&|_, seen| !seen.stuck && seen.active_in_baseline > MOST_ACTIVE_IN_BASELINE);
    say(problems, &touched, |names, one| {
        format!(
            "{names} {} active during the baseline; take everything off the hand before it is captured",
            if one { "was" } else { "were" }
        )
    });
    say(problems, &named(&|_, seen| seen.noise > MOST_NOISE), |names, one| {
        format!(
            "{names} {} noisy while nothing touches; check shielding and supply",
            if one { "is" } else { "are" }
        )
    });
}

fn judge_rate(name: &str, times_s: &[f64], nominal_hz: f64, problems: &mut Vec<String>) {
    let rate_hz = rate_hz(times_s);
    if (rate_hz / nominal_hz - 1.0).abs() > RATE_TOLERANCE {
        problems.push(format!(
            "{name}: {rate_hz:.1} Hz, nominal is {nominal_hz:.1} Hz; check the device and its cable, or the rate in the \
             station's files"
        ));
        return;
    }
    let gaps = || {
        times_s.windows(2).map(|pair| pair[1] - pair[0]).filter(|step_s| *step_s > GAP_PERIODS / nominal_hz)
    };
    let longest_s = gaps().fold(0.0, f64::max);
    let duration_s = times_s.last().zip(times_s.first()).map_or(0.0, |(last, first)| last - first);
    if longest_s > LONGEST_GAP_S || gaps().sum::<f64>() > MOST_GAPS_SHARE * duration_s {
        problems.push(format!(
            "{name}: {}, the longest {longest_s:.2} s; samples were lost, so check cable and load",
            counted(gaps().count() as u64, "gap")
        ));
    }
}

fn judge_clock(name: &str, log: &StreamLog, problems: &mut Vec<String>) {
    let steps_back = log.device_times_s.windows(2).filter(|pair| pair[1] < pair[0]).count();
    if steps_back > 0 {
        problems.push(format!(
            "{name}: the device's clock went back {steps_back} times; it restarted, or samples came out of order, so \
             check its supply"
        ));
    }
}

/// Compares where joints were with where they were told to be.
fn judge_tracking(take: &Take, problems: &mut Vec<String>) {
    if take.commands.times_s.is_empty() {
        return;
    }
    for (dof, joint) in take.station.robot.dofs().enumerate() {
        let Some([rms, most]) = tracking(&take.joints, &take.commands, dof, take.station.robot.num_dofs())
        else {
            continue;
        };
        let (limits, unit) = match joint.kind {
            JointKind::Prismatic => (TRACKING_M, "m"),
            _ => (TRACKING_RAD, "rad"),
        };
        if rms > limits[0] || most > limits[1] {
            problems.push(format!(
                "joint {:?} was up to {most:.3} {unit} from where it was told to be ({rms:.3} {unit} on average); check \
                 for something in its way, its current limit and its gains",
                joint.name
            ));
        }
    }
}

/// Root mean square and largest distance between the measured and the commanded positions of a joint, from the first
/// command on.
fn tracking(joints: &JointLog, commands: &JointLog, dof: usize, num_dofs: usize) -> Option<[f64; 2]> {
    let position = |log: &JointLog, frame: usize| log.positions.get(frame * num_dofs + dof).copied();
    let (mut sum, mut most, mut count) = (0.0, 0.0_f64, 0_usize);
    for (frame, time_s) in joints.times_s.iter().enumerate() {
        let given = commands.times_s.partition_point(|command_s| command_s <= time_s);
        let Some(commanded) = given.checked_sub(1).and_then(|command| position(commands, command)) else {
            continue;
        };
        let error = (position(joints, frame)? - commanded).abs();
        sum += error * error;
        most = most.max(error);
        count += 1;
    }
    (count > 0).then(|| [(sum / count as f64).sqrt(), most])
}

fn say(problems: &mut Vec<String>, names: &[String], sentence: impl FnOnce(String, bool) -> String) {
    if !names.is_empty() {
        problems.push(sentence(listed(names), names.len() == 1));
    }
}

/// Names as a sentence has them.
pub(crate) fn listed(names: &[String]) -> String {
    match names {
        [] => "nothing".to_owned(),
        [one] => one.clone(),
        [most @ .., last] if names.len() <= MOST_NAMES => format!("{} and {last}", most.join(", ")),
        _ => format!("{} and {} more", names[..MOST_NAMES].join(", "), names.len() - MOST_NAMES),
    }
}

fn is_baseline(spans: &[Span], time_s: f64) -> bool {
    spans.iter().any(|span| span.kind == SpanKind::Baseline && span.start_s <= time_s && time_s <= span.end_s)
}

fn rate_hz(times_s: &[f64]) -> f64 {
    match times_s {
        [first, .., last] if last > first => (times_s.len() - 1) as f64 / (last - first),
        _ => 0.0,
    }
}

fn share(part: usize, whole: usize) -> f64 {
    if whole == 0 { 0.0 } else { part as f64 / whole as f64 }
}

fn spread(values: &[f64]) -> f64 {
    let count = values.len().max(1) as f64;
    let mean = values.iter().sum::<f64>() / count;
    (values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / count).sqrt()
}

#[cfg(test)]
mod tests;
