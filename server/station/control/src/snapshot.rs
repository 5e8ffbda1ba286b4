//! What pages see: the newest state of the station as one message.

use nalgebra::Isometry3;
use palpate_drivers::{DeviceHealth, Link};
use palpate_messages::bits;
use palpate_safety::{Phase, Status};
use palpate_wire::proto::{
    ControlState, DeviceStatus, LiveFrame, MotorStatus, RecordingStatus, ReflexStatus, TaxelWarning,
    TwinStatus, control_state, device_status,
};

use crate::streams::Touch;

/// Everything that a message is made of.
#[derive(Debug)]
pub(crate) struct Snapshot<'a> {
    pub(crate) time_s: f64,
    /// Empty until every joint was seen.
    pub(crate) positions: &'a [f64],
    pub(crate) touch: &'a Touch,
    pub(crate) activity: String,
    pub(crate) object: Option<(&'a str, Isometry3<f64>)>,
    /// Joints, then each stream of the layout.
    pub(crate) rates_hz: Vec<f32>,
    pub(crate) status: &'a Status,
    /// Added to the reason of the status: what else an operator must know.
    pub(crate) notices: &'a [&'a str],
    /// Empty while disarmed.
    pub(crate) commanded: &'a [f64],
    pub(crate) loop_rates_hz: [f64; 3],
    /// The newest, and the 95th percentile.
    pub(crate) latency_ms: [f64; 2],
    pub(crate) devices: &'a [DeviceHealth],
    pub(crate) taxels: Vec<TaxelWarning>,
    pub(crate) recording: Option<RecordingStatus>,
    pub(crate) twin: Option<TwinStatus>,
    pub(crate) reflex: Option<ReflexStatus>,
}

impl Snapshot<'_> {
    pub(crate) fn message(self) -> LiveFrame {
        let (object, object_pose) = match &self.object {
            Some((object, pose)) => ((*object).to_owned(), pose_numbers(pose)),
            None => (String::new(), Vec::new()),
        };
        let status = self.status;
        let control = ControlState {
            phase: phase(status.phase).into(),
            reason: joined(&status.reason, self.notices),
            holder: status.holder.clone(),
            lease_left_s: status.lease_left_s,
            stop_confirmed: status.stop_confirmed,
            lead_through: status.lead_through,
            commanded: narrow(self.commanded),
            loop_hz: self.loop_rates_hz[0] as f32,
            loop_mean_hz: self.loop_rates_hz[1] as f32,
            loop_worst_hz: self.loop_rates_hz[2] as f32,
            latency_ms: self.latency_ms[0] as f32,
            latency_p95_ms: self.latency_ms[1] as f32,
            devices: self.devices.iter().map(device).collect(),
            taxels: self.taxels,
            recording: self.recording,
            twin: self.twin,
            reflex: self.reflex,
        };
        LiveFrame {
            time_s: self.time_s,
            joint_positions: narrow(self.positions),
            active: bits::pack(self.touch.active.iter().copied()),
            raw: self.touch.raw.clone(),
            activity: self.activity,
            object,
            object_pose,
            rates_hz: self.rates_hz,
            control: Some(control),
        }
    }
}

fn phase(phase: Phase) -> control_state::Phase {
    match phase {
        Phase::Disarmed => control_state::Phase::Disarmed,
        Phase::Arming => control_state::Phase::Arming,
        Phase::Armed => control_state::Phase::Armed,
        Phase::Holding => control_state::Phase::Holding,
        Phase::Disarming => control_state::Phase::Disarming,
        Phase::Stopped => control_state::Phase::Stopped,
    }
}

fn device(health: &DeviceHealth) -> DeviceStatus {
    let link = match health.link {
        Link::Connecting => device_status::Link::Connecting,
        Link::Ready => device_status::Link::Ready,
        Link::Fault => device_status::Link::Fault,
        Link::Lost => device_status::Link::Lost,
    };
    let known = |value: Option<f64>| value.unwrap_or(0.0) as f32;
    let motors = health.motors.iter().map(|motor| MotorStatus {
        joint: motor.joint.clone(),
        temperature_c: known(motor.temperature_c),
        supply_v: known(motor.supply_v),
        current_a: known(motor.current_a),
        problem: motor.problem.clone(),
    });
    DeviceStatus {
        id: health.id.clone(),
        kind: health.kind.clone(),
        link: link.into(),
        problem: health.problem.clone(),
        rate_hz: health.rate_hz as f32,
        rate_mean_hz: health.rate_mean_hz as f32,
        rate_worst_hz: health.rate_worst_hz as f32,
        gaps: health.gaps,
        bad_frames: health.bad_frames,
        reconnects: health.reconnects,
        clock_skew_ppm: health.clock_skew_ppm as f32,
        motors: motors.collect(),
    }
}

fn narrow(values: &[f64]) -> Vec<f32> {
    values.iter().map(|&value| value as f32).collect()
}

/// x y z, then w x y z.
fn pose_numbers(pose: &Isometry3<f64>) -> Vec<f64> {
    let (position, rotation) = (pose.translation.vector, pose.rotation);
    vec![position.x, position.y, position.z, rotation.w, rotation.i, rotation.j, rotation.k]
}

fn joined(reason: &str, notices: &[&str]) -> String {
    let texts = std::iter::once(reason).chain(notices.iter().copied());
    texts.filter(|text| !text.is_empty()).collect::<Vec<_>>().join("; ")
}
