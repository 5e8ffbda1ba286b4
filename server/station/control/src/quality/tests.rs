use std::path::Path;

use nalgebra::Isometry3;
use palpate_recording::{PoseLog, TakeMeta, load_station};

use super::*;

/// Four seconds of the finger: quiet for one, then channel 0 (of the gel) and 3 (of the film) are touched for a second.
fn good() -> Take {
    let path =
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../tests/fixtures/finger-station/station.toml");
    let station = load_station(&path).expect("the fixture reads");
    let joints = JointLog {
        times_s: (0..40).map(|frame| frame as f64 * 0.1).collect(),
        positions: (0..40).flat_map(|frame| [frame as f64 * 1e-3, -0.5]).collect(),
    };
    let streams = station.layout.streams.iter().map(|stream| {
        let width = stream.channels.len();
        let times_s: Vec<f64> =
            (0..(4.0 * stream.rate_hz) as usize).map(|sample| sample as f64 / stream.rate_hz).collect();
        let touched = |time_s: f64, offset: usize| (2.0..3.0).contains(&time_s) && offset == 0;
        let cells = || times_s.iter().flat_map(|&time_s| (0..width).map(move |offset| (time_s, offset)));
        StreamLog {
            raw: cells()
                .map(|(time_s, offset)| quiet(time_s) + if touched(time_s, offset) { 200.0 } else { 0.0 })
                .collect(),
            active: cells().map(|(time_s, offset)| touched(time_s, offset)).collect(),
            device_times_s: times_s.clone(),
            reference: vec![200.0; width],
            times_s,
            ..StreamLog::default()
        }
    });
    Take {
        id: "take-01".to_owned(),
        meta: TakeMeta {
            object: "ball".to_owned(),
            base_from_object: Isometry3::identity(),
            primitive: "tap".to_owned(),
            fixture_trusted: true,
            operator: String::new(),
            software: String::new(),
            surroundings: Vec::new(),
        },
        start_unix_ns: 0,
        commands: joints.clone(),
        joints,
        object_poses: PoseLog::default(),
        streams: streams.collect(),
        spans: vec![Span { kind: SpanKind::Baseline, start_s: 0.0, end_s: 1.0, label: String::new() }],
        station,
    }
}

/// What an untouched channel reads.
fn quiet(time_s: f64) -> f32 {
    200.0 + ((time_s * 1e3) as u64 % 3) as f32
}

fn judged(change: impl FnOnce(&mut Take)) -> TakeVerdict {
    let mut take = good();
    change(&mut take);
    verdict(&take, &Circumstances { planned: &[0, 3], ..Circumstances::default() })
}

/// Leaves out the samples of stream `stream_idx` whose number `leave_out` names.
fn thin(take: &mut Take, stream_idx: usize, leave_out: impl Fn(usize) -> bool) {
    let width = take.station.layout.streams[stream_idx].channels.len();
    let log = &mut take.streams[stream_idx];
    let keep = |sample: &usize| !leave_out(*sample);
    let kept: Vec<usize> = (0..log.times_s.len()).filter(keep).collect();
    let cells = |sample: &usize| (sample * width..(sample + 1) * width).collect::<Vec<_>>();
    log.raw = kept.iter().flat_map(cells).map(|cell| log.raw[cell]).collect();
    log.active = kept.iter().flat_map(cells).map(|cell| log.active[cell]).collect();
    log.device_times_s = kept.iter().map(|&sample| log.device_times_s[sample]).collect();
    log.times_s = kept.iter().map(|&sample| log.times_s[sample]).collect();
}

fn set_channel(take: &mut Take, channel: usize, mut reading: impl FnMut(f64) -> (f32, bool)) {
    let stream_idx = take.station.layout.channels[channel].stream;
    let stream = take.station.layout.streams[stream_idx].channels.clone();
    let log = &mut take.streams[stream_idx];
    for (sample, &time_s) in log.times_s.iter().enumerate() {
        let cell = sample * stream.len() + channel - stream.start;
        (log.raw[cell], log.active[cell]) = reading(time_s);
    }
}

#[test]
fn a_good_take_is_called_so() {
    let verdict = judged(|_| {});
    assert!(verdict.good, "{verdict:#?}");
    assert_eq!(verdict.summary, "all 2 planned channels were touched; rates, clocks and baseline are right");
    assert_eq!((verdict.covered, verdict.missed), (vec!["tip.0".to_owned(), "pulp".to_owned()], vec![]));
    let rates: Vec<(String, i64)> =
        verdict.rates_hz.into_iter().map(|(name, hz)| (name, hz.round() as i64)).collect();
    assert_eq!(rates, [("joints".to_owned(), 10), ("gel".to_owned(), 100), ("film".to_owned(), 40)]);
}

