//! The layout file, read and checked against the robot.

use std::collections::BTreeMap;

use toml::Spanned;

use super::{
    Channel, Patch, SensorKind, Stream, SurfaceNode, TactileLayout, TaxelAxes,
    config::{AxesReading, LayoutConfig, LayoutStreamConfig, PatchConfig, SensorKindConfig},
    map,
};
use crate::{
    ModelError, Robot,
    config::{Source, check_id, list, positive},
};

pub(super) fn layout(file: &str, text: &str, robot: &Robot) -> Result<TactileLayout, ModelError> {
    let source = Source { file, text };
    let config: LayoutConfig = source.parse()?;
    if config.stream.is_empty() {
        return Err(source.error_at("whole file", "no [[stream]], expected at least one"));
    }

    let mut streams: Vec<Stream> = Vec::with_capacity(config.stream.len());
    for spanned in &config.stream {
        let stream = stream(spanned.get_ref(), &streams).map_err(|problem| {
            source.error(spanned.span(), format!("stream {:?}", spanned.get_ref().id), problem)
        })?;
        streams.push(stream);
    }

    // The flat map and error messages follow the file; channels go by stream. A stable sort serves both.
    let mut order: Vec<(usize, usize)> = Vec::with_capacity(config.patch.len());
    let mut seen: BTreeMap<&str, ()> = BTreeMap::new();
    for (patch_idx, spanned) in config.patch.iter().enumerate() {
        let patch = spanned.get_ref();
        let error = |problem: String| source.error(spanned.span(), format!("patch {:?}", patch.id), problem);
        check_id("id", &patch.id).map_err(error)?;
        if seen.insert(&patch.id, ()).is_some() {
            return Err(error("this id is taken by an earlier patch; ids must be unique".to_owned()));
        }
        let Some(stream_idx) = streams.iter().position(|stream| stream.id == patch.stream) else {
            let known = list(streams.iter().map(|stream| stream.id.as_str()));
            return Err(error(format!("unknown stream {:?}, expected one of {known}", patch.stream)));
        };
        order.push((stream_idx, patch_idx));
    }
    order.sort_by_key(|&(stream_idx, _)| stream_idx);

    let configs: Vec<&PatchConfig> = config.patch.iter().map(Spanned::get_ref).collect();
    let kinds: Vec<SensorKind> = configs
        .iter()
        .map(|config| {
            streams.iter().find(|s| s.id == config.stream).map_or(SensorKind::Proximity, |s| s.kind)
        })
        .collect();
    let mut map_positions = map::positions(&configs, &kinds);

    let mut patches: Vec<Patch> = Vec::with_capacity(order.len());
    let mut channels: Vec<Channel> = Vec::new();
    for (stream_idx, patch_idx) in order {
        let spanned = &config.patch[patch_idx];
        let on_map = std::mem::take(&mut map_positions[patch_idx]);
        let patch = patch(spanned.get_ref(), robot, stream_idx, kinds[patch_idx], channels.len(), on_map)
            .map_err(|problem| {
                source.error(spanned.span(), format!("patch {:?}", spanned.get_ref().id), problem)
            })?;
        let num_taxels = patch.channels.len();
        channels.extend((0..num_taxels).map(|taxel| Channel {
            id: if num_taxels == 1 { patch.id.clone() } else { format!("{}.{taxel}", patch.id) },
            stream: stream_idx,
            patch: patches.len(),
            taxel,
        }));
        patches.push(patch);
    }

    for (stream_idx, stream) in streams.iter_mut().enumerate() {
        let mine = |channel: &Channel| channel.stream == stream_idx;
        let Some(first) = channels.iter().position(mine) else {
            let span = config.stream[stream_idx].span();
            return Err(source.error(
                span,
                format!("stream {:?}", stream.id),
                "no patch belongs to this stream; add a [[patch]] or remove it",
            ));
        };
        stream.channels = first..first + channels.iter().filter(|channel| mine(channel)).count();
    }
    Ok(TactileLayout { name: config.name, streams, patches, channels })
}

