//! Volume integrals that add up over parts.

use std::ops::{AddAssign, SubAssign};

use nalgebra::{Isometry3, Matrix3, Point3, Translation3, Vector3};

/// Integrals over a body, about the origin.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Moments {
    /// Integral of 1.
    pub(super) volume_m3: f64,
    /// Integral of x.
    pub(super) first_m4: Vector3<f64>,
    /// Integral of x x^T.
    pub(super) second_m5: Matrix3<f64>,
}

impl Moments {
    /// Of a body that is symmetric about its own three planes, placed by `object_from_part`: `mean_squares_m2` are its
    /// mean squared coordinates.
    pub(super) fn of_symmetric(
        volume_m3: f64,
        mean_squares_m2: Vector3<f64>,
        object_from_part: &Isometry3<f64>,
    ) -> Self {
        let rotation: Matrix3<f64> = object_from_part.rotation.to_rotation_matrix().into_inner();
        let center = object_from_part.translation.vector;
        let spread = rotation * Matrix3::from_diagonal(&mean_squares_m2) * rotation.transpose();
        Self {
            volume_m3,
            first_m4: center * volume_m3,
            second_m5: (spread + center * center.transpose()) * volume_m3,
        }
    }

    /// Of a closed surface of outward triangles: signed tetrahedra from the origin, each with
    /// `integral of x x^T = V / 20 (sum v v^T + (sum v)(sum v)^T)` over its corners v.
    pub(super) fn of_surface(vertices: &[Point3<f64>], triangles: &[[u32; 3]]) -> Self {
        let mut sum = Self::default();
        for triangle in triangles {
            let [a, b, c] = triangle.map(|i| vertices[i as usize].coords);
            let volume_m3 = a.dot(&b.cross(&c)) / 6.0;
            let corners = a + b + c;
            let squares = a * a.transpose() + b * b.transpose() + c * c.transpose();
            sum += Self {
                volume_m3,
                first_m4: corners * (volume_m3 / 4.0),
                second_m5: (squares + corners * corners.transpose()) * (volume_m3 / 20.0),
            };
        }
        sum
    }

    /// Of an upright column about `(x, y)`, `size_m` wide, from `low` to `high`.
    pub(super) fn of_column([x, y]: [f64; 2], size_m: [f64; 2], low: f64, high: f64) -> Self {
        let size = Vector3::new(size_m[0], size_m[1], high - low);
        let center = Translation3::new(x, y, 0.5 * (low + high));
        let mean_squares = size.component_mul(&size) / 12.0;
        Self::of_symmetric(size.product(), mean_squares, &center.into())
    }

    pub(super) fn centroid(&self) -> Point3<f64> {
        Point3::from(self.first_m4 / self.volume_m3)
    }

    /// Inertia about the centroid for a density of 1: `tr(S) 1 - S` of the central second moments S.
    pub(super) fn inertia_m5(&self) -> Matrix3<f64> {
        let center = self.centroid().coords;
        let central = self.second_m5 - center * center.transpose() * self.volume_m3;
        Matrix3::identity() * central.trace() - central
    }
}

impl AddAssign for Moments {
    fn add_assign(&mut self, other: Self) {
        self.volume_m3 += other.volume_m3;
        self.first_m4 += other.first_m4;
        self.second_m5 += other.second_m5;
    }
}

impl SubAssign for Moments {
    fn sub_assign(&mut self, other: Self) {
        self.volume_m3 -= other.volume_m3;
        self.first_m4 -= other.first_m4;
        self.second_m5 -= other.second_m5;
    }
}
