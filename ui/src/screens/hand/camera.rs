//! The eye of the 3-D view: it circles a point, with z up.

use nalgebra::{Matrix4, Perspective3, Point3, Unit, UnitVector3, Vector3};

/// Vertical opening angle. Narrow, so that a hand looks like a hand and not like a photograph from a hand's width.
const VERTICAL_FOV_RAD: f32 = 0.55;
/// The camera never stands exactly above or below its target, where "up" would have no direction on the screen.
const MAX_PITCH_RAD: f32 = 1.555;
const MIN_DISTANCE_M: f32 = 0.03;
const MAX_DISTANCE_M: f32 = 8.0;
/// How far from the base the target may be moved; beyond it there is nothing to see and no way back but reset.
const MAX_TARGET_M: f32 = 5.0;

/// An orbiting camera. It looks at `target` from `distance_m` away.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Camera {
    /// The point in the middle of the picture, m, in the robot's root frame.
    pub target: Point3<f32>,
    /// Direction from the target to the eye, about z from x, rad.
    pub yaw_rad: f32,
    /// Direction from the target to the eye, above the horizontal, rad.
    pub pitch_rad: f32,
    /// From the target to the eye, m.
    pub distance_m: f32,
}

/// A half-line, for picking.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ray {
    /// Where it starts.
    pub origin: Point3<f32>,
    /// Where it goes.
    pub direction: UnitVector3<f32>,
}

/// A ball around what should be in the picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Bounds {
    /// Its middle, m.
    pub center: Point3<f32>,
    /// Its radius, m.
    pub radius_m: f32,
}

impl Bounds {
    /// A ball around `points`: about their bounding box's middle. `None` without points.
    pub(super) fn around(points: impl IntoIterator<Item = Point3<f32>> + Clone) -> Option<Self> {
        let (low, high) =
            points.clone().into_iter().fold(None, |bounds: Option<(Point3<f32>, Point3<f32>)>, p| {
                let (low, high) = bounds.unwrap_or((p, p));
                Some((low.inf(&p), high.sup(&p)))
            })?;
        let center = nalgebra::center(&low, &high);
        let radius_m = points.into_iter().map(|p| (p - center).norm()).fold(0.0, f32::max);
        Some(Self { center, radius_m })
    }
}

impl Camera {
    /// A camera that sees all of `bounds`, from the side `toward_eye`. Seen from straight above or below, `screen_up`
    /// points up on the screen; from anywhere else z does.
    pub(super) fn framing(
        bounds: Bounds,
        toward_eye: Vector3<f32>,
        screen_up: Vector3<f32>,
        aspect: f32,
    ) -> Self {
        let toward_eye = Unit::try_new(toward_eye, 1e-6).unwrap_or(Vector3::x_axis());
        let pitch_rad = toward_eye.z.clamp(-1.0, 1.0).asin().clamp(-MAX_PITCH_RAD, MAX_PITCH_RAD);
        // Near the poles the horizontal part of the direction is noise: the wanted up direction decides instead.
        // Looking down, what is behind the target as seen from the eye is up on the screen; looking up, what is before it.
        let horizontal = if toward_eye.xy().norm() > 0.2 {
            toward_eye.xy()
        } else if toward_eye.z > 0.0 {
            -screen_up.xy()
        } else {
            screen_up.xy()
        };
        let yaw_rad = if horizontal.norm() > 1e-6 { horizontal.y.atan2(horizontal.x) } else { 0.0 };
        let half_fov =
            (VERTICAL_FOV_RAD / 2.0).min(((VERTICAL_FOV_RAD / 2.0).tan() * aspect.max(0.1)).atan());
        let mut camera =
            Self { target: bounds.center, yaw_rad, pitch_rad, distance_m: bounds.radius_m / half_fov.sin() };
        camera.confine();
        camera
    }

    /// Turns about the target by angles, rad: `right` moves the eye to the right, `up` lifts it.
    pub(super) fn orbit(&mut self, right_rad: f32, up_rad: f32) {
        self.yaw_rad += right_rad;
        self.pitch_rad += up_rad;
        self.confine();
    }

    /// Moves the target along the screen, in heights of the picture.
    pub(super) fn pan(&mut self, right_heights: f32, up_heights: f32) {
        let height_m = 2.0 * self.distance_m * (VERTICAL_FOV_RAD / 2.0).tan();
        let [right, up, _] = self.axes();
        self.target += (right * right_heights + up * up_heights) * height_m;
        self.confine();
    }

    /// Comes nearer by `factor` above one, goes away below one.
    pub(super) fn zoom(&mut self, factor: f32) {
        if factor > 0.0 {
            self.distance_m /= factor;
        }
        self.confine();
    }

