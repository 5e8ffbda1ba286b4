//! Measures the grasp world: bare physics, the same by MuJoCo's own `rollout`, and whole environment
//! steps and whole steps of the learning task, in turns.

use std::io::{BufRead as _, BufReader, Write as _};
use std::path::PathBuf;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::{Context as _, bail};
use palpate_grasp::learn::{LearnBatch, LearnConfig, LearnTask};
use palpate_grasp::{GraspBatch, GraspScene, Randomisation, Script, Start, World, scene};
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use rustix::time::{ClockId, clock_gettime};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::files::Sources;
use crate::{SceneArgs, files};

/// The peer's program: MuJoCo's Python bindings on the same scene, starts and controls.
const PEER: &str = include_str!("../../../tests/peers/mujoco_rollout.py");

#[derive(clap::Args)]
pub(crate) struct BenchArgs {
    #[command(flatten)]
    scene: SceneArgs,
    /// Environments
    #[arg(long, default_value_t = 16)]
    envs: usize,
    /// Simulated time of a round, s
    #[arg(long, default_value_t = 5.0)]
    span_s: f64,
    /// Rounds; the fastest counts
    #[arg(long, default_value_t = 5)]
    rounds: usize,
    /// Learning task, measured as an episode of it with actions
    #[arg(long, default_value = "assets/grasp/xarm6_leap_learning.toml")]
    learning: PathBuf,
    /// Python with the `mujoco` package to compare with; without it there is no comparison
    #[arg(long)]
    python: Option<PathBuf>,
}

/// Steps a second are physics steps of all environments together.
#[derive(Serialize)]
struct BenchReport {
    object: String,
    envs: usize,
    threads: usize,
    timestep_s: f64,
    physics_steps_per_round: usize,
    physics_steps_per_s: f64,
    rollout_steps_per_s: Option<f64>,
    env_steps_per_s: f64,
    control_steps_per_s: f64,
    /// Control steps of the learning task: actions, observations, rewards, and new episodes in worlds of their own.
    learning_steps_per_s: f64,
    /// Bare physics over MuJoCo's `rollout`, at least 0.95 wanted.
    physics_over_rollout: Option<f64>,
    /// Whole environment steps over bare physics, at least 0.6 wanted.
    env_over_physics: f64,
    /// The same two by processor time instead of time on the clock: what a busy machine leaves comparable.
    physics_over_rollout_cpu: Option<f64>,
    env_over_physics_cpu: f64,
    /// Largest distance between an object's end in our physics and in the peer's, m.
    peer_differs_m: Option<f64>,
}

/// What the peer is told, on one line.
#[derive(Serialize)]
struct PeerInputs<'a> {
    xml: String,
    threads: usize,
    joints: Vec<&'a str>,
    object: &'a str,
    /// Per environment, joint positions and the object's position and quaternion (scalar first).
    starts: Vec<(Vec<f64>, [f64; 7])>,
    /// Targets of each physics step.
    controls: Vec<Vec<f64>>,
}

/// What it answers to each round.
#[derive(Deserialize)]
struct PeerRound {
    seconds: f64,
    cpu_seconds: f64,
    /// Per environment, where the object ended.
    objects_m: Vec<[f64; 3]>,
}

pub(crate) fn run(args: &BenchArgs) -> anyhow::Result<()> {
    let (scene, script) = files::open(&args.scene, &Sources::default())?;
    let bench = Bench::new(scene, &script, args);
    let mut peer =
        args.python.as_ref().map(|python| Peer::start(python, PEER, &bench.peer_inputs()?)).transpose()?;
    let mut worlds = bench.worlds()?;
    let mut batch = GraspBatch::new(Arc::clone(&bench.scene), args.envs, 1)?;
    let mut learn = bench.learn(args, script)?;
    let num_learning_steps = bench.num_learning_steps();
    let mut fastest = [Spent::MAX; 4];
    let mut peer_differs_m = peer.is_some().then_some(0.0_f64);
    for _ in 0..args.rounds.max(1) {
        fastest[0].keep_least(bench.physics(&mut worlds)?);
        if let (Some(peer), Some(differs_m)) = (&mut peer, &mut peer_differs_m) {
            let round: PeerRound =
                peer.ask("round", "the Python package mujoco of the version linked here")?;
            fastest[1].keep_least(Spent { clock_s: round.seconds, cpu_s: round.cpu_seconds });
            for (world, theirs) in worlds.iter().zip(round.objects_m) {
                let ours = world.base_from_object().translation.vector;
                let apart_m = ours.iter().zip(theirs).map(|(ours, theirs)| (ours - theirs).abs());
                *differs_m = apart_m.fold(*differs_m, f64::max);
            }
        }
        fastest[2].keep_least(bench.env(&mut batch)?);
        fastest[3].keep_least(bench.learning(&mut learn)?);
    }
    let num_steps = bench.controls.len() * bench.scene.config().num_substeps() * args.envs;
    let per_s = fastest.map(|spent| num_steps as f64 / spent.clock_s);
    report(
        args.scene.json,
        &BenchReport {
            object: bench.scene.object().id.clone(),
            envs: args.envs,
            threads: rayon::current_num_threads(),
            timestep_s: bench.scene.config().physics.timestep_s,
            physics_steps_per_round: num_steps,
            physics_steps_per_s: per_s[0],
            rollout_steps_per_s: peer.as_ref().map(|_| per_s[1]),
            env_steps_per_s: per_s[2],
            control_steps_per_s: per_s[2] / bench.scene.config().num_substeps() as f64,
            learning_steps_per_s: (num_learning_steps * args.envs) as f64 / fastest[3].clock_s,
            physics_over_rollout: peer.as_ref().map(|_| per_s[0] / per_s[1]),
            env_over_physics: per_s[2] / per_s[0],
            physics_over_rollout_cpu: peer.as_ref().map(|_| fastest[1].cpu_s / fastest[0].cpu_s),
            env_over_physics_cpu: fastest[0].cpu_s / fastest[2].cpu_s,
            peer_differs_m,
        },
    )
}

