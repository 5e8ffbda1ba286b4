//! Scores with labels, sorted once: the objective for every threshold.

/// Scores of channel-frames, split by whether the real channel was active, each sorted.
///
/// A channel-frame is active in simulation if its score is *above* the threshold. Pressure is such a score; a signed
/// distance becomes one by its sign (`d < lambda` is `-d > -lambda`, exactly, also in floating point). Scores at or
/// below `floor`, the lowest admissible threshold, are never active: they are only counted, which keeps the many frames
/// without contact out of the sort.
#[derive(Clone, Debug, PartialEq)]
pub struct Ranked {
    floor: f64,
    /// Keys of scores above `floor`, ascending.
    active: Vec<u64>,
    /// Keys of scores above `floor`, ascending.
    inactive: Vec<u64>,
    active_at_rest: u64,
    inactive_at_rest: u64,
}

/// The best threshold over all admissible real numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BestThreshold {
    /// The threshold, in terms of the score.
    pub threshold: f64,
    /// Channel-frames that differ with it.
    pub l1: u64,
    /// Steps of the objective that were compared.
    pub evaluations: u64,
}

/// Collects scores before they are sorted.
#[derive(Clone, Debug)]
pub(crate) struct Unranked(Ranked);

impl Unranked {
    pub(crate) fn new(floor: f64) -> Self {
        Self::with_capacity(floor, [0, 0])
    }

    /// Expects that many scores above the floor, inactive and active in reality.
    pub(crate) fn with_capacity(floor: f64, [inactive, active]: [usize; 2]) -> Self {
        let (active, inactive) = (Vec::with_capacity(active), Vec::with_capacity(inactive));
        Self(Ranked { floor, active, inactive, active_at_rest: 0, inactive_at_rest: 0 })
    }

    #[inline]
    pub(crate) fn push(&mut self, score: f64, real_active: bool) {
        let ranked = &mut self.0;
        if score > ranked.floor {
            if real_active { ranked.active.push(key(score)) } else { ranked.inactive.push(key(score)) }
        } else {
            self.push_at_rest(1, u64::from(real_active));
        }
    }

    /// Adds `count` channel-frames that are never active, `real_active` of them active in reality.
    #[inline]
    pub(crate) fn push_at_rest(&mut self, count: u64, real_active: u64) {
        self.0.active_at_rest += real_active;
        self.0.inactive_at_rest += count - real_active;
    }

    pub(crate) fn rank(self) -> Ranked {
        let mut ranked = self.0;
        ranked.active.sort_unstable();
        ranked.inactive.sort_unstable();
        ranked
    }
}

impl Ranked {
    /// Sorts `(score, whether the real channel was active)`. Scores are finite or negative infinity.
    pub fn new(floor: f64, scores: impl IntoIterator<Item = (f64, bool)>) -> Self {
        let mut unranked = Unranked::new(floor);
        for (score, real_active) in scores {
            unranked.push(score, real_active);
        }
        unranked.rank()
    }

    /// Channel-frames in all.
    pub fn num_samples(&self) -> u64 {
        self.num_above_floor() + self.active_at_rest + self.inactive_at_rest
    }

    /// Channel-frames that some threshold makes active.
    pub fn num_above_floor(&self) -> u64 {
        (self.active.len() + self.inactive.len()) as u64
    }

    /// Channel-frames in which the real channel is active.
    pub fn num_real_active(&self) -> u64 {
        self.active.len() as u64 + self.active_at_rest
    }

    /// Channel-frames that differ if those with `score > threshold` are active; `threshold` is at least the floor.
    pub fn l1_at(&self, threshold: f64) -> u64 {
        let threshold = key(threshold);
        let misses = self.active.partition_point(|&score| score <= threshold);
        let false_alarms = self.inactive.len() - self.inactive.partition_point(|&score| score <= threshold);
        self.active_at_rest + (misses + false_alarms) as u64
    }

    /// The score below which a share `quantile` of those lies that are above the floor with the real channel active.
    pub fn active_quantile(&self, quantile: f64) -> Option<f64> {
        let last = self.active.len().checked_sub(1)?;
        Some(score(self.active[(quantile * last as f64).round() as usize]))
    }

