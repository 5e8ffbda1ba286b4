//! What is learned, and what cannot be.

use palpate_ppo::{Actor, Ending, Metrics, PpoConfig, Trainer, VectorEnv};

use crate::worlds::{Reach, Repeat, small_config};

fn trained<E: VectorEnv>(config: PpoConfig, env: &mut E) -> (Trainer, Vec<Metrics>) {
    let mut trainer = Trainer::new(config, env).expect("a configuration that fits");
    let updates = trainer.config().num_updates();
    let metrics = (0..updates).map(|_| trainer.update(env).expect("an update")).collect();
    (trainer, metrics)
}

/// Share of 200 first episodes that reach their target without noise.
fn success_rate(actor: &Actor) -> f64 {
    let mut env = Reach::new(200);
    env.restore("500").expect("targets anywhere");
    let mut observations = env.reset(999).expect("a reset").actor;
    let mut verdicts = [None; 200];
    for _ in 0..Reach::MAX_STEPS {
        let step = env.step(&actor.actions(&observations).expect("actions")).expect("a step");
        for (verdict, ending) in verdicts.iter_mut().zip(&step.endings) {
            *verdict = verdict.or(ending.as_ref().map(Ending::success));
        }
        observations = step.observations.actor;
    }
    verdicts.iter().filter(|verdict| **verdict == Some(true)).count() as f64 / 200.0
}

#[test]
fn points_learn_to_reach_their_targets_from_nothing() {
    let mut env = Reach::new(16);
    let untrained = Trainer::new(small_config(), &env).expect("a trainer");
    assert!(success_rate(&untrained.actor()) < 0.2);

    let (trainer, metrics) = trained(small_config(), &mut env);
    let rate = success_rate(&trainer.actor());
    assert!(rate >= 0.97, "{rate}, {:#?}", metrics.last());
    let (first, last) = (&metrics[0], &metrics[metrics.len() - 1]);
    assert!(last.return_mean > first.return_mean);
    assert!(last.explained_variance > 0.5, "{last:#?}");
    assert!(metrics.iter().all(|update| (0.0..0.1).contains(&update.kl)), "{metrics:#?}");
    assert_eq!(last.steps, trainer.steps());
}

#[test]
fn without_a_learning_rate_nothing_is_learned() {
    let config = PpoConfig { learning_rate: 0.0, ..small_config() };
    let (trainer, metrics) = trained(config, &mut Reach::new(16));
    let rate = success_rate(&trainer.actor());
    assert!(rate < 0.2, "{rate}");
    assert!(metrics.iter().all(|update| update.kl < 1e-6 && update.clip_fraction == 0.0));
}

#[test]
fn while_the_critic_warms_up_it_alone_learns() {
    let config = PpoConfig { critic_warmup_updates: 3, ..small_config() };
    let (_, metrics) = trained(config, &mut Reach::new(16));
    assert!(metrics[..3].iter().all(|update| update.kl < 1e-6 && update.clip_fraction == 0.0));
    assert!(metrics[2].explained_variance > metrics[0].explained_variance + 0.1, "{metrics:#?}");
    assert!(metrics[3].kl > 1e-5, "{:#?}", metrics[3]);
}

#[test]
fn a_critic_that_knows_what_the_actor_cannot_see_learns_where_another_does_not() {
    let learn = |critic_knows| {
        let mut env = Repeat::new(16, 10.0, critic_knows);
        let (trainer, metrics) = trained(PpoConfig { total_steps: 40_000, ..small_config() }, &mut env);
        let numbers = [-0.9, -0.5, -0.1, 0.3, 0.7];
        let actions = trainer.actor().actions(&numbers).expect("actions");
        let worst =
            numbers.iter().zip(&actions).map(|(number, action)| (number - action).abs()).fold(0.0, f32::max);
        (worst, metrics[metrics.len() - 1].explained_variance)
    };
    let (told_error, told_explained) = learn(true);
    let (untold_error, untold_explained) = learn(false);
    assert!(told_explained > 0.99 && untold_explained < 0.1, "{told_explained} {untold_explained}");
    assert!(told_error < 0.1 && untold_error > 0.2, "{told_error} {untold_error}");
}

#[test]
fn terms_of_the_reward_are_told_by_name() {
    let mut env = Reach::new(16);
    let mut trainer = Trainer::new(small_config(), &env).expect("a trainer");
    let metrics = trainer.update(&mut env).expect("an update");
    let terms: Vec<&str> = metrics.reward_terms.keys().map(String::as_str).collect();
    assert_eq!(terms, ["arrival", "distance"]);
    // A tenth of distances within the square and its surroundings.
    assert!((-0.4..0.0).contains(&metrics.reward_terms["distance"]), "{metrics:?}");
    // Returns of whole episodes are sums of the same terms.
    let a_step: f64 = metrics.reward_terms.values().sum();
    let of_episodes =
        metrics.return_mean.expect("episodes ended") / metrics.length_mean.expect("episodes ended");
    assert!((a_step - of_episodes).abs() < 0.1, "{a_step} {of_episodes}");
}

#[test]
fn the_same_seed_gives_the_same_bits_on_one_thread_and_on_two() {
    // Minibatches of more than one chunk, or threads would have nothing to share.
    let config =
        PpoConfig { total_steps: 16 * 160 * 3, num_minibatches: 2, batch_size: 16, ..small_config() };
    assert!(config.horizon() * config.num_envs / config.num_minibatches > 2 * 256);
    let run = |threads: usize, seed: u64| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        pool.install(|| {
            let config = PpoConfig { seed, ..config.clone() };
            trained(config, &mut Reach::new(16)).0.to_checkpoint()
        })
    };
    let alone = run(1, 5);
    assert!(alone == run(2, 5), "two threads give other bits than one");
    assert!(alone == run(3, 5), "three threads give other bits than one");
    assert!(alone != run(1, 6), "the seed changes nothing");
}
