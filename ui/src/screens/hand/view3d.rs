//! The 3-D view as a widget: camera by pointer, touch and keys, picking, and what is painted over the picture.

use std::sync::Arc;

use egui::{Align2, Color32, FontId, Key, PointerButton, Pos2, Rect, Rgba, Sense, Vec2, accesskit::Role};
use nalgebra::{Isometry3, Point3, Vector3};
use palpate_robot_model::{FixedBox, Station};

use super::{
    camera::{Bounds, Camera},
    detail::Detail,
    renderer::{Globals, Scene, ScenePaint},
    scene::{Geometry, SceneColors, Shown, Subject, TaxelLook, View},
};
use crate::{surface::Surface, theme::Palette};

/// A turn by one screen height, rad.
const ORBIT_RAD_PER_HEIGHT: f32 = 3.5;
/// How long a flight to another view takes, s.
const FLIGHT_S: f32 = 0.3;
/// A taxel can be hit within this many points of its middle, however small it is on the screen.
const PICK_SLACK_POINTS: f32 = 7.0;

/// What is remembered between frames.
pub(super) struct ViewState {
    /// The meshes of the station on the screen.
    pub geometry: Option<(Arc<Station>, Arc<Geometry>)>,
    /// What of the scene is shown.
    pub shown: Shown,
    /// A ghost of the hand where it is told to be.
    pub ghost: bool,
    /// Names at the fingers.
    pub labels: bool,
    /// The camera moves with the hand.
    pub follow: bool,
    /// Where the root of the hand was, to follow it.
    last_root: Option<Point3<f32>>,
    camera: Option<Camera>,
    flight: Option<Flight>,
    last_aspect: f32,
    detail: Detail,
}

struct Flight {
    from: Camera,
    to: Camera,
    share: f32,
}

impl Default for ViewState {
    fn default() -> Self {
        Self {
            geometry: None,
            shown: Shown { object: true, arm: true },
            ghost: true,
            labels: false,
            follow: true,
            last_root: None,
            camera: None,
            flight: None,
            last_aspect: 1.5,
            detail: Detail::default(),
        }
    }
}

/// One moment of the scene.
pub(super) struct Moment<'a> {
    /// The station.
    pub station: &'a Station,
    /// Pose of every link.
    pub root_from_link: &'a [Isometry3<f64>],
    /// One for each channel.
    pub looks: &'a [TaxelLook],
    /// The touched object and where it is.
    pub object: Option<(&'a str, &'a Isometry3<f64>)>,
    /// Pose of every link where it is told to be; empty where nothing is commanded.
    pub commanded_from_link: &'a [Isometry3<f64>],
    /// Boxes that stand beside the object.
    pub surroundings: &'a [FixedBox],
}

/// What the pointer did.
#[derive(Debug, Default)]
pub(super) struct ViewResponse {
    /// Channel under the pointer.
    pub hovered: Option<usize>,
    /// Channel that was clicked.
    pub clicked: Option<usize>,
    /// The picture's own response, for tooltips.
    pub response: Option<egui::Response>,
}

impl ViewState {
    /// The meshes of `station`; made anew when it changes, and the camera then starts over.
    pub(super) fn geometry_of(&mut self, station: &Arc<Station>) -> Arc<Geometry> {
        if let Some((known, geometry)) = &self.geometry
            && Arc::ptr_eq(known, station)
        {
            return Arc::clone(geometry);
        }
        let geometry = Arc::new(Geometry::new(station));
        self.geometry = Some((Arc::clone(station), Arc::clone(&geometry)));
        self.camera = None;
        self.flight = None;
        self.last_root = None;
        geometry
    }

    /// Flies to a named view.
    pub(super) fn look_at(&mut self, geometry: &Geometry, moment: &Moment<'_>, view: &View) {
        let (bounds, toward_eye, up) =
            geometry.framing(moment.station, moment.root_from_link, moment.object, &view.subject);
        self.fly_to(clear_camera(geometry, moment, bounds, [toward_eye, up], self.last_aspect, self.shown));
    }

