//! Recordings as people have them: columns by name, mapping files, units, falling readings.

use std::{
    fmt::Write as _,
    fs,
    path::{Path, PathBuf},
};

use palpate_recording::{
    Session, SpanKind, Take, check_session,
    import::{ImportOptions, ImportReport, Mapping, explain, fits, import, import_csv},
    load_station,
};
use proptest::prelude::*;

use crate::support::{fixtures, station, tree};

const TAKE_TOML: &str = r#"object = "ball"
object_pose = { position_m = [0.1, 0.0, 0.05] }
primitive = "tap"
baseline_s = [0.0, 0.9]
"#;

/// A column: its header, and its value at a time.
type Column = (&'static str, fn(f64) -> f64);

const SLIDE: Column = ("slide", |t| 0.02 * t);
const CURL: Column = ("curl", |t| -0.75 * t);
const GEL: [Column; 3] = [
    ("tip.0", |t| 200.0 + (t * 7.0).sin()),
    ("tip.1", |t| if (1.0..1.5).contains(&t) { 710.0 } else { 210.0 }),
    ("tip.2", |t| 190.0 + (t * 5.0).sin()),
];
const FILM: [Column; 2] = [("pulp", |t| 300.0 + t), ("root", |t| if t >= 1.5 { 810.0 } else { 310.0 })];

fn csv(time: &str, rate_hz: f64, time_scale: f64, columns: &[Column]) -> String {
    let header: Vec<&str> = std::iter::once(time).chain(columns.iter().map(|column| column.0)).collect();
    let mut text = header.join(",") + "\n";
    for time_s in (0..(2.0 * rate_hz) as usize).map(|row| row as f64 / rate_hz) {
        write!(text, "{}", time_s * time_scale).unwrap();
        for (_, value) in columns {
            write!(text, ",{}", value(time_s)).unwrap();
        }
        text.push('\n');
    }
    text
}

fn write(dir: &Path, files: &[(&str, &str)]) {
    fs::create_dir_all(dir).unwrap();
    for (name, text) in files {
        fs::write(dir.join(name), text).unwrap();
    }
}

fn numbered(dir: &Path) {
    let renamed = |columns: &[Column], names: &[&'static str]| -> Vec<Column> {
        columns.iter().zip(names).map(|(column, &name)| (name, column.1)).collect()
    };
    write(
        dir,
        &[
            ("take.toml", TAKE_TOML),
            ("joints.csv", &csv("t_s", 10.0, 1.0, &renamed(&[SLIDE, CURL], &["q0", "q1"]))),
            ("gel.csv", &csv("t_s", 100.0, 1.0, &renamed(&GEL, &["v0", "v1", "v2"]))),
            ("film.csv", &csv("t_s", 40.0, 1.0, &renamed(&FILM, &["v0", "v1"]))),
        ],
    );
}

fn take_of(root: &Path, csv_dir: &Path, mapping: Option<&str>) -> Result<(Take, ImportReport), String> {
    let mapping = mapping.map(|text| Mapping::parse(Path::new("mapping.toml"), text)).transpose();
    let mapping = mapping.map_err(|error| error.to_string())?;
    let options = ImportOptions { mapping: mapping.as_ref(), find_repetitions: false };
    let out = root.join("session");
    let result = import(&station(), csv_dir, options, &out);
    let (dir, report) =
        result.map_err(|error| error.to_string().replace(&root.display().to_string(), "ROOT"))?;
    let take = Session::open(&dir).unwrap().take(0).unwrap();
    fs::remove_dir_all(&out).unwrap();
    Ok((take, report))
}

fn assert_same(a: &Take, b: &Take) {
    assert_eq!(a.joints, b.joints);
    assert_eq!(a.streams, b.streams);
    assert_eq!((&a.spans, &a.meta, a.start_unix_ns), (&b.spans, &b.meta, b.start_unix_ns));
}

fn reference(root: &Path) -> Take {
    numbered(&root.join("numbered/a"));
    take_of(root, &root.join("numbered"), None).unwrap().0
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn the_order_of_columns_does_not_matter(
        joints in Just(vec![SLIDE, CURL]).prop_shuffle(),
        gel in Just(GEL.to_vec()).prop_shuffle(),
        film in Just(FILM.to_vec()).prop_shuffle(),
        extra in 0_usize..4,
    ) {
        let root = tempfile::tempdir().unwrap();
        let mut joints = joints;
        joints.insert(extra.min(2), ("effort", |t| t * t));
        write(&root.path().join("csv/a"), &[
            ("take.toml", TAKE_TOML),
            ("joints.csv", &csv("t_s", 10.0, 1.0, &joints)),
            ("gel.csv", &csv("t_s", 100.0, 1.0, &gel)),
            ("film.csv", &csv("t_s", 40.0, 1.0, &film)),
        ]);
        let (take, report) = take_of(root.path(), &root.path().join("csv"), None).unwrap();
        assert_same(&take, &reference(root.path()));
        prop_assert_eq!(report.takes[0].files[0].ignored.len(), 1);
        prop_assert!(report.takes[0].warnings[0].contains("\"effort\" is no joint"));
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn any_table_under_any_mapping_gives_a_session_or_an_error(
        table in "[0-3.;,\\-a-c \\n\\t\"]{0,120}",
        has_rows in any::<bool>(),
        delimiter in prop::sample::select(vec!["comma", "semicolon", "tab", "blanks"]),
        (header, skip, lines) in prop_oneof![Just((true, 0, 1)), Just((true, 2, 1)), (Just(false), 0..3_usize, 1..4_usize)],
        (first, rate_hz) in (0..6_usize, prop::sample::select(vec![1e-300, 0.5, 10.0, 1e300])),
        polarity in prop::sample::select(vec![-1, 1]),
    ) {
        let root = tempfile::tempdir().unwrap();
        // Half of the tables begin as they should, so that many get far.
        let good = "0 0 9 9 9 9 9\n1 0 9 9 9 9 9\n2 0 9 9 9 9 9\n";
        let table = if has_rows { good.to_owned() + &table } else { table };
        write(&root.path().join("csv/a"), &[("log.csv", &table)]);
        let text = format!(
            "format = 1\ntake = [{{ object = 'ball', object_pose = {{ position_m = [0.1, 0, 0] }}, primitive = 'x', \
             baseline_first_s = 1e300 }}]\nfixed_joints = {{ slide = 0.1 }}\n[[file]]\nfile = 'log.csv'\n\
             delimiter = '{delimiter}'\nheader = {header}\nskip_lines = {skip}\nlines_per_row = {lines}\n\
             time = {{ rate_hz = {rate_hz:e} }}\n[[file.map]]\ncolumns = {}\njoints = 'curl'\n\
             [[file.map]]\ncolumns = '3..5'\nstream = 'gel'\npolarity = {polarity}\n\
             [[file.map]]\ncolumns = [6, 7]\nstream = 'film'\n",
            first + 1
        );
        let mapping = Mapping::parse(Path::new("mapping.toml"), &text).unwrap();
        let options = ImportOptions { mapping: Some(&mapping), find_repetitions: true };
        let (dir, out) = (root.path().join("csv"), root.path().join("session"));
        let explained = explain(&station(), &dir, options).unwrap();
        match import(&station(), &dir, options, &out) {
            Ok(_) => {
                prop_assert!(explained.ok && fits(&station(), &dir, Some(&mapping)).is_ok());
                Session::open(&out).unwrap().take(0).unwrap();
            }
            Err(error) => {
                prop_assert!(!explained.ok && !out.exists());
                let problem = explained.takes[0].problem.clone();
                prop_assert_eq!(problem, Some(error.to_string()));
            }
        }
    }
}

#[test]
fn units_in_headers_are_converted() {
    let root = tempfile::tempdir().unwrap();
    let wanted = reference(root.path());
    write(
        &root.path().join("csv/a"),
        &[
            ("take.toml", TAKE_TOML),
            (
                "joints.csv",
                &csv(
                    "stamp [ms]",
                    10.0,
                    1e3,
                    &[("curl_deg", |t| (-0.75 * t).to_degrees()), ("slide (mm)", |t| 20.0 * t)],
                ),
            ),
            ("gel.csv", &csv("t_us", 100.0, 1e6, &GEL)),
            ("film.csv", &csv("time", 40.0, 1.0, &FILM)),
        ],
    );
    let (take, report) = take_of(root.path(), &root.path().join("csv"), None).unwrap();
    for (found, wanted) in take.joints.positions.iter().zip(&wanted.joints.positions) {
        assert!((found - wanted).abs() < 1e-12, "{found} {wanted}");
    }
    assert_eq!(take.joints.times_s, wanted.joints.times_s);
    assert_eq!(take.streams, wanted.streams);
    let columns = &report.takes[0].files[0].columns;
    assert_eq!(
        (columns[0].id.as_str(), columns[0].unit.as_str(), columns[0].to_unit.as_str()),
        ("curl", "deg", "rad")
    );
    assert_eq!(report.takes[0].files[0].time, "column 1 (stamp [ms]), ms");
}

#[test]
fn one_file_may_hold_everything_with_gaps_where_a_stream_has_no_sample() {
    let root = tempfile::tempdir().unwrap();
    let wanted = reference(root.path());
    // At 200 Hz, so that each stream's samples are some of the rows: every 20th, 2nd, 5th.
    let all: Vec<Column> = [SLIDE].into_iter().chain(GEL).chain(FILM).chain([CURL]).collect();
    let mut text = format!("t_s,{}\n", all.iter().map(|column| column.0).collect::<Vec<_>>().join(","));
    for row in 0..400_u32 {
        let time_s = f64::from(row) / 200.0;
        let cells = all.iter().map(|(id, value)| {
            let every = if ["slide", "curl"].contains(id) {
                20
            } else if id.starts_with("tip") {
                2
            } else {
                5
            };
            if row % every == 0 { value(time_s).to_string() } else { String::new() }
        });
        text += &format!("{time_s},{}\n", cells.collect::<Vec<_>>().join(","));
    }
    write(&root.path().join("csv/a"), &[("take.toml", TAKE_TOML), ("log.csv", &text)]);
    let (take, _) = take_of(root.path(), &root.path().join("csv"), None).unwrap();
    assert_same(&take, &wanted);

    // As files without folders and without take.toml, separated otherwise.
    let european = text.replace(',', ";").replace('.', ",").replace("tip,", "tip.");
    write(&root.path().join("flat"), &[("first.txt", &european), ("notes.txt", "nothing")]);
    let mapping = r#"
        format = 1
        takes = "files"
        pattern = "*.txt"
        except = ["notes*"]
        [[take]]
        object = "ball"
        object_pose = { position_m = [0.1, 0.0, 0.05] }
        [[take]]
        name = "f*"
        primitive = "tap"
        baseline_s = [0.0, 0.9]
        [[file]]
        delimiter = "semicolon"
        decimal_comma = true
    "#;
    let (take, report) = take_of(root.path(), &root.path().join("flat"), Some(mapping)).unwrap();
    assert_same(&take, &wanted);
    assert_eq!(report.takes[0].take, "first");
}

#[test]
fn a_mapping_renames_scales_and_joins_files() {
    let root = tempfile::tempdir().unwrap();
    let wanted = reference(root.path());
    // The slide in encoder counts of 20 um, ten times as fast as the other joint's file; the gel on two boards.
    let counts: Column = ("/motor/1/ticks", |t| 0.02 * t / 2e-5);
    write(
        &root.path().join("csv/a"),
        &[
            ("a_slide.csv", &csv("ns", 100.0, 1e9, &[counts])),
            ("a_hand.csv", &csv("t_s", 10.0, 1.0, &[("/hand/curl/position", CURL.1)])),
            ("board0.csv", &csv("t_s", 100.0, 1.0, &[("x", GEL[0].1), ("y", GEL[1].1)])),
            ("board1.csv", &csv("t_s", 100.0, 1.0, &[("x", GEL[2].1)])),
            ("film.csv", &csv("t_s", 40.0, 1.0, &FILM)),
        ],
    );
    let mapping = r#"
        format = 1
        [[take]]
        object = "ball"
        object_pose = { position_m = [0.1, 0.0, 0.05] }
        primitive = "tap"
        baseline_first_s = 0.9
        [[file]]
        file = "{take}_slide.csv"
        time = { column = "ns", unit = "ns" }
        map = [{ columns = "/motor/1/ticks", joints = "slide", scale = 2e-5 }]
        [[file]]
        file = "{take}_hand.csv"
        names = ["/hand/*/position"]
        [[file]]
        file = "board0.csv"
        map = [{ columns = ["x", "y"], channels = ["tip.0", "tip.1"] }]
        [[file]]
        file = "board1.csv"
        map = [{ columns = 2, channels = "tip.2", unit = "counts" }]
        [[file]]
        file = "film.csv"
    "#;
    let (take, report) = take_of(root.path(), &root.path().join("csv"), Some(mapping)).unwrap();
    assert_eq!(take.streams, wanted.streams);
    // The times of the faster file, as long as both have values.
    assert_eq!(take.joints.times_s.len(), 191);
    for (row, &time_s) in take.joints.times_s.iter().enumerate() {
        let [slide, curl] = [take.joints.positions[2 * row], take.joints.positions[2 * row + 1]];
        assert!(
            (slide - 0.02 * time_s).abs() < 1e-9 && (curl + 0.75 * time_s).abs() < 1e-9,
            "{time_s}: {slide} {curl}"
        );
    }
    let notes = &report.takes[0].notes;
    assert_eq!(
        notes[..],
        [
            "a_hand.csv interpolated to the times of a_slide.csv; 9 rows without all files left out",
            "board1.csv held until the next reading at the times of board0.csv"
        ]
    );
}

#[test]
fn readings_that_fall_under_load_are_touches() {
    let root = tempfile::tempdir().unwrap();
    numbered(&root.path().join("csv/a"));
    // The middle taxel falls from 900 by 500 where the other recording rises.
    let mut gel = GEL;
    gel[0].0 = "v0";
    gel[1] = ("v1", |t| 1110.0 - GEL[1].1(t));
    gel[2].0 = "v2";
    write(&root.path().join("csv/a"), &[("gel.csv", &csv("t_s", 100.0, 1.0, &gel))]);
    let fell = |take: &Take| (0..200).filter(|sample| take.streams[0].active[3 * sample + 1]).count();
    let (as_it_is, report) = take_of(root.path(), &root.path().join("csv"), None).unwrap();
    assert_eq!(fell(&as_it_is), 0);
    assert_eq!(
        report.takes[0].warnings.last().unwrap(),
        "channel \"tip.1\" never rises from its reading at rest, but falls by up to 500 counts; if a touch makes it fall, \
         import it with polarity = -1 in a mapping file"
    );
    // The check of a session says so too, instead of asking whether it is connected.
    let dir = import_csv(&station(), &root.path().join("csv"), &root.path().join("checked")).unwrap();
    let problems = check_session(&Session::open(&dir).unwrap()).unwrap().problems;
    let of = |id: &str| problems.iter().find(|problem| problem.place == id).unwrap().message.clone();
    assert!(of("tip.1").contains("falls by up to 500 counts"), "{}", of("tip.1"));
    assert!(of("tip.0").starts_with("never touched"), "{}", of("tip.0"));

    let mapping = r#"
        format = 1
        [[file]]
        file = "joints.csv"
        [[file]]
        file = "gel.csv"
        map = [{ channels = "tip.1", polarity = -1 }]
        [[file]]
        file = "film.csv"
    "#;
    let (take, report) = take_of(root.path(), &root.path().join("csv"), Some(mapping)).unwrap();
    assert_eq!(fell(&take), 50);
    // Others stay as they were, to the bit.
    for sample in 0..200 {
        assert_eq!(take.streams[0].raw[3 * sample], as_it_is.streams[0].raw[3 * sample]);
        let mirrored = 4095.0 - as_it_is.streams[0].raw[3 * sample + 1];
        assert_eq!(take.streams[0].raw[3 * sample + 1], mirrored);
    }
    assert_eq!(
        report.takes[0].notes,
        ["readings that fall under load are kept as 4095 counts minus the reading: \"tip.1\""]
    );
    assert!(report.takes[0].warnings.iter().all(|warning| !warning.contains("falls")), "{report:?}");
}

#[test]
fn repetitions_are_found_where_none_are_marked() {
    let root = tempfile::tempdir().unwrap();
    numbered(&root.path().join("csv/a"));
    // Rest, then three equal curls of half a second.
    let curls: Column =
        ("curl", |t| if t < 0.4 { 0.0 } else { -0.6 * (std::f64::consts::TAU * (t - 0.4)).sin().powi(2) });
    write(
        &root.path().join("csv/a"),
        &[("joints.csv", &csv("t_s", 50.0, 1.0, &[("slide", |_| 0.05), curls]))],
    );
    let (dir, out) = (root.path().join("csv"), root.path().join("session"));
    let options = ImportOptions { mapping: None, find_repetitions: true };
    let (session, report) = import(&station(), &dir, options, &out).unwrap();
    let take = Session::open(&session).unwrap().take(0).unwrap();
    let spans: Vec<_> = take.spans.iter().filter(|span| span.kind == SpanKind::Repetition).collect();
    assert_eq!(spans.len(), 3, "{:?}", report.takes[0].repetitions);
    assert!(
        spans.iter().all(|span| span.label == "tap" && (span.end_s - span.start_s - 0.5).abs() < 0.05),
        "{spans:?}"
    );
    assert_eq!(report.takes[0].repetitions_from, "joint path");
    assert!(
        report.takes[0]
            .warnings
            .iter()
            .any(|warning| warning.contains("joint \"slide\" (0.05 m) never changes"))
    );

    // Whoever says that there are none is believed.
    fs::write(dir.join("a/take.toml"), format!("{TAKE_TOML}repetitions_s = []\n")).unwrap();
    let report = explain(&station(), &dir, options).unwrap();
    assert_eq!((report.takes[0].repetitions_from.as_str(), report.takes[0].repetitions.len()), ("none", 0));
}

#[test]
fn explaining_writes_nothing_and_names_the_problem_of_every_take() {
    let root = tempfile::tempdir().unwrap();
    for take in ["a", "b", "c"] {
        numbered(&root.path().join("csv").join(take));
    }
    let bad = csv("t_s", 10.0, 1.0, &[SLIDE, ("curll", CURL.1)]);
    write(&root.path().join("csv/a"), &[("joints.csv", &bad)]);
    write(&root.path().join("csv/c"), &[("take.toml", &TAKE_TOML.replace("ball", "bal"))]);
    let before = tree(root.path());
    let report = explain(&station(), &root.path().join("csv"), ImportOptions::default()).unwrap();
    assert_eq!(tree(root.path()), before);
    assert!(!report.ok);
    let problems: Vec<Option<&str>> = report.takes.iter().map(|take| take.problem.as_deref()).collect();
    assert!(
        problems[0].unwrap().contains("no column for joint \"curl\"; \"curll\" looks like \"curl\""),
        "{problems:?}"
    );
    assert_eq!(problems[1], None);
    assert!(problems[2].unwrap().contains("knows \"ball\", \"wedge\"; is it \"ball\"?"), "{problems:?}");
    assert_eq!(report.takes[1].streams[1].samples, 200);
}

#[test]
fn stations_fit_by_names_numbers_and_objects() {
    let root = tempfile::tempdir().unwrap();
    numbered(&root.path().join("csv/a"));
    let dir = root.path().join("csv");
    let bench = load_station(&fixtures().join("../../assets/stations/probe_bench.toml")).unwrap();
    fits(&station(), &dir, None).unwrap();
    assert!(fits(&bench, &dir, None).unwrap_err().to_string().contains("object"));
    fs::write(dir.join("a/take.toml"), TAKE_TOML.replace("ball", "sphere_50mm")).unwrap();
    let error = fits(&bench, &dir, None).unwrap_err().to_string();
    assert!(error.contains("2 joint columns beside t_s, the station has 3"), "{error}");
    let all: Vec<Column> = [SLIDE, CURL].into_iter().chain(GEL).chain(FILM).collect();
    for file in ["joints.csv", "gel.csv", "film.csv"] {
        fs::remove_file(dir.join("a").join(file)).unwrap();
    }
    write(&dir.join("a"), &[("log.csv", &csv("t_s", 10.0, 1.0, &all))]);
    let error = fits(&bench, &dir, None).unwrap_err().to_string();
    assert!(error.contains("no column for joints \"stage_x\", \"stage_y\", \"stage_z\""), "{error}");
}

/// What is wrong, and the message about it.
#[test]
fn messages_of_faults_stay_as_they_are() {
    let joints = |text: &str| ("joints.csv", text.to_owned());
    let plain: Vec<(&str, (&str, String))> = vec![
        ("a name is nearly right", joints("t_s,slide,crul\n0,0,0\n0.1,0,0\n")),
        ("nothing is known", joints("t_s,a,b\n0,0,0\n")),
        ("a column twice", joints("t_s,slide,curl,slide\n0,0,0,0\n")),
        ("no time", joints("slide,curl\n0,0\n")),
        ("two times", joints("t_s,stamp_ms,slide,curl\n0,0,0,0\n")),
        ("another delimiter", joints("t_s;slide;curl\n0;0;0\n")),
        ("a unit of something else", joints("t_s,slide [deg],curl\n0,0,0\n")),
        ("an unknown unit", joints("t_s,slide,curl [turns]\n0,0,0\n")),
        ("a unit of time that is none", joints("t [mm],slide,curl\n0,0,0\n")),
        ("milliseconds as seconds", joints("time,slide,curl\n0,0,0\n100,0,0\n200,0,0\n300,0,0\n")),
        ("a word", joints("t_s,slide,curl\n0,0,0\n0.1,0,open\n")),
        ("a cell is empty", joints("t_s,slide,curl\n0,0,0\n0.1,0,\n")),
        ("a ragged row", joints("t_s,slide,curl\n0,0,0\n0.1,0\n")),
        ("times go back", joints("t_s,curl,slide\n0.2,0,0\n0.1,0,0\n")),
        ("out of limits", joints("t_s,curl,slide\n0,0,0\n0.1,9,0\n")),
        ("no rows", joints("t_s,curl,slide\n")),
        ("below the range", ("gel.csv", "t_s,tip.2,tip.0,tip.1\n0,1,-4,1\n".to_owned())),
        ("a decimal comma", ("gel.csv", "t_s,tip.2,tip.0,tip.1\n0,\"1,5\",4,1\n".to_owned())),
    ];
    let mut messages = String::new();
    for (what, (file, text)) in plain {
        let root = tempfile::tempdir().unwrap();
        numbered(&root.path().join("csv/a"));
        write(&root.path().join("csv/a"), &[(file, &text)]);
        let message = take_of(root.path(), &root.path().join("csv"), None).unwrap_err();
        writeln!(messages, "{what}\n    {message}").unwrap();
    }
    let mappings = [
        ("an unknown field", "format = 1\n[[file]]\nfile = \"joints.csv\"\ndelimeter = \"tab\"\n"),
        ("another format", "format = 2\n"),
        ("a pattern without folders as files", "format = 1\npattern = \"*.txt\"\n"),
        ("a file without a name", "format = 1\n[[file]]\nheader = true\n"),
        ("a file elsewhere", "format = 1\n[[file]]\nfile = \"../joints.csv\"\n"),
        ("nowhere a time", "format = 1\n[[file]]\nfile = \"joints.csv\"\nheader = false\n"),
        (
            "a time twice",
            "format = 1\n[[file]]\nfile = \"joints.csv\"\ntime = { column = 1, rate_hz = 10 }\n",
        ),
        ("a rate of zero", "format = 1\n[[file]]\nfile = \"joints.csv\"\ntime = { rate_hz = 0 }\n"),
        (
            "a polarity of two",
            "format = 1\n[[file]]\nfile = \"gel.csv\"\nmap = [{ stream = \"gel\", polarity = 2 }]\n",
        ),
        (
            "a joint that falls",
            "format = 1\n[[file]]\nfile = \"joints.csv\"\nmap = [{ joints = \"curl\", polarity = -1 }]\n",
        ),
        (
            "an unknown channel",
            "format = 1\n[[file]]\nfile = \"gel.csv\"\nmap = [{ columns = 2, channels = \"tip0\" }]\n",
        ),
        (
            "an unknown patch",
            "format = 1\n[[file]]\nfile = \"gel.csv\"\nmap = [{ columns = 2, patch = \"toe\" }]\n",
        ),
        (
            "an unknown column",
            "format = 1\n[[file]]\nfile = \"gel.csv\"\nmap = [{ columns = \"v9\", channels = \"tip.0\" }]\n",
        ),
        (
            "a column past the last",
            "format = 1\n[[file]]\nfile = \"gel.csv\"\nmap = [{ columns = \"3..5\", stream = \"gel\" }]\n",
        ),
        (
            "too few columns",
            "format = 1\n[[file]]\nfile = \"gel.csv\"\nmap = [{ columns = [2, 3], stream = \"gel\" }]\n",
        ),
        (
            "a column of two",
            "format = 1\n[[file]]\nfile = \"joints.csv\"\nmap = [{ columns = [2, 2], joints = [\"slide\", \"curl\"] }]\n",
        ),
        ("an unknown fixed joint", "format = 1\n[fixed_joints]\nslied = 0.1\n"),
        ("a fixed joint that was recorded", "format = 1\n[fixed_joints]\nslide = 0.1\n"),
        (
            "nothing is what it says",
            "format = 1\n[[file]]\nfile = \"joints.csv\"\n[[file]]\nfile = \"film.csv\"\n",
        ),
        ("a missing file", "format = 1\n[[file]]\nfile = \"joint.csv\"\n"),
        (
            "half a row",
            "format = 1\n[[file]]\nfile = \"joints.csv\"\nheader = false\nskip_lines = 1\nlines_per_row = 3\ntime = { rate_hz = 10 }\nmap = [{ columns = [2, 3], joints = [\"slide\", \"curl\"] }]\n",
        ),
        ("a take without fields", "format = 1\ntakes = \"files\"\n[[file]]\nfile = \"x\"\n"),
    ];
    for (what, mapping) in mappings {
        let root = tempfile::tempdir().unwrap();
        let dir = root.path().join("csv/a");
        numbered(&dir);
        write(
            &dir,
            &[
                ("joints.csv", &csv("t_s", 10.0, 1.0, &[SLIDE, CURL])),
                ("film.csv", &csv("t_s", 40.0, 1.0, &FILM)),
            ],
        );
        let csv_dir: PathBuf = if mapping.contains("takes = ") { dir } else { root.path().join("csv") };
        let message = take_of(root.path(), &csv_dir, Some(mapping)).unwrap_err();
        writeln!(messages, "{what}\n    {message}").unwrap();
    }
    insta::assert_snapshot!(messages);
}

/// A few frames as the iCub Grasp Dataset has them, of made-up numbers: a finger closes on something at the fourth.
fn icub_like(num_frames: usize) -> String {
    let mut text = "-10000\r\n".to_owned();
    for frame in 0..num_frames {
        let closed = frame as f64;
        writeln!(
            text,
            "20.5 80.5 {} 20.5 {} 60.0 36.0 {} 5.0 \r",
            15.0 + closed,
            30.0 + closed,
            40.0 + 2.0 * closed
        )
        .unwrap();
        text += "12.0 20.0 11.0 12.0 11.0\r\n";
        for finger in 0..5 {
            let pressed = if finger == 1 && frame >= 3 { 9.0 } else { 0.0 };
            let taxels: Vec<String> = (0..12)
                .map(|taxel| format!("{:.1}", 244.0 - if taxel == 2 { pressed } else { 0.0 }))
                .collect();
            text += &(taxels.join(" ") + "\r\n");
        }
    }
    text
}

#[test]
fn a_skin_that_falls_in_seven_lines_a_frame_without_time_is_imported() {
    let example = fixtures().join("../../docs/examples/icub_grasp");
    let station = load_station(&example.join("station.toml")).unwrap();
    let mapping = Mapping::read(&example.join("mapping.toml")).unwrap();
    assert_eq!(mapping.station(), Some("station.toml"));
    let root = tempfile::tempdir().unwrap();
    let dir = root.path().join("data");
    write(
        &dir,
        &[("book_1.txt", &icub_like(12)), ("none_2.txt", &icub_like(3)), ("README.txt", "about the data")],
    );
    let options = ImportOptions { mapping: Some(&mapping), find_repetitions: true };
    let (session, report) = import(&station, &dir, options, &root.path().join("session")).unwrap();
    let session = Session::open(&session).unwrap();
    let take = session.take(0).unwrap();
    assert_eq!(
        (take.id.as_str(), take.meta.primitive.as_str(), take.meta.fixture_trusted),
        ("book_1", "grasp_book", false)
    );
    assert_eq!(session.take(1).unwrap().meta.primitive, "close_on_nothing");
    assert!((take.joints.positions[1] - 80.5_f64.to_radians()).abs() < 1e-15);
    assert_eq!(take.joints.times_s[11], 1.1);
    // The third taxel of the index finger: 255 - 244 at rest.
    let touched = 12 + 2;
    assert_eq!(take.streams[0].raw[touched], 11.0);
    let active: Vec<usize> =
        take.streams[0].active.iter().enumerate().filter(|(_, on)| **on).map(|(cell, _)| cell % 60).collect();
    assert_eq!(active, [touched; 9]);
    assert_eq!(report.takes[0].files[0].columns.len(), 69);
    assert!(check_session(&session).unwrap().ok);
}
