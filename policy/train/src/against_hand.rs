//! Compares a rollout with the grasp world: what the same policy does there from the same starts, and what the commands of the
//! rollout do there, felt by several sensor models.

mod report;
mod simulate;

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use anyhow::{Context as _, bail};
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};
use palpate_grasp::{GraspScene, Start};
use palpate_rollout::read::{self, KnownStart, Recorded};
use palpate_rollout::verdict::TrialVerdict;
use palpate_sim::job::Progress as _;
use palpate_terminal::Bar;
use rayon::prelude::*;

use self::report::{Comparison, LeftOut, Model, OnHand, Pair, Touch};
use self::simulate::{Begin, Mover, Simulated};
use crate::files::{self, Source, Sources};
use crate::policy::Policy;
use crate::task::{self, TaskArgs};
use crate::{RobotArgs, SceneArgs};

/// An object that begins this far from where the record says did not begin in the same world, m: placing one again from its seed
/// differs by rounding, another seed or region by centimetres.
const SAME_START_M: f64 = 0.005;

#[derive(clap::Args)]
pub(crate) struct CompareRolloutArgs {
    /// Folder of the rollout: its `--out`
    #[arg(long)]
    rollout: PathBuf,
    /// Only the trials of these numbers, with commas between: those of one policy and object of a campaign
    #[arg(long, value_name = "N,N,...", value_delimiter = ',')]
    only: Vec<u64>,
    /// Sensor model: "nominal", which is that of the station, or a file; may be given several times [default: nominal]
    #[arg(long = "model", value_name = "nominal|FILE")]
    models: Vec<String>,
    /// Compare with what an emulated station of this truth file feels as well
    #[arg(long, value_name = "FILE")]
    truth: Option<PathBuf>,
    /// Station file
    #[arg(long, default_value = "assets/stations/xarm6_leap.toml")]
    station: PathBuf,
    /// Which verdict of the hand counts
    #[arg(long, value_enum, default_value_t = Counted::Seen)]
    verdict: Counted,
    /// Threads [default: all cores]
    #[arg(long)]
    threads: Option<usize>,
    /// One JSON document on standard output
    #[arg(long)]
    json: bool,
    /// Write the comparison with every trial to this file, as JSON
    #[arg(long)]
    out: Option<PathBuf>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Counted {
    /// What the operator of an emulated station saw, and where nobody looked what the robot suggested
    Seen,
    /// What the robot suggested
    Suggested,
}

/// A trial that can be compared.
struct Comparable {
    record: Recorded,
    begin: Begin,
    /// Nobody measured where the object was: it is taken to have been where the campaign's plan has it.
    is_planned: bool,
    /// Verdict on the hand, and whether it is the robot's own.
    verdict: TrialVerdict,
    is_suggested: bool,
}

pub(crate) fn run(args: &CompareRolloutArgs) -> anyhow::Result<()> {
    let began = Instant::now();
    if let Some(out) = &args.out {
        files::check_out(out)?;
    }
    let records = only(read::folder(&args.rollout)?, &args.only, &args.rollout)?;
    let num_recorded = records.len();
    let head = one_kind(&records)?;
    let named = Named::of(&head)?;
    files::start_threads(args.threads)?;
    let mut opened = arms(args)
        .into_iter()
        .map(|(name, feels)| Opened::open(args, &head, &named, name, &feels))
        .collect::<anyhow::Result<Vec<_>>>()?;
    let scene = Arc::clone(&opened.first().context("there is no sensor model")?.scene);
    check_station(&head, &scene)?;
    let (comparable, left_out) = comparable(records, args.verdict, &scene)?;

    let (bar, done) = (Bar::new(), AtomicU64::new(0));
    let all = (comparable.len() * opened.len()) as f64;
    let mut models = Vec::new();
    for arm in &mut opened {
        let pairs = comparable
            .par_iter()
            .map(|trial| {
                let pair = arm.pair(trial)?;
                bar.report((done.fetch_add(1, Ordering::Relaxed) + 1) as f64 / all, "trials");
                Ok(pair)
            })
            .collect::<anyhow::Result<Vec<Pair>>>()?;
        models.push(Model { name: arm.name.clone(), sources: std::mem::take(&mut arm.sources), pairs });
    }
    drop(bar);
    let comparison = Comparison {
        rollout: files::shown(&args.rollout),
        object: head.object.clone(),
        policy: head.policy.clone(),
        channels: head.channels.clone(),
        control_rate_hz: head.control_rate_hz,
        num_recorded,
        left_out,
        starts_as_planned: comparable
            .iter()
            .filter(|trial| trial.is_planned)
            .map(|trial| trial.record.head.trial)
            .collect(),
        hand: comparable
            .iter()
            .map(|trial| OnHand {
                trial: trial.record.head.trial,
                verdict: trial.verdict,
                is_suggested: trial.is_suggested,
            })
            .collect(),
        models,
        seconds: began.elapsed().as_secs_f64(),
    };
    if let Some(out) = &args.out {
        let text = serde_json::to_string_pretty(&comparison.document(true))?;
        files::write_in_one_move(out, format!("{text}\n").as_bytes())?;
    }
    if args.json {
        println!("{}", serde_json::to_string_pretty(&comparison.document(false))?);
    } else {
        print!("{}", comparison.text());
    }
    Ok(())
}

/// The records of the trials of these `numbers`; all without numbers.
fn only(mut records: Vec<Recorded>, numbers: &[u64], folder: &Path) -> anyhow::Result<Vec<Recorded>> {
    if let Some(missing) =
        numbers.iter().find(|&&number| records.iter().all(|record| record.head.trial != number))
    {
        bail!("--only names {missing}, and {folder:?} holds no record of a trial of that number");
    }
    records.retain(|record| numbers.is_empty() || numbers.contains(&record.head.trial));
    Ok(records)
}

/// What the trials share, if they share it.
fn one_kind(records: &[Recorded]) -> anyhow::Result<read::Head> {
    let first = &records.first().context("there are no records")?.head;
    let kind = |head: &read::Head| {
        let read::Head { object, policy, is_silenced, files, control_rate_hz, joints, channels, .. } = head;
        (
            object.clone(),
            policy.clone(),
            *is_silenced,
            files.clone(),
            control_rate_hz.to_bits(),
            joints.clone(),
            channels.clone(),
            head.start.as_ref().and_then(|start| start.start_cm).map(f64::to_bits),
        )
    };
    let other = records.iter().find(|record| kind(&record.head) != kind(first));
    if let Some(other) = other {
        bail!(
            "{} is of another object, policy, file, station or region of starts than the trials before, or the policy was told \
             that it feels nothing in one of them alone; compare them apart, by --only",
            other.path.display()
        );
    }
    if first.is_silenced {
        bail!(
            "{} is of a policy that was told that it feels nothing; it is compared as it is with its touch alone",
            records[0].path.display()
        );
    }
    Ok(first.clone())
}

/// Files that the record names; a role is the policy's, or the script's.
struct Named(Vec<Source>);

impl Named {
    /// Refuses those that are gone or other than they were.
    fn of(head: &read::Head) -> anyhow::Result<Self> {
        for file in &head.files {
            // The studio handed these out; joints and channels are compared instead.
            if file.role == "station" || file.role == "model" {
                continue;
            }
            let bytes = std::fs::read(&file.path).with_context(|| {
                format!(
                    "failed to read {:?}, the {} of the rollout; paths are relative to the folder that the command runs in",
                    file.path, file.role
                )
            })?;
            let found = files::sha256(&bytes);
            if found != file.sha256 {
                bail!(
                    "{:?}, the {} of the rollout, is another file now: SHA-256 {found}, not {}; bring the old one back",
                    file.path,
                    file.role,
                    file.sha256
                );
            }
        }
        Ok(Self(head.files.clone()))
    }