    /// Flies to where the view began.
    pub(super) fn reset(&mut self, geometry: &Geometry, moment: &Moment<'_>) {
        self.fly_to(home(geometry, moment, self.last_aspect, self.shown));
    }

    fn fly_to(&mut self, to: Camera) {
        match self.camera {
            Some(from) => self.flight = Some(Flight { from, to, share: 0.0 }),
            None => self.camera = Some(to),
        }
    }

    /// The camera of this frame: flights move on, and it follows the hand.
    fn advance(
        &mut self,
        ctx: &egui::Context,
        geometry: &Geometry,
        moment: &Moment<'_>,
        aspect: f32,
    ) -> Camera {
        self.last_aspect = aspect;
        let mut camera = self.camera.unwrap_or_else(|| home(geometry, moment, aspect, self.shown));
        if let Some(flight) = &mut self.flight {
            flight.share = (flight.share + ctx.input(|input| input.stable_dt) / FLIGHT_S).min(1.0);
            // Starts and lands softly (smoothstep).
            let eased = flight.share * flight.share * (3.0 - 2.0 * flight.share);
            camera = flight.from.toward(&flight.to, eased);
            if flight.share >= 1.0 {
                camera = flight.to;
                self.flight = None;
            } else {
                ctx.request_repaint();
            }
        }
        let root = moment
            .root_from_link
            .get(geometry.hand_root)
            .map(|pose| Point3::from(pose.translation.vector.cast::<f32>()));
        if self.follow
            && let (Some(root), Some(last)) = (root, self.last_root)
        {
            let moved = root - last;
            camera.target += moved;
            if let Some(flight) = &mut self.flight {
                flight.from.target += moved;
                flight.to.target += moved;
            }
        }
        self.last_root = root;
        self.camera = Some(camera);
        camera
    }

    fn steer(&mut self, ui: &egui::Ui, response: &egui::Response, rect: Rect) {
        if let Some(camera) = &mut self.camera
            && steer(camera, ui, response, rect)
        {
            self.flight = None;
        }
    }
}

/// Turns, moves and zooms by pointer, touch and keys; whether anything changed.
pub(super) fn steer(camera: &mut Camera, ui: &egui::Ui, response: &egui::Response, rect: Rect) -> bool {
    let before = *camera;
    let (drag, shift) = (response.drag_delta() / rect.height(), ui.input(|input| input.modifiers.shift));
    let pans =
        response.dragged_by(PointerButton::Secondary) || response.dragged_by(PointerButton::Middle) || shift;
    if response.dragged() && pans {
        camera.pan(-drag.x, drag.y);
    } else if response.dragged() {
        camera.orbit(-drag.x * ORBIT_RAD_PER_HEIGHT, drag.y * ORBIT_RAD_PER_HEIGHT);
    }
    if response.contains_pointer() {
        let (scroll, pinch) = ui.input(|input| (input.smooth_scroll_delta().y, input.zoom_delta()));
        camera.zoom((scroll * 0.0016).exp() * pinch);
    }
    if response.has_focus() {
        ui.input(|input| {
            let step = input.stable_dt * 1.5;
            let held = |key| if input.key_down(key) { step } else { 0.0 };
            camera.orbit(
                held(Key::ArrowRight) - held(Key::ArrowLeft),
                held(Key::ArrowUp) - held(Key::ArrowDown),
            );
            camera.zoom((held(Key::Plus) + held(Key::Equals) - held(Key::Minus)).exp());
        });
    }
    let changed = *camera != before;
    if changed {
        ui.ctx().request_repaint();
    }
    changed
}

