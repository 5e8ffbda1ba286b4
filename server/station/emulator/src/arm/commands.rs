//! What the box answers to a client.

use palpate_device_protocol::xarm::{Command, Frame, NUM_JOINT_SLOTS, Protocol, Reply, StateFlags, Text};

use super::kinematics::{from_pose, to_pose};
use super::motion::Move;
use super::report::slots;
use super::{ArmBox, MOST_QUEUED, SERIAL, VERSION, error, mode, state, warning};

/// Registers without a layout of their own in the protocol crate.
mod other {
    pub(super) const MOVE_JOINTS_BLENDED: u8 = 0x18;
    pub(super) const SLEEP: u8 = 0x1A;
    pub(super) const SET_EFFORT_KIND: u8 = 0x46;
}

type Joints = [f64; NUM_JOINT_SLOTS];

impl ArmBox {
    /// The answer to one frame; heartbeats have none.
    pub(crate) fn answer(&mut self, request: &Frame) -> Option<Frame> {
        if request.protocol == Protocol::Heartbeat {
            return None;
        }
        let plain = |register: u8| Reply::Other { register, params: Vec::new() };
        let before = self.flags();
        let mut is_queued = false;
        let answered = match Command::from_frame(request) {
            Ok(command) => {
                is_queued = matches!(command, Command::SetTcpLoad { .. } | Command::SetTcpOffset { .. });
                self.obey(&command)
            }
            Err(_) => {
                self.warning = warning::BAD_PARAMETER;
                Err(StateFlags::INVALID)
            }
        };
        let (reply, extra) = match answered {
            Ok(reply) => (reply, StateFlags::default()),
            Err(extra) => (plain(request.register), extra),
        };
        // These two are answered before they take effect, which stops the arm.
        let now = if is_queued { before } else { self.flags() };
        let flags = StateFlags(now.0 | extra.0);
        reply.to_frame(request, flags).or_else(|_| plain(request.register).to_frame(request, flags)).ok()
    }

