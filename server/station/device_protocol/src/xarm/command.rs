//! What a client asks of the box, and what the box answers.

use crate::fields::{Fields, Reader, Writer};

use super::frame::{Frame, FrameError, Protocol, StateFlags};

/// Joint slots in every array on the line.
pub const NUM_JOINT_SLOTS: usize = 7;
/// The box counts lengths in mm.
pub(super) const MM: f64 = 1000.0;

/// Position and orientation of the tool.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Pose {
    /// Position in the base frame.
    pub position_m: [f64; 3],
    /// Roll, pitch and yaw.
    pub rpy_rad: [f64; 3],
}

impl Pose {
    pub(super) fn fields(&mut self, fields: &mut impl Fields) {
        fields.f32s(&mut self.position_m, MM);
        fields.f32s(&mut self.rpy_rad, 1.0);
    }
}

/// What newer firmware takes behind a line's speed, acceleration and time.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct LineTail {
    /// Blending radius; negative for none.
    pub radius_m: f64,
    /// 0 base, 1 tool.
    pub frame: u8,
    /// 1 if the orientation is an axis and angle.
    pub axis_angle: u8,
    /// 1 to check the motion without moving.
    pub only_check: u8,
}

macro_rules! contents {
    ($(#[$doc:meta])* $name:ident { $($(#[$variant_doc:meta])* $register:literal $variant:ident { $($(#[$field_doc:meta])* $field:ident: $type:ty = $visit:expr,)* })* }) => {
        $(#[$doc])*
        #[derive(Debug, Clone, PartialEq)]
        pub enum $name {
            $($(#[$variant_doc])* $variant { $($(#[$field_doc])* $field: $type,)* },)*
            /// A register without a layout here; its content as it is.
            Other {
                /// The register.
                register: u8,
                /// What follows it, without a response's state byte.
                params: Vec<u8>,
            },
        }

        impl $name {
            /// The register that is asked for or answered.
            pub fn register(&self) -> u8 {
                match self {
                    $(Self::$variant { .. } => $register,)*
                    Self::Other { register, .. } => *register,
                }
            }

            fn blank(register: u8) -> Self {
                match register {
                    $($register => Self::$variant { $($field: <$type>::default(),)* },)*
                    register => Self::Other { register, params: Vec::new() },
                }
            }

            fn fields<F: Fields>(&mut self, fields: &mut F) {
                match self {
                    $(Self::$variant { $($field,)* } => {
                        let _ = &fields;
                        $(let visit: fn(&mut F, &mut $type) = $visit; visit(fields, $field);)*
                    })*
                    Self::Other { params, .. } => fields.rest(params),
                }
            }

            fn parse(register: u8, params: &[u8]) -> Result<Self, FrameError> {
                let mut content = Self::blank(register);
                let mut reader = Reader::new(params);
                content.fields(&mut reader);
                reader.finish().map_err(|source| FrameError::Content { register, source })?;
                Ok(content)
            }

            fn params(&self) -> Result<Vec<u8>, FrameError> {
                let mut writer = Writer::default();
                self.clone().fields(&mut writer);
                writer.finish().map_err(|source| FrameError::Content { register: self.register(), source })
            }
        }
    };
}

type Joints = [f64; NUM_JOINT_SLOTS];

contents! {
    /// A request. Queued motions are answered by [`Reply::Queued`], others mostly by [`Reply::Other`] without content.
    Command {
        /// Axes, type, serial numbers and version.
        0x01 GetVersion {}
        /// Serial numbers of arm and box.
        0x02 GetSerial {}
        /// Whether reports carry torque (0) or current (1).
        0x05 GetEffortKind {}
        /// Switch the box off (1) or restart it (2).
        0x0A Power { /// 1 off, 2 restart.
            action: u8 = F::u8, }
        /// Enable or disable the motors.
        0x0B MotionEnable { /// 1 to 7, or 8 for all.
            joint: u8 = F::u8, /// 1 on, 0 off.
            on: u8 = F::u8, }
        /// Ready (0), pause (3), stop (4) or decelerated stop (6).
        0x0C SetState { /// The state.
            state: u8 = F::u8, }
        /// Moving, ready, paused, stopped and so on.
        0x0D GetState {}
        /// Number of queued commands.
        0x0E GetQueueLength {}
        /// Error and warning.
        0x0F GetError {}
        /// Clear the error.
        0x10 ClearError {}
        /// Clear the warning.
        0x11 ClearWarning {}
        /// Hold or release a brake.
        0x12 Brake { /// 1 to 7, or 8 for all.
            joint: u8 = F::u8, /// 1 on, 0 off.
            on: u8 = F::u8, }
        /// Position (0), servo (1), lead-through (2), joint velocity (4), Cartesian velocity (5), online (6, 7).
        0x13 SetMode { /// The mode.
            mode: u8 = F::u8, /// Collision detection in lead-through, since firmware 1.10.0.
            detection: Option<u8> = |f, v| f.optional(v, 1, F::u8), }
        /// Straight line to a pose.
        0x15 MoveLine { /// Where to.
            pose: Pose = |f, v| v.fields(f), /// Speed.
            speed_m_per_sec: f64 = |f, v| f.f32(v, MM), /// Acceleration.
            acc_m_per_sec2: f64 = |f, v| f.f32(v, MM), /// Duration, 0 for none.
            time_secs: f64 = |f, v| f.f32(v, 1.0), /// Since firmware 1.11.100.
            tail: Option<LineTail> = |f, v| f.optional(v, 7, |f, tail| {
                f.f32(&mut tail.radius_m, MM);
                f.u8(&mut tail.frame);
                f.u8(&mut tail.axis_angle);
                f.u8(&mut tail.only_check);
            }), }
        /// Joints to a position.
        0x17 MoveJoints { /// Where to.
            joint_rad: Joints = |f, v| f.f32s(v, 1.0), /// Speed.
            speed_rad_per_sec: f64 = |f, v| f.f32(v, 1.0), /// Acceleration.
            acc_rad_per_sec2: f64 = |f, v| f.f32(v, 1.0), /// Duration, 0 for none.
            time_secs: f64 = |f, v| f.f32(v, 1.0), }
        /// Joints to zero.
        0x19 Home { /// Speed.
            speed_rad_per_sec: f64 = |f, v| f.f32(v, 1.0), /// Acceleration.
            acc_rad_per_sec2: f64 = |f, v| f.f32(v, 1.0), /// Duration, 0 for none.
            time_secs: f64 = |f, v| f.f32(v, 1.0), }
        /// Joint targets in servo mode, run at once; the box ignores what follows them.
        0x1D ServoJoints { /// Where to.
            joint_rad: Joints = |f, v| f.f32s(v, 1.0), /// Ignored by the box.
            speed_rad_per_sec: f64 = |f, v| f.f32(v, 1.0), /// Ignored by the box.
            acc_rad_per_sec2: f64 = |f, v| f.f32(v, 1.0), /// Ignored by the box.
            time_secs: f64 = |f, v| f.f32(v, 1.0), }
        /// Tool target in servo mode.
        0x1E ServoPose { /// Where to.
            pose: Pose = |f, v| v.fields(f), /// Speed.
            speed_m_per_sec: f64 = |f, v| f.f32(v, MM), /// Acceleration.
            acc_m_per_sec2: f64 = |f, v| f.f32(v, MM), /// 0 base, 1 tool.
            frame: f64 = |f, v| f.f32(v, 1.0), }
        /// Limit of the joints' jerk.
        0x21 SetJointJerk { /// Jerk.
            jerk_rad_per_sec3: f64 = |f, v| f.f32(v, 1.0), }
        /// Limit of the joints' acceleration.
        0x22 SetJointMaxAcc { /// Acceleration.
            acc_rad_per_sec2: f64 = |f, v| f.f32(v, 1.0), }
        /// Tool frame on the flange.
        0x23 SetTcpOffset { /// The frame.
            offset: Pose = |f, v| v.fields(f), }
        /// Load on the flange.
        0x24 SetTcpLoad { /// Mass.
            mass_kg: f64 = |f, v| f.f32(v, 1.0), /// Centre of mass.
            center_m: [f64; 3] = |f, v| f.f32s(v, MM), }
        /// Collision sensitivity, 0 to 5.
        0x25 SetCollisionSensitivity { /// 0 off to 5 most sensitive.
            level: u8 = F::u8, }
        /// Lead-through sensitivity, 1 to 5.
        0x26 SetTeachSensitivity { /// 1 to 5.
            level: u8 = F::u8, }
        /// Forget the configuration.
        0x27 ClearConfig {}
        /// Keep the configuration.
        0x28 SaveConfig {}
        /// Where the tool is.
        0x29 GetPose {}
        /// Where the joints are.
        0x2A GetJoints { /// 1 measured positions, 2 also velocities, 3 also efforts; none for commanded positions.
            num_arrays: Option<u8> = |f, v| f.optional(v, 1, F::u8), }
        /// Joints for a pose.
        0x2B InverseKinematics { /// The pose.
            pose: Pose = |f, v| v.fields(f), }
        /// Pose of joints.
        0x2C ForwardKinematics { /// The joints.
            joint_rad: Joints = |f, v| f.f32s(v, 1.0), }
        /// Whether joints are beyond a limit.
        0x2D CheckJointLimit { /// The joints.
            joint_rad: Joints = |f, v| f.f32s(v, 1.0), }
        /// Speed limit of the tool in reduced mode.
        0x2F SetReducedTcpSpeed { /// Speed.
            speed_m_per_sec: f64 = |f, v| f.f32(v, MM), }
        /// Speed limit of the joints in reduced mode.
        0x30 SetReducedJointSpeed { /// Speed.
            speed_rad_per_sec: f64 = |f, v| f.f32(v, 1.0), }
        /// Whether reduced mode is on.
        0x31 GetReduced {}
        /// Reduced mode on or off.
        0x32 SetReduced { /// 1 on, 0 off.
            on: u8 = F::u8, }
        /// Direction of gravity.
        0x33 SetGravityDirection { /// In the base frame.
            direction: [f64; 3] = |f, v| f.f32s(v, 1.0), }
        /// Workspace box, in whole mm as on the line.
        0x34 SetBoundary { /// x max, x min, y max, y min, z max, z min.
            bounds_mm: [i32; 6] = |f, v| for bound in v {
                let mut bytes = bound.to_le_bytes();
                f.raw(&mut bytes);
                *bound = i32::from_le_bytes(bytes);
            }, }
        /// All of reduced mode.
        0x35 GetReducedStates {}
        /// Torques of the joints.
        0x37 GetTorques {}
        /// Joint limits of reduced mode.
        0x3A SetReducedJointRange { /// Smallest and largest angle of each joint.
            range_rad: [[f64; 2]; NUM_JOINT_SLOTS] = |f, v| f.f32s(v.as_flattened_mut(), 1.0), }
        /// Workspace box on or off.
        0x3B SetFence { /// 1 on, 0 off.
            on: u8 = F::u8, }
        /// Rebound after a collision on or off.
        0x3C SetCollisionRebound { /// 1 on, 0 off.
            on: u8 = F::u8, }
        /// Self-collision check on or off.
        0x4D SetSelfCollision { /// 1 on, 0 off.
            on: u8 = F::u8, }
        /// Motion in the box's simulation only.
        0x4F SetSimulation { /// 1 on, 0 off.
            on: u8 = F::u8, }
        /// Joint velocities, in mode 4.
        0x51 JointVelocity { /// Velocities.
            joint_rad_per_sec: Joints = |f, v| f.f32s(v, 1.0), /// 1 if all joints stop together.
            sync: u8 = F::u8, /// How long; none until the next.
            duration_secs: Option<f64> = |f, v| f.optional(v, 4, |f, v| f.f32(v, 1.0)), }
    }
}

contents! {
    /// The content of a response, behind its state byte.
    Reply {
        /// Text padded with zero bytes: axes, type, serial numbers and version, between commas.
        0x01 Version { /// The 40 bytes.
            text: Text = |f, v| f.raw(&mut v.0), }
        /// Text padded with zero bytes: serial numbers of arm and box, a zero byte between them.
        0x02 Serial { /// The 40 bytes.
            text: Text = |f, v| f.raw(&mut v.0), }
        /// 1 moving, 2 ready, 3 paused, 4 stopped, 5 mode changed, 6 decelerating.
        0x0D State { /// The state.
            state: u8 = F::u8, }
        /// Number of queued commands.
        0x0E QueueLength { /// Commands.
            num_commands: u16 = F::u16, }
        /// Error and warning.
        0x0F Error { /// 0 for none.
            error: u8 = F::u8, /// 0 for none.
            warning: u8 = F::u8, }
        /// A line was queued.
        0x15 LineQueued { /// Commands in the queue.
            num_commands: u16 = F::u16, }
        /// A joint motion was queued.
        0x17 Queued { /// Commands in the queue.
            num_commands: u16 = F::u16, }
        /// Where the tool is.
        0x29 Pose { /// The pose.
            pose: Pose = |f, v| v.fields(f), }
        /// Where the joints are, and as many further arrays as were asked for.
        0x2A Joints { /// Positions.
            position_rad: Joints = |f, v| f.f32s(v, 1.0), /// Velocities, then efforts.
            velocity_rad_per_sec: Option<Joints> = |f, v| f.optional(v, 28, |f, v| f.f32s(v, 1.0)), /// Torques.
            effort: Option<Joints> = |f, v| f.optional(v, 28, |f, v| f.f32s(v, 1.0)), }
        /// Joints for a pose.
        0x2B InverseKinematics { /// The joints.
            joint_rad: Joints = |f, v| f.f32s(v, 1.0), }
        /// Pose of joints.
        0x2C ForwardKinematics { /// The pose.
            pose: Pose = |f, v| v.fields(f), }
        /// Torques of the joints.
        0x37 Torques { /// Torques.
            torque_nm: Joints = |f, v| f.f32s(v, 1.0), }
    }
}

/// A text of 40 bytes, padded with zero bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Text(pub [u8; 40]);

impl Default for Text {
    fn default() -> Self {
        Self([0; 40])
    }
}

impl Text {
    /// The parts between zero bytes, line ends and commas.
    pub fn parts(&self) -> Vec<String> {
        let parts = self.0.split(|byte| matches!(byte, 0 | b'\n' | b','));
        parts.filter(|part| !part.is_empty()).map(|part| String::from_utf8_lossy(part).into_owned()).collect()
    }
}

impl Command {
    /// The frame that asks this.
    pub fn to_frame(&self, transaction: u16, protocol: Protocol) -> Result<Frame, FrameError> {
        Ok(Frame { transaction, protocol, register: self.register(), content: self.params()? })
    }

    /// Understands a frame from a client.
    pub fn from_frame(frame: &Frame) -> Result<Self, FrameError> {
        Self::parse(frame.register, &frame.content)
    }
}

impl Reply {
    /// The frame that answers `request` with this.
    pub fn to_frame(&self, request: &Frame, flags: StateFlags) -> Result<Frame, FrameError> {
        let content = [vec![flags.0], self.params()?].concat();
        Ok(Frame { register: self.register(), content, ..*request })
    }

    /// Understands a frame from the box. A failed request is answered without content, as [`Reply::Other`].
    pub fn from_frame(frame: &Frame) -> Result<(StateFlags, Self), FrameError> {
        let (flags, params) = frame.response()?;
        let reply = if params.is_empty() {
            Self::Other { register: frame.register, params: Vec::new() }
        } else {
            Self::parse(frame.register, params)?
        };
        Ok((flags, reply))
    }
}
