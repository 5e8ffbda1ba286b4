//! Keeps what the searching expert does, trial by trial, as files to learn from.

use std::cell::Cell;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use anyhow::{Context as _, bail};
use nalgebra::Isometry3;
use palpate_cloning::{Episode, Robot, Step};
use palpate_grasp::controller::{Command, Controller, Observation};
use palpate_grasp::search::{Prior, Searcher, Senses};
use palpate_grasp::trial::{Known, Outcome, Score, conduct_seen};
use palpate_grasp::{GraspEnv, Protocol};
use palpate_rollout::task::robot;
use palpate_sim::job::{Cancel, Progress as _};
use palpate_terminal::{Bar, cancel_on_ctrl_c, events};
use palpate_training::{below, generator};
use rayon::prelude::*;
use safetensors::SafeTensors;
use safetensors::tensor::{Dtype, TensorView};
use serde::{Deserialize, Serialize};

use crate::SceneArgs;
use crate::files::{self, Source, Sources};
use crate::imitator::{self, Imitator};
use crate::search::{CLOSINGS, Expert, SEARCH};

/// The tensor that says where objects were.
const OBJECT_POSES: &str = "object_poses";
/// The tensor that says how strongly each channel was touched; only sensor models tell it.
const STRENGTHS: &str = "strengths";
/// The tensor that says from which step on each trial is learned from; without it all of it is.
const TAUGHT_FROM: &str = "taught_from";
/// What may stand before the path of a policy that imitates an expert.
const CLONE: &str = "clone:";
/// What the names of all files end with.
const ENDING: &str = ".safetensors.zst";
const ZSTD_LEVEL: i32 = 6;

#[derive(clap::Args)]
pub(crate) struct GatherArgs {
    #[command(flatten)]
    scene: SceneArgs,
    /// Where objects begin, and for how long the expert may search: a file, or a name in `assets/grasp/protocols`
    #[arg(long, default_value = "wide")]
    protocol: String,
    /// Objects: "seen", "unseen", "all", or names or files with commas between
    #[arg(long, default_value = "seen")]
    objects: String,
    /// Trials on each object
    #[arg(long, allow_negative_numbers = true, default_value_t = 300)]
    count: u64,
    /// Seed of places, randomised physics and noise; not the protocol's, or policies would be judged by what they
    /// learned from
    #[arg(long, default_value_t = 101)]
    seed: u64,
    /// Whose trials are kept: "search", or one that feels less: "search:touch", "search:tracking", "repetition", which feels
    /// nothing and goes by the time alone. What it may not feel is kept all the same
    #[arg(long, default_value = "search", value_parser = expert_kind)]
    expert: ExpertKind,
    /// A policy that imitates an expert moves the robot until a random moment, from which on the expert does: "clone:PATH", or
    /// a training's folder or file. Only the expert's part is learned from
    #[arg(long, value_name = "POLICY")]
    takeover: Option<String>,
    /// How the searching expert tries to grasp
    #[arg(long, default_value = SEARCH)]
    search: PathBuf,
    /// Closings that it has learned from
    #[arg(long, default_value = CLOSINGS)]
    closings: PathBuf,
    /// Folder for the files, one an object; those that are there already are not made again
    #[arg(long)]
    out: PathBuf,
}

/// A searching expert by the senses that it has, as `palpate-train evaluate` names it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ExpertKind {
    name: &'static str,
    senses: Senses,
}

const EXPERTS: [ExpertKind; 4] = [
    ExpertKind { name: "search", senses: Senses::BOTH },
    ExpertKind { name: "search:touch", senses: Senses { touch: true, tracking: false } },
    ExpertKind { name: "search:tracking", senses: Senses { touch: false, tracking: true } },
    ExpertKind { name: "repetition", senses: Senses::NONE },
];

pub(crate) fn expert_kind(text: &str) -> Result<ExpertKind, String> {
    let names = EXPERTS.map(|kind| kind.name).join(", ");
    let found = EXPERTS.into_iter().find(|kind| kind.name == text);
    found.ok_or_else(|| format!("{text:?} is none of {names}"))
}

impl ExpertKind {
    /// As files name it; the expert that has both senses needs no name.
    fn in_files(self) -> Option<String> {
        (self.senses != Senses::BOTH).then(|| self.name.to_owned())
    }
}

