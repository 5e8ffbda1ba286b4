//! Laws of mechanics.

use mujoco_rs::prelude::{MjModel, MjtObjBase};
use nalgebra::{Isometry3, Vector3};
use palpate_grasp::{GraspConfig, PhysicsConfig, Randomisation, ServoConfig, World, scene};
use palpate_robot_model::Robot;
use palpate_sim::body::MassProperties;

use super::{config, object, station};

const GRAVITY: f64 = 9.81;
const HALF_EDGE_M: f64 = 0.03;

/// The shipped world with a cube in it, its text changed by `change`; start positions and the cube's mass.
fn cube_world(change: impl Fn(String) -> String) -> (World, Vec<f64>, f64) {
    let station = station();
    let config = config(&station);
    let cube = object("cube");
    let mass = MassProperties::of(&cube).expect("a density");
    let text = scene::mjcf(&station.robot, &config, &cube, &mass, &Randomisation::none()).expect("a scene");
    let world = World::new(&change(text), &station.robot, &config).expect("a world");
    (world, config.start_positions(&station.robot), mass.mass_kg)
}

/// Beside the robot, `height_m` above the table.
fn aside(height_m: f64) -> Isometry3<f64> {
    Isometry3::translation(0.5, 0.45, height_m)
}

#[test]
fn a_falling_body_follows_gravity_and_keeps_its_spin() {
    let (mut world, start, _) = cube_world(|text| text);
    world.reset(&start, &aside(1.5));
    let spin = Vector3::new(0.0, 0.0, 3.0);
    world.set_object_velocity(&Vector3::new(0.1, 0.0, 0.0), &spin);
    let (dt, num_steps) = (0.005, 80);
    for _ in 0..num_steps {
        world.step_physics();
    }
    let t = dt * f64::from(num_steps);
    let (linear, angular) = world.object_velocity();
    assert!((linear - Vector3::new(0.1, 0.0, -GRAVITY * t)).norm() < 1e-9, "{linear}");
    assert!((angular - spin).norm() < 1e-9, "{angular}");
    // Semi-implicit Euler is ahead of the parabola by half a step of speed.
    let height_m = world.base_from_object().translation.z;
    assert!((height_m - (1.5 - 0.5 * GRAVITY * t * (t + dt))).abs() < 1e-9, "{height_m}");
}

#[test]
fn a_pendulum_keeps_its_energy() {
    let urdf = r#"<robot name="pendulum"><link name="post"/><link name="bob">
        <inertial><origin xyz="0 0 -0.3"/><mass value="0.5"/>
        <inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>
        <joint name="swing" type="continuous"><parent link="post"/><child link="bob"/>
        <origin xyz="0 0 2"/><axis xyz="0 1 0"/></joint></robot>"#;
    let robot = Robot::from_urdf("pendulum.urdf", urdf, &[]).expect("a robot");
    let shipped = config(&station());
    let config = GraspConfig {
        hand_root: "post".to_owned(),
        mutual_contacts: Vec::new(),
        servos: vec![ServoConfig {
            joints: vec!["swing".to_owned()],
            stiffness_n_m_per_rad: 1e-12,
            damping_gain_n_m_s_per_rad: 0.0,
            max_torque_n_m: 1e-12,
            joint_damping_n_m_s_per_rad: 0.0,
            armature_kg_m2: 0.0,
            friction_loss_n_m: 0.0,
        }],
        start: [("swing".to_owned(), 1.2)].into(),
        physics: PhysicsConfig { timestep_s: 0.001, ..shipped.physics.clone() },
        ..shipped
    };
    let cube = object("cube");
    let mass = MassProperties::of(&cube).expect("a density");
    let text = scene::mjcf(&robot, &config, &cube, &mass, &Randomisation::none()).expect("a scene");
    let mut world = World::new(&text, &robot, &config).expect("a world");
    world.reset(&[1.2], &aside(HALF_EDGE_M));
    for _ in 0..500 {
        world.step_physics();
    }
    let before_j: f64 = world.energy_j().iter().sum();
    let (mut lowest_j, mut highest_j, mut fastest) = (before_j, before_j, 0.0_f64);
    let mut speed = [0.0];
    for _ in 0..20_000 {
        world.step_physics();
        let energy_j: f64 = world.energy_j().iter().sum();
        (lowest_j, highest_j) = (lowest_j.min(energy_j), highest_j.max(energy_j));
        world.velocities_into(&mut speed);
        fastest = fastest.max(speed[0].abs());
    }
    // The depth of the swing is what the energy is measured against.
    let swing_j = 0.5 * GRAVITY * 0.3 * (1.0 - 1.2_f64.cos());
    assert!((highest_j - lowest_j) / swing_j < 0.02, "{lowest_j} to {highest_j} J of {swing_j} J");
    let at_bottom = (2.0 * swing_j / (0.5 * 0.09 + 1e-4)).sqrt();
    assert!((fastest / at_bottom - 1.0).abs() < 0.01, "{fastest} of {at_bottom} rad/s");
}

