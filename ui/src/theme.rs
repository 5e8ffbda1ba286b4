//! Colours that mean something, the same everywhere, and sizes that can be read and hit.
//!
//! Orange, blue and green are those of Okabe and Ito, which stay apart for the common colour blindnesses; state is never
//! colour alone, so every use also differs by place, shape or word.

use egui::{Color32, FontFamily, FontId, Stroke, TextStyle, Theme, Visuals};

/// Pages narrower than this show the station's state and STOP in the bar, and the rest behind a menu.
pub(crate) const NARROW: f32 = 900.0;

/// Whether the page at hand is narrow.
pub(crate) fn is_narrow(ctx: &egui::Context) -> bool {
    ctx.content_rect().width() < NARROW
}

/// What each colour stands for, in one theme.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Palette {
    /// Whether this is the dark theme.
    pub dark: bool,
    /// What the real hand did.
    pub real: Color32,
    /// The nominal simulation.
    pub nominal: Color32,
    /// Words about the nominal simulation: its orange is too light to read on a light page.
    pub nominal_text: Color32,
    /// The calibrated (or otherwise compared) simulation.
    pub calibrated: Color32,
    /// The diagnosed simulation.
    pub diagnosed: Color32,
    /// A contact that the simulation missed; also errors.
    pub mismatch: Color32,
    /// Something that needs a look.
    pub warning: Color32,
    /// Dead taxels (with a hatch).
    pub dead: Color32,
    /// Stuck taxels.
    pub stuck: Color32,
    /// Page behind everything.
    pub background: Color32,
    /// Surface of panels and lanes.
    pub surface: Color32,
    /// Lines between things.
    pub line: Color32,
    /// Text of less weight, still at a contrast of 4.5 to 1.
    pub text_weak: Color32,
}

impl Palette {
    /// The light theme.
    pub const LIGHT: Self = Self {
        dark: false,
        real: Color32::from_rgb(0x1b, 0x1b, 0x1b),
        nominal: Color32::from_rgb(0xd5, 0x7a, 0x00),
        nominal_text: Color32::from_rgb(0x96, 0x50, 0x00),
        calibrated: Color32::from_rgb(0x00, 0x67, 0xa8),
        diagnosed: Color32::from_rgb(0x00, 0x75, 0x52),
        mismatch: Color32::from_rgb(0xc4, 0x1e, 0x1e),
        warning: Color32::from_rgb(0x85, 0x54, 0x00),
        dead: Color32::from_rgb(0x9a, 0x9a, 0x9a),
        stuck: Color32::from_rgb(0xa8, 0x26, 0x96),
        background: Color32::from_rgb(0xf6, 0xf6, 0xf4),
        surface: Color32::from_rgb(0xff, 0xff, 0xff),
        line: Color32::from_rgb(0xdc, 0xdc, 0xd8),
        text_weak: Color32::from_rgb(0x5c, 0x5c, 0x5a),
    };

    /// The dark theme.
    pub const DARK: Self = Self {
        dark: true,
        real: Color32::from_rgb(0xec, 0xec, 0xec),
        nominal: Color32::from_rgb(0xf0, 0xa0, 0x30),
        nominal_text: Color32::from_rgb(0xf0, 0xa0, 0x30),
        calibrated: Color32::from_rgb(0x5c, 0xb4, 0xf0),
        diagnosed: Color32::from_rgb(0x35, 0xc0, 0x95),
        mismatch: Color32::from_rgb(0xff, 0x85, 0x7c),
        warning: Color32::from_rgb(0xf0, 0xc2, 0x4a),
        dead: Color32::from_rgb(0x70, 0x72, 0x76),
        stuck: Color32::from_rgb(0xee, 0x8a, 0xd9),
        background: Color32::from_rgb(0x1b, 0x1c, 0x1e),
        surface: Color32::from_rgb(0x23, 0x24, 0x27),
        line: Color32::from_rgb(0x3a, 0x3c, 0x40),
        text_weak: Color32::from_rgb(0xa6, 0xa8, 0xac),
    };

    /// The palette of `theme`.
    pub fn of(theme: Theme) -> Self {
        match theme {
            Theme::Dark => Self::DARK,
            Theme::Light => Self::LIGHT,
        }
    }

    /// `colour` as words of its meaning have it: what draws well may read badly.
    pub fn text_of(&self, colour: Color32) -> Color32 {
        if colour == self.nominal { self.nominal_text } else { colour }
    }
}

/// The fixed perceptual scale of taxels, viridis: 0 is dark violet, 1 bright yellow; outside is clamped, no number is
/// 0.
pub fn taxel_scale(share: f32) -> Color32 {
    let share = if share.is_nan() { 0.0 } else { f64::from(share.clamp(0.0, 1.0)) };
    let colour = colorous::VIRIDIS.eval_continuous(share);
    Color32::from_rgb(colour.r, colour.g, colour.b)
}

/// A bar with the colours of [`taxel_scale`], 0 on the left.
pub fn taxel_scale_ui(ui: &mut egui::Ui, width: f32) -> egui::Response {
    let (rect, response) = ui.allocate_exact_size(egui::vec2(width, 14.0), egui::Sense::hover());
    let num_steps = 48;
    let x_of = |step: i32| egui::lerp(rect.x_range(), step as f32 / num_steps as f32);
    for step in 0..num_steps {
        let cell = egui::Rect::from_x_y_ranges(x_of(step)..=x_of(step + 1), rect.y_range());
        ui.painter().rect_filled(cell, 0.0, taxel_scale((step as f32 + 0.5) / num_steps as f32));
    }
    response
}

