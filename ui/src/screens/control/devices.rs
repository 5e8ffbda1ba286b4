//! The devices of a live station: what each delivers, how warm it is, and what is wrong, in words that tell what to do.

use egui::RichText;
use palpate_wire::proto::{DeviceStatus, MotorStatus, TaxelWarning, device_status::Link};

use super::wording::link_word;
use crate::{
    screens::{ScreenContext, controls::name_button, help::Topic, topic_ui},
    store::control::Holder,
    theme::Palette,
};

/// Servos are built for up to 70 degrees; from here on they deserve a break.
const WARM_C: f32 = 60.0;

/// Every device, and the taxels that the live twin does not believe any more.
pub fn devices_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>) {
    let Some(state) = cx.store.control_state().cloned() else {
        ui.label("This station reports nothing about its devices.");
        return;
    };
    ui.horizontal_wrapped(|ui| {
        ui.label(RichText::new("Wiring, names, faults").color(cx.palette.text_weak));
        topic_ui(ui, Topic::Devices);
    });
    if state.devices.is_empty() {
        ui.label("No device has reported yet.");
    }
    let mine = cx.store.control.holder(Some(&state)) == Holder::Me;
    for device in &state.devices {
        if device_ui(ui, device, mine, &cx.palette) {
            cx.store.control.clear_fault(&device.id);
        }
        ui.separator();
    }
    ui.label(format!(
        "Control loop: {:.1} Hz now, {:.1} mean, {:.1} worst second",
        state.loop_hz, state.loop_mean_hz, state.loop_worst_hz
    ));
    ui.label(format!(
        "From a device's byte to this page: {:.1} ms now, 95 of 100 below {:.1} ms",
        state.latency_ms, state.latency_p95_ms
    ));
    ui.separator();
    taxel_warnings_ui(ui, &state.taxels, cx);
}

/// True when its fault shall be cleared.
fn device_ui(ui: &mut egui::Ui, device: &DeviceStatus, mine: bool, palette: &Palette) -> bool {
    let (word, color) = link_word(device.link(), palette);
    let mut clear = false;
    ui.horizontal(|ui| {
        ui.label(RichText::new(&device.id).strong());
        ui.label(RichText::new(&device.kind).color(palette.text_weak));
        ui.label(RichText::new(word).strong().color(color));
        let faulty =
            device.link() == Link::Fault || device.motors.iter().any(|motor| !motor.problem.is_empty());
        if faulty {
            let response = ui.add_enabled(mine, egui::Button::new("Clear"));
            name_button(&response, &format!("Clear {}", device.id));
            clear = response
                .on_disabled_hover_text("Take control first")
                .on_hover_text("Clears errors of the arm; restarts a servo that shut itself down")
                .clicked();
        }
    });
    if !device.problem.is_empty() {
        ui.label(RichText::new(format!("\u{26a0} {}", device.problem)).color(palette.mismatch));
    }
    ui.label(format!(
        "{:.1} Hz now, {:.1} mean, {:.1} worst second",
        device.rate_hz, device.rate_mean_hz, device.rate_worst_hz
    ));
    let mut counts = vec![
        counted(device.gaps, "gap"),
        counted(device.bad_frames, "bad frame"),
        counted(device.reconnects, "reconnect"),
    ];
    if device.clock_skew_ppm != 0.0 {
        counts.push(format!("clock {:+.0} ppm", device.clock_skew_ppm));
    }
    ui.label(RichText::new(counts.join(", ")).color(palette.text_weak));
    motors_ui(ui, &device.id, &device.motors, palette);
    clear
}

fn motors_ui(ui: &mut egui::Ui, device: &str, motors: &[MotorStatus], palette: &Palette) {
    let hottest = motors.iter().filter(|motor| motor.temperature_c > 0.0);
    if let Some(hottest) = hottest.max_by(|a, b| a.temperature_c.total_cmp(&b.temperature_c)) {
        let color = if hottest.temperature_c >= WARM_C { palette.warning } else { palette.real };
        let warm = if hottest.temperature_c >= WARM_C { ": let it cool down" } else { "" };
        let text = format!("Warmest: {} {:.0} \u{b0}C{warm}", hottest.joint, hottest.temperature_c);
        ui.label(RichText::new(text).color(color));
    }
    for motor in motors.iter().filter(|motor| !motor.problem.is_empty()) {
        let text = format!("\u{26a0} {}: {}", motor.joint, motor.problem);
        ui.label(RichText::new(text).color(palette.mismatch));
    }
    if motors.is_empty() {
        return;
    }
    egui::CollapsingHeader::new("Motors").id_salt(("motors", device)).show(ui, |ui| {
        egui::Grid::new(("motor grid", device)).num_columns(4).spacing([12.0, 2.0]).show(ui, |ui| {
            for motor in motors {
                ui.label(&motor.joint);
                ui.label(known(motor.temperature_c, 0, "\u{b0}C"));
                ui.label(known(motor.supply_v, 1, "V"));
                ui.label(format!("{:.0} mA", motor.current_a * 1e3));
                ui.end_row();
            }
        });
    });
}

/// A number of things: `1 gap`, `3 gaps`.
fn counted(count: u64, thing: &str) -> String {
    format!("{count} {thing}{}", if count == 1 { "" } else { "s" })
}

/// A number with its unit; a dash where it is unknown (0).
fn known(value: f32, decimals: usize, unit: &str) -> String {
    if value == 0.0 { "\u{2013}".to_owned() } else { format!("{value:.decimals$} {unit}") }
}

fn taxel_warnings_ui(ui: &mut egui::Ui, warnings: &[TaxelWarning], cx: &mut ScreenContext<'_>) {
    if warnings.is_empty() {
        return;
    }
    ui.label(RichText::new("Taxels that need a look").strong());
    for warning in warnings {
        let color = match warning.kind.as_str() {
            "dead" => cx.palette.text_weak,
            "stuck" => cx.palette.stuck,
            _ => cx.palette.warning,
        };
        let text = RichText::new(format!("\u{26a0} {}: {}", warning.kind, warning.text)).color(color);
        let response = ui.add(egui::Button::new(text).wrap().frame(false));
        if response.on_hover_text("Shows the taxel").clicked() {
            cx.playback.pinned = Some(warning.channel as usize);
        }
    }
}
