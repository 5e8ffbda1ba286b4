//! The command as people and scripts use it.

use std::{
    fs,
    io::{BufRead as _, BufReader, Read as _, Write as _},
    net::TcpStream,
    path::Path,
    process::{Command, Stdio},
};

use palpate_motion::Plan;
use palpate_recording::{TactileSampleRef, Take, TakeWriter};
use serde_json::Value;

use crate::support::{
    Data, NUM_CHANNELS, NUM_FRAMES, NUM_TAKES, STATION, arg, palpate, palpate_ok, palpate_refuses,
    write_recording,
};

#[test]
fn help_lists_every_command() {
    insta::assert_snapshot!(palpate_ok(&["--help"]));
}

#[test]
fn the_library_of_effects_has_every_parameter_within_its_bounds() {
    let listed: Vec<Value> = serde_json::from_str(&palpate_ok(&["effects", "--json"])).unwrap();
    let of = |domain: &str| listed.iter().filter(|effect| effect["domain"] == domain).count();
    assert!(of("tactile") >= 20 && of("actuator") >= 15, "{listed:?}");
    for effect in &listed {
        for parameter in effect["parameters"].as_array().unwrap() {
            let value = |key: &str| parameter[key].as_f64().unwrap();
            assert!((value("lower")..=value("upper")).contains(&value("neutral")), "{effect}");
            assert!(parameter["smallest"].as_f64().is_none_or(|smallest| smallest >= 0.0), "{effect}");
        }
    }
    let text = palpate_ok(&["effects"]);
    assert!(text.contains("current_limit (actuator)") && text.contains("more like these"), "{text}");
    assert!(palpate_refuses(&["effects", "--station", "nowhere"]).contains("xarm6-leap"));
}

#[test]
fn every_command_has_help() {
    for command in [
        &["emulate"][..],
        &["import"],
        &["session", "check"],
        &["replay"],
        &["calibrate"],
        &["diagnose"],
        &["effects"],
        &["serve"],
        &["bench", "sweep"],
        &["bench", "replay"],
    ] {
        let help = palpate_ok(&[command, &["--help"]].concat());
        assert!(help.contains("--json"), "{command:?}: {help}");
    }
}

#[test]
fn unknown_arguments_are_refused() {
    for args in [&["fly"][..], &["calibrate"], &["calibrate", "--session", "x", "--method", "guess"], &[]] {
        assert_eq!(palpate(args).status.code(), Some(2), "{args:?}");
    }
}

