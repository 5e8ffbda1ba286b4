//! Scripts made better by trial.

use palpate_grasp::tune::TuningConfig;
use palpate_grasp::{GraspConfig, Script};
use palpate_robot_model::Station;

use super::{config, station, text};

const TUNING: &str = "grasp/xarm6_leap_tuning.toml";
const SCRIPT: &str = "grasp/scripts/xarm6_leap_cube.toml";

fn script(station: &Station, config: &GraspConfig) -> Script {
    Script::from_toml(SCRIPT, &text(SCRIPT), &station.robot, config).expect("a script")
}

/// `script` with the parameter `name` of `tuning` at `value`, and all others at 0.
fn with_one(tuning: &TuningConfig, name: &str, value: f64, script: &Script, station: &Station) -> Script {
    let values: Vec<f64> =
        tuning.parameters.iter().map(|p| if p.name == name { value } else { 0.0 }).collect();
    assert!(values.contains(&value), "no parameter {name}");
    tuning.apply(&values, script, &station.robot, &config(station)).expect("within reach")
}

#[test]
fn what_is_wrong_with_a_tuning_file_is_named() {
    let station = station();
    let (robot, script) = (&station.robot, script(&station, &config(&station)));
    for (from, to, expected) in [
        ("spread = 0.012", "spread = -0.012", "parameter \"forward\": spread is -0.012"),
        ("spread = 0.012", "spread = 0.0", "parameter \"forward\": spread is 0"),
        ("keys = [2, 6]", "keys = [2, 7]", "keys holds 7, expected 1 to 6"),
        ("keys = [2, 6]", "keys = [0]", "keys holds 0"),
        ("keys = [2, 6]", "keys = []", "keys is empty"),
        ("index_pip = 1.0", "index_pop = 1.0", "there is no joint \"index_pop\""),
        ("index_pip = 1.0", "index_pip = nan", "the factor of joint \"index_pip\" is NaN"),
        ("\"hand_x\"", "\"joints\"", "joints belong to acts_on = \"joints\""),
        ("\"hand_x\"", "\"hand_w\"", "unknown variant `hand_w`"),
        ("lift = 0.3", "lift = -0.3", "score.lift is -0.3"),
        ("keys = [2, 6]", "keys = [2, 6]\nagain = [1]", "again has no place beside what it acts on"),
        ("\"hand_x\"", "\"unfelt_x\"", "again is empty, expected some numbers from 1 to 0"),
    ] {
        let shipped = text(TUNING);
        assert!(shipped.contains(from), "{from:?} is not in the file");
        let message = TuningConfig::from_toml("t.toml", &shipped.replacen(from, to, 1), robot, &script)
            .expect_err(to)
            .to_string();
        assert!(message.starts_with("t.toml: ") && message.contains(expected), "{to}: {message}");
    }
}

#[test]
fn a_search_gives_a_script_another_try_and_changes_what_it_names() {
    const TUNING: &str = "grasp/xarm6_leap_tuning_again.toml";
    let station = station();
    let (robot, config) = (&station.robot, config(&station));
    let script = script(&station, &config);
    let tuning = TuningConfig::from_toml(TUNING, &text(TUNING), robot, &script).expect("a tuning file");
    let with = |name: &str, value: f64| with_one(&tuning, name, value, &script, &station);
    let given = with("time to close", 0.0);
    assert_eq!((given.keys(), given.again()), (script.keys(), tuning.again.as_slice()));
    let mut expected = tuning.again.clone();
    expected[0].unfelt_m[1] += 0.01;
    let moved = with("left when nothing was felt", 0.01);
    assert!((moved.again()[0].unfelt_m[1] - expected[0].unfelt_m[1]).abs() < 1e-9);
    expected[0].unfelt_m[1] = moved.again()[0].unfelt_m[1];
    assert_eq!(moved.again(), expected);
    // Counts are whole, and not negative.
    for (value, channels) in [(0.4, 1), (0.6, 2), (-0.6, 0), (-3.0, 0)] {
        assert_eq!(with("channels that are enough", value).again()[0].channels, channels, "{value}");
    }
    // A script that tries again already goes on from its own tries.
    let again = TuningConfig::from_toml(TUNING, &text(TUNING), robot, &moved).expect("a tuning file");
    let unchanged = again.apply(&vec![0.0; again.parameters.len()], &moved, robot, &config);
    assert_eq!(unchanged, Some(moved));
}

