//! Contacts as run lengths: found once per take, cut down to pixels in every frame.

/// A span of contact, s: from `start_s` up to, not including, `end_s`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Event {
    /// When it began.
    pub start_s: f64,
    /// When it was over.
    pub end_s: f64,
}

/// A real contact and the simulated one that stands for it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OnsetPair {
    /// Real onset, s.
    pub real_s: f64,
    /// Simulated onset, s.
    pub simulated_s: f64,
}

/// Runs of `true` in `active`, which holds one value per time of `times_s`. A run lasts until the first sample that is
/// off again, the last one until `end_s`.
pub fn runs(times_s: &[f64], end_s: f64, active: impl IntoIterator<Item = bool>) -> Vec<Event> {
    let mut events = Vec::new();
    let mut start_s = None;
    for (&time_s, on) in times_s.iter().zip(active) {
        match (start_s, on) {
            (None, true) => start_s = Some(time_s),
            (Some(begun_s), false) => {
                events.push(Event { start_s: begun_s, end_s: time_s });
                start_s = None;
            }
            _ => {}
        }
    }
    if let Some(start_s) = start_s {
        events.push(Event { start_s, end_s: end_s.max(start_s) });
    }
    events
}

/// A stretch of pixels, `x0 < x1`, counted from the left edge of the view.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PixelSpan {
    /// First pixel.
    pub x0: u32,
    /// One past the last pixel.
    pub x1: u32,
}

/// The pixels of a view from `view_s[0]` to `view_s[1]`, `width_px` wide, that `events` (in order, disjoint) touch.
/// Spans come in order and do not touch, so there are never more than half as many as pixels, however many events there
/// are; the time taken grows with the pixels and the logarithm of the events.
pub fn decimate(events: &[Event], view_s: [f64; 2], width_px: u32) -> Vec<PixelSpan> {
    let [from_s, to_s] = view_s;
    let pixels_per_s = f64::from(width_px) / (to_s - from_s);
    let mut spans: Vec<PixelSpan> = Vec::new();
    if !(pixels_per_s.is_finite() && pixels_per_s > 0.0) {
        return spans;
    }
    let mut rest = &events[events.partition_point(|event| event.end_s < from_s)..];
    while let Some(event) = rest.first() {
        if event.start_s >= to_s {
            break;
        }
        let x0 = ((event.start_s - from_s) * pixels_per_s).floor().max(0.0) as u32;
        let x1 = ((event.end_s - from_s) * pixels_per_s).ceil() as u32;
        let x0 = x0.min(width_px - 1);
        let x1 = x1.clamp(x0 + 1, width_px.max(x0 + 1));
        match spans.last_mut() {
            Some(last) if x0 <= last.x1 => last.x1 = last.x1.max(x1),
            _ => spans.push(PixelSpan { x0, x1 }),
        }
        // What ends within the pixels that are painted already adds nothing.
        let painted_to_s = from_s + f64::from(x1) / pixels_per_s;
        rest = &rest[1..];
        rest = &rest[rest.partition_point(|event| event.end_s <= painted_to_s)..];
    }
    spans
}

