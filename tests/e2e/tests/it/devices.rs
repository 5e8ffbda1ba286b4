//! The emulated devices under clients that nobody here wrote.

use std::process::Command;

use e2e::{Devices, Tools, root, run_json};
use serde_json::{Value, json};

fn script(name: &str) -> std::path::PathBuf {
    root().join("tests/e2e/python").join(name)
}

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().into_iter().flatten().filter_map(Value::as_f64).collect()
}

/// All of `found` and `expected` agree within `tolerance`.
fn assert_near(found: &Value, expected: &Value, tolerance: f64) {
    let (found, expected) = (numbers(found), numbers(expected));
    assert_eq!(found.len(), expected.len(), "{found:?} against {expected:?}");
    for (a, b) in found.iter().zip(&expected) {
        assert!((a - b).abs() <= tolerance, "{found:?} against {expected:?}");
    }
}

#[test]
fn vendors_sdk_finds_sets_up_and_moves_the_servos() {
    let Some(tools) = Tools::find() else { return };
    let dir = tempfile::tempdir().unwrap();
    let Some(devices) = Devices::start(&tools, dir.path(), 1).unwrap() else { return };
    let seen = run_json(Command::new(&tools.python).arg(script("use_servos.py")).arg(&devices.u2d2)).unwrap();

    let found = seen["broadcast"]["found"].as_object().unwrap();
    assert_eq!(found.len(), 16, "{found:?}");
    assert!(found.values().all(|servo| *servo == json!([1240, 52])), "{found:?}");
    let ok = json!([0, 0]);
    assert!(seen["pings"].as_array().unwrap().iter().all(|ping| *ping == json!([1240, 0, 0])));
    assert_eq!(seen["nobody"][1], json!(-3001), "a time-out");
    assert_eq!(seen["firmware"], json!([52, 0, 0]));
    assert_eq!(seen["voltage"], json!([50, 0, 0]));
    assert!((20..60).contains(&seen["temperature"][0].as_i64().unwrap()));
    assert!(seen["modes"].as_array().unwrap().iter().all(|mode| *mode == json!([5, 0, 0])));
    assert!(seen["torque_on"].as_array().unwrap().iter().all(|write| *write == ok));
    // Error codes of the protocol: 7 access, 6 limit.
    assert_eq!(seen["eeprom_while_torque_is_on"], json!([0, 7]));
    assert_eq!(seen["beyond_the_limit"], json!([0, 6]));
    assert_eq!(seen["read_only"], json!([0, 7]));
    assert_eq!(seen["gain"], json!([600, 0, 0]));

    let motion = &seen["motion"];
    let (before, after) = (numbers(&motion["before"]), numbers(&motion["after"]));
    assert!((after[4] - motion["goal"].as_f64().unwrap()).abs() < 15.0, "{motion}");
    for servo in (0..16).filter(|&servo| servo != 4) {
        assert!((after[servo] - before[servo]).abs() <= 2.0, "servo {servo}: {motion}");
    }
    assert!(motion["most_current_ma"].as_f64().unwrap() <= 350.0, "{motion}");
    assert!(motion["most_velocity"].as_f64().unwrap() > 20.0, "{motion}");
    let on_the_way = numbers(&motion["positions"]);
    assert!(on_the_way.iter().any(|&p| p > before[4] + 50.0 && p < after[4] - 50.0), "{motion}");
    assert_eq!(seen["fast_sync_read"], json!(0));
    assert_eq!(numbers(&seen["fast_positions"]), after);

    assert_eq!(seen["bulk_read"], json!([0, 50, 0]));
    assert_eq!((&seen["registered"], &seen["led_before_action"]), (&ok, &json!([0, 0, 0])));
    assert_eq!(seen["led_after_action"], json!([1, 0, 0]));
    assert_eq!(seen["factory_reset"], json!([0, 1]), "refused");
    assert_eq!((&seen["reboot"], &seen["torque_after_reboot"]), (&ok, &json!([0, 0, 0])));
    assert_eq!(seen["mode_after_reboot"], json!([5, 0, 0]), "the EEPROM stays");

    assert!(devices.stop().unwrap().success());
    let left: Vec<_> = std::fs::read_dir(dir.path()).unwrap().map(|entry| entry.unwrap().path()).collect();
    assert!(left.is_empty(), "links stay behind: {left:?}");
}