fn report(json: bool, report: &BenchReport) -> anyhow::Result<()> {
    if json {
        println!("{}", serde_json::to_string_pretty(report)?);
        return Ok(());
    }
    println!(
        "{} environments on {} threads, physics step {} s",
        report.envs, report.threads, report.timestep_s
    );
    println!("bare physics       {:>9.0} steps/s", report.physics_steps_per_s);
    if let (Some(rollout), Some(ratio)) = (report.rollout_steps_per_s, report.physics_over_rollout) {
        println!("MuJoCo's rollout   {rollout:>9.0} steps/s; ours is {ratio:.2} of it");
    }
    if let Some(ratio) = report.physics_over_rollout_cpu {
        println!("                   by processor time ours is {ratio:.2} of it");
    }
    println!(
        "whole environment  {:>9.0} steps/s; {:.2} of bare physics; {:.0} control steps/s",
        report.env_steps_per_s, report.env_over_physics, report.control_steps_per_s
    );
    println!("                   by processor time {:.2} of bare physics", report.env_over_physics_cpu);
    println!(
        "learning task      {:>9.0} control steps/s, new episodes included",
        report.learning_steps_per_s
    );
    Ok(())
}

/// Time that a round took.
#[derive(Clone, Copy)]
struct Spent {
    /// On the clock, s.
    clock_s: f64,
    /// Of all processors, s.
    cpu_s: f64,
}

impl Spent {
    const MAX: Self = Self { clock_s: f64::INFINITY, cpu_s: f64::INFINITY };

    fn keep_least(&mut self, other: Self) {
        self.clock_s = self.clock_s.min(other.clock_s);
        self.cpu_s = self.cpu_s.min(other.cpu_s);
    }
}

struct Began {
    clock: Instant,
    cpu: Duration,
}

impl Began {
    fn now() -> Self {
        Self { clock: Instant::now(), cpu: cpu_time() }
    }

    fn spent(&self) -> Spent {
        let cpu = cpu_time().saturating_sub(self.cpu);
        Spent { clock_s: self.clock.elapsed().as_secs_f64(), cpu_s: cpu.as_secs_f64() }
    }
}

/// Processor time of this process so far, all threads together.
fn cpu_time() -> Duration {
    Duration::try_from(clock_gettime(ClockId::ProcessCPUTime)).unwrap_or_default()
}

struct Bench {
    scene: Arc<GraspScene>,
    /// Objects here and there; nominal physics, so that one scene serves all.
    starts: Vec<Start>,
    /// Targets of each control step, the same for all.
    controls: Vec<Vec<f64>>,
}

