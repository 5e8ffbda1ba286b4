//! The texts of a new station, for people to go on with.

use std::fmt::Write as _;

use nalgebra::Isometry3;

use super::{
    LAYOUT_FILE, MODEL_FILE, NewStation, NewStream, PLAN_FILE, ROBOT_FILE,
    skin::{group_of, label_of},
    stream_of,
};
use crate::{JointKind, Robot, SensorKind, SimplifiedUrdf, TaxelAxes};

/// Longest header of a recording that is shown, characters.
const MAX_HEADER: usize = 100;

/// The URDF; one that was changed says so at its beginning.
pub(super) fn urdf(urdf: &SimplifiedUrdf, file: &str) -> String {
    if urdf.changes.is_empty() && urdf.warnings.is_empty() {
        return urdf.text.clone();
    }
    let mut comment = format!(
        "<!-- Made from {} by `palpate station new`, because robots are drawn and touched as boxes,\n     cylinders, capsules \
         and spheres. Change the shapes below where a better one matters:",
        in_xml_comment(file)
    );
    for line in urdf.changes.iter().chain(&urdf.warnings) {
        let _ = write!(comment, "\n       {}", in_xml_comment(line));
    }
    comment.push_str(" -->\n");
    let at = urdf.text.find("<robot").unwrap_or(0);
    let mut text = urdf.text.clone();
    text.insert_str(at, &comment);
    text
}

/// `layout.toml`.
pub(super) fn layout(wanted: &NewStation, robot: &Robot, placed: &[Isometry3<f64>]) -> String {
    let mut text = format!(
        "# Where the skin of {} is and how its channels are ordered. Fields: docs/recordings.md, last section.\nname = {}\n",
        in_comment(&wanted.label),
        string(&format!("Skin of {}", wanted.label))
    );
    for stream in &wanted.streams {
        let label = stream.label.clone().unwrap_or_else(|| label_of(&stream.id));
        let (kind, hint) = match stream.kind {
            SensorKind::Pressure => {
                ("pressure", "a skin of taxels; \"proximity\": one reading a patch, as an FSR gives")
            }
            SensorKind::Proximity => ("proximity", "one reading a patch; \"pressure\": a skin of taxels"),
        };
        let _ = write!(
            text,
            "\n# Its file in a take is {id}.csv.\n[[stream]]\nid = {id_text}\nlabel = {}\nkind = \"{kind}\" # {hint}\n\
             rate_hz = {:?} # how often the device sends\nraw_unit = {}\n",
            string(&label),
            stream.rate_hz,
            string(&stream.unit),
            id = stream.id,
            id_text = string(&stream.id),
        );
        text.push_str(&axes_text(stream));
    }
    for (patch, link_from_patch) in wanted.patches.iter().zip(placed) {
        let stream = stream_of(wanted, patch);
        let kind = wanted.streams.iter().find(|other| other.id == stream).map(|other| other.kind);
        let label = patch.label.clone().unwrap_or_else(|| label_of(&patch.id));
        let group = patch.group.clone().unwrap_or_else(|| group_of(robot, &patch.link));
        let t = link_from_patch.translation.vector;
        let q = link_from_patch.rotation.quaternion();
        let [length, width] = patch.size_mm.map(|mm| number(mm / 1e3));
        let _ = write!(
            text,
            "\n[[patch]]\nid = {}\nlabel = {}\ngroup = {} # patches of one group are drawn together\nstream = {}\nlink = {}\n\
             # In the link, m. Its z is the outward normal, its x the way to the fingertip. Measure it: it decides when contact\n\
             # begins.\n\
             pose = {{ position_m = [{}, {}, {}], quaternion_wxyz = [{}, {}, {}, {}] }}\n\
             # Curved skin: kind = \"arc\" or \"cap\".\n\
             shape = {{ kind = \"rectangle\", length_m = {length}, width_m = {width} }}\nnode_spacing_m = {}\n",
            string(&patch.id),
            string(&label),
            string(&group),
            string(stream),
            string(&patch.link),
            number(t.x),
            number(t.y),
            number(t.z),
            number(q.w),
            number(q.i),
            number(q.j),
            number(q.k),
            number(patch.node_spacing_m()),
        );
        if kind == Some(SensorKind::Pressure) {
            text.push_str(
                "stiffness_pa_per_m = 2.0e7 # of a soft gel\n\
                 # [x, y] of each taxel, m, in the order of its readings: row by row towards +x, in a row from +y to -y.\n\
                 taxels_m = [\n",
            );
            let taxels = patch.taxels_m();
            for row in taxels.chunks(patch.taxels[1].max(1)) {
                let row: Vec<String> =
                    row.iter().map(|&[x, y]| format!("[{}, {}]", number(x), number(y))).collect();
                let _ = writeln!(text, "    {},", row.join(", "));
            }
            text.push_str("]\n");
        }
    }
    text
}