#[test]
fn vendors_sdk_moves_stops_and_sets_up_the_arm() {
    let Some(tools) = Tools::find() else { return };
    let dir = tempfile::tempdir().unwrap();
    let Some(devices) = Devices::start(&tools, dir.path(), 2).unwrap() else { return };
    let address = devices.xarm.to_string();
    let seen = run_json(Command::new(&tools.python).arg(script("use_arm.py")).arg(address)).unwrap();

    assert_eq!((&seen["connected"], &seen["axes"]), (&json!(true), &json!(6)));
    assert_eq!(seen["version"], json!([0, "6,6,XI1202,AC1302,v1.12.10"]));
    assert_eq!(seen["before_enabling"]["state"], json!([0, 4]));
    assert_ne!(seen["before_enabling"]["refused"], json!(0), "a motion before enabling");
    assert_eq!(seen["ready"], json!([0, 0, 0, [0, 2]]));

    let joints = &seen["joint_motion"];
    assert_eq!(joints["code"], json!(0));
    assert_near(&joints["reached"], &joints["goal"], 1e-4);
    // 0.3 rad at 0.6 rad/s.
    assert!(joints["seconds"].as_f64().unwrap() > 0.5, "{joints}");
    let kinematics = &seen["kinematics"];
    assert_near(&kinematics["forward"][1], &kinematics["position"][1], 1e-3);
    let inverse = numbers(&kinematics["inverse"][1]);
    assert_near(&json!(inverse[..6]), &joints["goal"], 1e-4);
    let zero = numbers(&seen["forward_at_zero"][1]);
    assert_near(
        &json!([zero[0], zero[1], zero[2], zero[3].abs()]),
        &json!([207.0, 0.0, 112.0, std::f64::consts::PI]),
        0.01,
    );
    assert_eq!(seen["line"]["code"], json!(0));
    assert_near(&seen["line"]["reached"], &seen["line"]["goal"], 0.01);

    assert_eq!(seen["servo_ready"], json!([0, 0, 0, [0, 2]]));
    let servo = &seen["servo_motion"];
    assert_eq!(servo["codes"], json!([0]));
    let wanted = servo["centre"].as_f64().unwrap() + 0.2 * (std::f64::consts::TAU * 0.99).sin();
    assert!((servo["reached"].as_f64().unwrap() - wanted).abs() < 1e-3, "{servo}");

    let stop = &seen["emergency_stop"];
    assert_eq!(stop["state_while_moving"], json!([0, 1]));
    assert_eq!((&stop["state"], &stop["refused"]), (&json!([0, 4]), &json!(9)));
    let way = stop["way"].as_f64().unwrap();
    assert!((-1.2..-0.1).contains(&way), "stopped on the way: {stop}");
    assert_eq!(stop["crept"], json!(0.0));
    assert_eq!(stop["ready_again"], json!([0, 0, 0, 0, [0, 2]]));
    assert_eq!(stop["back"], json!(0));
    assert!(stop["angle"].as_f64().unwrap().abs() < 1e-4, "{stop}");

    let settings = &seen["settings"];
    assert_eq!((&settings["load"], &settings["sensitivity"]), (&json!(0), &json!(0)));
    assert_eq!(settings["reduced"][2][1][0], json!(1), "{settings}");
    let reports = &seen["reports"];
    assert!((4.0..6.0).contains(&reports["per_s"].as_f64().unwrap()), "{reports}");
    assert_eq!(reports["load"], json!([0.6, [0.0, 0.0, 50.0]]));
    assert_eq!((&reports["sensitivity"], &reports["reduced"]), (&json!(4), &json!(true)));
    assert_eq!(reports["last"]["error_code"], json!(0));
    assert!((60.0..110.0).contains(&seen["real_reports"]["per_s"].as_f64().unwrap()), "{seen}");
    assert!((3.0..6.0).contains(&seen["normal_reports"]["per_s"].as_f64().unwrap()), "{seen}");
}

#[test]
fn boards_send_their_lines_and_faults_come_and_go_with_a_file() {
    let Some(tools) = Tools::find() else { return };
    let dir = tempfile::tempdir().unwrap();
    let Some(devices) = Devices::start(&tools, dir.path(), 3).unwrap() else { return };
    assert_eq!(devices.twintac.len(), 4);
    let feel = || {
        let mut read = Command::new(&tools.python);
        read.arg(script("feel_boards.py")).arg("2").arg(&devices.fsr).args(&devices.twintac);
        run_json(&mut read).unwrap()
    };
    let boards = feel();
    for (board, (lines_per_s, width)) in boards.as_array().unwrap().iter().zip(
        // Twelve resistors come as three rows.
        [(120.0, 4), (100.0, 8), (100.0, 8), (100.0, 8), (100.0, 8)],
    ) {
        assert_eq!((&board["widths"], &board["bad"]), (&json!([width]), &json!(0)));
        // A busy machine may lose lines, but none may be made up.
        let share = board["lines_per_s"].as_f64().unwrap() / lines_per_s;
        assert!((0.5..1.1).contains(&share), "{board}");
    }

    let faults = "[[fault]]\nkind = \"dead_taxel\"\nchannel = \"index_tip.3\"\nraw = 123.0\n\
                  [[fault]]\nkind = \"unplug\"\ndevice = \"twintac3\"\n";
    std::fs::write(dir.path().join("faults.toml"), faults).unwrap();
    let waited = (0..100).any(|_| {
        std::thread::sleep(std::time::Duration::from_millis(50));
        !devices.twintac[3].exists()
    });
    assert!(waited, "the link of an unplugged board stays");
    let mut read = Command::new(&tools.python);
    read.arg(script("feel_boards.py")).arg("1").args(&devices.twintac[..2]);
    let boards = run_json(&mut read).unwrap();
    assert_eq!(numbers(&boards[0]["mean"])[3], 123.0, "{boards}");
    assert!(numbers(&boards[1]["mean"])[3] > 7000.0, "the next board is well: {boards}");

    std::fs::remove_file(dir.path().join("faults.toml")).unwrap();
    let back = (0..100).any(|_| {
        std::thread::sleep(std::time::Duration::from_millis(50));
        devices.twintac[3].exists()
    });
    assert!(back, "the board does not come back");
    let boards = feel();
    assert!(numbers(&boards[1]["mean"])[3] > 7000.0, "{boards}");
    assert_eq!(numbers(&boards[4]["mean"]).len(), 8, "{boards}");
}

