//! Serving, from the first connection to an end that always ends.

use std::{
    net::SocketAddr,
    path::PathBuf,
    sync::Arc,
    time::{Duration, Instant},
};

use palpate_control::Ending;
use tokio::{net::TcpListener, sync::oneshot};

use crate::{
    Error, LiveStation, RunningStation, app,
    http::{listener, page},
    state::{Access, AppState, Studio},
};

/// The control loop takes 1.6 s at most to end all motion; one that has not said how it went after this has died.
const MOTION_PATIENCE: Duration = Duration::from_millis(1900);
/// What is recorded and the audit log get this long to be written, after motion has ended.
const FINISH_PATIENCE: Duration = Duration::from_millis(500);

/// How to serve.
#[derive(Clone, Debug)]
pub struct ServeConfig {
    /// Address to listen on; port 0 takes any free one.
    pub listen: SocketAddr,
    /// Where sessions, models and runs are kept.
    pub data: PathBuf,
    /// The station to run, if one is.
    pub station: Option<LiveStation>,
    /// Host names by which the server is known, besides `localhost` and addresses.
    pub hosts: Vec<String>,
    /// Listen beyond this computer though there is no login.
    pub insecure: bool,
}

/// How serving ended.
#[derive(Clone, Debug, Default)]
pub struct Served {
    /// How the motion of the station ended; `None` without one.
    pub motion: Option<Ending>,
    /// Whether everything that was recorded and logged is on disk.
    pub is_written: bool,
}

/// Serves until `stop` completes. Then motion ends before anything else does, whatever clients are up to; `motion_ended` is
/// told how. `ready` learns the real address.
pub async fn serve(
    config: ServeConfig,
    ready: impl FnOnce(SocketAddr),
    stop: impl Future<Output = ()> + Send + 'static,
    motion_ended: impl FnOnce(Option<&Ending>) + Send + 'static,
) -> Result<Served, Error> {
    let ServeConfig { listen, data, station, hosts, insecure } = config;
    let is_exposed = !listen.ip().is_loopback();
    if is_exposed && !insecure {
        return Err(Error::Argument(format!(
            "{listen} can be reached from other computers, and there is no login yet: anybody there could move the \
             robot. Listen on 127.0.0.1 and forward the port (ssh -L 8080:127.0.0.1:8080 THIS_COMPUTER), or say --insecure"
        )));
    }
    let failed_to = |action: &'static str| {
        move |err: std::io::Error| {
            Error::Argument(format!("failed to {action} {listen}: {err}; try another port"))
        }
    };
    let listener = TcpListener::bind(listen).await.map_err(failed_to("listen on"))?;
    let access = Access { hosts, insecure: is_exposed, program: None };
    let Studio { state, station } = Studio::open(&data, station.as_ref(), access)?;
    if is_exposed {
        tracing::warn!(%listen, "no login: anybody who reaches this address may take control of the robot");
    }
    if !page::is_built() {
        tracing::warn!("built without the page; `cargo xtask build` builds a binary that has it");
    }
    ready(listener.local_addr().map_err(failed_to("listen on"))?);
    let (tell, told) = oneshot::channel();
    let ending = state.clone();
    let stop = async move {
        stop.await;
        let ended = end_motion(station).await;
        motion_ended(ended.as_ref().map(|(motion, _)| motion));
        ending.begin_shutdown();
        // Whoever asked for the end waits for this.
        let _ = tell.send(ended);
    };
    listener::listen(listener, app(state), stop).await;
    let Ok(Some((motion, station))) = told.await else {
        return Ok(Served { motion: None, is_written: true });
    };
    let finish = move || station.finish(FINISH_PATIENCE);
    let is_written = on_own_thread("finish", finish).await.unwrap_or(false);
    Ok(Served { motion: Some(motion), is_written })
}

/// Serves `state` on `listener` until `stop` completes.
pub async fn serve_on(listener: TcpListener, state: Arc<AppState>, stop: impl Future<Output = ()>) {
    listener::listen(listener, app(state), stop).await;
}

/// Ends the motion of a station, if there is one. On a thread of its own: the runtime's may all be busy.
async fn end_motion(station: Option<RunningStation>) -> Option<(Ending, RunningStation)> {
    let station = station?;
    let begun = Instant::now();
    let ended = on_own_thread("end of motion", move || (station.end_motion(MOTION_PATIENCE), station)).await;
    let (motion, station) = ended?;
    let seconds = begun.elapsed().as_secs_f64();
    match motion.is_safe() {
        true => tracing::info!(seconds, "all motion has ended: {motion}"),
        false => tracing::error!(seconds, "the end of motion is not confirmed: {motion}"),
    }
    Some((motion, station))
}

/// Runs `work` on a new thread; `None` if there is none to be had or it panics.
async fn on_own_thread<T: Send + 'static>(
    name: &str,
    work: impl FnOnce() -> T + Send + 'static,
) -> Option<T> {
    let (tell, told) = oneshot::channel();
    let run = move || {
        // Whoever waits is this program's own end.
        let _ = tell.send(work());
    };
    if let Err(err) = std::thread::Builder::new().name(name.to_owned()).spawn(run) {
        tracing::error!(%err, name, "failed to start a thread");
    }
    told.await.ok()
}
