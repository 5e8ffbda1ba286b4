//! What keeps a studio busy while STOP is pressed: the work of many clients at a time.

use std::{
    fs,
    io::{Cursor, Write as _},
    net::SocketAddr,
    path::Path,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    time::Duration,
};

use futures_util::StreamExt as _;
use palpate_server::Error;
use serde::Serialize;
use serde_json::json;
use tokio::{
    io::{AsyncReadExt as _, AsyncWriteExt as _},
    net::TcpStream,
    runtime::Runtime,
    time::{sleep, timeout},
};
use tokio_tungstenite::connect_async;
use zip::{ZipWriter, write::SimpleFileOptions};

/// Clients of each kind.
const UPLOADS: usize = 8;
const REPLAYS: usize = 128;
const CHECKS: usize = 300;
const READS: usize = 530;
const STREAMS: usize = 50;
/// After a refusal a client asks again.
const AGAIN: Duration = Duration::from_millis(500);
const GIVE_UP: Duration = Duration::from_secs(60);

/// Requests of one kind.
#[derive(Debug, Default, Serialize)]
pub(super) struct Requests {
    clients: usize,
    answered: u64,
    /// With 503 or 429: come back later.
    refused: u64,
    failed: u64,
}

/// What the studio did besides.
#[derive(Debug, Default, Serialize)]
pub(super) struct LoadReport {
    uploads: Requests,
    replays: Requests,
    checks: Requests,
    /// Of the list of models, while a file among them is a pipe that nobody writes to.
    reads: Requests,
    diagnoses: Requests,
    stream_clients: usize,
    stream_messages: u64,
}

#[derive(Debug, Default)]
struct Counters {
    answered: AtomicU64,
    refused: AtomicU64,
    failed: AtomicU64,
}

impl Counters {
    fn requests(&self, clients: usize) -> Requests {
        Requests {
            clients,
            answered: self.answered.load(Ordering::Relaxed),
            refused: self.refused.load(Ordering::Relaxed),
            failed: self.failed.load(Ordering::Relaxed),
        }
    }
}

#[derive(Debug, Default)]
struct AllCounters {
    uploads: Counters,
    replays: Counters,
    checks: Counters,
    reads: Counters,
    diagnoses: Counters,
    stream_messages: AtomicU64,
}

/// Clients that ask until this ends.
pub(super) struct Load {
    runtime: Runtime,
    counters: Arc<AllCounters>,
}

impl Load {
    /// Starts all clients of the studio at `addr`, which has the session at `session`.
    pub(super) fn start(addr: SocketAddr, session: &Path) -> Result<Self, Error> {
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(2)
            .enable_all()
            .build()
            .map_err(|err| Error::Internal(format!("failed to start the clients: {err}")))?;
        let archive = Arc::new(zip_folder(session)?);
        hanging_file(session)?;
        let counters = Arc::new(AllCounters::default());
        for client in 0..UPLOADS {
            let (archive, counters) = (archive.clone(), counters.clone());
            runtime.spawn(async move {
                for round in 0_u64.. {
                    let name = format!("upload-{client}-{round}");
                    let path = format!("sessions?name={name}");
                    exchange(addr, "POST", &path, "application/zip", &archive, &counters.uploads).await;
                    exchange(addr, "DELETE", &format!("sessions/{name}"), "", &[], &Counters::default())
                        .await;
                }
            });
        }
        let repeat = |clients: usize, path: &'static str, of: fn(&AllCounters) -> &Counters| {
            for _ in 0..clients {
                let counters = counters.clone();
                runtime.spawn(async move {
                    loop {
                        exchange(addr, "GET", path, "", &[], of(&counters)).await;
                    }
                });
            }
        };
        repeat(REPLAYS, "sessions/load/takes/take-01/replay?model=nominal", |counters| &counters.replays);
        repeat(CHECKS, "sessions/load/check", |counters| &counters.checks);
        repeat(READS, "models", |counters| &counters.reads);
        let counted = counters.clone();
        runtime.spawn(async move {
            let body = json!({ "session": "load" }).to_string();
            loop {
                let posted = exchange(
                    addr,
                    "POST",
                    "diagnoses",
                    "application/json",
                    body.as_bytes(),
                    &counted.diagnoses,
                )
                .await;
                let Some(id) = posted.and_then(|run| run["id"].as_str().map(str::to_owned)) else { continue };
                loop {
                    sleep(AGAIN).await;
                    let run =
                        exchange(addr, "GET", &format!("diagnoses/{id}"), "", &[], &Counters::default())
                            .await;
                    if run.is_some_and(|run| run["state"] != "queued" && run["state"] != "running") {
                        break;
                    }
                }
            }
        });
        for _ in 0..STREAMS {
            let counters = counters.clone();
            runtime.spawn(async move {
                while let Ok((mut socket, _)) = connect_async(format!("ws://{addr}/api/v1/stream")).await {
                    while let Some(Ok(_)) = socket.next().await {
                        counters.stream_messages.fetch_add(1, Ordering::Relaxed);
                    }
                }
            });
        }
        Ok(Self { runtime, counters })
    }

    /// Ends all clients.
    pub(super) fn end(self) -> LoadReport {
        self.runtime.shutdown_background();
        let counters = &self.counters;
        LoadReport {
            uploads: counters.uploads.requests(UPLOADS),
            replays: counters.replays.requests(REPLAYS),
            checks: counters.checks.requests(CHECKS),
            reads: counters.reads.requests(READS),
            diagnoses: counters.diagnoses.requests(1),
            stream_clients: STREAMS,
            stream_messages: counters.stream_messages.load(Ordering::Relaxed),
        }
    }
}