#[test]
fn recording_is_imported_checked_calibrated_and_replayed() {
    let data = Data::empty();
    let csv = data.csv();
    write_recording(data.csv());
    let session = data.path("session");
    let json =
        palpate_ok(&["import", "--csv", arg(csv), "--out", arg(&session), "--station", STATION, "--json"]);
    let imported: Value = serde_json::from_str(&json).unwrap();
    assert_eq!(imported["summary"]["frames"], NUM_TAKES * NUM_FRAMES);

    let check: Value =
        serde_json::from_str(&palpate_ok(&["session", "check", arg(&session), "--json"])).unwrap();
    assert_eq!(check["ok"], true);
    assert_eq!(check["coverage"].as_array().unwrap().len(), NUM_CHANNELS);
    assert_eq!(check["takes"][0]["streams"][1]["stream"], "gel");
    for key in ["session", "ok", "frames", "duration_s", "takes", "coverage", "problems"] {
        assert!(check.get(key).is_some(), "{key} is missing");
    }
    let text = palpate_ok(&["session", "check", arg(&session)]);
    assert!(text.contains("take-01") && text.trim_end().ends_with("usable"), "{text}");

    let (model, report_dir) = (data.path("model.toml"), data.path("report"));
    let json = palpate_ok(&[
        "calibrate",
        "--session",
        arg(&session),
        "--hold-out",
        "take-03,take-04",
        "--out",
        arg(&model),
        "--report",
        arg(&report_dir),
        "--json",
    ]);
    let report: Value = serde_json::from_str(&json).unwrap();
    assert_contract(&report);
    assert_eq!(report["frames"], NUM_TAKES * NUM_FRAMES);
    assert_eq!(report["channels"], NUM_CHANNELS);
    assert!(report["calibrated"]["l1"].as_u64() < report["nominal"]["l1"].as_u64(), "{report}");
    let stored: Value = serde_json::from_slice(&fs::read(report_dir.join("report.json")).unwrap()).unwrap();
    assert_eq!(stored, report);
    assert_eq!(fs::read(report_dir.join("model.toml")).unwrap(), fs::read(&model).unwrap());
    assert!(fs::read_to_string(report_dir.join("report.html")).unwrap().contains("<svg"));

    let out = data.path("replayed.mcap");
    let take = session.join("take-01.mcap");
    let json =
        palpate_ok(&["replay", "--take", arg(&take), "--model", arg(&model), "--out", arg(&out), "--json"]);
    let replayed: Value = serde_json::from_str(&json).unwrap();
    assert_eq!((&replayed["frames"], &replayed["channels"]), (&NUM_FRAMES.into(), &NUM_CHANNELS.into()));
    let (recorded, simulated) = (Take::read(&take).unwrap(), Take::read(&out).unwrap());
    assert_eq!(simulated.joints, recorded.joints);
    assert_eq!(simulated.spans, recorded.spans);
    assert_eq!(simulated.start_unix_ns, recorded.start_unix_ns);
    assert_eq!(simulated.streams[0].times_s, recorded.joints.times_s);
    let mismatches = simulated
        .active_at_frames()
        .iter()
        .zip(recorded.active_at_frames())
        .filter(|(a, b)| **a != *b)
        .count();
    let expected = report["by_take"]["take-01"]["calibrated"]["l1"].as_u64().unwrap();
    assert_eq!(mismatches as u64, expected, "the replayed take is the one that the report counted");
}

#[test]
fn session_is_diagnosed_and_the_model_replays_with_what_was_named() {
    let data = Data::with_emulated_session();
    let (model, report_dir) = (data.path("model.toml"), data.path("report"));
    let (session, data_dir) = (data.session(), data.root());
    let common =
        ["diagnose", "--session", arg(session), "--data", arg(data_dir), "--hold-out", "take-04,take-06"];
    let next = data.path("next.toml");
    let files = ["--out", arg(&model), "--report", arg(&report_dir), "--plan", arg(&next), "--json"];
    let json = palpate_ok(&[&common[..], &files].concat());
    let report: Value = serde_json::from_str(&json).unwrap();
    let whole: palpate_reports::DiagnosisReport = serde_json::from_str(&json).unwrap();
    assert_eq!(serde_json::to_value(&whole).unwrap(), report, "nothing beside the report");
    for key in ["verdict", "where", "gap", "held_out", "metrics", "unexplained", "next_experiment", "seconds"]
    {
        assert!(report.get(key).is_some(), "{key} is missing");
    }
    for key in ["nominal", "calibrated", "diagnosed", "noise_floor"] {
        assert!(report["gap"].get(key).is_some(), "gap.{key} is missing");
    }
    let named = &report["effects"][0];
    assert!(named["where"].is_object() && named["parameters"].is_object(), "{named}");
    for key in ["interval", "gap_before", "gap_after", "takes_improved", "class", "rivals", "explanation"] {
        assert!(named.get(key).is_some(), "effects.{key} is missing");
    }
    assert!(named.get("p_value").is_none(), "without null sessions there is no probability: {named}");
    // What it asks for is a plan that its station can be moved by.
    let station = Take::read(&session.join("take-01.mcap")).unwrap().station;
    let plan = Plan::read(&next).unwrap();
    plan.check(&station).unwrap();
    assert_eq!(report["next_experiment"]["primitive"], plan.takes[0].primitive.as_str());
    assert!(plan.takes.len() >= 2 && plan.takes.iter().all(|take| take.object == plan.takes[0].object));

    let stored: Value = serde_json::from_slice(&fs::read(report_dir.join("report.json")).unwrap()).unwrap();
    assert_eq!(stored, report);
    assert_eq!(fs::read(report_dir.join("model.toml")).unwrap(), fs::read(&model).unwrap());
    assert!(fs::read_to_string(report_dir.join("report.html")).unwrap().contains("<svg"));
    assert!(!data_dir.join("bars").exists(), "no bar was asked for");

    let (take, out) = (session.join("take-04.mcap"), data.path("replayed.mcap"));
    palpate_ok(&["replay", "--take", arg(&take), "--model", arg(&model), "--out", arg(&out)]);
    let (recorded, simulated) = (Take::read(&take).unwrap(), Take::read(&out).unwrap());
    let mismatches =
        |events: &[bool]| events.iter().zip(recorded.active_at_frames()).filter(|(a, b)| **a != *b).count();
    let calibrated = data.path("calibrated.toml");
    palpate_ok(&[
        "calibrate",
        "--session",
        arg(session),
        "--hold-out",
        "take-04,take-06",
        "--out",
        arg(&calibrated),
    ]);
    palpate_ok(&["replay", "--take", arg(&take), "--model", arg(&calibrated), "--out", arg(&out)]);
    let without = Take::read(&out).unwrap();
    assert!(mismatches(&simulated.active_at_frames()) < mismatches(&without.active_at_frames()));

    let text = palpate_ok(&common);
    assert!(text.starts_with(report["sentence"].as_str().unwrap()), "{text}");
    for word in [
        "latency, stream",
        "Gap on the judging takes",
        "calibrated",
        "Unexplained",
        "confirm: take-04, take-06",
    ] {
        assert!(text.contains(word), "{word:?} is missing in {text}");
    }
}

