use super::*;

const STATION: &str = r#"id = "bench"
label = "Bench"
robot = "robots/slide.urdf"
layout = "pad.toml"
nominal_model = "nominal.toml"
objects = ["objects/ball.toml", "objects/ramp.toml"]
joint_rate_hz = 20.0
joints = ["turn", "lift"]
carrier_joints = ["lift"]

[[stream]]
stream = "film"
on_threshold = 30.0
off_threshold = 20.0
raw_min = 0.0
raw_max = 1023.0
"#;

const URDF: &str = r#"<robot name="slide"><link name="base"/><link name="column"/><link name="tip"/>
<joint name="lift" type="prismatic"><parent link="base"/><child link="column"/><axis xyz="0 0 1"/>
<limit lower="0" upper="0.1" velocity="0.1" effort="5"/></joint>
<joint name="turn" type="revolute"><parent link="column"/><child link="tip"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" velocity="1" effort="5"/></joint></robot>"#;

const LAYOUT: &str = r#"name = "One film sensor"
[[stream]]
id = "film"
label = "Film"
kind = "proximity"
rate_hz = 40.0
raw_unit = "counts"
[[patch]]
id = "tip"
label = "Tip"
group = "probe"
stream = "film"
link = "tip"
pose = { position_m = [0, 0, 0] }
shape = { kind = "cap", radius_m = 0.01, half_angle_rad = 0.8 }
node_spacing_m = 0.002
"#;

const BALL: &str = "id = 'ball'\nlabel = 'Ball'\nshape = { kind = 'sphere', radius_m = 0.02 }";
const RAMP: &str = "id = 'ramp'\nlabel = 'Ramp'\nshape = { kind = 'mesh', file = 'meshes/tetra.obj' }";
const TETRA: &str = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n";

/// The files of the station above, with `from` replaced by `to` in the file `path`.
fn read_with(path: &str, from: &str, to: &str) -> Result<Station, ModelError> {
    let files = [
        ("bench.toml", STATION),
        ("robots/slide.urdf", URDF),
        ("pad.toml", LAYOUT),
        ("nominal.toml", "format = 1"),
        ("objects/ball.toml", BALL),
        ("objects/ramp.toml", RAMP),
        ("objects/meshes/tetra.obj", TETRA),
    ];
    Station::read("bench.toml", |asked| {
        let (name, text) = files.iter().find(|(name, _)| *name == asked).ok_or("no such file")?;
        if *name == path {
            assert!(text.contains(from), "{path} has no {from:?}");
            return Ok(text.replacen(from, to, 1).into_bytes());
        }
        Ok(text.as_bytes().to_vec())
    })
}

fn read() -> Station {
    read_with("", "", "").expect("the station of these tests")
}

#[test]
fn a_station_brings_its_files_together() {
    let station = read();
    assert_eq!(station.id, "bench");
    let dofs: Vec<&str> = station.robot.dofs().map(|joint| joint.name.as_str()).collect();
    assert_eq!(dofs, ["turn", "lift"], "the order of the station, not of the URDF");
    assert_eq!(station.carrier_dofs, [1]);
    assert_eq!(station.objects.keys().collect::<Vec<_>>(), ["ball", "ramp"]);
    assert_eq!(station.streams[0].off_threshold, 20.0);
    assert_eq!(station.nominal_model_toml, "format = 1");
    let kept: Vec<&str> = station.files.files.keys().map(String::as_str).collect();
    assert_eq!(
        kept,
        [
            "nominal.toml",
            "objects/ball.toml",
            "objects/meshes/tetra.obj",
            "objects/ramp.toml",
            "pad.toml",
            "robots/slide.urdf"
        ]
    );
}

#[test]
fn the_attached_texts_make_the_same_station() {
    let station = read();
    let again = Station::from_files(station.files.clone()).unwrap();
    assert_eq!(again.files, station.files);
    assert_eq!(again.streams, station.streams);
    assert_eq!(again.layout.channels, station.layout.channels);

    let mut short = station.files;
    short.files.remove("pad.toml");
    let error = Station::from_files(short).unwrap_err().to_string();
    assert!(error.contains("failed to read \"pad.toml\"") && error.contains("attached files"), "{error}");
}

