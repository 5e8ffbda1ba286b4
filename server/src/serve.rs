//! Serving, from the first connection to an end that always ends.

use std::{
    net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr},
    path::{Path, PathBuf},
    sync::Arc,
    time::{Duration, Instant},
};

use palpate_control::Ending;
use tokio::{net::TcpListener, sync::oneshot};

use crate::{
    Error, LiveStation, RunningStation, Tls, app,
    data::database::open_people,
    http::{listener, page},
    retention::{self, RetentionConfig},
    state::{Access, AppState, Studio},
    tls::{self, TlsIdentity},
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
    /// Origins of other pages that may watch over Foxglove's protocol.
    pub foxglove_origins: Vec<String>,
    /// Listen beyond this computer without login and TLS.
    pub insecure: bool,
    /// A proxy on the way has TLS and says from where requests come: everybody has to log in, whatever the address.
    pub behind_proxy: bool,
    /// Everybody has to log in, also on this computer.
    pub login: bool,
    /// Which certificate the studio shows.
    pub tls: Tls,
    /// The `palpate-train` program; without, it is looked for beside this one and on `PATH`.
    pub train: Option<PathBuf>,
    /// Socket of the operator of an emulated station (`palpate-train station`), who places objects and sees where they are.
    pub operator: Option<PathBuf>,
    /// What becomes of old jobs and of the trash.
    pub retention: RetentionConfig,
}

/// How a studio that is ready can be reached.
#[derive(Clone, Debug)]
pub struct Ready {
    /// The real address.
    pub address: SocketAddr,
    /// SHA-256 of the certificate, where there is TLS.
    pub fingerprint: Option<String>,
    /// Where the certificate is, if it is the studio's own.
    pub own_cert: Option<PathBuf>,
}

impl Ready {
    /// The address as a browser takes it.
    pub fn url(&self) -> String {
        let scheme = if self.fingerprint.is_some() { "https" } else { "http" };
        format!("{scheme}://{}", self.address)
    }
}

/// What an address and the words of whoever starts the studio come to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Security {
    needs_login: bool,
    has_tls: bool,
    /// Anybody in the network may take control.
    is_open: bool,
}

impl ServeConfig {
    /// Refuses what could not be served, without starting anything.
    pub fn check(&self) -> Result<(), Error> {
        let Security { needs_login, .. } = self.security()?;
        if let Tls::Files { cert, key } = &self.tls {
            TlsIdentity::of_files(cert, key)?;
        }
        if needs_login {
            refuse_nobody(&self.data, self.listen)?;
        }
        Ok(())
    }

    fn security(&self) -> Result<Security, Error> {
        let is_exposed = !self.listen.ip().is_loopback();
        if self.insecure && (self.behind_proxy || self.login) {
            return Err(Error::Argument(
                "--insecure means that nobody logs in; leave it out, or --behind-proxy and --login"
                    .to_owned(),
            ));
        }
        let guards = is_exposed && !self.insecure;
        Ok(Security {
            needs_login: guards || self.behind_proxy || self.login,
            has_tls: self.tls != Tls::Auto || (guards && !self.behind_proxy),
            is_open: is_exposed && self.insecure,
        })
    }
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
/// told how. `ready` learns how it is reached.
pub async fn serve(
    config: ServeConfig,
    ready: impl FnOnce(Ready),
    stop: impl Future<Output = ()> + Send + 'static,
    motion_ended: impl FnOnce(Option<&Ending>) + Send + 'static,
) -> Result<Served, Error> {
    let Security { needs_login, has_tls, is_open } = config.security()?;
    let ServeConfig {
        listen,
        data,
        station,
        hosts,
        foxglove_origins,
        behind_proxy,
        tls,
        train,
        operator,
        retention,
        ..
    } = config;
    let failed_to = |action: &'static str| {
        move |err: std::io::Error| {
            Error::Argument(format!("failed to {action} {listen}: {err}; try another port"))
        }
    };
    let listener = TcpListener::bind(listen).await.map_err(failed_to("listen on"))?;
    let address = listener.local_addr().map_err(failed_to("listen on"))?;
    let own = OwnDoor::open(address, has_tls).await?;
    let names = tls::names(listen, &hosts);
    let access = Access {
        hosts,
        foxglove_origins,
        insecure: is_open,
        login: needs_login,
        behind_proxy,
        own_url: Some(own.url()),
        program: None,
        train,
        // Jobs run in folders of their own.
        operator: operator
            .map(|path| std::path::absolute(&path).map_err(Error::io("find", &path)))
            .transpose()?,
    };
    if needs_login {
        refuse_nobody(&data, listen)?;
    }
    // Before the station: what cannot be served must not switch anything on.
    let identity = match &tls {
        Tls::Files { cert, key } => Some(TlsIdentity::of_files(cert, key)?),
        Tls::Own | Tls::Auto if has_tls => Some(TlsIdentity::own(&data, &names)?),
        Tls::Own | Tls::Auto => None,
    };
    let Studio { state, station } = Studio::open(&data, station.as_ref(), access)?;
    if retention.is_on() {
        retention::keep_in_order(&state, retention)?;
    }
    if is_open {
        tracing::warn!(%listen, "no login: anybody who reaches this address may take control of the robot");
    }
    if !page::is_built() {
        tracing::warn!("built without the page; `cargo xtask build` builds a binary that has it");
    }
    let (tls, fingerprint, own_cert) = match identity {
        Some(TlsIdentity { acceptor, fingerprint, own_cert }) => {
            (Some(acceptor), Some(fingerprint), own_cert)
        }
        None => (None, None, None),
    };
    ready(Ready { address, fingerprint, own_cert });
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
    let app = app(state.clone());
    let own_listener = own.listener.map(|listener| {
        let mut shutdown = state.shutdown();
        let ends = async move {
            // Without a sender the server is gone already.
            let _ = shutdown.wait_for(|&ends| ends).await;
        };
        tokio::spawn(listener::listen(listener, None, app.clone(), ends))
    });
    drop(state);
    listener::listen(listener, tls, app, stop).await;
    if let Some(own_listener) = own_listener {
        // It ends with the other.
        let _ = own_listener.await;
    }
    let Ok(Some((motion, station))) = told.await else {
        return Ok(Served { motion: None, is_written: true });
    };
    let finish = move || station.finish(FINISH_PATIENCE);
    let is_written = on_own_thread("finish", finish).await.unwrap_or(false);
    Ok(Served { motion: Some(motion), is_written })
}

