//! Compiles the shipped assets and the page into the binary.
//!
//! `PALPATE_UI_DIST` names the folder with the built page; without it the table is empty and the server says how to
//! build one.

use std::{
    env,
    fmt::Write as _,
    fs, io,
    path::{Path, PathBuf},
};

fn main() -> io::Result<()> {
    let out_dir = PathBuf::from(env::var_os("OUT_DIR").unwrap_or_default());
    let assets = Path::new(env!("CARGO_MANIFEST_DIR")).join("../assets");
    embed(&assets, &out_dir.join("assets.rs"))?;

    compress(
        &Path::new(env!("CARGO_MANIFEST_DIR")).join("vendor/rapidoc/rapidoc-min.js"),
        &out_dir.join("rapidoc-min.js.gz"),
    )?;

    println!("cargo::rerun-if-env-changed=PALPATE_UI_DIST");
    let page_table = out_dir.join("page.rs");
    match env::var_os("PALPATE_UI_DIST") {
        Some(dir) => embed(Path::new(&dir), &page_table),
        None => fs::write(page_table, "&[]\n"),
    }
}

/// Writes `file` to `out` as gzip.
fn compress(file: &Path, out: &Path) -> io::Result<()> {
    println!("cargo::rerun-if-changed={}", file.display());
    let mut gzip = flate2::write::GzEncoder::new(fs::File::create(out)?, flate2::Compression::best());
    io::copy(&mut fs::File::open(file)?, &mut gzip)?;
    gzip.finish().map(|_| ())
}

/// Writes an expression to `table`: a sorted slice of `(path relative to dir, bytes)` of every file below `dir`.
fn embed(dir: &Path, table: &Path) -> io::Result<()> {
    println!("cargo::rerun-if-changed={}", dir.display());
    let dir = dir.canonicalize().map_err(|err| {
        io::Error::new(err.kind(), format!("failed to read {dir:?}, which goes into the binary: {err}"))
    })?;
    let mut files = Vec::new();
    collect(&dir, "", &mut files)?;
    files.sort();
    let mut source = String::from("&[\n");
    for (name, path) in files {
        let _ = writeln!(source, "    ({name:?}, include_bytes!({path:?})),");
    }
    source.push_str("]\n");
    fs::write(table, source)
}

fn collect(dir: &Path, prefix: &str, files: &mut Vec<(String, PathBuf)>) -> io::Result<()> {
    for entry in fs::read_dir(dir)? {
        let entry = entry?;
        let name = format!("{prefix}{}", entry.file_name().to_string_lossy());
        if entry.path().is_dir() {
            collect(&entry.path(), &format!("{name}/"), files)?;
        } else {
            files.push((name, entry.path()));
        }
    }
    Ok(())
}
