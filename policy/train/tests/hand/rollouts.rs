//! Observations and targets of a rollout beside those of training.

use std::collections::VecDeque;
use std::path::PathBuf;
use std::sync::Arc;

use palpate_grasp::learn::{ActorTask, Conditions, LearnConfig, LearnEnv, LearnTask};
use palpate_grasp::{GraspConfig, GraspScene, Script};
use palpate_ppo::Actor;
use palpate_robot_model::{ObjectModel, Station};
use palpate_rollout::policy::{LearnedPolicy, Policy as _, Seen};
use palpate_sim::SensorModel;
use serde_json::Value;

use super::{root, turn};

pub(crate) fn asset(path: &str) -> PathBuf {
    root().join("assets").join(path)
}

fn text(path: &str) -> String {
    std::fs::read_to_string(asset(path)).expect("a shipped file")
}

pub(crate) fn station() -> Arc<Station> {
    let folder = asset("stations");
    let read = |path: &str| std::fs::read(folder.join(path)).map_err(|err| err.to_string());
    Arc::new(Station::read("xarm6_leap.toml", read).expect("the shipped station"))
}

/// The cube's expert, and what it was trained for.
struct Cube {
    station: Arc<Station>,
    world: GraspConfig,
    script: Script,
    learning: LearnConfig,
    actor: Actor,
}

impl Cube {
    fn shipped() -> Self {
        let station = station();
        let robot = &station.robot;
        let world = GraspConfig::from_toml("world", &text("grasp/xarm6_leap.toml"), robot).expect("a world");
        let script =
            Script::from_toml("script", &text("grasp/scripts/cube.toml"), robot, &world).expect("a script");
        let learning = LearnConfig::from_toml("learning", &text("grasp/xarm6_leap_learning.toml"), robot);
        let file = asset("policies/cube.safetensors");
        let bytes = std::fs::read(&file).expect("a policy");
        let actor = Actor::from_bytes(&file, &bytes).expect("a policy");
        Self { world, script, learning: learning.expect("a learning file"), actor, station }
    }

    fn rolled_out(&self) -> LearnedPolicy {
        let (world, script) = (self.world.clone(), Some(self.script.clone()));
        let task = ActorTask::new(Arc::clone(&self.station), world, script, self.learning.clone());
        LearnedPolicy::new(task, self.actor.clone()).expect("it fits")
    }

    fn trained(&self) -> Arc<LearnTask> {
        let model = SensorModel::from_toml("nominal", &self.station.nominal_model_toml).expect("a model");
        let object =
            ObjectModel::from_toml("cube", &text("objects/cube.toml"), |_| Err("no mesh".to_owned()));
        let (station, world) = (Arc::clone(&self.station), self.world.clone());
        let scene = GraspScene::new(station, world, &object.expect("a cube"), &model).expect("a scene");
        let (script, learning) = (Some(self.script.clone()), self.learning.clone());
        Arc::new(LearnTask::new(Arc::new(scene), script, learning).expect("a task"))
    }
}

fn bits32(values: &[f32]) -> Vec<u32> {
    values.iter().map(|value| value.to_bits()).collect()
}

fn bits64(values: &[f64]) -> Vec<u64> {
    values.iter().map(|value| value.to_bits()).collect()
}

#[test]
fn a_rollout_sees_and_commands_the_bits_of_training() {
    let _turn = turn();
    let cube = Cube::shipped();
    let (mut rolled, task) = (cube.rolled_out(), cube.trained());
    let mut env = LearnEnv::for_trials(Arc::clone(&task)).expect("an environment");
    let (mut actor, mut critic) =
        (vec![0.0; task.layout().actor_dim()], vec![0.0; task.layout().critic_dim()]);
    let mut num_touched = 0;
    for trial in 0..2 {
        env.begin_trial(7, trial, Conditions::Evaluation).expect("a start");
        rolled.begin(env.grasp().targets());
        loop {
            env.observe(&mut actor, &mut critic);
            let active = env.grasp().readings().active.clone();
            num_touched += active.iter().filter(|&&active| active).count();
            let positions = env.read_positions().to_vec();
            let seen = VecDeque::from([Seen { time_s: env.grasp().time_s(), positions, active }]);
            let step = rolled.plan(&seen).expect("a plan").remove(0);
            assert_eq!(bits32(rolled.observation()), bits32(&actor), "what it sees");
            let action = cube.actor.actions(&actor).expect("an action");
            assert_eq!(bits32(&step.action), bits32(&action), "what it does");
            let outcome = env.step(&action).expect("a step");
            assert_eq!(bits64(&step.targets), bits64(env.grasp().targets()), "what it commands");
            if outcome.is_some() {
                break;
            }
        }
    }
    assert!(num_touched > 50, "touch is part of what was compared");
}

/// Replays the record of a rollout of the cube's expert: what was seen gives what was wanted, but for the last bit, which the
/// reader of JSON rounds. Gives the number of steps.
pub(crate) fn replay(record: &[Value]) -> usize {
    let mut rolled = Cube::shipped().rolled_out();
    let station = station();
    let numbers = |value: &Value| -> Vec<f64> {
        value.as_array().expect("numbers").iter().map(|value| value.as_f64().expect("a number")).collect()
    };
    rolled.begin(&numbers(&record[0]["trial"]["begins_at"]));
    let steps: Vec<&Value> = record.iter().filter(|line| line["kind"] == "step").collect();
    for line in &steps {
        let mut active = vec![false; station.layout.num_channels()];
        for channel in line["active"].as_array().expect("channels") {
            active[channel.as_u64().expect("a channel") as usize] = true;
        }
        let positions = numbers(&line["positions"]);
        let time_s = line["time_s"].as_f64().expect("a time");
        let step =
            rolled.plan(&VecDeque::from([Seen { time_s, positions, active }])).expect("a plan").remove(0);
        for (again, wanted) in step.targets.iter().zip(numbers(&line["wanted"])) {
            assert!((again - wanted).abs() < 1e-12, "{again} instead of {wanted} at {time_s} s");
        }
    }
    steps.len()
}