/// Which simulated contact stands for which real one, for the arrows: in order, each at most once, those whose onsets
/// are nearest, and no farther apart than `reach_s`. A picture's rule, not the metric's.
pub fn pair_onsets(real: &[Event], simulated: &[Event], reach_s: f64) -> Vec<OnsetPair> {
    let mut pairs: Vec<OnsetPair> = Vec::new();
    let mut next_idx = 0;
    for (real_idx, event) in real.iter().enumerate() {
        let candidate = simulated[next_idx..]
            .iter()
            .enumerate()
            .map(|(offset, candidate)| (next_idx + offset, (candidate.start_s - event.start_s).abs()))
            .take_while(|(idx, _)| simulated[*idx].start_s <= event.start_s + reach_s)
            .min_by(|a, b| a.1.total_cmp(&b.1));
        let Some((idx, distance_s)) = candidate else { continue };
        let nearer_to_next = real
            .get(real_idx + 1)
            .is_some_and(|next| (next.start_s - simulated[idx].start_s).abs() < distance_s);
        if distance_s <= reach_s && !nearer_to_next {
            pairs.push(OnsetPair { real_s: event.start_s, simulated_s: simulated[idx].start_s });
            next_idx = idx + 1;
        }
    }
    pairs
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn event(start_s: f64, end_s: f64) -> Event {
        Event { start_s, end_s }
    }

    #[test]
    fn run_lasts_until_the_first_sample_that_is_off() {
        let times_s = [0.0, 0.1, 0.2, 0.3, 0.4];
        let found = runs(&times_s, 0.5, [true, false, true, true, true]);
        assert_eq!(found, [event(0.0, 0.1), event(0.2, 0.5)]);
        assert!(runs(&[], 0.0, []).is_empty());
    }

    #[test]
    fn shorter_than_a_pixel_is_still_seen() {
        let found = decimate(&[event(5.0001, 5.0002)], [0.0, 10.0], 100);
        assert_eq!(found, [PixelSpan { x0: 50, x1: 51 }]);
    }

    #[test]
    fn onsets_pair_in_order_and_within_reach() {
        let real = [event(1.0, 2.0), event(5.0, 6.0), event(9.0, 9.5)];
        let simulated = [event(1.2, 1.9), event(4.9, 6.0), event(5.1, 5.2)];
        let pairs = pair_onsets(&real, &simulated, 1.0);
        assert_eq!(pairs.len(), 2);
        assert_eq!(pairs[0], OnsetPair { real_s: 1.0, simulated_s: 1.2 });
        assert!((pairs[1].simulated_s - 5.0).abs() < 0.11);
    }

    fn events() -> impl Strategy<Value = Vec<Event>> {
        proptest::collection::vec((0.001_f64..0.5, 0.001_f64..0.5), 0..200).prop_map(|steps| {
            let mut time_s = 0.0;
            steps
                .into_iter()
                .map(|(gap_s, length_s)| {
                    let start_s = time_s + gap_s;
                    time_s = start_s + length_s;
                    event(start_s, time_s)
                })
                .collect()
        })
    }

    proptest! {
        #[test]
        fn decimation_paints_every_touched_pixel_and_no_other(
            events in events(), from_s in -5.0_f64..60.0, span_s in 0.01_f64..120.0, width_px in 1_u32..400,
        ) {
            let view_s = [from_s, from_s + span_s];
            let spans = decimate(&events, view_s, width_px);
            prop_assert!(spans.windows(2).all(|pair| pair[0].x1 < pair[1].x0));
            prop_assert!(spans.iter().all(|span| span.x0 < span.x1 && span.x1 <= width_px));
            let painted = |x: u32| spans.iter().any(|span| (span.x0..span.x1).contains(&x));
            let px_s = span_s / f64::from(width_px);
            for x in 0..width_px {
                // A hundredth of a pixel either way: rounding may decide who owns an edge.
                let (left_s, right_s) = (from_s + f64::from(x) * px_s, from_s + f64::from(x + 1) * px_s);
                let slack_s = px_s * 0.01;
                let inside = events.iter().any(|event| {
                    event.start_s < right_s - slack_s && event.end_s > left_s + slack_s
                });
                let near = events.iter().any(|event| {
                    event.start_s < right_s + slack_s && event.end_s > left_s - slack_s
                });
                prop_assert!(!inside || painted(x), "pixel {} is touched and not painted", x);
                prop_assert!(near || !painted(x), "pixel {} is painted and not touched", x);
            }
        }

        #[test]
        fn runs_say_the_same_as_the_samples(active in proptest::collection::vec(any::<bool>(), 0..60)) {
            let times_s: Vec<f64> = (0..active.len()).map(|idx| idx as f64 * 0.1).collect();
            let end_s = active.len() as f64 * 0.1;
            let found = runs(&times_s, end_s, active.iter().copied());
            for (time_s, on) in times_s.iter().zip(&active) {
                let covered = found.iter().any(|event| event.start_s <= *time_s && *time_s < event.end_s);
                prop_assert_eq!(covered, *on);
            }
        }

        #[test]
        fn pairs_use_each_contact_once(real in events(), simulated in events()) {
            let pairs = pair_onsets(&real, &simulated, 0.6);
            prop_assert!(pairs.windows(2).all(|two| two[0].real_s < two[1].real_s
                && two[0].simulated_s < two[1].simulated_s));
            prop_assert!(pairs.iter().all(|pair| (pair.real_s - pair.simulated_s).abs() <= 0.6));
        }
    }
}
