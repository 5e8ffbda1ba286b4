//! A joint with play between its encoder and its link.

use palpate_robot_model::{Place, Station};

use super::{
    DynFrameEffect, Effect, EffectKind, Frame, FrameEffect, Kinematics, Parameter, Stage, TakeScene, places,
};

/// The link stays where it is until the encoder has crossed the play: the play operator on the measured path, which
/// stays within `width_rad / 2` of it (Visintin, "Differential Models of Hysteresis", 1994, section III). It has no
/// state of direction, which the noise of an encoder at rest would toss about.
pub(super) struct JointBacklash;

impl EffectKind for JointBacklash {
    fn id(&self) -> &'static str {
        "joint_backlash"
    }

    fn stage(&self) -> Stage {
        Stage::Kinematics
    }

    fn explain(&self, effect: &Effect, station: &Station) -> String {
        format!(
            "{} has {:.1} mrad of backlash between encoder and link.",
            places::title(&effect.place, station),
            effect.parameter("width_rad") * 1e3
        )
    }

    fn signature(&self) -> &'static str {
        "contact shifts by the same distance against each direction of motion, whatever the speed"
    }

    fn parameters(&self, _place: &Place, _station: &Station) -> Vec<Parameter> {
        vec![Parameter::new("width_rad", 0.0..=0.1, 0.0, 0.006, 0.015)]
    }

    fn places(&self, station: &Station) -> Vec<Place> {
        places::revolute_joints(station)
    }

    fn kinematics(&self, effect: &Effect, scene: &TakeScene<'_>, state: &mut Kinematics<'_>) {
        let Some(dof) = places::dof_of(&effect.place, scene.station) else { return };
        let half_width_rad = 0.5 * effect.parameter("width_rad");
        if half_width_rad <= 0.0 {
            return;
        }
        let num_dofs = scene.station.robot.num_dofs();
        let mut link_rad = state.positions.get(dof).copied().unwrap_or(0.0);
        for frame in state.positions.to_mut().chunks_exact_mut(num_dofs) {
            link_rad = link_rad.clamp(frame[dof] - half_width_rad, frame[dof] + half_width_rad);
            frame[dof] = link_rad;
        }
    }

    fn joints_by_frame(&self, effect: &Effect, station: &Station) -> Option<DynFrameEffect> {
        let dof = places::dof_of(&effect.place, station)?;
        let half_width_rad = 0.5 * effect.parameter("width_rad");
        (half_width_rad > 0.0).then(|| Box::new(Play { dof, half_width_rad }) as DynFrameEffect)
    }
}

/// Remembers where the link is.
#[derive(Debug)]
struct Play {
    dof: usize,
    half_width_rad: f64,
}

impl FrameEffect for Play {
    fn memory_len(&self) -> usize {
        1
    }

    fn step(&self, frame: &Frame<'_>, memory: &mut [f64], positions: &mut [f64]) {
        let (link_rad, position) = (&mut memory[0], &mut positions[self.dof]);
        if frame.is_first {
            *link_rad = *position;
        }
        *link_rad = link_rad.clamp(*position - self.half_width_rad, *position + self.half_width_rad);
        *position = *link_rad;
    }
}
