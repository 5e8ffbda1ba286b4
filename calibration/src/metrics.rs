//! Event metrics: L1, contact onset and offset error, activation F1, false positive rate.
//!
//! L1, F1 and FPR count channel-frames, as in the paper's appendix "Tactile Event Fidelity Metrics". The paper leaves
//! open which onsets belong together and what a missed contact counts; here is what this module does, and why.
//!
//! - **Contact**: a maximal run of active frames of one channel. Runs with a gap of at most [`CHATTER_GAP_S`] between
//!   them are one contact: a reading that hovers at its threshold drops out for a single frame, and one push would
//!   otherwise have several onsets. L1, F1 and FPR see the frames as they are.
//! - **Onset** is the time of a contact's first active frame, **offset** that of the first inactive frame after it. A
//!   contact that is already there in the first frame of a take has no onset, one that lasts to the end no offset.
//! - **Partners**: within a channel and take, a real and a simulated contact may be partners if they overlap or if
//!   their onsets lie within [`PAIRING_WINDOW_S`]. Overlap alone would lose short taps that come late; the window alone
//!   would drop the largest errors from the mean (a press that simulation reports two seconds early is still the same
//!   press).
//! - **Pairing** is one-to-one, keeps the order of time, and has as many pairs as possible; among those, the smallest
//!   sum of onset errors ([`pair_contacts`], exact dynamic programming). As many pairs as possible, because a pairing
//!   that may leave contacts out can always lower the error by leaving out the worst.
//! - **A missed contact** (no partner) has no onset error and enters no mean. It lowers the *coverage*, the share of
//!   real contacts with a partner, which stands beside the error wherever it is shown, and it costs F1 and L1 for as long as it
//!   lasts. An onset error is comparable between two models only where their coverages are.
//!
//! Everything is summed in integers (times in whole microseconds), so that [`MetricsSum`]s merge to the same bits in any
//! order and for any number of threads.

use std::iter::Sum;
use std::ops::{Add, AddAssign};

use palpate_reports::Metrics;

/// Longest gap within one contact, s: one missing frame at the 10 Hz of a joint log, not two.
pub const CHATTER_GAP_S: f64 = 0.15;

/// Largest distance of two onsets whose contacts do not overlap and may still be partners, s. Longer than a sensing
/// chain is late, shorter than the time between two taps.
pub const PAIRING_WINDOW_S: f64 = 0.5;

const CHATTER_GAP_US: i64 = (CHATTER_GAP_S * 1e6) as i64;
const PAIRING_WINDOW_US: i64 = (PAIRING_WINDOW_S * 1e6) as i64;

/// One contact of one channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Contact {
    /// Time of the first active frame, us since the take's start.
    pub start_us: i64,
    /// Time of the first inactive frame after it, us; of the last frame where the contact lasts to the end.
    pub end_us: i64,
    /// Whether the take shows the contact begin.
    pub has_onset: bool,
    /// Whether the take shows the contact end.
    pub has_offset: bool,
}

impl Contact {
    fn may_pair(&self, other: &Self) -> bool {
        let overlaps = self.start_us < other.end_us && other.start_us < self.end_us;
        overlaps || (self.start_us - other.start_us).abs() <= PAIRING_WINDOW_US
    }
}

/// Counts and sums that the metrics are made of; merges exactly.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MetricsSum {
    /// Channel-frames active in both.
    pub true_positives: u64,
    /// Channel-frames active in simulation only.
    pub false_positives: u64,
    /// Channel-frames active in reality only.
    pub false_negatives: u64,
    /// Channel-frames active in neither.
    pub true_negatives: u64,
    /// Real contacts.
    pub real_contacts: u64,
    /// Simulated contacts.
    pub simulated_contacts: u64,
    /// Pairs of a real and a simulated contact.
    pub paired_contacts: u64,
    /// Pairs in which both have an onset.
    pub paired_onsets: u64,
    /// Sum of their absolute onset differences, us.
    pub onset_error_us: u64,
    /// Pairs in which both have an offset.
    pub paired_offsets: u64,
    /// Sum of their absolute offset differences, us.
    pub offset_error_us: u64,
}

