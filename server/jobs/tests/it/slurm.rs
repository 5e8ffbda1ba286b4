//! Jobs on a real Slurm of one node, which the tests start and end.

use std::{
    collections::BTreeMap,
    fs,
    net::TcpListener,
    path::{Path, PathBuf},
    process::{Command, Output, Stdio},
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    thread::sleep,
    time::{Duration, Instant},
};

use palpate_jobs::{Runner, SlurmConfig, SlurmRunner};
use palpate_wire::api::{JobState, Resources};
use serde_json::{Value, json};

use crate::support::{PATIENCE, PROBE, Scene, open, processes_naming, wait};

/// One cluster at a time: each wants the cores of the whole computer.
static TURN: Mutex<()> = Mutex::new(());

/// A cluster in a folder of its own: own key, own ports, loopback only, no systemd, no cgroups, no database.
pub(crate) struct Cluster {
    dir: tempfile::TempDir,
    conf: PathBuf,
    _turn: MutexGuard<'static, ()>,
}

/// What Slurm's daemons need to hear of this computer.
fn slurm_conf(dir: &Path, host: &str, ports: [u16; 2]) -> String {
    let (dir, [ctld, slurmd]) = (dir.display(), ports);
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    format!(
        "ClusterName=test\nSlurmctldHost={host}(127.0.0.1)\nSlurmctldPort={ctld}\nSlurmdPort={slurmd}\n\
         CommunicationParameters=NoInAddrAny,NoCtldInAddrAny\nAuthType=auth/munge\nAuthInfo=socket={dir}/run/munge.socket\n\
         CredType=cred/munge\nSlurmUser=root\nSlurmdUser=root\nStateSaveLocation={dir}/state\nSlurmdSpoolDir={dir}/spool\n\
         SlurmctldPidFile={dir}/run/slurmctld.pid\nSlurmdPidFile={dir}/run/slurmd.pid\n\
         SlurmctldLogFile={dir}/log/slurmctld.log\nSlurmdLogFile={dir}/log/slurmd.log\nProctrackType=proctrack/linuxproc\n\
         TaskPlugin=task/none\nJobAcctGatherType=jobacct_gather/none\nMpiDefault=none\nSwitchType=switch/none\n\
         SelectType=select/cons_tres\nSelectTypeParameters=CR_CPU\nSchedulerType=sched/backfill\n\
         SchedulerParameters=batch_sched_delay=0,sched_interval=2,sched_min_interval=0,bf_interval=2\nReturnToService=2\n\
         MinJobAge=3600\nKillWait=2\nMailProg=/bin/true\nAccountingStorageType=accounting_storage/none\n\
         NodeName={host} NodeAddr=127.0.0.1 CPUs={cores} RealMemory=1024 State=UNKNOWN\n\
         PartitionName=main Nodes={host} Default=YES MaxTime=INFINITE State=UP OverSubscribe=NO\n"
    )
}

impl Cluster {
    /// `None` where `PALPATE_SKIP` names slurm.
    pub(crate) fn start() -> Option<Self> {
        if skip::leaves_out("slurm") {
            return None;
        }
        let missing: Vec<&str> =
            ["/usr/sbin/slurmctld", "/usr/sbin/slurmd", "/usr/bin/sbatch", "/usr/sbin/munged"]
                .into_iter()
                .filter(|program| !Path::new(program).exists())
                .collect();
        assert!(
            missing.is_empty(),
            "{} are missing: `apt-get install --no-install-recommends slurmctld slurmd slurm-client munge`, or set \
             PALPATE_SKIP=slurm to leave out what needs a Slurm",
            missing.join(", ")
        );
        let turn = TURN.lock().unwrap_or_else(PoisonError::into_inner);
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().canonicalize().unwrap();
        for folder in ["state", "spool", "log", "run"] {
            fs::create_dir(path.join(folder)).unwrap();
        }
        let key: Vec<u8> = (0..128u32).map(|byte| (byte * 37 % 251) as u8).collect();
        fs::write(path.join("munge.key"), key).unwrap();
        sh(&path, "chmod 600 munge.key; chown munge:munge munge.key run log; chmod 755 . run");
        let host = String::from_utf8(output("hostname", &["-s"]).stdout).unwrap();
        let free = || TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
        let conf = path.join("slurm.conf");
        fs::write(&conf, slurm_conf(&path, host.trim(), [free(), free()])).unwrap();
        sh(
            &path,
            "runuser -u munge -- /usr/sbin/munged --key-file=$PWD/munge.key --socket=$PWD/run/munge.socket \
             --pid-file=$PWD/run/munged.pid --log-file=$PWD/log/munged.log --seed-file=$PWD/run/munged.seed --force",
        );
        let cluster = Self { dir, conf, _turn: turn };
        cluster.start_controller();
        sh(&path, &format!("SLURM_CONF={} /usr/sbin/slurmd", cluster.conf.display()));
        cluster.wait_until_idle();
        Some(cluster)
    }

