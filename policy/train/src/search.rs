//! The searching expert's files: how it tries, and the closings that it has learned from.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use anyhow::{Context as _, bail};
use palpate_grasp::search::{Closing, Closings, Experience, Felt, SearchConfig, Senses, Skill, simulate};
use palpate_grasp::{GraspConfig, Script};
use palpate_robot_model::Station;
use safetensors::SafeTensors;
use safetensors::tensor::{Dtype, TensorView};
use serde::{Deserialize, Serialize};

use crate::SceneArgs;
use crate::files::{self, Source, Sources};

/// How to try, unless another file is named.
pub(crate) const SEARCH: &str = "assets/grasp/search/xarm6_leap.toml";
/// Closings, unless another file is named.
pub(crate) const CLOSINGS: &str = "assets/grasp/search/closings.safetensors";

#[derive(clap::Args)]
pub(crate) struct ClosingsArgs {
    #[command(flatten)]
    scene: SceneArgs,
    /// How the hand tries to grasp
    #[arg(long, default_value = SEARCH)]
    search: PathBuf,
    /// Objects: "seen", "unseen", "all", or names or files with commas between
    #[arg(long, default_value = "seen")]
    objects: String,
    /// Closings on each object
    #[arg(long, allow_negative_numbers = true, default_value_t = 600)]
    count: u64,
    /// Seed of places, randomised physics and noise
    #[arg(long, default_value_t = 1000)]
    seed: u64,
    /// Half the edge length of the square about the hand's place that objects begin in, cm
    #[arg(long, allow_negative_numbers = true, default_value_t = 12.0)]
    window_cm: f64,
    /// The file to write; without it only the summary is printed
    #[arg(long)]
    out: Option<PathBuf>,
}

/// What a file of closings says of itself.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
pub(crate) struct ClosingsRecord {
    /// Names, in the order of the shapes' numbers.
    objects: Vec<String>,
    window_m: f64,
    seed: u64,
    /// On each object.
    count: u64,
    /// Every file that the closings were made from.
    sources: Vec<Source>,
}

/// What closings on one object were like.
#[derive(Serialize)]
struct Summary<'a> {
    object: &'a str,
    closings: usize,
    won: usize,
    /// Area from which the object was grasped, cm2.
    area_won_cm2: f64,
    /// Of the closings that failed, those in which any channel felt something.
    felt_when_lost: usize,
    seconds: f64,
}

pub(crate) fn run(args: &ClosingsArgs) -> anyhow::Result<()> {
    if args.count == 0 {
        bail!("--count is 0, expected at least 1");
    }
    if !(args.window_cm.is_finite() && args.window_cm >= 1.0) {
        bail!("--window-cm is {}, expected a finite number of at least 1", args.window_cm);
    }
    if let Some(out) = &args.out {
        files::check_out(out)?;
    }
    let names = files::objects(&args.objects)?;
    let sources = Sources::default();
    let opened = files::open_world(&args.scene, &sources)?;
    let skill = skill(&args.search, &opened.station, &opened.config, &sources)?;
    let window_m = 0.01 * args.window_cm;
    let mut closings = Closings { objects: names.clone(), window_m, closings: Vec::new() };
    for (shape, name) in names.iter().enumerate() {
        let began = Instant::now();
        let scene = Arc::new(opened.scene(&files::object(name, &sources)?)?);
        closings.objects[shape].clone_from(&scene.object().id);
        let of_one = simulate(&scene, &skill, shape, window_m, args.seed, args.count)?;
        let lost = of_one.iter().filter(|closing| !closing.won);
        let won = of_one.iter().filter(|closing| closing.won).count();
        let summary = Summary {
            object: &scene.object().id,
            closings: of_one.len(),
            won,
            area_won_cm2: 4.0 * args.window_cm.powi(2) * won as f64 / of_one.len() as f64,
            felt_when_lost: lost
                .filter(|closing| closing.closing.touch.iter().any(|share| *share > 0.0))
                .count(),
            seconds: began.elapsed().as_secs_f64(),
        };
        if args.scene.json {
            println!("{}", serde_json::to_string(&summary)?);
        } else {
            println!(
                "{name}: {won} of {} held, from {:.0} cm2; {} that failed felt something; {:.0} s",
                of_one.len(),
                summary.area_won_cm2,
                summary.felt_when_lost,
                summary.seconds
            );
        }
        closings.closings.extend(of_one);
    }
    let Some(out) = &args.out else { return Ok(()) };
    let record = ClosingsRecord {
        objects: closings.objects.clone(),
        window_m,
        seed: args.seed,
        count: args.count,
        sources: sources.into_list(),
    };
    files::write_in_one_move(out, &to_bytes(&closings, &record)?)?;
    eprintln!("wrote {}", out.display());
    Ok(())
}

