//! Whatever is asked, killed and crashed in whatever order: no acknowledged job is lost, and none is done twice.

use std::panic::{AssertUnwindSafe, catch_unwind};

use palpate_wire::api::{JobExit, Resources};
use proptest::prelude::*;

use super::*;
use crate::runner::Capacity;

/// Processes, which outlive studios.
#[derive(Debug, Default)]
struct World {
    /// By job or shard and attempt.
    processes: BTreeMap<(String, u32), Process>,
    /// How often the work of each job and shard was done to the end.
    done: BTreeMap<String, u32>,
    /// The studio crashes when it next starts a process: before that, or after.
    crash: Option<Crash>,
    /// Number of the studio that runs now.
    studio: u32,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Crash {
    BeforeStart,
    AfterStart,
}

#[derive(Clone, Debug)]
struct Process {
    started_by: u32,
    is_alive: bool,
    is_asked: bool,
    exit: Option<JobState>,
    folder: JobFolder,
}

struct FakeRunner(Arc<Mutex<World>>);

impl Runner for FakeRunner {
    fn name(&self) -> &str {
        "process"
    }

    fn capacity(&self) -> Option<Capacity> {
        Some(Capacity { cores: 2, gpu: false, short_jobs: 1 })
    }

    fn submit(&self, launch: &Launch) -> Result<String, JobsError> {
        let crash = lock(&self.0).crash.take();
        launch.folder.begin_attempt(launch.attempt, &launch.folder.lock()?)?;
        assert_ne!(crash, Some(Crash::BeforeStart), "the studio is killed");
        {
            let mut world = lock(&self.0);
            let key = launch.key();
            let others = world.processes.iter().filter(|((id, _), process)| *id == key && process.is_alive);
            assert_eq!(others.count(), 0, "two processes work on {key}");
            let folder = launch.folder.clone();
            let process =
                Process { started_by: world.studio, is_alive: true, is_asked: false, exit: None, folder };
            let before = world.processes.insert((key.clone(), launch.attempt), process);
            assert!(before.is_none(), "attempt {} of {key} is begun twice", launch.attempt);
            let at_once = world.processes.values().filter(|process| process.is_alive).count();
            assert!(at_once <= 3, "{at_once} processes share 2 cores and the lane of short jobs");
        }
        assert_ne!(crash, Some(Crash::AfterStart), "the studio is killed");
        Ok("1".to_owned())
    }

    fn state(&self, launch: &Launch, _: Option<&str>) -> Result<RunState, JobsError> {
        let world = lock(&self.0);
        let known = world.processes.get(&(launch.key(), launch.attempt));
        let lost = || -> Result<RunState, JobsError> {
            if let Some(exit) = launch.folder.exit(launch.attempt) {
                return Ok(RunState::Ended(exit));
            }
            launch.folder.give_up_attempt(launch.attempt, &launch.folder.lock()?)?;
            Ok(RunState::Lost)
        };
        let Some(process) = known else { return lost() };
        Ok(match process.exit {
            Some(outcome) => RunState::Ended(exit(launch.attempt, outcome)),
            None if process.is_alive => RunState::Running,
            // Only who started it knows more.
            None if process.started_by == world.studio => RunState::Died("killed".to_owned()),
            None => lost()?,
        })
    }