    /// Does what is asked; or says with which flags it does not.
    fn obey(&mut self, command: &Command) -> Result<Reply, StateFlags> {
        let register = command.register();
        let done = Ok(Reply::Other { register, params: Vec::new() });
        let one = |byte: u8| Ok(Reply::Other { register, params: vec![byte] });
        match command {
            Command::GetVersion {} => Ok(Reply::Version { text: text(VERSION.as_bytes()) }),
            Command::GetSerial {} => {
                let joined = [SERIAL.0.as_bytes(), b"\0", SERIAL.1.as_bytes(), b"\n"].concat();
                Ok(Reply::Serial { text: text(&joined) })
            }
            Command::GetEffortKind {} => one(u8::from(self.settings.reports_current)),
            Command::GetState {} => Ok(Reply::State { state: self.state() }),
            Command::GetQueueLength {} => Ok(Reply::QueueLength { num_commands: self.queue_length() }),
            Command::GetError {} => Ok(Reply::Error { error: self.error, warning: self.warning }),
            Command::GetPose {} => {
                let tool = self.model.base_from_flange(&self.joints_rad) * self.tool();
                Ok(Reply::Pose { pose: to_pose(&tool) })
            }
            Command::GetJoints { num_arrays } => Ok(Reply::Joints {
                position_rad: slots(&self.joints_rad),
                velocity_rad_per_sec: num_arrays.is_some_and(|n| n >= 2).then(|| slots(&self.rad_per_sec)),
                effort: num_arrays.is_some_and(|n| n >= 3).then(|| self.effort_nm()),
            }),
            Command::GetTorques {} => Ok(Reply::Torques { torque_nm: self.effort_nm() }),
            Command::GetReduced {} => one(u8::from(self.settings.reduced)),
            Command::GetReducedStates {} => Ok(Reply::Other { register, params: self.reduced_states() }),
            Command::ForwardKinematics { joint_rad } => {
                let tool = self.model.base_from_flange(self.arm_part(joint_rad)) * self.tool();
                Ok(Reply::ForwardKinematics { pose: to_pose(&tool) })
            }
            Command::InverseKinematics { pose } => {
                let base_from_flange = from_pose(pose) * self.tool().inverse();
                let found = self.model.joints_rad(&base_from_flange, &self.joints_rad);
                let joints_rad = found.ok_or(StateFlags::INVALID)?;
                Ok(Reply::InverseKinematics { joint_rad: slots(&joints_rad) })
            }
            Command::CheckJointLimit { joint_rad } => {
                one(u8::from(self.model.beyond_limits(self.arm_part(joint_rad)).is_some()))
            }
            Command::MotionEnable { joint, on } => self.enable(*joint, *on != 0).and(done),
            Command::Brake { joint, on } => {
                let bits = self.joint_bits(*joint)?;
                // The protocol's "on" releases.
                self.brake_bits = if *on != 0 { self.brake_bits | bits } else { self.brake_bits & !bits };
                done
            }
            Command::SetState { state } => self.set_state(*state).and(done),
            Command::SetMode { mode, .. } => self.set_mode(*mode).and(done),
            Command::ClearError {} => {
                if !self.stop_is_pressed {
                    self.error = 0;
                }
                self.halt(state::STOPPED);
                done
            }
            Command::ClearWarning {} => {
                self.warning = 0;
                done
            }
            Command::ServoJoints { joint_rad, .. } => self.servo_to(joint_rad).and(done),
            Command::ServoPose { pose, .. } => {
                let base_from_flange = from_pose(pose) * self.tool().inverse();
                let Some(joints_rad) = self.model.joints_rad(&base_from_flange, &self.joints_rad) else {
                    self.fail(error::KINEMATICS);
                    return Err(StateFlags::INVALID);
                };
                self.servo_to(&slots(&joints_rad)).and(done)
            }
            Command::JointVelocity { joint_rad_per_sec, duration_secs, .. } => {
                self.may_move(mode::JOINT_VELOCITY)?;
                let steps = duration_secs.filter(|&secs| secs > 0.0).map(|secs| (secs * 1e3).ceil() as u64);
                let wanted = self.arm_part(joint_rad_per_sec).to_vec();
                self.velocity = Some((wanted, steps));
                done
            }
            Command::MoveJoints { joint_rad, speed_rad_per_sec, acc_rad_per_sec2, .. } => {
                self.queue_joints(joint_rad, *speed_rad_per_sec, *acc_rad_per_sec2)?;
                Ok(Reply::Queued { num_commands: self.queue_length() })
            }
            Command::Home { speed_rad_per_sec, acc_rad_per_sec2, .. } => {
                self.queue_joints(&[0.0; NUM_JOINT_SLOTS], *speed_rad_per_sec, *acc_rad_per_sec2)?;
                self.queued(register)
            }
            Command::MoveLine { pose, speed_m_per_sec, acc_m_per_sec2, tail, .. } => {
                self.may_move(mode::POSITION)?;
                if tail.is_some_and(|tail| tail.frame != 0 || tail.axis_angle != 0) {
                    // Only base frame and roll, pitch, yaw are emulated.
                    self.warning = warning::BAD_PARAMETER;
                    return Err(StateFlags::INVALID);
                }
                let base_from_flange = from_pose(pose) * self.tool().inverse();
                let most = if self.settings.reduced { self.settings.reduced_m_per_sec } else { 1.0 };
                let speed = speed_m_per_sec.min(most);
                if tail.is_none_or(|tail| tail.only_check == 0) {
                    self.push(Move::Line { base_from_flange, speed, acc: *acc_m_per_sec2 })?;
                }
                Ok(Reply::LineQueued { num_commands: self.queue_length() })
            }
            Command::Other { params, .. } => self.obey_other(register, params),
            setting => self.set(setting).and(done),
        }
    }

