//! What joints and devices report, and what follows from it: presence, age, stillness.

/// A joint that is slower than this stands still; rad/s or m/s. Two steps of a small servo's speed reading.
pub(crate) const STILL_VELOCITY: f64 = 0.05;
/// A joint has come to rest once it stands still for this long, ns.
pub(crate) const AT_REST_NS: u64 = 100_000_000;

/// What is known of joints and devices now.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Measured {
    /// The newest reading of each degree of freedom, in the station's order; `None` while its device is not there.
    pub joints: Vec<Option<JointReading>>,
    /// What is wrong with devices now; each keeps the station from being armed.
    pub faults: Vec<DeviceFault>,
}

/// One reading of a joint; rad or m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointReading {
    /// Where it is.
    pub position: f64,
    /// How fast it moves, per s.
    pub velocity: f64,
    /// Whether its motor holds it; `None` where the device does not say.
    pub torque_on: Option<bool>,
    /// When the reading came in, ns.
    pub received_ns: u64,
}

/// Something wrong with a device.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DeviceFault {
    /// Id of the device in the station file.
    pub device: String,
    /// The joint concerned, if it is one.
    pub dof: Option<usize>,
    /// What is wrong and what to do, in words.
    pub problem: String,
}

impl Measured {
    /// Nothing is known of `num_dofs` joints.
    pub fn new(num_dofs: usize) -> Self {
        Self { joints: vec![None; num_dofs], faults: Vec::new() }
    }

    /// A reading came in. One of an unknown joint is left out.
    pub fn read(&mut self, dof: usize, reading: JointReading) {
        if let Some(joint) = self.joints.get_mut(dof) {
            *joint = Some(reading);
        }
    }

    /// The device that reads `dofs` is gone.
    pub fn lost(&mut self, dofs: &[usize]) {
        for &dof in dofs {
            if let Some(joint) = self.joints.get_mut(dof) {
                *joint = None;
            }
        }
    }

    /// What is wrong with `device` now, in place of what was; an empty `problem` for nothing.
    pub fn set_fault(&mut self, device: &str, dof: Option<usize>, problem: &str) {
        self.faults.retain(|fault| fault.device != device);
        if !problem.is_empty() {
            self.faults.push(DeviceFault { device: device.to_owned(), dof, problem: problem.to_owned() });
        }
    }
}

/// Readings with what they tell over time.
#[derive(Clone, Debug)]
pub(crate) struct Telemetry {
    pub(crate) joints: Vec<JointTelemetry>,
    pub(crate) faults: Vec<DeviceFault>,
}

#[derive(Clone, Debug, Default)]
pub(crate) struct JointTelemetry {
    pub(crate) reading: Option<JointReading>,
    /// Its readings are no numbers.
    pub(crate) senseless: bool,
    still_since_ns: Option<u64>,
}

impl Telemetry {
    pub(crate) fn new(num_dofs: usize) -> Self {
        Self { joints: vec![JointTelemetry::default(); num_dofs], faults: Vec::new() }
    }

    pub(crate) fn take(&mut self, now_ns: u64, measured: &Measured) {
        for (dof, joint) in self.joints.iter_mut().enumerate() {
            joint.take(now_ns, measured.joints.get(dof).copied().flatten());
        }
        self.faults.clone_from(&measured.faults);
    }
}

impl JointTelemetry {
    fn take(&mut self, now_ns: u64, reading: Option<JointReading>) {
        let Some(reading) = reading else {
            *self = Self::default();
            return;
        };
        self.senseless = !(reading.position.is_finite() && reading.velocity.is_finite());
        if self.senseless {
            (self.reading, self.still_since_ns) = (None, None);
            return;
        }
        // Nothing is received before it is told of.
        let reading = JointReading { received_ns: reading.received_ns.min(now_ns), ..reading };
        if self.reading.is_some_and(|newest| reading.received_ns <= newest.received_ns) {
            return;
        }
        if reading.velocity.abs() <= STILL_VELOCITY {
            self.still_since_ns.get_or_insert(reading.received_ns);
        } else {
            self.still_since_ns = None;
        }
        self.reading = Some(reading);
    }

    /// The reading, if it is no older than `ttl_ns`.
    pub(crate) fn fresh(&self, now_ns: u64, ttl_ns: u64) -> Option<JointReading> {
        self.reading.filter(|reading| now_ns.saturating_sub(reading.received_ns) <= ttl_ns)
    }

    /// Whether readings from `since_ns` on show that it has come to rest.
    pub(crate) fn at_rest(&self, since_ns: u64) -> bool {
        let (Some(reading), Some(still_since_ns)) = (self.reading, self.still_since_ns) else { return false };
        reading.received_ns.saturating_sub(still_since_ns.max(since_ns)) >= AT_REST_NS
    }
}
