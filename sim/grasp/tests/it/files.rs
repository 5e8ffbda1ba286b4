//! What people write, and the scene that is made of it.

use palpate_grasp::{GraspConfig, Randomisation, scene};
use palpate_robot_model::Mimic;
use palpate_sim::body::MassProperties;

use super::{WORLD, config, object, station, text};

/// What the shipped file says after replacing `from`, which must occur, by `to`.
fn refusal(from: &str, to: &str) -> String {
    let text = text(WORLD);
    assert!(text.contains(from), "{from:?} is not in the file");
    GraspConfig::from_toml("world.toml", &text.replacen(from, to, 1), &station().robot)
        .expect_err("must be refused")
        .to_string()
}

#[test]
fn what_is_wrong_with_a_world_is_named() {
    for (from, to, expected) in [
        ("hand_root = \"palm\"", "hand_root = \"plam\"", "hand_root names link \"plam\""),
        ("\"index_distal\"", "\"index_tipp\"", "mutual_contacts names link \"index_tipp\""),
        ("sliding = 0.8", "sliding = -0.8", "friction.link.sliding is -0.8"),
        ("timestep_s = 0.005", "timestep_s = 0.007", "expected a whole number"),
        ("timestep_s = 0.005", "timestep_s = nan", "physics.timestep_s is NaN"),
        ("iterations = 10", "iterations = 0", "physics.iterations is 0"),
        ("\"index_pip\", ", "", "joint \"index_pip\" is in 0 [[servo]] entries"),
        ("\"index_pip\", ", "\"index_pip\", \"joint1\", ", "joint \"joint1\" is in 2 [[servo]] entries"),
        ("thumb_ip = 0.0", "", "start has no position for joint \"thumb_ip\""),
        ("thumb_ip = 0.0", "thumb_ip = 9.0", "start.thumb_ip is 9"),
        ("thumb_ip = 0.0", "thumb_tip = 0.0", "joint \"thumb_tip\" is none of the robot's"),
        ("object_mass_factor = [0.8, 1.2]", "object_mass_factor = [1.2, 0.8]", "object_mass_factor"),
        ("hold_s = 1.0", "hold_s = 1.0\nlfit_m = 1.0", "unknown field `lfit_m`"),
        ("half_width_m = 0.02", "half_width_m = -0.02", "task.half_width_m is -0.02"),
        ("settle_s = 2.0", "settle_s = -2.0", "task.settle_s is -2"),
    ] {
        let message = refusal(from, to);
        assert!(message.starts_with("world.toml: ") && message.contains(expected), "{to}: {message}");
    }
}

#[test]
fn a_joint_that_follows_another_is_refused_by_name() {
    let mut robot = station().robot.clone();
    let place = |name: &str| robot.joints.iter().position(|joint| joint.name == name).expect("a joint");
    let (followed, follower) = (place("index_pip"), place("index_dip"));
    robot.joints[follower].mimic = Some(Mimic { joint: followed, multiplier: 0.7, offset: 0.0 });
    let message =
        GraspConfig::from_toml("world.toml", &text(WORLD), &robot).expect_err("refused").to_string();
    let expected = "joint \"index_dip\" follows joint \"index_pip\" (mimic in the robot's file), and the grasp world moves every joint";
    assert!(message.starts_with("world.toml: ") && message.contains(expected), "{message}");
}

#[test]
fn the_shipped_ranges_are_those_of_the_paper() {
    // Table "Domain Randomization Parameters", and the text above it.
    let config = config(&station());
    let ranges = &config.randomisation;
    assert_eq!(ranges.fingertip_friction, [0.5, 1.0]);
    assert_eq!(ranges.object_mass_factor, [0.8, 1.2]);
    assert_eq!(ranges.object_com_offset_m, 0.005);
    assert_eq!(ranges.friction_loss_factor, [0.5, 2.0]);
    assert_eq!(ranges.stiffness_factor, [0.8, 1.2]);
    assert_eq!(ranges.joint_damping_factor, [0.8, 1.2]);
    assert_eq!(ranges.link_mass_factor, [0.9, 1.1]);
    assert_eq!(config.task.start_noise_rad, 0.05);
    // Evaluation: 4 x 4 cm, 10 s, 1.5 cm, 1 s.
    let task = &config.task;
    assert_eq!([task.half_width_m, task.episode_s, task.lift_m, task.hold_s], [0.02, 10.0, 0.015, 1.0]);
}

#[test]
fn a_scene_has_every_joint_and_what_cannot_be_grasped_is_refused() {
    let station = station();
    let config = config(&station);
    let cube = object("cube");
    let mass = MassProperties::of(&cube).expect("a density");
    let write = |object, randomisation: &Randomisation| {
        scene::mjcf(&station.robot, &config, object, &mass, randomisation)
    };
    let nominal = write(&cube, &Randomisation::none()).expect("a scene");
    for joint in station.robot.dofs() {
        assert!(
            nominal.contains(&format!("<position name=\"{0}\" joint=\"{0}\"", joint.name)),
            "{}",
            joint.name
        );
    }
    let mut heavy = Randomisation::none();
    heavy.object_mass_factor = 1.2;
    assert_ne!(write(&cube, &heavy).expect("a scene"), nominal);
    let mut mesh = cube.clone();
    mesh.shape = palpate_robot_model::ObjectShape::Mesh { vertices: Vec::new(), triangles: Vec::new() };
    let message = write(&mesh, &Randomisation::none()).expect_err("a mesh").to_string();
    assert!(message.contains("object \"cube\" cannot be grasped: a mesh has no convex parts"), "{message}");
}