impl Bench {
    fn new(scene: Arc<GraspScene>, script: &Script, args: &BenchArgs) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let start = |_| Start { randomisation: Randomisation::none(), ..Start::draw(&scene, &mut rng) };
        let starts = (0..args.envs).map(start).collect();
        let rate_hz = scene.config().control_rate_hz;
        let num_control_steps = (args.span_s * rate_hz).round().max(1.0) as usize;
        let controls = (0..num_control_steps).map(|step| script.targets_at(step as f64 / rate_hz)).collect();
        Self { scene, starts, controls }
    }

    fn worlds(&self) -> anyhow::Result<Vec<World>> {
        let text = self.scene.mjcf(&Randomisation::none())?;
        let world = |_: &Start| World::new(&text, &self.scene.station().robot, self.scene.config());
        Ok(self.starts.iter().map(world).collect::<Result<_, _>>()?)
    }

    /// Bare physics: targets in, steps, nothing out.
    fn physics(&self, worlds: &mut [World]) -> anyhow::Result<Spent> {
        for (world, start) in worlds.iter_mut().zip(&self.starts) {
            world.reset(&start.positions, &start.base_from_object);
        }
        let began = Began::now();
        worlds.par_iter_mut().try_for_each(|world| {
            self.controls.iter().try_for_each(|targets| {
                world.set_targets(targets);
                world.step()
            })
        })?;
        Ok(began.spent())
    }

    /// Whole steps: physics, touch, observations.
    fn env(&self, batch: &mut GraspBatch) -> anyhow::Result<Spent> {
        batch.begin(&self.starts)?;
        let mut observations = vec![0.0; self.starts.len() * self.scene.num_observations()];
        let mut targets = Vec::new();
        let began = Began::now();
        for of_all in &self.controls {
            targets.clear();
            self.starts.iter().for_each(|_| targets.extend_from_slice(of_all));
            batch.step(&targets, &mut observations)?;
        }
        Ok(began.spent())
    }

    fn learn(&self, args: &BenchArgs, script: Script) -> anyhow::Result<LearnBatch> {
        let (shown, text) = (files::shown(&args.learning), files::text(&args.learning)?);
        let config = LearnConfig::from_toml(&shown, &text, &self.scene.station().robot)?;
        let task = LearnTask::new(Arc::clone(&self.scene), Some(script), config)?;
        Ok(LearnBatch::new(Arc::new(task), args.envs, 1)?)
    }

    /// Steps of the longest episode.
    fn num_learning_steps(&self) -> usize {
        let config = self.scene.config();
        (config.task.episode_s * config.control_rate_hz).round().max(1.0) as usize
    }

    /// As many steps of the learning task as its longest episode has, from new starts and with actions that move everything.
    fn learning(&self, batch: &mut LearnBatch) -> anyhow::Result<Spent> {
        let num_actions = batch.num_envs() * batch.action_dim();
        let began = Began::now();
        batch.reset(0)?;
        for step in 0..self.num_learning_steps() {
            let actions: Vec<f32> =
                (0..num_actions).map(|idx| 0.2 * ((7 * idx + step) as f32).sin()).collect();
            batch.step(&actions)?;
        }
        Ok(began.spent())
    }

    fn peer_inputs(&self) -> anyhow::Result<String> {
        let start = |start: &Start| {
            let (t, q) = (start.base_from_object.translation, start.base_from_object.rotation);
            (start.positions.clone(), [t.x, t.y, t.z, q.w, q.i, q.j, q.k])
        };
        let num_substeps = self.scene.config().num_substeps();
        let inputs = PeerInputs {
            xml: self.scene.mjcf(&Randomisation::none())?,
            threads: rayon::current_num_threads(),
            joints: self.scene.station().robot.dofs().map(|joint| joint.name.as_str()).collect(),
            object: scene::OBJECT,
            starts: self.starts.iter().map(start).collect(),
            controls: self.controls.iter().flat_map(|targets| vec![targets.clone(); num_substeps]).collect(),
        };
        Ok(serde_json::to_string(&inputs)?)
    }
}

/// The peer's process: it runs a round whenever it gets a line, and answers with one.
pub(crate) struct Peer {
    child: Child,
    to: ChildStdin,
    from: BufReader<ChildStdout>,
}

impl Peer {
    /// Starts `program` in `python`, and tells it its `inputs`, one line.
    pub(crate) fn start(python: &PathBuf, program: &str, inputs: &str) -> anyhow::Result<Self> {
        let mut child = Command::new(python)
            .args(["-c", program])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .with_context(|| format!("failed to start {python:?}"))?;
        let (Some(mut to), Some(from)) = (child.stdin.take(), child.stdout.take()) else {
            bail!("the peer has no pipes");
        };
        writeln!(to, "{inputs}").context("failed to tell the peer what to run")?;
        Ok(Self { child, to, from: BufReader::new(from) })
    }

    /// What it answers to a line; `needs` says what its Python has to have.
    pub(crate) fn ask<T: DeserializeOwned>(&mut self, line: &str, needs: &str) -> anyhow::Result<T> {
        writeln!(self.to, "{line}").context("the peer has ended; its own message is above")?;
        let mut answer = String::new();
        self.from.read_line(&mut answer)?;
        serde_json::from_str(&answer)
            .with_context(|| format!("the peer answered {answer:?}; it needs {needs}"))
    }
}

impl Drop for Peer {
    fn drop(&mut self) {
        // It ends by itself when its input does; whether it had ended before is of no interest.
        self.child.kill().ok();
        self.child.wait().ok();
    }
}