    /// Between this camera at `share` 0 and `other` at 1, turning the shorter way.
    pub(super) fn toward(&self, other: &Self, share: f32) -> Self {
        let turn = (other.yaw_rad - self.yaw_rad + std::f32::consts::PI).rem_euclid(std::f32::consts::TAU)
            - std::f32::consts::PI;
        Self {
            target: self.target + (other.target - self.target) * share,
            yaw_rad: self.yaw_rad + turn * share,
            pitch_rad: self.pitch_rad + (other.pitch_rad - self.pitch_rad) * share,
            distance_m: self.distance_m * (other.distance_m / self.distance_m).powf(share),
        }
    }

    /// Where the eye is.
    pub(super) fn eye(&self) -> Point3<f32> {
        self.target + self.toward_eye() * self.distance_m
    }

    /// Unit vectors to the right, up and toward the eye.
    pub(super) fn axes(&self) -> [Vector3<f32>; 3] {
        let back = self.toward_eye();
        let right = Vector3::z().cross(&back).normalize();
        [right, back.cross(&right), back]
    }

    /// World to clip coordinates with depth 0 to 1, as wgpu has it.
    pub(super) fn clip_from_world(&self, aspect: f32) -> Matrix4<f32> {
        let view_from_world = Matrix4::look_at_rh(&self.eye(), &self.target, &Vector3::z());
        let near_m = (self.distance_m * 0.02).clamp(0.002, 0.1);
        let perspective = Perspective3::new(aspect.max(0.01), VERTICAL_FOV_RAD, near_m, 4.0 * MAX_DISTANCE_M);
        #[rustfmt::skip]
        let half_depth = Matrix4::new(
            1.0, 0.0, 0.0, 0.0,
            0.0, 1.0, 0.0, 0.0,
            0.0, 0.0, 0.5, 0.5,
            0.0, 0.0, 0.0, 1.0,
        );
        half_depth * perspective.to_homogeneous() * view_from_world
    }

    /// The ray through a point of the picture, in -1 to 1 (x right, y up).
    pub(super) fn ray(&self, ndc: [f32; 2], aspect: f32) -> Ray {
        let [right, up, back] = self.axes();
        let half_height = (VERTICAL_FOV_RAD / 2.0).tan();
        let direction = right * (ndc[0] * half_height * aspect) + up * (ndc[1] * half_height) - back;
        Ray { origin: self.eye(), direction: Unit::new_normalize(direction) }
    }

    /// Where a point is in the picture, in -1 to 1; `None` behind the eye.
    pub(super) fn project(&self, point: &Point3<f32>, aspect: f32) -> Option<[f32; 2]> {
        let clip = self.clip_from_world(aspect) * point.to_homogeneous();
        (clip.w > 1e-4).then(|| [clip.x / clip.w, clip.y / clip.w])
    }

    /// Metres that one picture height spans at `point`.
    pub(super) fn height_at(&self, point: &Point3<f32>) -> f32 {
        let depth_m = (self.eye() - point).dot(&self.toward_eye()).max(MIN_DISTANCE_M);
        2.0 * depth_m * (VERTICAL_FOV_RAD / 2.0).tan()
    }

    fn toward_eye(&self) -> Vector3<f32> {
        let (sin_yaw, cos_yaw) = self.yaw_rad.sin_cos();
        let (sin_pitch, cos_pitch) = self.pitch_rad.sin_cos();
        Vector3::new(cos_pitch * cos_yaw, cos_pitch * sin_yaw, sin_pitch)
    }