/// What a file says of itself.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
pub(crate) struct Record {
    object: String,
    protocol: String,
    /// Half the edge length of the square that objects began in, m; files of earlier versions do not say it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    half_width_m: Option<f64>,
    /// Whose trials these are; nothing for the searching expert that has both senses.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    expert: Option<String>,
    /// SHA-256 of the policy that moved the robot before the expert took over, if one did.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    taken_over_from: Option<String>,
    seed: u64,
    count: u64,
    joints: Vec<String>,
    channels: Vec<String>,
    control_rate_hz: f64,
    /// Every file that the trials were made from.
    sources: Vec<Source>,
}

impl Record {
    /// What tells these trials from others.
    pub(crate) fn name(&self) -> String {
        let Self { object, protocol, seed, count, .. } = self;
        let by = self.expert.as_ref().map(|expert| format!(", by {expert}")).unwrap_or_default();
        let from = self.taken_over_from.as_deref().unwrap_or_default();
        let from = if from.is_empty() { String::new() } else { format!(", taken over from policy {from}") };
        format!("{count} trials on {object}, protocol {protocol}, seed {seed}{by}{from}")
    }

    /// Half the edge length of the square that objects began in, m, if the file says it.
    pub(crate) fn half_width_m(&self) -> Option<f64> {
        self.half_width_m
    }

    /// Object, seed and protocol: files that share these have trials in common.
    pub(crate) fn key(&self) -> (&str, u64, Option<&str>) {
        (&self.object, self.seed, Some(&self.protocol))
    }

    /// Every file that the trials were made from.
    pub(crate) fn sources(&self) -> &[Source] {
        &self.sources
    }

    /// Whose trials these are.
    pub(crate) fn robot(&self) -> Robot {
        Robot {
            joints: self.joints.clone(),
            channels: self.channels.clone(),
            control_rate_hz: self.control_rate_hz,
        }
    }
}

/// One file.
pub(crate) struct Gathered {
    pub(crate) record: Record,
    /// By number.
    pub(crate) trials: Vec<Trial>,
    /// Whether trials say where the object was; those of earlier versions do not.
    pub(crate) has_poses: bool,
    /// Of the file before it was compressed.
    pub(crate) sha256: String,
}

/// One trial.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Trial {
    pub(crate) outcome: Outcome,
    pub(crate) episode: Episode,
    /// base_from_object, `[steps, 7]`: x, y, z, then the quaternion, w first; nothing in files of earlier versions.
    pub(crate) object_poses: Vec<f32>,
    /// `[steps, channels]`, from 0 to 1; nothing where it could not be told, and in files of earlier versions.
    pub(crate) strengths: Vec<f32>,
}

