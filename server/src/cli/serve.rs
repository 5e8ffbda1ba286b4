//! `palpate serve`.

use std::{
    net::SocketAddr,
    path::PathBuf,
    process::ExitCode,
    sync::{Arc, Mutex, PoisonError},
    time::{Duration, Instant},
};

use clap::Args;
use palpate_control::Ending;
use palpate_drivers::priority;
use palpate_server::{Error, LiveStation, ServeConfig, assets, serve};
use serde_json::json;
use tokio::signal::unix::{SignalKind, signal};

use super::{Outcome, output, station::StationArgs};

/// The program has ended this long after the first signal, whatever stalls: motion takes 1.6 s at most.
const END_DEADLINE: Duration = Duration::from_millis(2800);

#[derive(Args)]
pub(crate) struct ServeArgs {
    /// Address to listen on; port 0 takes any free one
    #[arg(long, default_value = "127.0.0.1:8080")]
    listen: SocketAddr,
    /// Where sessions, models and calibration runs are kept
    #[arg(long, value_name = "DIR", default_value = "data")]
    data: PathBuf,
    #[command(flatten)]
    station: StationArgs,
    /// Run an emulated station: a truth file, or the name of a shipped one
    #[arg(long, value_name = "TRUTH.toml", conflicts_with = "station")]
    emulate: Option<PathBuf>,
    /// A host name by which browsers reach this studio, besides localhost and addresses; may be given several times
    #[arg(long = "allow-host", value_name = "NAME")]
    hosts: Vec<String>,
    /// Listen beyond this computer though there is no login: anybody in the network may then take control of the robot
    #[arg(long)]
    insecure: bool,
    /// Print the address as JSON, once the studio is ready
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: ServeArgs) -> Outcome {
    let truth = args.emulate.as_deref().map(assets::truth).transpose()?;
    let station = match &truth {
        Some((path, _unpacked)) => Some(LiveStation::Emulated(path.clone())),
        None => args
            .station
            .open()?
            .map(|(station, ports)| LiveStation::Real { station: Arc::new(station), ports }),
    };
    let config = ServeConfig {
        listen: args.listen,
        data: args.data,
        station,
        hosts: args.hosts,
        insecure: args.insecure,
    };
    let ready = move |addr: SocketAddr| {
        let url = format!("http://{addr}");
        let printed = match args.json {
            true => output::line(&json!({ "url": url }).to_string()),
            false => output::line(&format!("listening on {url}")),
        };
        if let Err(err) = printed {
            tracing::warn!(%url, err = palpate_server::chain(&err), "failed to print the address");
        }
    };
    // A thread that panics must not wait for a terminal that stands still.
    std::panic::set_hook(Box::new(|info| tracing::error!("a thread panicked: {info}")));
    // Computing gives way to operators. If the pool is there already, it computes all the same.
    let _ = rayon::ThreadPoolBuilder::new().start_handler(|_| priority::background()).build_global();
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        // They carry an operator's messages, a stop among them.
        .on_thread_start(priority::ahead)
        .build()
        .map_err(|err| Error::Internal(format!("failed to start the server's threads: {err}")))?;
    let motion = Motion::default();
    let stop = end_on_signals(motion.clone())?;
    let motion_ended = move |ending: Option<&Ending>| motion.has_ended(ending);
    let served = runtime.block_on(serve(config, ready, stop, motion_ended))?;
    // A request's work that still computes is not waited for.
    runtime.shutdown_background();
    if !served.is_written {
        return Err(Error::Internal(
            "the disk was too slow: the end of what was recorded or logged may be missing".to_owned(),
        ));
    }
    match served.motion.filter(|ending| !ending.is_safe()) {
        Some(ending) => Err(Error::Internal(ending.to_string())),
        None => Ok(ExitCode::SUCCESS),
    }
}

/// What is known of the end of motion, for the thread that hears signals.
#[derive(Clone, Debug, Default)]
struct Motion {
    /// Whether it has ended, and whether readings confirm that; locked for a moment only.
    ended: Arc<Mutex<Option<bool>>>,
}

impl Motion {
    fn has_ended(&self, ending: Option<&Ending>) {
        *self.ended.lock().unwrap_or_else(PoisonError::into_inner) = Some(ending.is_none_or(Ending::is_safe));
    }

    fn is_safe(&self) -> Option<bool> {
        *self.ended.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Completes with the first Ctrl-C or termination signal. A second one ends the program as soon as motion has ended; so does
/// the deadline, whatever still stalls. The thread that hears them shares nothing with the server's.
fn end_on_signals(motion: Motion) -> Result<impl Future<Output = ()> + Send + 'static, Error> {
    let failed = |err| Error::Internal(format!("failed to listen for signals: {err}"));
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().map_err(failed)?;
    let (mut interrupt, mut terminate) = {
        let _entered = runtime.enter();
        (signal(SignalKind::interrupt()).map_err(failed)?, signal(SignalKind::terminate()).map_err(failed)?)
    };
    let (tell, told) = tokio::sync::oneshot::channel();
    let listen = async move {
        tokio::select! {
            _ = interrupt.recv() => {}
            _ = terminate.recv() => {}
        }
        let begun = Instant::now();
        // The server may have failed meanwhile.
        let _ = tell.send(());
        let is_impatient = tokio::select! {
            _ = interrupt.recv() => true,
            _ = terminate.recv() => true,
            () = tokio::time::sleep(END_DEADLINE) => false,
        };
        while motion.is_safe().is_none() && begun.elapsed() < END_DEADLINE {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
        let is_safe = motion.is_safe().unwrap_or(false);
        match (is_safe, is_impatient) {
            (true, true) => tracing::warn!("ended at once on a second signal; motion had ended"),
            (true, false) => tracing::error!("ended by the deadline; something stalled"),
            (false, _) => {
                tracing::error!("ended, but no reading confirms that motors are off: check the robot");
            }
        }
        // Gives the log's thread a moment.
        tokio::time::sleep(Duration::from_millis(20)).await;
        std::process::exit(if is_safe && is_impatient { 0 } else { 1 });
    };
    std::thread::Builder::new()
        .name("signals".to_owned())
        .spawn(move || runtime.block_on(listen))
        .map_err(failed)?;
    Ok(async move {
        // Without the thread the process can only be killed.
        if told.await.is_err() {
            std::future::pending::<()>().await;
        }
    })
}
