//! Measures the networks of a policy on one core, in turns with PyTorch: from an observation to an action, and steps of
//! learning.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context as _, bail};
use palpate_cloning::{CloneConfig, Episode, Episodes, Head, Memory, Moment, Robot, Shape, Step, Touch};
use palpate_encoder::{Dataset, EncoderConfig, Sample};
use serde::{Deserialize, Serialize};

use crate::bench::Peer;
use crate::files::{self, Sources};

/// The peer's program: the same networks in PyTorch.
const PEER: &str = include_str!("../../../tests/peers/torch_policy.py");
/// Observations between turns.
const BLOCK: usize = 10;
#[derive(clap::Args)]
pub(crate) struct BenchPolicyArgs {
    /// Station file: its joints and channels count
    #[arg(long, default_value = "assets/stations/xarm6_leap.toml")]
    station: PathBuf,
    /// Sizes of the policy: "small" or "paper"
    #[arg(long, default_value = "paper")]
    preset: String,
    /// How the policy joins the frames of a window: "window" or "recurrent"; the peer knows only "window"
    #[arg(long, default_value = "window", value_parser = crate::clone::memory)]
    memory: Memory,
    /// Sizes of the tactile encoder: "quick" or "paper"
    #[arg(long, default_value = "paper")]
    encoder_preset: String,
    /// Observations that become actions
    #[arg(long, allow_negative_numbers = true, default_value_t = 200)]
    inferences: usize,
    /// Steps of learning of the policy and of the encoder, each
    #[arg(long, default_value_t = 5)]
    learning_steps: usize,
    /// Samples of a step of learning
    #[arg(long, allow_negative_numbers = true, default_value_t = 64)]
    batch_size: usize,
    /// Python with PyTorch to compare with; without it there is no comparison
    #[arg(long)]
    python: Option<PathBuf>,
}

/// What the peer is told, on one line.
#[derive(Serialize)]
struct PeerInputs {
    batch_size: usize,
    input_len: usize,
    action_len: usize,
    predicted: usize,
    trunk: Vec<usize>,
    unet: [usize; 2],
    kernel: usize,
    sampled_steps: usize,
    history: usize,
    channels: usize,
    width: usize,
    layers: usize,
    heads: usize,
    feed_forward: usize,
}

/// Seconds that something took, each time.
#[derive(Clone, Debug, Default, Deserialize)]
struct Times {
    encoder: Vec<f64>,
    policy: Vec<f64>,
    policy_step: Vec<f64>,
}

/// Of one side, ms. Latency is from an observation to an action: encoder, then policy.
#[derive(Serialize)]
struct Side {
    latency_median_ms: f64,
    latency_p99_ms: f64,
    encoder_median_ms: f64,
    policy_median_ms: f64,
    policy_step_median_ms: Option<f64>,
}

#[derive(Serialize)]
struct Report {
    preset: String,
    encoder_preset: String,
    inferences: usize,
    batch_size: usize,
    palpate: Side,
    torch: Option<Side>,
    /// Medians of ours over those of PyTorch.
    latency_over_torch: Option<f64>,
    policy_step_over_torch: Option<f64>,
}

pub(crate) fn run(args: &BenchPolicyArgs) -> anyhow::Result<()> {
    for (name, value) in [("--inferences", args.inferences), ("--batch-size", args.batch_size)] {
        if value == 0 {
            bail!("{name} is 0, expected at least 1");
        }
    }
    if args.memory == Memory::Recurrent && args.python.is_some() {
        bail!("PyTorch's side has no recurrent policy; leave out --python or --memory");
    }
    let mut config = CloneConfig::preset(&args.preset)?;
    (config.head, config.memory, config.batch_size) = (Head::Diffusion, args.memory, args.batch_size);
    let mut encoding = EncoderConfig::preset(&args.encoder_preset)?;
    // Neither is part of an inference, and both make data that are not needed.
    (encoding.batch_size, encoding.hand_points, encoding.object_points) =
        (1, encoding.network.points_per_query, encoding.network.points_per_query);
    let robot = robot(&args.station)?;
    let shape = robot.shape();
    let inputs = peer_inputs(args, &config, &encoding, shape);
    let mut peer = match &args.python {
        None => None,
        Some(python) => Some(Peer::start(python, PEER, &serde_json::to_string(&inputs)?)?),
    };
    // One core each: the peer keeps to one thread as well.
    rayon::ThreadPoolBuilder::new().num_threads(1).build_global().context("failed to start a thread")?;
    let episodes = made_up(shape)?;
    let mut trainer = palpate_cloning::Trainer::new(config, robot, &episodes, BTreeMap::new())?;
    let policy = trainer.cloned();
    let encoder =
        palpate_encoder::Trainer::new(encoding.clone(), &Windows(&encoding, shape), BTreeMap::new())?
            .encoder();
    let window = Windows(&encoding, shape).sample(0).input;

    let (mut ours, mut theirs) = (Times::default(), Times::default());
    let (positions, commands) = (vec![0.1; shape.dofs], vec![0.11; shape.dofs]);
    let active = vec![true; shape.channels];
    while ours.policy.len() < args.inferences {
        for _ in 0..BLOCK.min(args.inferences - ours.policy.len()) {
            let began = Instant::now();
            let mut seen = policy.history(None)?;
            seen.see(&Moment {
                time_s: 1.0,
                positions: &positions,
                commands: &commands,
                touch: Touch::Events(&active),
                features: &[],
            });
            encoder.encode(&window)?;
            ours.encoder.push(began.elapsed().as_secs_f64());
            let began = Instant::now();
            policy.plan(&seen, &commands, [0, ours.policy.len() as u64])?;
            ours.policy.push(began.elapsed().as_secs_f64());
        }
        if let Some(peer) = &mut peer {
            let answer: Times = peer.ask(&format!("infer {BLOCK}"), "the Python package torch")?;
            theirs.encoder.extend(answer.encoder);
            theirs.policy.extend(answer.policy);
        }
    }
    for _ in 0..args.learning_steps {
        let began = Instant::now();
        trainer.update(&episodes)?;
        ours.policy_step.push(began.elapsed().as_secs_f64());
        if let Some(peer) = &mut peer {
            let answer: Times = peer.ask("learn", "the Python package torch")?;
            theirs.policy_step.extend(answer.policy_step);
        }
    }
    let palpate = Side::of(&ours);
    let torch = peer.is_some().then(|| Side::of(&theirs));
    let over = |of: &dyn Fn(&Side) -> Option<f64>| Some(of(&palpate)? / of(torch.as_ref()?)?);
    let report = Report {
        preset: args.preset.clone(),
        encoder_preset: args.encoder_preset.clone(),
        inferences: args.inferences,
        batch_size: args.batch_size,
        latency_over_torch: over(&|side| Some(side.latency_median_ms)),
        policy_step_over_torch: over(&|side| side.policy_step_median_ms),
        palpate,
        torch,
    };
    println!("{}", serde_json::to_string_pretty(&report)?);
    Ok(())
}