/// The view that the screen opens with: hand and object from before and a little above, the fingers in sight.
pub(super) fn home(geometry: &Geometry, moment: &Moment<'_>, aspect: f32, shown: Shown) -> Camera {
    let (bounds, front, up) =
        geometry.framing(moment.station, moment.root_from_link, moment.object, &Subject::Front);
    let front = front.try_normalize(1e-6).unwrap_or(Vector3::x());
    let up = (up - front * up.dot(&front)).try_normalize(1e-6).unwrap_or(Vector3::z());
    let side = up.cross(&front);
    // A little off the touching side, for some depth. Which way the eye leans decides what is up on the screen when it
    // looks steeply down or up (see `Camera::framing`): the fingers should be.
    let lean = if front.z < -0.5 {
        up * 0.45
    } else if front.z > 0.5 {
        up * -0.45
    } else {
        side * 0.45
    };
    let toward_eye = front + lean + side * 0.1;
    clear_camera(geometry, moment, bounds, [toward_eye, up], aspect, shown)
}

/// A camera that sees `bounds` from the side `toward_eye`, or as near to that side as what carries the hand (an arm, a
/// table) leaves the taxels in sight.
pub(super) fn clear_camera(
    geometry: &Geometry,
    moment: &Moment<'_>,
    bounds: Bounds,
    [toward_eye, up]: [Vector3<f32>; 2],
    aspect: f32,
    shown: Shown,
) -> Camera {
    const ENOUGH_IN_SIGHT: f32 = 0.8;
    const TILTS_RAD: [f32; 4] = [0.0, 0.6, 1.2, 1.8];
    const TURNS_RAD: [f32; 8] = [0.0, 0.8, -0.8, 1.6, -1.6, 2.4, -2.4, std::f32::consts::PI];
    let direct = toward_eye.try_normalize(1e-6).unwrap_or(Vector3::x());
    // Turns are counted from the operator's side of the station, -y.
    let across = |axis: Vector3<f32>| (axis - direct * axis.dot(&direct)).try_normalize(0.1);
    let first = across(-Vector3::y()).or_else(|| across(Vector3::x())).unwrap_or(Vector3::z());
    let second = direct.cross(&first);
    let mut best: Option<(f32, Camera)> = None;
    for tilt_rad in TILTS_RAD {
        for turn_rad in TURNS_RAD {
            let aside = first * turn_rad.cos() + second * turn_rad.sin();
            let direction = direct * tilt_rad.cos() + aside * tilt_rad.sin();
            let camera = Camera::framing(bounds, direction, up, aspect);
            let share = geometry.share_in_sight(moment.station, moment.root_from_link, &camera.eye(), shown);
            if share >= ENOUGH_IN_SIGHT {
                return camera;
            }
            if best.as_ref().is_none_or(|(most, _)| share > *most) {
                best = Some((share, camera));
            }
        }
    }
    best.map_or_else(|| Camera::framing(bounds, direct, up, aspect), |(_, camera)| camera)
}