pub(crate) fn run(args: &GatherArgs) -> anyhow::Result<()> {
    if args.count == 0 {
        bail!("--count is 0, expected at least 1");
    }
    let sources = Sources::default();
    let (protocol_name, protocol) = files::protocol(&args.protocol, &sources)?;
    check_seed(args.seed, &protocol_name, &protocol)?;
    files::start_threads(args.scene.threads)?;
    let objects = files::objects(&args.objects)?;
    std::fs::create_dir_all(&args.out).with_context(|| format!("failed to create {:?}", args.out))?;
    let mut world = files::open_world(&args.scene, &sources)?;
    protocol.apply(&mut world.config);
    let expert = Expert::open(&args.search, &args.closings, &world.station, &world.config, &sources)?;
    let experience = expert.experience(args.expert.senses)?;
    let student = args.takeover.as_deref().map(|policy| {
        let path = Path::new(policy.strip_prefix(CLONE).unwrap_or(policy));
        imitator::open(path, &world.station, &world.config)
    });
    let student = student.transpose().context("--takeover")?;
    let taken_over_from = student.as_ref().map(|(_, source)| source.sha256.clone());
    let student = student.map(|(imitation, source)| {
        sources.keep(source);
        imitation
    });
    let (bar, cancel, done) = (Bar::new(), cancel_on_ctrl_c(), AtomicU64::new(0));
    let all = args.count * objects.len() as u64;
    let mut report = Report::default();
    for name in &objects {
        let of_object = Sources::default();
        sources.list().into_iter().for_each(|source| of_object.keep(source));
        let scene = Arc::new(world.scene(&files::object(name, &of_object)?)?);
        let robot = robot(&world.station, &world.config);
        let record = Record {
            object: scene.object().id.clone(),
            protocol: protocol_name.clone(),
            half_width_m: Some(protocol.half_width_m),
            expert: args.expert.in_files(),
            taken_over_from: taken_over_from.clone(),
            seed: args.seed,
            count: args.count,
            joints: robot.joints.clone(),
            channels: robot.channels.clone(),
            control_rate_hz: robot.control_rate_hz,
            sources: of_object.into_list(),
        };
        let path = args.out.join(format!("{}{ENDING}", record.object));
        if path.exists() {
            let mut found = read(&path)?;
            let earlier = Record { half_width_m: None, ..record.clone() };
            if found.has_poses && found.record == earlier {
                // The same trials, as a version kept them that did not say how wide their region was.
                keep_half_width(&mut found, protocol.half_width_m);
                files::write_in_one_move(&path, &to_bytes(&found.record, &found.trials)?)?;
                bar.line(&format!("{}: the file says now how wide the region is", record.object));
            }
            if found.record != record && found.record != earlier {
                bail!(
                    "{path:?} holds other trials (another count, seed, protocol or file); take another --out"
                );
            }
            done.fetch_add(args.count, Ordering::Relaxed);
            bar.line(&format!("{}: {} trials are there already", record.object, record.count));
            report.add(&record.object, score_of(&found.trials));
            continue;
        }
        let trial = |trial: u64| -> anyhow::Result<Option<Trial>> {
            if Cancel::is_cancelled(&cancel) {
                return Ok(None);
            }
            let prior = Prior { half_width_m: protocol.half_width_m, shape: None };
            let searcher = Searcher::new(Arc::clone(&expert.skill), Arc::clone(&experience), &prior);
            let expert = Blinded { controller: searcher, senses: args.expert.senses };
            let student = student.as_ref().map(|student| {
                let station = Arc::clone(scene.station());
                Imitator::new(student, station, trial, protocol.half_width_m)
            });
            let last = TAKEN_OVER_BEFORE * protocol.episode_s * world.config.control_rate_hz;
            let lift_m = Cell::new(0.0);
            let controller = Relay {
                student: student.transpose()?,
                expert,
                not_before: below(&mut generator(args.seed, TAKEN_OVER, trial, 0), last as usize + 1),
                lift_m: &lift_m,
                step: 0,
                taken_over_at: None,
            };
            let episode = Episode { half_width_m: Some(protocol.half_width_m as f32), ..Episode::default() };
            let mut recorder = Recorder { controller, robot: &robot, episode, strengths: Vec::new() };
            let mut object_poses: Vec<f32> = Vec::new();
            let mut start_m = None;
            let mut see = |env: &GraspEnv| {
                let base_from_object = env.world().base_from_object();
                let height_m = base_from_object.translation.z;
                lift_m.set(height_m - *start_m.get_or_insert(height_m));
                object_poses.extend(pose(&base_from_object));
            };
            let ending = conduct_seen(&scene, &mut recorder, Known::ROBOT, args.seed, trial, &mut see)?;
            let Recorder { controller, mut episode, strengths, .. } = recorder;
            if let Some(student) = controller.student {
                student.problem.map_or(Ok(()), Err)?;
                // A trial that was over before teaches nothing.
                episode.taught_from = controller.taken_over_at.unwrap_or(episode.len());
            }
            // What came of the last step is nobody's beginning.
            object_poses.truncate(POSE * episode.len());
            let done = done.fetch_add(1, Ordering::Relaxed) + 1;
            bar.report(done as f64 / all as f64, "trials");
            Ok(Some(Trial { outcome: ending.outcome, episode, object_poses, strengths }))
        };
        let trials: Option<Vec<_>> =
            (0..args.count).into_par_iter().map(trial).collect::<anyhow::Result<_>>()?;
        let Some(trials) = trials else {
            drop(bar);
            eprintln!(
                "stopped; the same command goes on after the objects that are in {}",
                args.out.display()
            );
            return Ok(());
        };
        let score = score_of(&trials);
        let bytes = to_bytes(&record, &trials)?;
        files::write_in_one_move(&path, &bytes)?;
        let line = format!("{name}: {} of {} held, {} kB", score.successes, score.trials, bytes.len() / 1000);
        if args.scene.json {
            println!("{}", serde_json::json!({ "object": name, "score": score, "bytes": bytes.len() }));
        } else {
            bar.line(&line);
        }
        report.add(&record.object, score);
    }
    drop(bar);
    events::report(&report);
    Ok(())
}

