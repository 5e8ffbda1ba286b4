//! The flat map: palm and fingers unrolled, for people who read maps faster than 3-D.

use egui::{Align2, Color32, FontId, Pos2, Rect, Sense, Stroke, StrokeKind, Vec2, accesskit::Role};
use palpate_robot_model::Station;

use super::signal::{Sample, Signal, kind_of};
use crate::{playback::Playback, screens::capitalised, theme::Palette};

/// Room at the sides, and above and below, where the names of groups stand.
const MARGIN: Vec2 = Vec2::new(20.0, 34.0);
/// Crowded patches are drawn up to this much larger than to scale, so that each taxel can be seen and hit.
const MOST_GROWTH: f64 = 2.4;

/// What the map shows.
pub(super) struct FlatMap<'a> {
    /// Its layout is drawn.
    pub station: &'a Station,
    /// One for each channel.
    pub samples: &'a [Sample],
    /// What really happened, where `samples` are simulated: mismatches are marked.
    pub real: Option<&'a [Sample]>,
    /// Whose touch `samples` are.
    pub signal: Signal,
    /// Colour of each.
    pub colors: &'a [Color32],
    /// How they are called for screen readers and tests.
    pub name: &'a dyn Fn(usize) -> String,
}

/// Where the map's units are on the screen.
struct Projection {
    rect: Rect,
    low: [f64; 2],
    high: [f64; 2],
    scale: f32,
}

impl Projection {
    fn fit(positions: impl Iterator<Item = [f64; 2]>, rect: Rect) -> Option<Self> {
        let (low, high) = positions.fold(None, |bounds: Option<([f64; 2], [f64; 2])>, [x, y]| {
            let (low, high) = bounds.unwrap_or(([x, y], [x, y]));
            Some(([low[0].min(x), low[1].min(y)], [high[0].max(x), high[1].max(y)]))
        })?;
        let room = rect.shrink2(MARGIN);
        let share = |room: f32, size: f64| if size > 1e-9 { room / size as f32 } else { f32::INFINITY };
        let scale = share(room.width(), high[0] - low[0]).min(share(room.height(), high[1] - low[1]));
        let scale = if scale.is_finite() { scale.max(0.0) } else { 1.0 };
        Some(Self { rect, low, high, scale })
    }

    /// Right is right, up is up.
    fn to_screen(&self, [x, y]: [f64; 2]) -> Pos2 {
        let middle = |axis: usize| (self.low[axis] + self.high[axis]) / 2.0;
        self.rect.center() + Vec2::new((x - middle(0)) as f32, -(y - middle(1)) as f32) * self.scale
    }
}

/// Draws the map into all of `rect`. Pointing at a taxel and clicking it go into `playback`.
pub(super) fn flat_map_ui(
    ui: &mut egui::Ui,
    rect: Rect,
    map: &FlatMap<'_>,
    playback: &mut Playback,
    palette: &Palette,
) {
    let layout = &map.station.layout;
    let painter = ui.painter_at(rect);
    painter.rect(rect, 6.0, palette.surface, Stroke::new(1.0, palette.line), StrokeKind::Inside);
    let grown =
        grown_patches(&layout.patches.iter().map(|patch| patch.map_positions.as_slice()).collect::<Vec<_>>());
    let Some(projection) = Projection::fit(grown.iter().copied(), rect) else { return };
    let places: Vec<Pos2> = grown.into_iter().map(|position| projection.to_screen(position)).collect();
    let radius = marker_radius(&places);

    let outlines = patch_outlines(map.station, &places, radius);
    for outline in &outlines {
        painter.rect(
            *outline,
            radius * 0.8,
            palette.background,
            Stroke::new(1.0, palette.line),
            StrokeKind::Outside,
        );
    }
    group_names(&painter, map.station, &outlines, palette);

    for (channel, (&place, sample)) in places.iter().zip(map.samples).enumerate() {
        let target = Rect::from_center_size(place, Vec2::splat(radius * 2.0 + 2.0));
        let id = ui.scope_id().with(("taxel", channel));
        let response = ui.interact(target, id, Sense::click());
        if response.hovered() || response.has_focus() {
            playback.hovered = Some(channel);
        }
        if response.clicked() {
            let only_select = ui.input(|input| input.modifiers.command);
            click(playback, channel, only_select);
        }
        let marked = playback.highlighted() == Some(channel);
        let chosen = playback.pinned == Some(channel) || playback.selected.contains(&channel);
        let name = (map.name)(channel);
        response.widget_info(|| egui::WidgetInfo::selected(Role::Button, true, chosen, name.clone()));
        let real = map.real.and_then(|real| real.get(channel));
        let color = map.colors.get(channel).copied().unwrap_or(palette.dead);
        taxel_shape(&painter, place, radius, [Some(sample), real], color, map.signal, palette);
        if chosen || marked {
            let width = if marked { 3.0 } else { 2.0 };
            painter.circle_stroke(place, radius + 3.0, Stroke::new(width, palette.calibrated));
        }
        if response.has_focus() {
            painter.rect_stroke(target.expand(4.0), 3.0, Stroke::new(2.0, palette.real), StrokeKind::Outside);
        }
    }
}