    fn obey_other(&mut self, register: u8, params: &[u8]) -> Result<Reply, StateFlags> {
        let singles: Vec<f64> =
            params.as_chunks::<4>().0.iter().map(|&bytes| f64::from(f32::from_le_bytes(bytes))).collect();
        if singles.iter().any(|value| !value.is_finite()) {
            self.warning = warning::BAD_PARAMETER;
            return Err(StateFlags::INVALID);
        }
        match (register, singles.as_slice(), params) {
            (other::MOVE_JOINTS_BLENDED, [a, b, c, d, e, f, g, speed, acc, ..], _) => {
                self.queue_joints(&[*a, *b, *c, *d, *e, *f, *g], *speed, *acc)?;
                self.queued(register)
            }
            (other::SLEEP, [seconds, ..], _) => {
                self.may_move(mode::POSITION)?;
                self.push(Move::Sleep(*seconds))?;
                self.queued(register)
            }
            (other::SET_EFFORT_KIND, _, [kind]) => {
                self.settings.reports_current = *kind != 0;
                Ok(Reply::Other { register, params: Vec::new() })
            }
            _ => {
                self.warning = warning::UNKNOWN_COMMAND;
                Err(StateFlags::INVALID)
            }
        }
    }

    /// Commands that only keep a number. Those that change how the arm moves stop it first, as the box does.
    fn set(&mut self, command: &Command) -> Result<(), StateFlags> {
        let level = |level: u8| if level <= 5 { Ok(level) } else { Err(StateFlags::INVALID) };
        match command {
            Command::SetTcpOffset { offset } => self.settings.tcp_offset = *offset,
            Command::SetTcpLoad { mass_kg, center_m } => {
                (self.settings.load_kg, self.settings.load_center_m) = (*mass_kg, *center_m);
            }
            Command::SetCollisionSensitivity { level: wanted } => {
                self.settings.collision_sensitivity = level(*wanted)?;
            }
            Command::SetTeachSensitivity { level: wanted } => {
                self.settings.teach_sensitivity = level(*wanted)?;
            }
            Command::SetGravityDirection { direction } => self.settings.gravity_direction = *direction,
            quiet => return self.set_quietly(quiet),
        }
        self.halt(state::CHANGED);
        Ok(())
    }

    fn set_quietly(&mut self, command: &Command) -> Result<(), StateFlags> {
        let settings = &mut self.settings;
        match command {
            Command::SetJointJerk { jerk_rad_per_sec3 } => settings.joint_jerk = *jerk_rad_per_sec3,
            Command::SetJointMaxAcc { acc_rad_per_sec2 } => settings.joint_most_acc = *acc_rad_per_sec2,
            Command::SetReducedTcpSpeed { speed_m_per_sec } => settings.reduced_m_per_sec = *speed_m_per_sec,
            Command::SetReducedJointSpeed { speed_rad_per_sec } => {
                settings.reduced_rad_per_sec = *speed_rad_per_sec;
            }
            Command::SetReduced { on } => settings.reduced = *on != 0,
            Command::SetReducedJointRange { range_rad } => settings.reduced_range_rad = *range_rad,
            Command::SetBoundary { bounds_mm } => settings.bounds_mm = *bounds_mm,
            Command::SetFence { on } => settings.fence = *on != 0,
            Command::SetCollisionRebound { on } => settings.rebound = *on != 0,
            Command::SetSelfCollision { on } => settings.self_collision = *on != 0,
            Command::SetSimulation { on } => settings.simulation = *on != 0,
            // The box keeps its settings as long as it runs, and cannot be switched off by a client here.
            Command::ClearConfig {} | Command::SaveConfig {} | Command::Power { .. } => {}
            _ => {
                self.warning = warning::UNKNOWN_COMMAND;
                return Err(StateFlags::INVALID);
            }
        }
        Ok(())
    }

    fn joint_bits(&mut self, joint: u8) -> Result<u8, StateFlags> {
        match joint {
            1..=7 => Ok((1 << (joint - 1)) & self.all_joints()),
            // Slots that this arm lacks are reported as on too.
            8 => Ok(0x7F),
            _ => {
                self.warning = warning::BAD_PARAMETER;
                Err(StateFlags::INVALID)
            }
        }
    }

