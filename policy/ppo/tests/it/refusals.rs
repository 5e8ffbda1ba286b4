//! Worlds that do not fit or go wrong.

use palpate_ppo::{PpoConfig, PpoError, Trainer, VectorEnv};

use crate::worlds::{Mishap, Reach, small_config};

/// What the first updates of a world with a mishap at step 50 end with.
fn error(mishap: Mishap) -> PpoError {
    let mut env = Reach { mishap: Some((50, mishap)), ..Reach::new(16) };
    let mut trainer = Trainer::new(small_config(), &env).expect("a trainer");
    (0..3).find_map(|_| trainer.update(&mut env).err()).expect("a mishap")
}

#[test]
fn numbers_that_are_none_are_found_where_they_appear() {
    assert_eq!(
        error(Mishap::Nan).to_string(),
        "environment 3 gave NaN as actor observation 1 at step 51, expected finite numbers"
    );
}

#[test]
fn an_environment_that_fails_says_so_with_its_reason() {
    let err = error(Mishap::Fail);
    assert_eq!(err.to_string(), "environments failed at step 50");
    let reason = std::error::Error::source(&err).expect("a reason");
    assert_eq!(reason.to_string(), "the table caught fire");
}

#[test]
fn rows_that_are_missing_are_counted() {
    assert_eq!(
        error(Mishap::Short).to_string(),
        "the environments do not fit: 15 numbers as endings, expected 16 x 1"
    );
}

#[test]
fn a_configuration_for_other_environments_is_refused_before_anything_starts() {
    let err = Trainer::new(small_config(), &Reach::new(8)).expect_err("8 environments");
    assert_eq!(
        err.to_string(),
        "the environments do not fit: there are 8, the configuration's num_envs is 16"
    );
    let nonsense = PpoConfig { clip: f64::NAN, ..small_config() };
    let err = Trainer::new(nonsense, &Reach::new(16)).expect_err("no clip range");
    assert_eq!(err.to_string(), "configuration: clip is NaN, expected a number above 0 and below 1");
}

#[test]
fn a_training_that_runs_away_stops_with_parameters_that_are_numbers() {
    let mut env = Reach { reward_scale: f32::MAX, ..Reach::new(16) };
    env.restore("500").expect("targets far away");
    let mut trainer = Trainer::new(small_config(), &env).expect("a trainer");
    let err = trainer.update(&mut env).expect_err("returns beyond what fits into 32 bits");
    assert!(err.to_string().starts_with("the gradient of critic."), "{err}");
    let actions = trainer.actor().actions(&[0.1; 4]).expect("actions");
    assert!(actions.iter().all(|action| action.is_finite()));
}