/// Refuses to learn from the starts that a protocol judges by.
pub(crate) fn check_seed(seed: u64, protocol_name: &str, protocol: &Protocol) -> anyhow::Result<()> {
    if protocol.seed == seed {
        bail!(
            "--seed is {seed}, the seed of the protocol {protocol_name:?}: what is learned would be judged on the same starts"
        );
    }
    Ok(())
}

/// What the expert did.
#[derive(Default, Serialize)]
struct Report {
    trials: usize,
    won: usize,
    objects: BTreeMap<String, Score>,
}

impl Report {
    /// Adds the trials on one object, and a point to the curves.
    fn add(&mut self, object: &str, score: Score) {
        self.trials += score.trials;
        self.won += score.successes;
        let success_rate = score.successes as f64 / score.trials.max(1) as f64;
        let point =
            serde_json::json!({ "trials": self.trials, "won": self.won, "success_rate": success_rate });
        self.objects.insert(object.to_owned(), score);
        events::metrics(self.objects.len() as u64, &point);
    }
}

fn score_of(trials: &[Trial]) -> Score {
    Score::of(&trials.iter().map(|trial| trial.outcome).collect::<Vec<_>>())
}

/// Numbers of a pose.
const POSE: usize = 7;

/// x, y, z, then the quaternion, w first.
fn pose(pose: &Isometry3<f64>) -> [f32; POSE] {
    let (t, q) = (pose.translation, pose.rotation);
    [t.x, t.y, t.z, q.w, q.i, q.j, q.k].map(|value| value as f32)
}

/// Makes trials say in how wide a region they began.
fn keep_half_width(gathered: &mut Gathered, half_width_m: f64) {
    gathered.record.half_width_m = Some(half_width_m);
    let episodes = gathered.trials.iter_mut().map(|trial| &mut trial.episode);
    episodes.for_each(|episode| episode.half_width_m = Some(half_width_m as f32));
}

/// Keeps from a controller what it has no sense for, as a trial does that is told so.
struct Blinded<C> {
    controller: C,
    senses: Senses,
}

impl<C: Controller> Controller for Blinded<C> {
    fn control(&mut self, now: &Observation<'_>) -> Command {
        let nothing = vec![false; now.active.len()];
        self.controller.control(&Observation {
            positions: if self.senses.tracking { now.positions } else { now.commands },
            active: if self.senses.touch { now.active } else { &nothing },
            ..*now
        })
    }
}

/// What noise is for: when an expert takes over.
const TAKEN_OVER: u64 = 11;
/// An expert takes over within this share of the longest episode, so that it has time for a try.
const TAKEN_OVER_BEFORE: f64 = 0.6;
/// An object this high is being lifted, m: what to do then the expert's own trials teach. An expert that began anew would
/// let go of it.
const LIFTED_M: f64 = 0.005;

/// A student moves the robot until an expert takes over, which begins as if the trial began there.
struct Relay<'a> {
    /// Nobody where the expert moves it from the beginning.
    student: Option<Imitator>,
    expert: Blinded<Searcher>,
    /// The expert takes over in this step, or in the first after it in which the object is not lifted.
    not_before: usize,
    /// How high the object is above where it began.
    lift_m: &'a Cell<f64>,
    step: usize,
    taken_over_at: Option<usize>,
}

impl Controller for Relay<'_> {
    fn control(&mut self, now: &Observation<'_>) -> Command {
        let step = self.step;
        self.step += 1;
        let Some(student) = &mut self.student else { return self.expert.control(now) };
        if self.taken_over_at.is_none() {
            if step < self.not_before || self.lift_m.get() > LIFTED_M {
                return student.control(now);
            }
            self.taken_over_at = Some(step);
        }
        self.expert.control(now)
    }
}

/// Writes down what a controller knows and does.
struct Recorder<'a, C> {
    controller: C,
    robot: &'a Robot,
    episode: Episode,
    strengths: Vec<f32>,
}

