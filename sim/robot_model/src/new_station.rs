//! A station made from a URDF and a few words about its skin: the files that a station needs, with comments that say what to
//! change.
//!
//! [`explain()`] says what is understood of a robot, [`build`] makes the files. Both are given texts and give texts; whoever
//! calls writes them. What [`build`] gives was read back as a [`Station`], so it can be used as it is.

mod explain;
mod skin;
mod write;

use std::collections::BTreeMap;

use serde::Serialize;

pub use explain::{Follows, JointReport, LinkReport, RobotReport, explain};
pub use skin::{NewPatch, NewStream, Outward, SkinConfig};

use crate::{
    ModelError, Robot, SimplifiedUrdf, Station,
    config::{check_id, list, positive},
};

/// Name of the station file that [`build`] makes.
pub const STATION_FILE: &str = "station.toml";
/// Name of the plan file of a station that has one; its stem is the plan's id.
pub const PLAN_FILE: &str = "plans/every_patch.toml";
const ROBOT_FILE: &str = "robot.urdf";
const LAYOUT_FILE: &str = "layout.toml";
const MODEL_FILE: &str = "nominal.toml";
/// More taxels than any skin that is recorded at a useful rate; a typing error ends up here.
const MAX_TAXELS: usize = 20_000;

/// What is wanted.
#[derive(Clone, Debug)]
pub struct NewStation {
    /// Id of the station: letters, digits, `_` and `-`.
    pub id: String,
    /// Name for people.
    pub label: String,
    /// Nominal rate of the joint log, Hz.
    pub joint_rate_hz: f64,
    /// Joints of the arm that carries the hand.
    pub carrier_joints: Vec<String>,
    /// Streams, in channel order; each has at least one patch.
    pub streams: Vec<NewStream>,
    /// Patches of skin.
    pub patches: Vec<NewPatch>,
    /// Object files, relative to the station file: their paths, and all files that they need.
    pub objects: Vec<String>,
    /// Bytes of these files, by path relative to the station file.
    pub object_files: BTreeMap<String, Vec<u8>>,
    /// Text of the plan of what to record, if there is one.
    pub plan: Option<String>,
}

/// The files of a new station.
#[derive(Clone, Debug)]
pub struct BuiltStation {
    /// Bytes by path relative to the station's folder.
    pub files: BTreeMap<String, Vec<u8>>,
    /// The station, as the reader reads it.
    pub station: Station,
    /// Where the patches lie.
    pub patches: Vec<PatchReport>,
    /// What may be wrong, a sentence each.
    pub warnings: Vec<String>,
}

/// Where a patch lies.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PatchReport {
    /// Id of the patch.
    pub patch: String,
    /// The link that it is fixed to.
    pub link: String,
    /// Its stream.
    pub stream: String,
    /// Ids of its channels, as columns of recordings are called.
    pub channels: Vec<String>,
    /// Its middle in the link, m.
    pub position_m: [f64; 3],
    /// Outward normal in the link.
    pub outward: [f64; 3],
    /// Way to its upper end, along which rows count on, in the link.
    pub along: [f64; 3],
    /// Length along that way and width across, m.
    pub size_m: [f64; 2],
}

/// Makes the files of the station `wanted` for the robot that `urdf` is, which came from the file called `urdf_file`.
///
/// Refused, naming patch, stream, joint or link and what to do: what the readers of these files would refuse, a patch on a
/// link that does not exist, a robot on which nothing moves.
///
/// ```
/// use palpate_robot_model::{new_station::{NewPatch, NewStation, NewStream, build}, simplify_urdf};
///
/// let urdf = r#"<robot name="finger"><link name="base"/>
///   <link name="tip"><collision><origin xyz="0 0 0.02"/><geometry><box size="0.02 0.02 0.04"/></geometry></collision></link>
///   <joint name="curl" type="revolute"><parent link="base"/><child link="tip"/><axis xyz="0 1 0"/>
///   <limit lower="0" upper="1.5" velocity="2" effort="1"/></joint></robot>"#;
/// let urdf = simplify_urdf("finger.urdf", urdf, |_| Err("there is none".to_owned()))?;
/// let wanted = NewStation {
///     id: "finger".to_owned(),
///     label: "Finger".to_owned(),
///     joint_rate_hz: 100.0,
///     carrier_joints: Vec::new(),
///     streams: vec![NewStream::pressure("gel")],
///     patches: vec!["pad=tip:4x3@20x15:+x".parse::<NewPatch>().map_err(|problem| {
///         palpate_robot_model::ModelError::new("command line", "--patch", problem)
///     })?],
///     objects: vec!["ball.toml".to_owned()],
///     object_files: [(
///         "ball.toml".to_owned(),
///         b"id = 'ball'\nlabel = 'Ball'\nshape = { kind = 'sphere', radius_m = 0.02 }".to_vec(),
///     )].into(),
///     plan: None,
/// };
/// let built = build(&wanted, "finger.urdf", &urdf)?;
/// assert_eq!(built.station.layout.num_channels(), 12);
/// assert_eq!(built.patches[0].position_m, [0.01, 0.0, 0.02]);
/// # Ok::<(), palpate_robot_model::ModelError>(())
/// ```
pub fn build(
    wanted: &NewStation,
    urdf_file: &str,
    urdf: &SimplifiedUrdf,
) -> Result<BuiltStation, ModelError> {
    let robot = Robot::from_urdf(urdf_file, &urdf.text, &[])?;
    if robot.num_dofs() == 0 {
        let problem = "no joint moves, expected at least one that is revolute, continuous or prismatic";
        return Err(ModelError::new(urdf_file, format!("robot {:?}", robot.name), problem));
    }
    check(wanted, &robot)?;
    let mut warnings = urdf.warnings.clone();
    let mut placed = Vec::with_capacity(wanted.patches.len());
    for patch in &wanted.patches {
        placed.push(skin::place(patch, &robot, urdf_file, &mut warnings)?);
    }
    let mut files = wanted.object_files.clone();
    let plan = wanted.plan.iter().map(|text| (PLAN_FILE, text.clone()));
    let texts = [
        (ROBOT_FILE, write::urdf(urdf, urdf_file)),
        (LAYOUT_FILE, write::layout(wanted, &robot, &placed)),
        (MODEL_FILE, write::model(wanted)),
        (STATION_FILE, write::station(wanted, &robot, urdf_file)),
    ];
    for (name, text) in texts.into_iter().chain(plan) {
        if files.insert(name.to_owned(), text.into_bytes()).is_some() {
            let problem = "is what a file of the station itself is called; rename the object's file";
            return Err(ModelError::new("objects", name, problem));
        }
    }
    let station = Station::read(STATION_FILE, |path| {
        files.get(path).cloned().ok_or_else(|| "it is not among the files of the new station".to_owned())
    })?;
    let channels = |id: &str| -> Vec<String> {
        let layout = &station.layout;
        let channels = layout.channels.iter().filter(|channel| layout.patches[channel.patch].id == id);
        channels.map(|channel| channel.id.clone()).collect()
    };
    let patches = wanted
        .patches
        .iter()
        .zip(&placed)
        .map(|(patch, link_from_patch)| {
            let turn = link_from_patch.rotation.to_rotation_matrix();
            let axis = |column: usize| [0, 1, 2].map(|row| turn.matrix()[(row, column)].round() + 0.0);
            PatchReport {
                patch: patch.id.clone(),
                link: patch.link.clone(),
                stream: stream_of(wanted, patch).to_owned(),
                channels: channels(&patch.id),
                position_m: [0, 1, 2].map(|i| write::rounded(link_from_patch.translation.vector[i])),
                outward: axis(2),
                along: axis(0),
                size_m: patch.size_mm.map(|mm| write::rounded(mm / 1e3)),
            }
        })
        .collect();
    Ok(BuiltStation { files, station, patches, warnings })
}

