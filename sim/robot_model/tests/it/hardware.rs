//! Devices and safety of the shipped stations, and what is refused in them.

use std::f64::consts::PI;

use palpate_robot_model::{DeviceKind, ModelError, SafetyConfig, Station, WorkspaceBox};

use crate::{repository, station};

/// The LEAP station with `from` replaced by `to` in its station file.
fn edited(from: &str, to: &str) -> Result<Station, ModelError> {
    let folder = repository().join("assets/stations");
    Station::read("xarm6_leap.toml", |path| {
        let text = std::fs::read(folder.join(path)).map_err(|err| err.to_string())?;
        if path != "xarm6_leap.toml" {
            return Ok(text);
        }
        let text = String::from_utf8(text).map_err(|err| err.to_string())?;
        assert!(text.contains(from), "the station has no {from:?}");
        Ok(text.replacen(from, to, 1).into_bytes())
    })
}

#[test]
fn the_leap_stations_have_the_published_servos_arm_and_boards() {
    for file in ["xarm6_leap.toml", "xarm6_leap_b.toml"] {
        let station = station(file);
        let ids: Vec<&str> = station.devices.iter().map(|device| device.id.as_str()).collect();
        assert_eq!(ids, ["u2d2", "xarm", "twintac0", "twintac1", "twintac2", "twintac3", "fsr"]);
        let DeviceKind::Dynamixel(bus) = &station.devices[0].kind else { panic!("servos first") };
        assert_eq!(
            (bus.baud, bus.rate_hz, bus.current_limit_a, bus.watchdog_s),
            (4_000_000, 100.0, 0.3, 0.2)
        );
        assert_eq!(bus.servos.len(), 16);
        let joints: Vec<&str> = station.robot.dofs().map(|joint| joint.name.as_str()).collect();
        for (servo, id) in bus.servos.iter().zip(0_u8..) {
            assert_eq!((servo.id, servo.dof), (id, usize::from(id) + 6));
            assert_eq!(servo.joint, joints[servo.dof]);
            assert_eq!((servo.zero_rad, servo.direction, servo.i), (PI, 1, 0));
            let gains = if [0, 4, 8].contains(&id) { (450, 150) } else { (600, 200) };
            assert_eq!((servo.p, servo.d), gains, "servo {id}");
        }
        let DeviceKind::Xarm(arm) = &station.devices[1].kind else { panic!("then the arm") };
        assert_eq!(arm.dofs, station.carrier_dofs);
        assert_eq!((arm.command_port, arm.report_port), (502, 30_003));
        let boards: Vec<_> = station.devices[2..]
            .iter()
            .map(|device| match &device.kind {
                DeviceKind::Lines(board) => (board.channels.clone(), board.lines_per_sample),
                _ => panic!("{} is no board", device.id),
            })
            .collect();
        assert_eq!(boards, [(0..8, 1), (8..16, 1), (16..24, 1), (24..32, 1), (32..44, 3)]);
    }
}

#[test]
fn limits_of_joints_come_from_kind_and_robot() {
    let station = station("xarm6_leap.toml");
    let safety = &station.safety;
    assert_eq!((safety.lease_ttl_s, safety.heartbeat_ttl_s, safety.disarm_after_s), (6.0, 0.15, 0.5));
    assert_eq!(safety.joints[0].velocity, 0.6);
    assert_eq!((safety.joints[6].velocity, safety.joints[6].acceleration), (3.0, 40.0));
    assert_eq!((safety.joints[1].lower, safety.joints[1].upper), (-2.059, 2.0944));
    assert!(safety.workspace.is_some());
}

#[test]
fn a_station_without_hardware_opens_with_the_default_limits() {
    let station = station("probe_bench.toml");
    assert!(station.devices.is_empty() && station.plans.is_empty());
    let SafetyConfig {
        lease_ttl_s,
        heartbeat_ttl_s,
        disarm_after_s,
        command_ttl_s,
        telemetry_ttl_s,
        ease_in_s,
        workspace,
        joints,
    } = &station.safety;
    assert_eq!((*lease_ttl_s, *heartbeat_ttl_s, *disarm_after_s), (6.0, 0.15, 0.5));
    assert_eq!((*command_ttl_s, *telemetry_ttl_s, *ease_in_s), (0.15, 0.25, 1.0));
    assert_eq!(*workspace, None::<WorkspaceBox>);
    for (joint, safety) in station.robot.dofs().zip(joints) {
        let limits = joint.limits.expect("the stages have ends");
        assert_eq!((safety.lower, safety.upper), (limits.lower, limits.upper));
        assert!(safety.velocity <= limits.velocity, "{} is faster than its motor", joint.name);
    }
}

