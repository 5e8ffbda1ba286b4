//! Import of where a moving object is.

use std::{fmt::Write as _, fs, path::Path};

use nalgebra::Vector3;
use palpate_recording::{
    Session, Take,
    import::{ImportOptions, Mapping, explain, import, import_csv},
};
use palpate_robot_model::ObjectPath;

use crate::support::{station, tree};

const TAKE_TOML: &str =
    "object = \"ball\"\nprimitive = \"push\"\nbaseline_s = [0.0, 0.9]\nrepetitions_s = []\n";

/// Times of two seconds at `rate_hz`, and a row of each.
fn csv(header: &str, rate_hz: f64, row: impl Fn(f64) -> String) -> String {
    let mut text = format!("{header}\n");
    for time_s in (0..(2.0 * rate_hz) as usize).map(|row| row as f64 / rate_hz) {
        writeln!(text, "{time_s},{}", row(time_s)).unwrap();
    }
    text
}

/// A recording of a hand that stands still, with `object.csv` where it is given.
fn write_recording(dir: &Path, take_toml: &str, object_csv: Option<&str>) {
    fs::create_dir_all(dir).unwrap();
    fs::write(dir.join("take.toml"), take_toml).unwrap();
    fs::write(dir.join("joints.csv"), csv("t,slide,curl", 10.0, |_| "0.1,-0.5".to_owned())).unwrap();
    fs::write(dir.join("gel.csv"), csv("t,tip.0,tip.1,tip.2", 100.0, |_| "200,210,190".to_owned())).unwrap();
    fs::write(dir.join("film.csv"), csv("t_s,v0,v1", 40.0, |_| "300,310".to_owned())).unwrap();
    if let Some(text) = object_csv {
        fs::write(dir.join("object.csv"), text).unwrap();
    }
}

/// 20 mm/s along x and a quarter turn a second about z.
fn pushed() -> String {
    csv("t,x_mm,y_mm,z_mm,qw,qx,qy,qz", 50.0, |t| {
        let half_rad = std::f64::consts::FRAC_PI_4 * t;
        format!("{},0,50,{},0,0,{}", 100.0 + 20.0 * t, half_rad.cos(), half_rad.sin())
    })
}

fn imported(take_toml: &str, object_csv: &str) -> Take {
    let root = tempfile::tempdir().unwrap();
    write_recording(&root.path().join("csv/take-01"), take_toml, Some(object_csv));
    let session = import_csv(&station(), &root.path().join("csv"), &root.path().join("session")).unwrap();
    Session::open(&session).unwrap().take(0).unwrap()
}

#[test]
fn poses_of_an_object_become_those_of_the_take() {
    let take = imported(TAKE_TOML, &pushed());
    assert_eq!(take.object_poses.times_s.len(), 100);
    let ObjectPath::Moving(path) = take.object_path() else { panic!("it moves") };
    for (time_s, pose) in take.joints.times_s.iter().zip(&path) {
        let expected = Vector3::new(0.1 + 0.02 * time_s, 0.0, 0.05);
        assert!((pose.translation.vector - expected).norm() < 1e-9, "{pose} at {time_s} s");
        let turn = pose.rotation.scaled_axis() - Vector3::z() * std::f64::consts::FRAC_PI_2 * *time_s;
        assert!(turn.norm() < 1e-9, "{pose} at {time_s} s");
    }
    assert_eq!(take.meta.base_from_object, path[0]);
}

#[test]
fn without_a_quaternion_it_stays_turned_as_take_toml_says() {
    let sliding = csv("t,x,y,z", 20.0, |t| format!("{},0,0.05", 0.1 + 0.02 * t));
    let toml = format!("{TAKE_TOML}object_pose = {{ position_m = [0.1, 0, 0.05], rpy_rad = [0, 0, 1.0] }}\n");
    let take = imported(&toml, &sliding);
    assert_eq!(take.object_poses.poses.len(), 40);
    for pose in &take.object_poses.poses {
        assert!((pose.rotation.scaled_axis() - Vector3::z()).norm() < 1e-12);
    }
    assert!(imported(TAKE_TOML, &sliding).object_poses.poses[0].rotation.angle() < 1e-12);
}

#[test]
fn a_recording_that_begins_with_the_tracker_keeps_its_times() {
    let early = csv("t_ms,x,y,z", 20.0, |_| "0.1,0,0.05".to_owned()).replace("\n0,", "\n-250,");
    let take = imported(TAKE_TOML, &early);
    // Time zero is the last whole second at or before the earliest sample.
    assert_eq!(take.object_poses.times_s[0], 0.75);
    assert_eq!(take.joints.times_s[0], 1.0);
}

#[test]
fn explain_says_how_far_it_moves_and_what_disagrees() {
    let root = tempfile::tempdir().unwrap();
    let csv_dir = root.path().join("csv");
    let toml = format!("{TAKE_TOML}object_pose = {{ position_m = [0.13, 0, 0.05] }}\n");
    write_recording(&csv_dir.join("take-01"), &toml, Some(&pushed()));
    let report = explain(&station(), &csv_dir, ImportOptions::default()).unwrap();
    let take = &report.takes[0];
    assert!(report.ok, "{:?}", take.problem);
    let file = take.files.iter().find(|file| file.file == "object.csv").unwrap();
    let columns: Vec<(&str, &str)> =
        file.columns.iter().map(|column| (column.what, column.id.as_str())).collect();
    assert_eq!(columns[..2], [("object coordinate", "x"), ("object coordinate", "y")]);
    assert_eq!((file.columns[0].unit.as_str(), file.columns[0].to_unit.as_str()), ("mm", "m"));
    let note = "the object is where object.csv says: 100 poses, up to 39.6 mm and 3.11 rad from the first";
    assert!(take.notes.iter().any(|found| found == note), "{:?}", take.notes);
    let warning = "object_pose is 30.0 mm from the first pose in object.csv, which counts";
    assert!(take.warnings.iter().any(|found| found == warning), "{:?}", take.warnings);
}

