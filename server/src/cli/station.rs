//! Which station, and where its devices are.

use std::path::PathBuf;

use clap::Args;
use palpate_drivers::{PortOverride, Ports};
use palpate_recording::load_station;
use palpate_robot_model::{DeviceKind, Station};
use palpate_server::{Error, assets};

#[derive(Args)]
pub(crate) struct StationArgs {
    /// The station: a station file, or the id of a shipped one
    #[arg(long, value_name = "FILE")]
    station: Option<PathBuf>,
    /// Where a device is, if not where the station file says: `u2d2=/dev/ttyUSB1`, or `xarm=192.168.1.212`, with
    /// `:COMMAND_PORT/REPORT_PORT` if these are not the usual ones; may be given for several devices
    #[arg(long = "port", value_name = "DEVICE=WHERE", requires = "station")]
    ports: Vec<String>,
}

impl StationArgs {
    /// Whether a station was named.
    pub(crate) fn is_given(&self) -> bool {
        self.station.is_some()
    }

    /// Names a station where none was.
    pub(crate) fn fill_in(&mut self, station: Option<PathBuf>, ports: Vec<String>) {
        if self.station.is_none() && station.is_some() {
            (self.station, self.ports) = (station, ports);
        }
    }

    /// Reads the station, if one was named.
    pub(crate) fn open(&self) -> Result<Option<(Station, Ports)>, Error> {
        let Some(path) = &self.station else { return Ok(None) };
        let shipped =
            path.to_str().filter(|id| !path.exists() && assets::station_ids().iter().any(|s| s == id));
        let station = match shipped {
            Some(id) => assets::station(id)?,
            None => load_station(path)?,
        };
        let ports = self.ports.iter().map(|port| port_of(&station, port)).collect::<Result<_, _>>()?;
        Ok(Some((station, ports)))
    }
}

/// `DEVICE=WHERE`.
fn port_of(station: &Station, text: &str) -> Result<(String, PortOverride), Error> {
    let refused = |problem: &str| Error::Argument(format!("--port {text:?}: {problem}"));
    let (id, place) =
        text.split_once('=').ok_or_else(|| refused("expected DEVICE=WHERE, as in u2d2=/dev/ttyUSB1"))?;
    let Some(device) = station.devices.iter().find(|device| device.id == id) else {
        let known: Vec<&str> = station.devices.iter().map(|device| device.id.as_str()).collect();
        return Err(refused(&format!("the station has no device {id:?}; it has {}", known.join(", "))));
    };
    let port = match &device.kind {
        DeviceKind::Xarm(config) => {
            let (address, numbers) =
                place.split_once(':').map_or((place, None), |(ip, rest)| (ip, Some(rest)));
            let wrong =
                || refused("expected an address, as in xarm=192.168.1.212 or xarm=127.0.0.1:502/30003");
            let (command_port, report_port) = match numbers {
                None => (config.command_port, config.report_port),
                Some(numbers) => {
                    let (command, report) = numbers.split_once('/').ok_or_else(wrong)?;
                    (command.parse().map_err(|_| wrong())?, report.parse().map_err(|_| wrong())?)
                }
            };
            let address = address.parse().map_err(|_| wrong())?;
            PortOverride::Arm { address, command_port, report_port }
        }
        _ => PortOverride::Serial(PathBuf::from(place)),
    };
    Ok((id.to_owned(), port))
}