#[test]
fn a_resting_cube_carries_its_weight_and_hardly_sinks_in() {
    let (mut world, start, mass_kg) = cube_world(|text| text);
    world.reset(&start, &aside(HALF_EDGE_M + 0.01));
    for _ in 0..600 {
        world.step_physics();
    }
    let contacts = world.contacts();
    assert!((contacts.object_table_n / (mass_kg * GRAVITY) - 1.0).abs() < 0.01, "{contacts:?}");
    assert_eq!(
        (contacts.robot_object_n, contacts.robot_table_n),
        (0.0, 0.0),
        "the open hand touches nothing"
    );
    assert!(contacts.deepest_m < 2e-4, "{contacts:?}");
    let (linear, angular) = world.object_velocity();
    assert!(linear.norm() < 1e-4 && angular.norm() < 1e-3, "{linear} {angular}");
    assert!((world.base_from_object().translation.z - HALF_EDGE_M).abs() < 2e-4);
}

/// How far a cube slides in a second on a table tilted by `angle_rad`, m.
fn slid_m(angle_rad: f64) -> f64 {
    let (sin, cos) = angle_rad.sin_cos();
    // A tilt of the table is one of gravity.
    let gravity = format!("<option gravity=\"0 {} {}\" ", GRAVITY * sin, -GRAVITY * cos);
    let (mut world, start, _) = cube_world(|text| text.replacen("<option ", &gravity, 1));
    world.reset(&start, &Isometry3::translation(0.75, -0.55, HALF_EDGE_M - 2e-5));
    for _ in 0..200 {
        world.step_physics();
    }
    world.base_from_object().translation.y + 0.55
}

#[test]
fn a_block_slides_where_the_slope_is_steeper_than_its_friction() {
    let friction: f64 = 0.5;
    let cone_rad = friction.atan();
    let stuck_m = slid_m(cone_rad - 0.035);
    assert!(stuck_m < 0.002, "two degrees below the cone it slid {stuck_m} m");
    for steeper_rad in [0.035, 0.1] {
        let angle = cone_rad + steeper_rad;
        let expected_m = 0.5 * GRAVITY * (angle.sin() - friction * angle.cos());
        let slid_m = slid_m(angle);
        assert!((slid_m / expected_m - 1.0).abs() < 0.05, "{slid_m} m of {expected_m} m");
    }
}

#[test]
fn a_scene_begins_where_its_key_frame_says() {
    let station = station();
    let config = config(&station);
    let cube = object("cube");
    let mass = MassProperties::of(&cube).expect("a density");
    let text = scene::mjcf(&station.robot, &config, &cube, &mass, &Randomisation::none()).expect("a scene");
    // Every joint stands elsewhere.
    let positions: Vec<f64> = (0..station.robot.num_dofs()).map(|dof| 0.01 * (dof as f64 + 1.0)).collect();
    let pose = aside(0.3);
    let model = MjModel::from_xml_string(&scene::with_start(&text, &station.robot, &positions, &pose))
        .expect("MuJoCo loads it");
    assert_eq!((model.nkey(), model.name_to_id(MjtObjBase::mjOBJ_KEY, "start")), (1, Some(0)));
    let qpos = model.key_qpos();
    let address = |name: &str| {
        let joint = model.name_to_id(MjtObjBase::mjOBJ_JOINT, name).expect("a joint");
        model.jnt_qposadr()[joint] as usize
    };
    for (joint, position) in station.robot.dofs().zip(&positions) {
        assert_eq!(qpos[address(&joint.name)], *position, "{}", joint.name);
    }
    let at = address(scene::OBJECT);
    assert_eq!(qpos[at..at + 7], [0.5, 0.45, 0.3, 1.0, 0.0, 0.0, 0.0]);
}
