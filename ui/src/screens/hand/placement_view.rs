//! Where an object goes before a take, and where the hand will start: the station as it stands, the object as the plan has
//! it, and a ghost of the hand at the start of the motion.

use std::sync::Arc;

use egui::{Rect, Rgba};
use nalgebra::Isometry3;
use palpate_robot_model::Station;

use super::{
    scene::TaxelLook,
    signal::pose_from,
    view3d::{Moment, ViewState, view3d_ui},
};
use crate::{surface::Surface, theme::Palette};

/// A joint that moves by less, rad or m, is drawn where it was: the noise of a robot that stands still is no reason to draw
/// the scene anew.
const STILL: f64 = 0.02;

/// What is remembered between frames.
pub struct PlacementView {
    view: ViewState,
    /// Where joints are drawn.
    positions: Vec<f64>,
}

impl Default for PlacementView {
    fn default() -> Self {
        // The camera stays with the object while the hand moves.
        let mut view = ViewState::default();
        view.follow = false;
        Self { view, positions: Vec::new() }
    }
}

/// What is to be placed, and for which motion.
pub struct Placement<'a> {
    /// The station.
    pub station: &'a Arc<Station>,
    /// Where its joints are, rad or m; empty where that is not known.
    pub positions: &'a [f64],
    /// Where they are when the motion starts, rad or m.
    pub start: &'a [f64],
    /// Id of the object.
    pub object: &'a str,
    /// Where it goes.
    pub base_from_object: Isometry3<f64>,
}

impl<'a> Placement<'a> {
    /// As a step of the checklist says it; `None` where it does not belong to `station`.
    pub fn new(
        station: &'a Arc<Station>,
        positions: &'a [f64],
        start: &'a [f64],
        (object, pose): (&'a str, &[f64]),
    ) -> Option<Self> {
        let num_dofs = station.robot.num_dofs();
        let fits = |positions: &[f64]| {
            positions.len() == num_dofs && positions.iter().all(|position| position.is_finite())
        };
        let base_from_object = pose_from(pose)?;
        let is_known = station.objects.contains_key(object);
        let positions = if fits(positions) { positions } else { start };
        (fits(start) && is_known).then_some(Self { station, positions, start, object, base_from_object })
    }
}

impl PlacementView {
    /// Draws `placement` into `rect`; pointer and keys turn it.
    pub fn ui(
        &mut self,
        ui: &mut egui::Ui,
        rect: Rect,
        placement: &Placement<'_>,
        palette: &Palette,
        surface: Option<Surface>,
    ) {
        let Placement { station, positions, start, object, base_from_object } = placement;
        let moved = |(at, drawn): (&f64, &f64)| (at - drawn).abs() > STILL;
        if self.positions.len() != positions.len() || positions.iter().zip(&self.positions).any(moved) {
            self.positions = positions.to_vec();
        }
        let (mut root_from_link, mut start_from_link) = (Vec::new(), Vec::new());
        station.robot.forward_kinematics(&self.positions, &mut root_from_link);
        station.robot.forward_kinematics(start, &mut start_from_link);
        let rgba = Rgba::from(palette.dead);
        let look = TaxelLook { color: [rgba.r(), rgba.g(), rgba.b()], active: false, marked: false };
        let looks = vec![look; station.layout.num_channels()];
        let geometry = self.view.geometry_of(station);
        let moment = Moment {
            station,
            root_from_link: &root_from_link,
            looks: &looks,
            object: Some((object, base_from_object)),
            commanded_from_link: &start_from_link,
            surroundings: &[],
        };
        let seen = view3d_ui(ui, rect, &mut self.view, &geometry, &moment, palette, surface);
        if seen.response.is_some_and(|response| response.double_clicked()) {
            self.view.reset(&geometry, &moment);
        }
    }
}
