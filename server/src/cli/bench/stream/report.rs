//! What the bench found, and whether it is what is wanted.

use std::{collections::BTreeMap, fmt::Write as _};

use palpate_control::LOOP_HZ;
use serde::Serialize;

use super::{
    traffic::RecordedStream,
    watcher::{Pace, Watched},
};

/// Of the turns that are meant, the share that counts as keeping the rate: over all of it, and in the worst second.
const MEAN_SHARE: f64 = 0.99;
const WORST_SHARE: f64 = 0.95;
/// What a client that reads twice a second may see, s: its own pause, what waits in its queue, and the ways.
const MOST_AGE_S: f64 = 1.0;

/// Everything that was measured.
#[derive(Debug, Default, Serialize)]
pub(super) struct StreamBenchReport {
    /// For how long was measured, s.
    pub(super) seconds: f64,
    /// What is wanted, and whether it was so.
    pub(super) goals: Vec<Goal>,
    pub(super) control_loop: ControlLoop,
    /// From a device's byte to the published message, ms: the newest, the median, the 95th percentile, the most.
    pub(super) latency_ms: [f64; 4],
    /// From publishing to a client, ms above the fastest delivery: median, 95th percentile, most.
    pub(super) delivery_above_fastest_ms: [f64; 3],
    /// Takes that were written; the last one is cut off by the end of the measurement.
    pub(super) takes: usize,
    /// What they hold, by stream.
    pub(super) recorded: BTreeMap<String, RecordedStream>,
    /// Samples that the recorder could not keep, by its own count.
    pub(super) lost_samples: u64,
    /// What the operator was refused while recording, and got over.
    pub(super) problems: Vec<String>,
    /// One for each client; the last one reads slowly.
    pub(super) clients: Vec<ClientReport>,
    /// Cores that this process used, the emulated hardware and the clients included, and how many there are.
    pub(super) cores_used: f64,
    pub(super) cores: usize,
    /// By the names of threads, those that used a hundredth of a core and more.
    pub(super) cores_by_thread: BTreeMap<String, f64>,
    /// Load of the machine before and after, processes that want to run: above `cores`, somebody waits.
    pub(super) load_average: [f64; 2],
}

/// One thing that is wanted of a loaded station.
#[derive(Debug, Serialize)]
pub(super) struct Goal {
    pub(super) wanted: &'static str,
    pub(super) met: bool,
    pub(super) found: String,
}

/// Turns of the control loop, Hz.
#[derive(Debug, Default, Serialize)]
pub(super) struct ControlLoop {
    pub(super) target_hz: f64,
    /// Over the last second, on average over all of it, and over the worst second.
    pub(super) last_hz: f64,
    pub(super) mean_hz: f64,
    pub(super) worst_hz: f64,
}

/// What one client saw.
#[derive(Debug, Default, Serialize)]
pub(super) struct ClientReport {
    pub(super) slow: bool,
    /// Frames that came, and those that it was told it lost.
    pub(super) frames: u64,
    pub(super) dropped: u64,
    /// Frames that were published between its first and its last one, by what the first client saw.
    pub(super) published: u64,
    /// How old a frame was when it was read, s above the fastest delivery: median and most.
    pub(super) age_s: [f64; 2],
}

impl ClientReport {
    /// Whether what came and what it was told of is all there was. A frame may be dropped while the last one is on its way.
    fn accounts_for_all(&self) -> bool {
        self.published == self.frames + self.dropped
    }
}

impl ControlLoop {
    pub(super) fn of(first: &Watched) -> Self {
        let hz = &first.loop_hz;
        Self {
            target_hz: LOOP_HZ,
            last_hz: hz.last().copied().unwrap_or(0.0),
            mean_hz: hz.iter().sum::<f64>() / hz.len().max(1) as f64,
            worst_hz: hz.iter().copied().reduce(f64::min).unwrap_or(0.0),
        }
    }
}

