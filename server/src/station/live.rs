//! The live station: the control loop on its devices, which may be emulated ones; the drivers cannot tell.

use std::{path::PathBuf, sync::Arc, time::Duration};

use palpate_control::{AuditFile, Control, ControlConfig, Ending, Handle};
use palpate_drivers::Ports;
use palpate_emulator::StationControl;
use palpate_robot_model::Station;
use palpate_wire::api::Source;

use super::EmulatedDevices;
use crate::{Error, Hub, Store};

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

/// The live station as requests know it: they speak to it, and cannot end it.
pub(crate) struct Live {
    handle: Handle,
    emulated: Option<StationControl>,
}

/// The live station itself. It belongs to whoever runs the server and nobody else, so that its end does not depend on
/// requests that are still under way.
pub struct RunningStation {
    // Dropped in this order: the control loop lets go of the devices before they vanish.
    control: Control,
    _emulated: Option<EmulatedDevices>,
}

impl Live {
    /// Opens the station and publishes its state to `hub`. Sessions are recorded into `store`.
    pub(crate) fn start(
        which: &LiveStation,
        seed: u64,
        store: &Store,
        audit: AuditFile,
        hub: Arc<Hub>,
    ) -> Result<(Self, RunningStation), Error> {
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
            station,
            ports,
            source,
            sessions_dir: store.sessions_dir(),
            audit,
            wanted_path: store.wanted_path(),
            latch_path: store.latch_path(),
            place_object,
        };
        let control = Control::start(config, Box::new(move |frame| hub.publish_live(frame)))?;
        let live = Self {
            handle: control.handle(),
            emulated: emulated.as_ref().map(|devices| devices.control().clone()),
        };
        Ok((live, RunningStation { control, _emulated: emulated }))
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
    pub(crate) fn emulated(&self) -> Option<&StationControl> {
        self.emulated.as_ref()
    }
}

impl RunningStation {
    /// Ends all motion and says what readings confirm, within `patience`.
    pub fn end_motion(&self, patience: Duration) -> Ending {
        self.control.end(patience)
    }

    /// Waits until recordings, the audit log and the devices have ended, for `patience` at most; says whether they have.
    pub fn finish(mut self, patience: Duration) -> bool {
        self.control.finish(patience)
    }
}