/// The stream of a patch that names none is the first.
fn stream_of<'a>(wanted: &'a NewStation, patch: &'a NewPatch) -> &'a str {
    patch
        .stream
        .as_deref()
        .or_else(|| wanted.streams.first().map(|stream| stream.id.as_str()))
        .unwrap_or_default()
}

/// Refuses what no file could say.
fn check(wanted: &NewStation, robot: &Robot) -> Result<(), ModelError> {
    let error = |place: &str, problem: String| ModelError::new("new station", place, problem);
    check_id("id", &wanted.id).map_err(|problem| error("id", problem))?;
    positive("joint_rate_hz", wanted.joint_rate_hz).map_err(|problem| error("joint_rate_hz", problem))?;
    let dofs: Vec<&str> = robot.dofs().map(|joint| joint.name.as_str()).collect();
    for (idx, joint) in wanted.carrier_joints.iter().enumerate() {
        if !dofs.contains(&joint.as_str()) {
            let near = skin::near(joint, dofs.iter().copied());
            let problem = format!("no moving joint {joint:?}; nearest are {}", list(near));
            return Err(error("carrier joints", problem));
        }
        if wanted.carrier_joints[..idx].contains(joint) {
            return Err(error("carrier joints", format!("{joint:?} is named twice")));
        }
    }
    if wanted.streams.is_empty() {
        return Err(error("streams", "there is none, expected at least one".to_owned()));
    }
    for (idx, stream) in wanted.streams.iter().enumerate() {
        let place = format!("stream {:?}", stream.id);
        stream.check().map_err(|problem| error(&place, problem))?;
        if wanted.streams[..idx].iter().any(|other| other.id == stream.id) {
            return Err(error(&place, "is there twice; ids must differ".to_owned()));
        }
    }
    let mut num_taxels: usize = 0;
    for (idx, patch) in wanted.patches.iter().enumerate() {
        let place = format!("patch {:?}", patch.id);
        let Some(stream) = wanted.streams.iter().find(|stream| stream.id == stream_of(wanted, patch)) else {
            let known = list(wanted.streams.iter().map(|stream| stream.id.as_str()));
            let problem = format!("unknown stream {:?}, expected one of {known}", stream_of(wanted, patch));
            return Err(error(&place, problem));
        };
        patch.check(stream.kind).map_err(|problem| error(&place, problem))?;
        if wanted.patches[..idx].iter().any(|other| other.id == patch.id) {
            return Err(error(&place, "is there twice; give each patch a name of its own".to_owned()));
        }
        num_taxels = num_taxels.saturating_add(patch.taxels[0].saturating_mul(patch.taxels[1]));
        if num_taxels > MAX_TAXELS {
            let problem = format!("makes it more than {MAX_TAXELS} taxels; is the grid meant to be as fine?");
            return Err(error(&place, problem));
        }
    }
    // Last, because a patch with a misspelt stream is the likelier reason.
    for stream in &wanted.streams {
        if !wanted.patches.iter().any(|patch| stream_of(wanted, patch) == stream.id) {
            let problem = "has no patch; give it one, or take the stream away";
            return Err(error(&format!("stream {:?}", stream.id), problem.to_owned()));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests;
