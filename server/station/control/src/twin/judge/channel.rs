//! What is known of one channel, and whether it can be believed.

use std::collections::VecDeque;

use palpate_robot_model::StreamConfig;

use super::WINDOW_S;
use crate::streams::Reading;

/// A quiet reading that is off its zero by this share of what a touch takes has drifted.
const DRIFT_SHARE: f64 = 0.5;
/// And is back below this one.
const BACK_SHARE: f64 = 0.35;
/// Readings that are touched now and then are quiet in at least this share of a window.
const QUIET_SHARE: f64 = 0.1;
/// A touch that moves the reading by less than this share of what switches it on was not felt at all. A channel that
/// felt it weakly is insensitive, not dead.
const FELT_SHARE: f64 = 0.25;
/// A simulated load this far above the one that switches on is a touch that a channel should feel firmly.
const FIRM: f64 = 2.0;
/// Firm touches in a row, each as firm as those that it used to feel, that a channel must not feel to count as dead. A
/// model that is not calibrated expects touches that nobody would feel; those the channel has never felt either.
const MISSES: u32 = 3;
/// And so many where it has not felt anything at all so far.
const MISSES_FROM_START: u32 = 6;
/// Weight of a new touch in the mean of what is felt.
const NEW_SHARE: f64 = 0.2;
/// Shorter touches are too short to be expected with confidence, s.
const SHORTEST_TOUCH_S: f64 = 0.2;
/// Longer ones are judged before they end, while all of them is remembered, s.
const LONGEST_TOUCH_S: f64 = 5.0;
/// A touch may be felt so much earlier or later than the simulator expects, s.
const BEFORE_S: f64 = 0.5;
const AFTER_S: f64 = 0.7;
/// On for so long without anybody knowing an object in place, a channel is held by something that should be known, s.
const ALWAYS_S: f64 = 30.0;

/// One moment of the channel.
#[derive(Clone, Copy, Debug)]
pub(super) struct Moment {
    at_s: f64,
    raw: f32,
    reference: f64,
    active: bool,
    /// Whether the simulator has it on, and its load over the one that switches it on.
    expected: Option<(bool, f64)>,
}

impl Moment {
    pub(super) fn new(at_s: f64, reading: &Reading, expected: Option<(bool, f64)>) -> Self {
        Self { at_s, raw: reading.raw, reference: reading.reference, active: reading.active, expected }
    }

    fn rise(&self) -> f64 {
        f64::from(self.raw) - self.reference
    }

    fn is_expected(&self) -> bool {
        self.expected.is_some_and(|(active, _)| active)
    }
}

/// A firm touch that is expected: from when to when so far, s, and its most load so far.
#[derive(Clone, Copy, Debug)]
struct Touch {
    from_s: f64,
    until_s: f64,
    load: f64,
}

/// The account of one channel.
#[derive(Clone, Debug)]
pub(super) struct ChannelRecord {
    id: String,
    on_threshold: f64,
    raw_min: f64,
    /// The last [`WINDOW_S`], oldest first; anew with every zero.
    moments: VecDeque<Moment>,
    /// Since when the reading is the same to the bit, s, and as what.
    same: Option<(f64, f32)>,
    /// Since when it is on, s.
    on_since_s: Option<f64>,
    /// The firm touch that is expected.
    touch: Option<Touch>,
    /// Mean expected load of the firm touches that it felt.
    felt_load: Option<f64>,
    /// Whether it has ever felt anything.
    felt_any: bool,
    /// Firm touches in a row that were not felt.
    misses: u32,
    drifted: bool,
    /// It fell from a healthy zero to the least that its board can read, and has stayed there.
    fallen: bool,
}

impl ChannelRecord {
    pub(super) fn new(id: &str, config: &StreamConfig) -> Self {
        Self {
            id: id.to_owned(),
            on_threshold: config.on_threshold,
            raw_min: config.raw_min,
            moments: VecDeque::new(),
            same: None,
            on_since_s: None,
            touch: None,
            felt_load: None,
            felt_any: false,
            misses: 0,
            drifted: false,
            fallen: false,
        }
    }

