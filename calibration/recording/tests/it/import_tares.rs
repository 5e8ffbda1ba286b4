//! Import of recordings whose reference is taken anew before each press.

use std::{fmt::Write as _, fs, path::Path};

use palpate_recording::{
    Session, Take,
    import::{ImportOptions, ImportReport, explain, import},
};

use crate::support::station;

const ABOUT: &str = "object = \"ball\"\nobject_pose = { position_m = [0.1, 0.0, 0.05] }\nprimitive = \"tap\"\n\
                     repetitions_s = []\n";
/// Spans before each press.
const ANEW: &str = "baseline_s = [[0.0, 0.5], [1.0, 1.4], [2.4, 2.9]]";
const PRESSES_S: [[f64; 2]; 2] = [[1.5, 1.8], [3.0, 3.3]];

fn is_pressed(time_s: f64) -> bool {
    PRESSES_S.iter().any(|press| (press[0]..press[1]).contains(&time_s))
}

/// Readings of the gel over 3.9 s, of which the middle taxel is pressed and gains `drift` from what it was.
fn write_recording(dir: &Path, baseline: &str, drift: impl Fn(f64) -> f64) {
    fs::create_dir_all(dir).unwrap();
    fs::write(dir.join("take.toml"), format!("{ABOUT}{baseline}\n")).unwrap();
    let csv = |header: &str, rate_hz: i32, row: &dyn Fn(f64) -> String| {
        let mut text = header.to_owned();
        let times_s = (0..rate_hz * 39 / 10).map(|idx| f64::from(idx) / f64::from(rate_hz));
        times_s.for_each(|time_s| write!(text, "\n{time_s},{}", row(time_s)).unwrap());
        text + "\n"
    };
    let gel = |time_s: f64| {
        let pressed = if is_pressed(time_s) { 100.0 } else { 0.0 };
        format!("200,{},190", 210.0 + drift(time_s) + pressed)
    };
    fs::write(dir.join("joints.csv"), csv("t,slide,curl", 10, &|_| "0.1,-0.5".to_owned())).unwrap();
    fs::write(dir.join("film.csv"), csv("t,pulp,root", 40, &|_| "300,310".to_owned())).unwrap();
    fs::write(dir.join("gel.csv"), csv("t,tip.0,tip.1,tip.2", 100, &gel)).unwrap();
}

fn imported(baseline: &str, drift: impl Fn(f64) -> f64) -> Result<(Take, ImportReport), String> {
    let root = tempfile::tempdir().unwrap();
    write_recording(&root.path().join("csv/take-01"), baseline, drift);
    let options = ImportOptions::default();
    let made = import(&station(), &root.path().join("csv"), options, &root.path().join("session"));
    let (dir, report) = made.map_err(|error| error.to_string())?;
    Ok((Session::open(&dir).unwrap().take(0).unwrap(), report))
}

/// How many samples of the middle taxel are on where nothing presses, and off where something does.
fn wrong(take: &Take) -> [usize; 2] {
    let gel = &take.streams[0];
    let on = |sample: usize| gel.active[sample * 3 + 1];
    let samples = || gel.times_s.iter().enumerate();
    [
        samples().filter(|&(sample, &time_s)| on(sample) && !is_pressed(time_s)).count(),
        samples().filter(|&(sample, &time_s)| !on(sample) && is_pressed(time_s)).count(),
    ]
}

