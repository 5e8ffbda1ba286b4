//! The sensor model file: what is read, written and refused.

use proptest::prelude::*;

use super::*;

const MODEL: &str = "format = 1\nname = \"nominal\"\n\n[theta]\nlambda_con_m = 0.002\nalpha_per_m = 250\nlambda_pre_pa = 1200.0\n";

fn refusal(from: &str, to: &str) -> String {
    assert!(MODEL.contains(from), "{from:?} is not in the fixture");
    SensorModel::from_toml("model.toml", &MODEL.replacen(from, to, 1))
        .expect_err("must be refused")
        .to_string()
}

#[test]
fn a_model_is_read() {
    let model = SensorModel::from_toml("model.toml", MODEL).expect("valid");
    assert_eq!(model.theta, Theta { lambda_con_m: 0.002, alpha_per_m: 250.0, lambda_pre_pa: 1200.0 });
    assert_eq!((model.name.as_str(), model.provenance.len()), ("nominal", 0));
}

#[test]
fn bad_files_name_the_line_and_what_was_expected() {
    let cases = [
        ("format = 1", "format = 4\nnew_key = 3", "model.toml: line 1: format is 4, expected 1 to 3"),
        ("format = 1\n", "", "missing field `format`"),
        (
            "alpha_per_m = 250",
            "alpha_per_m = -1",
            "line 6: theta.alpha_per_m is -1, expected a finite number",
        ),
        ("alpha_per_m = 250", "alpha_per_m = nan", "line 6: theta.alpha_per_m is NaN"),
        ("alpha_per_m = 250", "alpha_per_m = \"x\"", "line 6: invalid type"),
        ("lambda_pre_pa = 1200.0", "lambda_pre_pa = inf", "line 7: theta.lambda_pre_pa is inf"),
        ("lambda_pre_pa = 1200.0", "lambda_pre_pa = -0.5", "line 7: theta.lambda_pre_pa is -0.5"),
        (
            "lambda_con_m = 0.002",
            "lambda_con_m = 0.05",
            "line 5: theta.lambda_con_m is 0.05, expected a finite number below 0.05",
        ),
        ("lambda_con_m = 0.002\n", "", "missing field `lambda_con_m`"),
        ("name", "nmae", "line 2: unknown field `nmae`"),
        ("[theta]", "[theta", "line 4: "),
    ];
    for (from, to, expected) in cases {
        let message = refusal(from, to);
        assert!(message.contains(expected), "{to:?}: {message}");
    }
}

const OF_STREAMS: &str = "format = 3
name = \"two skins\"
theta = { lambda_con_m = 0.002, alpha_per_m = 250, lambda_pre_pa = 1200.0 }

[stream.twintac]
alpha_per_m = 80.0
lambda_pre_pa = 400.0

[stream.fsr]
lambda_con_m = -0.001
";

#[test]
fn streams_have_parameters_of_their_own() {
    let model = SensorModel::from_toml("model.toml", OF_STREAMS).expect("valid");
    let theta = Theta { lambda_con_m: 0.002, alpha_per_m: 80.0, lambda_pre_pa: 400.0 };
    assert_eq!(model.thetas().of("twintac"), theta);
    assert_eq!(model.thetas().of("fsr"), Theta { lambda_con_m: -0.001, ..model.theta });
    assert_eq!(model.thetas().of("another"), model.theta);
    model.check_for(&leap()).expect("the station has both");
    assert_eq!(SensorModel::from_toml("again.toml", &model.to_toml()).expect("own text"), model);
    assert_eq!(
        model.to_toml(),
        "format = 3\nname = \"two skins\"\n\n[theta]\nlambda_con_m = 0.002\nalpha_per_m = 250.0\nlambda_pre_pa = 1200.0\n\n\
         [stream.fsr]\nlambda_con_m = -0.001\n\n[stream.twintac]\nalpha_per_m = 80.0\nlambda_pre_pa = 400.0\n"
    );
    let shared = SensorModel { streams: BTreeMap::new(), format: 1, ..model };
    assert!(shared.to_toml().starts_with("format = 1\n"), "{}", shared.to_toml());
    assert!(!shared.to_toml().contains("stream"), "{}", shared.to_toml());
}

