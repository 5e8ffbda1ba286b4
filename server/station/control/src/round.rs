//! Several devices that report at their own pace, as one that reports at theirs.

/// Rounds that a member may miss before nobody waits for it any more.
const MISSED_ROUNDS: u32 = 3;

/// Says when a round of reports is whole.
///
/// A round ends with the last member's report. A member that stays away does not stop the others: when one of them
/// reports for the second time, the round ends without it, and after a few rounds nobody waits for it. What comes late
/// belongs to the round that it missed, so that one lost line does not shift a member against the others for ever.
#[derive(Clone, Debug)]
pub(crate) struct Round {
    reported: Vec<bool>,
    /// Rounds missed in a row; those who miss too many are not waited for.
    missed: Vec<u32>,
}

/// What a report does to the round.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Report {
    /// Others are waited for.
    Waiting,
    /// The round is whole with this report.
    Whole,
    /// The round ended before this report, which is the first of the next.
    EndedBefore,
}

impl Round {
    /// Nobody has reported, and nobody is waited for who never does.
    pub(crate) fn new(num_members: usize) -> Self {
        Self { reported: vec![false; num_members], missed: vec![MISSED_ROUNDS; num_members] }
    }

    /// `member` reports. What it says is to be stored after a round that [`Report::EndedBefore`] is used, and before
    /// one that is [`Report::Whole`].
    pub(crate) fn report(&mut self, member: usize) -> Report {
        if self.missed[member] >= MISSED_ROUNDS {
            // Back, or here for the first time: alone it makes a round, in company it joins with the next.
            self.missed[member] = 0;
            return if self.waited_for().all(|other| other == member) {
                self.end();
                Report::Whole
            } else {
                Report::Waiting
            };
        }
        if self.reported[member] {
            self.end();
            self.reported[member] = true;
            // With everybody else gone this report is a round again.
            if self.whole() {
                self.end();
            }
            return Report::EndedBefore;
        }
        self.reported[member] = true;
        if self.whole() {
            self.end();
            return Report::Whole;
        }
        Report::Waiting
    }

    /// Whether `member` reports at present.
    pub(crate) fn takes_part(&self, member: usize) -> bool {
        self.missed[member] < MISSED_ROUNDS
    }

    fn waited_for(&self) -> impl Iterator<Item = usize> + '_ {
        (0..self.missed.len()).filter(|&member| self.takes_part(member))
    }

    fn whole(&self) -> bool {
        self.waited_for().all(|member| self.reported[member])
    }

    fn end(&mut self) {
        for (reported, missed) in self.reported.iter_mut().zip(&mut self.missed) {
            *missed = if *reported { 0 } else { missed.saturating_add(1).min(MISSED_ROUNDS) };
            *reported = false;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rounds that end while `order` report in turn.
    fn num_rounds(round: &mut Round, order: &[usize]) -> usize {
        order.iter().filter(|&&member| round.report(member) != Report::Waiting).count()
    }

    #[test]
    fn a_round_is_whole_with_the_last_report() {
        let mut round = Round::new(3);
        num_rounds(&mut round, &[0, 1, 2, 0, 1, 2]);
        let reports: Vec<Report> = [0, 1, 2, 1, 0, 2].map(|member| round.report(member)).into();
        use Report::{Waiting, Whole};
        assert_eq!(reports, [Waiting, Waiting, Whole, Waiting, Waiting, Whole]);
    }

    #[test]
    fn a_member_that_stays_away_does_not_stop_the_others() {
        let mut round = Round::new(3);
        num_rounds(&mut round, &[0, 1, 2, 0, 1, 2]);
        let order = [0, 1].repeat(20);
        let rounds = num_rounds(&mut round, &order);
        assert!((18..=20).contains(&rounds), "{rounds}");
        assert!(round.takes_part(0) && !round.takes_part(2));
        // And it is waited for again once it is back.
        num_rounds(&mut round, &[2, 0, 1, 2]);
        assert!(round.takes_part(2));
        assert_eq!(
            [0, 1, 2].map(|member| round.report(member)),
            [Report::Waiting, Report::Waiting, Report::Whole]
        );
    }

    #[test]
    fn one_lost_report_shifts_nobody() {
        let mut round = Round::new(3);
        num_rounds(&mut round, &[0, 1, 2, 0, 1, 2]);
        assert_eq!([0, 1].map(|member| round.report(member)), [Report::Waiting; 2]);
        assert_eq!(round.report(0), Report::EndedBefore);
        assert_eq!([1, 2].map(|member| round.report(member)), [Report::Waiting, Report::Whole]);
    }

    #[test]
    fn one_member_alone_makes_a_round_each_time() {
        let mut round = Round::new(1);
        assert_eq!(num_rounds(&mut round, &[0; 10]), 10);
    }
}