    fn path(&self) -> PathBuf {
        self.dir.path().canonicalize().unwrap()
    }

    fn start_controller(&self) {
        sh(&self.path(), &format!("SLURM_CONF={} /usr/sbin/slurmctld -i", self.conf.display()));
    }

    fn wait_until_idle(&self) {
        let begun = Instant::now();
        loop {
            let answer = self.slurm("sinfo", &["-h", "-o", "%T"]);
            if answer.trim() == "idle" {
                return;
            }
            let logs = ["slurmctld", "slurmd"].map(|name| {
                fs::read_to_string(self.path().join(format!("log/{name}.log"))).unwrap_or_default()
            });
            assert!(begun.elapsed() < PATIENCE, "Slurm says {answer:?}; its logs: {logs:?}");
            sleep(Duration::from_millis(50));
        }
    }

    fn slurm(&self, program: &str, arguments: &[&str]) -> String {
        let output = Command::new(program).args(arguments).env("SLURM_CONF", &self.conf).output().unwrap();
        String::from_utf8_lossy(&output.stdout).into_owned()
    }

    fn runner(&self, data: &Path) -> Arc<dyn Runner> {
        let config = SlurmConfig {
            name: "cluster".to_owned(),
            program: PathBuf::from(PROBE),
            data: None,
            partition: Some("main".to_owned()),
            lines: vec!["#SBATCH --time=10".to_owned()],
            environment: BTreeMap::from([("SLURM_CONF".to_owned(), self.conf.display().to_string())]),
        };
        Arc::new(SlurmRunner::new(config, data).unwrap())
    }

    /// The same for `runners.toml`.
    pub(crate) fn runner_file(&self) -> String {
        format!(
            "[[slurm]]\nname = \"cluster\"\nprogram = {PROBE:?}\npartition = \"main\"\n\
             lines = [\"#SBATCH --time=10\"]\nenvironment = {{ SLURM_CONF = {:?} }}\n",
            self.conf.display().to_string()
        )
    }

    fn scene(&self) -> Scene {
        let dir = tempfile::tempdir().unwrap();
        let runner = self.runner(dir.path());
        Scene::in_dir(dir, vec![runner])
    }

    fn kill(&self, daemon: &str, signal: &str) {
        let path = self.path();
        sh(
            &path,
            &format!(
                "pid=$(cat run/{daemon}.pid 2>/dev/null) || exit 0; kill -{signal} $pid 2>/dev/null || exit 0; \
                 for i in $(seq 200); do kill -0 $pid 2>/dev/null || exit 0; sleep 0.05; done; exit 1"
            ),
        );
    }
}

impl Drop for Cluster {
    fn drop(&mut self) {
        self.slurm("scancel", &["--user=root"]);
        sleep(Duration::from_millis(300));
        for daemon in ["slurmd", "slurmctld", "munged"] {
            self.kill(daemon, "TERM");
        }
    }
}