    fn path(&self, role: &str) -> Option<PathBuf> {
        // The description of an object comes before its meshes.
        let is_text = |source: &&Source| source.role == role && (role != "object" || is_toml(&source.path));
        self.0.iter().find(is_text).map(|source| PathBuf::from(&source.path))
    }

    fn must(&self, role: &str) -> anyhow::Result<PathBuf> {
        self.path(role).with_context(|| format!("the rollout names no {role} file"))
    }
}

fn is_toml(path: &str) -> bool {
    Path::new(path).extension().is_some_and(|extension| extension == "toml")
}

/// What a comparison feels with.
enum Feels {
    Nominal,
    Model(PathBuf),
    Truth(PathBuf),
}

fn arms(args: &CompareRolloutArgs) -> Vec<(String, Feels)> {
    let nominal = ["nominal".to_owned()];
    let models = if args.models.is_empty() { &nominal[..] } else { &args.models };
    let mut arms: Vec<(String, Feels)> = Vec::new();
    for model in models {
        let feels =
            if model == "nominal" { Feels::Nominal } else { Feels::Model(PathBuf::from(model.as_str())) };
        if arms.iter().all(|(name, _)| name != model) {
            arms.push((model.clone(), feels));
        }
    }
    if let Some(truth) = &args.truth {
        arms.push((format!("truth {}", truth.display()), Feels::Truth(truth.clone())));
    }
    arms
}

/// One sensor model in the world of the rollout.
struct Opened {
    name: String,
    scene: Arc<GraspScene>,
    mover: Mover,
    sources: Vec<Source>,
}

impl Opened {
    fn open(
        args: &CompareRolloutArgs,
        head: &read::Head,
        named: &Named,
        name: String,
        feels: &Feels,
    ) -> anyhow::Result<Self> {
        let policy = named.path("policy");
        let script = named.path("script");
        let scene_args = SceneArgs {
            robot: RobotArgs {
                station: args.station.clone(),
                world: named.must("world")?,
                model: if let Feels::Model(path) = feels { Some(path.clone()) } else { None },
            },
            truth: if let Feels::Truth(path) = feels { Some(path.clone()) } else { None },
            contact_map: None,
            silence_touch: false,
            script: PathBuf::new(),
            object: files::shown(&named.must("object")?),
            start_cm: head.start.as_ref().and_then(|start| start.start_cm),
            threads: None,
            json: false,
        };
        let sources = Sources::default();
        let world = files::open_world(&scene_args, &sources)?;
        let object = files::object(&scene_args.object, &sources)?;
        let scene = Arc::new(world.scene(&object)?);
        let script = script.map(|path| files::script(&path, &world, &sources)).transpose()?;
        let mover = match (policy, script) {
            (None, Some(script)) => Mover::Script(Arc::new(script)),
            (Some(policy), script) => {
                let learning = named.must("learning")?;
                let task_args = TaskArgs { scene: scene_args, learning, without_script: script.is_none() };
                let opened = task::of_script(&task_args, Arc::clone(&scene), script, sources)?;
                let (policy, source) = Policy::open(&policy, &opened)?;
                let mut sources = opened.sources.clone();
                sources.push(source);
                let mover = Mover::Learned { policy: Box::new(policy), task: opened.task };
                return Ok(Self { name, scene, mover, sources });
            }
            (None, None) => bail!("the rollout names neither a policy nor a script"),
        };
        Ok(Self { name, scene, mover, sources: sources.into_list() })
    }

