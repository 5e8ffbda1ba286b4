//! A running studio.

use std::{
    ffi::OsStr,
    io::{BufRead as _, BufReader, Read as _, Write as _},
    net::TcpStream,
    os::unix::process::CommandExt as _,
    path::Path,
    process::{Child, ChildStderr, Command, Stdio},
    sync::{Arc, Mutex, PoisonError},
    time::Duration,
};

use anyhow::{Context as _, bail};
use serde_json::Value;

use crate::Tools;

/// A studio on a free port; it ends when this is dropped.
pub struct Studio {
    process: Child,
    log: Arc<Mutex<String>>,
    /// Its standard error, where nobody reads it.
    _unread: Option<ChildStderr>,
    /// Where the page is.
    pub url: String,
}

impl Studio {
    /// Starts the studio on `data` as `cargo xtask studio` does, and waits until it says where it listens.
    pub fn start(tools: &Tools, data: &Path) -> anyhow::Result<Self> {
        let mut command = Command::new(&tools.xtask);
        command
            .args(["studio", "--listen", "127.0.0.1:0", "--bin"])
            .arg(&tools.palpate)
            .arg("--data")
            .arg(data);
        Self::spawn(command)
    }

    /// Starts `palpate serve` with more arguments, which say which station is live.
    pub fn serve(
        tools: &Tools,
        data: &Path,
        station: impl IntoIterator<Item = impl AsRef<OsStr>>,
    ) -> anyhow::Result<Self> {
        Self::spawn(serve(tools, data, station))
    }

    /// The same at the address where another one was: `ADDRESS:PORT`.
    pub fn serve_at(
        tools: &Tools,
        address: &str,
        data: &Path,
        station: impl IntoIterator<Item = impl AsRef<OsStr>>,
    ) -> anyhow::Result<Self> {
        let mut command = tools.palpate();
        command.args(["serve", "--listen", address, "--data"]).arg(data).args(station);
        Self::spawn(command)
    }

    /// The same where nobody ever reads its standard error: the pipe fills up.
    pub fn serve_unread(
        tools: &Tools,
        data: &Path,
        station: impl IntoIterator<Item = impl AsRef<OsStr>>,
    ) -> anyhow::Result<Self> {
        Self::spawn_read(serve(tools, data, station), false)
    }

    /// The same where no file can grow beyond `most_kib`: writing more fails, as on a disk that is full.
    pub fn serve_on_little_space(
        tools: &Tools,
        data: &Path,
        station: impl IntoIterator<Item = impl AsRef<OsStr>>,
        most_kib: u32,
    ) -> anyhow::Result<Self> {
        let mut command = Command::new("bash");
        // Whoever ignores the signal of the limit gets the error from the call that wrote.
        command
            .arg("-c")
            .arg(format!("ulimit -f {most_kib} && trap '' XFSZ && exec \"$0\" \"$@\""))
            .arg(&tools.palpate)
            .args(["serve", "--listen", "127.0.0.1:0", "--data"])
            .arg(data)
            .args(station);
        Self::spawn(command)
    }

