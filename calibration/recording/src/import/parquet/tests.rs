use std::path::PathBuf;

use proptest::prelude::*;

use super::*;

const SNAPPY: &[u8] = include_bytes!("../../../tests/parquet/snappy.parquet");
const ZSTD: &[u8] = include_bytes!("../../../tests/parquet/zstd.parquet");
const LIMIT: u64 = 1 << 20;

fn path() -> PathBuf {
    PathBuf::from("take/gel.parquet")
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(as_csv(&path(), bytes.to_vec(), &FileConfig::plain(), LIMIT).unwrap()).unwrap()
}

fn refusal(bytes: &[u8], config: &FileConfig, max_bytes: u64) -> String {
    as_csv(&path(), bytes.to_vec(), config, max_bytes).unwrap_err().to_string()
}

#[test]
fn what_pyarrow_wrote_is_read_column_by_column() {
    let expected = "\
        stamp [ns],curl_deg,slide,tip.0,tip.1,on,\"a \"\"b\"\", c\",seen [ms],list.list.element\n\
        1700000000123456789,0.0,0.05000000074505806,200,-1,1,,1,\n\
        1700000000133456789,0.1,0.10000000149011612,,2,0,,2,\n\
        1700000000143456789,,0.20000000298023224,65535,3,,,3,\n\
        1700000000153456789,-2.5e-7,0.30000001192092896,7,4,1,,4,\n";
    assert_eq!(text(SNAPPY), expected);
    assert_eq!(text(ZSTD), expected, "another codec, other pages, two groups of rows");
}

#[test]
fn files_are_known_by_their_beginning_or_their_name() {
    assert!(is_parquet(Path::new("a.csv"), SNAPPY));
    assert!(is_parquet(Path::new("a.parquet"), b"t,v0\n"));
    assert!(!is_parquet(Path::new("a.csv"), b"t,v0\n"));
}

#[test]
fn damaged_files_and_too_much_text_are_refused() {
    let plain = FileConfig::plain();
    for bytes in [&b""[..], b"PAR1", b"t,v0\n0,1\n", &SNAPPY[..SNAPPY.len() - 9], b"PAR1\0\0\0\0PAR1"] {
        let message = refusal(bytes, &plain, LIMIT);
        assert!(message.starts_with("take/gel.parquet: file: cannot be read as Parquet: "), "{message}");
        assert!(message.ends_with("; write it again, or as CSV") && !message.contains('\n'), "{message}");
    }
    assert!(refusal(SNAPPY, &plain, 100).contains("larger than 100 bytes"));
}

#[test]
fn a_mapping_that_is_about_text_is_refused() {
    let with = |change: fn(&mut FileConfig)| {
        let mut config = FileConfig::plain();
        change(&mut config);
        refusal(SNAPPY, &config, LIMIT)
    };
    assert!(with(|config| config.decimal_comma = true).contains("decimal_comma: is about text"));
    assert!(with(|config| config.header = false).contains("header: is about text"));
    assert!(with(|config| config.delimiter = Delimiter::Tab).contains("delimiter: is about text"));
    assert!(with(|config| config.skip_lines = 1).contains("skip_lines: is about text"));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(512))]

    #[test]
    fn damaged_bytes_are_an_error_or_a_table(
        is_snappy in any::<bool>(),
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
        cut in prop::option::weighted(0.2, any::<prop::sample::Index>()),
    ) {
        let mut bytes = if is_snappy { SNAPPY } else { ZSTD }.to_vec();
        for (at, byte) in changes {
            let at = at.index(bytes.len());
            bytes[at] = byte;
        }
        if let Some(cut) = cut {
            bytes.truncate(cut.index(bytes.len()));
        }
        match as_csv(&path(), bytes, &FileConfig::plain(), LIMIT) {
            Ok(text) => prop_assert!(text.len() as u64 <= LIMIT + 1),
            Err(error) => prop_assert!(error.to_string().contains("cannot be read as Parquet")),
        }
    }
}
