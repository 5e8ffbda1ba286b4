//! What is hidden shows in the recording, in the way that the entry says.

use std::sync::OnceLock;

use palpate_recording::Take;
use palpate_robot_model::Place;
use palpate_truth::{Hidden, Stage, cases};
use tempfile::TempDir;

use crate::{record, takes, variant, variant_of};

const TAKES: &str = r#"
[[take]]
object = "sphere_50mm"
primitive = "tap"
duration_s = 21.0
touch = ["palm_heel", "index_tip.4"]
"#;

/// A short take of the tuning world, which hides nothing.
fn stage() -> &'static Stage {
    static STAGE: OnceLock<Stage> = OnceLock::new();
    STAGE.get_or_init(|| {
        let dir = TempDir::new().expect("a folder");
        let path = variant_of("blind_tune.toml", dir.path(), "short", TAKES, &[]);
        Stage::read(&path).expect("a stage")
    })
}

fn take(hidden: &[Hidden]) -> Take {
    stage().record(hidden, 3).unwrap().remove(0)
}

fn stream(id: &str) -> Place {
    Place::Stream(id.into())
}

fn channel(id: &str) -> Place {
    Place::Channel(id.into())
}

/// Times and values (rise in raw units, active) of one channel.
fn trace(take: &Take, id: &str) -> Vec<(f64, f64, bool)> {
    let layout = &take.station.layout;
    let idx = layout.channels.iter().position(|channel| channel.id == id).unwrap();
    let stream = layout.channels[idx].stream;
    let (log, channels) = (&take.streams[stream], &layout.streams[stream].channels);
    let (width, at) = (channels.len(), idx - channels.start);
    let sample = |(i, &time_s): (usize, &f64)| {
        let rise = f64::from(log.raw[i * width + at] - log.reference[at]);
        (time_s, rise, log.active[i * width + at])
    };
    log.times_s.iter().enumerate().map(sample).collect()
}

fn peak(take: &Take, id: &str) -> f64 {
    trace(take, id).iter().map(|sample| sample.1).fold(0.0, f64::max)
}

fn share_on(take: &Take, id: &str) -> f64 {
    let trace = trace(take, id);
    trace.iter().filter(|sample| sample.2).count() as f64 / trace.len() as f64
}

/// Changes of a channel: `(time, on)`.
fn edges(take: &Take, id: &str) -> Vec<(f64, bool)> {
    trace(take, id).windows(2).filter(|w| w[0].2 != w[1].2).map(|w| (w[1].0, w[1].2)).collect()
}

/// Mean shift of the onsets, or of the ends, of a channel against the clean take, s.
fn shift_s(take: &Take, id: &str, on: bool) -> f64 {
    let clean = edges(&self::take(&[]), id);
    let hidden = edges(take, id);
    assert_eq!(clean.len(), hidden.len(), "touches differ: {clean:?} {hidden:?}");
    let shifts: Vec<f64> =
        clean.iter().zip(&hidden).filter(|(a, _)| a.1 == on).map(|(a, b)| b.0 - a.0).collect();
    shifts.iter().sum::<f64>() / shifts.len() as f64
}

#[test]
fn memory_and_disk_hold_the_same_session() {
    let dir = TempDir::new().unwrap();
    let truth = variant(&dir, "same.toml", TAKES, &[]);
    let session = record(&truth, &dir.path().join("out"), 5).unwrap();
    let on_disk = takes(&session);
    let in_memory = Stage::read(&truth).unwrap().record(&[], 5).unwrap();
    assert_eq!(on_disk.len(), in_memory.len());
    for (a, b) in on_disk.iter().zip(&in_memory) {
        assert_eq!((&a.id, &a.start_unix_ns, &a.joints), (&b.id, &b.start_unix_ns, &b.joints));
        assert_eq!(a.streams, b.streams);
        assert_eq!(a.spans, b.spans);
        let moved = a.meta.base_from_object.inverse() * b.meta.base_from_object;
        assert!(moved.translation.vector.norm() < 1e-12 && moved.rotation.angle() < 1e-6);
    }
}