/// Positions of all taxels, each patch grown about its middle as far as its neighbours leave room.
fn grown_patches(patches: &[&[[f64; 2]]]) -> Vec<[f64; 2]> {
    type Span = [[f64; 2]; 2];
    let around = |positions: &[[f64; 2]]| -> Span {
        positions.iter().fold([[f64::INFINITY; 2], [f64::NEG_INFINITY; 2]], |[low, high], [x, y]| {
            [[low[0].min(*x), low[1].min(*y)], [high[0].max(*x), high[1].max(*y)]]
        })
    };
    let all = around(&patches.concat());
    let padding = 0.03 * (all[1][0] - all[0][0]).max(all[1][1] - all[0][1]);
    let apart = |a: &Span, b: &Span| {
        (0..2).any(|axis| a[1][axis] + 2.0 * padding < b[0][axis] || b[1][axis] + 2.0 * padding < a[0][axis])
    };
    let mut spans: Vec<Span> = patches.iter().map(|positions| around(positions)).collect();
    let mut grown = Vec::new();
    for (idx, positions) in patches.iter().enumerate() {
        let [low, high] = around(positions);
        let middle = [(low[0] + high[0]) / 2.0, (low[1] + high[1]) / 2.0];
        let scaled = |factor: f64| -> Span {
            [low, high].map(|corner| [0, 1].map(|axis| middle[axis] + (corner[axis] - middle[axis]) * factor))
        };
        let free = |factor: f64| {
            let span = scaled(factor);
            spans.iter().enumerate().all(|(other, other_span)| other == idx || apart(&span, other_span))
        };
        let steps = 14;
        let factor = (1..=steps)
            .map(|step| 1.0 + (MOST_GROWTH - 1.0) * f64::from(step) / f64::from(steps))
            .take_while(|&factor| positions.len() > 1 && free(factor))
            .last()
            .unwrap_or(1.0);
        spans[idx] = scaled(factor);
        grown.extend(
            positions
                .iter()
                .map(|position| [0, 1].map(|axis| middle[axis] + (position[axis] - middle[axis]) * factor)),
        );
    }
    grown
}

/// What a click on a taxel does in every view: pin and select it, or only select it; again takes it back.
pub(super) fn click(playback: &mut Playback, channel: usize, only_select: bool) {
    if only_select {
        if !playback.selected.remove(&channel) {
            playback.selected.insert(channel);
        }
    } else if playback.pinned == Some(channel) {
        playback.pinned = None;
        playback.selected.remove(&channel);
    } else {
        playback.pinned = Some(channel);
        playback.selected.insert(channel);
    }
}

/// The name of a taxel for screen readers and tests: `index_tip.3: 34 counts, active`.
pub(super) fn taxel_name(station: &Station, channel: usize, sample: &Sample, signal: Signal) -> String {
    let info = &station.layout.channels[channel];
    let unit = &station.layout.streams[info.stream].raw_unit;
    let label = station.layout.channel_label(channel);
    format!("{label}: {}", sample.text(unit, kind_of(station, channel), signal))
}

/// What one number for each channel looks like on the map, wherever the page shows one.
pub fn channel_map_ui(
    ui: &mut egui::Ui,
    rect: Rect,
    station: &Station,
    colors: &[Color32],
    name: &dyn Fn(usize) -> String,
    playback: &mut Playback,
    palette: &Palette,
) {
    let samples = vec![Sample { active: Some(true), ..Sample::default() }; station.layout.num_channels()];
    let map = FlatMap { station, samples: &samples, real: None, signal: Signal::Real, colors, name };
    flat_map_ui(ui, rect, &map, playback, palette);
}

/// A taxel: what `sample` and, where that is simulated, the real one say, in `color`.
fn taxel_shape(
    painter: &egui::Painter,
    place: Pos2,
    radius: f32,
    [sample, real]: [Option<&Sample>; 2],
    color: Color32,
    signal: Signal,
    palette: &Palette,
) {
    let sample = sample.copied().unwrap_or_default();
    let active = sample.active == Some(true);
    let real_active = real.and_then(|real| real.active);
    let outline = Stroke::new(1.0, palette.text_weak);
    match sample.active {
        None => {
            painter.circle(place, radius * 0.8, Color32::TRANSPARENT, outline);
            let d = Vec2::splat(radius * 0.5);
            painter.line_segment([place - d, place + d], outline);
        }
        // Simulated but not real: hollow.
        Some(true) if real_active == Some(false) => {
            painter.circle(place, radius - 1.5, palette.surface, Stroke::new(3.0, signal.color(palette)));
        }
        Some(true) => {
            painter.circle(place, radius, color, Stroke::new(2.0, palette.real));
        }
        Some(false) => {
            painter.circle(place, radius * 0.75, color, outline);
        }
    }
    // Real but not simulated: a red line below.
    if !active && real_active == Some(true) {
        let y = place.y + radius + 2.0;
        painter.hline(place.x - radius..=place.x + radius, y, Stroke::new(3.0, palette.mismatch));
    }
}

