//! What can be wrong with a grasp world.

/// A grasp world that cannot be made, or that went wrong.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum GraspError {
    /// A file cannot be used.
    #[error("{file}: {problem}")]
    Config {
        /// Which file was being read.
        file: String,
        /// What is wrong, what was expected, and where.
        problem: String,
    },
    /// The scene cannot be made of robot and object.
    #[error("failed to make the scene: {0}")]
    Scene(String),
    /// MuJoCo refuses the scene.
    #[error("failed to load the scene into MuJoCo: {0}")]
    Physics(String),
    /// A position became NaN or infinite.
    #[error(
        "the simulation diverged at {time_s:.3} s: the position of {what} is not finite; a shorter physics.timestep_s or \
         weaker servos help"
    )]
    Diverged {
        /// Time in the episode, s.
        time_s: f64,
        /// Which joint, or the object.
        what: String,
    },
    /// An action is NaN or infinite.
    #[error("action {name:?} of environment {env} is {value}, expected a finite number")]
    Action {
        /// Number of the environment.
        env: usize,
        /// Which of its actions.
        name: String,
        /// What it is.
        value: f32,
    },
    /// A sense of touch that is no sensor model cannot be used.
    #[error("failed to feel: {0}")]
    Sense(String),
    /// Touch could not be computed.
    #[error(transparent)]
    Touch(#[from] palpate_sim::replay::ReplayError),
}