#[test]
fn joints_of_a_session_with_commands_are_diagnosed_one_after_the_other() {
    let data = Data::with_session();
    let diagnose = ["actuator", "diagnose", "--logs", arg(data.session()), "--json"];
    let silent = palpate_refuses(&[&diagnose[..], &["--joint", "all"]].concat());
    assert!(silent.contains("hold no joint commands"), "{silent}");

    let mut joints = Vec::new();
    for idx in 1..=NUM_TAKES {
        let path = data.session().join(format!("take-{idx:02}.mcap"));
        let take = Take::read(&path).unwrap();
        joints = take.station.robot.dofs().map(|joint| joint.name.clone()).collect();
        write_with_commands(&take, &path);
    }
    let [first, second, ..] = &joints[..] else { panic!("{joints:?}") };
    let unsaid = palpate_refuses(&diagnose);
    assert!(
        unsaid.contains(&format!("say which joint, or all; there are {}", joints.join(", "))),
        "{unsaid}"
    );
    let unknown = palpate_refuses(&[&diagnose[..], &["--joint", "elbow"]].concat());
    assert!(unknown.contains("no joint \"elbow\""), "{unknown}");

    let one: Value =
        serde_json::from_str(&palpate_ok(&[&diagnose[..], &["--joint", first]].concat())).unwrap();
    let both = format!("{first},{second}");
    let json = palpate_ok(&[&diagnose[..], &["--joint", &both]].concat());
    let both: Value = serde_json::from_str(&json).unwrap();
    assert_eq!(both["joints"][0]["joint"], first.as_str());
    assert_eq!(both["joints"][1]["joint"], second.as_str());
    assert_eq!(both["joints"][0]["report"]["sentence"], one["sentence"], "one by itself is the report alone");
    let notes = one["notes"].to_string();
    assert!(notes.contains("the logs state no position gain"), "{notes}");
}

/// `take` again, with commands that its joints follow after a frame.
fn write_with_commands(take: &Take, path: &Path) {
    let file = fs::File::create(path).unwrap();
    let mut writer = TakeWriter::new(file, &take.station, &take.meta, take.start_unix_ns).unwrap();
    let num_dofs = take.station.robot.num_dofs();
    let rows: Vec<&[f64]> = take.joints.positions.chunks(num_dofs).collect();
    for (frame, &time_s) in take.joints.times_s.iter().enumerate() {
        let time_ns = (time_s * 1e9).round() as u64;
        writer.joints(time_ns, rows[frame]).unwrap();
        writer.commands(time_ns, rows[(frame + 1).min(rows.len() - 1)]).unwrap();
    }
    let widths = take.station.layout.streams.iter().map(|stream| stream.channels.len());
    for (idx, (stream, width)) in take.streams.iter().zip(widths).enumerate() {
        for (sample, &time_s) in stream.times_s.iter().enumerate() {
            let row = sample * width..(sample + 1) * width;
            let sample = TactileSampleRef {
                raw: &stream.raw[row.clone()],
                active: &stream.active[row],
                device_time_ns: 0,
            };
            writer.tactile(idx, (time_s * 1e9).round() as u64, sample).unwrap();
        }
    }
    writer.finish().unwrap();
}

