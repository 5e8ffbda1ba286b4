//! Compares policies under a protocol, on the same starts.

mod films;
mod kept;
mod picture;
mod report;

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use anyhow::{Context as _, bail};
use palpate_grasp::controller::{Command, Controller, Observation, Scripted};
use palpate_grasp::learn::{Conditions, LearnEnv};
use palpate_grasp::search::{Belief, Experience, Prior, Searcher, Senses};
use palpate_grasp::trial::{Ending, Known, conduct_seen};
use palpate_grasp::{GraspEnv, GraspScene, Protocol, Script};
use palpate_robot_model::ObjectGroup;
use palpate_sim::job::Progress as _;
use palpate_terminal::{Bar, events};
use rayon::prelude::*;

use self::films::Films;
use self::kept::{ArmRecord, Record};
use self::report::{Arm, Comparison, OfObject};
use crate::evaluate::args::EvaluateArgs;
use crate::files::{self, OpenWorld, Sources};
use crate::imitator::{self, Imitation, Imitator};
use crate::policy::{Policy, Watch};
use crate::search::Expert;
use crate::task::{self, OpenTask};

/// Name of the arm that all others are compared with.
const POLICY: &str = "policy";

/// What moves the robot in one arm of a comparison.
#[derive(Clone, Debug, PartialEq)]
enum Mover {
    Script,
    /// The searching expert that has learned with these senses.
    Search(Senses),
    /// The searching expert, told where the object is.
    Oracle,
    /// A policy that was learned, in a file or folder.
    Learned(String),
    /// A policy that imitates an expert, in a file or folder.
    Cloned(String),
}

impl Mover {
    fn parse(text: &str) -> Self {
        match text {
            "script" => Self::Script,
            "search" => Self::Search(Senses::BOTH),
            "search:touch" => Self::Search(Senses { touch: true, tracking: false }),
            "search:tracking" => Self::Search(Senses { touch: false, tracking: true }),
            // Which places come next then follows from the time alone.
            "search:none" | "repetition" => Self::Search(Senses::NONE),
            "oracle" => Self::Oracle,
            path => match path.strip_prefix("clone:") {
                Some(path) => Self::Cloned(path.to_owned()),
                None => Self::Learned(path.to_owned()),
            },
        }
    }

    /// What it gets to know when nothing is taken away.
    fn known(&self) -> Known {
        match self {
            Self::Script | Self::Learned(_) | Self::Cloned(_) => Known::ROBOT,
            Self::Search(senses) => Known { touch: senses.touch, tracking: senses.tracking, place: false },
            Self::Oracle => Known { place: true, ..Known::ROBOT },
        }
    }
}

/// One arm of a comparison: what moves the robot, and what that gets to know.
struct Contestant {
    name: String,
    /// What moves the robot, as the command names it.
    policy: String,
    mover: Mover,
    known: Known,
}

/// The arms of a comparison, the policy first.
fn arms(args: &EvaluateArgs) -> anyhow::Result<Vec<Contestant>> {
    let arm = |name: &str, policy: &str, mover: &Mover, known: Known| Contestant {
        name: name.to_owned(),
        policy: policy.to_owned(),
        mover: mover.clone(),
        known,
    };
    let policy = Mover::parse(&args.policy);
    let whole = policy.known();
    let known = Known {
        touch: whole.touch && !args.task.scene.silence_touch,
        tracking: whole.tracking && !args.hide_tracking,
        ..whole
    };
    let mut arms = vec![arm(POLICY, &args.policy, &policy, known)];
    if args.controls {
        for name in ["script", "repetition", "oracle"] {
            let mover = Mover::parse(name);
            arms.push(arm(name, name, &mover, mover.known()));
        }
        for (name, known) in [
            ("silenced", Known { touch: false, ..known }),
            ("tracking_hidden", Known { tracking: false, ..known }),
            ("clock_only", Known { touch: false, tracking: false, ..known }),
        ] {
            arms.push(arm(name, &args.policy, &policy, known));
        }
    }
    for text in &args.beside {
        let mover = Mover::parse(text);
        arms.push(arm(text, text, &mover, mover.known()));
    }
    let twice =
        arms.iter().enumerate().find(|(idx, arm)| arms[..*idx].iter().any(|one| one.name == arm.name));
    if let Some((_, arm)) = twice {
        bail!("{:?} is compared twice; leave one --beside out", arm.name);
    }
    Ok(arms)
}