    /// A trial beside what happens here from the same start, and with the same commands.
    fn pair(&self, trial: &Comparable) -> anyhow::Result<Pair> {
        let record = &trial.record;
        let num_channels = record.head.channels.len();
        let hand = record.active_by_step();
        let start = trial.begin.start(&self.scene);
        let own = self.mover.run(&self.scene, &trial.begin, &start)?;
        let replayed = simulate::commands(&self.scene, &start, &record.commands_by_step())?;
        let rate_hz = record.head.control_rate_hz;
        Ok(Pair {
            outcome: own.outcome,
            touch: Touch::of(rate_hz, num_channels, &hand, &own.active),
            replayed_outcome: replayed.outcome,
            replayed_touch: Touch::of(rate_hz, num_channels, &hand, &replayed.active),
            joint_difference: joint_difference(record, &replayed),
        })
    }
}

/// Mean absolute difference of joint positions between the record and what its commands did in simulation, by joint, rad or m.
fn joint_difference(record: &Recorded, replayed: &Simulated) -> Vec<f64> {
    let num_joints = record.head.joints.len();
    let (mut sums, mut count) = (vec![0.0; num_joints], 0_u32);
    for step in &record.steps {
        let idx = (step.time_s * record.head.control_rate_hz).round() as usize;
        let Some(simulated) = replayed.positions.get(idx) else { break };
        for (sum, (at, simulated)) in sums.iter_mut().zip(step.positions.iter().zip(simulated)) {
            *sum += (at - simulated).abs();
        }
        count += 1;
    }
    sums.iter().map(|sum| sum / f64::from(count.max(1))).collect()
}

/// Refuses a rollout on other joints or channels.
fn check_station(head: &read::Head, scene: &GraspScene) -> anyhow::Result<()> {
    let station = scene.station();
    let joints: Vec<&str> = station.robot.dofs().map(|joint| joint.name.as_str()).collect();
    let channels: Vec<&str> = station.layout.channels.iter().map(|channel| channel.id.as_str()).collect();
    for (what, recorded, own) in [("joints", &head.joints, joints), ("channels", &head.channels, channels)] {
        if recorded.iter().map(String::as_str).ne(own.iter().copied()) {
            bail!(
                "the rollout's {what}, of station {:?}, are not those of {:?}; give its --station",
                head.station,
                station.id
            );
        }
    }
    let (recorded, own) = (head.control_rate_hz, scene.config().control_rate_hz);
    if recorded != own {
        bail!("the rollout took {recorded} steps a second, its world file says {own}");
    }
    Ok(())
}

/// Trials that can be compared, and why others cannot.
fn comparable(
    records: Vec<Recorded>,
    counted: Counted,
    scene: &GraspScene,
) -> anyhow::Result<(Vec<Comparable>, LeftOut)> {
    let (mut comparable, mut left_out) = (Vec::new(), LeftOut::default());
    for record in records {
        let number = record.head.trial;
        let Some(outcome) = &record.outcome else {
            left_out.no_outcome.push(number);
            continue;
        };
        let seen = outcome.truth.as_ref().and_then(|truth| truth.verdict);
        let seen = seen.filter(|_| counted == Counted::Seen);
        let (verdict, is_suggested) = (seen.unwrap_or(outcome.suggested), seen.is_none());
        if outcome.suggested == TrialVerdict::Void || verdict == TrialVerdict::Void {
            left_out.void.push(number);
            continue;
        }
        let measured = begin(&record)?;
        let is_planned = measured.is_none();
        let Some(begin) = measured.or_else(|| planned(&record, scene)) else {
            left_out.unknown_start.push(number);
            continue;
        };
        if !begins_as_recorded(&record, &begin, scene)? {
            left_out.another_start.push(number);
            continue;
        }
        comparable.push(Comparable { record, begin, is_planned, verdict, is_suggested });
    }
    Ok((comparable, left_out))
}

/// How a trial began; `None` where nobody knows where the object was.
fn begin(record: &Recorded) -> anyhow::Result<Option<Begin>> {
    let Some(start) = &record.head.start else { return Ok(None) };
    let problem = |what: String| format!("{}: {what}", record.path.display());
    if let (Some(seed), Some(trial)) = (start.seed, start.trial) {
        return Ok(Some(Begin::Trial { seed, trial }));
    }
    let Some(pose) = start.object_pose else { return Ok(None) };
    let base_from_object = isometry(pose).with_context(|| problem(format!("object_pose is {pose:?}")))?;
    Ok(Some(Begin::Pose { positions: record.head.begins_at.clone(), base_from_object }))
}

/// How a trial of a campaign began whose object somebody placed as the plan has it.
fn planned(record: &Recorded, scene: &GraspScene) -> Option<Begin> {
    let KnownStart { offset_m, yaw_rad, side, .. } = record.head.start.as_ref()?;
    let (offset_m, yaw_rad, side) = ((*offset_m)?, (*yaw_rad)?, (*side)?);
    let is_place = [offset_m[0], offset_m[1], yaw_rad, side].iter().all(|number| number.is_finite());
    is_place.then(|| Begin::Pose {
        positions: record.head.begins_at.clone(),
        base_from_object: Start::placed(scene, side, offset_m, yaw_rad).base_from_object,
    })
}

fn isometry([x, y, z, w, i, j, k]: [f64; 7]) -> anyhow::Result<Isometry3<f64>> {
    let turned = Quaternion::new(w, i, j, k);
    let is_unit = (turned.norm() - 1.0).abs() < 0.01;
    if !(is_unit && [x, y, z].iter().all(|value| value.is_finite())) {
        bail!("expected x y z in m and a unit quaternion w x y z");
    }
    Ok(Isometry3::from_parts(Translation3::new(x, y, z), UnitQuaternion::from_quaternion(turned)))
}

/// Whether the object begins here where the record says that it began.
fn begins_as_recorded(record: &Recorded, begin: &Begin, scene: &GraspScene) -> anyhow::Result<bool> {
    let recorded = record.head.start.as_ref().and_then(|start| start.object_pose);
    let Some(recorded) = recorded.map(isometry).transpose()? else { return Ok(true) };
    let own = scene.world(&begin.start(scene))?.base_from_object();
    Ok((own.translation.vector - recorded.translation.vector).norm() <= SAME_START_M)
}

#[cfg(test)]
mod tests;
