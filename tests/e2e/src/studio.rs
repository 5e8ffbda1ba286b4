//! A running studio.

use std::{
    io::{BufRead as _, BufReader},
    os::unix::process::CommandExt as _,
    path::Path,
    process::{Child, Command, Stdio},
};

use anyhow::Context as _;

use crate::Tools;

/// The studio as `cargo xtask studio` starts it, on a free port; it ends when this is dropped.
pub struct Studio {
    process: Child,
    /// Where the page is.
    pub url: String,
}

impl Studio {
    /// Starts the studio on `data` and waits until it says where it listens.
    pub fn start(tools: &Tools, data: &Path) -> anyhow::Result<Self> {
        let mut process = Command::new(&tools.xtask)
            .args(["studio", "--listen", "127.0.0.1:0", "--bin"])
            .arg(&tools.palpate)
            .arg("--data")
            .arg(data)
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .process_group(0)
            .spawn()
            .with_context(|| format!("failed to start {:?}", tools.xtask))?;
        let stdout = process.stdout.take().context("the studio has no standard output")?;
        let mut lines = BufReader::new(stdout).lines();
        let url = loop {
            let line = lines.next().context("the studio ended before it said where it listens")??;
            if let Some(start) = line.find("http://") {
                break line[start..].split_whitespace().next().unwrap_or_default().to_owned();
            }
        };
        // Whatever else it prints must not fill the pipe.
        std::thread::spawn(move || lines.for_each(drop));
        Ok(Self { process, url })
    }
}

impl Drop for Studio {
    fn drop(&mut self) {
        // The studio is xtask and the server that it started: the whole group ends.
        let group = format!("-{}", self.process.id());
        let _ = Command::new("kill").args(["-TERM", "--", &group]).status();
        let _ = self.process.wait();
    }
}
