//! `palpate serve`.

use std::{net::SocketAddr, path::PathBuf, process::ExitCode, sync::Arc};

use clap::Args;
use palpate_server::{Error, LiveStation, ServeConfig, assets, serve};
use serde_json::json;

use super::{Outcome, output, station::StationArgs};

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
    let config = ServeConfig { listen: args.listen, data: args.data, station };
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
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build()
        .map_err(|err| Error::Internal(format!("failed to start the server's threads: {err}")))?;
    runtime.block_on(serve(config, ready, stop_requested()))?;
    // A request's work that still computes is not waited for.
    runtime.shutdown_background();
    Ok(ExitCode::SUCCESS)
}

/// Ctrl-C, or the termination signal of service managers.
async fn stop_requested() {
    let interrupted = tokio::signal::ctrl_c();
    #[cfg(unix)]
    {
        let terminate = tokio::signal::unix::signal(tokio::signal::unix::SignalKind::terminate());
        if let Ok(mut terminate) = terminate {
            tokio::select! {
                _ = interrupted => {}
                _ = terminate.recv() => {}
            }
            return;
        }
    }
    // Without signals the process can only be killed.
    let _ = interrupted.await;
}