/// Draws the scene into `rect` and lets the pointer steer and pick.
pub(super) fn view3d_ui(
    ui: &mut egui::Ui,
    rect: Rect,
    state: &mut ViewState,
    geometry: &Arc<Geometry>,
    moment: &Moment<'_>,
    palette: &Palette,
    surface: Option<Surface>,
) -> ViewResponse {
    let response = ui.interact(rect, ui.scope_id().with("view3d"), Sense::click_and_drag());
    response.widget_info(|| {
        egui::WidgetInfo::labeled(
            Role::Canvas,
            true,
            "3-D view of the hand: drag to turn, shift-drag to move, wheel to zoom; arrow keys turn, plus and minus zoom",
        )
    });
    keep_arrow_keys(ui, &response);
    let aspect = rect.width() / rect.height().max(1.0);
    state.advance(ui.ctx(), geometry, moment, aspect);
    state.steer(ui, &response, rect);
    let Some(camera) = state.camera else { return ViewResponse::default() };

    let colors = scene_colors(palette);
    let object_if_shown = moment.object.filter(|_| state.shown.object);
    let painter = ui.painter_at(rect);
    if let Some(surface) = surface {
        let mut instances = geometry.instances(
            moment.station,
            moment.root_from_link,
            moment.looks,
            object_if_shown,
            &colors,
            state.shown,
        );
        if state.shown.object {
            instances.extend(geometry.boxes(moment.surroundings, colors.surroundings));
        }
        if state.ghost {
            let [from, to] = [moment.root_from_link, moment.commanded_from_link];
            instances.extend(geometry.ghost(from, to, colors.ghost, state.shown));
        }
        let scene = Scene {
            geometry: Arc::clone(geometry),
            instances,
            globals: globals(&camera, aspect, palette),
            background: background(palette),
        };
        let drawing = state.detail.drawing(ui.ctx(), scene);
        let paint = ScenePaint { drawing, size_points: rect.size(), surface };
        painter.add(egui_wgpu::Callback::new_paint_callback(rect, paint));
    } else {
        painter.rect_filled(rect, 6.0, palette.surface);
    }
    marks_ui(&painter, rect, geometry, moment, &camera, state.shown, palette);
    if state.labels {
        labels_ui(&painter, rect, geometry, moment, &camera, aspect, palette);
    }
    if response.has_focus() {
        painter.rect_stroke(rect, 6.0, egui::Stroke::new(2.0, palette.calibrated), egui::StrokeKind::Inside);
    }

    let picked = response.hover_pos().and_then(|pos| {
        let ndc = to_ndc(pos, rect);
        let slack_per_m =
            PICK_SLACK_POINTS / rect.height() * camera.height_at(&camera.target) / camera.distance_m;
        geometry.pick(
            moment.station,
            moment.root_from_link,
            &camera.ray(ndc, aspect),
            slack_per_m,
            state.shown,
        )
    });
    ViewResponse { hovered: picked, clicked: picked.filter(|_| response.clicked()), response: Some(response) }
}

/// Arrow keys turn what has the focus; they must not move the focus away.
pub(super) fn keep_arrow_keys(ui: &egui::Ui, response: &egui::Response) {
    if response.has_focus() {
        ui.memory_mut(|memory| {
            memory.set_focus_lock_filter(
                response.id,
                egui::EventFilter {
                    horizontal_arrows: true,
                    vertical_arrows: true,
                    ..egui::EventFilter::default()
                },
            );
        });
    }
}

fn to_ndc(pos: Pos2, rect: Rect) -> [f32; 2] {
    let share = (pos - rect.min) / rect.size();
    [share.x * 2.0 - 1.0, 1.0 - share.y * 2.0]
}

/// Rings around what is picked, as on the flat map, where nothing is before it.
fn marks_ui(
    painter: &egui::Painter,
    rect: Rect,
    geometry: &Geometry,
    moment: &Moment<'_>,
    camera: &Camera,
    shown: Shown,
    palette: &Palette,
) {
    let aspect = rect.width() / rect.height().max(1.0);
    for (channel, place) in geometry.taxels(moment.station, moment.root_from_link).iter().enumerate() {
        if !moment.looks.get(channel).is_some_and(|look| look.marked) {
            continue;
        }
        let Some(ndc) = camera.project(&place.position, aspect) else { continue };
        let seen = geometry.pick(moment.station, moment.root_from_link, &camera.ray(ndc, aspect), 0.0, shown);
        if seen == Some(channel) {
            let at = rect.min + Vec2::new((ndc[0] + 1.0) / 2.0, (1.0 - ndc[1]) / 2.0) * rect.size();
            let radius = place.radius_m / camera.height_at(&place.position) * rect.height() * 1.8 + 3.0;
            painter.circle_stroke(at, radius, egui::Stroke::new(5.0, palette.surface));
            painter.circle_stroke(at, radius, egui::Stroke::new(2.5, palette.calibrated));
        }
    }
}

