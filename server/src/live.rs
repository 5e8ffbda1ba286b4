//! The live station: the control loop on its devices, which may be emulated ones; the drivers cannot tell.

use std::{path::PathBuf, sync::Arc};

use palpate_control::{Control, ControlConfig, Handle};
use palpate_drivers::Ports;
use palpate_robot_model::Station;
use palpate_wire::api::Source;

use crate::{Error, Hub, Store, emulated::EmulatedDevices};

/// Which station is live.
#[derive(Clone, Debug)]
pub enum LiveStation {
    /// A station with its devices.
    Real {
        /// The station.
        station: Arc<Station>,
        /// Where its devices are, where that is not what the station says.
        ports: Ports,
    },
    /// The emulated devices of a truth file.
    Emulated(PathBuf),
}

/// The live station; it stops when this is dropped.
pub(crate) struct Live {
    // Dropped in this order: the control loop lets go of the devices before they vanish.
    _control: Control,
    handle: Handle,
    emulated: Option<EmulatedDevices>,
}

impl Live {
    /// Opens the station and publishes its state to `hub`. Sessions are recorded into `store`.
    pub(crate) fn start(which: &LiveStation, seed: u64, store: &Store, hub: Arc<Hub>) -> Result<Self, Error> {
        let (station, ports, emulated) = match which {
            LiveStation::Real { station, ports } => (station.clone(), ports.clone(), None),
            LiveStation::Emulated(truth) => {
                let emulated = EmulatedDevices::start(truth, seed)?;
                (emulated.station().clone(), emulated.ports().clone(), Some(emulated))
            }
        };
        let place_object = emulated.as_ref().map(|devices| devices.object_placer());
        let source = if emulated.is_some() { Source::Emulated } else { Source::Real };
        let config = ControlConfig {
            station: station.clone(),
            ports,
            source,
            sessions_dir: store.sessions_dir(),
            audit_path: store.audit_path(),
            wanted_path: store.wanted_path(),
            place_object,
        };
        let control = Control::start(config, Box::new(move |frame| hub.publish_live(frame)))?;
        Ok(Self { handle: control.handle(), _control: control, emulated })
    }

    /// The station.
    pub(crate) fn station(&self) -> &Station {
        self.handle.station()
    }

    /// Whether its devices are real.
    pub(crate) fn source(&self) -> Source {
        self.handle.source()
    }

    /// Where requests go.
    pub(crate) fn handle(&self) -> &Handle {
        &self.handle
    }

    /// The emulated devices, if they are.
    pub(crate) fn emulated(&self) -> Option<&EmulatedDevices> {
        self.emulated.as_ref()
    }
}
