//! What firmware would have made of readings.

use palpate_robot_model::StreamConfig;

use crate::StreamLog;

/// Firmware's rule: on above `on_threshold` over the reference, off again below `off_threshold`, else as before.
///
/// `log` has readings of `num_channels` channels, and their references.
pub(super) fn activations(config: &StreamConfig, log: &StreamLog, num_channels: usize) -> Vec<bool> {
    let mut state = vec![false; num_channels];
    let mut active = Vec::with_capacity(log.raw.len());
    for (&time_s, readings) in log.times_s.iter().zip(log.raw.chunks_exact(num_channels.max(1))) {
        let reference = log.reference_at(time_s);
        for ((state, &reading), &reference) in state.iter_mut().zip(readings).zip(reference) {
            let excess = f64::from(reading) - f64::from(reference);
            if excess > config.on_threshold {
                *state = true;
            } else if excess < config.off_threshold || config.off_threshold >= config.on_threshold {
                *state = false;
            }
            active.push(*state);
        }
    }
    active
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Reference;

    fn config(on_threshold: f64, off_threshold: f64) -> StreamConfig {
        StreamConfig { stream: "pad".to_owned(), on_threshold, off_threshold, raw_min: 0.0, raw_max: 4095.0 }
    }

    /// Samples a second apart that count from `reference`.
    fn log(raw: &[f32], reference: &[f32]) -> StreamLog {
        let times_s = (0..raw.len() / reference.len()).map(|sample| sample as f64).collect();
        StreamLog { times_s, raw: raw.to_vec(), reference: reference.to_vec(), ..StreamLog::default() }
    }

    #[test]
    fn a_channel_stays_on_between_the_two_thresholds() {
        // Two channels, the second rests at 100.
        let raw = [0.0, 100.0, 21.0, 115.0, 15.0, 121.0, 9.0, 115.0, 15.0, 109.0_f32];
        let active = activations(&config(20.0, 10.0), &log(&raw, &[0.0, 100.0]), 2);
        assert_eq!(active, [false, false, true, false, true, true, false, true, false, false]);
    }

    #[test]
    fn without_hysteresis_only_the_reading_counts() {
        let raw = [20.0, 20.5, 20.0, 19.0, 30.0_f32];
        assert_eq!(
            activations(&config(20.0, 20.0), &log(&raw, &[0.0]), 1),
            [false, true, false, false, true]
        );
    }

    #[test]
    fn readings_count_from_the_newest_reference() {
        let raw = [0.0, 30.0, 30.0, 30.0, 55.0, 5.0_f32];
        let mut log = log(&raw, &[0.0]);
        log.later_references.push(Reference { from_s: 2.0, readings: vec![30.0] });
        log.later_references.push(Reference { from_s: 5.0, readings: vec![5.0] });
        assert_eq!(activations(&config(20.0, 10.0), &log, 1), [false, true, false, false, true, false]);
    }
}
