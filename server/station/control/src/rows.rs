//! Reports of members that keep the same rate, each by its own clock, as rows with one report of each.

use std::collections::VecDeque;

/// Rows that a member may miss before nobody waits for it any more.
const MISSED_ROWS: u32 = 3;
/// How long a member's reports wait for another's, ns; longer than an operating system holds them back.
const WAITING_NS: u64 = 100_000_000;
/// Rows in a row that may be too wide.
const WIDE_ROWS: u32 = 4;

/// Puts together what belongs together.
///
/// Reports come one by one or in bursts, where an operating system hands on late what it heard in time. So a row is made
/// of the oldest report of every member, however they came. Where a report was lost, the other members' next ones suit
/// better; where a clock drifts against another, rows grow wider until they hold nearly a whole period for a while: then
/// the older reports make a row of their own. A member that stays away holds the others up for a few periods, and then
/// no longer.
#[derive(Clone, Debug)]
pub(crate) struct Rows<T> {
    period_ns: u64,
    waiting: Vec<VecDeque<(u64, T)>>,
    /// Rows missed in a row; those who miss too many are not waited for.
    missed: Vec<u32>,
    /// Rows in a row, the newest ones, that were too wide.
    wide: u32,
}

impl<T> Rows<T> {
    /// Nobody has reported, and nobody is waited for who never does. A member reports every `period_ns`.
    pub(crate) fn new(num_members: usize, period_ns: u64) -> Self {
        Self {
            period_ns,
            waiting: (0..num_members).map(|_| VecDeque::new()).collect(),
            missed: vec![MISSED_ROWS; num_members],
            wide: 0,
        }
    }

    /// `member` reports, of a time that is later than that of its report before.
    pub(crate) fn push(&mut self, member: usize, host_ns: u64, report: T) {
        if self.missed[member] >= MISSED_ROWS {
            self.missed[member] = 0;
        }
        self.waiting[member].push_back((host_ns, report));
    }

    /// The next row, if one is whole: of each member its report and when it was, or nothing where it missed the row.
    pub(crate) fn pop(&mut self) -> Option<Vec<Option<(u64, T)>>> {
        let longest = self.waiting.iter().map(VecDeque::len).max().filter(|&longest| longest > 0)?;
        let takes_part = |missed: &u32| *missed < MISSED_ROWS;
        let mut members = self.waiting.iter().zip(&self.missed);
        if longest <= self.max_waiting()
            && members.any(|(waiting, missed)| waiting.is_empty() && takes_part(missed))
        {
            return None;
        }
        let until_ns = self.row_ends_ns();
        let row = self.waiting.iter_mut().zip(&mut self.missed).map(|(waiting, missed)| {
            let report = waiting.pop_front_if(|(host_ns, _)| *host_ns <= until_ns);
            *missed = if report.is_some() { 0 } else { missed.saturating_add(1).min(MISSED_ROWS) };
            report
        });
        Some(row.collect())
    }

    /// Reports of one member that may wait for another's.
    fn max_waiting(&self) -> usize {
        (WAITING_NS / self.period_ns) as usize + 1
    }