impl AddAssign for MetricsSum {
    fn add_assign(&mut self, other: Self) {
        self.true_positives += other.true_positives;
        self.false_positives += other.false_positives;
        self.false_negatives += other.false_negatives;
        self.true_negatives += other.true_negatives;
        self.real_contacts += other.real_contacts;
        self.simulated_contacts += other.simulated_contacts;
        self.paired_contacts += other.paired_contacts;
        self.paired_onsets += other.paired_onsets;
        self.onset_error_us += other.onset_error_us;
        self.paired_offsets += other.paired_offsets;
        self.offset_error_us += other.offset_error_us;
    }
}

impl Add for MetricsSum {
    type Output = Self;

    fn add(mut self, other: Self) -> Self {
        self += other;
        self
    }
}

impl Sum for MetricsSum {
    fn sum<I: Iterator<Item = Self>>(sums: I) -> Self {
        sums.fold(Self::default(), Add::add)
    }
}

impl<'a> Sum<&'a Self> for MetricsSum {
    fn sum<I: Iterator<Item = &'a Self>>(sums: I) -> Self {
        sums.copied().sum()
    }
}

impl MetricsSum {
    /// Channel-frames that differ.
    pub fn l1(&self) -> u64 {
        self.false_positives + self.false_negatives
    }

    /// Mean absolute difference of paired onsets, ms; `None` without a pair.
    pub fn onset_error_ms(&self) -> Option<f64> {
        ratio(self.onset_error_us, self.paired_onsets).map(|us| us / 1e3)
    }

    /// Mean absolute difference of paired offsets, ms; `None` without a pair.
    pub fn offset_error_ms(&self) -> Option<f64> {
        ratio(self.offset_error_us, self.paired_offsets).map(|us| us / 1e3)
    }

    /// `2 TP / (2 TP + FP + FN)`; `None` where neither side is ever active.
    pub fn f1(&self) -> Option<f64> {
        ratio(2 * self.true_positives, 2 * self.true_positives + self.l1())
    }

    /// `FP / (FP + TN)`; `None` where the real channel is always active.
    pub fn fpr(&self) -> Option<f64> {
        ratio(self.false_positives, self.false_positives + self.true_negatives)
    }

    /// Real contacts with a partner, of all real contacts.
    pub fn coverage(&self) -> Option<f64> {
        ratio(self.paired_contacts, self.real_contacts)
    }

    /// The metrics as reports carry them.
    pub fn metrics(&self) -> Metrics {
        Metrics {
            onset_error_ms: self.onset_error_ms(),
            offset_error_ms: self.offset_error_ms(),
            f1: self.f1(),
            fpr: self.fpr(),
            l1: self.l1(),
            onset_coverage: self.coverage(),
            real_contacts: self.real_contacts,
            simulated_contacts: self.simulated_contacts,
        }
    }
}

fn ratio(numerator: u64, denominator: u64) -> Option<f64> {
    (denominator > 0).then(|| numerator as f64 / denominator as f64)
}

/// Compares one take, channel by channel: one sum per channel, in order.
///
/// `real` and `simulated` are `[frame * num_channels + channel]`; `frame_times_s` increases.
///
/// # Panics
/// If the lengths do not fit each other: a caller's bug.
pub fn compare_take(
    frame_times_s: &[f64],
    num_channels: usize,
    real: &[bool],
    simulated: &[bool],
) -> Vec<MetricsSum> {
    let num_frames = frame_times_s.len();
    assert_eq!(real.len(), num_frames * num_channels, "real activations: frames x channels");
    assert_eq!(simulated.len(), num_frames * num_channels, "simulated activations: frames x channels");
    let times_us: Vec<i64> = frame_times_s.iter().map(|&t| (t * 1e6).round() as i64).collect();
    (0..num_channels)
        .map(|channel| {
            let of_channel = |active: &'_ [bool]| -> Vec<bool> {
                active.iter().skip(channel).step_by(num_channels).copied().collect()
            };
            compare_channel(&times_us, &of_channel(real), &of_channel(simulated))
        })
        .collect()
}