/// How to try, as the file `search` and its script say.
fn skill(
    search: &Path,
    station: &Arc<Station>,
    config: &GraspConfig,
    sources: &Sources,
) -> anyhow::Result<Skill> {
    let how = SearchConfig::from_toml(&files::shown(search), &sources.text("search", search)?)?;
    let script = search.parent().unwrap_or(Path::new("")).join(&how.script);
    let text = sources.text("search script", &script)?;
    let script = Script::from_toml(&files::shown(&script), &text, &station.robot, config)?;
    Ok(Skill::new(station, config, &script, &how)?)
}

/// A row of a table of closings.
type Row<'a> = &'a dyn Fn(&Closing) -> Vec<f32>;

/// Tensors of a file, a row a closing: shape, whether it won, places of the object (before, at the glance, closed, in the
/// end), and what was felt up to the glance, while the hand closed, and while it lifted, of each touch and tracking.
fn to_bytes(closings: &Closings, record: &ClosingsRecord) -> anyhow::Result<Vec<u8>> {
    let rows = &closings.closings;
    let flat = |row: Row<'_>| -> Vec<u8> {
        rows.iter().flat_map(|closing| row(closing).into_iter().flat_map(f32::to_le_bytes)).collect()
    };
    let width = |row: Row<'_>| rows.first().map_or(0, |closing| row(closing).len());
    let shapes: Vec<u8> = rows.iter().flat_map(|closing| (closing.shape as u32).to_le_bytes()).collect();
    let won: Vec<u8> = rows.iter().map(|closing| u8::from(closing.won)).collect();
    let places: Row<'_> =
        &|closing| [closing.start_m, closing.glanced_m, closing.closed_m, closing.end_m].concat();
    let columns: [(&str, Row<'_>); 7] = [
        ("places_m", places),
        ("glance.touch", &|closing| closing.glance.touch.clone()),
        ("glance.tracking", &|closing| closing.glance.tracking.clone()),
        ("closing.touch", &|closing| closing.closing.touch.clone()),
        ("closing.tracking", &|closing| closing.closing.tracking.clone()),
        ("lifting.touch", &|closing| closing.lifting.touch.clone()),
        ("lifting.tracking", &|closing| closing.lifting.tracking.clone()),
    ];
    let data: Vec<(&str, usize, Vec<u8>)> =
        columns.iter().map(|(name, row)| (*name, width(row), flat(row))).collect();
    let mut tensors = vec![
        ("shape", TensorView::new(Dtype::U32, vec![rows.len()], &shapes)?),
        ("won", TensorView::new(Dtype::U8, vec![rows.len()], &won)?),
    ];
    for (name, width, bytes) in &data {
        tensors.push((name, TensorView::new(Dtype::F32, vec![rows.len(), *width], bytes)?));
    }
    let metadata = HashMap::from([("closings".to_owned(), serde_json::to_string(record)?)]);
    Ok(safetensors::serialize(tensors, Some(metadata))?)
}

