//! References that are taken anew during a take.

/// From some time on, readings count from what they were then.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tare {
    /// From when on they count from it, s since the take's start.
    pub from_s: f64,
    /// When they were so in the mean, s since the take's start.
    pub taken_s: f64,
}

impl Tare {
    /// The newest of `tares`, by time, at `time_s`; `None` before the first.
    pub fn newest(tares: &[Self], time_s: f64) -> Option<Self> {
        tares.partition_point(|tare| tare.from_s <= time_s).checked_sub(1).map(|newest| tares[newest])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tare_counts_until_the_next() {
        let tares = [Tare { from_s: 1.0, taken_s: 1.5 }, Tare { from_s: 4.0, taken_s: 4.5 }];
        let taken_s = |time_s| Tare::newest(&tares, time_s).map(|tare| tare.taken_s);
        assert_eq!(
            [0.9, 1.0, 3.9, 4.0, 9.0].map(taken_s),
            [None, Some(1.5), Some(1.5), Some(4.5), Some(4.5)]
        );
    }
}
