//! The hand's servos on their common line: bytes and time in, bytes and time out.

use palpate_device_protocol::dynamixel::{
    BROADCAST_ID, Decoder, FastBlock, Instruction, Packet, PacketError, PingReply, Request, Status,
    StatusError, encode_fast,
};

use super::control::{Hand, Push};
use super::servo::{FIRMWARE, STEP_S, Servo, ServoFaults};
use palpate_truth::Resistance;

/// Supply of the hand, V, and what its cable and connectors cost, ohm.
const SUPPLY_V: f64 = 5.0;
const CABLE_OHM: f64 = 0.05;

/// Damper beside the spring of a contact, s: that of the soft layers.
const CONTACT_DAMPING_S: f64 = 0.02;
/// A hand that moves a finger.
const SERVO_HAND: Hand = Hand { most_nm: 0.6, nm_s_per_rad: 1.0 };

/// An answer on its way to the host.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Answer {
    /// When its last byte is there, ns since the station started.
    pub(crate) due_ns: u64,
    pub(crate) bytes: Vec<u8>,
}

/// An object that a joint presses on, as it was when the joint was at `at_rad`.
#[derive(Clone, Copy, Debug, Default)]
struct Contact {
    resistance: Resistance,
    at_rad: f64,
}

impl Contact {
    /// What it does to the joint now. Where the joint presses on it grows; where the joint moves out it ends.
    fn torque_nm(&self, joint_rad: f64, rad_per_sec: f64) -> f64 {
        let Resistance { torque_nm, stiffness_nm_per_rad } = self.resistance;
        let moved_rad = joint_rad - self.at_rad + CONTACT_DAMPING_S * rad_per_sec;
        let pressed_nm = torque_nm - stiffness_nm_per_rad * moved_rad;
        // An object pushes and never pulls.
        if torque_nm >= 0.0 { pressed_nm.max(0.0) } else { pressed_nm.min(0.0) }
    }

    /// What keeps a step of a stiff contact stable: as much inertia as its spring and damper gather within the step.
    fn inertia_kg_m2(&self) -> f64 {
        self.resistance.stiffness_nm_per_rad * STEP_S * (STEP_S + CONTACT_DAMPING_S)
    }
}

/// All servos of a hand.
#[derive(Clone, Debug)]
pub(crate) struct ServoBus {
    servos: Vec<Servo>,
    pushes: Vec<Push>,
    contacts: Vec<Contact>,
    decoder: Decoder,
    /// When the line falls silent, ns.
    free_ns: u64,
    supply_v: f64,
}

impl ServoBus {
    /// Servos with the ids 0, 1, ... whose joints are at `joints_rad`, between `stops_rad`.
    pub(crate) fn new(joints_rad: &[f64], stops_rad: &[(f64, f64)]) -> Self {
        let servos = joints_rad.iter().zip(stops_rad).zip(0..);
        Self {
            servos: servos.map(|((&joint_rad, &stops), id)| Servo::new(id, joint_rad, stops)).collect(),
            pushes: vec![Push::NONE; joints_rad.len()],
            contacts: vec![Contact::default(); joints_rad.len()],
            decoder: Decoder::default(),
            free_ns: 0,
            supply_v: SUPPLY_V,
        }
    }

