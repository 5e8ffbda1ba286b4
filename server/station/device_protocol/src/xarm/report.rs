//! What the box pushes without being asked. Firmware has grown these frames over the years, so a report has what its size
//! holds, and bytes behind the last field that is known stay as they are.

use crate::{
    DecodeCounters, LayoutError,
    fields::{Fields, Reader, Writer},
};

use super::command::{MM, NUM_JOINT_SLOTS, Pose};

/// Size that some firmware declares for frames of [`REAL_SIZE_OF_233`] bytes.
const DECLARED_233: u32 = 233;
const REAL_SIZE_OF_233: u32 = 245;
const MAX_SIZE: u32 = 2048;
const MIN_SIZE: u32 = 87;
/// First size of the 250 Hz stream that is documented.
const MIN_REALTIME_SIZE: u32 = 784;

/// The report streams.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ReportKind {
    /// Ports 30001 and 30002, 5 Hz.
    Normal,
    /// Port 30003, 100 Hz.
    Real,
    /// Port 30000, 200 or 250 Hz. Its layout is its own: see [`Realtime`].
    Realtime,
}

/// One report.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Report {
    /// The size that the frame declares.
    pub declared_size: u32,
    /// 1 moving, 2 ready, 3 paused, 4 stopped, 5 mode changed, 6 decelerating.
    pub state: u8,
    /// Mode, 0 to 11.
    pub mode: u8,
    /// Commands in the queue.
    pub num_commands: u16,
    /// Measured angles.
    pub joint_rad: [f64; NUM_JOINT_SLOTS],
    /// Measured pose of the tool.
    pub pose: Pose,
    /// Torques, or currents if the box was told so.
    pub joint_effort: [f64; NUM_JOINT_SLOTS],
    /// From byte 87 on port 30003.
    pub wrenches: Option<Wrenches>,
    /// From byte 87 on ports 30001 and 30002.
    pub safety: Option<ReportSafety>,
    /// From byte 133 on ports 30001 and 30002: direction of gravity.
    pub gravity_direction: Option<[f64; 3]>,
    /// From byte 145 on port 30002.
    pub tools: Option<ReportTools>,
    /// From byte 181 on port 30002.
    pub limits: Option<ReportLimits>,
    /// From byte 229 on port 30002.
    pub rest: ReportRest,
    /// Port 30000 only.
    pub realtime: Option<Realtime>,
    /// What follows the last field that the size holds.
    pub tail: Vec<u8>,
}

/// What only the 250 Hz stream has, besides joints, pose and torques.
#[derive(Debug, Clone, PartialEq)]
pub struct Realtime {
    /// Time of the box.
    pub box_time_us: u64,
    /// Bytes 15 to 31, which are not documented.
    pub undocumented: [u8; 17],
    /// Commanded angles, velocities and accelerations.
    pub target: [[f64; NUM_JOINT_SLOTS]; 3],
    /// Measured velocities.
    pub joint_rad_per_sec: [f64; NUM_JOINT_SLOTS],
    /// Measured accelerations.
    pub joint_rad_per_sec2: [f64; NUM_JOINT_SLOTS],
    /// Currents.
    pub current_a: [f64; NUM_JOINT_SLOTS],
    /// Bytes 256 to 423, which are not documented.
    pub undocumented_too: [u8; 168],
    /// Commanded pose of the tool.
    pub target_pose: Pose,
    /// Commanded velocity of the tool: m/s, then rad/s.
    pub target_twist: Pose,
    /// Measured velocity of the tool: m/s, then rad/s.
    pub twist: Pose,
}

impl Default for Realtime {
    fn default() -> Self {
        Self {
            box_time_us: 0,
            undocumented: [0; 17],
            target: Default::default(),
            joint_rad_per_sec: Default::default(),
            joint_rad_per_sec2: Default::default(),
            current_a: Default::default(),
            undocumented_too: [0; 168],
            target_pose: Pose::default(),
            target_twist: Pose::default(),
            twist: Pose::default(),
        }
    }
}

/// Force and torque of the tool.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Wrenches {
    /// Force (N) and torque (Nm) without gravity and offset.
    pub external: [f64; 6],
    /// Force (N) and torque (Nm) as measured.
    pub raw: [f64; 6],
}

/// Motors, errors and settings.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct ReportSafety {
    /// Bit i: the brake of joint i+1 is released.
    pub brake_bits: u8,
    /// Bit i: joint i+1 is enabled.
    pub enable_bits: u8,
    /// 0 for none.
    pub error: u8,
    /// 0 for none.
    pub warning: u8,
    /// Tool frame on the flange.
    pub tcp_offset: Pose,
    /// Load on the flange.
    pub load_kg: f64,
    /// Its centre of mass.
    pub load_center_m: [f64; 3],
    /// 0 to 5.
    pub collision_sensitivity: u8,
    /// 0 to 5.
    pub teach_sensitivity: u8,
}

/// What the arm is.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct ReportTools {
    /// Type, axes and bus ids.
    pub identity: [u8; 6],
    /// Text padded with zero bytes.
    pub version: [u8; 30],
}

