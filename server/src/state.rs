//! What requests share.

use std::{
    path::{Path, PathBuf},
    sync::Arc,
    thread,
    time::Duration,
};

use palpate_control::{AuditFile, AuditRotation};
use palpate_emulator::StationControl;
use palpate_people::{LoginLimits, People};
use palpate_trials::Campaigns;
use tokio::sync::watch;

use crate::{
    Error, Hub, Store, assets,
    data::{database::open_people, index::TakeIndex, library::Library},
    jobs::{
        board::Jobs,
        runs::{Calibrations, Diagnoses, Runs},
        trainer::Trainer,
        way_in::WayIn,
    },
    station::{Live, LiveStation, RunningStation},
    work::Work,
};

/// Who may come in, who is told about it, and what runs jobs.
#[derive(Clone, Debug, Default)]
pub struct Access {
    /// Host names by which the server is known, besides `localhost` and addresses.
    pub hosts: Vec<String>,
    /// Origins of other pages that may watch over Foxglove's protocol.
    pub foxglove_origins: Vec<String>,
    /// It listens beyond this computer without a login; the page says so.
    pub insecure: bool,
    /// Everybody has to log in; without, whoever gets in is the local operator.
    pub login: bool,
    /// Requests come from a proxy on the way, which says in `X-Forwarded-For` from where it has them.
    pub behind_proxy: bool,
    /// Where jobs of this computer reach it without TLS; without, no job can move the robot.
    pub own_url: Option<String>,
    /// The `palpate` program that jobs run as; without, the one that runs now.
    pub program: Option<PathBuf>,
    /// The `palpate-train` program; without, it is looked for beside `palpate` and on `PATH`.
    pub train: Option<PathBuf>,
    /// Socket of the operator of an emulated station, who places objects for jobs that move the robot.
    pub operator: Option<PathBuf>,
}

/// What requests share.
pub struct AppState {
    // The first to go: the folder is free once nothing starts jobs any more.
    jobs: Jobs,
    campaigns: Campaigns,
    store: Arc<Store>,
    library: Arc<Library>,
    hub: Arc<Hub>,
    live: Option<Live>,
    people: Arc<People>,
    logins: LoginLimits,
    audit: AuditFile,
    work: Work,
    access: Access,
    /// The path of the data folder, without links.
    data: PathBuf,
    shutdown: watch::Sender<bool>,
}

/// What requests share, and the station itself, which they only speak to: whoever has it ends it.
pub struct Studio {
    /// What requests share.
    pub state: Arc<AppState>,
    /// The station, if one is run. It ends when this is dropped.
    pub station: Option<RunningStation>,
}

impl Studio {
    /// Opens the data folder `data`, and the live station if there is one.
    pub fn open(data: &Path, station: Option<&LiveStation>, access: Access) -> Result<Self, Error> {
        let store = Arc::new(Store::open(data)?);
        let hub = Arc::new(Hub::default());
        let program = match &access.program {
            Some(program) => program.clone(),
            None => std::env::current_exe().map_err(Error::io("find", "this program"))?,
        };
        let trainer = Trainer { configured: access.train.clone(), palpate: Some(program) };
        let people = Arc::new(open_people(store.root())?);
        let way_in = WayIn {
            url: access.own_url.clone(),
            operator: access.operator.clone(),
            login: access.login,
            people: people.clone(),
        };
        let jobs = Jobs::open(store.clone(), hub.clone(), trainer, way_in)?;
        // After the database has been made.
        let library = Arc::new(Library::with_index(TakeIndex::open(store.root())?));
        look_after(&people)?;
        let audit_path = store.audit_path();
        let audit = AuditFile::open(&audit_path, AuditRotation::default())
            .map_err(Error::io("open the audit log", &audit_path))?;
        let work = Work::start()?;
        let campaigns = Campaigns::new(data.join("campaigns"), assets::published_results()?);
        let (live, station) = match station {
            Some(station) => {
                let (live, running) = Live::start(station, 0, &store, audit.clone(), hub.clone())?;
                (Some(live), Some(running))
            }
            None => (None, None),
        };
        let data = data.canonicalize().map_err(Error::io("open", data))?;
        let shutdown = watch::Sender::new(false);
        let logins = LoginLimits::default();
        let state = AppState {
            jobs,
            campaigns,
            store,
            library,
            hub,
            live,
            people,
            logins,
            audit,
            work,
            access,
            data,
            shutdown,
        };
        Ok(Self { state: Arc::new(state), station })
    }
}

/// How often people are looked after: what `palpate people` or `palpate tokens` revoked in another process is good for no
/// longer than this.
const LOOK_AFTER: Duration = Duration::from_secs(1);

/// Looks after people until they are dropped.
fn look_after(people: &Arc<People>) -> Result<(), Error> {
    let people = Arc::downgrade(people);
    let look = move || {
        let mut problem = String::new();
        while let Some(people) = people.upgrade() {
            let now = people.refresh(palpate_people::now_s()).err().map(|err| crate::chain(&err));
            let now = now.unwrap_or_default();
            if now != problem && !now.is_empty() {
                tracing::error!("{now}");
            }
            problem = now;
            drop(people);
            thread::sleep(LOOK_AFTER);
        }
    };
    thread::Builder::new()
        .name("people".to_owned())
        .spawn(look)
        .map_err(|err| Error::Internal(format!("failed to start a thread: {err}")))?;
    Ok(())
}

impl AppState {
    /// Where live frames and job updates go.
    pub fn hub(&self) -> &Hub {
        &self.hub
    }

    /// What is truly going on at an emulated station; `None` for a real one or none.
    pub fn emulated_station(&self) -> Option<&StationControl> {
        self.live()?.emulated()
    }

    pub(crate) fn store(&self) -> &Arc<Store> {
        &self.store
    }

    pub(crate) fn library(&self) -> &Library {
        &self.library
    }

    pub(crate) fn jobs(&self) -> &Jobs {
        &self.jobs
    }

    pub(crate) fn campaigns(&self) -> &Campaigns {
        &self.campaigns
    }

    pub(crate) fn calibrations(&self) -> Runs<'_, Calibrations> {
        Runs::of(&self.jobs)
    }

    pub(crate) fn diagnoses(&self) -> Runs<'_, Diagnoses> {
        Runs::of(&self.jobs)
    }

    pub(crate) fn live(&self) -> Option<&Live> {
        self.live.as_ref()
    }

    /// Who the people are.
    pub fn people(&self) -> &Arc<People> {
        &self.people
    }

    /// Attempts to log in.
    pub(crate) fn logins(&self) -> &LoginLimits {
        &self.logins
    }

    /// Who did what.
    pub(crate) fn audit(&self) -> &AuditFile {
        &self.audit
    }

    pub(crate) fn access(&self) -> &Access {
        &self.access
    }

    /// The path of the data folder, without links.
    pub(crate) fn data(&self) -> &Path {
        &self.data
    }

    pub(crate) fn work(&self) -> &Work {
        &self.work
    }

    /// Becomes true when the server ends.
    pub(crate) fn shutdown(&self) -> watch::Receiver<bool> {
        self.shutdown.subscribe()
    }

    /// Ends streams, and starts no job any more, so that the server can end. Jobs that run go on.
    pub fn begin_shutdown(&self) {
        self.shutdown.send_replace(true);
        self.jobs.scheduler().begin_to_stop();
    }
}
