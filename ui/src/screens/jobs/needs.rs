//! What a job needs of the machine, as far as the form asks: parts, and the graphics card.

use egui::RichText;
use palpate_reports::wording::counted;
use palpate_wire::api::{Job, Resources};

use super::super::ScreenContext;

/// Most parts of a job; the server knows how many there are at most of this one.
const MAX_PARTS: u32 = 256;
/// Most cores that the form asks for.
const MAX_CORES: u32 = 1024;

/// What was filled in. It is kept from one kind to another, and used by those that can.
#[derive(Debug)]
pub(super) struct Needs {
    /// Parts into which the work is divided; with 1 it is not.
    pub(super) parts: u32,
    /// Cores of each part.
    pub(super) cores: u32,
    /// Parts that work at once at most; 0: as many as there is room for.
    pub(super) at_once: u32,
    pub(super) gpu: bool,
}

impl Default for Needs {
    fn default() -> Self {
        Self { parts: 1, cores: 1, at_once: 0, gpu: false }
    }
}

impl Needs {
    /// What is asked for; `None` means what the kind needs anyway.
    pub(super) fn resources(&self, is_divisible: bool, may_use_gpu: bool) -> Option<Resources> {
        let is_divided = is_divisible && self.parts > 1;
        let gpu = may_use_gpu && self.gpu;
        let resources = Resources { gpu, ..Resources::default() };
        if is_divided {
            let &Self { parts: shards, cores, at_once, .. } = self;
            return Some(Resources { shards, cores, at_once, ..resources });
        }
        gpu.then_some(resources)
    }

    /// The fields, folded; nothing where the kind has none.
    pub(super) fn show(
        &mut self,
        ui: &mut egui::Ui,
        cx: &ScreenContext<'_>,
        parts: Option<&str>,
        may_use_gpu: bool,
    ) {
        if parts.is_none() && !may_use_gpu {
            return;
        }
        let weak = |ui: &mut egui::Ui, text: &str| {
            ui.add(egui::Label::new(RichText::new(text).color(cx.palette.text_weak)).wrap());
        };
        egui::CollapsingHeader::new("Advanced").id_salt("job_needs").show(ui, |ui| {
            if let Some(parts) = parts {
                weak(
                    ui,
                    &format!(
                        "The work can be divided: parts share its {parts} and work side by side, as processes of this \
                         computer or as tasks of a Slurm array. The result is the same."
                    ),
                );
                egui::Grid::new("job_parts").num_columns(2).spacing([14.0, 6.0]).show(ui, |ui| {
                    number_ui(ui, "Parts", &mut self.parts, 1..=MAX_PARTS, |parts| match parts {
                        1 => "1, not divided".to_owned(),
                        parts => parts.to_string(),
                    });
                    if self.parts > 1 {
                        number_ui(ui, "Cores of each", &mut self.cores, 0..=MAX_CORES, |cores| match cores {
                            0 => "all, one after another".to_owned(),
                            cores => cores.to_string(),
                        });
                        number_ui(ui, "At once at most", &mut self.at_once, 0..=MAX_PARTS, |most| match most {
                            0 => "as many as there is room for".to_owned(),
                            most => most.to_string(),
                        });
                    }
                });
            }
            if may_use_gpu {
                ui.checkbox(&mut self.gpu, "Learn on the graphics card");
                weak(ui, "It waits until no other job has the card, and is refused where the runner has none.");
            }
        });
    }
}

fn number_ui(
    ui: &mut egui::Ui,
    name: &str,
    number: &mut u32,
    range: std::ops::RangeInclusive<u32>,
    words: impl Fn(u32) -> String,
) {
    let label = ui.label(name);
    let field = egui::DragValue::new(number)
        .range(range)
        .custom_formatter(|number, _| words(number as u32))
        .custom_parser(|text| text.split([',', ' ']).next().and_then(|number| number.parse().ok()));
    ui.add(field).labelled_by(label.id);
    ui.end_row();
}

/// Into what `job` is divided and what it has beside cores, in words; `None` where nothing is said.
pub(super) fn words(job: &Job) -> Option<String> {
    let Resources { shards, cores, at_once, gpu, .. } = job.spec.resources;
    let mut words = Vec::new();
    if shards > 0 {
        words.push(counted(shards.into(), "part"));
        let each = match cores {
            0 => "all cores".to_owned(),
            cores => counted(cores.into(), "core"),
        };
        words.push(format!("{each} each"));
        if at_once > 0 {
            words.push(format!("{at_once} at once at most"));
        }
    }
    if gpu {
        words.push("the graphics card".to_owned());
    }
    (!words.is_empty()).then(|| words.join(", "))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_kind_cannot_use_is_not_asked_for() {
        let needs = Needs { parts: 4, cores: 2, at_once: 3, gpu: true };
        let divided = Resources { shards: 4, cores: 2, at_once: 3, ..Resources::default() };
        assert_eq!(needs.resources(true, false), Some(divided));
        assert_eq!(needs.resources(false, true), Some(Resources { gpu: true, ..Resources::default() }));
        assert_eq!(needs.resources(false, false), None);
        assert_eq!(needs.resources(true, true), Some(Resources { gpu: true, ..divided }));
        assert_eq!(Needs::default().resources(true, true), None);
    }
}