    /// Loads of another model are other loads; other objects are touched as firmly.
    pub(super) fn forget_loads(&mut self) {
        (self.felt_load, self.misses) = (None, 0);
    }

    pub(super) fn forget_expectations(&mut self) {
        self.touch = None;
        for moment in &mut self.moments {
            moment.expected = None;
        }
    }

    /// Its board says nothing, which the board's device tells.
    pub(super) fn silent(&mut self) {
        self.moments.clear();
        (self.same, self.on_since_s, self.touch) = (None, None, None);
    }

    pub(super) fn take_in(&mut self, moment: Moment) {
        let at_s = moment.at_s;
        if self.moments.back().is_some_and(|newest| newest.reference != moment.reference) {
            self.moments.clear();
            (self.drifted, self.touch) = (false, None);
        }
        if self.same.is_none_or(|(_, raw)| raw.to_bits() != moment.raw.to_bits()) {
            self.same = Some((at_s, moment.raw));
            let at_bottom = f64::from(moment.raw) <= self.raw_min;
            self.fallen = at_bottom && moment.reference - self.raw_min > self.on_threshold;
        }
        self.on_since_s = moment.active.then(|| self.on_since_s.unwrap_or(at_s));
        self.moments.push_back(moment);
        while self.moments.front().is_some_and(|first| first.at_s + WINDOW_S < at_s) {
            self.moments.pop_front();
        }
        if moment.active {
            self.misses = 0;
            self.felt_any = true;
        }
        self.follow_touch(at_s, moment.expected);
    }

    /// Counts the firm touches that were not felt.
    fn follow_touch(&mut self, at_s: f64, expected: Option<(bool, f64)>) {
        if let Some((true, load)) = expected
            && load >= FIRM
        {
            let touch = self.touch.get_or_insert(Touch { from_s: at_s, until_s: at_s, load });
            touch.until_s = at_s;
            touch.load = touch.load.max(load);
        }
        let Some(touch) = self.touch else { return };
        if at_s < touch.until_s + AFTER_S && at_s < touch.from_s + LONGEST_TOUCH_S {
            return;
        }
        self.touch = None;
        if self.felt(touch.from_s - BEFORE_S) {
            self.misses = 0;
            self.felt_any = true;
            let mean = self.felt_load.get_or_insert(touch.load);
            *mean += NEW_SHARE * (touch.load - *mean);
        } else if touch.until_s - touch.from_s >= SHORTEST_TOUCH_S {
            let counts = match self.felt_load {
                Some(felt_load) => touch.load >= felt_load,
                None => !self.felt_any,
            };
            self.misses += u32::from(counts);
        }
    }

    /// Whether anything at all was felt since `from_s`.
    fn felt(&self, from_s: f64) -> bool {
        let little = FELT_SHARE * self.on_threshold;
        let mut range = (f64::INFINITY, f64::NEG_INFINITY);
        for moment in self.moments.iter().filter(|moment| moment.at_s >= from_s) {
            let rise = moment.rise();
            range = (range.0.min(rise), range.1.max(rise));
            if moment.active || rise > little {
                return true;
            }
        }
        range.1 - range.0 > little
    }

    /// Whether the reading was not the same all the time lately.
    pub(super) fn changed_lately(&self, now_s: f64) -> bool {
        self.same.is_some_and(|(since_s, _)| now_s - since_s < WINDOW_S)
    }

