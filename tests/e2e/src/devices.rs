//! A running emulation of the station's devices.

use std::{
    io::{BufRead as _, BufReader},
    net::{IpAddr, Ipv4Addr, TcpListener},
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
};

use anyhow::{Context as _, bail};
use serde_json::Value;

use crate::{Tools, Turn, beside_a_station, root};

/// `palpate devices emulate`; it ends when this is dropped.
pub struct Devices {
    process: Child,
    _turn: Turn,
    /// Link to the servos' line.
    pub u2d2: PathBuf,
    /// Links to the fingertips' boards.
    pub twintac: Vec<PathBuf>,
    /// Link to the board of force resistors.
    pub fsr: PathBuf,
    /// Address of the arm.
    pub xarm: IpAddr,
}

impl Devices {
    /// Starts the emulation with its links in `dir` and waits until it is ready. `host` makes the arm's address, so that
    /// tests side by side do not meet: 127.0.5.`host`.
    ///
    /// `None` (with a message) where ports below 1024 may not be listened on.
    pub fn start(tools: &Tools, dir: &Path, host: u8) -> anyhow::Result<Option<Self>> {
        let turn = beside_a_station();
        let xarm = IpAddr::V4(Ipv4Addr::new(127, 0, 5, host));
        if let Err(err) = TcpListener::bind((xarm, 502)) {
            if err.kind() != std::io::ErrorKind::PermissionDenied {
                bail!("port 502 of {xarm} is not free: {err}");
            }
            eprintln!(
                "skipped: the arm's port 502 needs `sudo sysctl net.ipv4.ip_unprivileged_port_start=502`"
            );
            return Ok(None);
        }
        let mut process = Command::new(&tools.palpate)
            .args(["devices", "emulate", "--xarm-ip", &xarm.to_string(), "--dir"])
            .arg(dir)
            .arg("--truth")
            .arg(root().join("assets/truth/demo.toml"))
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .spawn()
            .with_context(|| format!("failed to start {:?}", tools.palpate))?;
        let stdout = process.stdout.take().context("the emulation has no standard output")?;
        let mut ready = String::new();
        BufReader::new(stdout).read_line(&mut ready)?;
        let found: Value =
            serde_json::from_str(&ready).with_context(|| format!("no JSON line: {ready:?}"))?;
        let link =
            |value: &Value| value.as_str().map(PathBuf::from).with_context(|| format!("no path: {value}"));
        Ok(Some(Self {
            process,
            _turn: turn,
            u2d2: link(&found["u2d2"])?,
            twintac: found["twintac"].as_array().into_iter().flatten().map(link).collect::<Result<_, _>>()?,
            fsr: link(&found["fsr"])?,
            xarm: found["xarm"].as_str().context("no address")?.parse()?,
        }))
    }

    /// Ends the emulation as service managers do, and waits until it has cleaned up.
    pub fn stop(mut self) -> anyhow::Result<std::process::ExitStatus> {
        terminate(&self.process);
        Ok(self.process.wait()?)
    }
}

impl Drop for Devices {
    fn drop(&mut self) {
        terminate(&self.process);
        let _ = self.process.wait();
    }
}

fn terminate(process: &Child) {
    let _ = Command::new("kill").args(["-TERM", &process.id().to_string()]).stderr(Stdio::null()).status();
}
