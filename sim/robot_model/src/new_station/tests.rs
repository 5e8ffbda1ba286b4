use proptest::prelude::*;

use super::*;
use crate::{AxesReading, SensorKind, TaxelAxes, simplify_urdf};

const SHIPPED: [(&str, &str); 2] = [
    ("xarm6_leap_right.urdf", include_str!("../../../../assets/robots/xarm6_leap_right.urdf")),
    ("probe_bench.urdf", include_str!("../../../../assets/robots/probe_bench.urdf")),
];
/// A gripper whose right finger mimics the left one, with meshes for shapes.
const GRIPPER: &str = include_str!("../../tests/gripper/gripper.urdf");
const FINGER_MESH: &str = include_str!("../../tests/gripper/finger.obj");
const BALL: &str = "id = 'ball'\nlabel = 'Ball'\nshape = { kind = 'sphere', radius_m = 0.02 }";

fn gripper() -> SimplifiedUrdf {
    let read = |name: &str| match name {
        "package://gripper/finger.obj" => Ok(FINGER_MESH.as_bytes().to_vec()),
        _ => Err("no such file".to_owned()),
    };
    simplify_urdf("gripper.urdf", GRIPPER, read).unwrap()
}

fn plain(text: &str) -> SimplifiedUrdf {
    simplify_urdf("hand.urdf", text, |_| Err("no such file".to_owned())).unwrap()
}

fn wanted(patches: &[&str]) -> NewStation {
    NewStation {
        id: "mine".to_owned(),
        label: "My \"hand\"".to_owned(),
        joint_rate_hz: 50.0,
        carrier_joints: Vec::new(),
        streams: vec![NewStream::pressure("gel")],
        patches: patches.iter().map(|text| text.parse().unwrap()).collect(),
        objects: vec!["objects/ball.toml".to_owned()],
        object_files: BTreeMap::from([("objects/ball.toml".to_owned(), BALL.as_bytes().to_vec())]),
        plan: None,
    }
}

fn refusal(wanted: &NewStation) -> String {
    build(wanted, "gripper.urdf", &gripper()).expect_err("must be refused").to_string()
}

#[test]
fn a_patch_lies_on_the_face_that_it_names() {
    let built = build(
        &wanted(&["left=finger_left:2x3@30x12:-y", "right=finger_right:1x1@10x10:+y:0,0,5"]),
        "g",
        &gripper(),
    )
    .unwrap();
    assert_eq!(built.station.label, "My \"hand\"");
    let [left, right] = &built.patches[..] else { panic!("{:?}", built.patches) };
    assert_eq!(left.channels, ["left.0", "left.1", "left.2", "left.3", "left.4", "left.5"]);
    assert_eq!(right.channels, ["right"]);
    // The finger's mesh is 16 x 12 x 50 mm and stands on the link's origin.
    assert_eq!(
        (left.position_m, left.outward, left.along),
        ([0.0, -0.006, 0.025], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0])
    );
    assert_eq!((right.position_m, right.outward), ([0.0, 0.006, 0.03], [0.0, 1.0, 0.0]));
    let taxels = &built.station.layout.patches[0].taxels_in_link;
    // Rows go up; seen from outside, that is from -y with z up, +x is at the right.
    assert!((taxels[0] - nalgebra::Point3::new(-0.004, -0.006, 0.0175)).norm() < 1e-6, "{}", taxels[0]);
    assert!((taxels[5] - nalgebra::Point3::new(0.004, -0.006, 0.0325)).norm() < 1e-6, "{}", taxels[5]);
    let normal = built.station.layout.patches[0].nodes[0].normal_in_link;
    assert!((normal.y + 1.0).abs() < 1e-6, "{normal:?}");
    assert_eq!(built.station.robot.mimics().len(), 1);
    assert!(built.warnings.iter().all(|warning| warning.contains("mesh")), "{:?}", built.warnings);
}

