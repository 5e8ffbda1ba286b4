//! A studio in a process of its own, and a connection to it.

use std::{
    io::{BufRead as _, BufReader, Read as _, Write as _},
    net::{SocketAddr, TcpStream},
    path::Path,
    process::{Child, Command, Stdio},
    time::{Duration, Instant},
};

use palpate_server::Error;
use serde::de::DeserializeOwned;
use serde_json::Value;

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

/// A connection that stays open.
pub(super) struct Client {
    stream: BufReader<TcpStream>,
}

impl Client {
    pub(super) fn connect(addr: SocketAddr) -> Result<Self, Error> {
        let stream = TcpStream::connect(addr).map_err(|err| broken(&err))?;
        stream
            .set_nodelay(true)
            .and_then(|()| stream.set_read_timeout(Some(PATIENCE)))
            .map_err(|err| broken(&err))?;
        Ok(Self { stream: BufReader::new(stream) })
    }

    /// Waits for answers as long as `patience`.
    pub(super) fn wait_up_to(&self, patience: Duration) -> Result<(), Error> {
        self.stream.get_ref().set_read_timeout(Some(patience)).map_err(|err| broken(&err))
    }

    /// The answer to a request below `/api/v1/`, and how long it took, s.
    pub(super) fn ask<T: DeserializeOwned>(
        &mut self,
        method: &str,
        path: &str,
        body: Option<&Value>,
    ) -> Result<(T, f64), Error> {
        let (answer, seconds) = self.exchange(method, &format!("/api/v1/{path}"), body)?;
        let answer = serde_json::from_slice(&answer).map_err(|err| broken(&err))?;
        Ok((answer, seconds))
    }

    /// The bytes of the answer, and how long it took, s; any status but success is an error with the studio's words.
    pub(super) fn exchange(
        &mut self,
        method: &str,
        path: &str,
        body: Option<&Value>,
    ) -> Result<(Vec<u8>, f64), Error> {
        let body = body.map(Value::to_string).unwrap_or_default();
        let head = format!(
            "{method} {path} HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\nContent-Length: {}\r\n\r\n",
            body.len()
        );
        let begun = Instant::now();
        self.stream.get_mut().write_all((head + &body).as_bytes()).map_err(|err| broken(&err))?;
        let (status, answer) = self.answer().map_err(|err| broken(&err))?;
        let seconds = begun.elapsed().as_secs_f64();
        match status {
            200..300 => Ok((answer, seconds)),
            _ => {
                let said = String::from_utf8_lossy(&answer).into_owned();
                Err(Error::Internal(format!("{method} {path} was answered by {status}: {said}")))
            }
        }
    }

    fn answer(&mut self) -> std::io::Result<(u16, Vec<u8>)> {
        let (mut status, mut length, mut is_chunked) = (0, 0, false);
        loop {
            let line = self.line()?;
            if line.is_empty() {
                break;
            }
            if let Some(rest) = line.strip_prefix("HTTP/1.1 ") {
                status = rest.get(..3).and_then(|code| code.parse().ok()).unwrap_or(0);
            }
            let lower = line.to_ascii_lowercase();
            if let Some(value) = lower.strip_prefix("content-length:") {
                length = value.trim().parse().unwrap_or(0);
            }
            is_chunked |= lower.starts_with("transfer-encoding:") && lower.contains("chunked");
        }
        let mut body = Vec::new();
        if !is_chunked {
            body.resize(length, 0);
            self.stream.read_exact(&mut body)?;
            return Ok((status, body));
        }
        loop {
            let size = usize::from_str_radix(self.line()?.trim(), 16).unwrap_or(0);
            let start = body.len();
            body.resize(start + size, 0);
            self.stream.read_exact(&mut body[start..])?;
            self.line()?;
            if size == 0 {
                return Ok((status, body));
            }
        }
    }

    /// Without its end.
    fn line(&mut self) -> std::io::Result<String> {
        let mut line = String::new();
        if self.stream.read_line(&mut line)? == 0 {
            return Err(std::io::ErrorKind::UnexpectedEof.into());
        }
        Ok(line.trim_end().to_owned())
    }
}

fn broken(err: &dyn std::fmt::Display) -> Error {
    Error::Internal(format!("a request failed: {err}"))
}