/// Texts of takes recorded before stations named devices lack all of it.
#[test]
fn the_texts_of_an_older_take_still_open() {
    let station = station("xarm6_leap.toml");
    let mut files = station.files;
    let old = files.station_toml.find("# Times and limits").expect("where the new sections begin");
    files.station_toml.truncate(old);
    let mut lines: Vec<&str> = files.station_toml.lines().collect();
    lines.retain(|line| !line.starts_with("plans"));
    files.station_toml = lines.join("\n");
    let again = Station::from_files(files).unwrap();
    assert!(again.devices.is_empty() && again.plans.is_empty());
    assert_eq!(again.safety.workspace, None);
    assert_eq!(again.layout.channels, station.layout.channels);
}

#[test]
fn plans_are_kept_with_the_station() {
    let files = station("probe_bench.toml").files;
    let mut with_plans = files.clone();
    with_plans.station_toml = format!("plans = [\"../plans/tour.toml\"]\n{}", files.station_toml);
    let error = Station::from_files(with_plans.clone()).unwrap_err().to_string();
    assert!(error.contains("line 1, plans: failed to read \"../plans/tour.toml\""), "{error}");
    with_plans.files.insert("../plans/tour.toml".to_owned(), b"label = 'Tour'".to_vec());
    let station = Station::from_files(with_plans.clone()).unwrap();
    assert_eq!(station.plans, [("tour".to_owned(), "label = 'Tour'".to_owned())]);
    assert_eq!(station.files, with_plans, "a take carries the plan");

    with_plans.station_toml =
        format!("plans = [\"../plans/tour.toml\", \"../plans/tour.toml\"]\n{}", files.station_toml);
    let error = Station::from_files(with_plans).unwrap_err().to_string();
    assert!(error.contains("has the name of an earlier plan"), "{error}");
}