    fn cancel(&self, launch: &Launch, _: Option<&str>, insists: bool) -> Result<(), JobsError> {
        let mut world = lock(&self.0);
        if let Some(process) = world.processes.get_mut(&(launch.key(), launch.attempt)) {
            process.is_asked = true;
            process.is_alive &= !insists;
        }
        Ok(())
    }
}

fn exit(attempt: u32, outcome: JobState) -> JobExit {
    JobExit {
        attempt,
        outcome,
        code: 0,
        problem: (outcome == JobState::Failed).then(|| "it was told to fail".to_owned()),
        started: rfc3339_now(),
        ended: rfc3339_now(),
        host: String::new(),
    }
}

#[derive(Clone, Debug)]
enum Step {
    Submit {
        short: bool,
        shards: u32,
    },
    Cancel(usize),
    Retry(usize),
    Delete(usize),
    Tick,
    /// A process ends.
    Finish(usize, Ending),
    /// The studio is killed between ticks and started again.
    Crash,
    /// It is killed while it starts a job, if one may start.
    CrashInTick(bool),
}

#[derive(Clone, Copy, Debug)]
enum Ending {
    Done,
    Failed,
    /// Because it was asked to, or by itself.
    Cancelled,
    Killed,
}

fn step() -> impl Strategy<Value = Step> {
    let ending =
        prop_oneof![Just(Ending::Done), Just(Ending::Failed), Just(Ending::Cancelled), Just(Ending::Killed)];
    prop_oneof![
        4 => (any::<bool>(), 0u32..8).prop_map(|(short, shards)| {
            // Half of all jobs are not divided.
            Step::Submit { short, shards: shards.saturating_sub(4) }
        }),
        2 => (0usize..8).prop_map(Step::Cancel),
        1 => (0usize..8).prop_map(Step::Retry),
        1 => (0usize..8).prop_map(Step::Delete),
        6 => Just(Step::Tick),
        4 => (0usize..3, ending).prop_map(|(which, ending)| Step::Finish(which, ending)),
        1 => Just(Step::Crash),
        1 => any::<bool>().prop_map(Step::CrashInTick),
    ]
}

struct Scene {
    dir: tempfile::TempDir,
    world: Arc<Mutex<World>>,
    scheduler: Option<Scheduler>,
    /// Acknowledged, in order.
    ids: Vec<String>,
    deleted: Vec<String>,
    cancelled: Vec<String>,
}

impl Scene {
    fn new() -> Self {
        let mut scene = Self {
            dir: tempfile::tempdir().unwrap(),
            world: Arc::default(),
            scheduler: None,
            ids: Vec::new(),
            deleted: Vec::new(),
            cancelled: Vec::new(),
        };
        scene.restart();
        scene
    }

    fn restart(&mut self) {
        drop(self.scheduler.take());
        let mut world = lock(&self.world);
        world.studio += 1;
        world.crash = None;
        drop(world);
        let database = Database::open(&self.dir.path().join("palpate.sqlite")).unwrap();
        let config = SchedulerConfig {
            runs: self.dir.path().join("runs"),
            trash: self.dir.path().join("trash"),
            database: Arc::new(database),
            runners: vec![Arc::new(FakeRunner(self.world.clone()))],
            observer: Arc::new(|_| {}),
            cancel_grace: Some(Duration::ZERO),
        };
        self.scheduler = Some(Scheduler::open(config).unwrap());
    }

    fn scheduler(&self) -> &Scheduler {
        self.scheduler.as_ref().unwrap()
    }

    fn submit(&mut self, short: bool) {
        self.submit_divided(short, 0);
    }

    fn submit_divided(&mut self, short: bool, shards: u32) {
        let mut spec = spec(short);
        spec.resources.shards = shards;
        let shards: Vec<Shard> = (0..shards)
            .map(|shard| Shard { request: serde_json::json!({ "part": shard }), seed: u64::from(shard) })
            .collect();
        let submission =
            Submission { prefix: "run-", spec: &spec, shards: &shards, owner: "me", runner: None, key: None };
        self.ids.push(self.scheduler().submit(&submission).unwrap().job.id);
    }

    fn finish(&self, which: usize, ending: Ending) {
        let mut world = lock(&self.world);
        let alive = world.processes.iter_mut().filter(|(_, process)| process.is_alive);
        let Some(((id, attempt), process)) = alive.into_iter().nth(which) else { return };
        let (id, attempt) = (id.clone(), *attempt);
        process.is_alive = false;
        process.exit = match ending {
            Ending::Done => Some(JobState::Done),
            Ending::Failed => Some(JobState::Failed),
            Ending::Cancelled => Some(JobState::Cancelled),
            Ending::Killed => None,
        };
        if let Some(outcome) = process.exit {
            process.folder.write_exit(&exit(attempt, outcome)).unwrap();
        }
        if matches!(ending, Ending::Done) {
            *world.done.entry(id).or_default() += 1;
        }
    }