/// Closings in the bytes of a file, and what it says of itself.
fn from_bytes(bytes: &[u8]) -> anyhow::Result<(Closings, ClosingsRecord)> {
    let (_, header) = SafeTensors::read_metadata(bytes)?;
    let record = header.metadata().as_ref().and_then(|metadata| metadata.get("closings"));
    let record: ClosingsRecord =
        serde_json::from_str(record.context("it does not say that it holds closings")?)?;
    let file = SafeTensors::deserialize(bytes)?;
    let floats = |name: &str| -> anyhow::Result<Vec<Vec<f32>>> {
        let tensor = file.tensor(name)?;
        let [rows, width] = *tensor.shape() else { bail!("{name} is no table") };
        if tensor.dtype() != Dtype::F32 {
            bail!("{name} holds {:?}, expected F32", tensor.dtype());
        }
        let values: Vec<f32> = tensor
            .data()
            .chunks_exact(4)
            .filter_map(|bytes| bytes.try_into().ok().map(f32::from_le_bytes))
            .collect();
        Ok((0..rows).map(|row| values[row * width..(row + 1) * width].to_vec()).collect())
    };
    let (shape, won) = (file.tensor("shape")?, file.tensor("won")?);
    if (shape.dtype(), won.dtype()) != (Dtype::U32, Dtype::U8) {
        bail!("shape and won hold {:?} and {:?}, expected U32 and U8", shape.dtype(), won.dtype());
    }
    let shapes: Vec<usize> = shape
        .data()
        .chunks_exact(4)
        .filter_map(|bytes| bytes.try_into().ok().map(u32::from_le_bytes))
        .map(|shape| shape as usize)
        .collect();
    let places = floats("places_m")?;
    let felt = |moment: &str| -> anyhow::Result<Vec<Felt>> {
        let (touch, tracking) = (floats(&format!("{moment}.touch"))?, floats(&format!("{moment}.tracking"))?);
        if touch.len() != tracking.len() {
            bail!("{moment}.touch and {moment}.tracking have {} and {} rows", touch.len(), tracking.len());
        }
        Ok(touch.into_iter().zip(tracking).map(|(touch, tracking)| Felt { touch, tracking }).collect())
    };
    let (glance, closing, lifting) = (felt("glance")?, felt("closing")?, felt("lifting")?);
    let rows = shapes.len();
    let lengths = [won.data().len(), places.len(), glance.len(), closing.len(), lifting.len()];
    if lengths.iter().any(|length| *length != rows) {
        bail!("its tensors have different numbers of rows");
    }
    let mut closings = Vec::with_capacity(rows);
    for (row, ((glance, closing), lifting)) in glance.into_iter().zip(closing).zip(lifting).enumerate() {
        let [x0, y0, x1, y1, x2, y2, x3, y3] = places[row][..] else {
            bail!("places_m has {} columns, expected 8", places[row].len())
        };
        closings.push(Closing {
            shape: shapes[row],
            start_m: [x0, y0],
            glanced_m: [x1, y1],
            closed_m: [x2, y2],
            end_m: [x3, y3],
            won: won.data()[row] != 0,
            glance,
            closing,
            lifting,
        });
    }
    Ok((Closings { objects: record.objects.clone(), window_m: record.window_m, closings }, record))
}

/// A skill and what it has been like.
pub(crate) struct Expert {
    pub(crate) skill: Arc<Skill>,
    closings: Closings,
}

impl Expert {
    /// Reads both, for trials as `config` has them.
    pub(crate) fn open(
        search: &Path,
        closings: &Path,
        station: &Arc<Station>,
        config: &GraspConfig,
        sources: &Sources,
    ) -> anyhow::Result<Self> {
        let skill = Arc::new(skill(search, station, config, sources)?);
        let bytes = std::fs::read(closings).with_context(|| {
            format!("failed to read {closings:?}; `palpate-train closings --out` makes such a file")
        })?;
        sources.add("closings", closings, &bytes);
        let (closings, record) =
            from_bytes(&bytes).with_context(|| format!("{closings:?} holds no closings that can be used"))?;
        // Other postures make other closings.
        let postures = ["search", "search script", "station"];
        for now in sources.list().iter().filter(|source| postures.contains(&source.role.as_str())) {
            let then: Vec<_> = record.sources.iter().filter(|source| source.role == now.role).collect();
            if !then.iter().any(|source| source.sha256 == now.sha256) {
                eprintln!(
                    "note: the closings were made with another {} than {}; make them again with `palpate-train closings`",
                    now.role, now.path
                );
            }
        }
        Ok(Self { skill, closings })
    }

    /// Number of the shape with this name.
    pub(crate) fn shape(&self, object: &str) -> Option<usize> {
        self.closings.objects.iter().position(|name| name == object)
    }

    /// What it has been like for these senses.
    pub(crate) fn experience(&self, senses: Senses) -> anyhow::Result<Arc<Experience>> {
        Ok(Arc::new(Experience::new(self.closings.clone(), &self.skill, senses)?))
    }
}