/// What each of `watched` saw. What was published is what any of them saw.
pub(super) fn clients(watched: &[(Pace, Watched)]) -> Vec<ClientReport> {
    let fastest =
        watched.iter().flat_map(|(_, client)| &client.delays_s).copied().fold(f64::INFINITY, f64::min);
    let mut all: Vec<f64> = watched.iter().flat_map(|(_, client)| &client.made_s).copied().collect();
    all.sort_unstable_by(f64::total_cmp);
    all.dedup();
    let of = |(pace, client): &(Pace, Watched)| {
        let ages: Vec<f64> = client.delays_s.iter().map(|delay_s| delay_s - fastest).collect();
        let published = match client.made_s.as_slice() {
            [] => 0,
            [first, ..] => {
                let last = client.made_s.last().unwrap_or(first);
                all.iter().filter(|made_s| (first..=last).contains(made_s)).count() as u64
            }
        };
        ClientReport {
            slow: *pace == Pace::Slow,
            frames: client.made_s.len() as u64,
            dropped: client.dropped,
            published,
            age_s: [quantile(&ages, 0.5), quantile(&ages, 1.0)],
        }
    };
    watched.iter().map(of).collect()
}

impl StreamBenchReport {
    /// Compares what was found with what is wanted.
    pub(super) fn judge(&mut self) {
        let turns = &self.control_loop;
        let kept =
            turns.mean_hz >= MEAN_SHARE * turns.target_hz && turns.worst_hz >= WORST_SHARE * turns.target_hz;
        let sent = self.recorded.values().filter_map(|stream| Some((stream.sent?, stream.samples)));
        let (sent, samples) = sent.fold((0, 0), |(sent, samples), (s, r)| (sent + s, samples + r));
        // Which sample was the first and the last of a take is known to one.
        let edges = self.takes * self.recorded.len();
        // Boards of one stream that report apart make a sample more, so that more is none too few.
        let complete = samples > 0 && sent <= samples + edges;
        let (slow, fast): (Vec<_>, Vec<_>) = self.clients.iter().partition(|client| client.slow);
        let undisturbed = fast.iter().all(|client| client.dropped == 0 && client.accounts_for_all());
        let slow_dropped = slow.iter().map(|client| client.dropped).sum::<u64>();
        let informed = slow.iter().all(|client| client.dropped > 0 && client.accounts_for_all());
        let oldest_s = slow.iter().map(|client| client.age_s[1]).fold(0.0, f64::max);
        self.goals = vec![
            Goal {
                wanted: "the control loop keeps its rate",
                met: kept,
                found: format!(
                    "{:.1} Hz on average, {:.1} Hz in the worst second, of {}",
                    turns.mean_hz, turns.worst_hz, turns.target_hz
                ),
            },
            Goal {
                wanted: "the recorder loses no sample",
                met: self.lost_samples == 0 && complete,
                found: format!(
                    "{} lost by its own count; {samples} tactile samples recorded of {sent} sent (known to {edges})",
                    self.lost_samples
                ),
            },
            Goal {
                wanted: "a slow client costs the others nothing",
                met: undisturbed,
                found: format!(
                    "{} clients, {} frames dropped",
                    fast.len(),
                    fast.iter().map(|client| client.dropped).sum::<u64>()
                ),
            },
            Goal {
                wanted: "a slow client hears what it lost",
                met: informed,
                found: format!(
                    "{} frames came, {slow_dropped} were counted as dropped, {} were published",
                    slow.iter().map(|client| client.frames).sum::<u64>(),
                    slow.iter().map(|client| client.published).sum::<u64>()
                ),
            },
            Goal {
                wanted: "a slow client sees no old picture",
                met: oldest_s < MOST_AGE_S,
                found: format!("{oldest_s:.2} s at most"),
            },
        ];
    }