#[test]
fn timing_effects_shift_edges_by_their_size() {
    let late = take(&[Hidden::new("latency", stream("fsr"), &[("delay_s", 0.05)])]);
    assert!((shift_s(&late, "palm_heel", true) - 0.05).abs() < 1e-6);
    assert!(shift_s(&late, "index_tip.4", true).abs() < 1e-9, "the other stream is as it was");
    let sure = take(&[Hidden::new("debounce", stream("twintac"), &[("min_on_s", 0.1)])]);
    assert!((shift_s(&sure, "index_tip.4", true) - 0.1).abs() < 0.011);
    assert!(shift_s(&sure, "index_tip.4", false).abs() < 0.011);
    let slow = take(&[Hidden::new("low_pass", stream("twintac"), &[("time_s", 0.1)])]);
    assert!(shift_s(&slow, "index_tip.4", true) > 0.01 && shift_s(&slow, "index_tip.4", false) > 0.05);
    let skewed = take(&[Hidden::new("clock_skew", stream("twintac"), &[("skew", 0.01)])]);
    let (first, skewed) = (edges(&take(&[]), "index_tip.4"), edges(&skewed, "index_tip.4"));
    for (a, b) in first.iter().zip(&skewed) {
        assert!((b.0 - a.0 - 0.01 * a.0).abs() < 0.021, "{a:?} {b:?}");
    }
    let lagging = take(&[Hidden::new(
        "viscoelastic_release",
        stream("twintac"),
        &[("fraction", 0.6), ("time_s", 0.3)],
    )]);
    assert!(shift_s(&lagging, "index_tip.4", false) > 0.03);
    let keen = take(&[Hidden::new("threshold_hysteresis", stream("twintac"), &[("off_fraction", 0.1)])]);
    assert!(shift_s(&keen, "index_tip.4", true).abs() < 1e-9 && shift_s(&keen, "index_tip.4", false) > 0.004);
    let held = take(&[Hidden::new("sample_hold", stream("fsr"), &[("hold_s", 0.6), ("every_s", 1.0)])]);
    let repeats = |take: &Take| {
        let log = &take.streams[1];
        let width = take.station.layout.streams[1].channels.len();
        let rows: Vec<&[f32]> = log.raw.chunks_exact(width).collect();
        rows.windows(2).filter(|pair| pair[0] == pair[1]).count() as f64 / rows.len() as f64
    };
    assert!(repeats(&take(&[])) < 0.01);
    assert!((repeats(&held) - 0.375).abs() < 0.12, "{}", repeats(&held));
}

#[test]
fn kinematic_effects_move_what_they_name() {
    let joints = |take: &Take, dof: usize| {
        let count = take.station.robot.num_dofs();
        take.joints.positions.chunks_exact(count).map(|row| row[dof]).sum::<f64>() / take.num_frames() as f64
    };
    let clean = take(&[]);
    let dof = clean.station.robot.dofs().position(|joint| joint.name == "index_pip").unwrap();
    let offset = take(&[Hidden::new("joint_offset", Place::Joint("index_pip".into()), &[("offset", 0.012)])]);
    assert!((joints(&offset, dof) - joints(&clean, dof) - 0.012).abs() < 1e-4);
    assert_eq!(offset.streams, clean.streams, "touch is what it was");

    let loose = take(&[Hidden::new("joint_backlash", Place::Group("index".into()), &[("width", 0.05)])]);
    assert_eq!(loose.joints, clean.joints, "encoders sit on the motors");
    assert_ne!(loose.streams[0], clean.streams[0]);
    assert_eq!(trace(&loose, "palm_heel"), trace(&clean, "palm_heel"));

    let pose = [("x_m", 0.001), ("y_m", -0.002)];
    let moved = take(&[Hidden::new("object_pose_offset", Place::Object("sphere_50mm".into()), &pose)]);
    let error =
        clean.meta.base_from_object.translation.vector - moved.meta.base_from_object.translation.vector;
    assert!((error - nalgebra_vector(0.001, -0.002)).norm() < 1e-12, "true less recorded");
    assert_eq!(moved.streams, clean.streams);

    let grown =
        take(&[Hidden::new("object_scale", Place::Object("sphere_50mm".into()), &[("factor", 1.02)])]);
    assert!(peak(&grown, "index_tip.4") > 1.2 * peak(&clean, "index_tip.4"));
    assert!(shift_s(&grown, "palm_heel", true) < 0.0);

    let askew = [("x_m", 0.002), ("y_m", 0.002), ("rx_rad", 0.1)];
    let askew = take(&[Hidden::new("sensor_mount_offset", Place::Patch("index_tip".into()), &askew)]);
    assert_ne!(trace(&askew, "index_tip.4"), trace(&clean, "index_tip.4"));
    assert_eq!(trace(&askew, "palm_heel"), trace(&clean, "palm_heel"));
}

fn nalgebra_vector(x: f64, y: f64) -> nalgebra::Vector3<f64> {
    nalgebra::Vector3::new(x, y, 0.0)
}