    fn take(&mut self, step: &Step) {
        let id = |which: &usize| self.ids.get(*which).cloned();
        match step {
            Step::Submit { short, shards } => self.submit_divided(*short, *shards),
            Step::Cancel(which) => {
                if let Some(id) = id(which)
                    && self.scheduler().cancel(&id).is_ok()
                {
                    self.cancelled.push(id);
                }
            }
            Step::Retry(which) => {
                if let Some(id) = id(which)
                    && self.scheduler().retry(&id).is_ok()
                {
                    self.cancelled.retain(|cancelled| *cancelled != id);
                }
            }
            Step::Delete(which) => {
                if let Some(id) = id(which)
                    && self.scheduler().delete(&id).is_ok()
                {
                    assert!(self.dir.path().join("trash").join(&id).join("job.json").is_file());
                    self.deleted.push(id);
                }
            }
            Step::Tick => self.scheduler().tick(),
            Step::Finish(which, ending) => self.finish(*which, *ending),
            Step::Crash => self.restart(),
            Step::CrashInTick(after) => {
                lock(&self.world).crash = Some(if *after { Crash::AfterStart } else { Crash::BeforeStart });
                let _ = catch_unwind(AssertUnwindSafe(|| self.scheduler().tick()));
                self.restart();
            }
        }
    }

    fn check(&self) {
        let world = lock(&self.world);
        for id in &self.ids {
            let done = world.done.get(id).copied().unwrap_or(0);
            assert!(done <= 1, "{id} was done {done} times");
            if self.deleted.contains(id) {
                assert!(self.scheduler().job(id).is_err());
                continue;
            }
            let job = self.scheduler().job(id).unwrap();
            let of_shards = world.done.iter().filter(|(key, _)| key.starts_with(&format!("{id}/")));
            let of_shards: Vec<u32> = of_shards.map(|(_, &done)| done).collect();
            assert!(of_shards.iter().all(|&done| done <= 1), "shards of {id} were done {of_shards:?} times");
            if job.state == JobState::Done {
                assert_eq!(done, 1, "{id} is called done and is not");
                assert_eq!(of_shards.len(), job.spec.resources.shards as usize, "{job:?}");
            }
        }
    }