#[test]
fn every_fault_is_named_by_itself() {
    type Change<'a> = &'a dyn Fn(&mut Take);
    let cases: Vec<(Change<'_>, &str)> = vec![
        (&|take| thin(take, 0, |sample| sample % 2 == 1), "gel: 50.0 Hz, nominal is 100.0 Hz"),
        (&|take| thin(take, 1, |sample| (128..139).contains(&sample)), "film: 1 gap, the longest 0.30 s"),
        (&|take| take.streams[0].device_times_s[70] = 0.1, "gel: the device's clock went back 1 times"),
        (&|take| take.spans.clear(), "there is no baseline"),
        (
            &|take| set_channel(take, 4, |time_s| (quiet(time_s), time_s < 0.5)),
            "Root was active during the baseline; take everything off",
        ),
        (&|take| set_channel(take, 4, |time_s| (quiet(time_s), true)), "Root was active throughout; tare"),
        (
            &|take| set_channel(take, 2, |time_s| (200.0 + 40.0 * (time_s * 60.0).sin() as f32, false)),
            "Tip \u{b7} 2 is noisy while nothing touches",
        ),
        (
            &|take| {
                set_channel(take, 0, |time_s| {
                    let touched = (2.0..3.0).contains(&time_s);
                    (if touched { 4095.0 } else { quiet(time_s) }, touched)
                });
            },
            "Tip \u{b7} 0 is at the top of the range",
        ),
        (
            &|take| set_channel(take, 3, |time_s| (quiet(time_s), false)),
            "Pulp was not touched though the motion meant to",
        ),
        (&|take| set_channel(take, 3, |_| (0.0, false)), "Pulp reads the same value throughout: dead"),
        (
            &|take| {
                take.joints.positions.iter_mut().skip(21).step_by(2).for_each(|position| *position += 0.2);
            },
            "joint \"curl\" was up to 0.200 rad from where it was told to be",
        ),
        (&|take| take.joints.positions[20] += 0.05, "joint \"slide\" was up to 0.050 m from where"),
    ];
    for (change, expected) in cases {
        let verdict = judged(change);
        assert!(!verdict.good);
        assert_eq!(verdict.problems.len(), 1, "{expected}: {verdict:#?}");
        assert!(verdict.problems[0].starts_with(expected), "{:?}\nis not\n{expected}", verdict.problems[0]);
        assert_eq!(verdict.summary, verdict.problems[0]);
    }
}

#[test]
fn joints_may_be_faster_than_promised_and_their_gaps_are_found_all_the_same() {
    let fast = |take: &mut Take, in_gap: &dyn Fn(f64) -> bool| {
        let times_s = (0..400).map(|frame| frame as f64 * 0.01).filter(|&time_s| !in_gap(time_s));
        let times_s: Vec<f64> = times_s.collect();
        take.joints.positions = times_s.iter().flat_map(|_| [0.0, -0.5]).collect();
        take.joints.times_s = times_s;
        take.commands = take.joints.clone();
    };
    assert!(judged(|take| fast(take, &|_| false)).good);
    let verdict = judged(|take| fast(take, &|time_s| (1.5..1.85).contains(&time_s)));
    assert!(verdict.problems[0].starts_with("joints: 1 gap, the longest 0.36 s"), "{verdict:#?}");
    let verdict = judged(|take| {
        take.joints.times_s.iter_mut().for_each(|time_s| *time_s *= 2.0);
        take.commands = take.joints.clone();
    });
    assert!(verdict.problems[0].starts_with("joints: 5.0 Hz, nominal is 10.0 Hz"), "{verdict:#?}");
}

#[test]
fn missed_channels_are_listed_and_unplanned_ones_need_not_be_touched() {
    let verdict = judged(|take| {
        for channel in [0, 3] {
            set_channel(take, channel, |time_s| (quiet(time_s), false));
        }
    });
    assert_eq!(verdict.missed, ["tip.0", "pulp"]);
    assert!(verdict.problems[0].starts_with("Tip \u{b7} 0 and Pulp were not touched"), "{verdict:#?}");
}

#[test]
fn fingers_that_hold_something_may_be_elsewhere_than_they_are_told_to_be() {
    let mut take = good();
    take.joints.positions.iter_mut().skip(21).step_by(2).for_each(|position| *position += 0.2);
    let judged = |is_free| verdict(&take, &Circumstances { is_free, ..Circumstances::default() });
    assert!(judged(true).good && !judged(false).good);
}

#[test]
fn what_the_file_does_not_say_counts_too() {
    let circumstances = Circumstances {
        planned: &[0],
        is_free: false,
        lost_samples: 3,
        refusal: "",
        broken_off: "the station stopped: the emergency stop is pressed",
    };
    let verdict = verdict(&good(), &circumstances);
    assert_eq!(verdict.problems.len(), 2);
    assert!(verdict.summary.starts_with("the take ended early: the station stopped"), "{verdict:#?}");
    assert!(verdict.summary.ends_with("(and 1 more)"), "{verdict:#?}");
    let nothing = unreadable("take-01.mcap: byte 0: the recording is cut off", &circumstances);
    assert!(
        !nothing.good && nothing.summary.starts_with("the take cannot be used: take-01.mcap"),
        "{nothing:#?}"
    );
}

#[test]
fn long_lists_are_cut() {
    let names: Vec<String> = (0..9).map(|channel| format!("c{channel}")).collect();
    assert_eq!(listed(&names), "c0, c1, c2, c3, c4, c5 and 3 more");
    assert_eq!(listed(&names[..3]), "c0, c1 and c2");
}
