//! What requests share.

use std::{
    path::{Path, PathBuf},
    sync::Arc,
};

use palpate_emulator::devices::StationControl;
use tokio::sync::watch;

use crate::{
    Error, Hub, Store,
    data::library::Library,
    jobs::runs::{Calibrations, Diagnoses, Queue, Runs},
    station::{Live, LiveStation, RunningStation},
    work::Work,
};

/// Who may come in, and who is told about it.
#[derive(Clone, Debug, Default)]
pub struct Access {
    /// Host names by which the server is known, besides `localhost` and addresses.
    pub hosts: Vec<String>,
    /// It listens beyond this computer without a login; the page says so.
    pub insecure: bool,
}

/// What requests share.
pub struct AppState {
    store: Arc<Store>,
    library: Arc<Library>,
    hub: Arc<Hub>,
    calibrations: Runs<Calibrations>,
    diagnoses: Runs<Diagnoses>,
    live: Option<Live>,
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
        let library = Arc::new(Library::default());
        let hub = Arc::new(Hub::default());
        let queue = Queue::start()?;
        let calibrations = Runs::open(store.clone(), library.clone(), hub.clone(), queue.clone())?;
        let diagnoses = Runs::open(store.clone(), library.clone(), hub.clone(), queue)?;
        let work = Work::start()?;
        let (live, station) = match station {
            Some(station) => {
                let (live, running) = Live::start(station, 0, &store, hub.clone())?;
                (Some(live), Some(running))
            }
            None => (None, None),
        };
        let data = data.canonicalize().map_err(Error::io("open", data))?;
        let shutdown = watch::Sender::new(false);
        let state =
            AppState { store, library, hub, calibrations, diagnoses, live, work, access, data, shutdown };
        Ok(Self { state: Arc::new(state), station })
    }
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

    pub(crate) fn calibrations(&self) -> &Runs<Calibrations> {
        &self.calibrations
    }

    pub(crate) fn diagnoses(&self) -> &Runs<Diagnoses> {
        &self.diagnoses
    }

    pub(crate) fn live(&self) -> Option<&Live> {
        self.live.as_ref()
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

    /// Ends streams and runs, so that the server can end.
    pub fn begin_shutdown(&self) {
        self.shutdown.send_replace(true);
        self.calibrations.cancel_all();
        self.diagnoses.cancel_all();
    }
}