/// What an arm needs in the world of one object.
enum Ready {
    Scripted(Arc<Script>),
    Searching { expert: Arc<Expert>, experience: Arc<Experience>, prior: Prior },
    Learned { policy: Box<Policy>, opened: OpenTask, tracking_hidden: bool },
    Cloned(Imitation),
}

pub(crate) fn run(args: &EvaluateArgs) -> anyhow::Result<()> {
    let began = Instant::now();
    if let Some(out) = &args.out {
        files::check_out(out)?;
    }
    if let Some(folder) = &args.by_object {
        std::fs::create_dir_all(folder).with_context(|| format!("failed to create {folder:?}"))?;
    }
    if let Some(folder) = &args.pictures {
        std::fs::create_dir_all(folder).with_context(|| format!("failed to create {folder:?}"))?;
    }
    let mut films = args.films.as_deref().map(Films::begin).transpose()?;
    if args.task.scene.start_cm.is_some() {
        bail!("--start-cm and --protocol exclude each other: a protocol says where objects start");
    }
    let sources = Sources::default();
    let (name, mut protocol) = files::protocol(args.protocol.as_deref().unwrap_or_default(), &sources)?;
    protocol.trials = args.trials.unwrap_or(protocol.trials);
    protocol.seed = args.seed.unwrap_or(protocol.seed);
    let objects = files::objects(args.objects.as_deref().unwrap_or(&args.task.scene.object))?;
    let arms = arms(args)?;
    files::start_threads(args.task.scene.threads)?;
    let mut experiences = Experiences::default();
    let (bar, done) = (Bar::new(), AtomicU64::new(0));
    let all = protocol.trials * (objects.len() * arms.len()) as u64;
    // That of every object's world.
    let mut station = None;
    let mut endings: Vec<Vec<OfObject>> = arms.iter().map(|_| Vec::new()).collect();
    for object in &objects {
        let mut of_object = Bench::open(args, object, &protocol)?;
        let ready = arms
            .iter()
            .map(|arm| of_object.ready(args, &arm.mover, arm.known, &protocol, &mut experiences))
            .collect::<anyhow::Result<Vec<Ready>>>()?;
        let kept = args.by_object.as_ref().map(|folder| {
            let record = of_object.record(args, &protocol, &arms);
            (kept::path(folder, &record.object), record)
        });
        let found = match &kept {
            Some((path, record)) => kept::read(path, record)?,
            None => None,
        };
        let of_arms = if let Some(found) = found {
            done.fetch_add(protocol.trials * arms.len() as u64, Ordering::Relaxed);
            bar.line(&format!("{}: {} trials are there already", of_object.id(), protocol.trials));
            found
        } else {
            let mut of_arms = Vec::with_capacity(arms.len());
            for (arm, ready) in arms.iter().zip(&ready) {
                let scene = of_object.scene_for(arm.known);
                let trials = (0..protocol.trials)
                    .into_par_iter()
                    .map(|trial| {
                        let ending = ready.run(scene, arm.known, protocol.seed, trial)?;
                        let done = done.fetch_add(1, Ordering::Relaxed) + 1;
                        bar.report(done as f64 / all as f64, "trials");
                        Ok(ending)
                    })
                    .collect::<anyhow::Result<Vec<Ending>>>()?;
                of_arms.push(trials);
            }
            if let Some((path, record)) = kept {
                kept::write(&path, record, &of_arms)?;
            }
            of_arms
        };
        if let Some(films) = &mut films {
            films.know(of_object.id(), files::object_files(object)?);
        }
        if args.pictures.is_some() || films.is_some() {
            for ((arm, ready), trials) in arms.iter().zip(&ready).zip(&of_arms) {
                let scene = of_object.scene_for(arm.known);
                let folder = args.pictures.as_deref();
                picture::of_trials(folder, &mut films, arm, ready, scene, &protocol, trials)?;
            }
        }
        station = Some(Arc::clone(&of_object.world.station));
        let group = of_object.scene.object().group;
        for (trials, endings) in of_arms.into_iter().zip(&mut endings) {
            endings.push(OfObject { id: of_object.id(), group, trials });
        }
        of_object.sources.list().into_iter().for_each(|source| sources.keep(source));
    }
    if let (Some(films), Some(station)) = (films, &station) {
        films.finish(station)?;
    }
    drop(bar);
    let arms = arms.into_iter().zip(endings).map(|(arm, objects)| Arm { name: arm.name, objects }).collect();
    let comparison = Comparison {
        protocol_name: name,
        protocol,
        policy: args.policy.clone(),
        arms,
        sources: sources.into_list(),
        seconds: began.elapsed().as_secs_f64(),
    };
    if let Some(out) = &args.out {
        let text = serde_json::to_string_pretty(&comparison.document(true))?;
        files::write_in_one_move(out, format!("{text}\n").as_bytes())?;
    }
    events::report(&comparison.document(false));
    if args.task.scene.json {
        println!("{}", serde_json::to_string_pretty(&comparison.document(false))?);
    } else if !events::are_printed() {
        print!("{}", comparison.text());
    }
    Ok(())
}

