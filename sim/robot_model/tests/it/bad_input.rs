//! Faults in the shipped files, as somebody who edits them makes them: the error names the place.

use palpate_robot_model::{ModelError, Station};

use crate::repository;

/// The LEAP station with `from` replaced by `to` in the file whose path ends with `file`.
fn edited(file: &str, from: &str, to: &str) -> ModelError {
    let folder = repository().join("assets/stations");
    let mut edited = false;
    let result = Station::read("xarm6_leap.toml", |path| {
        let bytes = std::fs::read(folder.join(path)).map_err(|err| err.to_string())?;
        if !path.ends_with(file) {
            return Ok(bytes);
        }
        let text = String::from_utf8(bytes).map_err(|err| err.to_string())?;
        assert!(text.contains(from), "{path} has no {from:?}");
        edited = true;
        Ok(text.replacen(from, to, 1).into_bytes())
    });
    assert!(edited, "{file} was not read");
    result.err().unwrap_or_else(|| panic!("{from:?} -> {to:?} in {file} is accepted"))
}

fn assert_names(error: &ModelError, file: &str, words: &[&str]) {
    let text = error.to_string();
    assert!(error.file.ends_with(file), "{text}");
    for word in words {
        assert!(text.contains(word), "{word:?} is missing: {text}");
    }
}

#[test]
fn a_urdf_whose_joint_lacks_its_link_names_joint_and_link() {
    let error =
        edited("xarm6_leap_right.urdf", "<child link=\"index_base\"/>", "<child link=\"index_knuckle\"/>");
    assert_names(&error, "xarm6_leap_right.urdf", &["index_mcp_forward", "index_knuckle"]);
}

#[test]
fn a_urdf_with_a_non_finite_number_names_the_joint() {
    let error = edited("xarm6_leap_right.urdf", "<origin xyz=\"0 0 0.267\"", "<origin xyz=\"0 0 nan\"");
    assert_names(&error, "xarm6_leap_right.urdf", &["joint1"]);
}

#[test]
fn a_urdf_that_is_not_xml_is_refused() {
    let error = edited("xarm6_leap_right.urdf", "</robot>", "");
    assert_names(&error, "xarm6_leap_right.urdf", &[]);
}

#[test]
fn a_layout_that_names_an_unknown_link_names_line_patch_and_the_links_there_are() {
    let error = edited("leap_44.toml", "link = \"thumb_medial\"", "link = \"thumb_dip\"");
    assert_names(
        &error,
        "leap_44.toml",
        &["line ", "patch \"thumb_medial\"", "unknown link \"thumb_dip\"", "\"thumb_distal\""],
    );
}

#[test]
fn a_layout_with_broken_syntax_names_the_line() {
    let error = edited("leap_44.toml", "rate_hz = 100.0", "rate_hz = 100,0");
    assert_names(&error, "leap_44.toml", &["line 16"]);
}

#[test]
fn a_station_with_a_misspelt_joint_names_it() {
    let error = edited("xarm6_leap.toml", "\"thumb_axial\"", "\"thumb_axle\"");
    assert_names(&error, "xarm6_leap_right.urdf", &["thumb_axle"]);
}

#[test]
fn a_station_without_the_thresholds_of_a_stream_names_the_stream() {
    let error = edited("xarm6_leap.toml", "stream = \"fsr\"", "stream = \"fsr2\"");
    assert_names(&error, "xarm6_leap.toml", &["fsr2", "\"twintac\", \"fsr\""]);
}

#[test]
fn a_missing_object_file_is_named_with_its_line() {
    let error = edited("xarm6_leap.toml", "sphere_50mm.toml", "sphere_60mm.toml");
    assert_names(&error, "xarm6_leap.toml", &["line 8", "objects", "sphere_60mm.toml"]);
}

#[test]
fn a_mesh_with_a_hole_is_refused() {
    let first_facet_vertex = "vertex -40 -30 -20";
    let error = edited("meshes/wedge_80mm.stl", first_facet_vertex, "vertex -41 -30 -20");
    assert_names(&error, "wedge_80mm.toml", &["wedge_80mm.stl", "closed surface"]);
}