#[test]
fn mechanical_effects_change_readings_as_they_say() {
    let clean = take(&[]);
    let full = peak(&clean, "index_tip.4");
    let weak = take(&[Hidden::new("sensitivity_spread", channel("index_tip.4"), &[("gain", 0.6)])]);
    assert!((peak(&weak, "index_tip.4") / full - 0.6).abs() < 0.03);
    assert!((peak(&weak, "index_tip.3") / peak(&clean, "index_tip.3") - 1.0).abs() < 0.05);
    let gap = take(&[Hidden::new("preload", Place::Patch("index_tip".into()), &[("depth_m", 0.0006)])]);
    assert!(peak(&gap, "index_tip.4") < 0.9 * full && shift_s(&gap, "index_tip.4", true) > 0.0);
    let wide = take(&[Hidden::new("elastic_crosstalk", stream("twintac"), &[("added_m", 0.002)])]);
    let far = |take: &Take| peak(take, "index_tip.6") / peak(take, "index_tip.4");
    assert!(far(&wide) > 1.1 * far(&clean), "{} {}", far(&wide), far(&clean));
    let damped = take(&[Hidden::new("rate_dependence", stream("twintac"), &[("damping_s", 0.1)])]);
    assert!(shift_s(&damped, "index_tip.4", true) < 0.0 && peak(&damped, "index_tip.4") > full);
}

#[test]
fn analog_effects_reach_the_readings() {
    let clean = take(&[]);
    let end = |take: &Take| {
        let trace = trace(take, "ring_tip.4");
        let last = &trace[trace.len() - 100..];
        last.iter().map(|sample| sample.1).sum::<f64>() / last.len() as f64
    };
    let drifting = take(&[Hidden::new("baseline_drift", stream("twintac"), &[("rate_raw_per_s", 2.0)])]);
    assert!((end(&drifting) - end(&clean) - 2.0 * 19.0).abs() < 6.0, "{}", end(&drifting));
    let strained = take(&[Hidden::new("motion_artifact", stream("twintac"), &[("raw_s_per_rad", 300.0)])]);
    assert!(peak(&strained, "ring_tip.4") > peak(&clean, "ring_tip.4") + 50.0);
    let leaking = take(&[Hidden::new("electrical_crosstalk", stream("fsr"), &[("leak", 0.2)])]);
    let neighbour = peak(&leaking, "palm_index") / peak(&clean, "palm_heel");
    assert!((neighbour - 0.2).abs() < 0.03, "{neighbour}");
    let humming = take(&[Hidden::new("mains_hum", stream("fsr"), &[("amplitude_raw", 80.0)])]);
    assert!(peak(&humming, "palm_ring") > 60.0 && peak(&clean, "palm_ring") < 40.0);
    let snag = [("beyond", -3.0), ("offset_raw", 70.0)];
    let caught = take(&[Hidden::new("snagged_cable", stream("twintac"), &snag).driven_by("index_pip")]);
    let raw = |take: &Take| f64::from(take.streams[0].raw[0]);
    assert!((raw(&caught) - raw(&clean) - 70.0).abs() < 2.0, "always beyond");
    let bend = [("per_rad", 0.0), ("middle", 0.0)];
    let same = take(&[
        Hidden::new("joint_dependent_gain", Place::Group("index".into()), &bend).driven_by("index_pip")
    ]);
    assert_eq!(same.streams, clean.streams, "no gain without a slope");
    let bend = [("per_rad", 1.0), ("middle", -1.0)];
    let bent = take(&[
        Hidden::new("joint_dependent_gain", Place::Group("index".into()), &bend).driven_by("index_pip")
    ]);
    assert!(peak(&bent, "index_tip.4") > 1.3 * peak(&clean, "index_tip.4"));
}

#[test]
fn channels_die_stick_swap_and_wrap() {
    let clean = take(&[]);
    let dead = take(&[Hidden::new("dead_channel", channel("palm_heel"), &[])]);
    assert!(share_on(&clean, "palm_heel") > 0.02);
    assert!(share_on(&dead, "palm_heel") == 0.0 && peak(&dead, "palm_heel") < 40.0);
    let stuck = take(&[Hidden::new("stuck_channel", channel("palm_ring"), &[("rise_raw", 500.0)])]);
    assert!(share_on(&stuck, "palm_ring") > 0.99 && peak(&stuck, "palm_ring") < 1.0, "one value throughout");
    let pair = Place::Channels(vec!["palm_heel".into(), "palm_ring".into()]);
    let swapped = take(&[Hidden::new("swapped_channels", pair, &[])]);
    assert!((peak(&swapped, "palm_ring") / peak(&clean, "palm_heel") - 1.0).abs() < 0.02);
    assert!(peak(&swapped, "palm_heel") < 40.0);
    let wrapped = take(&[Hidden::new("integer_wrap", channel("index_tip.0"), &[])]);
    assert!(wrapped.streams[0].raw.iter().any(|&reading| reading > 60_000.0));
    assert!(share_on(&wrapped, "index_tip.0") > 0.2);
}

