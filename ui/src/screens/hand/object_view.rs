//! One object in 3-D, resting on the table, drawn by the hand's renderer.

use std::sync::Arc;

use egui::{Rect, Rgba, Sense, accesskit::Role};
use nalgebra::{Isometry3, Vector3};
use palpate_robot_model::ObjectShape;

use super::{
    camera::{Bounds, Camera},
    detail::Detail,
    renderer::{Scene, ScenePaint},
    scene::{Geometry, Instance},
    view3d::{background, globals, keep_arrow_keys, steer},
};
use crate::{surface::Surface, theme::Palette};

/// Distance between the lines of the table's grid, m.
const GRID_STEP_M: f32 = 0.02;

/// What is remembered between frames.
#[derive(Default)]
pub struct ObjectView {
    drawn: Option<(String, Arc<Geometry>)>,
    camera: Option<Camera>,
    detail: Detail,
}

impl ObjectView {
    /// Starts over with the camera.
    pub fn reset(&mut self) {
        self.camera = None;
    }

    /// Draws the shape of object `id` into `rect`; the pointer and the arrow keys turn it.
    pub fn ui(
        &mut self,
        ui: &mut egui::Ui,
        rect: Rect,
        (id, shape): (&str, &ObjectShape),
        table_from_object: &Isometry3<f64>,
        palette: &Palette,
        surface: Option<Surface>,
    ) {
        let geometry = match &self.drawn {
            Some((known, geometry)) if known == id => Arc::clone(geometry),
            _ => {
                let geometry = Arc::new(Geometry::of_object(shape));
                self.drawn = Some((id.to_owned(), Arc::clone(&geometry)));
                self.camera = None;
                geometry
            }
        };
        let response = ui.interact(rect, ui.scope_id().with("object_view"), Sense::click_and_drag());
        response.widget_info(|| {
            let name =
                "3-D view of the object: drag to turn, wheel to zoom; arrow keys turn, plus and minus zoom";
            egui::WidgetInfo::labeled(Role::Canvas, true, name)
        });
        keep_arrow_keys(ui, &response);
        let aspect = rect.width() / rect.height().max(1.0);
        let table_from_object = table_from_object.cast::<f32>();
        let Some(bounds) = geometry.meshes.first().and_then(|mesh| mesh.bounds()) else { return };
        let camera = self.camera.get_or_insert_with(|| {
            let bounds =
                Bounds { center: table_from_object * bounds.center, radius_m: bounds.radius_m * 1.2 };
            Camera::framing(bounds, Vector3::new(0.8, -1.0, 0.65), Vector3::z(), aspect)
        });
        steer(camera, ui, &response, rect);

        let painter = ui.painter_at(rect);
        if let Some(surface) = surface {
            let tone = Rgba::from(if palette.dark {
                egui::Color32::from_rgb(0xb9, 0xa8, 0x8c)
            } else {
                egui::Color32::from_rgb(0xb0, 0x98, 0x72)
            });
            let mut globals = globals(camera, aspect, palette);
            globals.grid = [0.0, 0.0, 6.0 * bounds.radius_m, GRID_STEP_M];
            let scene = Scene {
                geometry: Arc::clone(&geometry),
                instances: vec![Instance {
                    mesh: 0,
                    root_from_mesh: table_from_object.to_homogeneous(),
                    color: [tone.r(), tone.g(), tone.b(), 1.0],
                    unlit: 0.0,
                    rim: 0.0,
                }],
                globals,
                background: background(palette),
            };
            let drawing = self.detail.drawing(ui.ctx(), scene);
            let paint = ScenePaint { drawing, size_points: rect.size(), surface };
            painter.add(egui_wgpu::Callback::new_paint_callback(rect, paint));
        } else {
            painter.rect_filled(rect, 6.0, palette.surface);
        }
        if response.has_focus() {
            let stroke = egui::Stroke::new(2.0, palette.calibrated);
            painter.rect_stroke(rect, 6.0, stroke, egui::StrokeKind::Inside);
        }
    }
}
