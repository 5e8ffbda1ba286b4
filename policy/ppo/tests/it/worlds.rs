//! Worlds whose answers are known.

use palpate_ppo::{Ending, EnvError, NetworksConfig, Observations, PpoConfig, StepResult, VectorEnv};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// What happens instead of a step that a test wants to go wrong.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Mishap {
    /// The process dies.
    Panic,
    /// The world says that it cannot go on.
    Fail,
    /// Environment 3 gives NaN as component 1 of the actor's observation.
    Nan,
    /// The world gives one row too few.
    Short,
}

/// Points in the plane that are to reach targets. An action is a velocity; an episode ends at the target, or truncated
/// after [`Reach::MAX_STEPS`].
///
/// Targets are near at first and farther with every success, which is what these worlds remember.
#[derive(Clone, Debug)]
pub(crate) struct Reach {
    pub(crate) points: Vec<Point>,
    pub(crate) round: u64,
    pub(crate) steps: u64,
    pub(crate) successes: u32,
    /// On every reward.
    pub(crate) reward_scale: f32,
    /// When, in steps since this world was made, and what goes wrong.
    pub(crate) mishap: Option<(u64, Mishap)>,
    /// Zeros at the end of the actor's observation.
    pub(crate) padding: usize,
    /// Name of the second term of the reward.
    pub(crate) second_term: &'static str,
}

#[derive(Clone, Debug, Default)]
pub(crate) struct Point {
    position: [f32; 2],
    target: [f32; 2],
    steps: u32,
    episode: u64,
}

impl Reach {
    pub(crate) const MAX_STEPS: u32 = 20;
    /// How near counts.
    const NEAR: f32 = 0.15;
    /// Way that an action of 1 makes in a step.
    const PACE: f32 = 0.15;

    pub(crate) fn new(num_envs: usize) -> Self {
        Self {
            points: vec![Point::default(); num_envs],
            round: 0,
            steps: 0,
            successes: 0,
            reward_scale: 1.0,
            mishap: None,
            padding: 0,
            second_term: "arrival",
        }
    }

    fn begin(&mut self, env: usize) {
        let point = &mut self.points[env];
        let seed = self.round * 1_000_003 + env as u64 * 10_007 + point.episode;
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let reach = (0.5 + 0.001 * self.successes as f32).min(1.0);
        let mut somewhere = || [rng.random_range(-reach..reach), rng.random_range(-reach..reach)];
        let (position, target) = (somewhere(), somewhere());
        *point = Point { position, target, steps: 0, episode: point.episode + 1 };
    }

    fn critic(point: &Point) -> [f32; 5] {
        let [x, y] = point.position;
        let [to_x, to_y] = point.target;
        [x, y, to_x, to_y, (Self::MAX_STEPS - point.steps) as f32]
    }

    fn observations(&self) -> Observations {
        let actor = |point: &Point| {
            let [x, y] = point.position;
            let seen = [x, y, point.target[0] - x, point.target[1] - y];
            seen.into_iter().chain(std::iter::repeat_n(0.0, self.padding))
        };
        Observations {
            actor: self.points.iter().flat_map(actor).collect(),
            critic: self.points.iter().flat_map(Self::critic).collect(),
        }
    }
}

impl VectorEnv for Reach {
    fn num_envs(&self) -> usize {
        self.points.len()
    }

    fn actor_dim(&self) -> usize {
        4 + self.padding
    }

    fn critic_dim(&self) -> usize {
        5
    }

    fn action_dim(&self) -> usize {
        2
    }

    fn reward_terms(&self) -> Vec<String> {
        ["distance", self.second_term].map(str::to_owned).to_vec()
    }

    fn reset(&mut self, round: u64) -> Result<Observations, EnvError> {
        self.round = round;
        for env in 0..self.points.len() {
            self.points[env].episode = 0;
            self.begin(env);
        }
        Ok(self.observations())
    }