    /// What is wrong with it and what to do, if anything is. `lively`: its neighbours' readings change; `expecting`:
    /// the simulator says what it should feel.
    pub(super) fn judge(
        &mut self,
        now_s: f64,
        lively: bool,
        expecting: bool,
    ) -> Option<(&'static str, String)> {
        let id = &self.id;
        if let Some((since_s, raw)) = self.same.filter(|_| lively && !self.changed_lately(now_s)) {
            let seconds = now_s - since_s;
            if f64::from(raw) > self.raw_min {
                return Some((
                    "stuck",
                    format!(
                        "{id} has read {raw} to the bit for {seconds:.0} s while its neighbours' readings change; check \
                         its wire and switch its board off and on"
                    ),
                ));
            }
            if self.fallen {
                return Some((
                    "dead",
                    format!(
                        "{id} fell from its zero to {raw}, the least that its board can read, {seconds:.0} s ago and \
                         stays there; check its wire"
                    ),
                ));
            }
        }
        let enough = if self.felt_any { MISSES } else { MISSES_FROM_START };
        if self.misses >= enough {
            return Some((
                "dead",
                format!(
                    "{id} did not feel any of the last {} firm touches that the simulator expects; check its wire and \
                     skin, and whether the object stands where it should",
                    self.misses
                ),
            ));
        }
        self.judge_quiet(now_s, expecting)
    }

    /// What the readings say while nothing touches the channel.
    fn judge_quiet(&mut self, now_s: f64, expecting: bool) -> Option<(&'static str, String)> {
        let first = self.moments.front()?;
        if now_s - first.at_s < 0.9 * WINDOW_S {
            return None;
        }
        let mut quiet: Vec<f64> =
            self.moments.iter().filter(|moment| !moment.is_expected()).map(Moment::rise).collect();
        // Hardly ever quiet: nothing can be said.
        if quiet.len() * 4 < self.moments.len() {
            return None;
        }
        quiet.sort_unstable_by(f64::total_cmp);
        let share = |share: f64| quiet[((quiet.len() - 1) as f64 * share) as usize];
        // Touch raises readings: the lowest are quiet, and what is below zero for most of the time is not touch.
        let (low, high) = (share(QUIET_SHARE), share(1.0 - QUIET_SHARE));
        let offset = low.max(0.0) + high.min(0.0);
        let limit = if self.drifted { BACK_SHARE } else { DRIFT_SHARE } * self.on_threshold;
        let on_s = self.on_since_s.map_or(0.0, |since_s| now_s - since_s);
        let untouched = !self.moments.iter().any(Moment::is_expected);
        let id = &self.id;
        if !self.drifted && on_s >= 0.9 * WINDOW_S {
            // It came here at once, or it wandered.
            if self.wanders() {
                self.drifted = true;
            } else if untouched && (if expecting { on_s >= WINDOW_S } else { on_s >= ALWAYS_S }) {
                let what = match expecting {
                    true => "though the simulator expects no touch",
                    false => "though no object is known to be in place",
                };
                return Some((
                    "stuck",
                    format!(
                        "{id} has been on for {on_s:.0} s {what}; let go of the hand and tare, and if that does not help \
                         check its wire and what presses on it"
                    ),
                ));
            }
        } else {
            let num_on = self.moments.iter().filter(|moment| moment.active).count();
            let mostly_on = num_on * 2 > self.moments.len();
            self.drifted = offset.abs() > limit && (self.drifted || !mostly_on);
        }
        self.drifted.then(|| {
            let percent = 100.0 * offset / self.on_threshold;
            (
                "drifted",
                format!(
                    "{id} is off its zero by {percent:+.0} % of what a touch takes while nothing touches it; let go of \
                     the hand and tare"
                ),
            )
        })
    }

    /// Whether the reading goes one way all through the window, by a good part of a touch.
    fn wanders(&self) -> bool {
        let mean = |from: usize, until: usize| {
            let part = self.moments.range(from..until);
            part.map(Moment::rise).sum::<f64>() / (until - from).max(1) as f64
        };
        let third = self.moments.len() / 3;
        let (early, middle, late) = (mean(0, third), mean(third, 2 * third), mean(2 * third, 3 * third));
        let step = 0.5 * FELT_SHARE * self.on_threshold;
        middle - early > step && late - middle > step
    }
}
