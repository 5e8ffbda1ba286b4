//! The side panel: what one taxel says, and when it was touched.

use egui::{Rect, RichText, Sense, Stroke, StrokeKind, accesskit::Role};
use palpate_robot_model::Station;
use palpate_wire::proto::ReplayTrace;

use super::signal::{Contact, Sample, Signal, kind_of, reading_text, real_contacts, simulated_contacts};
use crate::{screens::duration_text, take_data::TakeData, theme::Palette};

/// The trace shows this long before and after the cursor, s.
const TRACE_HALF_S: f64 = 4.0;
/// Contacts listed before the cursor.
const LISTED_CONTACTS: usize = 3;

/// What is known about the taxels now.
pub(super) struct Details<'a> {
    /// The station.
    pub station: &'a Station,
    /// In the order of [`Signal::ALL`], one for each channel; empty where it is not there.
    pub samples: [&'a [Sample]; Signal::COUNT],
    /// The take and the cursor, unless live.
    pub take: Option<(&'a TakeData, f64)>,
    /// Nominal, compared and diagnosed replays of the take.
    pub replays: [Option<&'a ReplayTrace>; Signal::COUNT - 1],
}

impl Details<'_> {
    /// The contacts of `channel` in one signal.
    pub(super) fn contacts(&self, signal: Signal, channel: usize) -> Vec<Contact> {
        let Some((take, _)) = self.take else { return Vec::new() };
        let replay = match signal {
            Signal::Real => return real_contacts(self.station, take, channel),
            Signal::Nominal => self.replays[0],
            Signal::Calibrated => self.replays[1],
            Signal::Diagnosed => self.replays[2],
        };
        replay.map_or_else(Vec::new, |replay| simulated_contacts(self.station, take, replay, channel))
    }

    /// What people call the channel; its id in files, its stream and its link.
    fn heading(&self, channel: usize) -> (String, String) {
        let info = &self.station.layout.channels[channel];
        let patch = &self.station.layout.patches[info.patch];
        let stream = &self.station.layout.streams[info.stream];
        let link = &self.station.robot.links[patch.link].name;
        let label = self.station.layout.channel_label(channel);
        (label, format!("{}, {}, on link {link}", info.id, stream.label))
    }

    /// Reading against threshold of one signal, in words.
    fn line(&self, signal: Signal, channel: usize) -> Option<String> {
        let sample = self.samples[signal as usize].get(channel)?;
        let info = &self.station.layout.channels[channel];
        let (unit, kind) =
            (&self.station.layout.streams[info.stream].raw_unit, kind_of(self.station, channel));
        let state = sample.text(unit, kind, signal);
        let compared = sample.threshold.filter(|_| sample.reading.is_some());
        Some(match compared {
            Some(threshold) => format!("{state} (threshold {})", reading_text(threshold, unit, kind, signal)),
            None => state,
        })
    }
}

/// The tooltip of a taxel: id, link, reading, threshold, last touch.
pub(super) fn tooltip_ui(ui: &mut egui::Ui, details: &Details<'_>, channel: usize, signal: Signal) {
    let (label, place) = details.heading(channel);
    ui.label(RichText::new(label).strong());
    ui.label(place);
    if let Some(line) = details.line(signal, channel) {
        ui.label(format!("{}: {line}", signal.label()));
    }
    if let Some((_, time_s)) = details.take
        && let Some(last) = before(&details.contacts(signal, channel), time_s).last()
    {
        ui.label(format!("Last touched {}", contact_text(last, time_s)));
    }
}

/// The panel about `channel`. `true` when the operator lets it go.
pub(super) fn details_ui(
    ui: &mut egui::Ui,
    details: &Details<'_>,
    channel: usize,
    pinned: bool,
    palette: &Palette,
) -> bool {
    let (label, place) = details.heading(channel);
    let mut unpin = false;
    ui.horizontal(|ui| {
        ui.label(RichText::new(&label).strong().size(16.0));
        if pinned {
            ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| {
                unpin = ui
                    .button("Unpin")
                    .on_hover_text("Let this taxel go; clicking it again does the same")
                    .clicked();
            });
        }
    });
    ui.label(RichText::new(place).color(palette.text_weak));
    // Lines of text, not of controls.
    ui.spacing_mut().interact_size.y = 18.0;
    for signal in Signal::ALL {
        if let Some(line) = details.line(signal, channel) {
            ui.horizontal_wrapped(|ui| {
                ui.label(
                    RichText::new(signal.label()).color(palette.text_of(signal.color(palette))).strong(),
                );
                ui.label(line);
            });
        }
    }
    if let Some((take, time_s)) = details.take {
        let contacts = Signal::ALL.map(|signal| details.contacts(signal, channel));
        trace_ui(ui, details, take, time_s, channel, &contacts, palette);
        let earlier = before(&contacts[0], time_s);
        ui.label(RichText::new("Last real touches").strong());
        if earlier.is_empty() {
            ui.label(RichText::new("None up to here").color(palette.text_weak));
        }
        for contact in earlier.iter().rev().take(LISTED_CONTACTS) {
            ui.label(contact_text(contact, time_s));
        }
    }
    unpin
}

