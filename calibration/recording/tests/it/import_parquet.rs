//! Parquet files stand for the CSV files that they would be.

use std::{fs, path::Path, sync::Arc};

use palpate_recording::{
    Session, Take,
    import::{ImportOptions, Mapping, explain, import, import_csv},
};
use parquet::{
    data_type::{DoubleType, Int64Type},
    file::writer::SerializedFileWriter,
    schema::parser::parse_message_type,
};

use crate::support::station;

const TAKE_TOML: &str = "object = \"ball\"\nobject_pose = { position_m = [0.1, 0.0, 0.05] }\nprimitive = \"tap\"\n\
                         baseline_s = [0.0, 0.5]\n";
const START_NS: i64 = 0;

/// Names, and rows of whole nanoseconds and values.
struct Rows {
    names: Vec<String>,
    rows: Vec<(i64, Vec<f64>)>,
}

fn rows(names: &[&str], rate_hz: i64, value: impl Fn(f64, usize) -> f64) -> Rows {
    let row = |idx: i64| {
        let time_ns = START_NS + idx * 1_000_000_000 / rate_hz;
        let time_s = time_ns as f64 / 1e9;
        (time_ns, (0..names.len()).map(|column| value(time_s, column)).collect())
    };
    Rows {
        names: names.iter().map(|&name| name.to_owned()).collect(),
        rows: (0..2 * rate_hz).map(row).collect(),
    }
}