fn stream(config: &LayoutStreamConfig, earlier: &[Stream]) -> Result<Stream, String> {
    check_id("id", &config.id)?;
    if earlier.iter().any(|stream| stream.id == config.id) {
        return Err("this id is taken by an earlier stream; ids must be unique".to_owned());
    }
    Ok(Stream {
        id: config.id.clone(),
        label: config.label.clone(),
        kind: match config.kind {
            SensorKindConfig::Proximity => SensorKind::Proximity,
            SensorKindConfig::Pressure => SensorKind::Pressure,
        },
        rate_hz: positive("rate_hz", config.rate_hz)?,
        channels: 0..0,
        raw_unit: config.raw_unit.clone(),
        axes: taxel_axes(config.axes, config.reading, config.normal_axis.as_deref())?,
    })
}

/// The axes that a stream states: how many, how they become one reading, and which is along the outward normal.
pub(crate) fn taxel_axes(
    count: Option<usize>,
    reading: Option<AxesReading>,
    normal_axis: Option<&str>,
) -> Result<TaxelAxes, String> {
    let count = count.unwrap_or(1);
    if !(1..=TaxelAxes::NAMES.len()).contains(&count) {
        return Err(format!("axes is {count}, expected 1, 2 or 3 numbers for each taxel"));
    }
    if let Some(named) = normal_axis.filter(|_| reading != Some(AxesReading::Normal)) {
        return Err(format!("normal_axis = {named:?} has no effect without reading = \"normal\"; remove it"));
    }
    match (count, reading) {
        (1, None) => Ok(TaxelAxes::One),
        (1, Some(_)) => {
            Err("reading says how several axes become one, but there is one; remove it, or add axes = 3"
                .to_owned())
        }
        (_, None) => Err(format!(
            "axes = {count} without a rule for the one reading that calibration works with; add reading = \"norm\" (how far \
             they are from rest) or reading = \"normal\" (the one along the outward normal)"
        )),
        (_, Some(AxesReading::Norm)) => Ok(TaxelAxes::Norm { count }),
        (_, Some(AxesReading::Normal)) => {
            let names = &TaxelAxes::NAMES[..count];
            let Some(stated) = normal_axis.or((count == 3).then_some("z")) else {
                let problem =
                    "two axes and no normal_axis; say which one is along the outward normal: \"x\" or \"y\"";
                return Err(problem.to_owned());
            };
            let (name, falls) = stated.strip_prefix('-').map_or((stated, false), |name| (name, true));
            let axis = names.iter().position(|known| *known == name).ok_or_else(|| {
                format!(
                    "normal_axis is {stated:?}, expected one of {}, with a minus in front where pressing makes it fall",
                    list(names.iter().copied())
                )
            })?;
            Ok(TaxelAxes::Normal { count, axis, falls })
        }
    }
}