    /// The threshold with the smallest objective over all real numbers from the floor on; `None` if no score is above
    /// the floor, since all thresholds are the same then.
    ///
    /// Between two neighbouring scores the objective is constant. Where several such intervals share the optimum, the
    /// widest connected one wins (the lowest, if equal), and its centre is taken: the threshold farthest from changing
    /// anything. The interval above the largest score counts as wide as nothing, for want of a centre.
    pub fn best(&self) -> Option<BestThreshold> {
        let mut plateaus = Plateaus::start(self.floor, self.active_at_rest + self.inactive.len() as u64);
        let (mut i, mut j) = (0, 0);
        while i < self.active.len() || j < self.inactive.len() {
            let next = match (self.active.get(i), self.inactive.get(j)) {
                (Some(&a), Some(&b)) => a.min(b),
                (Some(&a), None) => a,
                (None, Some(&b)) => b,
                (None, None) => break,
            };
            let (misses_before, alarms_before) = (i, j);
            while self.active.get(i) == Some(&next) {
                i += 1;
            }
            while self.inactive.get(j) == Some(&next) {
                j += 1;
            }
            plateaus.step(score(next), (i - misses_before) as u64, (j - alarms_before) as u64);
        }
        (i + j > 0).then(|| plateaus.finish())
    }
}

/// Integers compare faster than floats: a key that orders as the score does. `-0.0` and `0.0` have one key.
#[inline]
fn key(score: f64) -> u64 {
    let bits = (score + 0.0).to_bits();
    // Negative floats order backwards by their bits, and below all positive ones.
    if bits >> 63 == 1 { !bits } else { bits | 1 << 63 }
}

#[inline]
fn score(key: u64) -> f64 {
    f64::from_bits(if key >> 63 == 1 { key & !(1 << 63) } else { !key })
}

/// Follows the objective upwards and keeps its widest lowest plateau.
struct Plateaus {
    l1: u64,
    /// Lower end of the plateau under way, and of its last interval.
    start: f64,
    last: f64,
    best_l1: u64,
    best: [f64; 2],
    steps: u64,
}

impl Plateaus {
    fn start(floor: f64, l1: u64) -> Self {
        Self { l1, start: floor, last: floor, best_l1: u64::MAX, best: [floor; 2], steps: 1 }
    }

    /// At `score`, `active` scores fall silent rightly missed and `inactive` ones rightly so.
    fn step(&mut self, score: f64, active: u64, inactive: u64) {
        self.last = score;
        self.steps += 1;
        if active != inactive {
            self.close();
            self.start = score;
            self.l1 = self.l1 + active - inactive;
        }
    }

    /// Ends the plateau under way at `self.last`.
    fn close(&mut self) {
        let is_better = self.l1 < self.best_l1;
        let is_wider = self.l1 == self.best_l1 && self.last - self.start > self.best[1] - self.best[0];
        if is_better || is_wider {
            (self.best_l1, self.best) = (self.l1, [self.start, self.last]);
        }
    }