    /// Angles of the joints by their encoders, rad.
    pub(crate) fn joints_rad(&self) -> impl Iterator<Item = f64> + '_ {
        self.servos.iter().map(Servo::joint_rad)
    }

    /// The servos, by id.
    pub(crate) fn servos(&self) -> &[Servo] {
        &self.servos
    }

    /// Who pushes the joint of the servo at `idx` by hand.
    pub(crate) fn push_joint(&mut self, idx: usize, push: Push) {
        self.pushes[idx] = push;
    }

    /// What an object does to the joint of the servo at `idx` from where that is now.
    pub(crate) fn resist(&mut self, idx: usize, resistance: Resistance) {
        self.contacts[idx] = Contact { resistance, at_rad: self.servos[idx].joint_rad() };
    }

    /// What is wrong, for each servo, and what the supply gives in place of its nominal voltage.
    pub(crate) fn set_faults(&mut self, faults: &[ServoFaults], supply_v: Option<f64>) {
        for (servo, faults) in self.servos.iter_mut().zip(faults) {
            servo.set_faults(*faults);
        }
        self.supply_v = supply_v.unwrap_or(SUPPLY_V);
    }

    /// One step of motors and control loops.
    pub(crate) fn step(&mut self) {
        let supply_v = self.supply_v();
        for ((servo, push), contact) in self.servos.iter_mut().zip(&self.pushes).zip(&self.contacts) {
            let pushed_nm = push.torque_nm(servo.rad_per_sec(), &SERVO_HAND);
            let pressed_nm = contact.torque_nm(servo.joint_rad(), servo.rad_per_sec());
            servo.set_outside(pushed_nm + pressed_nm, contact.inertia_kg_m2());
            servo.step(supply_v);
        }
    }

    /// What the servos do to their joints in a step, where something else moves these: torque in N m, and whether the gear is
    /// jammed. [`Self::follow`] ends the step.
    pub(crate) fn drive(&mut self) -> impl Iterator<Item = (f64, bool)> + '_ {
        let supply_v = self.supply_v();
        for (servo, push) in self.servos.iter_mut().zip(&self.pushes) {
            servo.set_outside(push.torque_nm(servo.rad_per_sec(), &SERVO_HAND), 0.0);
            servo.drive(supply_v);
        }
        self.servos.iter().map(Servo::outside_drive)
    }

    /// Ends a step: the joints' angles by their encoders and their velocities, rad and rad/s.
    pub(crate) fn follow(&mut self, joints: impl Iterator<Item = (f64, f64)>) {
        let supply_v = self.supply_v();
        for (servo, (joint_rad, rad_per_sec)) in self.servos.iter_mut().zip(joints) {
            servo.follow(supply_v, joint_rad, rad_per_sec);
        }
    }

    /// What is left of the supply behind its cable.
    fn supply_v(&self) -> f64 {
        let current_a: f64 = self.servos.iter().map(|servo| servo.current_a().abs()).sum();
        (self.supply_v - CABLE_OHM * current_a).max(0.0)
    }

    /// Takes bytes that arrived at `now_ns`, split in any way, and gives the answers.
    pub(crate) fn receive(&mut self, now_ns: u64, bytes: &[u8]) -> Vec<Answer> {
        let mut answers = Vec::new();
        for packet in self.decoder.feed(bytes) {
            self.free_ns = self.free_ns.max(now_ns);
            self.obey(&packet, &mut answers);
        }
        answers
    }

    fn obey(&mut self, packet: &Packet, answers: &mut Vec<Answer>) {
        for servo in &mut self.servos {
            servo.hear();
        }
        let request = match Request::from_packet(packet) {
            Ok(request) => request,
            Err(error) => {
                let error = match error {
                    PacketError::UnknownInstruction { .. } => StatusError::Instruction,
                    _ => StatusError::DataLength,
                };
                // Another servo's answer comes back to nobody.
                if packet.instruction != palpate_device_protocol::dynamixel::code::STATUS {
                    self.with(packet.id, answers, |_| (Needs::All, Err(error)));
                }
                return;
            }
        };
        let id = request.id;
        match request.instruction {
            Instruction::Ping => self.with(id, answers, |servo| {
                let reply = PingReply { model: servo.model_number(), firmware: FIRMWARE };
                (Needs::Ping, Ok(reply.to_data()))
            }),
            Instruction::Read { address, length } => {
                self.with(id, answers, |servo| (Needs::Read, servo.read(address, length)));
            }
            Instruction::Write { address, data } => {
                self.with(id, answers, |servo| {
                    (Needs::All, servo.write(address, &data).map(|()| Vec::new()))
                });
            }
            Instruction::RegWrite { address, data } => self.with(id, answers, |servo| {
                (Needs::All, servo.register_write(address, &data).map(|()| Vec::new()))
            }),
            Instruction::Action => {
                self.with(id, answers, |servo| (Needs::All, servo.action().map(|()| Vec::new())));
            }
            // A hand that forgot its ids could not be set up again from here.
            Instruction::FactoryReset(_) => {
                self.with(id, answers, |_| (Needs::All, Err(StatusError::ResultFail)));
            }
            Instruction::Reboot => self.with(id, answers, |servo| {
                servo.reboot();
                (Needs::All, Ok(Vec::new()))
            }),
            Instruction::ClearTurns => {
                self.with(id, answers, |servo| (Needs::All, servo.clear_turns().map(|()| Vec::new())));
            }
            Instruction::SyncRead { address, length, ids } => {
                for id in ids {
                    self.with(id, answers, |servo| (Needs::Read, servo.read(address, length)));
                }
            }
            Instruction::BulkRead(reads) => {
                for read in reads {
                    self.with(read.id, answers, |servo| (Needs::Read, servo.read(read.address, read.length)));
                }
            }
            Instruction::FastSyncRead { address, length, ids } => {
                let reads: Vec<_> = ids.into_iter().map(|id| (id, address, length)).collect();
                self.read_together(&reads, answers);
            }
            Instruction::FastBulkRead(reads) => {
                let reads: Vec<_> = reads.iter().map(|read| (read.id, read.address, read.length)).collect();
                self.read_together(&reads, answers);
            }
            Instruction::SyncWrite { address, data, .. } => {
                for (id, bytes) in data {
                    self.quietly(id, address, &bytes);
                }
            }
            Instruction::BulkWrite(writes) => {
                for write in writes {
                    self.quietly(write.id, write.address, &write.data);
                }
            }
        }
    }

    /// Lets every servo that `id` addresses do something and answer, if its status return level has it answer that.
    fn with(
        &mut self,
        id: u8,
        answers: &mut Vec<Answer>,
        mut act: impl FnMut(&mut Servo) -> (Needs, Result<Vec<u8>, StatusError>),
    ) {
        for servo in self.servos.iter_mut().filter(|servo| servo.is_awake()) {
            let (own, secondary) = (servo.id() == id, servo.secondary_id() == Some(id));
            if !own && !secondary && id != BROADCAST_ID {
                continue;
            }
            // What it answers is timed as it was before the instruction changed anything.
            let (delay_ns, byte_ns, level) =
                (servo.return_delay_ns(), servo.byte_ns(), servo.status_return_level());
            let own_id = servo.id();
            let (needs, result) = act(servo);
            let answers_all = match needs {
                Needs::Ping => own || id == BROADCAST_ID,
                Needs::Read => own && level >= 1,
                Needs::All => own && level >= 2,
            };
            if !answers_all {
                continue;
            }
            let error = servo.error_byte(result.as_ref().err().copied());
            let status = Status { id: own_id, error, data: result.unwrap_or_default() };
            // Ids are at most 252 and a read is never longer than the table.
            if let Ok(bytes) = status.encode() {
                self.free_ns += delay_ns + byte_ns * bytes.len() as u64;
                answers.push(Answer { due_ns: self.free_ns, bytes });
            }
        }
    }

    /// Writes without an answer.
    fn quietly(&mut self, id: u8, address: u16, data: &[u8]) {
        let addressed = |servo: &&mut Servo| servo.id() == id || servo.secondary_id() == Some(id);
        for servo in self.servos.iter_mut().filter(|servo| servo.is_awake()).filter(addressed) {
            // A servo that refuses has nobody to tell.
            let _refused = servo.write(address, data);
        }
    }

    /// The joint answer: it ends where the first servo stays silent.
    fn read_together(&mut self, reads: &[(u8, u16, u16)], answers: &mut Vec<Answer>) {
        let expected: Vec<(u8, u16)> = reads.iter().map(|&(id, _, length)| (id, length)).collect();
        let promised: usize = expected.iter().map(|&(_, length)| usize::from(length) + 4).sum();
        if promised >= usize::from(u16::MAX) {
            // No length field holds this answer.
            return;
        }
        let mut blocks = Vec::new();
        let (mut delay_ns, mut byte_ns) = (0, 0);
        for &(id, address, length) in reads {
            let found = self.servos.iter().find(|servo| servo.id() == id && servo.is_awake());
            let Some(servo) = found.filter(|servo| servo.status_return_level() >= 1) else { break };
            if blocks.is_empty() {
                (delay_ns, byte_ns) = (servo.return_delay_ns(), servo.byte_ns());
            }
            let read = servo.read(address, length);
            let error = servo.error_byte(read.as_ref().err().copied());
            let data = read.unwrap_or_else(|_| vec![0; usize::from(length)]);
            blocks.push(FastBlock { id, error, data });
        }
        if blocks.is_empty() {
            return;
        }
        if let Ok(bytes) = encode_fast(&blocks, &expected) {
            self.free_ns += delay_ns + byte_ns * bytes.len() as u64;
            answers.push(Answer { due_ns: self.free_ns, bytes });
        }
    }
}

/// What an instruction needs the status return level to be for an answer.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Needs {
    Ping,
    Read,
    All,
}

#[cfg(test)]
mod tests;
