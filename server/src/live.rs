//! Runs the emulated station in real time and publishes what it feels.

use std::{
    collections::VecDeque,
    path::Path,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

use palpate_emulator::{LiveSample, LiveStation};
use palpate_robot_model::Station;
use palpate_wire::{bits, proto::LiveFrame};

use crate::{Error, Hub};

/// Time between published frames: 30 Hz at most.
const FRAME_PERIOD: Duration = Duration::from_micros(33_334);

/// The live station; it stops when this is dropped.
pub struct LiveFeed {
    station: Station,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl LiveFeed {
    /// Starts the station of the truth file at `truth_path` and publishes its state to `hub`.
    pub fn start(truth_path: &Path, seed: u64, hub: Arc<Hub>) -> Result<Self, Error> {
        let mut live = LiveStation::new(truth_path, seed)?;
        let station = live.station().clone();
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = stop.clone();
        let thread = thread::Builder::new()
            .name("live-station".to_owned())
            .spawn(move || run(&mut live, &hub, &stopped))
            .map_err(|err| Error::Internal(format!("failed to start the live station: {err}")))?;
        Ok(Self { station, stop, thread: Some(thread) })
    }

    /// The station.
    pub fn station(&self) -> &Station {
        &self.station
    }
}

impl Drop for LiveFeed {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            tracing::error!("the live station's thread panicked");
        }
    }
}

fn run(live: &mut LiveStation, hub: &Hub, stop: &AtomicBool) {
    let mut rates = Rates::default();
    let start = Instant::now();
    let mut last = start;
    while !stop.load(Ordering::Relaxed) {
        thread::sleep(FRAME_PERIOD);
        let now = Instant::now();
        // After a pause of the whole machine the station goes on from where it was.
        let dt_secs = (now - last).as_secs_f64().min(1.0);
        last = now;
        let sample = live.advance(dt_secs);
        let rates_hz = rates.update((now - start).as_secs_f64(), &sample.samples);
        hub.publish_live(live_frame(sample, rates_hz));
    }
}

fn live_frame(sample: LiveSample, rates_hz: Vec<f32>) -> LiveFrame {
    let (object, object_pose) = match sample.object {
        Some((object, pose)) => {
            let (position, rotation) = (pose.translation.vector, pose.rotation);
            let pose =
                [position.x, position.y, position.z, rotation.w, rotation.i, rotation.j, rotation.k].to_vec();
            (object, pose)
        }
        None => (String::new(), Vec::new()),
    };
    LiveFrame {
        time_s: sample.time_s,
        joint_positions: sample.positions.iter().map(|&position| position as f32).collect(),
        active: bits::pack(sample.active),
        raw: sample.raw,
        activity: sample.activity,
        object,
        object_pose,
        rates_hz,
    }
}

/// Rates over the last second, from counts of samples.
#[derive(Debug, Default)]
struct Rates {
    /// `(time in s, counts)`, oldest first, of a little more than a second.
    history: VecDeque<(f64, Vec<u64>)>,
}

impl Rates {
    fn update(&mut self, time_s: f64, counts: &[u64]) -> Vec<f32> {
        self.history.push_back((time_s, counts.to_vec()));
        while self.history.get(1).is_some_and(|(second_s, _)| time_s - second_s >= 1.0) {
            self.history.pop_front();
        }
        match self.history.front() {
            Some((oldest_s, oldest)) if time_s > *oldest_s => counts
                .iter()
                .zip(oldest)
                .map(|(newest, oldest)| (newest.saturating_sub(*oldest) as f64 / (time_s - oldest_s)) as f32)
                .collect(),
            _ => vec![0.0; counts.len()],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rates_are_those_of_the_last_second() {
        let mut rates = Rates::default();
        assert_eq!(rates.update(0.0, &[0, 0]), [0.0, 0.0]);
        let mut newest = Vec::new();
        for step in 1..=40_u64 {
            // 100 Hz and 40 Hz, then the second stream stops after a second.
            newest = rates.update(step as f64 * 0.05, &[step * 5, step.min(20) * 2]);
            if step == 20 {
                assert!((newest[0] - 100.0).abs() < 1e-3 && (newest[1] - 40.0).abs() < 1e-3, "{newest:?}");
            }
        }
        assert!((newest[0] - 100.0).abs() < 1e-3 && newest[1] == 0.0, "{newest:?}");
    }
}