/// Limits of motion.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct ReportLimits {
    /// Jerk (m/s^3), smallest and largest acceleration (m/s^2), smallest and largest speed (m/s) of the tool.
    pub tcp: [f64; 5],
    /// The same of the joints, in rad.
    pub joint: [f64; 5],
    /// Jerk and acceleration of the tool's rotation, in rad.
    pub rotation: [f64; 2],
}

/// Fields that came with later firmware, each present if the size holds it.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ReportRest {
    /// Status and code of each servo, then two bytes of the tool's inputs.
    pub servo_status: Option<[u8; 16]>,
    /// Temperatures of the servos, two's complement, degrees Celsius.
    pub temperature_c: Option<[u8; NUM_JOINT_SLOTS]>,
    /// Speed of the tool (m/s).
    pub tcp_speed_m_per_sec: Option<f64>,
    /// Velocities.
    pub joint_rad_per_sec: Option<[f64; NUM_JOINT_SLOTS]>,
    /// Reports since the box started.
    pub counter: Option<u32>,
    /// Base in the world.
    pub world_offset: Option<Pose>,
    /// Reset of inputs (2), simulation, self-collision check, tool model.
    pub switches: Option<[u8; 5]>,
    /// Parameters of the tool model.
    pub tool_params: Option<[f64; 6]>,
    /// Supply of each servo, in hundredths of a volt.
    pub voltage_centivolt: Option<[u16; NUM_JOINT_SLOTS]>,
    /// Currents.
    pub current_a: Option<[f64; NUM_JOINT_SLOTS]>,
    /// Inputs and outputs of the box.
    pub box_io: Option<[u8; 50]>,
    /// Force and torque.
    pub wrenches: Option<Wrenches>,
}

impl Report {
    /// Whether the arm follows commands: neither stopped nor in a changed mode, and all of `num_axes` joints enabled with
    /// their brakes released. `None` if the stream does not say.
    pub fn ready(&self, num_axes: u32) -> Option<bool> {
        let all = 1_u32.checked_shl(num_axes).map_or(u32::MAX, |bit| bit - 1);
        let safety = self.safety?;
        let on = u32::from(safety.brake_bits & safety.enable_bits) & all == all & 0xFF;
        Some(on && !matches!(self.state, 4 | 5))
    }

    /// Understands one whole frame.
    pub fn decode(kind: ReportKind, bytes: &[u8]) -> Result<Self, LayoutError> {
        let mut report = Self::default();
        let mut reader = Reader::new(bytes);
        report.fields(kind, &mut reader);
        reader.finish()?;
        Ok(report)
    }

    /// The bytes on the line: fields in order up to the first that is `None`, then the tail. `declared_size` is sent as
    /// it is.
    pub fn encode(&self, kind: ReportKind) -> Result<Vec<u8>, LayoutError> {
        let mut writer = Writer::default();
        self.clone().fields(kind, &mut writer);
        writer.finish()
    }

    fn fields<F: Fields>(&mut self, kind: ReportKind, fields: &mut F) {
        fields.u32(&mut self.declared_size);
        let mut realtime = self.realtime.take().unwrap_or_default();
        if kind == ReportKind::Realtime {
            fields.u64(&mut realtime.box_time_us);
        }
        let mut state_and_mode = (self.mode << 4) | (self.state & 0x0F);
        fields.u8(&mut state_and_mode);
        (self.state, self.mode) = (state_and_mode & 0x0F, state_and_mode >> 4);
        fields.u16(&mut self.num_commands);
        if kind == ReportKind::Realtime {
            fields.raw(&mut realtime.undocumented);
            fields.f32s(realtime.target.as_flattened_mut(), 1.0);
            fields.f32s(&mut self.joint_rad, 1.0);
            fields.f32s(&mut realtime.joint_rad_per_sec, 1.0);
            fields.f32s(&mut realtime.joint_rad_per_sec2, 1.0);
            fields.f32s(&mut realtime.current_a, 1.0);
            fields.f32s(&mut self.joint_effort, 1.0);
            fields.raw(&mut realtime.undocumented_too);
            realtime.target_pose.fields(fields);
            realtime.target_twist.fields(fields);
            self.pose.fields(fields);
            realtime.twist.fields(fields);
            self.realtime = Some(realtime);
            fields.rest(&mut self.tail);
            return;
        }
        fields.f32s(&mut self.joint_rad, 1.0);
        self.pose.fields(fields);
        fields.f32s(&mut self.joint_effort, 1.0);
        if kind == ReportKind::Real {
            fields.optional(&mut self.wrenches, 48, |f, v| v.fields(f));
        } else {
            fields.optional(&mut self.safety, 46, |f, v| v.fields(f));
            fields.optional(&mut self.gravity_direction, 12, |f, v| f.f32s(v, 1.0));
            fields.optional(&mut self.tools, 36, |f, v| {
                f.raw(&mut v.identity);
                f.raw(&mut v.version);
            });
            fields.optional(&mut self.limits, 48, |f, v| {
                f.f32s(&mut v.tcp, MM);
                f.f32s(&mut v.joint, 1.0);
                f.f32s(&mut v.rotation, 1.0);
            });
            if self.limits.is_some() {
                self.rest.fields(fields);
            }
        }
        fields.rest(&mut self.tail);
    }
}