#[test]
fn a_parameter_changes_what_it_names_and_nothing_else() {
    let station = station();
    let (robot, config) = (&station.robot, config(&station));
    let script = script(&station, &config);
    let tuning = TuningConfig::from_toml(TUNING, &text(TUNING), robot, &script).expect("a tuning file");
    let with = |name: &str, value: f64| with_one(&tuning, name, value, &script, &station);
    let palm = robot.link_index("palm").expect("a palm");
    let palm_at = |script: &Script, key: usize| {
        let mut frames = Vec::new();
        robot.forward_kinematics(script.targets_at_key(key), &mut frames);
        frames[palm]
    };
    let unchanged = with("height", 0.0);
    (0..6).for_each(|key| assert_eq!(unchanged.targets_at_key(key), script.targets_at_key(key)));
    let lower = with("height", -0.01);
    let moved = palm_at(&lower, 1).translation.vector - palm_at(&script, 1).translation.vector;
    assert!((moved.z + 0.01).abs() < 1e-3 && moved.xy().norm() < 1e-3, "{moved}");
    assert!((palm_at(&lower, 5).translation.z - palm_at(&script, 5).translation.z).abs() < 1e-12);
    let turned = palm_at(&with("yaw", 0.1), 1).rotation.angle_to(&palm_at(&script, 1).rotation);
    assert!((turned - 0.1).abs() < 2e-3, "{turned}");
    let slower = with("time to close", 2.0_f64.ln());
    let times: Vec<f64> = slower.keys().iter().map(|key| key.at_s).collect();
    assert_eq!(times, [0.6, 1.8, 2.0, 5.0, 5.5, 7.0]);
    // Joints stop at their limits, and what is written reads back the same.
    let far = with("fingers curl closed", 9.0);
    let read =
        Script::from_toml("far.toml", &far.to_toml().expect("text"), robot, &config).expect("a script");
    assert_eq!(read, far);
    // No arm reaches a metre further.
    let mut values = vec![0.0; tuning.parameters.len()];
    values[0] = 1.0;
    assert!(tuning.apply(&values, &script, robot, &config).is_none());
}

#[cfg(feature = "mujoco")]
mod search {
    use std::sync::{Arc, Mutex};

    use palpate_grasp::learn::{Conditions, LearnConfig, LearnEnv, LearnTask};
    use palpate_grasp::touch::NoTouch;
    use palpate_grasp::trial::{self, Outcome};
    use palpate_grasp::tune::{Generation, TuneParams, TuneReport, tune};
    use palpate_grasp::{GraspEnv, GraspScene, Start};
    use palpate_sim::SensorModel;
    use palpate_sim::job::{Cancel, NoProgress, Progress};

    use super::super::object;
    use super::*;

    const PARAMS: TuneParams =
        TuneParams { seed: 5, generations: 2, candidates: 6, elite: 2, trials: 2, check_trials: 3 };

    fn scene(id: &str) -> Arc<GraspScene> {
        let station = station();
        let model = SensorModel::from_toml("nominal.toml", &station.nominal_model_toml).expect("a model");
        let config = config(&station);
        Arc::new(GraspScene::new(station, config, &object(id), &model).expect("a scene"))
    }

    fn search(
        params: &TuneParams,
        num_threads: usize,
        progress: &dyn Progress,
        cancel: &Cancel,
    ) -> (Option<TuneReport>, Vec<Generation>) {
        let scene = scene("ball");
        let robot = &scene.station().robot;
        let script = script(scene.station(), scene.config());
        let tuning = TuningConfig::from_toml(TUNING, &text(TUNING), robot, &script).expect("a tuning file");
        let told = Mutex::new(Vec::new());
        let pool = rayon::ThreadPoolBuilder::new().num_threads(num_threads).build().expect("threads");
        let report = pool.install(|| {
            tune(&scene, &script, &tuning, params, progress, cancel, |generation, _| {
                told.lock().expect("a lock").push(generation.clone());
                Ok(())
            })
        });
        (report.expect("a search"), told.into_inner().expect("a lock"))
    }

    #[test]
    fn a_search_has_the_same_bits_for_any_number_of_threads() {
        let one = search(&PARAMS, 1, &NoProgress, &Cancel::default());
        assert_eq!(one.1.len(), 3);
        assert_eq!(one.0.as_ref().map(|report| &report.generations), Some(&one.1));
        assert_eq!(search(&PARAMS, 3, &NoProgress, &Cancel::default()), one);
        let other = TuneParams { seed: 6, ..PARAMS };
        assert_ne!(
            search(&other, 2, &NoProgress, &Cancel::default()).1,
            one.1,
            "another seed is another search"
        );
    }

    #[test]
    fn every_tuned_script_grasps_the_object_it_was_tuned_on() {
        for id in [
            "ball",
            "big_egg",
            "box",
            "cross",
            "cube",
            "cubeball",
            "egg",
            "h_shape",
            "hollow_cube",
            "hourglass",
        ] {
            let scene = scene(id);
            let file = format!("grasp/scripts/{id}.toml");
            let robot = &scene.station().robot;
            let script = Script::from_toml(&file, &text(&file), robot, scene.config()).expect("a script");
            let score = trial::Score::of(&trial::run_all(&scene, &script, 77, 8).expect("trials"));
            assert!(score.successes >= 6, "{id}: {score:?}");
        }
    }