#[test]
fn hidden_effects_are_the_same_for_any_number_of_threads() {
    let hidden = [
        Hidden::new("sample_hold", stream("fsr"), &[("hold_s", 0.3), ("every_s", 1.0)]),
        Hidden::new("sensitivity_spread", stream("twintac"), &[("spread", 0.3), ("draw", 4.0)]),
        Hidden::new("mains_hum", stream("twintac"), &[("amplitude_raw", 30.0)]),
    ];
    let with_threads = |threads: usize, seed| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| stage().record(&hidden, seed).unwrap().remove(0).streams)
    };
    assert_eq!(with_threads(1, 9), with_threads(3, 9));
    assert_ne!(with_threads(1, 9), with_threads(1, 10));
}

#[test]
fn every_case_of_the_bench_can_be_hidden_and_comes_again_with_its_seed() {
    let cases = cases(stage(), 3, 11).unwrap();
    assert_eq!(cases, palpate_truth::cases(stage(), 3, 11).unwrap());
    assert_ne!(cases, palpate_truth::cases(stage(), 3, 12).unwrap());
    assert_eq!(cases.iter().filter(|case| case.hidden.is_empty()).count(), 3);
    let clean = take(&[]);
    for case in &cases {
        let recorded = stage().record(&case.hidden, 3).unwrap().remove(0);
        assert_eq!(recorded.num_frames(), clean.num_frames(), "{}", case.label);
    }
}

#[test]
fn bad_entries_are_refused_with_their_number_and_what_is_wrong() {
    let refused = |hidden: Hidden, says: &[&str]| {
        let good = Hidden::new("latency", stream("fsr"), &[("delay_s", 0.1)]);
        let error = stage().record(&[good, hidden], 1).unwrap_err().to_string();
        for part in says.iter().chain(&["short.toml", "hidden 2"]) {
            assert!(error.contains(part), "{error:?} does not say {part:?}");
        }
    };
    refused(Hidden::new("gremlins", stream("fsr"), &[]), &["no effect \"gremlins\"", "latency"]);
    refused(Hidden::new("latency", stream("fsrs"), &[("delay_s", 0.1)]), &["no stream \"fsrs\""]);
    refused(Hidden::new("latency", stream("fsr"), &[]), &["needs its parameter delay_s"]);
    refused(Hidden::new("latency", stream("fsr"), &[("delay_s", -0.1)]), &["delay_s = -0.1", "0..2"]);
    refused(Hidden::new("latency", stream("fsr"), &[("delay_s", f64::NAN)]), &["delay_s = NaN"]);
    refused(Hidden::new("latency", channel("palm_heel"), &[("delay_s", 0.1)]), &["cannot be at a channel"]);
    refused(Hidden::new("dead_channel", channel("palm"), &[]), &["no channel \"palm\""]);
    refused(Hidden::new("dead_channel", channel("palm_heel"), &[("x", 1.0)]), &["no parameter \"x\""]);
    refused(Hidden::new("joint_offset", Place::Joint("elbow".into()), &[("offset", 0.1)]), &["\"elbow\""]);
    let snag = [("beyond", 0.1), ("offset_raw", 9.0)];
    refused(Hidden::new("snagged_cable", stream("fsr"), &snag), &["joint that drives it"]);
}

#[test]
fn truth_files_hide_effects() {
    let dir = TempDir::new().unwrap();
    let entry = "[[hidden]]\nid = \"latency\"\nwhere = { stream = \"fsr\" }\ndelay_s = 0.05\n";
    let hiding = |entry: &str| format!("{entry}\n[joints]\n");
    let truth = variant(&dir, "late.toml", TAKES, &[("[joints]\n", &hiding(entry))]);
    let plain = variant(&dir, "plain.toml", TAKES, &[]);
    let hidden = Hidden::new("latency", stream("fsr"), &[("delay_s", 0.05)]);
    let from_file = Stage::read(&truth).unwrap().record(&[], 1).unwrap();
    let from_call = Stage::read(&plain).unwrap().record(&[hidden], 1).unwrap();
    assert_eq!(from_file[0].streams, from_call[0].streams);
    let bad = variant(&dir, "bad.toml", TAKES, &[("[joints]\n", &hiding(&entry.replace("fsr", "fsrs")))]);
    let error = Stage::read(&bad).unwrap_err().to_string();
    assert!(error.contains("bad.toml") && error.contains("hidden 1 (latency)"), "{error}");
}