#[test]
fn bar_of_a_station_is_set_once_and_kept() {
    let data = Data::with_session();
    let (session, data_dir) = (data.session(), data.path("bars-of-stations"));
    let diagnose = |more: &[&str]| -> Value {
        let common = ["diagnose", "--session", arg(session), "--data", arg(&data_dir), "--json"];
        serde_json::from_str(&palpate_ok(&[&common, more].concat())).unwrap()
    };
    assert_eq!(diagnose(&[])["bar"]["null_sessions"], 0, "the shipped default");
    let set = diagnose(&["--null-bar", "20"]);
    assert_eq!(set["bar"]["null_sessions"], 20);
    assert_eq!(set["bar"]["null_maxima"].as_array().unwrap().len(), 20);
    assert_eq!(diagnose(&[])["bar"], set["bar"], "later diagnoses use it");
}

/// The field names that scripts read.
fn assert_contract(report: &Value) {
    let metrics = ["onset_error_ms", "offset_error_ms", "f1", "fpr", "l1"];
    for place in ["/nominal", "/calibrated", "/held_out/nominal", "/held_out/calibrated"] {
        for metric in metrics {
            assert!(report.pointer(&format!("{place}/{metric}")).is_some(), "{place}/{metric} is missing");
        }
    }
    for theta in ["lambda_con_m", "alpha_per_m", "lambda_pre_pa"] {
        assert!(report["theta"][theta].is_f64(), "theta.{theta} is missing");
    }
    for key in ["frames", "channels", "evaluations", "seconds"] {
        assert!(report[key].is_number(), "{key} is missing");
    }
    assert!(report["by_modality"]["gel"]["calibrated"]["f1"].is_number());
    assert!(report["by_modality"]["film"]["nominal"].get("fpr").is_some());
    assert_eq!(report["by_take"].as_object().unwrap().len(), NUM_TAKES);
    assert_eq!(report["by_take"]["take-03"]["held_out"], true);
}

#[test]
fn damaged_session_fails_the_check_with_a_report() {
    let data = Data::with_session();
    let session_dir = data.session();
    data.truncate_take();
    let output = palpate(&["session", "check", arg(session_dir), "--json"]);
    assert_eq!(output.status.code(), Some(2));
    let check: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(check["ok"], false);
    assert_eq!(check["problems"][0]["severity"], "error");
}