/// Contacts that began up to `time_s`.
fn before(contacts: &[Contact], time_s: f64) -> &[Contact] {
    &contacts[..contacts.partition_point(|contact| contact.start_s <= time_s)]
}

fn contact_text(contact: &Contact, time_s: f64) -> String {
    match contact.end_s.filter(|&end_s| end_s <= time_s) {
        Some(end_s) => format!("at {:.2} s for {}", contact.start_s, duration_text(end_s - contact.start_s)),
        None => format!("since {:.2} s ({})", contact.start_s, duration_text(time_s - contact.start_s)),
    }
}

/// Reading over time with its threshold, and below it a row of contacts of each signal.
fn trace_ui(
    ui: &mut egui::Ui,
    details: &Details<'_>,
    take: &TakeData,
    time_s: f64,
    channel: usize,
    contacts: &[Vec<Contact>; Signal::COUNT],
    palette: &Palette,
) {
    let (rect, response) = ui.allocate_exact_size(egui::vec2(ui.available_width(), 118.0), Sense::hover());
    let label = details.station.layout.channel_label(channel);
    let name = format!("Trace of {label}, {TRACE_HALF_S:.0} s before and after the cursor");
    response.widget_info(|| egui::WidgetInfo::labeled(Role::Image, true, name.clone()));
    let painter = ui.painter_at(rect);
    painter.rect(rect, 4.0, palette.surface, Stroke::new(1.0, palette.line), StrokeKind::Inside);
    let (start_s, end_s) = (time_s - TRACE_HALF_S, time_s + TRACE_HALF_S);
    let x_of =
        |t: f64| egui::remap(t, start_s..=end_s, f64::from(rect.left())..=f64::from(rect.right())) as f32;
    let rows_top = rect.bottom() - Signal::COUNT as f32 * 10.0 - 6.0;
    let plot = Rect::from_min_max(rect.min + egui::vec2(0.0, 6.0), egui::pos2(rect.right(), rows_top - 4.0));

    for (row, (signal, contacts)) in Signal::ALL.iter().zip(contacts).enumerate() {
        let y = rows_top + row as f32 * 10.0;
        for contact in contacts {
            let to_s = contact.end_s.unwrap_or(take.duration_s());
            if to_s >= start_s && contact.start_s <= end_s {
                let (x0, x1) = (x_of(contact.start_s).max(rect.left()), x_of(to_s).min(rect.right()));
                let bar = Rect::from_min_max(egui::pos2(x0, y), egui::pos2(x1.max(x0 + 1.5), y + 8.0));
                painter.rect_filled(bar, 1.5, signal.color(palette));
            }
        }
    }

    let info = &details.station.layout.channels[channel];
    let stream_info = &details.station.layout.streams[info.stream];
    if let (Some(stream), Some(config)) =
        (take.stream(&stream_info.id), details.station.streams.get(info.stream))
    {
        let width = stream_info.channels.len();
        let offset = channel - stream_info.channels.start;
        let first = stream.times_s.partition_point(|&t| t < start_s).saturating_sub(1);
        let last = (stream.times_s.partition_point(|&t| t <= end_s) + 1).min(stream.times_s.len());
        let points: Vec<(f32, f32)> = (first..last)
            .filter_map(|idx| Some((x_of(stream.times_s[idx]), *stream.raw.get(idx * width + offset)?)))
            .filter(|(_, raw)| raw.is_finite())
            .collect();
        // The threshold stands at a quarter of the height unless the reading needs more room: as fixed as may be.
        let threshold = config.on_threshold as f32;
        let top = points.iter().map(|(_, raw)| *raw).fold(4.0 * threshold.abs().max(1e-6), f32::max);
        let y_of = |raw: f32| egui::remap_clamp(raw, 0.0..=top, plot.bottom()..=plot.top());
        painter.extend(egui::Shape::dashed_line(
            &[egui::pos2(rect.left(), y_of(threshold)), egui::pos2(rect.right(), y_of(threshold))],
            Stroke::new(1.0, palette.text_weak),
            5.0,
            4.0,
        ));
        let line = points.into_iter().map(|(x, raw)| egui::pos2(x, y_of(raw))).collect();
        painter.line(line, Stroke::new(1.5, palette.real));
    }
    painter.vline(x_of(time_s), rect.y_range(), Stroke::new(1.5, palette.calibrated));
}
