//! Scripts, and what they do where too little is felt.

use nalgebra::{Point3, Vector3};
use palpate_grasp::{Script, ScriptRun, Sensed};
use palpate_robot_model::Station;

use super::{config, station, text};

const SHIPPED: &str = "grasp/scripts/xarm6_leap_cube.toml";

/// One further try for the shipped script: it has gripped at 4.0 s, and is down again 1.2 s later.
const AGAIN: &str = r"
[[again]]
at_key = 5
channels = 2
to_key = 2
within_s = 1.2
raise_m = 0.05
unfelt_m = [-0.03, 0.04]
felt_m = [0.01, 0.0]
towards = [0.0, 1.0]
";

/// The shipped script with `more` at its end.
fn with(station: &Station, more: &str) -> Result<Script, palpate_grasp::GraspError> {
    Script::from_toml("s.toml", &format!("{}{more}", text(SHIPPED)), &station.robot, &config(station))
}

#[test]
fn a_script_is_linear_between_its_keys_and_its_faults_are_named() {
    let station = station();
    let config = config(&station);
    let read = |text: &str| Script::from_toml("s.toml", text, &station.robot, &config);
    let script =
        read("key = [{ at_s = 1.0 }, { at_s = 3.0, joints = { thumb_ip = 0.8 } }]").expect("a script");
    let dof = station.robot.dofs().position(|joint| joint.name == "thumb_ip").expect("a joint");
    for (time_s, expected) in [(0.0, 0.0), (1.0, 0.0), (2.0, 0.4), (3.0, 0.8), (9.0, 0.8)] {
        assert!((script.targets_at(time_s)[dof] - expected).abs() < 1e-12, "{time_s}");
    }
    for (text, expected) in [
        ("key = [{ at_s = 0.0 }]", "key 1: at_s is 0, expected a time after 0 s"),
        ("key = [{ at_s = 2.0 }, { at_s = 1.0 }]", "key 2: at_s is 1"),
        ("key = [{ at_s = 1.0, joints = { tumb = 0.0 } }]", "key 1: there is no joint \"tumb\""),
        ("key = [{ at_s = 1.0, joints = { thumb_ip = 7.0 } }]", "beyond its limits"),
    ] {
        let message = read(text).expect_err(text).to_string();
        assert!(message.starts_with("s.toml: ") && message.contains(expected), "{message}");
    }
}

#[test]
fn what_is_wrong_with_a_try_is_named() {
    let station = station();
    let script = with(&station, AGAIN).expect("a script");
    assert!(script.feels());
    let read =
        Script::from_toml("t.toml", &script.to_toml().expect("text"), &station.robot, &config(&station));
    assert_eq!(read.expect("a script"), script);
    for (from, to, expected) in [
        ("at_key = 5", "at_key = 7", "again 1: at_key is 7, expected 1 to 6"),
        ("to_key = 2", "to_key = 5", "again 1: to_key is 5, expected an earlier key than at_key, 5"),
        ("to_key = 2", "to_key = 0", "again 1: to_key is 0"),
        ("within_s = 1.2", "within_s = 0.0", "again 1: within_s is 0, expected a time above zero"),
        ("0.04]", "nan]", "again 1: unfelt_m holds NaN"),
        ("channels = 2", "channels = -2", "invalid value"),
    ] {
        let message = with(&station, &AGAIN.replacen(from, to, 1)).expect_err(to).to_string();
        assert!(message.starts_with("s.toml: ") && message.contains(expected), "{to}: {message}");
    }
}

/// Targets of the shipped script with `more`, every 50 ms for 10 s, when `active` is felt at each moment; and how far the palm
/// is then from where the script without tries has it at the script's own time, which is `late_s` earlier.
fn run(more: &str, active: impl Fn(f64) -> Vec<usize>) -> Vec<(f64, Vec<f64>)> {
    let station = station();
    let (script, config) = (with(&station, more).expect("a script"), config(&station));
    let mut run = ScriptRun::new(&script);
    let mut positions = config.start_positions(&station.robot);
    let mut told = Vec::new();
    for step in 0..200 {
        let time_s = f64::from(step) / config.control_rate_hz;
        let mut felt = vec![false; station.layout.num_channels()];
        active(time_s).into_iter().for_each(|channel| felt[channel] = true);
        let now = Sensed { time_s, positions: &positions, active: &felt };
        // A robot that is where it was sent.
        positions = run.targets(&script, &station, &config, now);
        told.push((time_s, positions.clone()));
    }
    told
}