impl<C: Controller> Controller for Recorder<'_, C> {
    fn control(&mut self, now: &Observation<'_>) -> Command {
        let command = self.controller.control(now);
        let step = Step {
            moment: imitator::moment(now),
            targets: &command.targets,
            claims_held: command.claims_held,
        };
        self.episode.push(self.robot.shape(), &step);
        self.strengths.extend_from_slice(now.strengths.unwrap_or_default());
        command
    }
}

/// A safetensors file, compressed as a whole: `frames`, `targets`, `times_s`, `object_poses` and, where they could be
/// told, `strengths` of all steps one after the other, `first_steps` where each trial begins, and how it ended.
fn to_bytes(record: &Record, trials: &[Trial]) -> anyhow::Result<Vec<u8>> {
    let column = |of: &dyn Fn(&Trial) -> &[f32]| -> Vec<u8> {
        trials.iter().flat_map(of).flat_map(|value| value.to_le_bytes()).collect()
    };
    let mut columns = vec![
        ("frames", column(&|trial| &trial.episode.frames)),
        ("targets", column(&|trial| &trial.episode.targets)),
        ("times_s", column(&|trial| &trial.episode.times_s)),
        (OBJECT_POSES, column(&|trial| &trial.object_poses)),
    ];
    if trials.iter().any(|trial| !trial.strengths.is_empty()) {
        columns.push((STRENGTHS, column(&|trial| &trial.strengths)));
    }
    let mut first = 0;
    let mut first_steps: Vec<u8> = 0_u64.to_le_bytes().to_vec();
    for trial in trials {
        first += trial.episode.len() as u64;
        first_steps.extend(first.to_le_bytes());
    }
    let steps = first as usize;
    let outcomes: Vec<u8> = trials.iter().map(|trial| code(trial.outcome)).collect();
    let mut tensors = vec![
        ("first_steps", TensorView::new(Dtype::U64, vec![trials.len() + 1], &first_steps)?),
        ("outcomes", TensorView::new(Dtype::U8, vec![trials.len()], &outcomes)?),
    ];
    let taught_from: Vec<u8> =
        trials.iter().flat_map(|trial| (trial.episode.taught_from as u64).to_le_bytes()).collect();
    if record.taken_over_from.is_some() {
        tensors.push((TAUGHT_FROM, TensorView::new(Dtype::U64, vec![trials.len()], &taught_from)?));
    }
    for (name, bytes) in &columns {
        let width = bytes.len() / 4 / steps.max(1);
        tensors.push((*name, TensorView::new(Dtype::F32, vec![steps, width], bytes)?));
    }
    let metadata = [("gathered".to_owned(), serde_json::to_string(record)?)].into();
    Ok(zstd::encode_all(&*safetensors::serialize(tensors, Some(metadata))?, ZSTD_LEVEL)?)
}

/// Outcomes in files.
const OUTCOMES: [Outcome; 4] = [Outcome::Success, Outcome::EmptyGrasp, Outcome::Slip, Outcome::EmergencyStop];

fn code(outcome: Outcome) -> u8 {
    OUTCOMES.iter().zip(0..).find_map(|(one, code)| (*one == outcome).then_some(code)).unwrap_or_default()
}

/// The file at `path`.
///
/// # Errors
/// Files that cannot be read, or are no trials of an expert.
fn read(path: &Path) -> anyhow::Result<Gathered> {
    let compressed = std::fs::read(path).with_context(|| format!("failed to read {path:?}"))?;
    from_bytes(&compressed).with_context(|| format!("{path:?} holds no trials of an expert that can be used"))
}

