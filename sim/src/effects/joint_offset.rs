//! A joint whose zero is not where it should be.

use palpate_robot_model::{Place, Station};

use super::{
    DynFrameEffect, Effect, EffectKind, Frame, FrameEffect, Kinematics, Parameter, Stage, TakeScene, places,
};

/// The joint stands `offset_rad` further than it reports.
pub(super) struct JointOffset;

impl EffectKind for JointOffset {
    fn id(&self) -> &'static str {
        "joint_offset"
    }

    fn stage(&self) -> Stage {
        Stage::Kinematics
    }

    fn explain(&self, effect: &Effect, station: &Station) -> String {
        format!(
            "{} stands {:+.1} mrad from where it reports.",
            places::title(&effect.place, station),
            effect.parameter("offset_rad") * 1e3
        )
    }

    fn signature(&self) -> &'static str {
        "a shift of contact that changes sign with the side the joint touches from"
    }

    fn parameters(&self, _place: &Place, _station: &Station) -> Vec<Parameter> {
        vec![Parameter::new("offset_rad", -0.1..=0.1, 0.0, 0.004, 0.008)]
    }

    fn places(&self, station: &Station) -> Vec<Place> {
        places::revolute_joints(station)
    }

    fn kinematics(&self, effect: &Effect, scene: &TakeScene<'_>, state: &mut Kinematics<'_>) {
        let Some(dof) = places::dof_of(&effect.place, scene.station) else { return };
        let (num_dofs, offset_rad) = (scene.station.robot.num_dofs(), effect.parameter("offset_rad"));
        for frame in state.positions.to_mut().chunks_exact_mut(num_dofs) {
            frame[dof] += offset_rad;
        }
    }

    fn joints_by_frame(&self, effect: &Effect, station: &Station) -> Option<DynFrameEffect> {
        let dof = places::dof_of(&effect.place, station)?;
        Some(Box::new(Shift { dof, offset_rad: effect.parameter("offset_rad") }))
    }
}

#[derive(Debug)]
struct Shift {
    dof: usize,
    offset_rad: f64,
}

impl FrameEffect for Shift {
    fn step(&self, _frame: &Frame<'_>, _memory: &mut [f64], positions: &mut [f64]) {
        positions[self.dof] += self.offset_rad;
    }
}