    /// The report as a page of text.
    pub(super) fn to_text(&self) -> String {
        let mut text = String::new();
        let mut line = |words: String| {
            let _ = writeln!(text, "{words}");
        };
        line(format!("measured for {:.0} s with {} clients", self.seconds, self.clients.len()));
        for goal in &self.goals {
            line(format!(
                "  {}  {}: {}",
                if goal.met { "met   " } else { "MISSED" },
                goal.wanted,
                goal.found
            ));
        }
        let [_, median, p95, most] = self.latency_ms;
        line(format!(
            "device byte to published message: median {median:.1} ms, 95 % {p95:.1} ms, most {most:.1} ms"
        ));
        let [median, p95, most] = self.delivery_above_fastest_ms;
        line(format!(
            "publishing to client, above the fastest: median {median:.1} ms, 95 % {p95:.1} ms, most {most:.1} ms"
        ));
        line(format!("{} takes:", self.takes));
        for (id, stream) in &self.recorded {
            let sent = stream.sent.map_or(String::new(), |sent| format!(" of {sent} sent"));
            line(format!(
                "  {id}: {} samples recorded{sent}, {:.1} Hz, longest gap {:.0} ms",
                stream.samples, stream.rate_hz, stream.longest_gap_ms
            ));
        }
        line("client    frames  dropped  published  median age, s  most, s".to_owned());
        for (number, client) in self.clients.iter().enumerate() {
            let ClientReport { slow, frames, dropped, published, age_s: [median, most] } = client;
            let slow = if *slow { "slow" } else { "" };
            line(format!(
                "{number:>3} {slow:4} {frames:>7} {dropped:>8} {published:>10} {median:>14.3} {most:>8.3}"
            ));
        }
        for problem in &self.problems {
            line(format!("the operator was refused: {problem}"));
        }
        let [before, after] = self.load_average;
        line(format!(
            "{:.2} of {} cores used by this process; load average of the machine {before:.1} before, {after:.1} after",
            self.cores_used, self.cores
        ));
        for (name, used) in &self.cores_by_thread {
            line(format!("  {name}: {used:.2}"));
        }
        text
    }
}

/// The value that `share` of all are at most; 0 without any.
pub(in super::super) fn quantile(values: &[f64], share: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_unstable_by(f64::total_cmp);
    let idx = (share * sorted.len().saturating_sub(1) as f64).round() as usize;
    sorted.get(idx).copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn watched(made_s: &[f64], late_s: f64, dropped: u64) -> Watched {
        Watched {
            made_s: made_s.to_vec(),
            delays_s: made_s.iter().map(|_| 5.0 + late_s).collect(),
            dropped,
            loop_hz: vec![LOOP_HZ; made_s.len()],
            ..Watched::default()
        }
    }

    fn report(slow: Watched) -> StreamBenchReport {
        let fast = watched(&[0.0, 0.1, 0.2, 0.3, 0.4, 0.5], 0.0, 0);
        let stream = RecordedStream { samples: 100, sent: Some(100), rate_hz: 100.0, longest_gap_ms: 11.0 };
        let mut report = StreamBenchReport {
            control_loop: ControlLoop::of(&fast),
            clients: clients(&[(Pace::AsItComes, fast), (Pace::Slow, slow)]),
            takes: 1,
            recorded: BTreeMap::from([("fsr".to_owned(), stream)]),
            ..StreamBenchReport::default()
        };
        report.judge();
        report
    }

    fn missed(report: &StreamBenchReport) -> Vec<&str> {
        report.goals.iter().filter(|goal| !goal.met).map(|goal| goal.wanted).collect()
    }

    #[test]
    fn what_is_wanted_is_met_and_missed() {
        let mut good = report(watched(&[0.1, 0.4], 0.3, 2));
        assert_eq!(missed(&good), Vec::<&str>::new(), "{:?}", good.goals);
        assert_eq!(missed(&report(watched(&[0.1, 0.4], 0.3, 1))), ["a slow client hears what it lost"]);
        assert_eq!(missed(&report(watched(&[0.1, 0.4], 80.0, 2))), ["a slow client sees no old picture"]);
        good.recorded.values_mut().for_each(|stream| stream.samples = 98);
        good.control_loop.worst_hz = 150.0;
        good.clients[0].dropped = 1;
        good.judge();
        assert_eq!(missed(&good).len(), 3, "{:?}", good.goals);
        assert!(
            good.to_text().contains("MISSED  the recorder loses no sample: 0 lost"),
            "{}",
            good.to_text()
        );
    }

    #[test]
    fn quantiles_are_of_the_sorted_values() {
        let values = [5.0, 1.0, 3.0, 2.0, 4.0];
        assert_eq!([0.0, 0.5, 1.0].map(|share| quantile(&values, share)), [1.0, 3.0, 5.0]);
        assert_eq!(quantile(&[], 0.5), 0.0);
    }
}
