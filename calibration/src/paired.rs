//! Takes as calibration compares them: real events beside replayed contact.

use palpate_recording::Take;
use palpate_robot_model::{SensorKind, TactileLayout};
use palpate_sim::{
    geometry::SignedDistance,
    replay::{ContactTrace, PatchTrace, contact_trace_among},
};

use crate::CalibrationError;

/// A take, replayed: what calibration compares.
#[derive(Clone, Debug)]
pub struct PairedTake {
    /// Id of the take within its session.
    pub id: String,
    /// Id of the object.
    pub object: String,
    /// Host time of each joint frame since the take's start, s.
    pub frame_times_s: Vec<f64>,
    /// Replayed contact.
    pub contact: ContactTrace,
    /// Real activation in effect at each frame, `[frame * num_channels + channel]`.
    pub real_active: Vec<bool>,
}

impl PairedTake {
    /// Replays the joint path of `take` past its object and takes the real events in effect at each joint frame.
    pub fn from_take(take: &Take) -> Result<Self, CalibrationError> {
        let fail = |problem: String| CalibrationError::Input(format!("take {:?}: {problem}", take.id));
        let station = &take.station;
        let object = station.objects.get(&take.meta.object).ok_or_else(|| {
            let known: Vec<&str> = station.objects.keys().map(String::as_str).collect();
            fail(format!(
                "touches object {:?}, which station {:?} does not know (it knows {}); add the object to the station \
                 file, or correct the take's object",
                take.meta.object,
                station.id,
                known.join(", ")
            ))
        })?;
        let distance = SignedDistance::new(&object.shape)
            .map_err(|problem| fail(format!("object {:?} cannot be touched: {problem}", object.id)))?;
        let contact = contact_trace_among(
            &station.robot,
            &station.layout,
            &distance,
            &take.meta.surroundings,
            &take.object_path(),
            &take.joints.positions,
        )
        .map_err(|err| fail(err.to_string()))?;
        let paired = Self {
            id: take.id.clone(),
            object: take.meta.object.clone(),
            frame_times_s: take.joints.times_s.clone(),
            contact,
            real_active: take.active_at_frames(),
        };
        paired.check(&station.layout)?;
        Ok(paired)
    }

    /// Number of frames.
    pub fn num_frames(&self) -> usize {
        self.frame_times_s.len()
    }

    /// Everything has the shape of `layout`, times increase, signals are numbers.
    pub(crate) fn check(&self, layout: &TactileLayout) -> Result<(), CalibrationError> {
        let fail = |problem: String| Err(CalibrationError::Input(format!("take {:?}: {problem}", self.id)));
        let (num_frames, num_channels) = (self.num_frames(), layout.num_channels());
        if self.contact.num_frames != num_frames {
            return fail(format!(
                "the replay has {} frames, but the joint log has {num_frames}; replay the whole joint log",
                self.contact.num_frames
            ));
        }
        if self.real_active.len() != num_frames * num_channels {
            return fail(format!(
                "{} real activations, but {num_frames} frames of {num_channels} channels make {}; was the take \
                 recorded with another layout?",
                self.real_active.len(),
                num_frames * num_channels
            ));
        }
        if let Some(frame) = (1..num_frames).find(|&i| {
            self.frame_times_s[i - 1].partial_cmp(&self.frame_times_s[i]).is_none_or(|o| o.is_ge())
        }) {
            return fail(format!("frame {frame} is not later than the one before it; times must increase"));
        }
        if self.contact.patches.len() != layout.patches.len() {
            return fail(format!(
                "the replay has {} patches, but the layout has {}; replay with this layout",
                self.contact.patches.len(),
                layout.patches.len()
            ));
        }
        for (patch, trace) in layout.patches.iter().zip(&self.contact.patches) {
            if let Err(problem) =
                check_patch(trace, layout.streams[patch.stream].kind, num_frames, patch.nodes.len())
            {
                return fail(format!("patch {:?}: {problem}", patch.id));
            }
        }
        Ok(())
    }
}

fn check_patch(
    trace: &PatchTrace,
    kind: SensorKind,
    num_frames: usize,
    num_nodes: usize,
) -> Result<(), String> {
    match (trace, kind) {
        (PatchTrace::Proximity { min_distance_m, .. }, SensorKind::Proximity) => {
            if min_distance_m.len() != num_frames {
                return Err(format!("{} replayed distances for {num_frames} frames", min_distance_m.len()));
            }
            match min_distance_m.iter().position(|distance_m| distance_m.is_nan()) {
                Some(frame) => Err(format!("the replayed distance of frame {frame} is not a number")),
                None => Ok(()),
            }
        }
        (PatchTrace::Pressure { offsets, entries }, SensorKind::Pressure) => {
            let ascending = offsets.windows(2).all(|two| two[0] <= two[1]);
            let ends = (offsets.first().copied(), offsets.last().map(|&end| end as usize));
            if offsets.len() != num_frames + 1 || !ascending || ends != (Some(0), Some(entries.len())) {
                return Err(format!("replayed pressures do not cover the take's {num_frames} frames"));
            }
            match entries
                .iter()
                .find(|(node, pressure_pa)| !pressure_pa.is_finite() || *node as usize >= num_nodes)
            {
                Some((node, pressure_pa)) => {
                    Err(format!("pressure {pressure_pa} Pa at node {node} of {num_nodes}"))
                }
                None => Ok(()),
            }
        }
        _ => {
            Err("replayed with another kind of sensor than the layout's; replay with this layout".to_owned())
        }
    }
}
