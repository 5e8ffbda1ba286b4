//! Joint readings of several devices as frames of the whole robot.

use crate::round::{Report, Round};

/// All joints at one moment.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct JointFrame {
    /// Host time, ns; later than that of the frame before.
    pub(crate) host_ns: u64,
    /// In the station's order; the last known where a joint could not be read.
    pub(crate) positions: Vec<f64>,
}

/// Makes frames of the reports of devices that each know some joints.
///
/// A frame is at the time of the least new of the reports in it; what the other devices say is interpolated to that
/// time, so that a moving arm and a moving hand are seen at the same moment.
#[derive(Clone, Debug)]
pub(crate) struct JointFrames {
    /// Devices that know joints, and when each took its newest report.
    members: Vec<(usize, Option<u64>)>,
    joints: Vec<Readings>,
    round: Round,
    last_ns: Option<u64>,
}

/// The last two readings of a joint: when, and where it was.
#[derive(Clone, Copy, Debug, Default)]
struct Readings {
    before: Option<(u64, f64)>,
    newest: Option<(u64, f64)>,
}

impl JointFrames {
    /// Frames of `num_dofs` joints that `devices` report.
    pub(crate) fn new(num_dofs: usize, devices: &[usize]) -> Self {
        Self {
            members: devices.iter().map(|&device| (device, None)).collect(),
            joints: vec![Readings::default(); num_dofs],
            round: Round::new(devices.len()),
            last_ns: None,
        }
    }

    /// A device reports `positions` of `dofs`. Gives the frame that is whole now, if one is.
    ///
    /// Reports of unknown devices or joints, with numbers that are none, or from before the device's newest are left
    /// out.
    pub(crate) fn report(
        &mut self,
        device: usize,
        host_ns: u64,
        dofs: &[usize],
        positions: &[f64],
    ) -> Option<JointFrame> {
        let idx = self.members.iter().position(|(member, _)| *member == device)?;
        let newer = self.members[idx].1.is_none_or(|newest_ns| host_ns > newest_ns);
        let known = dofs.iter().all(|&dof| dof < self.joints.len()) && dofs.len() == positions.len();
        if !newer || !known || !positions.iter().all(|position| position.is_finite()) {
            return None;
        }
        let report = self.round.report(idx);
        let ended = if report == Report::EndedBefore { self.frame() } else { None };
        self.members[idx].1 = Some(host_ns);
        for (&dof, &position) in dofs.iter().zip(positions) {
            let readings = &mut self.joints[dof];
            readings.before = readings.newest.replace((host_ns, position));
        }
        if report == Report::Whole { self.frame() } else { ended }
    }

    /// Where every joint is now as far as known; `None` before every joint was seen.
    pub(crate) fn newest(&self) -> Option<Vec<f64>> {
        self.positions_at(u64::MAX)
    }

    fn frame(&mut self) -> Option<JointFrame> {
        let times = || {
            let members = self.members.iter().enumerate();
            members
                .filter(|(idx, _)| self.round.takes_part(*idx))
                .filter_map(|(_, (_, newest_ns))| *newest_ns)
        };
        let after_last = |at_ns: &u64| self.last_ns.is_none_or(|last_ns| *at_ns > last_ns);
        let host_ns = times().min().filter(after_last).or_else(|| times().filter(after_last).min())?;
        let positions = self.positions_at(host_ns)?;
        self.last_ns = Some(host_ns);
        Some(JointFrame { host_ns, positions })
    }

    fn positions_at(&self, host_ns: u64) -> Option<Vec<f64>> {
        self.joints.iter().map(|readings| readings.at(host_ns)).collect()
    }
}

impl Readings {
    fn at(self, host_ns: u64) -> Option<f64> {
        let (newest_ns, newest) = self.newest?;
        let Some((before_ns, before)) = self.before.filter(|_| host_ns < newest_ns) else {
            return Some(newest);
        };
        let share = host_ns.saturating_sub(before_ns) as f64 / (newest_ns - before_ns) as f64;
        Some(before + share.min(1.0) * (newest - before))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A device with joints 2 and 0, one with joint 1.
    const FIRST: (usize, &[usize]) = (4, &[2, 0]);
    const SECOND: (usize, &[usize]) = (7, &[1]);

    fn report(
        frames: &mut JointFrames,
        device: (usize, &[usize]),
        host_ns: u64,
        at: f64,
    ) -> Option<JointFrame> {
        frames.report(device.0, host_ns, device.1, &vec![at; device.1.len()])
    }

    #[test]
    fn devices_are_seen_at_the_same_moment() {
        let mut frames = JointFrames::new(3, &[4, 7]);
        let at = |ns: u64| ns as f64 * 1e-3;
        assert_eq!(frames.newest(), None);
        let mut made = Vec::new();
        for step in 1..=20_u64 {
            let (first_ns, second_ns) = (step * 100, step * 100 + 60);
            made.extend(report(&mut frames, FIRST, first_ns, at(first_ns)));
            made.extend(report(&mut frames, SECOND, second_ns, at(second_ns)));
        }
        assert!(made.len() >= 17, "{}", made.len());
        for frame in &made[1..] {
            for position in &frame.positions {
                assert!((position - at(frame.host_ns)).abs() < 1e-12, "{frame:?}");
            }
        }
        assert!(made.windows(2).all(|pair| pair[0].host_ns < pair[1].host_ns));
        assert_eq!(frames.newest(), Some(vec![at(2000), at(2060), at(2000)]));
    }

    #[test]
    fn a_device_that_has_gone_is_where_it_was_last_seen() {
        let mut frames = JointFrames::new(3, &[4, 7]);
        let mut made = Vec::new();
        for step in 1..=20_u64 {
            made.extend(report(&mut frames, FIRST, step * 100, step as f64));
            if step <= 5 {
                made.extend(report(&mut frames, SECOND, step * 100 + 10, 0.5));
            }
        }
        assert!(made.len() >= 17, "{}", made.len());
        assert_eq!(made.last().map(|frame| frame.positions.clone()), Some(vec![20.0, 0.5, 20.0]));
    }

    #[test]
    fn a_joint_that_could_not_be_read_stays_where_it_was() {
        let mut frames = JointFrames::new(2, &[0]);
        assert_eq!(frames.report(0, 10, &[0], &[1.0]), None);
        assert_eq!(
            frames.report(0, 20, &[0, 1], &[2.0, 7.0]).map(|frame| frame.positions),
            Some(vec![2.0, 7.0])
        );
        assert_eq!(frames.report(0, 30, &[0], &[3.0]).map(|frame| frame.positions), Some(vec![3.0, 7.0]));
    }

    #[test]
    fn reports_that_make_no_sense_are_left_out() {
        let mut frames = JointFrames::new(1, &[0]);
        assert_eq!(frames.report(3, 10, &[0], &[1.0]), None);
        assert_eq!(frames.report(0, 10, &[0], &[1.0, 2.0]), None);
        assert_eq!(frames.report(0, 10, &[5], &[1.0]), None);
        assert_eq!(frames.report(0, 10, &[0], &[f64::NAN]), None);
        assert_eq!(frames.newest(), None);
        assert!(frames.report(0, 10, &[0], &[1.0]).is_some());
        assert_eq!(frames.report(0, 10, &[0], &[2.0]), None);
        assert_eq!(frames.newest(), Some(vec![1.0]));
    }
}