    /// What it has said so far.
    pub fn log(&self) -> String {
        self.log.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    fn spawn(command: Command) -> anyhow::Result<Self> {
        Self::spawn_read(command, true)
    }

    fn spawn_read(mut command: Command, reads_stderr: bool) -> anyhow::Result<Self> {
        let mut process = command
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .process_group(0)
            .spawn()
            .with_context(|| format!("failed to start {command:?}"))?;
        let stderr = process.stderr.take().context("the studio has no standard error")?;
        let log = Arc::<Mutex<String>>::default();
        let kept = Arc::clone(&log);
        let mut unread = None;
        if reads_stderr {
            std::thread::spawn(move || read_log(stderr, &kept));
        } else {
            unread = Some(stderr);
        }
        let stdout = process.stdout.take().context("the studio has no standard output")?;
        let mut lines = BufReader::new(stdout).lines();
        let url = loop {
            let line = lines.next().context("the studio ended before it said where it listens")??;
            if let Some(start) = line.find("http://").or_else(|| line.find("https://")) {
                break line[start..].split_whitespace().next().unwrap_or_default().to_owned();
            }
        };
        // Whatever else it prints must not fill the pipe.
        std::thread::spawn(move || lines.for_each(drop));
        Ok(Self { process, log, _unread: unread, url })
    }

    /// Kills it, as when the machine loses its power: it has no time for a last word.
    pub fn kill(mut self) -> anyhow::Result<()> {
        self.process.kill()?;
        self.process.wait()?;
        Ok(())
    }

    /// `GET` of a JSON document.
    pub fn get(&self, path: &str) -> anyhow::Result<Value> {
        self.exchange("GET", path, 0, "")
    }

    /// Sends `request` as it is, and reads the answer to its end; gives the code of its status. HTTP/1.0 or `Connection:
    /// close` makes it end.
    pub fn raw(&self, request: &[u8], patience: Duration) -> anyhow::Result<u16> {
        let mut stream = TcpStream::connect(self.address())?;
        stream.set_read_timeout(Some(patience))?;
        // A request that is refused before its end is not taken in to its end.
        let _ = stream.write_all(request);
        read_status(stream)
    }

    /// Where it listens, as `ADDRESS:PORT`.
    pub fn address(&self) -> &str {
        self.url.trim_start_matches("http://")
    }

    /// The most memory that the process has ever held, bytes.
    pub fn peak_memory_bytes(&self) -> anyhow::Result<u64> {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.process.id()))?;
        let peak = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
        let kib =
            peak.and_then(|peak| peak.trim().strip_suffix("kB")).context("the system tells no VmHWM")?;
        Ok(1024 * kib.trim().parse::<u64>()?)
    }

    /// `POST` of a JSON document, answered by another one (or by nothing).
    pub fn post(&self, path: &str, body: &Value) -> anyhow::Result<Value> {
        self.exchange("POST", path, 0, &body.to_string())
    }

    /// The same under a lease, as the operator's page sends it.
    pub fn post_under(&self, lease: u64, path: &str, body: &Value) -> anyhow::Result<Value> {
        self.exchange("POST", path, lease, &body.to_string())
    }

    /// `POST` of nothing by a client that calls the studio `host`; gives the status line.
    pub fn post_as(&self, host: &str, path: &str) -> anyhow::Result<String> {
        let mut stream = TcpStream::connect(self.url.trim_start_matches("http://"))?;
        write!(stream, "POST /api/v1{path} HTTP/1.0\r\nHost: {host}\r\nContent-Length: 0\r\n\r\n")?;
        let mut answer = String::new();
        stream.read_to_string(&mut answer)?;
        Ok(answer.lines().next().unwrap_or_default().to_owned())
    }

    /// The process.
    pub fn pid(&self) -> u32 {
        self.process.id()
    }

    /// Sends it a signal, e.g. `TERM`.
    pub fn signal(&self, name: &str) -> anyhow::Result<()> {
        let status =
            Command::new("kill").args([&format!("-{name}"), &self.process.id().to_string()]).status()?;
        if !status.success() {
            bail!("kill -{name} failed: {status}");
        }
        Ok(())
    }

    /// Waits until it has ended; gives its exit code, or `None` if it runs on after `patience`.
    pub fn ended(&mut self, patience: Duration) -> anyhow::Result<Option<i32>> {
        let begun = std::time::Instant::now();
        loop {
            if let Some(status) = self.process.try_wait()? {
                return Ok(Some(status.code().unwrap_or(-1)));
            }
            if begun.elapsed() > patience {
                return Ok(None);
            }
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    fn exchange(&self, method: &str, path: &str, lease: u64, body: &str) -> anyhow::Result<Value> {
        let address = self.address();
        let mut stream = TcpStream::connect(address)?;
        stream.set_read_timeout(Some(Duration::from_secs(60)))?;
        // HTTP/1.0: the answer ends where the connection does.
        let head = format!(
            "{method} /api/v1{path} HTTP/1.0\r\nHost: {address}\r\nContent-Type: application/json\r\n\
             Palpate-Lease: {lease}\r\nContent-Length: {}\r\n\r\n",
            body.len()
        );
        stream.write_all(head.as_bytes())?;
        stream.write_all(body.as_bytes())?;
        let mut answer = String::new();
        stream.read_to_string(&mut answer)?;
        let (head, content) = answer.split_once("\r\n\r\n").context("the answer has no end of its head")?;
        let status = head.lines().next().unwrap_or_default();
        if !status.contains(" 200 ") && !status.contains(" 201 ") {
            bail!("{method} {path}: {status}: {content}");
        }
        if content.is_empty() {
            return Ok(Value::Null);
        }
        serde_json::from_str(content).with_context(|| format!("{method} {path}: no JSON: {content}"))
    }
}

/// Reads an answer to its end; gives the code of its status.
pub fn read_status(mut stream: TcpStream) -> anyhow::Result<u16> {
    let mut answer = Vec::new();
    // Whoever refuses a request may close the connection while more of it comes.
    let ended = stream.read_to_end(&mut answer);
    let text = String::from_utf8_lossy(&answer);
    let code = text.split_whitespace().nth(1).and_then(|code| code.parse().ok());
    code.with_context(|| format!("no answer: {ended:?} {:?}", text.lines().next()))
}

/// `palpate serve` on any free port.
fn serve(tools: &Tools, data: &Path, station: impl IntoIterator<Item = impl AsRef<OsStr>>) -> Command {
    let mut command = tools.palpate();
    command.args(["serve", "--listen", "127.0.0.1:0", "--data"]).arg(data).args(station);
    command
}

/// Prints and keeps what a studio logs.
fn read_log(stderr: ChildStderr, kept: &Mutex<String>) {
    for line in BufReader::new(stderr).lines().map_while(Result::ok) {
        eprintln!("{line}");
        let mut log = kept.lock().unwrap_or_else(PoisonError::into_inner);
        log.push_str(&line);
        log.push('\n');
    }
}

impl Drop for Studio {
    fn drop(&mut self) {
        // Before it serves, the studio may be xtask and what it has started: the whole group ends.
        let group = format!("-{}", self.process.id());
        let _ = Command::new("kill").args(["-TERM", "--", &group]).stderr(Stdio::null()).status();
        let _ = self.process.wait();
    }
}
