//! The task as something to learn.

use palpate_grasp::learn::LearnConfig;

use super::{station, text};

const LEARNING: &str = "grasp/xarm6_leap_learning.toml";

fn learning() -> LearnConfig {
    LearnConfig::from_toml(LEARNING, &text(LEARNING), &station().robot).unwrap_or_else(|err| panic!("{err}"))
}

#[test]
fn what_is_wrong_with_a_learning_file_is_named() {
    assert!(learning().reward.success > 0.0);
    for (from, to, expected) in [
        ("\"thumb_distal\"", "\"thumb_tipp\"", "opposing_link names link \"thumb_tipp\""),
        ("arm_reach_m = [0.03, 0.03, 0.02]", "arm_reach_m = [0.03, -0.03, 0.02]", "arm_reach_m is -0.03"),
        ("touch_memory = 0.9", "touch_memory = 1.9", "observation.touch_memory is 1.9, expected 0 to 1"),
        ("scale = 0.1", "scale = 0.0", "reward.scale is 0"),
        ("half_width_m = [0.03, 0.05]", "half_width_m = [0.05, 0.02]", "expected the smaller one first"),
        ("window = 64", "window = 0", "start.window is 0"),
        ("probability = 0.01", "probability = nan", "push.probability is NaN"),
        ("grasp = 0.15", "grsap = 0.15", "unknown field `grsap`"),
    ] {
        let shipped = text(LEARNING);
        assert!(shipped.contains(from), "{from:?} is not in the file");
        let message = LearnConfig::from_toml("l.toml", &shipped.replacen(from, to, 1), &station().robot)
            .expect_err(to)
            .to_string();
        assert!(message.starts_with("l.toml: ") && message.contains(expected), "{to}: {message}");
    }
}

#[cfg(feature = "mujoco")]
mod episodes {
    use std::sync::Arc;

    use nalgebra::Translation3;
    use palpate_grasp::learn::{Curriculum, LearnBatch, LearnStep, LearnTask, REWARD_TERMS, Segment};
    use palpate_grasp::trial::{self, Outcome};
    use palpate_grasp::{GraspError, GraspScene, Script, Start};
    use palpate_sim::SensorModel;

    use super::super::{config, object};
    use super::*;

    /// The cube and the shipped closing script, the learning file changed by `change`.
    fn task(with_script: bool, change: impl Fn(&mut LearnConfig)) -> Arc<LearnTask> {
        let station = station();
        let config = config(&station);
        let file = "grasp/scripts/xarm6_leap_cube.toml";
        let script = Script::from_toml(file, &text(file), &station.robot, &config).expect("a script");
        let model = SensorModel::from_toml("nominal.toml", &station.nominal_model_toml).expect("a model");
        let scene = GraspScene::new(station, config, &object("cube"), &model).expect("a scene");
        let mut learning = learning();
        change(&mut learning);
        Arc::new(LearnTask::new(Arc::new(scene), with_script.then_some(script), learning).expect("a task"))
    }

    /// Without what is random.
    fn quiet(config: &mut LearnConfig) {
        config.observation.position_noise = 0.0;
        config.push.probability = 0.0;
        config.start.any_orientation = false;
    }

    /// Actions of some strength that differ everywhere.
    fn actions(batch: &LearnBatch, step: usize, strength: f32) -> Vec<f32> {
        let count = batch.num_envs() * batch.action_dim();
        (0..count).map(|idx| strength * ((idx * 7 + step * 13) as f32).sin()).collect()
    }