    /// The latest time that a report of the next row may have.
    fn row_ends_ns(&mut self) -> u64 {
        let half_ns = self.period_ns / 2;
        let heads = || self.waiting.iter().filter_map(|waiting| waiting.front()).map(|(host_ns, _)| *host_ns);
        let (first_ns, last_ns) = (heads().min().unwrap_or(0), heads().max().unwrap_or(u64::MAX));
        // Members whose clocks are spread as evenly as can be are within all but one part of a period.
        let parts = 2 * self.waiting.len() as u64;
        let is_wide = last_ns - first_ns > self.period_ns / parts * (parts - 1);
        self.wide = if is_wide { self.wide + 1 } else { 0 };
        if self.wide > WIDE_ROWS {
            self.wide = 0;
            return first_ns + half_ns;
        }
        // Someone whose next report suits the latest one so much better that its oldest must be of a row before.
        let suits_better = |waiting: &&VecDeque<(u64, T)>| match (waiting.front(), waiting.get(1)) {
            (Some((head_ns, _)), Some((next_ns, _))) => {
                next_ns.abs_diff(last_ns) + half_ns < last_ns - head_ns
            }
            _ => false,
        };
        let lone = self.waiting.iter().filter(suits_better).filter_map(VecDeque::front);
        lone.map(|(head_ns, _)| head_ns + half_ns).min().unwrap_or(last_ns)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const PERIOD_NS: u64 = 10_000_000;

    /// Rows of what members report: who, when. A report is its own number within its member.
    fn rows(num_members: usize, reports: &[(usize, u64)]) -> Vec<Vec<Option<u32>>> {
        let mut rows = Rows::new(num_members, PERIOD_NS);
        let mut counts = vec![0; num_members];
        let mut made = Vec::new();
        for &(member, host_ns) in reports {
            rows.push(member, host_ns, counts[member]);
            counts[member] += 1;
            made.extend(std::iter::from_fn(|| rows.pop()));
        }
        let report = |report: Option<(u64, u32)>| report.map(|(_, number)| number);
        made.into_iter().map(|row| row.into_iter().map(report).collect()).collect()
    }

    /// Both members `from..until`, the second `lag_ns` after the first.
    fn in_turn(from: u64, until: u64, lag_ns: u64) -> Vec<(usize, u64)> {
        (from..until).flat_map(|step| [(0, step * PERIOD_NS), (1, step * PERIOD_NS + lag_ns)]).collect()
    }

    /// Rows in which somebody is missing, without the first, in which not all have come yet.
    fn num_partial(rows: &[Vec<Option<u32>>]) -> usize {
        rows[1..].iter().filter(|row| row.contains(&None)).count()
    }

    #[test]
    fn a_row_is_whole_with_the_last_report() {
        assert_eq!(
            rows(2, &in_turn(0, 4, 3_000_000)),
            [[Some(0), None], [Some(1), Some(0)], [Some(2), Some(1)], [Some(3), Some(2)]]
        );
    }

    #[test]
    fn a_burst_makes_no_rows_of_its_own() {
        let mut reports = in_turn(0, 10, 3_000_000);
        // Nobody is heard for 30 ms; then the first member all at once, and the second.
        reports
            .extend([0, 0, 0, 1, 1, 1].iter().zip(130_000_000..).map(|(&member, host_ns)| (member, host_ns)));
        reports.extend(in_turn(14, 20, 3_000_000));
        let rows = rows(2, &reports);
        assert_eq!(num_partial(&rows), 0, "{rows:?}");
        assert!(rows.iter().skip(1).all(|row| row[0] == row[1].map(|number| number + 1)), "{rows:?}");
    }

    #[test]
    fn members_that_report_at_once_are_in_one_row() {
        for lag_ns in [0, 100_000, 2_000_000] {
            let rows = rows(2, &in_turn(0, 20, lag_ns));
            assert_eq!(rows.last(), Some(&vec![Some(19), Some(19)]), "{lag_ns}");
            assert!(num_partial(&rows) <= 1, "{rows:?}");
        }
        // The second reports just before the first, and one of its reports is lost.
        let mut reports = in_turn(0, 40, 9_900_000);
        reports.remove(21);
        assert_eq!(rows(2, &reports).last(), Some(&vec![Some(39), Some(37)]));
    }

    #[test]
    fn lost_reports_shift_nobody() {
        let mut reports = in_turn(0, 20, 3_000_000);
        let second = |step: u64| (1, step * PERIOD_NS + 3_000_000);
        reports.retain(|report| ![second(5), second(10), second(15)].contains(report));
        let rows = rows(2, &reports);
        // The first loss is made up for: until then the second member's reports were older by most of a period.
        assert_eq!(num_partial(&rows), 2, "{rows:?}");
        assert_eq!(rows.last(), Some(&vec![Some(19), Some(19 - 3)]));
    }

    #[test]
    fn a_member_that_stays_away_does_not_stop_the_others() {
        let mut reports = in_turn(0, 10, 3_000_000);
        reports.extend((10..30).map(|step| (0, step * PERIOD_NS)));
        let alone = rows(2, &reports);
        // The last report has come through as soon as nobody is waited for.
        assert_eq!(alone.last(), Some(&vec![Some(29), None]));
        // And it is waited for again once it is back.
        reports.extend(in_turn(30, 40, 3_000_000));
        let back = rows(2, &reports);
        assert!(back[back.len() - 8..].iter().all(|row| !row.contains(&None)), "{back:?}");
    }

    #[test]
    fn one_member_alone_makes_a_row_each_time() {
        let reports: Vec<(usize, u64)> = (0..10).map(|step| (0, step * PERIOD_NS)).collect();
        assert_eq!(rows(1, &reports).len(), 10);
    }

    proptest! {
        #[test]
        fn every_report_is_in_one_row_and_in_turn(
            reports in prop::collection::vec((0_usize..3, 0_u64..20_000_000), 1..300)
        ) {
            let mut now_ns = 0;
            let mut timed = Vec::new();
            for (member, step_ns) in reports {
                now_ns += step_ns + 1;
                timed.push((member, now_ns));
            }
            let rows = rows(3, &timed);
            let max_waiting = Rows::<u32>::new(3, PERIOD_NS).max_waiting();
            for member in 0..3 {
                let seen: Vec<u32> = rows.iter().filter_map(|row| row[member]).collect();
                let pushed = timed.iter().filter(|(from, _)| *from == member).count();
                prop_assert!(seen.iter().enumerate().all(|(idx, &number)| number as usize == idx));
                prop_assert!((pushed.saturating_sub(max_waiting)..=pushed).contains(&seen.len()));
            }
        }
    }

    #[test]
    fn clocks_that_drift_make_as_many_rows_as_the_fastest_reports() {
        // A tenth faster: in 200 periods it gains 20, one row for each.
        let mut reports: Vec<(usize, u64)> = (0..200).map(|step| (0, step * PERIOD_NS)).collect();
        reports.extend((0..220).map(|step| (1, step * PERIOD_NS * 10 / 11)));
        reports.sort_by_key(|&(_, host_ns)| host_ns);
        let rows = rows(2, &reports);
        assert!((218..=221).contains(&rows.len()), "{}", rows.len());
    }
}