/// How a stream of several axes says so; nothing for one axis.
fn axes_text(stream: &NewStream) -> String {
    match stream.taxel_axes() {
        Ok(TaxelAxes::Norm { count }) => format!(
            "axes = {count} # numbers that each taxel measures\n\
             reading = \"norm\" # how far they are from rest; \"normal\": the axis along the outward normal alone\n"
        ),
        Ok(TaxelAxes::Normal { count, axis, falls }) => format!(
            "axes = {count} # numbers that each taxel measures\n\
             reading = \"normal\" # the axis along the outward normal; \"norm\": how far all are from rest\n\
             normal_axis = \"{}{}\" # a minus in front: pressing makes it fall\n",
            if falls { "-" } else { "" },
            TaxelAxes::NAMES[axis]
        ),
        // What makes no sense was refused before.
        Ok(TaxelAxes::One) | Err(_) => String::new(),
    }
}

/// `nominal.toml`.
pub(super) fn model(wanted: &NewStation) -> String {
    format!(
        "# The simulator of {} before calibration: rough values, which `palpate calibrate` replaces.\nformat = 1\nname = {}\n\
         provenance = [\"first values of palpate station new; not calibrated\"]\n\n\
         [theta]\n\
         lambda_con_m = 0.002 # a proximity patch is on when the object is nearer than this\n\
         alpha_per_m = 150.0 # how fast pressure fades beside the place where it acts\n\
         lambda_pre_pa = 15000.0 # a taxel is on above this pressure\n",
        in_comment(&wanted.label),
        string(&format!("Nominal, {}", wanted.label)),
    )
}