fn patch(
    config: &PatchConfig,
    robot: &Robot,
    stream: usize,
    kind: SensorKind,
    first_channel: usize,
    map_positions: Vec<[f64; 2]>,
) -> Result<Patch, String> {
    let Some(link) = robot.link_index(&config.link) else {
        let known = list(robot.links.iter().map(|link| link.name.as_str()));
        return Err(format!("unknown link {:?}, expected one of the robot's links: {known}", config.link));
    };
    let stiffness_pa_per_m = match (kind, config.stiffness_pa_per_m) {
        (SensorKind::Pressure, Some(stiffness)) => positive("stiffness_pa_per_m", stiffness)?,
        (SensorKind::Pressure, None) => {
            return Err(
                "no stiffness_pa_per_m, expected one: the patch belongs to a pressure stream".to_owned()
            );
        }
        (SensorKind::Proximity, Some(_)) => {
            return Err("stiffness_pa_per_m has no effect on a proximity stream; remove it".to_owned());
        }
        (SensorKind::Proximity, None) => 0.0,
    };
    config.shape.check().map_err(|problem| format!("shape: {problem}"))?;
    let link_from_patch = config.pose.to_isometry().map_err(|problem| format!("pose: {problem}"))?;

    let taxels = config.taxels(kind);
    match (kind, taxels.len()) {
        (_, 0) => return Err("no taxels_m, expected at least one taxel".to_owned()),
        (SensorKind::Proximity, n) if n > 1 => {
            return Err(format!(
                "{n} taxels, expected one: a proximity patch has a single reading; split the patch in {n}"
            ));
        }
        _ => {}
    }
    let mut taxels_in_link = Vec::with_capacity(taxels.len());
    let mut taxel_normals_in_link = Vec::with_capacity(taxels.len());
    for (taxel_idx, &taxel_m) in taxels.iter().enumerate() {
        let point =
            config.shape.project(taxel_m).map_err(|problem| format!("taxel {taxel_idx}: {problem}"))?;
        taxels_in_link.push(link_from_patch * point.pos_in_patch);
        taxel_normals_in_link.push(link_from_patch.rotation * point.normal_in_patch);
    }
    if map_positions.iter().flatten().any(|v| !v.is_finite()) || map_positions.len() != taxels.len() {
        return Err(format!(
            "map: expected {} finite positions, one a taxel, or {{ at = [x, y] }}",
            taxels.len()
        ));
    }
    let nodes = config
        .shape
        .sample(config.node_spacing_m)?
        .into_iter()
        .map(|point| SurfaceNode {
            pos_in_link: link_from_patch * point.pos_in_patch,
            normal_in_link: link_from_patch.rotation * point.normal_in_patch,
        })
        .collect();
    Ok(Patch {
        id: config.id.clone(),
        label: config.label.clone(),
        group: config.group.clone(),
        stream,
        link,
        link_from_patch,
        nodes,
        channels: first_channel..first_channel + taxels.len(),
        taxels_in_link,
        taxel_normals_in_link,
        stiffness_pa_per_m,
        map_positions,
    })
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const ROBOT: &str = r#"<robot name="finger"><link name="base"/><link name="tip"/>
        <joint name="slide" type="prismatic"><parent link="base"/><child link="tip"/>
        <axis xyz="0 0 1"/><limit lower="0" upper="1" velocity="1" effort="1"/></joint></robot>"#;

    /// Two streams, declared in the order gel, film; the film's patch comes first in the file.
    const LAYOUT: &str = r#"name = "test"
[[stream]]
id = "gel"
label = "Gel"
kind = "pressure"
rate_hz = 100.0
raw_unit = "counts"
[[stream]]
id = "film"
label = "Film"
kind = "proximity"
rate_hz = 40.0
raw_unit = "mV"
[[patch]]
id = "back"
label = "Back"
group = "palm"
stream = "film"
link = "base"
pose = { position_m = [0.0, 0.0, -0.01], rpy_rad = [3.141592653589793, 0.0, 0.0] }
shape = { kind = "rectangle", length_m = 0.02, width_m = 0.01 }
node_spacing_m = 0.005
[[patch]]
id = "pad"
label = "Pad"
group = "finger"
stream = "gel"
link = "tip"
pose = { position_m = [0.1, 0.0, 0.0] }
shape = { kind = "arc", radius_m = 0.01, arc_rad = 2.0, length_m = 0.02, dome_rad = 1.0 }
node_spacing_m = 0.002
stiffness_pa_per_m = 1.0e7
taxels_m = [[-0.005, 0.0], [0.005, 0.003], [0.012, 0.0]]
"#;

    fn read(text: &str) -> Result<TactileLayout, ModelError> {
        let robot = Robot::from_urdf("finger.urdf", ROBOT, &[]).expect("the robot of this test");
        layout("pad.toml", text, &robot)
    }

    #[test]
    fn channels_go_by_stream_then_patch_then_taxel() {
        let layout = read(LAYOUT).unwrap();
        let ids: Vec<&str> = layout.channels.iter().map(|channel| channel.id.as_str()).collect();
        assert_eq!(ids, ["pad.0", "pad.1", "pad.2", "back"]);
        assert_eq!(layout.streams[0].channels, 0..3);
        assert_eq!(layout.streams[1].channels, 3..4);
        assert_eq!(layout.patches[1].channels, 3..4);
        assert_eq!(layout.channels[3].patch, 1);
        for channel in &layout.channels {
            assert_eq!(layout.patches[channel.patch].stream, channel.stream);
        }
    }

    #[test]
    fn a_patch_is_placed_by_its_pose() {
        let layout = read(LAYOUT).unwrap();
        let back = &layout.patches[1];
        assert_eq!(back.nodes.len(), 4 * 2);
        for node in &back.nodes {
            assert!((node.pos_in_link.z + 0.01).abs() < 1e-12);
            assert!((node.normal_in_link.z + 1.0).abs() < 1e-12);
        }
        let pad = &layout.patches[0];
        let axis_z = -0.01;
        let taxel = pad.taxels_in_link[1];
        assert!((taxel.y.hypot(taxel.z - axis_z) - 0.01).abs() < 1e-12);
        assert!((taxel.x - 0.105).abs() < 1e-12);
    }

    #[test]
    fn every_fault_names_line_patch_and_remedy() {
        let faults: &[(&str, &str, &str)] = &[
            ("link = \"tip\"", "link = \"thumb\"", "unknown link \"thumb\""),
            (
                "stream = \"film\"",
                "stream = \"foil\"",
                "unknown stream \"foil\", expected one of \"gel\", \"film\"",
            ),
            ("id = \"pad\"", "id = \"back\"", "taken by an earlier patch"),
            ("id = \"film\"", "id = \"gel\"", "taken by an earlier stream"),
            ("id = \"pad\"", "id = \"p d\"", "expected letters, digits"),
            ("node_spacing_m = 0.002", "node_spacing_m = 0.0", "above zero"),
            ("node_spacing_m = 0.002", "node_spacing_m = nan", "above zero"),
            ("node_spacing_m = 0.002", "node_spacing_m = 0.000002", "coarser"),
            ("length_m = 0.02, width_m", "length_m = -0.02, width_m", "length_m is -0.02"),
            ("arc_rad = 2.0", "arc_rad = 7.0", "full turn"),
            ("dome_rad = 1.0", "dome_rad = 2.0", "pi / 2"),
            ("stiffness_pa_per_m = 1.0e7\n", "", "no stiffness_pa_per_m"),
            ("stiffness_pa_per_m = 1.0e7", "stiffness_pa_per_m = inf", "above zero"),
            ("node_spacing_m = 0.005", "node_spacing_m = 0.005\nstiffness_pa_per_m = 1.0", "no effect"),
            (
                "node_spacing_m = 0.005",
                "node_spacing_m = 0.005\ntaxels_m = [[0, 0], [0, 0]]",
                "split the patch",
            ),
            ("[0.012, 0.0]]", "[0.022, 0.0]]", "taxel 2: [0.022, 0] m lies beside"),
            ("taxels_m = [[-0.005, 0.0], [0.005, 0.003], [0.012, 0.0]]", "", "at least one taxel"),
            ("position_m = [0.1, 0.0, 0.0]", "position_m = [nan, 0.0, 0.0]", "must be finite"),
            ("rate_hz = 40.0", "rate_hz = 0.0", "rate_hz is 0"),
            ("rate_hz = 40.0", "rate_hz = 40.0\ncolour = 1", "unknown field `colour`"),
            ("raw_unit = \"mV\"", "raw_unit = \"mV\"\naxes = 4", "axes is 4, expected 1, 2 or 3"),
            ("raw_unit = \"mV\"", "raw_unit = \"mV\"\naxes = 3", "add reading = \"norm\""),
            ("raw_unit = \"mV\"", "raw_unit = \"mV\"\nreading = \"norm\"", "but there is one"),
            (
                "raw_unit = \"mV\"",
                "raw_unit = \"mV\"\naxes = 2\nreading = \"normal\"",
                "two axes and no normal_axis",
            ),
            (
                "raw_unit = \"mV\"",
                "raw_unit = \"mV\"\naxes = 2\nreading = \"normal\"\nnormal_axis = \"z\"",
                "expected one of \"x\", \"y\"",
            ),
            (
                "raw_unit = \"mV\"",
                "raw_unit = \"mV\"\naxes = 3\nreading = \"norm\"\nnormal_axis = \"z\"",
                "has no effect without reading = \"normal\"",
            ),
            ("kind = \"arc\"", "kind = \"spline\"", "unknown variant `spline`"),
            ("kind = \"proximity\"", "kind = \"thermal\"", "unknown variant `thermal`"),
            ("taxels_m = [", "map = { positions = [[0, 0]] }\ntaxels_m = [", "expected 3 finite positions"),
            ("taxels_m = [", "map = { at = [nan, 0] }\ntaxels_m = [", "expected 3 finite positions"),
        ];
        for (from, to, expected) in faults {
            assert!(LAYOUT.contains(from), "{from}");
            let error = read(&LAYOUT.replacen(from, to, 1)).expect_err(to).to_string();
            assert!(error.contains(expected), "{to}: {error}");
            assert!(error.starts_with("pad.toml: line "), "{to}: {error}");
        }
        let unknown_link = read(&LAYOUT.replacen("link = \"tip\"", "link = \"thumb\"", 1)).unwrap_err();
        assert_eq!(unknown_link.place, "line 23, patch \"pad\"");
    }

    #[test]
    fn axes_say_how_they_become_a_reading() {
        let axes_of = |more: &str| {
            let layout =
                read(&LAYOUT.replacen("raw_unit = \"mV\"", &format!("raw_unit = \"mV\"\n{more}"), 1));
            layout.unwrap().streams[1].axes
        };
        assert_eq!(axes_of(""), TaxelAxes::One);
        assert_eq!(axes_of("axes = 1"), TaxelAxes::One);
        assert_eq!(axes_of("axes = 2\nreading = \"norm\""), TaxelAxes::Norm { count: 2 });
        let normal = |axis, falls| TaxelAxes::Normal { count: 3, axis, falls };
        assert_eq!(axes_of("axes = 3\nreading = \"normal\""), normal(2, false));
        assert_eq!(axes_of("axes = 3\nreading = \"normal\"\nnormal_axis = \"-x\""), normal(0, true));
        assert_eq!(normal(0, true).names(), ["x", "y", "z"]);
    }

    #[test]
    fn a_layout_without_streams_or_with_an_idle_stream_is_refused() {
        assert!(read("name = \"x\"").unwrap_err().to_string().contains("no [[stream]]"));
        let idle = LAYOUT.replacen(
            "stream = \"film\"",
            "stream = \"gel\"\nstiffness_pa_per_m = 1.0\ntaxels_m = [[0, 0]]",
            1,
        );
        assert!(read(&idle).unwrap_err().to_string().contains("no patch belongs to this stream"));
    }

    #[test]
    fn the_flat_map_is_drawn_in_columns_unless_the_file_places_a_patch() {
        let layout = read(LAYOUT).unwrap();
        let [palm, finger] = [layout.patches[1].map_positions[0], layout.patches[0].map_positions[0]];
        assert!(finger[0] > palm[0] + 10.0, "one column a group: {palm:?} {finger:?}");
        // Up on the map is towards the tip of the patch, and the patch is seen from outside.
        let pad = &layout.patches[0].map_positions;
        assert!(pad[0][1] < pad[1][1] && pad[1][1] < pad[2][1]);
        assert!(pad[1][0] < pad[0][0], "+y of the patch is left of its middle");

        let placed =
            read(&LAYOUT.replacen("taxels_m = [", "map = { at = [7.0, 9.0] }\ntaxels_m = [", 1)).unwrap();
        assert_eq!(placed.patches[0].map_positions[0], [7.0, 9.0 - 5.0]);
        let listed = LAYOUT.replacen(
            "taxels_m = [",
            "map = { positions = [[0, 1], [2, 3], [4, 5]] }\ntaxels_m = [",
            1,
        );
        assert_eq!(read(&listed).unwrap().patches[0].map_positions, [[0.0, 1.0], [2.0, 3.0], [4.0, 5.0]]);
    }

    proptest! {
        #[test]
        fn a_spoilt_byte_is_an_error_or_a_sound_layout(at in 0..LAYOUT.len(), byte in 32..127_u8) {
            let mut bytes = LAYOUT.as_bytes().to_vec();
            bytes[at] = byte;
            let text = String::from_utf8(bytes).unwrap();
            if let Ok(layout) = read(&text) {
                let mut next = 0;
                for patch in &layout.patches {
                    prop_assert_eq!(patch.channels.start, next);
                    next = patch.channels.end;
                    prop_assert_eq!(patch.taxels_in_link.len(), patch.channels.len());
                    prop_assert_eq!(patch.map_positions.len(), patch.channels.len());
                    prop_assert!(!patch.nodes.is_empty());
                    prop_assert!(patch.nodes.iter().all(|n| n.pos_in_link.coords.iter().all(|x| x.is_finite())));
                }
                prop_assert_eq!(next, layout.num_channels());
            }
        }
    }
}