fn sh(dir: &Path, script: &str) {
    // A daemon that kept a pipe open would be waited for.
    let status = Command::new("sh")
        .args(["-c", script])
        .current_dir(dir)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .status()
        .unwrap();
    assert!(status.success() || std::thread::panicking(), "{script}: {status}");
}

fn output(program: &str, arguments: &[&str]) -> Output {
    Command::new(program).args(arguments).output().unwrap()
}

#[test]
fn jobs_run_on_a_cluster_with_their_log_exit_and_cancel() {
    let Some(cluster) = Cluster::start() else { return };
    let scene = cluster.scene();
    let done = scene.submit(json!({ "sleep_ms": 300, "ledger": scene.ledger_path() })).id;
    let failed = scene.submit(json!({ "outcome": "fail" })).id;
    let died = scene.submit(json!({ "outcome": "abort" })).id;
    let job = scene.ended(&done);
    assert_eq!((job.state, job.runner.as_str(), job.attempts), (JobState::Done, "cluster", 1), "{job:?}");
    assert!(scene.scheduler.folder(&done).log_tail(10_000).unwrap().contains("working as attempt 1"));
    assert_eq!(scene.ledger().len(), 1);
    let named = cluster.slurm("squeue", &["-h", "-t", "all", "-o", "%j|%k"]);
    assert!(named.contains(&format!("-{done}-1|palpate:run:{done}")), "{named}");
    let job = scene.ended(&failed);
    assert_eq!((job.state, job.problem.as_deref()), (JobState::Failed, Some("it was told to fail")));
    let job = scene.ended(&died);
    let problem = job.problem.unwrap();
    assert!(job.state == JobState::Failed && problem.contains("Slurm says FAILED"), "{problem}");

    // An array: a task that fails stops the others, and is begun again without those that are done.
    let ledger = json!({ "ledger": scene.ledger_path() });
    let one = Resources { cores: 1, ..Resources::default() };
    let hangs = json!({ "sleep_ms": 600_000, "unless": scene.dir.path().join("mended") });
    let fails = json!({ "outcome": "fail", "unless": scene.dir.path().join("mended") });
    let limited = Resources { at_once: 2, ..one };
    let divided = scene.submit_divided(
        ledger.clone(),
        limited,
        vec![ledger.clone(), merged(&hangs, &ledger), merged(&fails, &ledger)],
    );
    let job = scene.ended(&divided.id);
    assert_eq!((job.state, job.problem.as_deref()), (JobState::Failed, Some("shard 2: it was told to fail")));
    assert!(scene.scheduler.folder(&divided.id).log_tail(10_000).unwrap().contains("working as attempt 1"));
    let named = cluster.slurm("squeue", &["-h", "-r", "-t", "all", "-o", "%j|%k|%K"]);
    let task = format!("-{0}-shards-1|palpate:run:{0}|2", divided.id);
    assert!(named.contains(&task), "{named}");
    assert_eq!(scene.ledger().len(), 2, "shard 0 is done: {:?}", scene.ledger());
    fs::write(scene.dir.path().join("mended"), "").unwrap();
    scene.scheduler.retry(&divided.id).unwrap();
    let job = scene.ended(&divided.id);
    assert_eq!((job.state, job.attempts, job.fraction), (JobState::Done, 2, 1.0), "{job:?}");
    let runs = format!("{}/runs/", scene.dir.path().canonicalize().unwrap().display());
    let done: Vec<String> = scene.ledger()[1..].iter().map(|line| line.replace(&runs, "")).collect();
    let shard = |shard: u32, attempt: u32| format!("{}/shards/{shard} {attempt}", divided.id);
    assert_eq!(done[0], shard(0, 1), "{done:?}");
    assert!(done[1..3].contains(&shard(1, 17)) && done[1..3].contains(&shard(2, 17)), "{done:?}");
    assert_eq!(done[3..], [format!("{} 2", divided.id)]);

    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let running: Vec<String> =
        (0..cores).map(|_| scene.submit(json!({ "sleep_ms": 600_000, "deaf": true })).id).collect();
    for id in &running {
        scene.wait(id, |job| job.stage == "sleeping");
    }
    let waits = scene.submit(json!({ "ledger": scene.ledger_path() })).id;
    let stage = scene.wait(&waits, |job| job.stage.starts_with("waiting in Slurm")).stage;
    assert!(stage.contains("Resources") || stage.contains("Priority") || stage.contains("None"), "{stage}");
    let array = scene.submit_divided(ledger.clone(), one, vec![ledger; 4]).id;
    scene.wait(&array, |job| job.stage == "0 of 4 shards done, 0 at work, 4 waiting");
    for id in running.iter().chain([&waits, &array]) {
        scene.scheduler.cancel(id).unwrap();
    }
    for id in running.iter().chain([&waits, &array]) {
        assert_eq!(scene.ended(id).state, JobState::Cancelled, "{id}");
    }
    assert_eq!(scene.ledger().len(), 5);
    let begun = Instant::now();
    while !processes_naming(scene.dir.path().to_str().unwrap()).is_empty() {
        assert!(begun.elapsed() < PATIENCE, "Slurm leaves processes");
        sleep(Duration::from_millis(50));
    }
}

