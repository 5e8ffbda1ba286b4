//! The person beside a station: a socket where an emulated one has it, or somebody at the keyboard.

use std::io::{BufRead as _, BufReader, Write as _};
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::time::Duration;

use anyhow::{Context as _, bail};
use serde_json::Value;

/// Placing an object takes a simulation of a second or two.
const PATIENCE: Duration = Duration::from_secs(60);

/// A connection to the operator's socket of `palpate-train station`.
pub struct Operator {
    lines: BufReader<UnixStream>,
}

impl Operator {
    /// Connects to the socket at `path`.
    ///
    /// # Errors
    /// No socket there, or nobody behind it.
    pub fn connect(path: &Path) -> anyhow::Result<Self> {
        let stream = UnixStream::connect(path).with_context(|| {
            format!("failed to connect to {path:?}; `palpate-train station` prints where it is")
        })?;
        stream.set_read_timeout(Some(PATIENCE))?;
        Ok(Self { lines: BufReader::new(stream) })
    }

    /// Asks for something; gives what the station answers.
    ///
    /// # Errors
    /// A refusal, with its reason, and a station that is gone.
    pub fn ask(&mut self, request: &Value) -> anyhow::Result<Value> {
        writeln!(self.lines.get_mut(), "{request}").context("the station's operator is gone")?;
        let mut line = String::new();
        if self.lines.read_line(&mut line).context("the station's operator does not answer")? == 0 {
            bail!("the station has ended");
        }
        let reply: Value = serde_json::from_str(&line).context("the station's operator answers no JSON")?;
        if reply["ok"] != true {
            bail!("{}", reply["problem"].as_str().unwrap_or("the station's operator refuses"));
        }
        Ok(reply)
    }
}