    /// Cancels as soon as `at` trials are done.
    struct CancelAfter<'a>(f64, &'a Cancel);

    impl Progress for CancelAfter<'_> {
        fn report(&self, fraction: f64, _stage: &str) {
            if fraction >= self.0 {
                self.1.cancel();
            }
        }
    }

    #[test]
    fn a_search_that_is_stopped_keeps_what_it_found() {
        let cancel = Cancel::default();
        cancel.cancel();
        assert_eq!(search(&PARAMS, 2, &NoProgress, &cancel), (None, Vec::new()));
        // 33 trials in all: 3 for the script it begins with, 15 a generation.
        let whole = search(&PARAMS, 2, &NoProgress, &Cancel::default());
        let cancel = Cancel::default();
        let (report, told) = search(&PARAMS, 2, &CancelAfter(25.0 / 33.0, &cancel), &cancel);
        assert_eq!(told, whole.1[..2]);
        assert_eq!(report.expect("a script").generations, told);
    }

    #[test]
    fn a_script_that_tries_again_needs_its_touch_and_has_it_among_actions_too() {
        let file = "grasp/scripts/again/egg_diagnosed.toml";
        let felt = scene("egg");
        let (station, config) = (Arc::clone(felt.station()), felt.config().clone());
        let script = Script::from_toml(file, &text(file), &station.robot, &config).expect("a script");
        let outcomes = trial::run_all(&felt, &script, 77, 4).expect("trials");
        let numb = GraspScene::new(station, config, &object("egg"), &NoTouch).expect("a scene");
        let unfelt = trial::run_all(&Arc::new(numb), &script, 77, 4).expect("trials");
        let wins = |outcomes: &[Outcome]| outcomes.iter().filter(|&&one| one == Outcome::Success).count();
        assert!(wins(&outcomes) > wins(&unfelt), "{outcomes:?}, without touch {unfelt:?}");
        // Under a policy that does nothing, the same happens.
        let learning = "grasp/xarm6_leap_learning.toml";
        let learning = LearnConfig::from_toml(learning, &text(learning), &felt.station().robot);
        let task = LearnTask::new(felt, Some(script), learning.expect("a learning file")).expect("a task");
        let task = Arc::new(task);
        let mut env = LearnEnv::for_trials(Arc::clone(&task)).expect("an environment");
        let still = vec![0.0; task.layout().action_dim()];
        for (trial, expected) in outcomes.iter().enumerate() {
            env.begin_trial(77, trial as u64, Conditions::Evaluation).expect("a start");
            let outcome =
                std::iter::repeat_with(|| env.step(&still).expect("a step")).find_map(|outcome| outcome);
            assert_eq!(outcome, Some(*expected), "trial {trial}");
        }
    }

    #[test]
    fn a_trial_without_touch_ends_as_one_with_it() {
        let scene = scene("egg");
        let script = script(scene.station(), scene.config());
        let longest_s = scene.config().task.episode_s;
        for number in 0..2 {
            let report = trial::watch(&scene, &script, 3, number, longest_s).expect("a trial");
            let mut env = GraspEnv::new(Arc::clone(&scene), 3, number).expect("an environment");
            env.reset().expect("a start");
            let mut judge = trial::Judge::new(env.world(), longest_s);
            let outcome: Outcome = loop {
                env.step(&script.targets_at(env.time_s())).expect("a step");
                if let Some(outcome) = judge.look(scene.config(), env.world(), &env.world().contacts()) {
                    break outcome;
                }
            };
            assert_eq!((outcome, judge.lift_m(env.world())), (report.outcome, report.lift_m));
        }
    }

    #[test]
    fn a_ball_with_a_heavy_side_waits_where_it_was_put() {
        let scene = scene("ball");
        let mut start = Start::nominal(&scene);
        start.randomisation.object_com_offset_m = nalgebra::Vector3::new(0.005, 0.0, 0.0);
        let mut world = scene.world(&start).expect("a world");
        let begun = world.base_from_object();
        assert_eq!(begun.translation.x, start.base_from_object.translation.x);
        for _ in 0..40 {
            world.step().expect("a step");
        }
        let moved = (begun.inverse() * world.base_from_object()).translation.vector.norm();
        assert!(moved < 2e-3, "it rolled {moved} m in two seconds");
        // Without time to settle it rolls away.
        let mut restless = world;
        restless.reset(&start.positions, &start.base_from_object);
        for _ in 0..5 {
            restless.step().expect("a step");
        }
        let rolled =
            (start.base_from_object.inverse() * restless.base_from_object()).translation.vector.norm();
        assert!(rolled > 5e-3, "it rolled {rolled} m in a quarter of a second");
    }
}