fn from_bytes(compressed: &[u8]) -> anyhow::Result<Gathered> {
    let bytes = zstd::decode_all(compressed)?;
    // Of what was compressed: compressors differ.
    let sha256 = files::sha256(&bytes);
    let (_, header) = SafeTensors::read_metadata(&bytes)?;
    let record = header.metadata().as_ref().and_then(|metadata| metadata.get("gathered"));
    let record: Record = serde_json::from_str(record.context("it does not say that it holds any")?)?;
    let file = SafeTensors::deserialize(&bytes)?;
    let bytes = |name: &str, dtype: Dtype| -> anyhow::Result<&[u8]> {
        let tensor = file.tensor(name)?;
        if tensor.dtype() != dtype {
            bail!("{name} holds {:?}, expected {dtype:?}", tensor.dtype());
        }
        Ok(tensor.data())
    };
    let floats = |name: &str| -> anyhow::Result<Vec<f32>> {
        Ok(bytes(name, Dtype::F32)?.as_chunks().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect())
    };
    let (frames, targets, times_s) = (floats("frames")?, floats("targets")?, floats("times_s")?);
    let counts = |name: &str| -> anyhow::Result<Vec<usize>> {
        let chunks = bytes(name, Dtype::U64)?.as_chunks().0;
        Ok(chunks.iter().map(|bytes| u64::from_le_bytes(*bytes) as usize).collect())
    };
    let first_steps = counts("first_steps")?;
    let taught_from = match record.taken_over_from {
        Some(_) => counts(TAUGHT_FROM)?,
        None => vec![0; first_steps.len().saturating_sub(1)],
    };
    let outcomes = bytes("outcomes", Dtype::U8)?;
    let has_poses = file.tensor(OBJECT_POSES).is_ok();
    let object_poses = if has_poses { floats(OBJECT_POSES)? } else { Vec::new() };
    let pose_len = if has_poses { POSE } else { 0 };
    let robot = record.robot();
    let has_strengths = file.tensor(STRENGTHS).is_ok();
    let strengths = if has_strengths { floats(STRENGTHS)? } else { Vec::new() };
    let num_strengths = if has_strengths { robot.channels.len() } else { 0 };
    let (frame_len, action_len) = (2 * robot.joints.len() + robot.channels.len(), robot.joints.len() + 1);
    let steps = times_s.len();
    let is_whole = first_steps.len() == outcomes.len() + 1
        && taught_from.len() == outcomes.len()
        && first_steps.first() == Some(&0)
        && first_steps.last() == Some(&steps)
        && first_steps.windows(2).all(|pair| pair[0] <= pair[1])
        && frames.len() == steps * frame_len
        && object_poses.len() == steps * pose_len
        && strengths.len() == steps * num_strengths
        && targets.len() == steps * action_len;
    if !is_whole {
        bail!("its tensors do not have the sizes that its joints, channels and trials say");
    }
    let mut trials = Vec::with_capacity(outcomes.len());
    for ((pair, &outcome), taught_from) in first_steps.windows(2).zip(outcomes).zip(taught_from) {
        let outcome = OUTCOMES.get(usize::from(outcome)).context("an outcome is none of the four")?;
        let episode = Episode {
            frames: frames[pair[0] * frame_len..pair[1] * frame_len].to_vec(),
            targets: targets[pair[0] * action_len..pair[1] * action_len].to_vec(),
            times_s: times_s[pair[0]..pair[1]].to_vec(),
            half_width_m: record.half_width_m.map(|half_width_m| half_width_m as f32),
            taught_from,
        };
        let object_poses = object_poses[pair[0] * pose_len..pair[1] * pose_len].to_vec();
        let strengths = strengths[pair[0] * num_strengths..pair[1] * num_strengths].to_vec();
        trials.push(Trial { outcome: *outcome, episode, object_poses, strengths });
    }
    Ok(Gathered { record, trials, has_poses, sha256 })
}

/// Whether `folder` holds such files.
pub(crate) fn is_folder(folder: &Path) -> bool {
    let Ok(entries) = std::fs::read_dir(folder) else { return false };
    entries.flatten().any(|entry| entry.path().to_string_lossy().ends_with(ENDING))
}

/// All files of `folders`, in the order of their paths, each with its path.
pub(crate) fn read_all(folders: &[PathBuf]) -> anyhow::Result<Vec<(String, Gathered)>> {
    let mut all = Vec::new();
    for folder in folders {
        let entries = std::fs::read_dir(folder).with_context(|| format!("failed to read {folder:?}"))?;
        let mut paths: Vec<PathBuf> =
            entries.map(|entry| Ok(entry?.path())).collect::<std::io::Result<_>>()?;
        paths.retain(|path| path.to_string_lossy().ends_with(ENDING));
        paths.sort();
        if paths.is_empty() {
            bail!("{folder:?} holds no file *{ENDING}; `palpate-train gather` makes such files");
        }
        for path in paths {
            all.push((files::shown(&path), read(&path)?));
        }
    }
    Ok(all)
}
