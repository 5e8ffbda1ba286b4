//! A studio in a process of its own, and a connection to it.

use std::{
    io::{BufRead as _, BufReader},
    net::SocketAddr,
    path::Path,
    process::{Child, Command, Stdio},
    time::{Duration, Instant},
};

use axum::body::Bytes;
use palpate_server::Error;
use serde::de::DeserializeOwned;
use serde_json::Value;
use tokio::{runtime::Runtime, time::timeout};

use super::http::Connection;

/// A studio that has not answered by now does not work.
pub(super) const PATIENCE: Duration = Duration::from_secs(60);

/// `palpate serve`. It ends when dropped.
pub(super) struct Studio {
    process: Child,
    pub(super) addr: SocketAddr,
}

impl Studio {
    /// Starts it on the data folder `data` with `args`, and waits until it says where it listens.
    pub(super) fn start(data: &Path, args: &[String]) -> Result<Self, Error> {
        let failed = |what: &str| Error::Internal(format!("the studio did not start: {what}"));
        let program = std::env::current_exe().map_err(Error::io("find", "palpate"))?;
        let mut process = Command::new(program)
            .args(["serve", "--json", "--listen", "127.0.0.1:0", "--data"])
            .arg(data)
            .args(args)
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .map_err(|err| failed(&err.to_string()))?;
        let line = process.stdout.take().map(|stdout| {
            let mut line = String::new();
            BufReader::new(stdout).read_line(&mut line).map(|_| line)
        });
        let line = line.and_then(Result::ok).unwrap_or_default();
        let said: Value = serde_json::from_str(&line).unwrap_or_default();
        let addr = said["url"].as_str().and_then(|url| url.strip_prefix("http://")?.parse().ok());
        match addr {
            Some(addr) => Ok(Self { process, addr }),
            None => {
                // It is of no use.
                let _ = process.kill();
                let _ = process.wait();
                Err(failed(&format!("it said {line:?}")))
            }
        }
    }

    /// The largest part of the machine's memory that it has had, MB; 0 where there is no `/proc`.
    pub(super) fn peak_memory_mb(&self) -> f64 {
        let status =
            std::fs::read_to_string(format!("/proc/{}/status", self.process.id())).unwrap_or_default();
        let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
        line.and_then(|line| line.trim().trim_end_matches("kB").trim().parse::<f64>().ok()).unwrap_or(0.0)
            / 1e3
    }
}

impl Drop for Studio {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = Command::new("kill").args(["-TERM", &self.process.id().to_string()]).status();
        let _ = self.process.wait();
    }
}

/// A connection that stays open, for whoever waits for answers.
pub(super) struct Client {
    runtime: Runtime,
    connection: Connection,
    patience: Duration,
}

impl Client {
    pub(super) fn connect(addr: SocketAddr) -> Result<Self, Error> {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
        let runtime = runtime.map_err(Error::io("start", "a runtime"))?;
        let connection = runtime.block_on(Connection::open(addr))?;
        Ok(Self { runtime, connection, patience: PATIENCE })
    }

    /// Waits for answers as long as `patience`.
    pub(super) fn wait_up_to(&mut self, patience: Duration) {
        self.patience = patience;
    }

    /// The answer to a request below `/api/v1/`, and how long it took, s.
    pub(super) fn ask<T: DeserializeOwned>(
        &mut self,
        method: &str,
        path: &str,
        body: Option<&Value>,
    ) -> Result<(T, f64), Error> {
        let path = format!("/api/v1/{path}");
        let (answer, seconds) = self.exchange(method, &path, body)?;
        let answer = serde_json::from_slice(&answer).map_err(|err| {
            Error::Internal(format!("the answer to {method} {path} is not what was expected: {err}"))
        })?;
        Ok((answer, seconds))
    }

    /// The bytes of the answer, and how long it took, s; any status but success is an error with the studio's words.
    pub(super) fn exchange(
        &mut self,
        method: &str,
        path: &str,
        body: Option<&Value>,
    ) -> Result<(Bytes, f64), Error> {
        let (begun, patience) = (Instant::now(), self.patience);
        let asked = self.connection.ask(method, path, 0, body.map(Value::to_string));
        let answer = self.runtime.block_on(async { timeout(patience, asked).await });
        let answer = answer.map_err(|_| {
            Error::Internal(format!("{method} {path} was not answered within {} s", patience.as_secs()))
        })??;
        Ok((answer, begun.elapsed().as_secs_f64()))
    }
}
