//! The grasp world as a folder for other programs.

use std::path::Path;

use palpate_grasp::{GraspConfig, World};
use palpate_robot_model::Station;
use palpate_touch::{FixedBody, TouchScene};

use super::palpate_train;

fn text(path: &Path) -> String {
    std::fs::read_to_string(path).unwrap_or_else(|err| panic!("{}: {err}", path.display()))
}

#[test]
fn an_exported_scene_loads_in_mujoco_and_is_felt_with_what_lies_beside_it() {
    let folder = tempfile::tempdir().expect("a folder");
    let out = folder.path().join("cube");
    let name = out.to_str().expect("a path");
    let model = "assets/models/demo_diagnosed.toml";
    let output =
        palpate_train(&["export-mujoco", "--out", name, "--object", "cube", "--model", model, "--json"]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let report: serde_json::Value = serde_json::from_slice(&output.stdout).expect("a document");
    assert_eq!(report["object"], "cube");

    let station_file = out.join("station/stations/xarm6_leap.toml");
    let read =
        |path: &str| std::fs::read(station_file.with_file_name("").join(path)).map_err(|err| err.to_string());
    let station = Station::read("xarm6_leap.toml", read).expect("a station");
    let assets = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../assets");
    let world = text(&assets.join("grasp/xarm6_leap.toml"));
    let config = GraspConfig::from_toml("world", &world, &station.robot).expect("a world");
    let scene = text(&out.join("scene.xml"));
    World::new(&scene, &station.robot, &config).expect("MuJoCo loads the scene");

    let table = out.join("table.toml");
    let (readme, feel) = (text(&out.join("README.md")), text(&out.join("feel.py")));
    for (name, text) in [("README.md", &readme), ("feel.py", &feel)] {
        let filled = ["{station", "{object}", "{object_label}", "{model}", "{table_pose}", "{rate_hz}"];
        assert!(
            filled.iter().all(|place| !text.contains(place)),
            "{name} has a place that is not filled: {text}"
        );
    }
    assert!(readme.contains("station/stations/xarm6_leap.toml"), "{readme}");
    let pose = feel.lines().find_map(|line| line.trim().strip_prefix("fixed=[(HERE / \"table.toml\", "));
    let pose = pose.and_then(|rest| rest.strip_suffix(")],")).expect("the table's pose");
    let pose: Vec<f64> = serde_json::from_str(pose).expect("numbers");
    let top_m = config.table.top_m;
    assert!((pose[2] + 0.5 * config.table.size_m[2] - top_m).abs() < 1e-12);
    let fixed = FixedBody {
        object: table.to_str().expect("a path"),
        base_from_body: pose.try_into().expect("seven numbers"),
    };
    let path = |file: &Path| file.to_str().expect("a path").to_owned();
    let model = text(&out.join("model.toml"));
    let touch = TouchScene::open(
        &path(&station_file),
        Some(("model.toml", &model)),
        &path(&out.join("object.toml")),
        &[fixed],
    );
    let touch = touch.expect("a scene");
    assert_eq!((touch.object().id.as_str(), touch.fixed().len()), ("cube", 1));
    assert_eq!(touch.model().effects.len(), 6);

    let again = palpate_train(&["export-mujoco", "--out", name]);
    let said = String::from_utf8_lossy(&again.stderr);
    assert!(!again.status.success() && said.contains("which exists"), "{said}");
    let none = folder.path().join("none");
    let wrong =
        palpate_train(&["export-mujoco", "--out", none.to_str().expect("a path"), "--object", "cueb"]);
    let said = String::from_utf8_lossy(&wrong.stderr);
    assert!(!wrong.status.success() && said.contains("no file and no object") && !none.exists(), "{said}");
}