#[test]
fn the_manual_shows_a_model_that_is_read() {
    let manual = include_str!("../../../docs/calibration.md");
    let (_, rest) = manual.split_once("```toml\n").expect("an example");
    let (example, _) = rest.split_once("```").expect("its end");
    let model = SensorModel::from_toml("calibration.md", example).expect("valid");
    model.check_for(&leap()).expect("of the shipped station");
    assert_eq!((model.streams.len(), model.effects.len(), model.format), (2, 1, 3));
    // Whatever a file may hold is in the example.
    let mut everything = model.clone();
    everything.response.pad_softness_m = 1e-4;
    everything.response.proximity_band_m = 2e-3;
    for line in everything.to_toml().lines().filter(|line| !line.contains("takes")) {
        let key = line.split('=').next().unwrap_or_default().trim().trim_matches(['[', ']']);
        let last = key.rsplit('.').next().unwrap_or_default();
        assert!(example.contains(last), "{line:?} is not in the manual");
    }
}

#[test]
fn a_stuck_channel_of_a_file_from_before_it_had_a_level_stands_at_its_reference() {
    let of = |parameters: &str| {
        let stuck = "id = \"stuck_channel\"\nwhere = { channel = \"palm_ring\" }";
        let effect = format!("{OF_STREAMS}\n[[effect]]\n{stuck}\nparameters = {{ {parameters} }}\n");
        let model = SensorModel::from_toml("model.toml", &effect).unwrap();
        model.effects.last().unwrap().parameters.clone()
    };
    let at = |level: f64| [("level".to_owned(), level), ("presence".to_owned(), 1.0)].into();
    assert_eq!(of("presence = 1"), at(0.0));
    assert_eq!(of("presence = 1, level = 2.5"), at(2.5));
}

#[test]
fn bad_parameters_of_streams_name_the_line_or_the_stream() {
    let read = |from: &str, to: &str| {
        assert!(OF_STREAMS.contains(from), "{from:?} is not in the fixture");
        SensorModel::from_toml("model.toml", &OF_STREAMS.replacen(from, to, 1))
    };
    for (from, to, expected) in [
        ("format = 3", "format = 2", "line 1: format is 2, expected 3 in a file with `stream`"),
        (
            "alpha_per_m = 80.0",
            "alpha_per_m = -1",
            "line 6: stream.twintac.alpha_per_m is -1, expected a finite",
        ),
        ("-0.001", "0.06", "line 10: stream.fsr.lambda_con_m is 0.06, expected a finite number below 0.05"),
        ("lambda_con_m = -0.001\n", "", "line 9: stream.fsr has no parameter, expected some of lambda_con_m"),
        ("alpha_per_m = 80.0", "beta = 1", "line 6: unknown field `beta`"),
    ] {
        let message = read(from, to).expect_err("must be refused").to_string();
        assert!(message.contains(expected), "{to:?}: {message}");
    }
    for (from, to, expected) in [
        ("stream.fsr", "stream.skin", "stream.skin: layout \"LEAP Hand, right: 4 TwinTac"),
        (
            "stream.fsr]\nlambda_con_m = -0.001",
            "stream.fsr]\nalpha_per_m = 1.0",
            "stream.fsr has alpha_per_m, which a proximity",
        ),
        (
            "alpha_per_m = 80.0",
            "lambda_con_m = 0.0",
            "stream.twintac has lambda_con_m, which a pressure stream does not use",
        ),
    ] {
        let message = read(from, to)
            .expect("a valid file")
            .check_for(&leap())
            .expect_err("must be refused")
            .to_string();
        assert!(message.contains(expected), "{to:?}: {message}");
    }
}

proptest! {
    #[test]
    fn text_and_model_are_the_same(
        lambda_con_m in -0.01..0.0499, alpha_per_m in 0.0..1e5, lambda_pre_pa in 0.0..1e6,
        name in "\\PC{0,20}", provenance in prop::collection::vec("\\PC{0,20}", 0..3),
    ) {
        let theta = Theta { lambda_con_m, alpha_per_m, lambda_pre_pa };
        let model = SensorModel { provenance, ..SensorModel::plain(name, theta) };
        prop_assert_eq!(SensorModel::from_toml("model.toml", &model.to_toml()).expect("own text"), model);
    }
}

const DIAGNOSED: &str = "format = 2
name = \"diagnosed\"
theta = { lambda_con_m = 0.002, alpha_per_m = 250, lambda_pre_pa = 1200.0 }

[response]
proximity_band_m = 0.0012
pad_softness_m = 0.0004
off_fractions = { fsr = 0.75 }