#[test]
fn what_is_wrong_with_poses_is_named_by_line_and_changes_nothing() {
    let line = |number: usize, with: &str| {
        let text = pushed();
        let lines = text.lines().enumerate().map(|(idx, line)| if idx + 1 == number { with } else { line });
        lines.collect::<Vec<_>>().join("\n")
    };
    let cases = [
        (
            line(4, "0.04,100,0,50,0.9,0,0,0"),
            "object.csv: line 4: the quaternion [0.9, 0.0, 0.0, 0.0] (qw, qx, qy, qz)",
        ),
        (line(4, "0.04,100000,0,50,1,0,0,0"), "object.csv: line 4: the object is 100"),
        (
            line(4, "0.01,100,0,50,1,0,0,0"),
            "object.csv: line 4, column 1 (t): time 0.01 s does not come after 0.02 s",
        ),
        (
            line(4, "0.04,nan,0,50,1,0,0,0"),
            "object.csv: line 4, column 2 (x_mm, object coordinate \"x\"): NaN is not finite",
        ),
        (
            line(4, "0.04,,0,50,1,0,0,0"),
            "object.csv: line 4, column 2 (x_mm, object coordinate \"x\"): is empty",
        ),
        (
            pushed().replace("z_mm", "height"),
            "no column for object coordinate \"z\"; a pose has x, y, z, and, if it turns, qw, qx, qy, qz",
        ),
        (pushed().replace(",qz", ",q_z"), "no column for object coordinate \"qz\""),
        (
            pushed().replace("x_mm", "x_deg"),
            "unit \"deg\" of object coordinate \"x\" cannot be converted to m",
        ),
        ("t,x,y,z\n".to_owned(), "object.csv"),
        (String::new(), "object.csv: line 1: the file is empty, expected a header with x, y and z"),
    ];
    for (text, expected) in cases {
        let root = tempfile::tempdir().unwrap();
        write_recording(&root.path().join("csv/take-01"), TAKE_TOML, Some(&text));
        let before = tree(root.path());
        let error = import_csv(&station(), &root.path().join("csv"), &root.path().join("session"))
            .expect_err(expected)
            .to_string();
        assert_eq!(tree(root.path()), before);
        assert!(error.contains(expected), "{error}\nlacks\n{expected}");
    }
    // Somewhere it has to be.
    let root = tempfile::tempdir().unwrap();
    write_recording(&root.path().join("csv/take-01"), TAKE_TOML, None);
    let error = import_csv(&station(), &root.path().join("csv"), &root.path().join("session"))
        .unwrap_err()
        .to_string();
    assert!(error.contains("take.toml: file: missing field `object_pose`"), "{error}");
}

#[test]
fn a_mapping_file_says_which_columns_of_a_tracker_are_the_pose() {
    let root = tempfile::tempdir().unwrap();
    let csv_dir = root.path().join("csv");
    write_recording(&csv_dir.join("take-01"), TAKE_TOML, None);
    let tracked = csv("stamp,px,py,pz,quality", 50.0, |t| format!("{},0,50,0.9", 100.0 + 20.0 * t));
    fs::write(csv_dir.join("take-01/tracker.csv"), tracked).unwrap();
    let path = root.path().join("mapping.toml");
    let mapping = |map: &str| {
        let files = "{ file = 'joints.csv' }, { file = 'gel.csv' }, { file = 'film.csv', map = [{ columns = ['v0', 'v1'], \
                     channels = ['CHANNEL_A', 'CHANNEL_B'] }] }";
        let film: Vec<String> = {
            let station = station();
            let stream = &station.layout.streams[1];
            station.layout.channels[stream.channels.clone()]
                .iter()
                .map(|channel| channel.id.clone())
                .collect()
        };
        let files = files.replace("CHANNEL_A", &film[0]).replace("CHANNEL_B", &film[1]);
        let text = format!("format = 1\nfile = [{files}, {{ file = 'tracker.csv', map = [{map}] }}]\n");
        Mapping::parse(&path, &text)
    };
    let map = "{ columns = ['px', 'py', 'pz'], object = ['x', 'y', 'z'], unit = 'mm' }";
    let options = |mapping| ImportOptions { mapping: Some(mapping), find_repetitions: false };
    let good = mapping(map).unwrap();
    let (session, report) =
        import(&station(), &csv_dir, options(&good), &root.path().join("session")).unwrap();
    let take = Session::open(&session).unwrap().take(0).unwrap();
    assert_eq!(take.object_poses.poses.len(), 100);
    assert!((take.object_poses.poses[50].translation.x - 0.12).abs() < 1e-9);
    let warnings = &report.takes[0].warnings;
    assert!(
        warnings.iter().any(|text| text.contains("column 5 \"quality\" is no number of a pose")),
        "{warnings:?}"
    );

    let wrong = mapping("{ columns = ['px', 'py'], object = ['x', 'yaw'] }").unwrap();
    let error = explain(&station(), &csv_dir, options(&wrong)).unwrap().takes[0].problem.clone().unwrap();
    assert!(
        error.contains("\"yaw\" is no number of a pose, expected some of x, y, z, qw, qx, qy, qz"),
        "{error}"
    );
    for (map, expected) in [
        (
            "{ columns = 'px', object = 'x', joints = 'slide' }",
            "expected exactly one of joints, channels, patch, stream and object",
        ),
        (
            "{ columns = 'px', object = 'x', polarity = -1 }",
            "turn a joint or a coordinate round with scale = -1",
        ),
    ] {
        let error = mapping(map).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
    }
}
