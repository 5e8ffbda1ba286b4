//! Many environments feel as each would alone, and what cannot be felt is refused.

use std::path::Path;
use std::sync::Arc;

use palpate_touch::{FixedBody, TouchBatch, TouchError, TouchScene};

fn asset(path: &str) -> String {
    let assets = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../assets");
    assets.join(path).to_str().expect("UTF-8").to_owned()
}

fn diagnosed() -> String {
    std::fs::read_to_string(asset("models/demo_diagnosed.toml")).expect("a shipped model")
}

fn open(model: Option<&str>, object: &str, fixed: &[FixedBody<'_>]) -> Result<TouchScene, TouchError> {
    let model = model.map(|text| ("model.toml", text));
    TouchScene::open(&asset("stations/xarm6_leap.toml"), model, object, fixed)
}

fn scene() -> Arc<TouchScene> {
    Arc::new(open(Some(&diagnosed()), "sphere_50mm", &[]).expect("shipped files"))
}

/// What environment `env` does in frame `frame`: the middle finger's tip goes into the ball and out again, deeper in each
/// environment.
fn pose_of(scene: &TouchScene, env: usize, frame: usize) -> [f64; 7] {
    let station = scene.station();
    let mut root_from_link = Vec::new();
    station.robot.forward_kinematics(&vec![0.0; station.robot.num_dofs()], &mut root_from_link);
    let patch = station.layout.patches.iter().find(|patch| patch.id == "middle_tip").expect("a patch");
    let root_from_tip = root_from_link[patch.link];
    let depth_m = (0.001 + 4e-4 * env as f64) * (0.4 * frame as f64).sin();
    let normal = patch.taxel_normals_in_link[0];
    let center = root_from_tip * (patch.taxels_in_link[0] + normal.into_inner() * (0.05 - depth_m));
    [center.x, center.y, center.z, 1.0, 0.0, 0.0, 0.0]
}

type Frames = Vec<(Vec<u64>, Vec<u8>)>;

/// Bits of the readings of the environments `envs` in turn, restarting those in `restarted` at the frame given.
fn felt(envs: &[usize], threads: usize, restarted: Option<(usize, &[u8])>) -> Frames {
    let scene = scene();
    let station = scene.station();
    let (dofs, channels) = (station.robot.num_dofs(), station.layout.num_channels());
    let mut batch = TouchBatch::new(Arc::clone(&scene), envs.len(), threads).expect("a batch");
    let mut frames = Vec::new();
    for frame in 0..40 {
        if let Some((_, which)) = restarted.filter(|(at, _)| *at == frame) {
            batch.restart(Some(which));
        }
        let times_s = vec![0.05 * frame as f64; envs.len()];
        let poses: Vec<_> = envs.iter().map(|&env| pose_of(&scene, env, frame)).collect();
        let (mut raw, mut active) = (vec![f64::NAN; envs.len() * channels], vec![9; envs.len() * channels]);
        batch.step(&times_s, &vec![0.0; envs.len() * dofs], &poses, &mut raw, &mut active).expect("a frame");
        frames.push((raw.iter().map(|raw| raw.to_bits()).collect(), active));
    }
    frames
}

/// Environment `idx` of `of`.
fn row(frames: &Frames, idx: usize, of: usize) -> Frames {
    let cut = |(raw, active): &(Vec<u64>, Vec<u8>)| {
        let channels = raw.len() / of;
        let row = idx * channels..(idx + 1) * channels;
        (raw[row.clone()].to_vec(), active[row].to_vec())
    };
    frames.iter().map(cut).collect()
}

#[test]
fn environments_depend_neither_on_each_other_nor_on_threads() {
    let envs: Vec<usize> = (0..19).collect();
    let many = felt(&envs, 3, None);
    assert_eq!(many, felt(&envs, 1, None));
    let touched = |frames: &Frames| frames.iter().any(|(_, active)| active.contains(&1));
    for env in [0, 7, 18] {
        let alone = felt(&[env], 1, None);
        assert_eq!(row(&many, env, envs.len()), alone, "environment {env}");
        assert!(touched(&alone), "environment {env} touches");
    }
    assert!(many.iter().all(|(_, active)| active.iter().all(|&active| active < 2)));
}

#[test]
fn a_restart_forgets_the_environments_that_it_names() {
    let (at, envs) = (11, [2, 5, 9]);
    let restarted = felt(&envs, 2, Some((at, &[0, 1, 0])));
    let going_on = felt(&envs, 2, None);
    for idx in [0, 2] {
        assert_eq!(row(&restarted, idx, 3), row(&going_on, idx, 3), "environment {idx}");
    }
    let (again, before) = (row(&restarted, 1, 3), row(&going_on, 1, 3));
    assert_eq!(again[..at], before[..at]);
    // What is late shows another moment once the past is gone.
    assert_ne!(again[at..], before[at..]);
}

#[test]
fn a_step_that_is_refused_names_the_environment_and_changes_nothing() {
    let scene = scene();
    let station = scene.station();
    let (dofs, channels) = (station.robot.num_dofs(), station.layout.num_channels());
    let mut batch = TouchBatch::new(Arc::clone(&scene), 3, 2).expect("a batch");
    let (mut raw, mut active) = (vec![0.0; 3 * channels], vec![0; 3 * channels]);
    let poses: Vec<_> = (0..3).map(|env| pose_of(&scene, env, 1)).collect();
    let still = vec![0.0; 3 * dofs];
    let mut step = |times_s: &[f64], positions: &[f64], poses: &[[f64; 7]]| {
        batch.step(times_s, positions, poses, &mut raw, &mut active)
    };
    step(&[0.0; 3], &still, &poses).expect("a frame");
    let mut lost = still.clone();
    lost[dofs + 8] = f64::NAN;
    let (mut infinite, mut long) = (poses.clone(), poses.clone());
    infinite[2][1] = f64::INFINITY;
    long[0][3] = 1.5;
    for (times_s, positions, poses, words) in [
        (&[0.1; 3], &lost, &poses, ["environment 1", "\"index_pip\"", "NaN"]),
        (&[0.1, 0.1, 0.0], &still, &poses, ["environment 2", "0 s after 0 s", "restart"]),
        (&[0.1, f64::NAN, 0.1], &still, &poses, ["environment 1", "NaN s after 0 s", "finite"]),
        (&[0.1; 3], &still, &infinite, ["environment 2", "inf", "must be finite"]),
        (&[0.1; 3], &still, &long, ["environment 0", "norm 1.5", "scalar first"]),
    ] {
        let problem = step(times_s, positions, poses).expect_err("refused").to_string();
        assert!(words.iter().all(|words| problem.contains(words)), "{problem}");
    }
    // Environments 0 and 1 took no part of the steps that 2 was refused in: 0.1 s is still to come.
    step(&[0.1; 3], &still, &poses).expect("a frame");
}

#[test]
fn files_that_do_not_fit_are_refused_by_name() {
    let of =
        |station: &str| TouchScene::open(station, None, "sphere_50mm", &[]).expect_err("refused").to_string();
    assert!(of("nowhere/station.toml").contains("station.toml"), "{}", of("nowhere/station.toml"));
    assert!(of("").contains("names no file"), "{}", of(""));
    let problem = |model, object| open(model, object, &[]).expect_err("refused").to_string();
    let unknown = problem(None, "teapot");
    assert!(unknown.contains("\"teapot\"") && unknown.contains("sphere_50mm"), "{unknown}");
    assert!(problem(Some("format = 9"), "sphere_50mm").contains("model.toml: line 1"));
    let elsewhere = diagnosed().replace("middle_tip", "pinky_tip");
    let elsewhere = problem(Some(&elsewhere), "sphere_50mm");
    assert!(elsewhere.contains("sensor_mount_offset") && elsewhere.contains("middle_tip"), "{elsewhere}");
    let scene = scene();
    for num_envs in [0, usize::MAX] {
        assert!(matches!(TouchBatch::new(Arc::clone(&scene), num_envs, 1), Err(TouchError::Input(_))));
    }
}

#[test]
fn what_stands_still_is_felt_and_kept_out_of_replays() {
    let ball = asset("objects/sphere_50mm.toml");
    let far = [0.0, 0.0, 9.0, 1.0, 0.0, 0.0, 0.0];
    // Deep in the tip.
    let beside = FixedBody { object: &ball, base_from_body: pose_of(&scene(), 18, 4) };
    let scene = Arc::new(open(None, "sphere_50mm", &[beside]).expect("a scene"));
    let station = scene.station();
    let channels = station.layout.num_channels();
    let (mut raw, mut active) = (vec![0.0; channels], vec![0; channels]);
    let positions = vec![0.0; station.robot.num_dofs()];
    let mut batch = TouchBatch::new(Arc::clone(&scene), 1, 1).expect("a batch");
    batch.step(&[0.0], &positions, &[far], &mut raw, &mut active).expect("a frame");
    assert!(active.contains(&1), "the ball at the tip is felt");
    let refused = scene.replay(&[0.0], &positions, &far).expect_err("refused").to_string();
    assert!(refused.contains("fixed bodies"), "{refused}");
}