impl Wrenches {
    fn fields<F: Fields>(&mut self, fields: &mut F) {
        fields.f32s(&mut self.external, 1.0);
        fields.f32s(&mut self.raw, 1.0);
    }
}

impl ReportSafety {
    fn fields<F: Fields>(&mut self, fields: &mut F) {
        for byte in [&mut self.brake_bits, &mut self.enable_bits, &mut self.error, &mut self.warning] {
            fields.u8(byte);
        }
        self.tcp_offset.fields(fields);
        fields.f32(&mut self.load_kg, 1.0);
        fields.f32s(&mut self.load_center_m, MM);
        fields.u8(&mut self.collision_sensitivity);
        fields.u8(&mut self.teach_sensitivity);
    }
}

impl ReportRest {
    fn fields<F: Fields>(&mut self, fields: &mut F) {
        macro_rules! next {
            ($field:ident, $num_bytes:literal, $blank:expr, $visit:expr) => {
                if !fields.present(self.$field.is_some(), $num_bytes) {
                    return;
                }
                let visit: fn(&mut F, &mut _) = $visit;
                visit(fields, self.$field.get_or_insert($blank));
            };
        }
        next!(servo_status, 16, [0; 16], F::raw);
        next!(temperature_c, 7, [0; NUM_JOINT_SLOTS], F::raw);
        next!(tcp_speed_m_per_sec, 4, 0.0, |f, v| f.f32(v, MM));
        next!(joint_rad_per_sec, 28, [0.0; NUM_JOINT_SLOTS], |f, v| f.f32s(v, 1.0));
        next!(counter, 4, 0, F::u32);
        next!(world_offset, 24, Pose::default(), |f, v: &mut Pose| v.fields(f));
        next!(switches, 5, [0; 5], F::raw);
        next!(tool_params, 24, [0.0; 6], |f, v| f.f32s(v, 1.0));
        next!(voltage_centivolt, 14, [0; NUM_JOINT_SLOTS], |f, v: &mut [u16; NUM_JOINT_SLOTS]| v
            .iter_mut()
            .for_each(|v| f.u16(v)));
        next!(current_a, 28, [0.0; NUM_JOINT_SLOTS], |f, v| f.f32s(v, 1.0));
        next!(box_io, 50, [0; 50], F::raw);
        next!(wrenches, 48, Wrenches::default(), |f, v: &mut Wrenches| v.fields(f));
    }
}

/// Incremental decoder for one report connection.
#[derive(Debug, Clone)]
pub struct ReportDecoder {
    kind: ReportKind,
    buffer: Vec<u8>,
    lost: bool,
    counters: DecodeCounters,
}

impl ReportDecoder {
    /// A decoder for a connection to one of the report ports.
    pub fn new(kind: ReportKind) -> Self {
        Self { kind, buffer: Vec::new(), lost: false, counters: DecodeCounters::default() }
    }

    /// Takes the next bytes of the stream and gives the reports that they complete.
    pub fn feed(&mut self, bytes: &[u8]) -> Vec<Report> {
        self.buffer.extend_from_slice(bytes);
        let mut reports = Vec::new();
        let mut at = 0;
        while let Some(size) = self.buffer[at..].first_chunk::<4>() {
            let declared = u32::from_be_bytes(*size);
            let size = if declared == DECLARED_233 { REAL_SIZE_OF_233 } else { declared };
            let least = if self.kind == ReportKind::Realtime { MIN_REALTIME_SIZE } else { MIN_SIZE };
            let decoded = if (least..=MAX_SIZE).contains(&size) {
                let Some(frame) = self.buffer[at..].get(..size as usize) else { break };
                Report::decode(self.kind, frame).ok().filter(believable)
            } else {
                None
            };
            if let Some(report) = decoded {
                reports.push(report);
                self.counters.deliver(size as usize);
                self.lost = false;
                at += size as usize;
            } else {
                self.counters.drop_bytes(1);
                self.counters.malformed += u64::from(!self.lost);
                self.lost = true;
                at += 1;
            }
        }
        self.buffer.drain(..at);
        reports
    }

    /// What became of the bytes so far.
    pub fn counters(&self) -> DecodeCounters {
        self.counters
    }

    /// Bytes of a report that may have begun.
    pub fn pending(&self) -> &[u8] {
        &self.buffer
    }
}

/// Ranges outside which a stream is out of step.
fn believable(report: &Report) -> bool {
    let sensitivities =
        report.safety.is_none_or(|s| s.collision_sensitivity <= 5 && s.teach_sensitivity <= 5);
    report.mode <= 11 && report.state <= 9 && sensitivities
}
