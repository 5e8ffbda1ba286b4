//! A picture of where the object lies when a trial begins.

use palpate_wire::api::{CampaignPlan, TrialStart};

use crate::theme::Palette;

const SIZE: f32 = 220.0;
/// The region takes so much of the picture's width.
const REGION: f32 = 0.7;

/// The region from above, x away from the robot's base and y to its left, and where the object lies in it.
pub(super) fn place_ui(ui: &mut egui::Ui, palette: &Palette, plan: &CampaignPlan, start: &TrialStart) {
    let (rect, response) = ui.allocate_exact_size(egui::Vec2::splat(SIZE), egui::Sense::hover());
    let words = words(start);
    response.widget_info(|| egui::WidgetInfo::labeled(egui::accesskit::Role::Image, true, &words));
    let painter = ui.painter_at(rect);
    painter.rect(
        rect.shrink(1.0),
        6.0,
        palette.surface,
        egui::Stroke::new(1.0, palette.line),
        egui::StrokeKind::Inside,
    );
    let region = egui::Rect::from_center_size(rect.center(), egui::Vec2::splat(SIZE * REGION));
    painter.rect_stroke(region, 0.0, egui::Stroke::new(1.5, palette.text_weak), egui::StrokeKind::Middle);
    painter.line_segment([region.center_top(), region.center_bottom()], egui::Stroke::new(0.5, palette.line));
    painter.line_segment([region.left_center(), region.right_center()], egui::Stroke::new(0.5, palette.line));
    let points_per_m =
        if plan.half_width_m > 0.0 { 0.5 * region.width() / plan.half_width_m as f32 } else { 0.0 };
    // Seen by somebody who stands behind the robot: away is up, left is left.
    let at = rect.center() + egui::vec2(-(start.y_m as f32), -(start.x_m as f32)) * points_per_m;
    let yaw = start.yaw_rad as f32;
    let heading = egui::vec2(-yaw.sin(), -yaw.cos());
    painter.circle_filled(at, 7.0, palette.calibrated);
    painter.arrow(at, heading * 26.0, egui::Stroke::new(2.5, palette.calibrated));
    let font = egui::FontId::proportional(12.0);
    painter.text(
        rect.center_bottom() - egui::vec2(0.0, 4.0),
        egui::Align2::CENTER_BOTTOM,
        "robot",
        font.clone(),
        palette.text_weak,
    );
    painter.text(
        region.center_top() - egui::vec2(0.0, 4.0),
        egui::Align2::CENTER_BOTTOM,
        format!("\u{b1}{:.0} mm", 1000.0 * plan.half_width_m),
        font,
        palette.text_weak,
    );
}

/// Where the object lies, in words.
pub(super) fn words(start: &TrialStart) -> String {
    let mm = |m: f64| format!("{:+.0} mm", 1000.0 * m).replace("-0 mm", "+0 mm");
    format!(
        "x {}, y {} from the middle, turned by {:.0}\u{b0}",
        mm(start.x_m),
        mm(start.y_m),
        start.yaw_rad.to_degrees()
    )
}
