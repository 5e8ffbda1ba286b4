//! The box's report streams: which there are, and what the present state looks like on each.

use palpate_device_protocol::xarm::{
    NUM_JOINT_SLOTS, Report, ReportKind, ReportLimits, ReportRest, ReportSafety, ReportTools, Wrenches,
};

use super::kinematics::to_pose;
use super::motion::{MOST_RAD_PER_SEC, MOST_RAD_PER_SEC2};
use super::{ArmBox, VERSION};

/// Supply of the joints, V, and temperature of their servos, degrees Celsius: neither changes here.
const SUPPLY_CENTIVOLT: u16 = 4800;
const TEMPERATURE_C: u8 = 32;

/// The ports on which the box reports.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum ReportPort {
    /// Port 30000: 250 Hz.
    Realtime,
    /// Port 30001: 5 Hz, the short report.
    Normal,
    /// Port 30002: 5 Hz, the long report.
    Rich,
    /// Port 30003: 100 Hz.
    Real,
}

impl ReportPort {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Realtime, Self::Normal, Self::Rich, Self::Real];

    /// The TCP port of the real box.
    pub const fn number(self) -> u16 {
        match self {
            Self::Realtime => 30_000,
            Self::Normal => 30_001,
            Self::Rich => 30_002,
            Self::Real => 30_003,
        }
    }

    /// Time between two reports, ms.
    pub(crate) fn period_ms(self) -> u64 {
        match self {
            Self::Realtime => 4,
            Self::Normal | Self::Rich => 200,
            Self::Real => 10,
        }
    }
}

impl ArmBox {
    /// The report for one port at `now_ns` since the box started.
    pub(crate) fn report(&mut self, port: ReportPort, now_ns: u64) -> Vec<u8> {
        let flange = self.model.base_from_flange(&self.joints_rad);
        let effort = self.effort_nm();
        let mut report = Report {
            state: self.state(),
            mode: self.mode,
            num_commands: self.queue_length(),
            joint_rad: slots(&self.joints_rad),
            pose: to_pose(&(flange * self.tool())),
            joint_effort: if self.settings.reports_current { self.current_a(&effort) } else { effort },
            ..Report::default()
        };
        let kind = match port {
            ReportPort::Realtime => {
                self.fill_realtime(&mut report, now_ns);
                ReportKind::Realtime
            }
            ReportPort::Real => {
                report.wrenches = Some(Wrenches::default());
                ReportKind::Real
            }
            ReportPort::Normal | ReportPort::Rich => {
                report.safety = Some(self.safety());
                report.gravity_direction = Some(self.settings.gravity_direction);
                if port == ReportPort::Rich {
                    self.fill_rich(&mut report, &effort);
                }
                ReportKind::Normal
            }
        };
        // All numbers here are finite; a report that could not be written would be left out.
        let mut bytes = report.encode(kind).unwrap_or_default();
        let size = (bytes.len() as u32).to_be_bytes();
        if let Some(head) = bytes.first_chunk_mut::<4>() {
            *head = size;
        }
        bytes
    }

    fn safety(&self) -> ReportSafety {
        ReportSafety {
            brake_bits: self.brake_bits,
            enable_bits: self.enable_bits,
            error: self.error,
            warning: self.warning,
            tcp_offset: self.settings.tcp_offset,
            load_kg: self.settings.load_kg,
            load_center_m: self.settings.load_center_m,
            collision_sensitivity: self.settings.collision_sensitivity,
            teach_sensitivity: self.settings.teach_sensitivity,
        }
    }