    fn confine(&mut self) {
        self.yaw_rad = self.yaw_rad.rem_euclid(std::f32::consts::TAU);
        self.pitch_rad = self.pitch_rad.clamp(-MAX_PITCH_RAD, MAX_PITCH_RAD);
        self.distance_m = self.distance_m.clamp(MIN_DISTANCE_M, MAX_DISTANCE_M);
        self.target.coords.apply(|value| *value = value.clamp(-MAX_TARGET_M, MAX_TARGET_M));
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    prop_compose! {
        fn any_camera()(x in -2.0f32..2.0, y in -2.0f32..2.0, z in -2.0f32..2.0, yaw in -9.0f32..9.0, pitch in -3.0f32..3.0, distance in 0.0f32..9.0) -> Camera {
            let mut camera = Camera { target: Point3::new(x, y, z), yaw_rad: yaw, pitch_rad: pitch, distance_m: distance };
            camera.confine();
            camera
        }
    }

    proptest! {
        #[test]
        fn the_ray_through_a_projected_point_meets_the_point(camera in any_camera(), x in -0.9f32..0.9, y in -0.9f32..0.9, aspect in 0.4f32..3.0, share in 0.3f32..3.0) {
            let ray = camera.ray([x, y], aspect);
            let point = ray.origin + ray.direction.into_inner() * (camera.distance_m * share);
            let ndc = camera.project(&point, aspect).expect("before the eye");
            prop_assert!((ndc[0] - x).abs() < 2e-3 && (ndc[1] - y).abs() < 2e-3, "{ndc:?} is not {x}, {y}");
        }

        #[test]
        fn a_framed_ball_is_wholly_in_the_picture(radius in 0.02f32..0.8, dx in -1.0f32..1.0, dy in -1.0f32..1.0, dz in -1.0f32..1.0, aspect in 0.4f32..3.0, px in -1.0f32..1.0, py in -1.0f32..1.0, pz in -1.0f32..1.0) {
            let bounds = Bounds { center: Point3::new(0.3, -0.1, 0.4), radius_m: radius };
            let camera = Camera::framing(bounds, Vector3::new(dx, dy, dz), Vector3::x(), aspect);
            let on_ball = Unit::try_new(Vector3::new(px, py, pz), 1e-3).unwrap_or(Vector3::z_axis());
            let ndc = camera.project(&(bounds.center + on_ball.into_inner() * radius), aspect).expect("before the eye");
            prop_assert!(ndc[0].abs() < 1.01 && ndc[1].abs() < 1.01, "{ndc:?}");
        }

        #[test]
        fn no_gesture_makes_the_camera_useless(camera in any_camera(), right in -20.0f32..20.0, up in -20.0f32..20.0, pan in -20.0f32..20.0, zoom in 0.0f32..1e4) {
            let mut camera = camera;
            camera.orbit(right, up);
            camera.pan(pan, -pan);
            camera.zoom(zoom);
            prop_assert!(camera.clip_from_world(1.5).iter().all(|value| value.is_finite()));
            let seen = camera.project(&camera.target, 1.5).expect("the target is before the eye");
            prop_assert!(seen[0].abs() < 1e-3 && seen[1].abs() < 1e-3);
        }

        #[test]
        fn panning_moves_the_picture_with_the_pointer(camera in any_camera(), right in -0.4f32..0.4, up in -0.4f32..0.4) {
            let grabbed = camera.target;
            let mut camera = camera;
            camera.pan(-right, -up);
            prop_assume!((camera.target - grabbed).norm() > 1e-6);
            prop_assume!(camera.target.iter().all(|v| v.abs() < MAX_TARGET_M));
            let ndc = camera.project(&grabbed, 1.0).expect("before the eye");
            prop_assert!((ndc[0] / 2.0 - right).abs() < 5e-3 && (ndc[1] / 2.0 - up).abs() < 5e-3, "{ndc:?} for {right}, {up}");
        }

        #[test]
        fn a_move_between_cameras_begins_and_ends_at_them(from in any_camera(), to in any_camera()) {
            let end = from.toward(&to, 1.0);
            prop_assert!((end.eye() - to.eye()).norm() < 1e-3);
            prop_assert!((from.toward(&to, 0.0).eye() - from.eye()).norm() < 1e-4);
            let halfway = from.toward(&to, 0.5);
            prop_assert!((halfway.yaw_rad - from.yaw_rad).abs() <= std::f32::consts::FRAC_PI_2 + 1e-3);
        }
    }

    #[test]
    fn seen_from_straight_below_the_wanted_direction_is_up() {
        let bounds = Bounds { center: Point3::origin(), radius_m: 0.1 };
        for (toward_eye, up) in
            [(-Vector3::z(), Vector3::x()), (Vector3::z(), Vector3::y()), (-Vector3::z(), -Vector3::y())]
        {
            let camera = Camera::framing(bounds, toward_eye, up, 1.0);
            let ndc = camera.project(&Point3::from(up * 0.05), 1.0).expect("before the eye");
            assert!(ndc[1] > 0.1 && ndc[0].abs() < 1e-3, "{ndc:?}");
        }
    }

    #[test]
    fn depth_grows_from_zero_to_one() {
        let camera = Camera { target: Point3::origin(), yaw_rad: 0.3, pitch_rad: 0.2, distance_m: 1.0 };
        let depth_of = |point: Point3<f32>| {
            let clip = camera.clip_from_world(1.0) * point.to_homogeneous();
            clip.z / clip.w
        };
        let [_, _, back] = camera.axes();
        let near = depth_of(camera.target + back * 0.5);
        let far = depth_of(camera.target - back * 0.5);
        assert!(0.0 < near && near < far && far < 1.0, "{near} {far}");
    }
}
