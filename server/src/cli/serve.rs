//! `palpate serve`.

mod config;

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
use palpate_server::{Error, LiveStation, Ready, ServeConfig, Tls, assets, serve};
use serde_json::json;
use tokio::signal::unix::{SignalKind, signal};

pub(super) use config::{Config, LogFormat};

use super::{Outcome, output, retention_days::RetentionArgs, station::StationArgs};

/// The program has ended this long after the first signal, whatever stalls: motion takes 1.6 s at most.
const END_DEADLINE: Duration = Duration::from_millis(2800);

#[derive(Args)]
pub(crate) struct ServeArgs {
    /// Address to listen on; port 0 takes any free one [default: 127.0.0.1:8080]
    #[arg(long)]
    listen: Option<SocketAddr>,
    /// Where sessions, models and calibration runs are kept [default: data]
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
    /// Configuration file; what the command line says wins
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Check the configuration, and what it names, and start nothing
    #[arg(long)]
    check_config: bool,
    /// Print a configuration file with all keys and their defaults
    #[arg(long)]
    print_default_config: bool,
    /// How the log on standard error is written [default: text]
    #[arg(long, value_enum, value_name = "FORMAT")]
    log: Option<LogFormat>,
    #[command(flatten)]
    station: StationArgs,
    /// Run an emulated station: a truth file, or the name of a shipped one
    #[arg(long, value_name = "TRUTH.toml", conflicts_with = "station")]
    emulate: Option<PathBuf>,
    /// A host name by which browsers reach this studio, besides localhost and addresses; may be given several times
    #[arg(long = "allow-host", value_name = "NAME")]
    hosts: Vec<String>,
    /// An origin whose pages may watch over Foxglove's protocol, e.g. `https://app.foxglove.dev`; may be given several times
    #[arg(long = "foxglove-origin", value_name = "ORIGIN")]
    foxglove_origins: Vec<String>,
    /// Listen beyond this computer without login and TLS: anybody in the network may then take control of the robot
    #[arg(long)]
    insecure: bool,
    /// Everybody has to log in, also on this computer
    #[arg(long)]
    login: bool,
    /// A proxy in front has TLS, and says in X-Forwarded-For from where requests come; everybody has to log in
    #[arg(long)]
    behind_proxy: bool,
    /// Certificate chain in PEM, in place of one of the studio's own
    #[arg(long, value_name = "FILE", requires = "tls_key")]
    tls_cert: Option<PathBuf>,
    /// Private key of the certificate, in PEM
    #[arg(long, value_name = "FILE", requires = "tls_cert")]
    tls_key: Option<PathBuf>,
    /// Speak TLS on this computer too, by the studio's own certificate
    #[arg(long, conflicts_with = "tls_cert")]
    tls: bool,
    /// The palpate-train program [default: the one beside palpate, or on PATH]
    #[arg(long, value_name = "FILE")]
    train: Option<PathBuf>,
    /// Socket of the operator of an emulated station, as `palpate-train station` prints it: places the objects of campaigns
    /// that jobs run, and says where these are
    #[arg(long, value_name = "SOCKET")]
    operator: Option<PathBuf>,
    #[command(flatten)]
    retention: RetentionArgs,
    /// Print the address as JSON, once the studio is ready
    #[arg(long)]
    json: bool,
}

/// Where a studio listens, and where it keeps data, without a word.
const LISTEN: &str = "127.0.0.1:8080";
const DATA: &str = "data";

pub(super) fn run(args: ServeArgs) -> Outcome {
    if args.print_default_config {
        output::line(config::DEFAULT.trim_end())?;
        return Ok(ExitCode::SUCCESS);
    }
    let truth = args.emulate.as_deref().map(assets::truth).transpose()?;
    let station = match &truth {
        Some((path, _unpacked)) => Some(LiveStation::Emulated(path.clone())),
        None => args
            .station
            .open()?
            .map(|(station, ports)| LiveStation::Real { station: Arc::new(station), ports }),
    };
    let serve_config = ServeConfig {
        listen: match args.listen {
            Some(listen) => listen,
            None => LISTEN.parse().map_err(|err| Error::Internal(format!("{LISTEN}: {err}")))?,
        },
        data: args.data.unwrap_or_else(|| DATA.into()),
        station,
        hosts: args.hosts,
        foxglove_origins: args.foxglove_origins,
        insecure: args.insecure,
        behind_proxy: args.behind_proxy,
        login: args.login,
        tls: match (args.tls_cert, args.tls_key) {
            (Some(cert), Some(key)) => Tls::Files { cert, key },
            _ if args.tls => Tls::Own,
            _ => Tls::Auto,
        },
        train: args.train,
        operator: args.operator,
        retention: args.retention.config(),
    };
    if args.check_config {
        serve_config.check()?;
        output::line("the configuration can be used")?;
        return Ok(ExitCode::SUCCESS);
    }
    let ready = move |ready: Ready| {
        let url = ready.url();
        let printed = match args.json {
            true => output::line(&address_json(&ready).to_string()),
            false => output::line(&address_text(&ready)),
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
    let served = runtime.block_on(serve(serve_config, ready, stop, motion_ended))?;
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

fn address_json(ready: &Ready) -> serde_json::Value {
    let mut document = json!({ "url": ready.url() });
    if let Some(fingerprint) = &ready.fingerprint {
        document["fingerprint"] = json!(fingerprint);
    }
    if let Some(cert) = &ready.own_cert {
        document["certificate"] = json!(cert);
    }
    document
}

fn address_text(ready: &Ready) -> String {
    let mut text = format!("listening on {}", ready.url());
    if let Some(fingerprint) = &ready.fingerprint {
        text += &format!("\ncertificate SHA-256 {fingerprint}");
    }
    if let Some(cert) = &ready.own_cert {
        text += &format!(
            "\nit is the studio's own ({}): browsers warn once; compare the SHA-256 before going on",
            cert.display()
        );
    }
    text
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