fn labels_ui(
    painter: &egui::Painter,
    rect: Rect,
    geometry: &Geometry,
    moment: &Moment<'_>,
    camera: &Camera,
    aspect: f32,
    palette: &Palette,
) {
    let places = geometry.taxels(moment.station, moment.root_from_link);
    let mut taken: Vec<Rect> = Vec::new();
    for patch in &moment.station.layout.patches {
        let of_patch = &places[patch.channels.clone()];
        let Some(first) = of_patch.first() else { continue };
        let middle =
            of_patch.iter().map(|place| place.position.coords).sum::<Vector3<f32>>() / of_patch.len() as f32;
        if first.normal.dot(&(camera.eye() - Point3::from(middle))) < 0.0 {
            continue;
        }
        if let Some([x, y]) = camera.project(&Point3::from(middle), aspect) {
            let at =
                rect.min + Vec2::new((x + 1.0) / 2.0, (1.0 - y) / 2.0) * rect.size() + Vec2::new(14.0, -14.0);
            let galley =
                painter.layout_no_wrap(patch.label.clone(), FontId::proportional(13.0), palette.real);
            let ground = Align2::LEFT_BOTTOM.anchor_size(at, galley.size());
            // A name over another cannot be read: the first one stays.
            if taken.iter().any(|other| other.intersects(ground)) {
                continue;
            }
            taken.push(ground);
            painter.rect_filled(ground.expand(2.0), 3.0, palette.surface.gamma_multiply(0.8));
            painter.galley(ground.min, galley, palette.real);
        }
    }
}

fn scene_colors(palette: &Palette) -> SceneColors {
    let linear = |color: Color32, alpha: f32| {
        let rgba = Rgba::from(color);
        [rgba.r(), rgba.g(), rgba.b(), alpha]
    };
    if palette.dark {
        SceneColors {
            body: [0.62, 0.64, 0.68, 1.0],
            skin: linear(Color32::from_rgb(0x4a, 0x4d, 0x55), 1.0),
            object: linear(Color32::from_rgb(0xb9, 0xa8, 0x8c), 0.45),
            ghost: linear(palette.text_weak, 0.2),
            surroundings: linear(palette.text_weak, 0.25),
        }
    } else {
        SceneColors {
            body: [0.78, 0.79, 0.81, 1.0],
            skin: linear(Color32::from_rgb(0x6a, 0x6d, 0x75), 1.0),
            object: linear(Color32::from_rgb(0xb0, 0x98, 0x72), 0.45),
            ghost: linear(palette.text_weak, 0.2),
            surroundings: linear(palette.text_weak, 0.25),
        }
    }
}

pub(super) fn background(palette: &Palette) -> [f64; 4] {
    let [r, g, b, _] = palette.surface.to_array();
    [r, g, b, 255].map(|value| f64::from(value) / 255.0)
}

pub(super) fn globals(camera: &Camera, aspect: f32, palette: &Palette) -> Globals {
    let four = |v: Vector3<f32>, w: f32| [v.x, v.y, v.z, w];
    let [right, up, back] = camera.axes();
    // The lamp stands over the left shoulder of whoever looks, but never below the table.
    let mut lamp = back * 0.6 + up * 0.7 - right * 0.5;
    lamp.z = lamp.z.max(0.15);
    let linear = |color: Color32| {
        let rgba = Rgba::from(color);
        Vector3::new(rgba.r(), rgba.g(), rgba.b())
    };
    let (sky, ground, strength, lines) =
        if palette.dark { (0.42, 0.2, 0.55, 0.5) } else { (0.52, 0.3, 0.55, 0.55) };
    Globals {
        clip_from_world: camera.clip_from_world(aspect).into(),
        eye: four(camera.eye().coords, 1.0),
        lamp: four(lamp.normalize(), strength),
        sky: [sky, sky, sky * 1.04, 1.0],
        ground: [ground * 1.02, ground, ground * 0.98, 1.0],
        mark: four(linear(palette.real), 1.0),
        // From below the ground, its lines would lie over everything.
        grid_color: four(linear(palette.text_weak), if camera.eye().z > 0.0 { lines } else { lines * 0.3 }),
        grid: [camera.target.x, camera.target.y, (camera.distance_m * 2.2).clamp(0.6, 4.0), 0.1],
    }
}
