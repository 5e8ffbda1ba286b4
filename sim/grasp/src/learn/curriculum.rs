//! How wide the region is that objects start in.

use serde::{Deserialize, Serialize};

use super::StartConfig;

/// Widens the region when enough episodes in a row of windows succeed; it never narrows. Plain data, so that a training
/// that is resumed goes on where it was.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
pub struct Curriculum {
    /// Half the edge length, m.
    pub half_width_m: f64,
    /// Episodes of the window so far.
    pub episodes: usize,
    /// Of them won.
    pub successes: usize,
}

impl Curriculum {
    /// At its beginning.
    pub fn new(config: &StartConfig) -> Self {
        Self { half_width_m: config.half_width_m[0], episodes: 0, successes: 0 }
    }

    /// Counts an episode that ended, and widens the region when a window is full and good enough.
    pub fn count(&mut self, config: &StartConfig, success: bool) {
        self.episodes += 1;
        self.successes += usize::from(success);
        if self.episodes < config.window {
            return;
        }
        if self.successes as f64 >= config.widen_at * self.episodes as f64 {
            self.half_width_m = (self.half_width_m + config.widen_m).min(config.half_width_m[1]);
        }
        (self.episodes, self.successes) = (0, 0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_region_widens_after_good_windows_only_and_stops_at_its_last_width() {
        let config = StartConfig {
            half_width_m: [0.02, 0.03],
            widen_m: 0.006,
            widen_at: 0.75,
            window: 4,
            any_orientation: false,
        };
        let mut curriculum = Curriculum::new(&config);
        let mut window = |successes: usize| {
            (0..4).for_each(|episode| curriculum.count(&config, episode < successes));
            curriculum.half_width_m
        };
        assert_eq!(window(2), 0.02);
        assert!((window(3) - 0.026).abs() < 1e-12);
        assert!((window(0) - 0.026).abs() < 1e-12);
        assert_eq!(window(4), 0.03);
        assert_eq!(window(4), 0.03);
    }
}