    /// Lets everything end; then each job has, and as it should.
    fn drain(&mut self) {
        for _ in 0..20 * (self.ids.len() + 1) {
            self.scheduler().tick();
            while lock(&self.world).processes.values().any(|process| process.is_alive) {
                self.finish(0, Ending::Done);
            }
        }
        self.scheduler().tick();
        self.check();
        let world = lock(&self.world);
        for id in self.ids.iter().filter(|id| !self.deleted.contains(id)) {
            let job = self.scheduler().job(id).unwrap();
            assert!(!job.is_unfinished(), "{job:?}");
            let done = world.done.get(id).copied().unwrap_or(0);
            assert_eq!(job.state == JobState::Done, done == 1, "{job:?} was done {done} times");
            if job.state == JobState::Cancelled {
                assert!(self.cancelled.contains(id), "nobody cancelled {id}");
            }
        }
    }
}

fn spec(short: bool) -> JobSpec {
    JobSpec {
        kind: "probe".to_owned(),
        request: serde_json::json!({ "work": 1 }),
        inputs: BTreeMap::new(),
        seed: 0,
        software: "test".to_owned(),
        priority: 0,
        resources: Resources { cores: 1, short, ..Resources::default() },
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn no_acknowledged_job_is_lost_or_done_twice(steps in proptest::collection::vec(step(), 1..40)) {
        let mut scene = Scene::new();
        for step in &steps {
            scene.take(step);
            scene.check();
        }
        scene.drain();
    }
}

#[test]
fn same_key_gives_the_same_job_and_another_request_with_it_is_refused() {
    let scene = Scene::new();
    let (one, mut two) = (spec(true), spec(true));
    two.seed = 7;
    let submit = |spec: &JobSpec, key| {
        let request = format!("seed {}", spec.seed);
        let key: Option<&str> = key;
        let key = key.map(|key| (key, request.as_str()));
        let submission = Submission { prefix: "run-", spec, shards: &[], owner: "me", runner: None, key };
        scene.scheduler().submit(&submission)
    };
    let first = submit(&one, Some("abc")).unwrap();
    let again = submit(&one, Some("abc")).unwrap();
    assert!(first.is_new && !again.is_new);
    assert_eq!(first.job.id, again.job.id);
    let known = scene.scheduler().job_of_key("abc", "seed 0").unwrap().unwrap();
    assert_eq!(known, again.job);
    assert_eq!(scene.scheduler().job_of_key("abd", "seed 0").unwrap(), None);
    assert!(matches!(scene.scheduler().job_of_key("abc", "seed 7"), Err(JobsError::KeyReused(_))));
    assert!(submit(&two, Some("abc")).unwrap_err().to_string().contains("another request"));
    assert_ne!(submit(&one, None).unwrap().job.id, first.job.id);
    scene.scheduler().cancel(&first.job.id).unwrap();
    scene.scheduler().delete(&first.job.id).unwrap();
    assert!(submit(&one, Some("abc")).unwrap_err().to_string().contains("has been deleted"));
}

#[test]
fn robot_moves_when_somebody_has_just_asked_for_it_or_not_at_all() {
    let mut scene = Scene::new();
    let mut trials = spec(false);
    trials.resources.station = true;
    let submit = |scene: &Scene| {
        let submission =
            Submission { prefix: "run-", spec: &trials, shards: &[], owner: "me", runner: None, key: None };
        scene.scheduler().submit(&submission).map(|submitted| submitted.job.id)
    };
    let state = |scene: &Scene, id: &str| scene.scheduler().job(id).unwrap().state;
    let first = submit(&scene).unwrap();
    assert!(submit(&scene).unwrap_err().to_string().contains("has the station"), "it would wait");
    scene.scheduler().tick();
    assert_eq!(state(&scene, &first), JobState::Running);

    // It was cut off while no studio was there.
    scene.finish(0, Ending::Killed);
    scene.restart();
    scene.scheduler().tick();
    assert_eq!(state(&scene, &first), JobState::Failed, "no attempt begins by itself");
    scene.scheduler().retry(&first).unwrap();
    assert!(submit(&scene).is_err());
    // The studio ends before it has begun.
    scene.restart();
    scene.scheduler().tick();
    assert_eq!(state(&scene, &first), JobState::Failed);
    let problem = scene.scheduler().job(&first).unwrap().problem.unwrap();
    assert!(problem.contains("when the robot may move"), "{problem}");
    scene.scheduler().retry(&first).unwrap();
    scene.scheduler().tick();
    assert_eq!(state(&scene, &first), JobState::Running, "somebody has asked again");
}

#[test]
fn numbers_are_given_once() {
    let mut scene = Scene::new();
    scene.submit(true);
    scene.submit(true);
    assert_eq!(scene.ids, ["run-1", "run-2"]);
    scene.scheduler().cancel("run-2").unwrap();
    scene.scheduler().delete("run-2").unwrap();
    scene.restart();
    scene.submit(true);
    assert_eq!(scene.ids[2], "run-3", "the trash may hold run-2");
}

#[test]
fn pages_follow_each_other_without_gaps() {
    let mut scene = Scene::new();
    (0..7).for_each(|_| scene.submit(true));
    scene.scheduler().cancel("run-4").unwrap();
    let mut filter = ListFilter { limit: Some(3), ..ListFilter::default() };
    let mut seen = Vec::new();
    loop {
        let page = scene.scheduler().list(&filter).unwrap();
        seen.extend(page.jobs.into_iter().map(|job| job.id));
        if page.next_cursor.is_none() {
            break;
        }
        filter.cursor = page.next_cursor;
    }
    assert_eq!(seen, ["run-7", "run-6", "run-5", "run-4", "run-3", "run-2", "run-1"]);
    let cancelled = ListFilter { state: Some(JobState::Cancelled), ..ListFilter::default() };
    let page = scene.scheduler().list(&cancelled).unwrap();
    assert_eq!((page.jobs.len(), page.jobs[0].id.as_str(), page.next_cursor), (1, "run-4", None));
    let nonsense = ListFilter { cursor: Some("x".to_owned()), ..ListFilter::default() };
    assert!(scene.scheduler().list(&nonsense).is_err());
}

#[test]
fn higher_priority_starts_first() {
    let mut scene = Scene::new();
    for priority in [0, 5, 5, -3] {
        let spec = JobSpec { priority, resources: Resources::default(), ..spec(false) };
        let submission =
            Submission { prefix: "run-", spec: &spec, shards: &[], owner: "me", runner: None, key: None };
        scene.ids.push(scene.scheduler().submit(&submission).unwrap().job.id);
    }
    let mut order = Vec::new();
    for _ in 0..4 {
        scene.scheduler().tick();
        let running = ListFilter { state: Some(JobState::Running), ..ListFilter::default() };
        let page = scene.scheduler().list(&running).unwrap();
        assert_eq!(page.jobs.len(), 1, "each takes all cores");
        order.push(page.jobs[0].id.clone());
        scene.finish(0, Ending::Done);
    }
    assert_eq!(order, ["run-2", "run-3", "run-1", "run-4"]);
}

#[test]
fn failed_shard_fails_the_job_and_what_others_have_done_is_not_done_again() {
    let mut scene = Scene::new();
    scene.submit_divided(false, 4);
    scene.scheduler().tick();
    scene.scheduler().tick();
    let work = |scene: &Scene| {
        let world = lock(&scene.world);
        world
            .processes
            .iter()
            .filter(|(_, at)| at.is_alive)
            .map(|((key, _), _)| key.clone())
            .collect::<Vec<_>>()
    };
    assert_eq!(work(&scene), ["run-1/0", "run-1/1"], "two cores, two shards");
    scene.finish(0, Ending::Done);
    scene.scheduler().tick();
    assert_eq!(work(&scene), ["run-1/1", "run-1/2"]);
    let job = scene.scheduler().job("run-1").unwrap();
    assert_eq!(
        (job.state, job.stage.as_str()),
        (JobState::Running, "1 of 4 shards done, 1 at work, 2 waiting")
    );
    assert!((job.fraction - 0.99 / 4.0).abs() < 1e-9, "{job:?}");

    fs::write(scene.scheduler().folder("run-1").shard(2).file("log.txt"), "error: the disk hums\n").unwrap();
    scene.finish(1, Ending::Failed);
    scene.scheduler().tick();
    assert!(
        lock(&scene.world).processes[&("run-1/1".to_owned(), 1)].is_asked,
        "the others are asked to stop"
    );
    scene.finish(0, Ending::Cancelled);
    scene.scheduler().tick();
    let job = scene.scheduler().job("run-1").unwrap();
    assert_eq!((job.state, job.problem.as_deref()), (JobState::Failed, Some("shard 2: it was told to fail")));
    let log = scene.scheduler().folder("run-1").log_tail(1000).unwrap();
    assert_eq!(log, "--- shard 2:\nerror: the disk hums\n");
    assert!(work(&scene).is_empty());

    scene.scheduler().retry("run-1").unwrap();
    scene.restart();
    scene.scheduler().tick();
    scene.scheduler().tick();
    assert_eq!(work(&scene), ["run-1/1", "run-1/2"], "shard 0 is done");
    // One process is killed while no studio looks: only it is begun again.
    scene.finish(1, Ending::Killed);
    scene.restart();
    scene.scheduler().tick();
    assert_eq!(work(&scene), ["run-1/1", "run-1/2"]);
    scene.drain();
    let world = lock(&scene.world);
    let attempts: Vec<(&str, u32)> = world.processes.keys().map(|(key, at)| (key.as_str(), *at)).collect();
    let shards =
        [("run-1/0", 1), ("run-1/1", 1), ("run-1/1", 17), ("run-1/2", 1), ("run-1/2", 17), ("run-1/2", 19)];
    assert_eq!(attempts, [&[("run-1", 2)], &shards[..], &[("run-1/3", 17)]].concat());
}

#[test]
fn shard_that_is_cut_off_again_and_again_fails_the_job() {
    let mut scene = Scene::new();
    scene.submit_divided(false, 1);
    let mut begun = 0;
    for _ in 0..40 {
        scene.scheduler().tick();
        begun += usize::from(lock(&scene.world).processes.values().any(|process| process.is_alive));
        scene.finish(0, Ending::Killed);
        scene.restart();
    }
    let job = scene.scheduler().job("run-1").unwrap();
    assert_eq!((job.state, begun), (JobState::Failed, 5), "{job:?}");
    assert!(job.problem.unwrap().starts_with("shard 0: it was cut off 5 times"));
}

#[test]
fn line_of_the_log_that_says_what_happened_is_found() {
    let log = "--- attempt 1 at 2026\nreading\nmemory allocation of 9 bytes failed\nstack backtrace:\n 0: alloc::handle_error\n";
    assert_eq!(telling_line(log), Some("memory allocation of 9 bytes failed"));
    assert_eq!(telling_line("--- attempt 1 at 2026\nreading\n\n"), Some("reading"));
    assert_eq!(telling_line("--- attempt 1 at 2026\n"), None);
}