fn compare_channel(times_us: &[i64], real: &[bool], simulated: &[bool]) -> MetricsSum {
    let mut sum = MetricsSum::default();
    for (&real, &simulated) in real.iter().zip(simulated) {
        match (real, simulated) {
            (true, true) => sum.true_positives += 1,
            (false, true) => sum.false_positives += 1,
            (true, false) => sum.false_negatives += 1,
            (false, false) => sum.true_negatives += 1,
        }
    }
    let real = contacts(times_us, real);
    let simulated = contacts(times_us, simulated);
    sum.real_contacts = real.len() as u64;
    sum.simulated_contacts = simulated.len() as u64;
    for (real_idx, simulated_idx) in pair_contacts(&real, &simulated) {
        let (real, simulated) = (real[real_idx], simulated[simulated_idx]);
        sum.paired_contacts += 1;
        if real.has_onset && simulated.has_onset {
            sum.paired_onsets += 1;
            sum.onset_error_us += real.start_us.abs_diff(simulated.start_us);
        }
        if real.has_offset && simulated.has_offset {
            sum.paired_offsets += 1;
            sum.offset_error_us += real.end_us.abs_diff(simulated.end_us);
        }
    }
    sum
}

/// The contacts of one channel, in order of time. `times_us` and `active` have one entry per frame.
pub fn contacts(times_us: &[i64], active: &[bool]) -> Vec<Contact> {
    let mut contacts: Vec<Contact> = Vec::new();
    let mut start = None;
    for frame in 0..=active.len() {
        let is_active = active.get(frame).copied().unwrap_or(false);
        match (start, is_active) {
            (None, true) => start = Some(frame),
            (Some(first), false) => {
                start = None;
                let has_offset = frame < active.len();
                let run = Contact {
                    start_us: times_us[first],
                    end_us: times_us[if has_offset { frame } else { frame - 1 }],
                    has_onset: first > 0,
                    has_offset,
                };
                match contacts.last_mut() {
                    Some(last) if run.start_us - last.end_us <= CHATTER_GAP_US => {
                        (last.end_us, last.has_offset) = (run.end_us, run.has_offset);
                    }
                    _ => contacts.push(run),
                }
            }
            _ => {}
        }
    }
    contacts
}

/// How good a partial pairing is: more pairs, then less onset error, then less offset error.
#[derive(Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord)]
struct PairingScore {
    pairs: u32,
    minus_onset_error_us: i64,
    minus_offset_error_us: i64,
}

#[derive(Clone, Copy)]
enum Step {
    SkipReal,
    SkipSimulated,
    Pair,
}

