//! Compiles the shipped assets, the manual and the page into the binary.
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
    embed_docs(&Path::new(env!("CARGO_MANIFEST_DIR")).join(".."), &out_dir.join("docs.rs"))?;

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
    let dir = found(dir)?;
    let mut files = Vec::new();
    collect(&dir, "", &mut files)?;
    write_table(files, table)
}

/// Writes the same of the documents in `root/docs` and the pictures that they show. `README.md` goes among them as the
/// tour, because it has one.
fn embed_docs(root: &Path, table: &Path) -> io::Result<()> {
    let root = found(root)?;
    let (docs, tour) = (root.join("docs"), root.join("README.md"));
    for path in [&docs, &tour] {
        println!("cargo::rerun-if-changed={}", path.display());
    }
    let mut files = Vec::new();
    collect(&docs, "", &mut files)?;
    let is_shown = |name: &str| [".md", ".png", ".svg"].iter().any(|ending| name.ends_with(ending));
    files.retain(|(name, _)| is_shown(name) && !name.contains('/'));
    files.push(("tour.md".to_owned(), tour));
    write_table(files, table)
}

fn found(path: &Path) -> io::Result<PathBuf> {
    path.canonicalize().map_err(|err| {
        io::Error::new(err.kind(), format!("failed to read {path:?}, which goes into the binary: {err}"))
    })
}

fn write_table(mut files: Vec<(String, PathBuf)>, table: &Path) -> io::Result<()> {
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