fn merged(one: &Value, other: &Value) -> Value {
    let mut fields = one.as_object().unwrap().clone();
    fields.extend(other.as_object().unwrap().clone());
    Value::Object(fields)
}

#[test]
fn job_on_a_cluster_is_found_by_its_name_after_a_crash_of_the_studio() {
    let Some(cluster) = Cluster::start() else { return };
    let scene = cluster.scene();
    let id = scene.submit(json!({ "sleep_ms": 2500, "ledger": scene.ledger_path() })).id;
    scene.wait(&id, |job| job.stage == "sleeping");
    scene.scheduler.stop();
    // As a studio that was killed right after sbatch leaves it: nobody wrote down Slurm's number.
    let database = rusqlite::Connection::open(scene.dir.path().join("palpate.sqlite")).unwrap();
    assert_eq!(database.execute("UPDATE jobs SET handle = NULL WHERE handle IS NOT NULL", []).unwrap(), 1);
    drop(database);
    let (again, _) = open(scene.dir.path(), vec![cluster.runner(scene.dir.path())]);
    let job = wait(&again, &id, |job| !job.is_unfinished());
    assert_eq!((job.state, job.attempts), (JobState::Done, 1), "{job:?}");
    assert_eq!(scene.ledger().len(), 1, "{:?}", scene.ledger());
}

#[test]
fn controller_that_forgets_a_job_and_gives_its_number_again_confuses_nobody() {
    let Some(cluster) = Cluster::start() else { return };
    let scene = cluster.scene();
    let forgotten = scene.submit(json!({ "sleep_ms": 8000, "ledger": scene.ledger_path() })).id;
    scene.wait(&forgotten, |job| job.stage == "sleeping");
    // Its state is written every few seconds only; what it knew is lost with certainty when the files are.
    cluster.kill("slurmctld", "KILL");
    fs::remove_dir_all(cluster.path().join("state")).unwrap();
    fs::create_dir(cluster.path().join("state")).unwrap();
    cluster.start_controller();
    cluster.wait_until_answers();
    let later = scene.submit(json!({ "sleep_ms": 100, "ledger": scene.ledger_path() })).id;
    let job = scene.ended(&later);
    assert_eq!((job.state, job.attempts), (JobState::Done, 1), "{job:?}");
    let job = scene.ended(&forgotten);
    // The controller may end processes that it does not know; then the job was lost, and is done by its next attempt.
    assert!(job.state == JobState::Done && job.attempts <= 2, "{job:?}");
    assert_eq!(scene.ledger().len(), 2, "{:?}", scene.ledger());
}

impl Cluster {
    fn wait_until_answers(&self) {
        let begun = Instant::now();
        while self.slurm("sinfo", &["-h", "-o", "%T"]).trim().is_empty() {
            assert!(begun.elapsed() < PATIENCE, "the controller does not come back");
            sleep(Duration::from_millis(50));
        }
    }
}