#[test]
fn every_fault_of_a_device_names_line_and_device() {
    let line = |text: &str| {
        let file = std::fs::read_to_string(repository().join("assets/stations/xarm6_leap.toml")).unwrap();
        format!("line {}, ", 1 + file[..file.find(text).unwrap()].matches('\n').count())
    };
    let servo = "joint = \"index_pip\"\nid = 2\nzero_rad = 3.141592653589793\ndirection = 1\np = 600";
    for (from, to, expected) in [
        (
            "kind = \"xarm\"",
            "kind = \"ur5\"",
            vec!["device \"xarm\"", "unknown kind \"ur5\"", "\"dynamixel\""],
        ),
        ("id = \"xarm\"", "id = \"x arm\"", vec!["device \"x arm\"", "letters"]),
        ("id = \"xarm\"", "id = \"u2d2\"", vec!["device \"u2d2\"", "an earlier device has this id"]),
        ("192.168.1.212", "arm.local", vec!["device \"xarm\"", "\"arm.local\" is not an IP address"]),
        ("report_port = 30003", "report_port = 0", vec!["report_port is 0"]),
        ("report_port = 30003", "watchdog_s = 0.1", vec!["of kind \"xarm\" has no watchdog_s"]),
        (
            "\"joint5\", \"joint6\"]\n\n[[device]]",
            "\"joint5\"]\n\n[[device]]",
            vec!["joint \"joint6\"", "no device moves"],
        ),
        (
            "\"joint5\", \"joint6\"]\n\n[[device]]",
            "\"joint5\", \"joint5\"]\n\n[[device]]",
            vec!["joint \"joint5\"", "moves this joint already"],
        ),
        ("current_limit_a = 0.3", "current_limit_a = 0.6", vec!["current_limit_a is 0.6", "0.55 A"]),
        ("current_limit_a = 0.3", "current_limit_a = nan", vec!["current_limit_a is NaN"]),
        ("baud = 4000000", "baud = 4000001", vec!["baud is 4000001", "115200"]),
        ("watchdog_s = 0.2", "watchdog_s = 1.02", vec!["device \"u2d2\"", "watchdog_s is 1.02", "to 1 s"]),
        ("watchdog_s = 0.2", "watchdog_s = 0.01", vec!["watchdog_s is 0.01", "expected 0.02"]),
        (
            "rate_hz = 100.0\ncurrent_limit_a = 0.3\nwatchdog_s = 0.2",
            "rate_hz = 10.0\ncurrent_limit_a = 0.3\nwatchdog_s = 0.15",
            vec!["watchdog_s is 0.15", "expected 0.2", "two cycles"],
        ),
        ("rate_hz = 100.0\ncurrent", "rate_hz = 0.0\ncurrent", vec!["rate_hz is 0", "10 to 1000 Hz"]),
        (servo, &servo.replace("index_pip", "index_pop"), vec!["joint \"index_pop\"", "expected one of"]),
        (
            servo,
            &servo.replace("index_pip", "index_mcp_side"),
            vec!["joint \"index_mcp_side\"", "moves this joint already"],
        ),
        (
            servo,
            &servo.replace("id = 2", "id = 1"),
            vec!["joint \"index_pip\"", "servo id 1 is that of joint \"index_mcp_forward\""],
        ),
        (servo, &servo.replace("id = 2", "id = 253"), vec!["joint \"index_pip\"", "id is 253"]),
        (servo, &servo.replace("3.141592653589793", "nan"), vec!["joint \"index_pip\"", "zero_rad is NaN"]),
        (
            servo,
            &servo.replace("direction = 1", "direction = 0"),
            vec!["joint \"index_pip\"", "direction is 0"],
        ),
        (servo, &servo.replace("p = 600", "p = 20000"), vec!["joint \"index_pip\"", "p is 20000"]),
        (
            "port = \"/dev/ttyACM1\"",
            "port = \"/dev/ttyACM0\"",
            vec!["device \"twintac1\"", "that of device \"twintac0\" too"],
        ),
        ("port = \"/dev/ttyACM1\"", "port = \"\"", vec!["device \"twintac1\"", "no port"]),
        (
            "first_channel = 8\n",
            "first_channel = 7\n",
            vec!["device \"twintac1\"", "channel \"index_tip.7\"", "\"twintac0\" too"],
        ),
        (
            "first_channel = 24\n",
            "first_channel = 25\n",
            vec!["device \"twintac3\"", "stream \"twintac\" has 32 channels"],
        ),
        (
            "lines_per_sample = 3",
            "lines_per_sample = 5",
            vec!["device \"fsr\"", "lines_per_sample is 5", "divisor"],
        ),
        ("num_channels = 12", "num_channels = 9", vec!["channel \"ring_medial\"", "no device reads"]),
        ("stream = \"fsr\"\nfirst", "stream = \"foil\"\nfirst", vec!["device \"fsr\"", "no stream \"foil\""]),
        ("lines_per_sample = 3", "lines = 3", vec!["unknown field `lines`"]),
    ] {
        let error = edited(from, to).err().unwrap_or_else(|| panic!("{to:?} is accepted")).to_string();
        for word in expected {
            assert!(error.contains(word), "{to}: {word:?} is missing: {error}");
        }
    }
    let error = edited("current_limit_a = 0.3", "current_limit_a = 0.6").unwrap_err().to_string();
    assert!(error.contains(&line("current_limit_a")), "{error}");
}

