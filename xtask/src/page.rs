//! Assembles the files that the server embeds: hashed names, compressed copies, the HTML that loads them.

use std::{
    fs,
    hash::{DefaultHasher, Hash as _, Hasher as _},
    io::Write as _,
    path::{Path, PathBuf},
};

use anyhow::Context as _;

use crate::paths;

/// Copies what wasm-bindgen left in `bound` to `page_dir`, with names that change with their content.
pub(crate) fn assemble(bound: &Path, page_dir: &Path) -> anyhow::Result<PathBuf> {
    let wasm = fs::read(bound.join("palpate_ui_bg.wasm")).context("failed to read the bound wasm")?;
    let script =
        fs::read_to_string(bound.join("palpate_ui.js")).context("failed to read the bound script")?;
    let wasm_name = hashed_name("palpate_ui", "wasm", &wasm);
    let script = script.replace("palpate_ui_bg.wasm", &wasm_name);
    let script_name = hashed_name("palpate_ui", "js", script.as_bytes());
    let fill = |name: &str| -> anyhow::Result<String> {
        let path = paths::root().join("ui").join(name);
        let text = fs::read_to_string(&path).with_context(|| format!("failed to read {path:?}"))?;
        Ok(text.replace("{{script}}", &script_name).replace("{{wasm}}", &wasm_name))
    };
    // The page's policy allows scripts from files only, so that the HTML holds none.
    let (theme, boot) = (fill("theme.js")?, fill("boot.js")?);
    let theme_name = hashed_name("theme", "js", theme.as_bytes());
    let boot_name = hashed_name("boot", "js", boot.as_bytes());
    let html = fill("index.html")?.replace("{{theme}}", &theme_name).replace("{{boot}}", &boot_name);

    fs::create_dir_all(page_dir).with_context(|| format!("failed to create {page_dir:?}"))?;
    let fresh = [
        ("index.html", html.into_bytes()),
        (&theme_name, theme.into_bytes()),
        (&boot_name, boot.into_bytes()),
        (&script_name, script.into_bytes()),
        (&wasm_name, wasm),
    ];
    remove_stale(page_dir, &fresh.iter().map(|(name, _)| *name).collect::<Vec<_>>())?;
    for (name, content) in &fresh {
        write_with_copies(page_dir, name, content)?;
    }
    Ok(page_dir.to_owned())
}

fn hashed_name(stem: &str, extension: &str, content: &[u8]) -> String {
    let mut hasher = DefaultHasher::new();
    content.hash(&mut hasher);
    format!("{stem}-{:016x}.{extension}", hasher.finish())
}

fn remove_stale(page_dir: &Path, fresh: &[&str]) -> anyhow::Result<()> {
    for entry in fs::read_dir(page_dir)? {
        let entry = entry?;
        let name = entry.file_name().to_string_lossy().into_owned();
        let stem = name.trim_end_matches(".br").trim_end_matches(".gz");
        if !fresh.contains(&stem) {
            fs::remove_file(entry.path())?;
        }
    }
    Ok(())
}

/// Writes `name` with its brotli and gzip copies, unless they are there with this content already: the strongest brotli
/// level takes half a minute on the module.
fn write_with_copies(page_dir: &Path, name: &str, content: &[u8]) -> anyhow::Result<()> {
    let path = page_dir.join(name);
    let brotli_path = page_dir.join(format!("{name}.br"));
    let gzip_path = page_dir.join(format!("{name}.gz"));
    let same = fs::read(&path).is_ok_and(|old| old == content);
    if same && brotli_path.exists() && gzip_path.exists() {
        return Ok(());
    }
    let mut compressed = Vec::new();
    let params = brotli::enc::BrotliEncoderParams { quality: 9, lgwin: 24, ..Default::default() };
    brotli::BrotliCompress(&mut &content[..], &mut compressed, &params)?;
    fs::write(&brotli_path, &compressed)?;
    let mut gzip = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::best());
    gzip.write_all(content)?;
    fs::write(&gzip_path, gzip.finish()?)?;
    // The plain file comes last: it vouches for the other two.
    fs::write(&path, content).with_context(|| format!("failed to write {path:?}"))?;
    eprintln!("{name}: {} kB, {} kB as brotli", content.len() / 1000, compressed.len() / 1000);
    Ok(())
}