/// `station.toml`.
pub(super) fn station(wanted: &NewStation, robot: &Robot, urdf_file: &str) -> String {
    let names = |names: &mut dyn Iterator<Item = &str>| names.map(string).collect::<Vec<_>>().join(", ");
    let mut text = format!(
        "# Made by `palpate station new` from {}. Paths are relative to this file; every field is in docs/recordings.md.\n\
         id = {} # sessions and models name the station by it\nlabel = {}\nrobot = \"{ROBOT_FILE}\"\n\
         layout = \"{LAYOUT_FILE}\" # where the taxels are: check their places there\nnominal_model = \"{MODEL_FILE}\"\n\
         # What is touched: add your own (docs/objects.md), remove what you do not have.\nobjects = [{}]\n\
         joint_rate_hz = {:?} # how often joint positions are recorded\n\
         # Every moving joint, as its column in joints.csv is called.\njoints = [\n",
        in_comment(urdf_file),
        string(&wanted.id),
        string(&wanted.label),
        names(&mut wanted.objects.iter().map(String::as_str)),
        wanted.joint_rate_hz,
    );
    for joint in robot.dofs() {
        let unit = if joint.kind == JointKind::Prismatic { "m" } else { "rad" };
        let range = joint.limits.map_or_else(
            || ", no limits".to_owned(),
            |limits| format!(", {} to {}", limits.lower, limits.upper),
        );
        let follows = joint.mimic.map_or_else(String::new, |mimic| {
            format!("; follows {}, so its column may be missing", in_comment(&robot.joints[mimic.joint].name))
        });
        let _ = writeln!(text, "    {}, # {unit}{range}{follows}", string(&joint.name));
    }
    let _ = write!(
        text,
        "]\n# Those that carry the hand about, of an arm.\ncarrier_joints = [{}]\n",
        names(&mut wanted.carrier_joints.iter().map(String::as_str))
    );
    text.push_str(&match &wanted.plan {
        Some(_) => format!(
            "# What sessions touch (docs/plans.md): add your own. `palpate serve` and emulated stations record them.\n\
             plans = [\"{PLAN_FILE}\"]\n"
        ),
        None => "# What sessions touch: plans = [\"FILE.toml\"] (docs/plans.md).\n".to_owned(),
    });
    for stream in &wanted.streams {
        let [on, off] = stream.thresholds();
        let _ = write!(
            text,
            "\n[[stream]]\nstream = {}\n\
             on_threshold = {on:?} # so far above its reference a channel is on: some times the noise, less than a light touch\n\
             off_threshold = {off:?} # and off again below this\nraw_min = {:?} # what the device can give\nraw_max = {:?}\n",
            string(&stream.id),
            stream.raw_min,
            stream.raw_max,
        );
    }
    let recorded = robot.dofs().filter(|joint| joint.mimic.is_none()).map(|joint| joint.name.as_str());
    let _ = write!(
        text,
        "\n# Recordings of this station (docs/recordings.md): a folder for each take, with\n\
         #   take.toml   object, object_pose, primitive, baseline_s\n#   joints.csv  {}\n",
        header(recorded)
    );
    for stream in &wanted.streams {
        let axes = stream.taxel_axes().map_or(&[][..], TaxelAxes::names);
        let ids =
            wanted.patches.iter().filter(|patch| stream_of(wanted, patch) == stream.id).flat_map(|patch| {
                let count = patch.taxels[0] * patch.taxels[1];
                (0..count).map(move |taxel| match count {
                    1 => patch.id.clone(),
                    _ => format!("{}.{taxel}", patch.id),
                })
            });
        let columns = ids.flat_map(|id| match axes {
            [_, _, ..] => axes.iter().map(|axis| format!("{id}.{axis}")).collect(),
            _ => vec![id],
        });
        let ids: Vec<String> = columns.take(MAX_HEADER).collect();
        let file = format!("{}.csv", stream.id);
        let _ = writeln!(text, "#   {file:<11} {}", header(ids.iter().map(String::as_str)));
    }
    text.push_str("# A robot that Palpate drives has [[device]] entries too (docs/hardware.md).\n");
    text
}

/// `t,a,b,...` of as many names as fit.
fn header<'a>(names: impl Iterator<Item = &'a str>) -> String {
    let mut text = "t".to_owned();
    for name in names {
        if text.len() + name.len() > MAX_HEADER {
            text.push_str(",...");
            break;
        }
        text.push(',');
        text.push_str(&in_comment(name));
    }
    text
}

/// `text` in quotes, as TOML has it.
fn string(text: &str) -> String {
    toml::Value::String(text.to_owned()).to_string()
}

/// `text` for the rest of a line that is a comment.
fn in_comment(text: &str) -> String {
    text.chars().map(|c| if c.is_control() { ' ' } else { c }).collect()
}

/// `text` for a comment of XML, which must not have two dashes in a row.
fn in_xml_comment(text: &str) -> String {
    in_comment(text).replace("--", "- -").trim_end_matches('-').to_owned()
}

/// `value` to a tenth of a micrometre.
pub(super) fn rounded(value: f64) -> f64 {
    let rounded = (value * 1e7).round() / 1e7 + 0.0;
    if rounded.is_finite() { rounded } else { value }
}

fn number(value: f64) -> String {
    format!("{:?}", rounded(value))
}