#[test]
fn every_fault_of_the_safety_section_names_line_and_joint() {
    let joint = |text: &str| format!("[[safety.joint]]\nname = \"index_pip\"\n{text}\n\n# Devices.");
    for (from, to, expected) in [
        ("lease_ttl_s = 6.0", "lease_ttl_s = 0.0".to_owned(), "safety: lease_ttl_s is 0"),
        ("lease_ttl_s = 6.0", "lease_ttl_s = 0.4".to_owned(), "lease_ttl_s 0.4 is below disarm_after_s 0.5"),
        (
            "heartbeat_ttl_s = 0.15",
            "heartbeat_ttl_s = 0.5".to_owned(),
            "heartbeat_ttl_s 0.5 is not below disarm_after_s",
        ),
        ("telemetry_ttl_s = 0.25", "telemetry_ttl_s = nan".to_owned(), "telemetry_ttl_s is NaN"),
        ("ease_in_s = 1.0", "ease_in_s = -1.0".to_owned(), "ease_in_s is -1"),
        ("ease_in_s = 1.0", "easy_s = 1.0".to_owned(), "unknown field `easy_s`"),
        (
            "max_m = [0.8, 0.8, 1.2]",
            "max_m = [0.8, -0.9, 1.2]".to_owned(),
            "safety.workspace: along y it goes from -0.8 to -0.9",
        ),
        ("hand_velocity = 3.0", "hand_velocity = inf".to_owned(), "hand_velocity is inf"),
        (
            "# Devices.",
            joint("upper = 3.0"),
            "joint \"index_pip\": upper is 3 rad, expected it within the robot's limits",
        ),
        (
            "# Devices.",
            joint("velocity = 9.0"),
            "joint \"index_pip\": velocity 9 rad/s is above the robot's 8.48",
        ),
        (
            "# Devices.",
            joint("lower = 1.0\nupper = 0.5"),
            "joint \"index_pip\": lower 1 is not below upper 0.5",
        ),
        ("# Devices.", joint("acceleration = nan"), "joint \"index_pip\": acceleration is NaN"),
        (
            "# Devices.",
            joint("").replace("index_pip", "pip"),
            "joint \"pip\": safety.joint names a joint that the station has not",
        ),
        (
            "# Devices.",
            joint("").replace("# Devices.", &joint("")),
            "joint \"index_pip\": this joint has two",
        ),
    ] {
        let error = edited(from, &to).err().unwrap_or_else(|| panic!("{to:?} is accepted")).to_string();
        assert!(error.contains(expected), "{to}: {error}");
        assert!(error.contains("line "), "{to}: {error}");
    }
    let tight = edited("# Devices.", &joint("upper = 1.5\nvelocity = 1.0")).unwrap();
    let pip = tight.robot.dofs().position(|joint| joint.name == "index_pip").unwrap();
    assert_eq!((tight.safety.joints[pip].upper, tight.safety.joints[pip].velocity), (1.5, 1.0));
    assert_eq!(tight.safety.joints[pip].lower, -0.506);
}

