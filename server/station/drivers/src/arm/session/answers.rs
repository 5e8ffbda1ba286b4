//! What the box's answers mean for the conversation.

use palpate_device_protocol::xarm::{Frame, Protocol, Reply, StateFlags};

use super::{Fault, Phase, Session, Step, state};

/// Register by which the box speaks without being asked.
const FEEDBACK: u8 = 0xFF;

impl Session {
    /// Takes bytes of the box.
    pub(crate) fn receive(&mut self, now_ns: u64, bytes: &[u8]) {
        for frame in self.decoder.feed(bytes) {
            self.answer(now_ns, &frame);
        }
    }

    fn answer(&mut self, now_ns: u64, frame: &Frame) {
        let found = self
            .asked
            .iter()
            .position(|asked| asked.transaction == frame.transaction && asked.register == frame.register);
        let Some(found) = found.filter(|_| frame.register != FEEDBACK) else { return };
        // The box answers in order: what came before and has no answer gets none any more.
        self.asked.drain(..=found);
        let (flags, reply) = match Reply::from_frame(frame) {
            Ok(answer) => answer,
            Err(error) => {
                self.broken = Some(format!("the control box sent an answer that makes no sense: {error}"));
                return;
            }
        };
        self.took_readiness(flags);
        match reply {
            Reply::Version { text } => self.took_version(&text.parts()),
            Reply::Serial { text } => self.serial_text = Some(text.parts().join(", ")),
            Reply::Error { error, warning } => {
                self.took_error(now_ns, error, warning);
                if self.phase == Phase::Hello && self.version_text.is_some() {
                    self.phase = Phase::Idle;
                }
                return;
            }
            Reply::Other { register: 0x0B, .. } => self.enable_answered(now_ns, flags),
            _ => {}
        }
        self.next_step(now_ns, frame.register, flags);
        let has_news = flags.contains(StateFlags::ERROR) != matches!(self.fault, Some(Fault::Box(_)))
            || flags.contains(StateFlags::WARNING) != (self.warning != 0);
        if has_news && self.phase != Phase::Hello {
            self.look(now_ns);
        }
    }

    fn took_version(&mut self, parts: &[String]) {
        let version = parts.iter().find_map(|part| parse_version(part));
        if version.is_some_and(|version| version >= [1, 8, 6]) {
            self.protocol = Protocol::KeepAlive;
        }
        self.version = version;
        self.version_text = Some(parts.join(","));
        let axes = parts.first().and_then(|axes| axes.parse::<usize>().ok());
        if let Some(axes) = axes.filter(|&axes| axes != self.joints.len()) {
            self.fault = Some(Fault::Lasting(format!(
                "the arm has {axes} joints, the station's file names {} of it; correct the list of its joints",
                self.joints.len()
            )));
        }
    }

    pub(super) fn took_error(&mut self, now_ns: u64, error: u8, warning: u8) {
        self.warning = warning;
        match (error, &self.fault) {
            (0, Some(Fault::Box(_))) => self.fault = None,
            (0, _) | (_, Some(Fault::Lasting(_))) => {}
            (code, _) => {
                if matches!(code, 1 | 2) {
                    // The stop cuts the motors' power.
                    self.enabled = false;
                }
                self.note.clear();
                self.fail(now_ns, Fault::Box(code));
            }
        }
    }

    /// What the flags of every answer tell about the motors: ready means enabled, not ready may also mean stopped.
    fn took_readiness(&mut self, flags: StateFlags) {
        let is_stopped =
            self.seen.as_ref().is_none_or(|seen| matches!(seen.state, state::STOPPED | state::CHANGED));
        if !flags.contains(StateFlags::NOT_READY) {
            self.enabled = true;
        } else if self.phase == Phase::Idle && !is_stopped {
            self.enabled = false;
        }
    }

    fn enable_answered(&mut self, now_ns: u64, flags: StateFlags) {
        if self.phase == Phase::Disabling {
            self.enabled = false;
            self.ours = false;
            self.phase = Phase::Idle;
            self.look(now_ns);
        } else if !flags.contains(StateFlags::ERROR) {
            self.enabled = true;
        }
    }

    fn next_step(&mut self, now_ns: u64, register: u8, flags: StateFlags) {
        let Phase::Engaging { step, mode, .. } = self.phase else { return };
        let next = match (step, register) {
            (Step::Enable, 0x0B) => Step::Mode,
            (Step::Mode, 0x13) => Step::State,
            (Step::State, 0x0C) => Step::Confirm,
            _ => return,
        };
        if flags.contains(StateFlags::INVALID) || flags.contains(StateFlags::ERROR) {
            let refused = match step {
                Step::Enable => "switch its motors on",
                Step::Mode => "change its mode",
                Step::State | Step::Confirm => "get ready",
            };
            let problem = format!("the control box refused to {refused}; clear the fault and arm again");
            self.fail(now_ns, Fault::Passing(problem));
            self.look(now_ns);
            return;
        }
        self.phase = Phase::Engaging { step: next, mode, since_ns: now_ns };
        self.say_step(now_ns, next, mode);
    }
}

/// `v1.12.10` as numbers.
fn parse_version(text: &str) -> Option<[u32; 3]> {
    let mut numbers = text.strip_prefix(['v', 'V'])?.split('.').map(str::parse);
    let mut next = || numbers.next()?.ok();
    Some([next()?, next()?, next()?])
}