/// Sets fonts, sizes and colours of both themes.
pub fn install(ctx: &egui::Context) {
    for theme in [Theme::Light, Theme::Dark] {
        ctx.style_mut_of(theme, |style| {
            let palette = Palette::of(theme);
            style.text_styles = [
                (TextStyle::Small, FontId::new(13.0, FontFamily::Proportional)),
                (TextStyle::Body, FontId::new(14.5, FontFamily::Proportional)),
                (TextStyle::Button, FontId::new(14.5, FontFamily::Proportional)),
                (TextStyle::Monospace, FontId::new(13.5, FontFamily::Monospace)),
                (TextStyle::Heading, FontId::new(20.0, FontFamily::Proportional)),
            ]
            .into();
            style.spacing.interact_size = egui::vec2(40.0, 32.0);
            style.spacing.button_padding = egui::vec2(10.0, 6.0);
            style.spacing.item_spacing = egui::vec2(8.0, 6.0);
            style.spacing.icon_width = 18.0;
            style.spacing.slider_width = 160.0;
            // Numbers are compared and copied, names are clicked: selectable labels swallow both on a touch screen.
            style.interaction.selectable_labels = false;
            style.visuals = visuals(&palette);
        });
    }
}

fn visuals(palette: &Palette) -> Visuals {
    let mut visuals = if palette.dark { Visuals::dark() } else { Visuals::light() };
    visuals.panel_fill = palette.background;
    visuals.window_fill = palette.surface;
    visuals.extreme_bg_color = palette.surface;
    visuals.faint_bg_color = palette.surface;
    visuals.window_stroke = Stroke::new(1.0, palette.line);
    visuals.widgets.noninteractive.bg_stroke = Stroke::new(1.0, palette.line);
    visuals.widgets.noninteractive.fg_stroke = Stroke::new(1.0, palette.real);
    visuals.widgets.inactive.fg_stroke = Stroke::new(1.0, palette.real);
    visuals.weak_text_color = Some(palette.text_weak);
    visuals.error_fg_color = palette.mismatch;
    visuals.warn_fg_color = palette.warning;
    visuals.hyperlink_color = palette.calibrated;
    visuals.selection.bg_fill =
        if palette.dark { Color32::from_rgb(0x1b, 0x3b, 0x50) } else { Color32::from_rgb(0xdc, 0xeb, 0xf6) };
    visuals.selection.stroke = Stroke::new(1.0, palette.real);
    visuals
}

#[cfg(test)]
mod tests {
    use super::*;

    fn luminance(colour: Color32) -> f64 {
        // WCAG 2.2, relative luminance.
        let linear = |value: u8| {
            let value = f64::from(value) / 255.0;
            if value <= 0.04045 { value / 12.92 } else { ((value + 0.055) / 1.055).powf(2.4) }
        };
        0.2126 * linear(colour.r()) + 0.7152 * linear(colour.g()) + 0.0722 * linear(colour.b())
    }

    fn contrast(a: Color32, b: Color32) -> f64 {
        let (a, b) = (luminance(a), luminance(b));
        (a.max(b) + 0.05) / (a.min(b) + 0.05)
    }

    /// Whatever words stand on: the page, panels, and buttons that are idle, hovered or chosen.
    fn grounds(palette: &Palette) -> Vec<Color32> {
        let visuals = visuals(palette);
        let widgets = &visuals.widgets;
        vec![
            palette.background,
            palette.surface,
            visuals.selection.bg_fill,
            widgets.inactive.weak_bg_fill,
            widgets.noninteractive.weak_bg_fill,
        ]
    }

    #[test]
    fn words_stand_out_from_everything_that_they_stand_on() {
        for palette in [Palette::LIGHT, Palette::DARK] {
            let meanings = [palette.nominal, palette.calibrated, palette.diagnosed, palette.stuck];
            let words = meanings.map(|colour| palette.text_of(colour));
            let words =
                words.into_iter().chain([palette.real, palette.text_weak, palette.mismatch, palette.warning]);
            for word in words {
                for ground in grounds(&palette) {
                    let contrast = contrast(word, ground);
                    assert!(contrast >= 4.5, "{word:?} on {ground:?}: {contrast:.2} (WCAG 2.2, 1.4.3)");
                }
            }
            // Words of large buttons, on what the button is filled with.
            for fill in [palette.calibrated, palette.diagnosed, palette.real] {
                assert!(contrast(palette.surface, fill) >= 4.5, "{fill:?}");
            }
        }
    }

    #[test]
    fn pictures_stand_out_from_the_page() {
        for palette in [Palette::LIGHT, Palette::DARK] {
            for colour in
                [palette.nominal, palette.calibrated, palette.diagnosed, palette.stuck, palette.real]
            {
                let contrast = contrast(colour, palette.surface);
                assert!(contrast >= 3.0, "{colour:?}: {contrast:.2} (WCAG 2.2, 1.4.11)");
            }
        }
    }

    #[test]
    fn taxel_scale_grows_brighter_and_takes_anything() {
        let steps: Vec<f64> = (0..=50).map(|step| luminance(taxel_scale(step as f32 / 50.0))).collect();
        assert!(steps.windows(2).all(|pair| pair[1] >= pair[0]));
        assert_eq!(taxel_scale(f32::NAN), taxel_scale(0.0));
        assert_eq!(taxel_scale(7.0), taxel_scale(1.0));
    }
}