/// Pairs contacts of one channel: `(index in real, index in simulated)`, both ascending.
///
/// Maximises the number of pairs, then minimises the sum of onset errors, then that of offset errors, over all
/// one-to-one pairings that keep the order. Dynamic programming over an alignment; as the possible partners of a
/// contact are consecutive and move on with it, only that band is visited: cost is the number of possible pairs.
pub fn pair_contacts(real: &[Contact], simulated: &[Contact]) -> Vec<(usize, usize)> {
    // best[j] is the best score of the reals so far with the first j simulated contacts; beyond its end it stays flat.
    let mut best = vec![PairingScore::default()];
    let mut rows: Vec<(usize, Vec<Step>)> = Vec::with_capacity(real.len());
    let mut band = 0..0;
    for real_contact in real {
        while band.start < simulated.len() && is_before(&simulated[band.start], real_contact) {
            band.start += 1;
        }
        band.end = band.end.max(band.start);
        while band.end < simulated.len() && simulated[band.end].may_pair(real_contact) {
            band.end += 1;
        }
        let flat = best[best.len() - 1];
        best.resize(best.len().max(band.end + 1), flat);
        let mut steps = Vec::with_capacity(band.len());
        let mut diagonal = best[band.start];
        for j in band.clone() {
            let above = best[j + 1];
            let mut paired = diagonal;
            paired.pairs += 1;
            paired.minus_onset_error_us -= (real_contact.start_us - simulated[j].start_us).abs();
            paired.minus_offset_error_us -= (real_contact.end_us - simulated[j].end_us).abs();
            // On equal scores the earlier option stands, so that the result is one and the same everywhere.
            let (mut step, mut score) = (Step::SkipReal, above);
            if best[j] > score {
                (step, score) = (Step::SkipSimulated, best[j]);
            }
            if simulated[j].may_pair(real_contact) && paired > score {
                (step, score) = (Step::Pair, paired);
            }
            best[j + 1] = score;
            steps.push(step);
            diagonal = above;
        }
        rows.push((band.start, steps));
    }
    let mut pairs = Vec::new();
    let mut j = simulated.len();
    for (real_idx, (first, steps)) in rows.iter().enumerate().rev() {
        j = j.min(first + steps.len());
        while j > *first {
            match steps[j - 1 - first] {
                Step::SkipReal => break,
                Step::SkipSimulated => j -= 1,
                Step::Pair => {
                    j -= 1;
                    pairs.push((real_idx, j));
                    break;
                }
            }
        }
    }
    pairs.reverse();
    pairs
}