/// Where jobs of this computer reach the studio without TLS: a certificate of the lab is for the name of the studio, and
/// they would have to be told which to trust. It lets in whom the other address lets in.
struct OwnDoor {
    address: SocketAddr,
    /// Where the address that everybody uses speaks TLS.
    listener: Option<TcpListener>,
}

impl OwnDoor {
    /// A door beside that at `address`, if that `has_tls`.
    async fn open(address: SocketAddr, has_tls: bool) -> Result<Self, Error> {
        let loopback = match address.ip() {
            IpAddr::V4(_) => IpAddr::from(Ipv4Addr::LOCALHOST),
            IpAddr::V6(_) => IpAddr::from(Ipv6Addr::LOCALHOST),
        };
        if !has_tls {
            let ip = if address.ip().is_unspecified() { loopback } else { address.ip() };
            return Ok(Self { address: SocketAddr::new(ip, address.port()), listener: None });
        }
        let failed = |err: std::io::Error| {
            Error::Argument(format!("failed to listen on {loopback} for jobs of this computer: {err}"))
        };
        let listener = TcpListener::bind((loopback, 0)).await.map_err(failed)?;
        Ok(Self { address: listener.local_addr().map_err(failed)?, listener: Some(listener) })
    }

    fn url(&self) -> String {
        format!("http://{}", self.address)
    }
}

/// Serves `state` on `listener` until `stop` completes.
pub async fn serve_on(listener: TcpListener, state: Arc<AppState>, stop: impl Future<Output = ()>) {
    listener::listen(listener, None, app(state), stop).await;
}

/// Refuses to serve where everybody has to log in and nobody can.
fn refuse_nobody(data: &Path, listen: SocketAddr) -> Result<(), Error> {
    std::fs::create_dir_all(data).map_err(Error::io("make", data))?;
    if !open_people(data)?.is_empty() {
        return Ok(());
    }
    Err(Error::Argument(format!(
        "whoever reaches {listen} has to log in, and nobody could: add yourself with `palpate people add NAME --role admin \
         --data {}`, or listen on 127.0.0.1 and forward the port (ssh -L 8080:127.0.0.1:8080 THIS_COMPUTER)",
        data.display()
    )))
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whatever_can_be_reached_from_elsewhere_needs_login_and_tls() {
        let config = |listen: &str| ServeConfig {
            listen: listen.parse().unwrap(),
            data: PathBuf::new(),
            station: None,
            hosts: Vec::new(),
            foxglove_origins: Vec::new(),
            insecure: false,
            behind_proxy: false,
            login: false,
            tls: Tls::Auto,
            train: None,
            operator: None,
            retention: RetentionConfig::default(),
        };
        let security = |config: ServeConfig| {
            let Security { needs_login, has_tls, is_open } = config.security().unwrap();
            (needs_login, has_tls, is_open)
        };
        for listen in ["127.0.0.1:8080", "[::1]:8080", "127.9.9.9:1"] {
            assert_eq!(security(config(listen)), (false, false, false), "{listen}");
            assert_eq!(security(ServeConfig { login: true, ..config(listen) }), (true, false, false));
            // Others come through the proxy.
            assert_eq!(security(ServeConfig { behind_proxy: true, ..config(listen) }), (true, false, false));
            assert_eq!(security(ServeConfig { tls: Tls::Own, ..config(listen) }), (false, true, false));
        }
        for listen in ["0.0.0.0:8080", "[::]:8080", "10.0.0.7:8080"] {
            assert_eq!(security(config(listen)), (true, true, false), "{listen}");
            assert_eq!(security(ServeConfig { behind_proxy: true, ..config(listen) }), (true, false, false));
            assert_eq!(security(ServeConfig { insecure: true, ..config(listen) }), (false, false, true));
            assert!(ServeConfig { insecure: true, login: true, ..config(listen) }.security().is_err());
        }
    }
}