    fn finish(mut self) -> BestThreshold {
        self.close();
        let [low, high] = self.best;
        let centre = low + (high - low) / 2.0;
        // The plateau is closed below and open above: with neighbouring floats the centre may round up to its end.
        let threshold = if centre < high { centre } else { low };
        BestThreshold { threshold, l1: self.best_l1, evaluations: self.steps }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn brute_force(scores: &[(f64, bool)], threshold: f64) -> u64 {
        scores.iter().filter(|&&(score, real_active)| (score > threshold) != real_active).count() as u64
    }

    fn best(scores: &[(f64, bool)]) -> Option<BestThreshold> {
        Ranked::new(0.0, scores.iter().copied()).best()
    }

    #[test]
    fn separable_scores_give_the_centre_of_the_gap() {
        let found =
            best(&[(0.0, false), (1.0, false), (3.0, true), (4.0, true)]).expect("scores above the floor");
        assert_eq!((found.threshold, found.l1), (2.0, 0));
    }

    #[test]
    fn widest_of_several_optima_wins() {
        // [1, 2) and [5, 9) both leave one mistake.
        let scores = [(1.0, false), (2.0, true), (5.0, false), (9.0, true)];
        let found = best(&scores).expect("scores above the floor");
        assert_eq!((found.threshold, found.l1), (7.0, 1));
    }

    #[test]
    fn all_inactive_is_silenced_at_the_largest_score() {
        let found = best(&[(0.0, false), (2.0, false), (7.0, false)]).expect("scores above the floor");
        assert_eq!((found.threshold, found.l1), (7.0, 0));
    }

    #[test]
    fn all_active_takes_the_centre_of_the_lowest_interval() {
        let found = best(&[(2.0, true), (2.0, true), (7.0, true)]).expect("scores above the floor");
        assert_eq!((found.threshold, found.l1), (1.0, 0));
    }

    #[test]
    fn all_equal_is_decided_by_the_majority() {
        assert_eq!(
            best(&[(2.0, true), (2.0, true), (2.0, false)]).map(|b| (b.threshold, b.l1)),
            Some((1.0, 1))
        );
        assert_eq!(
            best(&[(2.0, true), (2.0, false), (2.0, false)]).map(|b| (b.threshold, b.l1)),
            Some((2.0, 1))
        );
    }

    #[test]
    fn without_a_score_above_the_floor_there_is_nothing_to_choose() {
        assert_eq!(best(&[]), None);
        assert_eq!(best(&[(0.0, true), (0.0, false)]), None);
    }

    #[test]
    fn neighbouring_floats_are_told_apart() {
        let low = 1.0_f64;
        let high = low.next_up();
        let found = best(&[(low, false), (high, true)]).expect("scores above the floor");
        assert_eq!(found.l1, 0);
        assert_eq!(brute_force(&[(low, false), (high, true)], found.threshold), 0);
    }

    fn scores_strategy() -> impl Strategy<Value = Vec<(f64, bool)>> {
        // Few distinct values for ties, and continuous ones.
        let score = prop_oneof![Just(0.0), (0..6_u8).prop_map(f64::from), -1.0..5.0_f64];
        proptest::collection::vec((score, any::<bool>()), 0..60)
    }

    proptest! {
        #[test]
        fn keys_order_as_scores_and_lead_back(a in -1e9..1e9_f64, b in prop_oneof![Just(0.0), Just(-0.0), -1e-300..1e9_f64]) {
            prop_assert_eq!(a.partial_cmp(&b), Some(key(a).cmp(&key(b))));
            prop_assert_eq!(score(key(a)), a);
        }

        #[test]
        fn objective_equals_brute_force_at_every_threshold(
            scores in scores_strategy(),
            thresholds in proptest::collection::vec(0.0..6.0_f64, 1..20),
        ) {
            let ranked = Ranked::new(0.0, scores.iter().copied());
            prop_assert_eq!(ranked.num_samples(), scores.len() as u64);
            let at_scores = scores.iter().map(|&(score, _)| score).filter(|&score| score >= 0.0);
            for threshold in thresholds.into_iter().chain(at_scores) {
                prop_assert_eq!(ranked.l1_at(threshold), brute_force(&scores, threshold));
            }
        }

        #[test]
        fn best_is_reached_and_beats_every_threshold(
            scores in scores_strategy(),
            thresholds in proptest::collection::vec(0.0..6.0_f64, 1..20),
        ) {
            if let Some(best) = best(&scores) {
                prop_assert!(best.threshold >= 0.0 && best.threshold.is_finite());
                prop_assert_eq!(best.l1, brute_force(&scores, best.threshold));
                let at_scores = scores.iter().map(|&(score, _)| score).filter(|&score| score >= 0.0);
                for threshold in thresholds.into_iter().chain(at_scores).chain([0.0]) {
                    prop_assert!(best.l1 <= brute_force(&scores, threshold));
                }
            }
        }

        #[test]
        fn order_of_the_samples_does_not_matter(scores in scores_strategy()) {
            let forward = Ranked::new(0.0, scores.iter().copied());
            let backward = Ranked::new(0.0, scores.iter().rev().copied());
            prop_assert_eq!(forward, backward);
        }
    }
}