fn peer_inputs(
    args: &BenchPolicyArgs,
    config: &CloneConfig,
    encoding: &EncoderConfig,
    shape: Shape,
) -> PeerInputs {
    PeerInputs {
        batch_size: args.batch_size,
        input_len: config.observation.frames * (2 * shape.dofs + shape.channels) + 1,
        action_len: shape.dofs + 1,
        predicted: config.predicted,
        trunk: config.trunk.clone(),
        unet: config.diffusion.channels,
        kernel: config.diffusion.kernel,
        sampled_steps: config.diffusion.sampled_steps,
        history: encoding.history,
        channels: shape.channels,
        width: encoding.network.width,
        layers: encoding.network.layers,
        heads: encoding.network.heads,
        feed_forward: encoding.network.feed_forward,
    }
}

/// The robot of a station file, as if it were controlled 20 times a second: the rate is only compared.
fn robot(path: &Path) -> anyhow::Result<Robot> {
    let station = files::station(path, &Sources::default())?;
    Ok(Robot {
        joints: station.robot.dofs().map(|joint| joint.name.clone()).collect(),
        channels: station.layout.channels.iter().map(|channel| channel.id.clone()).collect(),
        control_rate_hz: 20.0,
    })
}

/// Motions of no meaning: what is measured does not depend on what is learned.
fn made_up(shape: Shape) -> anyhow::Result<Episodes> {
    let mut episodes = Vec::new();
    for number in 0..4 {
        let mut episode = Episode::default();
        for step in 0..150 {
            let at = |ahead: usize| -> Vec<f64> {
                (0..shape.dofs).map(|dof| (0.05 * (step + ahead + 7 * number + dof) as f64).sin()).collect()
            };
            let active: Vec<bool> =
                (0..shape.channels).map(|channel| (step / 5 + channel) % 7 == 0).collect();
            let (positions, commands, targets) = (at(0), at(1), at(2));
            let time_s = 0.05 * step as f64;
            let moment = Moment {
                time_s,
                positions: &positions,
                commands: &commands,
                touch: Touch::Events(&active),
                features: &[],
            };
            episode.push(shape, &Step { moment, targets: &targets, claims_held: false });
        }
        episodes.push(episode);
    }
    Ok(Episodes::new(shape, episodes)?)
}

/// Windows of no meaning.
struct Windows<'a>(&'a EncoderConfig, Shape);

impl Dataset for Windows<'_> {
    fn len(&self) -> usize {
        4
    }

    fn num_channels(&self) -> usize {
        self.1.channels
    }

    fn num_joints(&self) -> usize {
        self.1.dofs
    }

    fn sample(&self, idx: usize) -> Sample {
        let wave = |len: usize| -> Vec<f32> { (0..len).map(|at| 0.1 * ((at + idx) as f32).sin()).collect() };
        Sample {
            input: wave(self.0.history * self.1.channels * 4),
            hand_points: wave(3 * self.0.hand_points),
            object_points: wave(3 * self.0.object_points),
            pose: [0.1, 0.0, 0.1, 1.0, 0.0, 0.0, 0.0],
            joints: wave(self.1.dofs),
            contacts: (0..self.1.channels).map(|channel| ((channel + idx) % 2) as f32).collect(),
        }
    }
}

impl Side {
    fn of(times: &Times) -> Self {
        let latencies: Vec<f64> =
            times.encoder.iter().zip(&times.policy).map(|(encoder, policy)| encoder + policy).collect();
        let ms = |values: &[f64], share: f64| quantile(values, share).map(|s| 1e3 * s);
        let of = |values: &[f64], share: f64| ms(values, share).unwrap_or(f64::NAN);
        Self {
            latency_median_ms: of(&latencies, 0.5),
            latency_p99_ms: of(&latencies, 0.99),
            encoder_median_ms: of(&times.encoder, 0.5),
            policy_median_ms: of(&times.policy, 0.5),
            policy_step_median_ms: ms(&times.policy_step, 0.5),
        }
    }
}

/// The value that this share of `values` does not exceed; nothing of none.
fn quantile(values: &[f64], share: f64) -> Option<f64> {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.get(((share * sorted.len() as f64).ceil() as usize).saturating_sub(1)).copied()
}