    fn segment<'a>(segments: &'a [Segment], name: &str) -> &'a Segment {
        segments.iter().find(|segment| segment.name == name).unwrap_or_else(|| panic!("no {name}"))
    }

    fn a_second_of_five(task: &Arc<LearnTask>, num_threads: usize, seed: u64, round: u32) -> Vec<LearnStep> {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(num_threads).build().expect("threads");
        pool.install(|| {
            let mut batch = LearnBatch::new(Arc::clone(task), 5, seed).expect("environments");
            let mut told = vec![batch.reset(round).expect("starts")];
            for step in 0..20 {
                let actions = actions(&batch, step, 1.5);
                told.push(batch.step(&actions).expect("a step"));
            }
            told
        })
    }

    #[test]
    fn a_batch_has_the_same_bits_for_any_number_of_threads() {
        let task = task(true, |_| ());
        let one = a_second_of_five(&task, 1, 3, 0);
        assert_eq!(a_second_of_five(&task, 3, 3, 0), one);
        assert_ne!(a_second_of_five(&task, 2, 4, 0), one, "another seed");
        assert_ne!(a_second_of_five(&task, 2, 3, 1), one, "another round");
    }

    #[test]
    fn a_round_does_not_depend_on_what_was_before_it() {
        let task = task(true, |_| ());
        let mut batch = LearnBatch::new(Arc::clone(&task), 2, 3).expect("environments");
        let fresh = batch.reset(4).expect("starts");
        for step in 0..3 {
            batch.step(&actions(&batch, step, 1.0)).expect("a step");
        }
        assert_eq!(batch.reset(4).expect("starts"), fresh);
    }

    #[test]
    fn layouts_cover_every_number_once_and_sizes_are_the_stations() {
        let task = task(true, |_| ());
        let (layout, station) = (task.layout(), task.scene().station());
        let mut next = 0;
        for segment in layout.actor.iter().chain(&layout.privileged) {
            assert_eq!(segment.range, next..next + segment.entries.len(), "{}", segment.name);
            next = segment.range.end;
        }
        assert_eq!(next, layout.critic_dim());
        let (num_dofs, num_channels) = (station.robot.num_dofs(), station.layout.num_channels());
        let num_hand = task.scene().dofs_in_hand().iter().filter(|in_hand| **in_hand).count();
        assert_eq!(layout.action_dim(), num_hand + 4);
        assert_eq!(layout.actor_dim(), 3 * num_dofs + 2 * num_channels + layout.action_dim() + 1);
        let env =
            LearnBatch::new(Arc::clone(&task), 1, 1).expect("an environment").reset(0).expect("a start");
        assert!(env.critic.iter().all(|value| value.is_finite()));
        assert_eq!(env.critic[..layout.actor_dim()], env.actor);
    }

    #[test]
    fn the_actor_does_not_see_an_object_that_it_does_not_touch() {
        let task = task(true, |_| ());
        let mut batch = [0, 1].map(|_| LearnBatch::new(Arc::clone(&task), 1, 3).expect("an environment"));
        let begin = |batch: &mut LearnBatch, offset_m: f64| {
            let mut start = Start::nominal(task.scene());
            start.base_from_object = Translation3::new(offset_m, -offset_m, 0.0) * start.base_from_object;
            batch.begin(&[start]).expect("a start")
        };
        let [one, other] = &mut batch;
        let mut told = [begin(one, 0.0), begin(other, 0.02)];
        for step in 0..6 {
            assert_eq!(told[0].actor, told[1].actor, "step {step}");
            assert_ne!(told[0].critic, told[1].critic, "step {step}");
            let actions = actions(one, step, 1.0);
            told = [one.step(&actions).expect("a step"), other.step(&actions).expect("a step")];
        }
        // Nor how heavy it is, nor how fast it falls.
        let mut start = Start::nominal(task.scene());
        start.randomisation.object_mass_factor = 1.2;
        start.base_from_object.translation.z += 0.005;
        let heavy = other.begin(&[start]).expect("a start");
        assert_eq!(heavy.actor, begin(one, 0.0).actor);
    }

    #[test]
    fn terms_sum_to_the_reward_and_over_an_episode_to_its_sums() {
        let task = task(true, |_| ());
        let mut batch = LearnBatch::new(Arc::clone(&task), 3, 8).expect("environments");
        batch.reset(0).expect("starts");
        let mut sums = vec![vec![0.0_f64; REWARD_TERMS.len()]; 3];
        let mut num_ended = 0;
        for step in 0..210 {
            let told = batch.step(&actions(&batch, step, 0.2)).expect("a step");
            for (idx, terms) in told.terms.chunks(REWARD_TERMS.len()).enumerate() {
                assert_eq!(told.rewards[idx], terms.iter().sum::<f32>());
                sums[idx].iter_mut().zip(terms).for_each(|(sum, term)| *sum += f64::from(*term));
                let Some(ending) = &told.endings[idx] else { continue };
                for ((sum, expected), name) in sums[idx].iter().zip(&ending.term_sums).zip(REWARD_TERMS) {
                    assert!((sum - expected).abs() < 1e-4, "{name}: {sum} and {expected}");
                }
                let won = ending.outcome == Outcome::Success;
                let success = REWARD_TERMS.iter().position(|term| *term == "success").expect("a term");
                assert_eq!(ending.term_sums[success] > 0.0, won);
                assert_eq!(ending.truncated, ending.num_steps == 200 && !won);
                assert_eq!(ending.final_critic.len(), batch.critic_dim());
                sums[idx].fill(0.0);
                num_ended += 1;
            }
        }
        assert!(num_ended >= 3, "{num_ended} episodes ended");
    }

    #[test]
    fn without_actions_the_script_runs_as_in_a_trial() {
        let task = task(true, quiet);
        let mut batch = LearnBatch::new(Arc::clone(&task), 3, 1).expect("environments");
        let half_width_m = task.scene().config().task.half_width_m;
        batch.set_curriculum(Curriculum { half_width_m, episodes: 0, successes: 0 });
        batch.reset(0).expect("starts");
        let script = text("grasp/scripts/xarm6_leap_cube.toml");
        let robot = &task.scene().station().robot;
        let script = Script::from_toml("s.toml", &script, robot, task.scene().config()).expect("a script");
        let wanted = trial::run_all(task.scene(), &script, 1, 3).expect("trials");
        let mut outcomes = [None; 3];
        let still = vec![0.0; 3 * batch.action_dim()];
        for _ in 0..200 {
            let told = batch.step(&still).expect("a step");
            for (outcome, ending) in outcomes.iter_mut().zip(told.endings) {
                *outcome = outcome.or(ending.map(|ending| ending.outcome));
            }
        }
        assert_eq!(outcomes.to_vec(), wanted.into_iter().map(Some).collect::<Vec<_>>());
    }

    #[test]
    fn actions_move_the_hand_by_their_bounds_and_no_further() {
        let task = task(false, quiet);
        let bounds = *task.bounds();
        let mut batch = LearnBatch::new(Arc::clone(&task), 1, 1).expect("an environment");
        let robot = &task.scene().station().robot;
        let palm = robot.link_index("palm").expect("a palm");
        let commands = segment(&task.layout().actor, "commands").range.clone();
        let palm_at = |told: &LearnStep| {
            let targets: Vec<f64> =
                told.actor[commands.clone()].iter().map(|&value| f64::from(value)).collect();
            let mut frames = Vec::new();
            robot.forward_kinematics(&targets, &mut frames);
            (frames[palm], targets)
        };
        let begun = palm_at(&batch.begin(&[Start::nominal(task.scene())]).expect("a start"));
        let named = |name: &str| {
            let at = task.layout().action.iter().position(|action| action == name).expect("an action");
            (0..batch.action_dim()).map(|idx| if idx == at { 3.0 } else { 0.0 }).collect::<Vec<f32>>()
        };
        let (up, left) = (named("hand z"), named("hand y"));
        let bend = named("index_pip");
        // Three counts as one.
        let raised = palm_at(&batch.step(&up).expect("a step"));
        let moved = raised.0.translation.vector - begun.0.translation.vector;
        assert!((moved.z - bounds.arm_step_m).abs() < 1e-4 && moved.xy().norm() < 1e-4, "{moved}");
        assert!(raised.0.rotation.angle_to(&begun.0.rotation) < 2e-3);
        let index_pip = robot.dofs().position(|joint| joint.name == "index_pip").expect("a joint");
        let bent = palm_at(&batch.step(&bend).expect("a step"));
        assert!((bent.1[index_pip] - begun.1[index_pip] - bounds.hand_step_rad).abs() < 1e-6);
        let mut far = bent;
        for _ in 0..40 {
            far = palm_at(&batch.step(&left).expect("a step"));
        }
        let moved = far.0.translation.vector - begun.0.translation.vector;
        assert!((moved.y - bounds.arm_reach_m[1]).abs() < 1e-3, "{moved}");
    }

    #[test]
    fn objects_start_on_any_side_and_at_rest() {
        let task = task(true, |config| config.push.probability = 0.0);
        let mut batch = LearnBatch::new(Arc::clone(&task), 8, 5).expect("environments");
        let mut told = batch.reset(0).expect("starts");
        let (critic_dim, still) = (batch.critic_dim(), vec![0.0; 8 * batch.action_dim()]);
        let layout = task.layout().clone();
        let of = |told: &LearnStep, env: usize, name: &str| {
            let range = segment(&layout.privileged, name).range.clone();
            told.critic[env * critic_dim..][range].to_vec()
        };
        let first: Vec<_> = (0..8).map(|env| of(&told, env, "object_rotation")).collect();
        // The largest part of the first axis says which way it points: up or to a side.
        let up = first.iter().filter(|axes| axes[2].abs() > 0.9).count();
        assert!(up > 0 && up < 8, "{first:?}");
        for _ in 0..4 {
            told = batch.step(&still).expect("a step");
        }
        for (env, first) in first.iter().enumerate() {
            let turned = of(&told, env, "object_rotation")
                .iter()
                .zip(first)
                .map(|(now, then)| now - then)
                .fold(0.0, |most: f32, by| most.max(by.abs()));
            assert!(turned < 0.02, "environment {env} turned by {turned}");
            assert!(of(&told, env, "object_lift")[0].abs() < 1e-3);
        }
    }

    #[test]
    fn a_push_moves_the_object_and_the_critic_is_told() {
        let task = task(true, |config| {
            quiet(config);
            config.push.probability = 1.0;
            config.push.force_n = 3.0;
        });
        let mut batch = LearnBatch::new(Arc::clone(&task), 2, 5).expect("environments");
        batch.reset(0).expect("starts");
        let told = batch.step(&vec![0.0; 2 * batch.action_dim()]).expect("a step");
        let critic = &told.critic[..batch.critic_dim()];
        let read = |name: &str| &critic[segment(&task.layout().privileged, name).range.clone()];
        assert!(read("push").iter().all(|force_n| *force_n != 0.0 && force_n.abs() <= 3.0));
        assert!(
            read("object_velocity").iter().any(|speed| speed.abs() > 1e-3),
            "{:?}",
            read("object_velocity")
        );
        // Calm again when an episode begins.
        let told = batch.reset(1).expect("starts");
        assert_eq!(told.critic[segment(&task.layout().privileged, "push").range.clone()], [0.0; 3]);
    }

    #[test]
    fn an_action_that_is_not_finite_is_named() {
        let task = task(true, |_| ());
        let mut batch = LearnBatch::new(Arc::clone(&task), 2, 1).expect("environments");
        batch.reset(0).expect("starts");
        let mut actions = vec![0.0; 2 * batch.action_dim()];
        actions[batch.action_dim() + 1] = f32::NAN;
        let refused = batch.step(&actions).expect_err("must be refused");
        let name = task.layout().action[1].clone();
        assert!(
            matches!(&refused, GraspError::Action { env: 1, name: named, .. } if *named == name),
            "{refused}"
        );
    }
}