/// One object in the world of a protocol.
struct Bench {
    object: String,
    world: OpenWorld,
    script: Script,
    scene: Arc<GraspScene>,
    without_touch: Arc<GraspScene>,
    expert: Option<Arc<Expert>>,
    sources: Sources,
}

impl Bench {
    fn open(args: &EvaluateArgs, object: &str, protocol: &Protocol) -> anyhow::Result<Self> {
        let sources = Sources::default();
        let mut world = files::open_world(&args.task.scene, &sources)?;
        protocol.apply(&mut world.config);
        let model = files::object(object, &sources)?;
        let script =
            files::script(&path_for(&files::shown(&args.task.scene.script), &model.id), &world, &sources)?;
        Ok(Self {
            object: object.to_owned(),
            scene: Arc::new(world.scene(&model)?),
            without_touch: Arc::new(world.scene_without_touch(&model)?),
            world,
            script,
            expert: None,
            sources,
        })
    }

    fn id(&self) -> String {
        self.scene.object().id.clone()
    }

    /// What a trial of somebody who knows this is simulated in: nobody computes touch that nobody feels.
    fn scene_for(&self, known: Known) -> &Arc<GraspScene> {
        if known.touch { &self.scene } else { &self.without_touch }
    }

    /// What trials of `arms` are made with, once these are ready.
    fn record(&self, args: &EvaluateArgs, protocol: &Protocol, arms: &[Contestant]) -> Record {
        let of_arm = |arm: &Contestant| ArmRecord {
            name: arm.name.clone(),
            policy: arm.policy.clone(),
            known: arm.known,
        };
        Record {
            object: self.id(),
            protocol: protocol.clone(),
            arms: arms.iter().map(of_arm).collect(),
            know_shape: args.know_shape,
            without_script: args.task.without_script,
            sources: self.sources.list(),
        }
    }

    /// Makes `mover` ready to run.
    fn ready(
        &mut self,
        args: &EvaluateArgs,
        mover: &Mover,
        known: Known,
        protocol: &Protocol,
        experiences: &mut Experiences,
    ) -> anyhow::Result<Ready> {
        let id = self.id();
        match mover {
            Mover::Script => Ok(Ready::Scripted(Arc::new(self.script.clone()))),
            Mover::Search(_) | Mover::Oracle => {
                let senses = if let Mover::Search(senses) = mover { *senses } else { Senses::BOTH };
                let expert = self.expert(args)?;
                let shape = if args.know_shape {
                    let shape = expert.shape(&id);
                    Some(shape.with_context(|| {
                        format!("--know-shape, but there are no closings on {id:?} in {:?}", args.closings)
                    })?)
                } else {
                    None
                };
                let closings = path_for(&files::shown(&args.closings), &id);
                let experience = experiences.of(&closings, senses, &expert)?;
                let prior = Prior { half_width_m: protocol.half_width_m, shape };
                Ok(Ready::Searching { expert, experience, prior })
            }
            Mover::Learned(path) => {
                // A policy is tied to the files of one object, so these are read again on their own.
                let sources = Sources::default();
                let world = files::open_world(&args.task.scene, &sources)?;
                let model = files::object(&self.object, &sources)?;
                let script = files::script(
                    &path_for(&files::shown(&args.task.scene.script), &model.id),
                    &world,
                    &sources,
                )?;
                let scene = self.scene_for(known);
                let opened = task::of(&args.task, Arc::clone(scene), script, sources)?;
                let (policy, source) = Policy::open(&path_for(path, &id), &opened)?;
                self.sources.keep(source);
                Ok(Ready::Learned { policy: Box::new(policy), opened, tracking_hidden: !known.tracking })
            }
            Mover::Cloned(path) => {
                let (policy, source) =
                    imitator::open(&path_for(path, &id), &self.world.station, &self.world.config)?;
                self.sources.keep(source);
                Ok(Ready::Cloned(policy))
            }
        }
    }