    fn enable(&mut self, joint: u8, on: bool) -> Result<(), StateFlags> {
        let bits = self.joint_bits(joint)?;
        self.halt(state::STOPPED);
        if on && self.error == 0 {
            self.enable_bits |= bits;
            self.brake_bits |= bits;
        } else if !on {
            self.enable_bits &= !bits;
            self.brake_bits &= !bits;
        }
        Ok(())
    }

    fn set_state(&mut self, wanted: u8) -> Result<(), StateFlags> {
        match wanted {
            0 if self.error == 0 => {
                // Servo mode begins where the arm is.
                self.resting_state = state::READY;
            }
            // An error keeps the arm stopped, which the flags say.
            0 => {}
            3 if matches!(self.resting_state, state::READY | state::PAUSED) => {
                self.resting_state = state::PAUSED;
            }
            3 => {}
            4 | 6 => self.halt(state::STOPPED),
            _ => {
                self.warning = warning::BAD_PARAMETER;
                return Err(StateFlags::INVALID);
            }
        }
        Ok(())
    }

    fn set_mode(&mut self, wanted: u8) -> Result<(), StateFlags> {
        if ![mode::POSITION, mode::SERVO, mode::LEAD_THROUGH, mode::JOINT_VELOCITY].contains(&wanted) {
            self.warning = warning::BAD_PARAMETER;
            return Err(StateFlags::INVALID);
        }
        self.halt(state::CHANGED);
        self.mode = wanted;
        Ok(())
    }

    /// Whether motions of `needed` mode are taken now.
    fn may_move(&self, needed: u8) -> Result<(), StateFlags> {
        if self.error == 0 && self.is_ready() && self.mode == needed {
            Ok(())
        } else {
            Err(StateFlags::NOT_READY)
        }
    }

    fn servo_to(&mut self, joint_rad: &Joints) -> Result<(), StateFlags> {
        self.may_move(mode::SERVO)?;
        let target_rad = self.within_limits(joint_rad)?;
        self.target_rad = Some(target_rad);
        Ok(())
    }

    fn queue_joints(&mut self, joint_rad: &Joints, speed: f64, acc: f64) -> Result<(), StateFlags> {
        self.may_move(mode::POSITION)?;
        let target_rad = self.within_limits(joint_rad)?;
        self.push(Move::Joints { target_rad, speed, acc })
    }

    fn within_limits(&mut self, joint_rad: &Joints) -> Result<Vec<f64>, StateFlags> {
        let target_rad = self.arm_part(joint_rad).to_vec();
        if self.model.beyond_limits(&target_rad).is_some() {
            self.fail(error::JOINT_LIMIT);
            return Err(StateFlags::INVALID);
        }
        Ok(target_rad)
    }

    fn push(&mut self, planned: Move) -> Result<(), StateFlags> {
        if self.queue.len() >= MOST_QUEUED {
            self.warning = warning::QUEUE_FULL;
            return Err(StateFlags::INVALID);
        }
        self.queue.push_back(planned);
        Ok(())
    }

    fn queued(&self, register: u8) -> Result<Reply, StateFlags> {
        Ok(Reply::Other { register, params: self.queue_length().to_be_bytes().to_vec() })
    }

    fn arm_part<'a>(&self, joint_rad: &'a Joints) -> &'a [f64] {
        &joint_rad[..self.model.num_joints()]
    }

    fn reduced_states(&self) -> Vec<u8> {
        let settings = &self.settings;
        let single = |value: f64| (value as f32).to_le_bytes();
        let mut params = vec![u8::from(settings.reduced)];
        params.extend(settings.bounds_mm.iter().flat_map(|&bound| (bound as i16).to_be_bytes()));
        params.extend(single(settings.reduced_m_per_sec * 1e3));
        params.extend(single(settings.reduced_rad_per_sec));
        params.extend(settings.reduced_range_rad.as_flattened().iter().flat_map(|&value| single(value)));
        params.extend([u8::from(settings.fence), u8::from(settings.rebound)]);
        params
    }
}

fn text(bytes: &[u8]) -> Text {
    let mut text = Text::default();
    for (slot, &byte) in text.0.iter_mut().zip(bytes) {
        *slot = byte;
    }
    text
}