#[test]
fn every_fault_of_the_station_file_names_its_line() {
    for (from, to, expected) in [
        ("id = \"bench\"", "id = \"\"", "bench.toml: id: id is \"\""),
        ("id = \"bench\"", "name = \"bench\"", "line 1: unknown field `name`"),
        (
            "robots/slide.urdf",
            "robots/slid.urdf",
            "line 3, robot: failed to read \"robots/slid.urdf\": no such file",
        ),
        ("pad.toml", "pod.toml", "line 4, layout: failed to read \"pod.toml\""),
        ("nominal.toml", "nom.toml", "line 5, nominal_model: failed to read"),
        ("objects/ball.toml", "ball.toml", "line 6, objects: failed to read \"ball.toml\""),
        (
            "objects/ramp.toml",
            "objects/ball.toml",
            "line 6, objects: \"objects/ball.toml\" holds an object called \"ball\"",
        ),
        ("joint_rate_hz = 20.0", "joint_rate_hz = 0.0", "line 7, joint_rate_hz: joint_rate_hz is 0"),
        ("joint_rate_hz = 20.0", "joint_rate_hz = nan", "line 7, joint_rate_hz"),
        (
            "[\"turn\", \"lift\"]",
            "[\"turn\", \"turn\"]",
            "line 8, joint \"turn\": this joint is listed twice",
        ),
        ("[\"turn\", \"lift\"]", "[]", "line 8, joints: no joints"),
        ("[\"turn\", \"lift\"]", "[\"turn\", \"lift\", \"tilt\"]", "tilt"),
        ("[\"turn\", \"lift\"]", "[\"lift\"]", "turn"),
        (
            "carrier_joints = [\"lift\"]",
            "carrier_joints = [\"tilt\"]",
            "line 9, joint \"tilt\": carrier_joints names a joint",
        ),
        ("carrier_joints = [\"lift\"]", "carrier_joints = [\"lift\", \"lift\"]", "names this joint twice"),
        (
            "stream = \"film\"",
            "stream = \"foil\"",
            "line 11, stream \"foil\": pad.toml has no such stream, expected one of \"film\"",
        ),
        ("on_threshold = 30.0", "on_threshold = nan", "line 11, stream \"film\": on_threshold is NaN"),
        ("on_threshold = 30.0", "on_threshold = 10.0", "off_threshold 20 is above on_threshold 10"),
        ("on_threshold = 30.0", "on_threshold = 5000.0", "cannot be reached"),
        ("raw_max = 1023.0", "raw_max = 0.0", "raw_min 0 is not below raw_max 0"),
    ] {
        let error = read_with("bench.toml", from, to).expect_err(to).to_string();
        assert!(error.contains(expected), "{to}: {error}");
    }
}

#[test]
fn a_stream_needs_exactly_one_entry() {
    let (head, entry) = STATION.split_at(STATION.find("[[stream]]").unwrap());
    let error = read_with("bench.toml", entry, "").unwrap_err().to_string();
    assert!(error.contains("stream \"film\": no [[stream]] entry for this stream of pad.toml"), "{error}");
    let error = read_with("bench.toml", head, &format!("{head}{entry}")).unwrap_err().to_string();
    assert!(error.contains("two [[stream]] entries"), "{error}");
}

#[test]
fn faults_of_the_files_it_names_name_those_files() {
    for (path, from, to, expected) in [
        ("robots/slide.urdf", "<link name=\"tip\"/>", "", "robots/slide.urdf"),
        (
            "pad.toml",
            "link = \"tip\"",
            "link = \"thumb\"",
            "pad.toml: line 8, patch \"tip\": unknown link \"thumb\"",
        ),
        ("objects/ball.toml", "0.02", "-1", "objects/ball.toml: line 3"),
        (
            "objects/meshes/tetra.obj",
            "f 1 3 2\n",
            "",
            "objects/ramp.toml: line 3, object \"ramp\": mesh \"meshes/tetra.obj\"",
        ),
        ("objects/ramp.toml", "tetra.obj", "cube.obj", "failed to read \"objects/meshes/cube.obj\""),
    ] {
        let error = read_with(path, from, to).expect_err(to).to_string();
        assert!(error.contains(expected), "{to}: {error}");
    }
    let error = Station::read("bench.toml", |_| Err("permission denied".to_owned())).unwrap_err().to_string();
    assert_eq!(error, "bench.toml: whole file: failed to read the station file: permission denied");
    let error = Station::read("bench.toml", |_| Ok(b"id = \"a\"\n\xff".to_vec())).unwrap_err().to_string();
    assert!(error.starts_with("bench.toml: line 2: not UTF-8"), "{error}");
}