#[test]
fn reader_that_has_heard_enough_is_no_error() {
    let data = Data::with_session();
    let session_dir = data.session();
    let mut child = Command::new(env!("CARGO_BIN_EXE_palpate"))
        .args(["session", "check", arg(session_dir), "--json"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    drop(child.stdout.take());
    let output = child.wait_with_output().unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && stderr.is_empty(), "{}: {stderr}", output.status);
}

#[test]
fn serve_prints_its_address_and_ends_when_asked() {
    let data = Data::with_session();
    let mut child = Command::new(env!("CARGO_BIN_EXE_palpate"))
        .args(["serve", "--listen", "127.0.0.1:0", "--data", arg(data.root())])
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let mut line = String::new();
    BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
    let address = line.trim().strip_prefix("listening on http://").unwrap_or_else(|| panic!("{line:?}"));
    let mut socket = TcpStream::connect(address).unwrap();
    socket
        .write_all(b"GET /api/v1/sessions HTTP/1.1\r\nhost: localhost\r\nconnection: close\r\n\r\n")
        .unwrap();
    let mut response = String::new();
    socket.read_to_string(&mut response).unwrap();
    assert!(response.starts_with("HTTP/1.1 200") && response.contains("\"taps\""), "{response}");

    let asked = Command::new("kill").args(["-TERM", &child.id().to_string()]).status().unwrap();
    assert!(asked.success());
    assert!(child.wait().unwrap().success(), "a stop that was asked for is no failure");
}

#[test]
fn port_in_use_is_named() {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    let data = Data::empty();
    let error = crate::support::palpate_refuses(&["serve", "--listen", &address, "--data", arg(data.root())]);
    assert!(error.contains(&address), "{error}");
}

#[test]
fn an_import_says_which_station_it_takes_and_why() {
    let data = Data::empty();
    write_recording(data.csv());
    let csv = arg(data.csv()).to_owned();
    let before = fs::read_dir(data.path(".")).unwrap().count();
    let text = palpate_ok(&["import", "--csv", &csv, "--explain"]);
    let first = text.lines().next().unwrap();
    assert!(
        first.starts_with("station probe-bench: the only shipped station that the recordings fit"),
        "{text}"
    );
    assert!(
        text.contains("joints: 300 samples") && text.trim_end().ends_with("nothing was written"),
        "{text}"
    );
    let report: Value =
        serde_json::from_str(&palpate_ok(&["import", "--csv", &csv, "--explain", "--json"])).unwrap();
    assert_eq!((report["ok"].as_bool(), report["station"].as_str()), (Some(true), Some(STATION)));
    assert_eq!(report["takes"].as_array().unwrap().len(), NUM_TAKES);
    assert_eq!(fs::read_dir(data.path(".")).unwrap().count(), before);

    // A problem of one take is told beside the others.
    let joints = data.csv().join("take-02/joints.csv");
    let text = fs::read_to_string(&joints).unwrap();
    fs::write(
        &joints,
        text.replacen("q2", "stage_zz", 1).replacen("q1", "stage_y", 1).replacen("q0", "stage_x", 1),
    )
    .unwrap();
    let output = palpate(&["import", "--csv", &csv, "--explain"]);
    let text = String::from_utf8(output.stdout).unwrap();
    assert_eq!(output.status.code(), Some(2), "{text}");
    assert!(
        text.contains("\"stage_zz\" looks like \"stage_z\"")
            && text.contains("1 of 4 takes cannot be imported"),
        "{text}"
    );

    // Nobody's recordings become those of a station by default.
    fs::rename(data.csv().join("take-01/gel.csv"), data.csv().join("take-01/jelly.csv")).unwrap();
    let error = palpate_refuses(&["import", "--csv", &csv, "--explain"]);
    assert!(
        error.contains("no shipped station fits the recordings; name the station that recorded them"),
        "{error}"
    );
    assert!(error.contains("probe-bench does not: ") && error.contains("xarm6-leap does not: "), "{error}");
}

#[test]
fn recordings_that_fit_several_stations_are_the_usual_ones_and_the_others_are_named() {
    let data = Data::empty();
    let station = palpate_server::assets::station("xarm6-leap").unwrap();
    let take = data.csv().join("take-01");
    fs::create_dir_all(&take).unwrap();
    let table = |names: Vec<&str>, value: &str| {
        let header = format!("t_s,{}\n", names.join(","));
        let row = vec![value; names.len()].join(",");
        (0..300).fold(header, |text, number| format!("{text}{:.2},{row}\n", f64::from(number) * 0.01))
    };
    let joints = station.robot.dofs().map(|joint| joint.name.as_str()).collect();
    fs::write(take.join("joints.csv"), table(joints, "0.0")).unwrap();
    for stream in &station.layout.streams {
        let names =
            station.layout.channels[stream.channels.clone()].iter().map(|channel| channel.id.as_str());
        fs::write(take.join(format!("{}.csv", stream.id)), table(names.collect(), "10.0")).unwrap();
    }
    fs::write(
        take.join("take.toml"),
        "object = \"sphere_50mm\"\nobject_pose = { position_m = [0.4, 0.0, 0.3] }\nprimitive = \"tap\"\n\
         baseline_s = [0.0, 2.0]\n",
    )
    .unwrap();
    let text = palpate_ok(&["import", "--csv", arg(data.csv()), "--explain"]);
    let first = text.lines().next().unwrap();
    assert!(first.starts_with("station xarm6-leap: the usual one of the shipped stations"), "{text}");
    assert!(first.contains("xarm6-leap-c"), "{first}");
}