#[test]
fn readings_that_drift_count_from_the_newest_reference() {
    // Three quarters of the threshold a second.
    let drift = |time_s: f64| 30.0 * time_s;
    let (once, _) = imported("baseline_s = [0.0, 0.5]", drift).unwrap();
    assert!(wrong(&once)[0] > 100, "the drift alone is felt: {:?}", wrong(&once));
    let (take, report) = imported(ANEW, drift).unwrap();
    assert_eq!(wrong(&take), [0, 0]);
    let gel = &take.streams[0];
    let of_middle: Vec<f32> = gel.references().map(|reference| reference[1]).collect();
    for (reference, middle_s) in of_middle.iter().zip([0.25, 1.2, 2.65]) {
        assert!((f64::from(*reference) - 210.0 - drift(middle_s)).abs() < 0.01, "{of_middle:?}");
    }
    assert_eq!(of_middle.len(), 3);
    let from_s: Vec<f64> = gel.later_references.iter().map(|later| later.from_s).collect();
    assert_eq!(from_s, [1.0, 2.4]);
    assert_eq!(gel.reference_at(0.0), gel.reference, "before the first span has ended it counts too");
    assert_eq!(gel.reference_at(2.39)[1], of_middle[1]);
    let taken_s: Vec<f64> = take.tares().iter().map(|tare| tare.taken_s).collect();
    assert!((taken_s[0] - 1.2).abs() < 1e-12 && (taken_s[1] - 2.65).abs() < 1e-12, "{taken_s:?}");
    let said = &report.takes[0];
    assert_eq!(
        (said.baseline_s, &said.later_baselines_s[..]),
        (Some([0.0, 0.5]), &[[1.0, 1.4], [2.4, 2.9]][..])
    );
}

#[test]
fn a_device_that_tares_itself_is_told_in_the_same_way() {
    // It falls, and the device puts it back to zero as each span begins: a jump of more than the threshold.
    let tared_s =
        |time_s: f64| [0.0, 1.0, 2.4].into_iter().filter(|tare_s| *tare_s <= time_s).fold(0.0, f64::max);
    let drift = |time_s: f64| -30.0 * (time_s - tared_s(time_s));
    let (take, _) = imported(ANEW, drift).unwrap();
    assert_eq!(wrong(&take), [0, 0]);
}

#[test]
fn one_span_in_a_list_is_one_span() {
    let drift = |time_s: f64| 3.0 * (time_s * 7.0).sin();
    let (pair, _) = imported("baseline_s = [0.0, 0.5]", drift).unwrap();
    let (list, _) = imported("baseline_s = [[0.0, 0.5]]", drift).unwrap();
    assert_eq!(pair.streams, list.streams);
    assert_eq!(pair.spans, list.spans);
    assert!(pair.streams[0].later_references.is_empty() && pair.tares().is_empty());
}

#[test]
fn spans_that_cannot_be_are_refused() {
    for (baseline, expected) in [
        (
            "baseline_s = [[0.0, 0.5], [0.4, 0.9]]",
            "baseline_s, span 2: [0.4, 0.9] begins before [0.0, 0.5], the span before it, has ended",
        ),
        ("baseline_s = [[2.0, 2.5], [0.0, 0.5]]", "baseline_s, span 2: [0.0, 0.5] begins before"),
        ("baseline_s = [[0.0, 0.5], [9.0, 9.5]]", "baseline_s, span 2: [9, 9.5] lies outside the recording"),
        ("baseline_s = [[0.0, 0.5], [1.5, 1.2]]", "baseline_s, span 2: [1.5, 1.2] ends before it starts"),
        (
            "baseline_s = [[0.0, 0.5], [0.901, 0.909]]",
            "no sample of stream \"gel\" lies within 0.901..0.909 s",
        ),
        ("baseline_s = []", "baseline_s: [] has no span"),
        ("baseline_s = 0.5", "expected a span [t0, t1] in s, or a list of spans [[t0, t1], [t0, t1]]"),
        ("baseline_s = [0.0, 0.5, 1.0]", "expected a span [t0, t1] in s, or a list of spans"),
    ] {
        let error = imported(baseline, |_| 0.0).expect_err(baseline);
        assert!(error.contains(expected), "{baseline}: {error}");
    }
    let root = tempfile::tempdir().unwrap();
    write_recording(&root.path().join("csv/take-01"), "baseline_s = [[0.0, 0.5], [0.4, 0.9]]", |_| 0.0);
    let report = explain(&station(), &root.path().join("csv"), ImportOptions::default()).unwrap();
    assert!(report.takes[0].problem.as_deref().unwrap_or_default().contains("span 2"), "{report:?}");
}
