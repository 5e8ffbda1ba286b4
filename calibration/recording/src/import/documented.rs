//! The page about recordings says all that the readers know: fields of structs are those that serde has.

use std::path::Path;

use palpate_robot_model::Station;

use super::{
    Mapping,
    config::{TakeConfig, documented_fields, listed_fields},
};

const PAGE: &str = include_str!("../../../../docs/recordings.md");

/// Code spans of the page, words in them: what a reader can find by searching.
fn mentions(field: &str) -> bool {
    let is_word = |c: char| c.is_ascii_alphanumeric() || c == '_';
    PAGE.split('`').skip(1).step_by(2).any(|code| code.split(|c| !is_word(c)).any(|word| word == field))
}

#[test]
fn every_field_that_people_write_is_on_the_page() {
    let sections = documented_fields();
    for (section, fields) in &sections {
        assert!(fields.len() >= 4, "{section}: {fields:?}");
        for field in fields {
            assert!(mentions(field), "docs/recordings.md does not mention `{field}` of {section}");
        }
    }
    assert_eq!(
        sections[0].1.len() + 1,
        sections[2].1.len(),
        "[[take]] has the fields of take.toml and a name"
    );
}

#[test]
fn every_field_of_station_and_layout_is_on_the_page() {
    let dir = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures/finger-station");
    let read = |file: &str| std::fs::read(dir.join(file)).map_err(|error| error.to_string());
    let mut num_fields = 0;
    for (file, header) in [
        ("station.toml", "id ="),
        ("station.toml", "stream ="),
        ("layout.toml", "name ="),
        ("layout.toml", "kind ="),
        ("layout.toml", "link ="),
    ] {
        // An unknown key before a known one stands in the same table.
        let error = Station::read("station.toml", |path| {
            let bytes = read(path)?;
            if path != file {
                return Ok(bytes);
            }
            let text = "\n".to_owned() + &String::from_utf8(bytes).map_err(|error| error.to_string())?;
            Ok(text
                .replacen(&format!("\n{header}"), &format!("\nno_such_field = 1\n{header}"), 1)
                .into_bytes())
        })
        .expect_err("an unknown key")
        .to_string();
        let fields = listed_fields(&error);
        assert!(fields.len() >= 3, "{file}, beside {header:?}: {error}");
        for field in &fields {
            assert!(mentions(field), "docs/recordings.md does not mention `{field}` of {file}");
        }
        num_fields += fields.len();
    }
    assert!(num_fields > 30, "{num_fields}");
}

#[test]
fn examples_on_the_page_are_read() {
    let mut num_mappings = 0;
    for block in PAGE.split("```toml\n").skip(1).filter_map(|rest| rest.split("```").next()) {
        if block.starts_with("format") {
            Mapping::parse(Path::new("docs/recordings.md"), block).unwrap();
            num_mappings += 1;
        } else {
            let take: TakeConfig = toml::from_str(block).unwrap();
            assert!(take.object.is_some() && take.object_pose.is_some() && take.primitive.is_some());
        }
    }
    assert_eq!(num_mappings, 2);
}