    fn fill_rich(&mut self, report: &mut Report, effort: &[f64; NUM_JOINT_SLOTS]) {
        let axes = self.model.num_joints() as u8;
        let mut version = [0; 30];
        for (slot, byte) in version.iter_mut().zip(VERSION.bytes()) {
            *slot = byte;
        }
        self.num_rich_reports = self.num_rich_reports.wrapping_add(1);
        let settings = &self.settings;
        report.tools = Some(ReportTools { identity: [axes, axes, 0xAA, 0x55, 1, 1], version });
        report.limits = Some(ReportLimits {
            tcp: [10.0, 0.0, 50.0, 0.0, 1.0],
            joint: [settings.joint_jerk, 0.0, settings.joint_most_acc, 0.0, MOST_RAD_PER_SEC],
            rotation: [MOST_RAD_PER_SEC2, MOST_RAD_PER_SEC2],
        });
        report.rest = ReportRest {
            servo_status: Some([0; 16]),
            temperature_c: Some([TEMPERATURE_C; NUM_JOINT_SLOTS]),
            tcp_speed_m_per_sec: Some(self.tool_twist()[..3].iter().map(|v| v * v).sum::<f64>().sqrt()),
            joint_rad_per_sec: Some(slots(&self.rad_per_sec)),
            counter: Some(self.num_rich_reports),
            world_offset: Some(palpate_device_protocol::xarm::Pose::default()),
            switches: Some([0, 0, u8::from(settings.simulation), u8::from(settings.self_collision), 0]),
            tool_params: Some([0.0; 6]),
            voltage_centivolt: Some([SUPPLY_CENTIVOLT; NUM_JOINT_SLOTS]),
            current_a: Some(self.current_a(effort)),
            box_io: Some([0; 50]),
            wrenches: Some(Wrenches::default()),
        };
        report.tail = self.rich_tail(report);
    }

    /// What newer firmware added behind the force sensor.
    fn rich_tail(&self, report: &Report) -> Vec<u8> {
        let settings = &self.settings;
        let rotation = nalgebra::UnitQuaternion::from_euler_angles(
            report.pose.rpy_rad[0],
            report.pose.rpy_rad[1],
            report.pose.rpy_rad[2],
        );
        let axis_angle = rotation.scaled_axis();
        let mut tail = vec![0];
        let single = |value: f64| (value as f32).to_le_bytes();
        tail.extend(axis_angle.iter().flat_map(|&value| single(value)));
        let flags = u8::from(settings.reduced)
            | (u8::from(settings.fence) << 1)
            | (u8::from(settings.reports_current) << 2);
        tail.extend([flags, u8::from(settings.reduced)]);
        tail.extend(settings.bounds_mm.iter().flat_map(|&bound| (bound as i16).to_be_bytes()));
        tail.extend(single(settings.reduced_m_per_sec * 1e3));
        tail.extend(single(settings.reduced_rad_per_sec));
        tail.extend(settings.reduced_range_rad.as_flattened().iter().flat_map(|&value| single(value)));
        tail.extend([u8::from(settings.fence), u8::from(settings.rebound)]);
        // Alarms of inputs, switches and a monitored device: none of them is here.
        tail.extend([0; 13]);
        tail
    }

    fn fill_realtime(&self, report: &mut Report, now_ns: u64) {
        let mut realtime = palpate_device_protocol::xarm::Realtime::default();
        let [vx, vy, vz, wx, wy, wz] = self.tool_twist();
        let twist = palpate_device_protocol::xarm::Pose { position_m: [vx, vy, vz], rpy_rad: [wx, wy, wz] };
        let acc = slots(&self.rad_per_sec2);
        realtime.box_time_us = now_ns / 1000;
        realtime.target = [slots(&self.joints_rad), slots(&self.rad_per_sec), acc];
        realtime.joint_rad_per_sec = slots(&self.rad_per_sec);
        realtime.joint_rad_per_sec2 = acc;
        realtime.current_a = self.current_a(&report.joint_effort);
        realtime.target_pose = report.pose;
        realtime.target_twist = twist;
        realtime.twist = twist;
        report.realtime = Some(realtime);
        // Force sensor and inputs, up to the size of this firmware's reports.
        report.tail = vec![0; 284];
    }
}

/// Values of the arm's joints in the slots of the line.
pub(crate) fn slots(values: &[f64]) -> [f64; NUM_JOINT_SLOTS] {
    std::array::from_fn(|joint| values.get(joint).copied().unwrap_or(0.0))
}