/// Whether `simulated` is over, for `real` and every later real contact.
fn is_before(simulated: &Contact, real: &Contact) -> bool {
    simulated.start_us < real.start_us && !simulated.may_pair(real)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const FRAME_S: f64 = 0.1;

    fn frames(pattern: &str) -> Vec<bool> {
        pattern.chars().map(|c| c == '#').collect()
    }

    fn times_s(num_frames: usize) -> Vec<f64> {
        (0..num_frames).map(|frame| frame as f64 * FRAME_S).collect()
    }

    fn compare(real: &str, simulated: &str) -> MetricsSum {
        let (real, simulated) = (frames(real), frames(simulated));
        compare_take(&times_s(real.len()), 1, &real, &simulated)[0]
    }

    #[test]
    fn frame_counts_follow_the_papers_formulas() {
        let sum = compare("..###...#.", "...###....");
        assert_eq!(
            (sum.true_positives, sum.false_positives, sum.false_negatives, sum.true_negatives),
            (2, 1, 2, 5)
        );
        assert_eq!(sum.l1(), 3);
        assert_eq!(sum.f1(), Some(4.0 / 7.0));
        assert_eq!(sum.fpr(), Some(1.0 / 6.0));
    }

    #[test]
    fn onset_and_offset_errors_are_those_of_the_pair() {
        let sum = compare("..#####......", "....####.....");
        assert_eq!((sum.onset_error_ms(), sum.offset_error_ms()), (Some(200.0), Some(100.0)));
        assert_eq!(sum.coverage(), Some(1.0));
    }

    #[test]
    fn missed_contact_lowers_coverage_and_leaves_the_error_alone() {
        let sum = compare("..##..........##....", "...##...............");
        assert_eq!(sum.onset_error_ms(), Some(100.0));
        assert_eq!(sum.coverage(), Some(0.5));
    }

    #[test]
    fn chatter_of_one_frame_is_one_contact_but_two_frames_part() {
        assert_eq!(compare("..###.###..", "..###.###..").real_contacts, 1);
        assert_eq!(compare("..###..###.", "..###..###.").real_contacts, 2);
    }

    #[test]
    fn late_tap_without_overlap_finds_its_partner_within_the_window_only() {
        assert_eq!(compare("..#..........", ".....#.......").onset_error_ms(), Some(300.0));
        assert_eq!(compare("..#..........", "........#....").onset_error_ms(), None);
    }

    #[test]
    fn early_press_counts_in_full_because_it_overlaps() {
        assert_eq!(compare("............####.", "..##############.").onset_error_ms(), Some(1000.0));
    }

    #[test]
    fn contacts_cut_by_the_takes_ends_have_no_onset_or_offset() {
        let sum = compare("###.....", "##......");
        assert_eq!((sum.onset_error_ms(), sum.offset_error_ms()), (None, Some(100.0)));
        let sum = compare(".....###", "......##");
        assert_eq!((sum.onset_error_ms(), sum.offset_error_ms()), (Some(100.0), None));
    }

    #[test]
    fn nothing_to_average_over_is_none() {
        let sum = compare("....", "....");
        assert_eq!(
            (sum.onset_error_ms(), sum.f1(), sum.fpr(), sum.coverage()),
            (None, None, Some(0.0), None)
        );
        assert_eq!(compare("##", "##").fpr(), None);
    }

    #[test]
    fn channels_are_read_with_their_stride() {
        let real = [true, false, false, false, true, true];
        let simulated = [true, true, false, false, false, true];
        let sums = compare_take(&times_s(2), 3, &real, &simulated);
        assert_eq!(sums.iter().map(MetricsSum::l1).collect::<Vec<_>>(), [0, 2, 0]);
    }

    /// Tries every order-preserving pairing.
    fn brute_force(real: &[Contact], simulated: &[Contact]) -> PairingScore {
        let Some((first, rest)) = real.split_first() else { return PairingScore::default() };
        let mut best = brute_force(rest, simulated);
        for (j, partner) in simulated.iter().enumerate() {
            if partner.may_pair(first) {
                let mut score = brute_force(rest, &simulated[j + 1..]);
                score.pairs += 1;
                score.minus_onset_error_us -= (first.start_us - partner.start_us).abs();
                score.minus_offset_error_us -= (first.end_us - partner.end_us).abs();
                best = best.max(score);
            }
        }
        best
    }

    fn active_strategy(num_frames: usize) -> impl Strategy<Value = Vec<bool>> {
        proptest::collection::vec((any::<bool>(), 1usize..6), 1..num_frames).prop_map(move |runs| {
            let mut active: Vec<bool> =
                runs.into_iter().flat_map(|(active, len)| std::iter::repeat_n(active, len)).collect();
            active.resize(num_frames, false);
            active
        })
    }

    proptest! {
        #[test]
        fn pairing_is_the_best_of_all_pairings(real in active_strategy(40), simulated in active_strategy(40)) {
            let times_us: Vec<i64> = (0..40).map(|frame| frame * 100_000).collect();
            let (real, simulated) = (contacts(&times_us, &real), contacts(&times_us, &simulated));
            let pairs = pair_contacts(&real, &simulated);
            let mut score = PairingScore::default();
            for &(i, j) in &pairs {
                prop_assert!(real[i].may_pair(&simulated[j]));
                score.pairs += 1;
                score.minus_onset_error_us -= (real[i].start_us - simulated[j].start_us).abs();
                score.minus_offset_error_us -= (real[i].end_us - simulated[j].end_us).abs();
            }
            prop_assert!(pairs.windows(2).all(|two| two[0].0 < two[1].0 && two[0].1 < two[1].1));
            prop_assert!(score == brute_force(&real, &simulated));
        }

        #[test]
        fn a_stream_matches_itself(active in active_strategy(60)) {
            let sum = compare_take(&times_s(60), 1, &active, &active)[0];
            prop_assert_eq!(sum.l1(), 0);
            prop_assert_eq!(sum.paired_contacts, sum.real_contacts);
            prop_assert_eq!((sum.onset_error_us, sum.offset_error_us), (0, 0));
        }

        #[test]
        fn sums_merge_to_the_same_bits_in_any_order(
            patterns in proptest::collection::vec((active_strategy(30), active_strategy(30)), 2..6),
        ) {
            let sums: Vec<MetricsSum> = patterns
                .iter()
                .map(|(real, simulated)| compare_take(&times_s(30), 1, real, simulated)[0])
                .collect();
            let forward: MetricsSum = sums.iter().sum();
            let backward: MetricsSum = sums.iter().rev().sum();
            prop_assert_eq!(forward, backward);
            prop_assert_eq!(forward.metrics(), backward.metrics());
        }
    }
}