#[test]
fn bad_arguments_say_what_to_do() {
    let Some(tools) = Tools::find() else { return };
    let dir = tempfile::tempdir().unwrap();
    let emulate = |truth: &str, ip: &str| {
        let mut command = tools.palpate();
        command.args(["devices", "emulate", "--truth", truth, "--xarm-ip", ip, "--dir"]).arg(dir.path());
        let output = command.output().unwrap();
        (output.status.code(), String::from_utf8(output.stderr).unwrap())
    };
    let (code, text) = emulate("bench", "127.0.5.4");
    assert!(code == Some(2) && text.contains("has no hand on an arm"), "{text}");
    let (code, text) = emulate("demo", "192.0.2.1");
    assert!(code == Some(2) && text.contains("choose one that it has with --xarm-ip"), "{text}");
    let _taken = std::net::TcpListener::bind("127.0.5.4:30002").unwrap();
    let (code, text) = emulate("demo", "127.0.5.4");
    assert!(code == Some(2), "{text}");
    assert!(text.contains("another emulation") || text.contains("sysctl"), "{text}");
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0, "no links were made");
}

#[test]
fn vendors_sdks_meet_faults_and_recover() {
    let Some(tools) = Tools::find() else { return };
    let dir = tempfile::tempdir().unwrap();
    let Some(devices) = Devices::start(&tools, dir.path(), 5).unwrap() else { return };
    let mut meet = Command::new(&tools.python);
    meet.arg(script("meet_faults.py")).arg(dir.path()).arg(&devices.u2d2).arg(devices.xarm.to_string());
    let seen = run_json(&mut meet).unwrap();

    // Bit 5 is overload; 128 is the alert that every answer then has.
    let overloaded = &seen["overloaded"];
    assert_eq!(overloaded["hardware_error"], json!([32, 0, 128]));
    assert_eq!(overloaded["torque"], json!([0, 0, 128]), "torque is cut");
    assert!(overloaded["says"].as_str().unwrap().contains("Hardware error"), "{overloaded}");
    assert_eq!(overloaded["neighbour"], json!([0, 0, 0]));
    assert_eq!(seen["still_tripped"], json!([32, 0, 128]), "only a reboot helps");
    assert_eq!(seen["after_reboot"], json!([0, 0, 0]));
    let lost = &seen["half_lost"];
    assert_eq!(lost["good"].as_u64().unwrap() + lost["timed_out"].as_u64().unwrap(), 40, "{lost}");
    assert!((5..=35).contains(&lost["good"].as_u64().unwrap()), "{lost}");

    for (name, code, cleared_too_soon) in [("collision", 31, 0), ("emergency_stop", 1, 1)] {
        let fault = &seen[name];
        assert_eq!((&fault["error"], &fault["state"]), (&json!([0, [code, 0]]), &json!([0, 4])), "{fault}");
        assert_ne!(fault["refused"], json!(0), "{fault}");
        assert!((0.01..1.4).contains(&fault["way"].as_f64().unwrap()), "stopped on the way: {fault}");
        assert_eq!(fault["cleared_too_soon"], json!([0, [cleared_too_soon, 0]]), "{fault}");
        assert_eq!(fault["cleared"], json!([0, [0, 0]]), "{fault}");
        assert_eq!((&fault["ready"], &fault["back"]), (&json!([0, 0, 0, [0, 2]]), &json!(0)), "{fault}");
    }
    assert!(seen["told"].as_array().unwrap().contains(&json!(31)), "the report says so too: {seen}");
}