/// A box around each patch; boxes keep apart from each other where their taxels do.
fn patch_outlines(station: &Station, places: &[Pos2], radius: f32) -> Vec<Rect> {
    let around: Vec<Rect> = station
        .layout
        .patches
        .iter()
        .map(|patch| {
            let of_patch = places[patch.channels.clone()].iter();
            of_patch.fold(Rect::NOTHING, |rect, &place| rect.union(Rect::from_center_size(place, Vec2::ZERO)))
        })
        .collect();
    let nearest = around
        .iter()
        .enumerate()
        .flat_map(|(idx, a)| around[idx + 1..].iter().map(move |b| gap(a, b)))
        .filter(|gap| *gap > 0.5)
        .fold(f32::INFINITY, f32::min);
    let margin = (radius * 1.6).min((nearest / 2.0 - 1.0).max(radius * 0.5));
    around.into_iter().map(|rect| rect.expand(margin)).collect()
}

/// How far apart two boxes are along the axis that parts them most; at most 0 if they overlap.
fn gap(a: &Rect, b: &Rect) -> f32 {
    let x = (b.left() - a.right()).max(a.left() - b.right());
    let y = (b.top() - a.bottom()).max(a.top() - b.bottom());
    x.max(y)
}

/// Names of the groups, above the highest of their patches.
fn group_names(painter: &egui::Painter, station: &Station, outlines: &[Rect], palette: &Palette) {
    let mut groups: Vec<(&str, Rect)> = Vec::new();
    for (patch, &around) in station.layout.patches.iter().zip(outlines) {
        match groups.iter_mut().find(|(group, _)| *group == patch.group) {
            Some((_, rect)) => *rect = rect.union(around),
            None => groups.push((&patch.group, around)),
        }
    }
    for (group, around) in groups {
        let at = Pos2::new(around.center().x, around.top() - 2.0);
        painter.text(
            at,
            Align2::CENTER_BOTTOM,
            capitalised(group),
            FontId::proportional(13.0),
            palette.text_weak,
        );
    }
}

/// As large as the nearest two taxels allow.
fn marker_radius(places: &[Pos2]) -> f32 {
    let nearest = places
        .iter()
        .enumerate()
        .flat_map(|(idx, a)| places[idx + 1..].iter().map(move |b| a.distance(*b)))
        .filter(|gap| *gap > 0.5)
        .fold(f32::INFINITY, f32::min);
    (nearest * 0.4).clamp(4.0, 11.0)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn every_position_is_inside_and_up_is_up(positions in prop::collection::vec([-50.0f64..50.0, -50.0f64..50.0], 1..40), width in 120.0f32..900.0, height in 120.0f32..900.0) {
            let rect = Rect::from_min_size(Pos2::new(10.0, 20.0), Vec2::new(width, height));
            let projection = Projection::fit(positions.iter().copied(), rect).expect("positions");
            for position in &positions {
                prop_assert!(rect.expand(0.1).contains(projection.to_screen(*position)));
            }
            let [x, y] = positions[0];
            prop_assert!(projection.to_screen([x, y + 1.0]).y <= projection.to_screen([x, y]).y);
        }
    }

    #[test]
    fn crowded_patches_grow_into_free_room_only() {
        let crowded = [[0.0, 0.0], [2.0, 0.0], [0.0, 2.0], [2.0, 2.0]];
        let (near, far) = ([[4.0, 1.0]], [[60.0, 1.0]]);
        let width = |grown: &[[f64; 2]]| grown[1][0] - grown[0][0];
        assert!((width(&grown_patches(&[&crowded, &far])) - 2.0 * MOST_GROWTH).abs() < 1e-9);
        let beside = grown_patches(&[&crowded, &near, &far]);
        assert!((width(&beside) - 2.0).abs() < 1e-9);
        assert_eq!(beside[4..], [near[0], far[0]]);
    }

    #[test]
    fn a_second_click_takes_the_first_back() {
        let mut playback = Playback::default();
        click(&mut playback, 3, false);
        assert_eq!((playback.pinned, playback.selected.contains(&3)), (Some(3), true));
        click(&mut playback, 5, true);
        assert_eq!((playback.pinned, playback.selected.len()), (Some(3), 2));
        click(&mut playback, 5, true);
        click(&mut playback, 3, false);
        assert_eq!((playback.pinned, playback.selected.len()), (None, 0));
    }
}