#[test]
fn no_station_file_lifts_the_ceilings_of_times_and_speeds() {
    let joint = |name: &str, text: &str| format!("[[safety.joint]]\nname = {name:?}\n{text}\n\n# Devices.");
    // As in the file, just too much, what is said of it, and what is still allowed.
    for (from, to, expected, allowed) in [
        (
            "heartbeat_ttl_s = 0.15\ndisarm_after_s = 0.5",
            "heartbeat_ttl_s = 3600\ndisarm_after_s = 7200",
            "heartbeat_ttl_s is 3600, expected at most 0.5 s",
            "heartbeat_ttl_s = 0.5\ndisarm_after_s = 0.6",
        ),
        (
            "disarm_after_s = 0.5",
            "disarm_after_s = 2.1",
            "disarm_after_s is 2.1, expected at most 2 s",
            "disarm_after_s = 2.0",
        ),
        (
            "disarm_after_s = 0.5\ncommand_ttl_s = 0.15",
            "disarm_after_s = 0.9\ncommand_ttl_s = 0.6",
            "command_ttl_s is 0.6, expected at most 0.5 s",
            "disarm_after_s = 0.9\ncommand_ttl_s = 0.5",
        ),
        (
            "command_ttl_s = 0.15",
            "command_ttl_s = 0.5",
            "command_ttl_s 0.5 is not below disarm_after_s 0.5",
            "command_ttl_s = 0.4",
        ),
        (
            "disarm_after_s = 0.5\ncommand_ttl_s = 0.15\ntelemetry_ttl_s = 0.25",
            "disarm_after_s = 2.0\ncommand_ttl_s = 0.15\ntelemetry_ttl_s = 1.1",
            "telemetry_ttl_s is 1.1, expected at most 1 s",
            "disarm_after_s = 2.0\ncommand_ttl_s = 0.15\ntelemetry_ttl_s = 1.0",
        ),
        (
            "lease_ttl_s = 6.0",
            "lease_ttl_s = 61.0",
            "lease_ttl_s is 61, expected at most 60 s",
            "lease_ttl_s = 60.0",
        ),
        (
            "ease_in_s = 1.0",
            "ease_in_s = 10.5",
            "ease_in_s is 10.5, expected zero to 10 s",
            "ease_in_s = 10.0",
        ),
        (
            "hand_velocity = 3.0",
            "hand_velocity = 6.3",
            "hand_velocity is 6.3, expected at most 6.283 rad/s",
            "hand_velocity = 6.28",
        ),
        (
            "hand_acceleration = 40.0",
            "hand_acceleration = 201.0",
            "hand_acceleration is 201, expected at most 200 rad/s²",
            "hand_acceleration = 200.0",
        ),
        (
            "carrier_velocity = 0.6",
            "carrier_velocity = 1.6",
            "carrier_velocity is 1.6, expected at most 1.57 rad/s",
            "carrier_velocity = 1.57",
        ),
        (
            "carrier_acceleration = 5.0",
            "carrier_acceleration = 21.0",
            "carrier_acceleration is 21, expected at most 20 rad/s²",
            "carrier_acceleration = 20.0",
        ),
        (
            "carrier_acceleration = 5.0",
            "carrier_acceleration = 1.0",
            "carrier_acceleration is 1, so that braking from carrier_velocity 0.6 takes 0.60 s, expected at most 0.5 s",
            "carrier_acceleration = 1.2",
        ),
        (
            "# Devices.",
            &joint("index_pip", "velocity = 7.0"),
            "joint \"index_pip\": velocity is 7, expected at most 6.283 rad/s",
            &joint("index_pip", "velocity = 6.0"),
        ),
        (
            "# Devices.",
            &joint("joint1", "velocity = 2.0"),
            "joint \"joint1\": velocity is 2, expected at most 1.57 rad/s",
            &joint("joint1", "velocity = 1.5"),
        ),
        (
            "# Devices.",
            &joint("joint1", "acceleration = 50.0"),
            "joint \"joint1\": acceleration is 50, expected at most 20 rad/s²",
            &joint("joint1", "acceleration = 20.0"),
        ),
        (
            "# Devices.",
            &joint("index_pip", "acceleration = 5.0"),
            "joint \"index_pip\": acceleration is 5, so that braking from velocity 3 takes 0.60 s",
            &joint("index_pip", "acceleration = 6.0"),
        ),
    ] {
        let error = edited(from, to).err().unwrap_or_else(|| panic!("{to:?} is accepted")).to_string();
        assert!(error.contains(expected) && error.contains("line "), "{to}: {error}");
        edited(from, allowed).unwrap_or_else(|error| panic!("{allowed:?} is refused: {error}"));
    }
}

#[test]
fn sliding_joints_without_a_speed_of_their_own_get_no_more_than_their_ceiling() {
    let mut files = station("probe_bench.toml").files;
    let robot = files.files.get_mut("../robots/probe_bench.urdf").expect("the robot's file");
    *robot = String::from_utf8(robot.clone())
        .expect("text")
        .replace("velocity=\"0.1\"", "velocity=\"0\"")
        .into_bytes();
    files.station_toml.push_str("\n[safety.joint_defaults]\ncarrier_velocity = 1.5\n");
    let fastest = |files| {
        let joints = Station::from_files(files).expect("a station").safety.joints;
        joints.iter().map(|joint| joint.velocity).fold(0.0, f64::max)
    };
    assert_eq!(fastest(files.clone()), 1.0);
    files.station_toml.push_str("[[safety.joint]]\nname = \"stage_z\"\nvelocity = 1.2\n");
    let error = Station::from_files(files).unwrap_err().to_string();
    assert!(error.contains("joint \"stage_z\": velocity is 1.2, expected at most 1 m/s"), "{error}");
}