fn palm_at(targets: &[f64]) -> Vector3<f64> {
    let robot = &station().robot;
    let mut frames = Vec::new();
    robot.forward_kinematics(targets, &mut frames);
    frames[robot.link_index("palm").expect("a palm")].translation.vector
}

#[test]
fn a_script_that_feels_enough_runs_as_one_without_tries() {
    let station = station();
    let plain = with(&station, "").expect("a script");
    // What is felt before and after the moment that decides does not matter.
    let told = run(AGAIN, |time_s| if (time_s - 4.0).abs() < 0.3 { vec![3, 40] } else { vec![] });
    for (time_s, targets) in told {
        assert_eq!(targets, plain.targets_at(time_s), "{time_s} s");
    }
}

#[test]
fn a_hand_that_closed_on_nothing_tries_again_elsewhere() {
    let station = station();
    let plain = with(&station, "").expect("a script");
    let told = run(AGAIN, |_| vec![]);
    let late_s = told.iter().find(|(time_s, _)| *time_s > 3.99).expect("the moment").0 + 1.2 - 1.8;
    let moved = |time_s: f64| {
        let (time_s, targets) = told.iter().find(|(at_s, _)| *at_s >= time_s - 1e-9).expect("a moment");
        palm_at(targets) - palm_at(&plain.targets_at(time_s - late_s))
    };
    for (time_s, targets) in told.iter().take_while(|(time_s, _)| *time_s <= 4.0) {
        assert_eq!(targets, &plain.targets_at(*time_s), "{time_s} s");
    }
    // Down again, closed, lifted: everything once more, 30 mm back and 40 mm to the left.
    for time_s in [5.2, 6.0, 6.9, 7.5, 9.5] {
        assert!(
            (moved(time_s) - Vector3::new(-0.03, 0.04, 0.0)).norm() < 2e-3,
            "{time_s}: {}",
            moved(time_s)
        );
    }
    let down_m = palm_at(plain.targets_at_key(1)).z;
    let up_m = palm_at(&told.iter().find(|(time_s, _)| *time_s >= 4.4 - 1e-9).expect("a moment").1).z;
    assert!((up_m - down_m - 0.05).abs() < 5e-3, "{up_m} over {down_m}");
    // One try is what the script has.
    assert_eq!(told.last().map(|(_, targets)| targets), told.iter().rfind(|(t, _)| *t < 9.2).map(|(_, t)| t));
}

#[test]
fn a_try_goes_to_where_something_was_felt() {
    let station = station();
    let plain = with(&station, "").expect("a script");
    let (channel, felt_s) = (20, 3.0);
    let taxel = &station.layout.channels[channel];
    let patch = &station.layout.patches[taxel.patch];
    let mut frames = Vec::new();
    // One step before: that is where the robot is when it feels.
    station.robot.forward_kinematics(&plain.targets_at(felt_s - 0.05), &mut frames);
    let at: Point3<f64> = frames[patch.link] * patch.taxels_in_link[taxel.taxel];
    // Alone it is not enough, and where it is later does not matter.
    let told = run(AGAIN, |time_s| if time_s > felt_s - 1e-9 { vec![channel] } else { vec![] });
    let center_m = config(&station).task.center_m;
    let last = palm_at(&told.last().expect("a moment").1) - palm_at(plain.targets_at_key(5));
    let expected = Vector3::new(0.01, at.y - center_m[1], 0.0);
    assert!((last - expected).norm() < 3e-3, "{last} and {expected}");
}

#[test]
fn a_try_out_of_reach_goes_as_far_as_the_arm_does() {
    let station = station();
    let plain = with(&station, "").expect("a script");
    let told = run(&AGAIN.replace("[-0.03, 0.04]", "[0.8, 0.0]"), |_| vec![]);
    let last = palm_at(&told.last().expect("a moment").1) - palm_at(plain.targets_at_key(5));
    assert!(last.x > 0.04 && last.x < 0.5 && last.y.abs() < 3e-3, "{last}");
}