#[test]
fn what_was_changed_of_the_urdf_stands_in_it() {
    let built = build(&wanted(&["left=finger_left:1x1@10x10:-y"]), "gripper.urdf", &gripper()).unwrap();
    let text = String::from_utf8(built.files["robot.urdf"].clone()).unwrap();
    assert!(text.contains("Made from gripper.urdf"), "{text}");
    assert!(text.contains("link \"finger_left\": 2 meshes are replaced by the box around each"), "{text}");
    let (file, urdf) = SHIPPED[1];
    let built = build(&wanted(&["pad=ram:1x1@10x10:-z"]), file, &plain(urdf)).unwrap();
    assert_eq!(built.files["robot.urdf"], urdf.as_bytes(), "nothing had to be changed");
}

#[test]
fn a_patch_off_its_link_is_warned_about() {
    let warnings = |patch: &str| build(&wanted(&[patch]), "g", &gripper()).unwrap().warnings.join("\n");
    assert!(warnings("p=finger_left:4x4@90x10:-y").contains("reaches 20.0 mm beyond the box around"));
    assert!(warnings("p=finger_left:4x4@9x10:-y:0,-40,0").contains("reaches 40.0 mm beyond"));
    assert!(warnings("p=finger_left:4x4@9x10:-y:0,5,0").contains("lies 5.0 mm inside"));
    assert!(warnings("p=tool_point:1x1@9x9").contains("the link has no shape"));
}

#[test]
fn robots_are_explained_tips_first() {
    let urdf = gripper();
    let robot = Robot::from_urdf("g", &urdf.text, &[]).unwrap();
    let report = explain(&robot, &urdf);
    assert_eq!((report.robot.as_str(), report.root.as_str()), ("gripper", "wrist"));
    let right = report.joints.iter().find(|joint| joint.joint == "right").unwrap();
    assert_eq!((right.kind, right.unit, right.lower, right.upper), ("prismatic", "m", Some(0.0), Some(0.04)));
    let follows = Follows { joint: "left".to_owned(), multiplier: 1.0, offset: 0.0 };
    assert_eq!(right.follows, Some(follows));
    let links: Vec<(&str, bool)> = report.links.iter().map(|link| (link.link.as_str(), link.tip)).collect();
    let others = ["wrist", "palm", "tool_point"].map(|link| (link, false));
    assert_eq!(links[..2], [("finger_left", true), ("finger_right", true)]);
    assert_eq!(links[2..], others, "a mere frame is no tip");
    let size = report.links[0].size_m.unwrap().map(|m| (m * 1e6).round() / 1e3);
    assert_eq!(size, [16.0, 12.0, 50.0]);
    let warnings = report.warnings.join("\n");
    for expected in [
        "link \"palm\": mesh \"package://gripper/palm.dae\" is left out: no such file",
        "joint \"roll\" has no limits",
        "a patch on a link without a shape is placed at its origin: \"tool_point\"",
    ] {
        assert!(warnings.contains(expected), "{expected}: {warnings}");
    }
}