    fn step(&mut self, actions: &[f32]) -> Result<StepResult, EnvError> {
        let mishap = self.mishap.filter(|(at, _)| *at == self.steps).map(|(_, mishap)| mishap);
        self.steps += 1;
        match mishap {
            Some(Mishap::Panic) => panic!("the process is killed"),
            Some(Mishap::Fail) => return Err("the table caught fire".into()),
            _ => {}
        }
        let mut result = StepResult::default();
        for (env, action) in actions.chunks_exact(2).enumerate() {
            let point = &mut self.points[env];
            for (position, velocity) in point.position.iter_mut().zip(action) {
                *position += Self::PACE * velocity.clamp(-1.0, 1.0);
            }
            point.steps += 1;
            let [dx, dy] = [0, 1].map(|axis| point.target[axis] - point.position[axis]);
            let distance = dx.hypot(dy);
            let arrived = distance < Self::NEAR;
            let terms = [-0.1 * distance, if arrived { 1.0 } else { 0.0 }];
            result.reward_terms.extend(terms.map(|term| term * self.reward_scale));
            let late = point.steps == Self::MAX_STEPS;
            let point = point.clone();
            self.successes += u32::from(arrived);
            result.endings.push(if arrived {
                Some(Ending::Terminated { success: true })
            } else if late {
                Some(Ending::Truncated { success: false, final_critic: Self::critic(&point).to_vec() })
            } else {
                None
            });
            if arrived || late {
                self.begin(env);
            }
        }
        result.observations = self.observations();
        match mishap {
            Some(Mishap::Nan) => result.observations.actor[3 * 4 + 1] = f32::NAN,
            Some(Mishap::Short) => drop(result.endings.pop()),
            _ => {}
        }
        Ok(result)
    }

    fn memory(&self) -> String {
        self.successes.to_string()
    }

    fn restore(&mut self, memory: &str) -> Result<(), EnvError> {
        self.successes = memory.parse()?;
        Ok(())
    }
}

/// Learns to reach within seconds.
pub(crate) fn small_config() -> PpoConfig {
    PpoConfig {
        seed: 5,
        total_steps: 60_000,
        num_envs: 16,
        unroll_length: 40,
        batch_size: 8,
        num_minibatches: 4,
        num_epochs: 4,
        learning_rate: 2e-3,
        discount: 0.95,
        critic_warmup_updates: 0,
        initial_std: 0.6,
        networks: NetworksConfig { actor: vec![32, 32], critic: vec![32, 32], ..NetworksConfig::default() },
        ..PpoConfig::default()
    }
}

/// Numbers that are to be repeated, in episodes of one step. Each episode also has its luck, which is added to the reward
/// whatever the action. Only the critic can know it.
#[derive(Clone, Debug)]
pub(crate) struct Repeat {
    rng: ChaCha8Rng,
    numbers: Vec<f32>,
    luck: Vec<f32>,
    /// Size of the luck.
    pub(crate) size: f32,
    /// Whether the critic is told.
    pub(crate) critic_knows: bool,
}

impl Repeat {
    pub(crate) fn new(num_envs: usize, size: f32, critic_knows: bool) -> Self {
        let rng = ChaCha8Rng::seed_from_u64(0);
        Self { rng, numbers: vec![0.0; num_envs], luck: vec![0.0; num_envs], size, critic_knows }
    }

    fn begin(&mut self) -> Observations {
        self.numbers.fill_with(|| self.rng.random_range(-1.0..1.0));
        self.luck.fill_with(|| if self.rng.random() { self.size } else { -self.size });
        let told = if self.critic_knows { 1.0 } else { 0.0 };
        let critic = self.numbers.iter().zip(&self.luck).flat_map(|(&number, luck)| [number, told * luck]);
        Observations { actor: self.numbers.clone(), critic: critic.collect() }
    }
}

impl VectorEnv for Repeat {
    fn num_envs(&self) -> usize {
        self.numbers.len()
    }

    fn actor_dim(&self) -> usize {
        1
    }

    fn critic_dim(&self) -> usize {
        2
    }

    fn action_dim(&self) -> usize {
        1
    }

    fn reward_terms(&self) -> Vec<String> {
        ["error", "luck"].map(str::to_owned).to_vec()
    }

    fn reset(&mut self, round: u64) -> Result<Observations, EnvError> {
        self.rng = ChaCha8Rng::seed_from_u64(round);
        Ok(self.begin())
    }

    fn step(&mut self, actions: &[f32]) -> Result<StepResult, EnvError> {
        let errors = self.numbers.iter().zip(actions).map(|(number, action)| number - action);
        let reward_terms = errors.clone().zip(&self.luck).flat_map(|(error, &luck)| [-error * error, luck]);
        let success = |error: f32| Some(Ending::Terminated { success: error.abs() < 0.2 });
        Ok(StepResult {
            reward_terms: reward_terms.collect(),
            endings: errors.map(success).collect(),
            observations: self.begin(),
        })
    }
}