/// One request on a connection of its own; gives the answer if it was a success with a JSON document.
async fn exchange(
    addr: SocketAddr,
    method: &str,
    path: &str,
    content_type: &str,
    body: &[u8],
    counters: &Counters,
) -> Option<serde_json::Value> {
    let ask = async {
        let mut stream = TcpStream::connect(addr).await?;
        let head = format!(
            "{method} /api/v1/{path} HTTP/1.1\r\nHost: {addr}\r\nConnection: close\r\nContent-Type: {content_type}\r\n\
             Content-Length: {}\r\n\r\n",
            body.len()
        );
        stream.write_all(head.as_bytes()).await?;
        // A refusal may come before all of it is sent.
        let _ = stream.write_all(body).await;
        let mut answer = Vec::new();
        stream.read_to_end(&mut answer).await?;
        Ok::<_, std::io::Error>(answer)
    };
    let answer = timeout(GIVE_UP, ask).await.ok().and_then(Result::ok).unwrap_or_default();
    let status = answer.split(|&byte| byte == b' ').nth(1).unwrap_or_default();
    match status {
        [b'2', ..] => counters.answered.fetch_add(1, Ordering::Relaxed),
        b"503" | b"429" => counters.refused.fetch_add(1, Ordering::Relaxed),
        _ => counters.failed.fetch_add(1, Ordering::Relaxed),
    };
    if !status.starts_with(b"2") {
        sleep(AGAIN).await;
        return None;
    }
    let begin = answer.windows(4).position(|window| window == b"\r\n\r\n")? + 4;
    serde_json::from_slice(&answer[begin..]).ok()
}

/// A pipe among the models, which nobody writes to: whoever opens it as a file waits for ever.
fn hanging_file(session: &Path) -> Result<(), Error> {
    let models = session.ancestors().nth(2).unwrap_or(session).join("models");
    fs::create_dir_all(&models).map_err(Error::io("make", &models))?;
    let path = models.join("hangs.toml");
    let made =
        rustix::fs::mknodat(rustix::fs::CWD, &path, rustix::fs::FileType::Fifo, rustix::fs::Mode::RWXU, 0);
    made.map_err(|err| Error::io("make", &path)(err.into()))
}

fn zip_folder(dir: &Path) -> Result<Vec<u8>, Error> {
    let failed = |err: zip::result::ZipError| Error::Internal(format!("failed to pack {dir:?}: {err}"));
    let mut writer = ZipWriter::new(Cursor::new(Vec::new()));
    for entry in fs::read_dir(dir).map_err(Error::io("read", dir))? {
        let path = entry.map_err(Error::io("read", dir))?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        if path.is_file() {
            let bytes = fs::read(&path).map_err(Error::io("read", &path))?;
            writer.start_file(name, SimpleFileOptions::default()).map_err(failed)?;
            writer.write_all(&bytes).map_err(Error::io("pack", &path))?;
        }
    }
    Ok(writer.finish().map_err(failed)?.into_inner())
}