#[test]
fn every_fault_says_where_it_is_and_what_to_do() {
    let with = |change: &dyn Fn(&mut NewStation)| {
        let mut wanted = wanted(&["left=finger_left:2x3@30x12:-y"]);
        change(&mut wanted);
        refusal(&wanted)
    };
    type Change<'a> = &'a dyn Fn(&mut NewStation);
    let cases: &[(Change<'_>, &str)] = &[
        (&|w| w.id = "my hand".to_owned(), "expected letters, digits"),
        (&|w| w.joint_rate_hz = f64::NAN, "joint_rate_hz is NaN"),
        (
            &|w| w.patches[0].link = "finger_lfet".to_owned(),
            "patch \"left\": gripper.urdf has no link \"finger_lfet\"; nearest are \"finger_left\"",
        ),
        (&|w| w.patches[0].id = "a b".to_owned(), "name is \"a b\""),
        (&|w| w.patches.push(w.patches[0].clone()), "patch \"left\": is there twice"),
        (&|w| w.patches[0].taxels = [0, 3], "at least 1 x 1"),
        (&|w| w.patches[0].taxels = [usize::MAX, 3], "more than 20000 taxels"),
        (&|w| w.patches[0].size_mm = [0.02, 12.0], "length is 0.02 mm, expected 0.1 to 2000 mm"),
        (&|w| w.patches[0].size_mm[1] = f64::NAN, "width is NaN mm"),
        (&|w| w.patches[0].offset_mm[1] = f64::INFINITY, "offset"),
        (
            &|w| w.patches[0].stream = Some("film".to_owned()),
            "unknown stream \"film\", expected one of \"gel\"",
        ),
        (&|w| w.streams[0].kind = SensorKind::Proximity, "a proximity patch has one reading"),
        (&|w| w.streams.push(NewStream::pressure("film")), "stream \"film\": has no patch"),
        (&|w| w.streams.push(NewStream::pressure("gel")), "stream \"gel\": is there twice"),
        (&|w| w.streams.clear(), "there is none"),
        (&|w| w.streams[0].id = "joints".to_owned(), "as the joint log"),
        (&|w| w.streams[0].raw_max = -1.0, "expected the lower one first"),
        (&|w| w.streams[0].on_threshold = Some(9999.0), "on_threshold is 9999"),
        (&|w| w.streams[0].off_threshold = Some(500.0), "off_threshold is 500"),
        (&|w| w.streams[0].rate_hz = 0.0, "rate_hz is 0"),
        (
            &|w| w.carrier_joints = vec!["rol".to_owned()],
            "carrier joints: no moving joint \"rol\"; nearest are \"roll\"",
        ),
        (&|w| w.carrier_joints = vec!["roll".to_owned(), "roll".to_owned()], "named twice"),
        (&|w| w.objects.push("mine.toml".to_owned()), "mine.toml"),
        (
            &|w| drop(w.object_files.insert("layout.toml".to_owned(), Vec::new())),
            "is what a file of the station itself is called",
        ),
    ];
    for (change, expected) in cases {
        let message = with(change);
        assert!(message.contains(expected), "{expected}: {message}");
    }
    let still = r#"<robot name="still"><link name="a"/></robot>"#;
    let message = build(&wanted(&["p=a:1x1@9x9"]), "still.urdf", &plain(still)).unwrap_err().to_string();
    assert!(message.contains("no joint moves"), "{message}");
}

#[test]
fn patches_are_read_from_text_and_from_files() {
    let patch: NewPatch = "tip=ns::tip:4x3@20x15.5mm:-y:0,1,-2.5".parse().unwrap();
    assert_eq!((patch.link.as_str(), patch.taxels, patch.size_mm), ("ns::tip", [4, 3], [20.0, 15.5]));
    assert_eq!((patch.outward, patch.offset_mm), ("-y".parse().unwrap(), [0.0, 1.0, -2.5]));
    let text = "[[patch]]\nid = 'tip'\nlink = 'ns::tip'\ntaxels = [4, 3]\nsize_mm = [20, 15.5]\noutward = '-y'\n\
                offset_mm = [0, 1, -2.5]\n";
    let skin = SkinConfig::from_toml("skin.toml", text).unwrap();
    assert_eq!(skin.patches, [patch]);
    for (text, expected) in [
        ("tip", "no = in it"),
        ("tip=link", "no LINK:ROWSxCOLUMNS@LENGTHxWIDTH"),
        ("tip=4x3@20x15", "no LINK:ROWSxCOLUMNS@LENGTHxWIDTH"),
        ("tip=link:4@20x15", "no number of rows and columns"),
        ("tip=link:4x3@20", "no length and width in mm"),
        ("tip=link:4x3@20x15:up", "direction \"up\", expected one of +x"),
        ("tip=link:4x3@20x15:+z:1,2", "no offset in mm"),
        ("tip=link:4x3@20x15:+z:1,2,3:4", "is too much"),
    ] {
        let problem = text.parse::<NewPatch>().unwrap_err();
        assert!(problem.contains(expected), "{text}: {problem}");
    }
    for (text, expected) in [
        ("", "no [[patch]]"),
        ("[[patch]]\nid = 'tip'", "line 1"),
        ("[[patch]]\nid = 'tip'\nlink = 'a'\ntaxels = [1, 1]\nsize_mm = [1, 1]\noutward = 'up'", "direction"),
        ("[[stream]]\nid = 'gel'\nkind = 'warm'", "unknown variant `warm`"),
    ] {
        let problem = SkinConfig::from_toml("skin.toml", text).unwrap_err().to_string();
        assert!(problem.starts_with("skin.toml: ") && problem.contains(expected), "{text}: {problem}");
    }
}

#[test]
fn thresholds_follow_the_range() {
    let mut stream = NewStream::pressure("gel");
    assert_eq!(stream.thresholds(), [82.0, 62.0]);
    stream.raw_max = 5.0;
    assert_eq!(stream.thresholds(), [0.1, 0.075]);
    stream.on_threshold = Some(0.4);
    assert_eq!(stream.thresholds(), [0.4, 0.3]);
}

#[test]
fn axes_of_taxels_are_in_the_layout_and_in_the_columns_of_recordings() {
    let with = |axes: Option<usize>, reading: Option<AxesReading>, normal_axis: Option<&str>| {
        let mut wanted = wanted(&["pad=finger_left:1x2@20x12:-y"]);
        let stream = &mut wanted.streams[0];
        (stream.axes, stream.reading, stream.normal_axis) = (axes, reading, normal_axis.map(str::to_owned));
        build(&wanted, "gripper.urdf", &gripper())
    };
    let axes =
        |axes, reading, normal_axis| with(axes, reading, normal_axis).unwrap().station.layout.streams[0].axes;
    assert_eq!(axes(None, None, None), TaxelAxes::One);
    assert_eq!(axes(Some(3), None, None), TaxelAxes::Norm { count: 3 });
    let normal = |axis, falls| TaxelAxes::Normal { count: 3, axis, falls };
    assert_eq!(axes(Some(3), Some(AxesReading::Normal), None), normal(2, false));
    assert_eq!(axes(Some(3), None, Some("-x")), normal(0, true));
    let built = with(Some(3), None, None).unwrap();
    let station = String::from_utf8(built.files[STATION_FILE].clone()).unwrap();
    assert!(station.contains("t,pad.0.x,pad.0.y,pad.0.z,pad.1.x,"), "{station}");
    for (count, normal_axis, expected) in [
        (Some(4), None, "axes is 4, expected 1, 2 or 3"),
        (Some(2), Some("z"), "normal_axis is \"z\", expected one of \"x\", \"y\""),
        (None, Some("z"), "reading says how several axes become one, but there is one"),
    ] {
        let problem = with(count, None, normal_axis).unwrap_err().to_string();
        assert!(problem.contains("stream \"") && problem.contains(expected), "{problem}");
    }
}

fn xml(name: &str) -> String {
    name.chars().map(|c| format!("&#{};", c as u32)).collect()
}

/// A URDF of links with the given names, each on one before it.
#[derive(Debug)]
struct Made {
    names: Vec<String>,
    urdf: String,
}

fn robots() -> impl Strategy<Value = Made> {
    let name = prop_oneof![4 => "[a-z_]{1,8}", 1 => r#"[ "'\\<>&é#=:@\-]{1,6}[a-z]"#];
    let shape = prop_oneof![
        Just(String::new()),
        (0.001..0.3_f64, 0.001..0.3_f64, -0.1..0.1_f64, -3.0..3.0_f64).prop_map(|(a, b, at, turn)| format!(
            r#"<collision><origin xyz="{at} 0 {b}" rpy="{turn} 0 0"/><geometry><box size="{a} {b} 0.02"/></geometry></collision>"#
        )),
        (0.001..0.1_f64, 0.001..0.1_f64).prop_map(|(radius, length)| format!(
            r#"<visual><geometry><cylinder radius="{radius}" length="{length}"/></geometry></visual>"#
        )),
        Just(r#"<visual><geometry><mesh filename="a--b.stl"/></geometry></visual>"#.to_owned()),
    ];
    let link = (name, shape, any::<prop::sample::Index>(), 0..4_u8, any::<bool>(), any::<bool>());
    prop::collection::vec(link, 1..8).prop_map(|links| {
        let mut names = vec!["base".to_owned()];
        let mut urdf = r#"<robot name="made"><link name="base"/>"#.to_owned();
        for (idx, (name, shape, parent, kind, limits, follows)) in links.into_iter().enumerate() {
            let name = format!("{name}{idx}");
            let parent = xml(&names[parent.index(names.len())]);
            let kind = ["fixed", "revolute", "prismatic", "continuous"][if idx == 0 { 1 } else { usize::from(kind) }];
            let limit = if limits && idx > 0 { r#"<limit lower="-1" upper="1" velocity="1" effort="1"/>"# } else { "" };
            let mimic = if follows && idx > 0 { r#"<mimic joint="j0" multiplier="-1"/>"# } else { "" };
            urdf += &format!(
                r#"<link name="{name}">{shape}</link><joint name="j{idx}" type="{kind}"><parent link="{parent}"/>
                <child link="{name}"/><origin xyz="0 0.01 0.02"/><axis xyz="0 0 1"/>{limit}{mimic}</joint>"#,
                name = xml(&name)
            );
            names.push(name);
        }
        Made { names, urdf: urdf + "</robot>" }
    })
}

proptest! {
    #[test]
    fn any_link_of_any_robot_makes_a_station(
        made in robots(),
        link in any::<prop::sample::Index>(),
        taxels in (1..5_usize, 1..5_usize),
        size_mm in (0.2..400.0_f64, 0.2..400.0_f64),
        outward in prop::sample::select(vec!["+x", "-x", "+y", "-y", "+z", "-z"]),
        raw_max in 0.01..1e6_f64,
        label in any::<String>(),
    ) {
        let urdf = plain(&made.urdf);
        let link = made.names[link.index(made.names.len())].clone();
        let mut wanted = wanted(&["pad=x:1x1@1x1"]);
        wanted.label = label.clone();
        wanted.streams[0].raw_max = raw_max;
        wanted.streams[0].unit = label;
        wanted.patches[0] = NewPatch {
            link: link.clone(),
            taxels: [taxels.0, taxels.1],
            size_mm: [size_mm.0, size_mm.1],
            outward: outward.parse().unwrap(),
            ..wanted.patches[0].clone()
        };
        let built = build(&wanted, "made.urdf", &urdf).unwrap();
        let station = &built.station;
        prop_assert_eq!(station.layout.num_channels(), taxels.0 * taxels.1);
        prop_assert_eq!(&station.robot.links[station.layout.patches[0].link].name, &link);
        prop_assert_eq!(&station.label, &wanted.label);
        let outward = nalgebra::Vector3::from(built.patches[0].outward);
        let nodes = &station.layout.patches[0].nodes;
        prop_assert!(nodes.iter().all(|node| (node.normal_in_link.into_inner() - outward).norm() < 1e-6));
    }

    #[test]
    fn any_link_of_the_shipped_robots_makes_a_station(
        which in 0..SHIPPED.len(),
        link in any::<prop::sample::Index>(),
        outward in prop::sample::select(vec!["+x", "-x", "+y", "-y", "+z", "-z"]),
    ) {
        let (file, text) = SHIPPED[which];
        let robot = Robot::from_urdf(file, text, &[]).unwrap();
        let link = &robot.links[link.index(robot.links.len())].name;
        let built = build(&wanted(&[&format!("pad={link}:3x2@12x8:{outward}")]), file, &plain(text)).unwrap();
        prop_assert_eq!(built.station.robot.num_dofs(), robot.num_dofs());
        prop_assert_eq!(built.station.layout.num_channels(), 6);
    }

    #[test]
    fn any_text_is_a_patch_or_says_what_is_expected(text in "[a-z=:@x0-9,.+-]{0,40}") {
        if let Err(problem) = text.parse::<NewPatch>() {
            prop_assert!(problem.contains("expected"), "{}", problem);
        }
    }
}
