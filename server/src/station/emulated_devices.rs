//! Emulated devices in this process, on links in a folder of their own and on free ports.

use std::{
    net::{IpAddr, Ipv4Addr},
    path::Path,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
        mpsc,
    },
    thread::{self, JoinHandle},
};

use palpate_control::PlaceObject;
use palpate_drivers::{PortOverride, Ports, priority};
use palpate_emulator::{ArmPorts, DevicePorts, EmulatedStation, PortsConfig, StationControl, serve_devices};
use palpate_robot_model::{DeviceKind, Station};
use tempfile::TempDir;

use crate::{Error, chain};

/// Devices that run until this is dropped.
pub struct EmulatedDevices {
    station: Arc<Station>,
    ports: Ports,
    control: StationControl,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
    _links: TempDir,
}

impl EmulatedDevices {
    /// Starts the devices of the truth file at `truth`.
    pub fn start(truth: &Path, seed: u64) -> Result<Self, Error> {
        let mut emulated = EmulatedStation::new(truth, seed)?;
        let station = Arc::new(emulated.station().clone());
        let control = emulated.control();
        let links = tempfile::tempdir().map_err(Error::io("make", std::env::temp_dir()))?;
        let config = PortsConfig {
            dir: links.path().to_owned(),
            arm_ip: IpAddr::V4(Ipv4Addr::LOCALHOST),
            arm_ports: ArmPorts::Any,
        };
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = stop.clone();
        let (found_there, found) = mpsc::sync_channel(1);
        let run = move || {
            // Real devices wait for nobody.
            priority::real_time();
            let ready = found_there.clone();
            let served = serve_devices(
                &mut emulated,
                &config,
                &stopped,
                // Nobody waits any more if the start was given up.
                &mut |ports| drop(ready.try_send(Ok(ports.clone()))),
                &mut |notice| tracing::warn!("{notice}"),
            );
            if let Err(err) = served {
                tracing::error!(err = chain(&err), "the emulated devices ended");
                drop(found_there.try_send(Err(chain(&err))));
            }
        };
        let thread = thread::Builder::new()
            .name("emulated-devices".to_owned())
            .spawn(run)
            .map_err(|err| Error::Internal(format!("failed to start the emulated devices: {err}")))?;
        let found = match found.recv() {
            Ok(Ok(found)) => found,
            Ok(Err(problem)) => {
                return Err(Error::Internal(format!("the emulated devices did not start: {problem}")));
            }
            Err(_) => {
                return Err(Error::Internal("the emulated devices ended before they had started".to_owned()));
            }
        };
        let ports = overrides(&station, &found);
        Ok(Self { station, ports, control, stop, thread: Some(thread), _links: links })
    }

    /// The station that they are of.
    pub fn station(&self) -> &Arc<Station> {
        &self.station
    }

    /// What is truly going on.
    pub fn control(&self) -> &StationControl {
        &self.control
    }

    /// Where the drivers find them.
    pub fn ports(&self) -> &Ports {
        &self.ports
    }

    /// Puts an object where the session that is recorded wants it: nobody stands beside an emulated station.
    pub(crate) fn object_placer(&self) -> PlaceObject {
        let control = self.control.clone();
        Box::new(move |object| control.place_object(Some(object)).map_err(|err| chain(&err)))
    }
}

/// Where the station's devices are found: lines and arm go by the ids that the station has for them.
fn overrides(station: &Station, found: &DevicePorts) -> Ports {
    let mut ports = Ports::new();
    for device in &station.devices {
        let port = match &device.kind {
            DeviceKind::Xarm(_) => Some(PortOverride::Arm {
                address: found.arm_ip,
                command_port: found.arm_ports.command,
                report_port: found.arm_ports.real,
            }),
            _ => found
                .links
                .iter()
                .find(|(line, _)| *line == device.id)
                .map(|(_, path)| PortOverride::Serial(path.clone())),
        };
        if let Some(port) = port {
            ports.insert(device.id.clone(), port);
        }
    }
    ports
}

impl Drop for EmulatedDevices {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            tracing::error!("the thread of the emulated devices panicked");
        }
    }
}