fn recording() -> [(&'static str, Rows); 3] {
    [
        ("joints", rows(&["curl_deg", "slide"], 20, |t, column| [1.5 * t, 0.01 + 0.001 * t][column])),
        (
            "gel",
            rows(&["tip.0", "tip.1", "tip.2"], 100, |t, column| {
                200.0 + (t * 7.0).sin() * (column + 1) as f64
            }),
        ),
        ("film", rows(&["pulp", "root"], 40, |t, column| 300.5 + t * column as f64)),
    ]
}

fn write_csv(path: &Path, Rows { names, rows }: &Rows) {
    let mut text = format!("stamp [ns],{}\n", names.join(","));
    for (time_ns, values) in rows {
        let values: Vec<String> = values.iter().map(f64::to_string).collect();
        text += &format!("{time_ns},{}\n", values.join(","));
    }
    fs::write(path, text).unwrap();
}

fn write_parquet(path: &Path, Rows { names, rows }: &Rows) {
    let columns: String = names.iter().map(|name| format!("optional double {name};")).collect();
    let schema = format!("message take {{ required int64 stamp (TIMESTAMP(NANOS,true)); {columns} }}");
    let schema = Arc::new(parse_message_type(&schema).unwrap());
    let mut writer =
        SerializedFileWriter::new(fs::File::create(path).unwrap(), schema, Arc::default()).unwrap();
    // In several groups, as large tables have them.
    for group_rows in rows.chunks(33) {
        let mut group = writer.next_row_group().unwrap();
        let mut column = group.next_column().unwrap().unwrap();
        let times: Vec<i64> = group_rows.iter().map(|(time_ns, _)| *time_ns).collect();
        column.typed::<Int64Type>().write_batch(&times, None, None).unwrap();
        column.close().unwrap();
        for idx in 0..names.len() {
            let mut column = group.next_column().unwrap().unwrap();
            let values: Vec<f64> = group_rows.iter().map(|(_, values)| values[idx]).collect();
            let levels = vec![1; values.len()];
            column.typed::<DoubleType>().write_batch(&values, Some(&levels), None).unwrap();
            column.close().unwrap();
        }
        group.close().unwrap();
    }
    writer.close().unwrap();
}

fn take_of(session_dir: &Path) -> Take {
    Session::open(session_dir).unwrap().take(0).unwrap()
}

#[test]
fn a_take_of_parquet_files_has_the_bits_of_one_of_csv_files() {
    let root = tempfile::tempdir().unwrap();
    let dirs = ["csv", "parquet", "mixed"].map(|name| root.path().join(name));
    for dir in &dirs {
        fs::create_dir_all(dir.join("take-01")).unwrap();
        fs::write(dir.join("take-01/take.toml"), TAKE_TOML).unwrap();
    }
    for (name, rows) in &recording() {
        write_csv(&dirs[0].join(format!("take-01/{name}.csv")), rows);
        write_parquet(&dirs[1].join(format!("take-01/{name}.parquet")), rows);
        let mixed = dirs[2].join("take-01");
        match *name {
            "gel" => write_parquet(&mixed.join("gel.parquet"), rows),
            name => write_csv(&mixed.join(format!("{name}.csv")), rows),
        }
    }
    let takes = dirs.each_ref().map(|dir| {
        let session = dir.with_extension("session");
        import_csv(&station(), dir, &session).unwrap();
        take_of(&session)
    });
    for other in &takes[1..] {
        assert_eq!(other.joints, takes[0].joints);
        assert_eq!(other.streams, takes[0].streams);
        assert_eq!(other.start_unix_ns, takes[0].start_unix_ns);
    }
    let report = explain(&station(), &dirs[1], ImportOptions::default()).unwrap();
    let file = &report.takes[0].files[0];
    assert_eq!(
        (file.file.as_str(), file.rows, file.time.as_str()),
        ("joints.parquet", 40, "column 1 (stamp [ns]), ns")
    );
    assert_eq!((file.columns[0].id.as_str(), file.columns[0].unit.as_str()), ("curl", "deg"));
}

#[test]
fn takes_that_are_parquet_files_follow_a_mapping() {
    let root = tempfile::tempdir().unwrap();
    let dir = root.path().join("data");
    fs::create_dir_all(&dir).unwrap();
    let all =
        rows(&["angle", "slide", "tip_0", "tip_1", "tip_2", "pulp", "root"], 40, |t, column| match column {
            0 => 1.5 * t,
            1 => 0.02,
            _ => 200.0 + column as f64 + (t * 7.0).sin(),
        });
    write_parquet(&dir.join("tap_1.parquet"), &all);
    let mapping = |extra: &str| {
        let text = format!(
            "format = 1\ntakes = \"files\"\npattern = \"*.parquet\"\n[[take]]\nobject = \"ball\"\n\
             object_pose = {{ position_m = [0.1, 0.0, 0.05] }}\nprimitive = \"tap\"\nbaseline_first_s = 0.5\n\
             [[file]]\n{extra}map = [{{ columns = \"angle\", joints = \"curl\", unit = \"deg\" }}, \
             {{ columns = [\"tip_0\", \"tip_1\", \"tip_2\"], patch = \"tip\" }}]\n"
        );
        let path = root.path().join("mapping.toml");
        fs::write(&path, text).unwrap();
        Mapping::read(&path).unwrap()
    };
    let plain = mapping("");
    let options = ImportOptions { mapping: Some(&plain), find_repetitions: false };
    let session = root.path().join("session");
    import(&station(), &dir, options, &session).unwrap();
    let take = take_of(&session);
    assert!((take.joints.positions[2 * 20 + 1] - (1.5_f64 * 0.5).to_radians()).abs() < 1e-12);
    let about_text = mapping("skip_lines = 1\n");
    let options = ImportOptions { mapping: Some(&about_text), find_repetitions: false };
    let error = import(&station(), &dir, options, &root.path().join("other")).unwrap_err().to_string();
    assert!(error.contains("tap_1.parquet") && error.contains("skip_lines: is about text"), "{error}");
}

#[test]
fn damaged_and_double_files_are_refused() {
    let root = tempfile::tempdir().unwrap();
    let take_dir = root.path().join("csv/take-01");
    fs::create_dir_all(&take_dir).unwrap();
    fs::write(take_dir.join("take.toml"), TAKE_TOML).unwrap();
    for (name, rows) in &recording() {
        write_parquet(&take_dir.join(format!("{name}.parquet")), rows);
    }
    let refused = || {
        let error =
            import_csv(&station(), &root.path().join("csv"), &root.path().join("session")).unwrap_err();
        assert!(!root.path().join("session").exists());
        error.to_string()
    };
    let (name, gel) = &recording()[1];
    write_csv(&take_dir.join(format!("{name}.csv")), gel);
    let error = refused();
    assert!(error.contains("gel.parquet: file: holds the same as") && error.contains("gel.csv"), "{error}");
    fs::remove_file(take_dir.join("gel.csv")).unwrap();
    let bytes = fs::read(take_dir.join("gel.parquet")).unwrap();
    fs::write(take_dir.join("gel.parquet"), &bytes[..bytes.len() / 2]).unwrap();
    let error = refused();
    assert!(error.contains("gel.parquet: file: cannot be read as Parquet"), "{error}");
}