[[effect]]
id = \"joint_backlash\"
where = { joint = \"index_pip\" }
parameters = { width_rad = 0.018 }
interval = { width_rad = [0.015, 0.021] }
takes = [\"take-01\"]

[[effect]]
id = \"swapped_channels\"
where = { channels = [\"index_tip.1\", \"index_tip.4\"] }
parameters = { presence = 1 }
";

fn leap() -> Station {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../assets/stations");
    let read = |path: &str| std::fs::read(folder.join(path)).map_err(|err| err.to_string());
    Station::read("xarm6_leap.toml", read).expect("the shipped station is valid")
}

#[test]
fn a_model_with_effects_is_read_and_written_again() {
    let model = SensorModel::from_toml("model.toml", DIAGNOSED).expect("valid");
    assert_eq!((model.format, model.effects.len()), (2, 2));
    assert_eq!(model.effects[0].place, Place::Joint("index_pip".into()));
    assert_eq!(model.effects[0].interval["width_rad"], [0.015, 0.021]);
    assert_eq!(model.response.off_fraction("fsr"), 0.75);
    assert_eq!(model.response.off_fraction("twintac"), 1.0);
    assert_eq!(SensorModel::from_toml("again.toml", &model.to_toml()).expect("own text"), model);
    model.check_for(&leap()).expect("the station has all of it");
    let without = SensorModel { effects: Vec::new(), response: Response::default(), ..model };
    assert!(without.to_toml().contains("format = 1"), "{}", without.to_toml());
}

#[test]
fn bad_effects_name_the_line_and_what_was_expected() {
    let cases = [
        ("format = 2", "format = 1", "line 1: format is 1, expected 2 in a file with `response` or `effect`"),
        (
            "joint_backlash",
            "gremlins",
            "line 11: there is no effect \"gremlins\", expected one of joint_offset, ",
        ),
        (
            "width_rad = 0.018",
            "width_rad = nan",
            "line 13: parameter width_rad of effect joint_backlash is NaN",
        ),
        ("[0.015, 0.021]", "[0.021, 0.015]", "line 14: interval of width_rad"),
        ("{ width_rad = [", "{ wide_rad = [", "line 14: effect joint_backlash has an interval for wide_rad"),
        ("joint = \"index_pip\"", "elbow = \"x\"", "line 12: unknown variant `elbow`"),
        ("where = { joint = \"index_pip\" }\n", "", "missing field `where`"),
        ("takes", "take", "line 15: unknown field `take`"),
        ("0.0012", "-1", "line 6: response.proximity_band_m is -1, expected a positive number"),
        (
            "0.0004",
            "0.4",
            "line 7: response.pad_softness_m is 0.4, expected a number of m between 0 and 0.003",
        ),
        ("fsr = 0.75", "fsr = 1.5", "line 8: response.off_fractions.fsr is 1.5, expected a number above 0"),
        ("off_fractions", "off_fraction", "line 8: unknown field `off_fraction`"),
    ];
    for (from, to, expected) in cases {
        assert!(DIAGNOSED.contains(from), "{from:?} is not in the fixture");
        let message = SensorModel::from_toml("model.toml", &DIAGNOSED.replacen(from, to, 1))
            .expect_err("must be refused")
            .to_string();
        assert!(message.contains(expected), "{to:?}: {message}");
    }
}

#[test]
fn a_model_for_another_station_names_effect_and_place() {
    let station = leap();
    let cases = [
        ("index_pip", "elbow", "effect 1 (joint_backlash, joint \"elbow\"): it cannot act there on station"),
        (
            "width_rad = 0.018",
            "wide_rad = 0.018",
            "it has no parameter \"wide_rad\" there, expected width_rad",
        ),
        ("width_rad = 0.018", "width_rad = 0.5", "parameter \"width_rad\" is 0.5, expected 0 to 0.1"),
        (
            "presence = 1",
            "",
            "effect 2 (swapped_channels, channels \"index_tip.1\" and \"index_tip.4\"): parameter",
        ),
        ("index_tip.4", "thumb_tip.4", "it cannot act there"),
        ("fsr = 0.75", "skin = 0.75", "names stream \"skin\", which station \"xarm6-leap\" does not have"),
    ];
    for (from, to, expected) in cases {
        let text = DIAGNOSED.replacen(from, to, 1).replace("interval = { width_rad = [0.015, 0.021] }\n", "");
        let model = SensorModel::from_toml("model.toml", &text).expect("a valid file");
        let message = model.check_for(&station).expect_err("must be refused").to_string();
        assert!(message.contains(expected), "{to:?}: {message}");
    }
}
