//! What requests share, and the socket.

use std::{
    net::SocketAddr,
    path::{Path, PathBuf},
    sync::Arc,
};

use axum::serve::ListenerExt as _;
use palpate_emulator::devices::StationControl;
use tokio::{net::TcpListener, sync::watch};

use crate::{
    Error, Hub, Store, app,
    library::Library,
    live::{Live, LiveStation},
    page,
    runs::{Calibrations, Diagnoses, Queue, Runs},
};

/// How to serve.
#[derive(Clone, Debug)]
pub struct ServeConfig {
    /// Address to listen on; port 0 takes any free one.
    pub listen: SocketAddr,
    /// Where sessions, models and runs are kept.
    pub data: PathBuf,
    /// The station to run, if one is.
    pub station: Option<LiveStation>,
}

/// What requests share.
pub struct AppState {
    store: Arc<Store>,
    library: Arc<Library>,
    hub: Arc<Hub>,
    calibrations: Runs<Calibrations>,
    diagnoses: Runs<Diagnoses>,
    live: Option<Live>,
    shutdown: watch::Sender<bool>,
}

impl AppState {
    /// Opens the data folder `data`, and the live station if there is one.
    pub fn open(data: &Path, station: Option<&LiveStation>) -> Result<Arc<Self>, Error> {
        let store = Arc::new(Store::open(data)?);
        let library = Arc::new(Library::default());
        let hub = Arc::new(Hub::default());
        let queue = Queue::start()?;
        let calibrations = Runs::open(store.clone(), library.clone(), hub.clone(), queue.clone())?;
        let diagnoses = Runs::open(store.clone(), library.clone(), hub.clone(), queue)?;
        let live = station.map(|station| Live::start(station, 0, &store, hub.clone())).transpose()?;
        Ok(Arc::new(Self {
            store,
            library,
            hub,
            calibrations,
            diagnoses,
            live,
            shutdown: watch::Sender::new(false),
        }))
    }

    /// Where live frames and job updates go.
    pub fn hub(&self) -> &Hub {
        &self.hub
    }

    /// What is truly going on at an emulated station; `None` for a real one or none.
    pub fn emulated_station(&self) -> Option<&StationControl> {
        Some(self.live()?.emulated()?.control())
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

/// Serves until `stop` completes. `ready` learns the real address.
pub async fn serve(
    config: ServeConfig,
    ready: impl FnOnce(SocketAddr),
    stop: impl Future<Output = ()> + Send + 'static,
) -> Result<(), Error> {
    let ServeConfig { listen, data, station } = config;
    let state = AppState::open(&data, station.as_ref())?;
    let failed_to = |action: &'static str| {
        move |err: std::io::Error| {
            Error::Argument(format!("failed to {action} {listen}: {err}; try another port"))
        }
    };
    let listener = TcpListener::bind(listen).await.map_err(failed_to("listen on"))?;
    if !page::is_built() {
        tracing::warn!("built without the page; `cargo xtask build` builds a binary that has it");
    }
    ready(listener.local_addr().map_err(failed_to("listen on"))?);
    let ending = state.clone();
    let stop = async move {
        stop.await;
        ending.begin_shutdown();
    };
    serve_on(listener, state, stop).await.map_err(|err| Error::Internal(format!("the server stopped: {err}")))
}

/// Serves `state` on `listener` until `stop` completes.
pub async fn serve_on(
    listener: TcpListener,
    state: Arc<AppState>,
    stop: impl Future<Output = ()> + Send + 'static,
) -> std::io::Result<()> {
    // Replies and frames are small, and late if they wait for more to be sent.
    let listener = listener.tap_io(|connection| {
        if let Err(err) = connection.set_nodelay(true) {
            tracing::debug!(%err, "a connection may delay small messages");
        }
    });
    axum::serve(listener, app(state)).with_graceful_shutdown(stop).await
}