    fn expert(&mut self, args: &EvaluateArgs) -> anyhow::Result<Arc<Expert>> {
        if let Some(expert) = &self.expert {
            return Ok(Arc::clone(expert));
        }
        let id = &self.scene.object().id;
        let expert = Arc::new(Expert::open(
            &args.search,
            &path_for(&files::shown(&args.closings), id),
            &self.world.station,
            &self.world.config,
            &self.sources,
        )?);
        self.expert = Some(Arc::clone(&expert));
        Ok(expert)
    }
}

/// `path` with the object's name in it where it says {object}.
fn path_for(path: &str, object: &str) -> PathBuf {
    PathBuf::from(path.replace("{object}", object))
}

/// Experiences by file and senses: making one takes a second.
#[derive(Default)]
struct Experiences(Vec<(PathBuf, Senses, Arc<Experience>)>);

impl Experiences {
    fn of(&mut self, path: &Path, senses: Senses, expert: &Expert) -> anyhow::Result<Arc<Experience>> {
        let known = self.0.iter().find(|(of, with, _)| of == path && *with == senses);
        if let Some((.., experience)) = known {
            return Ok(Arc::clone(experience));
        }
        let experience = expert.experience(senses)?;
        self.0.push((path.to_owned(), senses, Arc::clone(&experience)));
        Ok(experience)
    }
}

impl Ready {
    fn run(&self, scene: &Arc<GraspScene>, known: Known, seed: u64, trial: u64) -> anyhow::Result<Ending> {
        self.run_seen(scene, known, seed, trial, &mut |_| ()).map(|(ending, _)| ending)
    }

    /// The same trial, to the same bits, with `see` shown its beginning and what came of each control step; also what a
    /// searching expert believed before each of its tries, and when, s.
    fn run_seen(
        &self,
        scene: &Arc<GraspScene>,
        known: Known,
        seed: u64,
        trial: u64,
        see: &mut dyn FnMut(&GraspEnv),
    ) -> anyhow::Result<(Ending, Vec<(f64, Belief)>)> {
        let conduct = |controller: &mut dyn Controller, see: &mut dyn FnMut(&GraspEnv)| {
            conduct_seen(scene, controller, known, seed, trial, see)
        };
        match self {
            Self::Scripted(script) => {
                let config = Arc::new(scene.config().clone());
                let mut scripted = Scripted::new(Arc::clone(script), Arc::clone(scene.station()), config);
                Ok((conduct(&mut scripted, see)?, Vec::new()))
            }
            Self::Searching { expert, experience, prior } => {
                let searcher = Searcher::new(Arc::clone(&expert.skill), Arc::clone(experience), prior);
                let mut searcher = Remembering { searcher, beliefs: Vec::new() };
                let ending = conduct(&mut searcher, see)?;
                Ok((ending, searcher.beliefs))
            }
            Self::Cloned(policy) => {
                let half_width_m = scene.config().task.half_width_m;
                let mut imitator = Imitator::new(policy, Arc::clone(scene.station()), trial, half_width_m)?;
                let ending = conduct(&mut imitator, see)?;
                imitator.problem.map_or(Ok((ending, Vec::new())), Err)
            }
            Self::Learned { policy, opened, tracking_hidden } => {
                let mut env = LearnEnv::for_trials(Arc::clone(&opened.task))?;
                env.hide_tracking(*tracking_hidden);
                env.begin_trial(seed, trial, Conditions::Evaluation)?;
                see(env.grasp());
                let outcome = policy.run(&mut env, &mut Seen(see))?;
                let ending = Ending { outcome, time_s: env.grasp().time_s(), claimed: false };
                Ok((ending, Vec::new()))
            }
        }
    }
}

/// Shows every step of a trial to somebody.
struct Seen<'a>(&'a mut dyn FnMut(&GraspEnv));

impl Watch for Seen<'_> {
    fn before(&mut self, _: &LearnEnv, _: &[f32], _: &[f32]) {}

    fn after(&mut self, env: &LearnEnv) {
        (self.0)(env.grasp());
    }
}

/// A searching expert whose beliefs are kept.
struct Remembering {
    searcher: Searcher,
    beliefs: Vec<(f64, Belief)>,
}

impl Controller for Remembering {
    fn control(&mut self, now: &Observation<'_>) -> Command {
        let command = self.searcher.control(now);
        if self.searcher.num_tries() > self.beliefs.len() {
            self.beliefs.push((now.time_s, self.searcher.belief().clone()));
        }
        command
    }
}

/// Whether an object belongs to a group.
fn is_in(group: Option<ObjectGroup>, wanted: ObjectGroup) -> bool {
    group == Some(wanted)
}
