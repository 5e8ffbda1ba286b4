//! `palpate station new`.

use std::{
    io::{self, IsTerminal as _},
    path::{Path, PathBuf},
    process::ExitCode,
};

use clap::{Args, Subcommand, ValueEnum};
use palpate_motion::{FirstPlan, ObjectInPlan};
use palpate_recording::files::{MAX_TEXT_BYTES, read_text};
use palpate_reports::wording::counted;
use palpate_robot_model::{
    AxesReading, SensorKind,
    new_station::{
        BuiltStation, JointReport, NewPatch, NewStation, NewStream, PLAN_FILE, PatchReport, RobotReport,
        STATION_FILE, SkinConfig,
    },
};
use palpate_server::{
    Error,
    data::new_station::{self, RobotFile},
};
use serde::Serialize;

use super::{Outcome, output};

/// Objects that a station has if nobody says otherwise.
const USUAL_OBJECTS: [&str; 2] = ["sphere_50mm", "box_80x60x45mm"];
/// Stream that a station has if nobody says otherwise.
const USUAL_STREAM: &str = "skin";

#[derive(Subcommand)]
pub(crate) enum StationCommand {
    /// Make the folder of a station from a URDF: robot, layout, nominal model, objects, a plan of what to record, and comments
    /// that say what to change
    New(Box<NewArgs>),
}

#[derive(Args)]
pub(crate) struct NewArgs {
    /// The robot. Meshes become the boxes around them; joints that mimic others are followed
    #[arg(long, value_name = "FILE")]
    urdf: PathBuf,
    /// Folder to make; it must not exist or be empty
    #[arg(long, value_name = "DIR", required_unless_present = "explain")]
    out: Option<PathBuf>,
    /// A patch of skin, in mm, as in `index_tip=index_distal:4x3@20x15:-z`; may be given for several. DIRECTION is outward in the
    /// link's frame, +z if left out; X,Y,Z moves it from the middle of that side [default: asked for, at a terminal]
    #[arg(
        long = "patch",
        value_name = "NAME=LINK:ROWSxCOLUMNS@LENGTHxWIDTH[:DIRECTION[:X,Y,Z]]",
        allow_hyphen_values = true
    )]
    patches: Vec<String>,
    /// Patches, and streams if there are several, from a file (docs/your_own_hand.md)
    #[arg(long = "patches", value_name = "FILE")]
    patches_file: Option<PathBuf>,
    /// Id of the station [default: made from the URDF's name]
    #[arg(long)]
    id: Option<String>,
    /// Name of the station for people [default: the URDF's name]
    #[arg(long)]
    label: Option<String>,
    /// Id of the stream of readings, as its file of a recording is called [default: skin]
    #[arg(long)]
    stream: Option<String>,
    /// What its sensors are: a skin of taxels, or one reading for each patch, as an FSR gives [default: pressure]
    #[arg(long)]
    kind: Option<Kind>,
    /// How often the skin is read, Hz [default: 100]
    #[arg(long)]
    rate_hz: Option<f64>,
    /// Unit of its readings [default: counts]
    #[arg(long)]
    unit: Option<String>,
    /// How many numbers each taxel measures, 1 to 3, as magnetic skins have it [default: 1]
    #[arg(long, value_name = "COUNT")]
    axes: Option<usize>,
    /// How several axes become the one reading: how far they are from rest, or the axis along the outward normal [default: norm,
    /// or normal with --normal-axis]
    #[arg(long)]
    reading: Option<Reading>,
    /// The axis along the outward normal, with a minus where pressing makes it fall: x, y, z, -x, -y or -z [default: z of three]
    #[arg(long, value_name = "AXIS", allow_hyphen_values = true)]
    normal_axis: Option<String>,
    /// Lowest reading that the device can give [default: 0]
    #[arg(long, allow_hyphen_values = true)]
    raw_min: Option<f64>,
    /// Highest reading that the device can give [default: 4095]
    #[arg(long, allow_hyphen_values = true)]
    raw_max: Option<f64>,
    /// So far above its reference a channel is on [default: a fiftieth of the range]
    #[arg(long)]
    on_threshold: Option<f64>,
    /// And off again below this [default: three quarters of --on-threshold]
    #[arg(long)]
    off_threshold: Option<f64>,
    /// How often joint positions are recorded, Hz
    #[arg(long, default_value_t = 100.0)]
    joint_rate_hz: f64,
    /// Joints of the arm that carries the hand
    #[arg(long, value_name = "JOINT,...", value_delimiter = ',')]
    carrier: Vec<String>,
    /// What is touched: the id of a shipped object or an object file; may be given for several [default: sphere_50mm and
    /// box_80x60x45mm]
    #[arg(long = "object", value_name = "ID|FILE")]
    objects: Vec<String>,
    /// Print what is understood of the URDF, and where patches lie, and write nothing; exit code 2 if no station can be made
    #[arg(long, conflicts_with = "out")]
    explain: bool,
    /// Print what was made, or understood, as JSON
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, ValueEnum)]
enum Kind {
    Pressure,
    Proximity,
}

#[derive(Clone, Copy, ValueEnum)]
enum Reading {
    Norm,
    Normal,
}

/// What `--json` prints.
#[derive(Serialize)]
struct Document<'a> {
    /// `null` with `--explain` and without patches.
    station: Option<&'a str>,
    /// The folder; `null` if nothing was written.
    dir: Option<&'a Path>,
    /// Files in it.
    files: Vec<&'a str>,
    robot: &'a RobotReport,
    patches: &'a [PatchReport],
    /// The plan of what to record; `null` where none could be made, which `warnings` says, and without patches.
    plan: Option<PlanDocument<'a>>,
    warnings: Vec<&'a str>,
}

/// What a plan touches.
#[derive(Serialize)]
struct PlanDocument<'a> {
    /// Its file in the folder.
    file: &'static str,
    takes: usize,
    duration_s: f64,
    objects: &'a [ObjectInPlan],
}

pub(super) fn run(command: &StationCommand) -> Outcome {
    let StationCommand::New(args) = command;
    if let Some(out) = &args.out {
        new_station::check_target(out)?;
    }
    let robot = new_station::read_robot(&args.urdf)?;
    let (mut streams, mut patches) = skin(args)?;
    if patches.is_empty() && !args.explain {
        patches = asked(&robot)?;
        if let [stream] = &mut streams[..]
            && args.patches_file.is_none()
            && [args.axes.is_some(), args.reading.is_some(), args.normal_axis.is_some()] == [false; 3]
        {
            let failed = Error::io("ask", "the terminal");
            (stream.axes, stream.normal_axis) =
                new_station::ask_axes(&mut io::stdin().lock(), &mut io::stderr()).map_err(failed)?;
        }
    }
    let built = if patches.is_empty() {
        None
    } else {
        let usual = USUAL_OBJECTS.map(str::to_owned);
        let objects = if args.objects.is_empty() { &usual[..] } else { &args.objects };
        let objects = new_station::read_objects(objects)?;
        let wanted = NewStation {
            id: args.id.clone().unwrap_or_else(|| id_of(&robot.robot.name)),
            label: args.label.clone().unwrap_or_else(|| label_of(&robot)),
            joint_rate_hz: args.joint_rate_hz,
            carrier_joints: args.carrier.clone(),
            streams,
            patches,
            objects: objects.paths,
            object_files: objects.files,
            plan: None,
        };
        Some(new_station::build_with_plan(wanted, &robot)?)
    };
    let (built, plan) = built.unzip();
    let plan = plan.unwrap_or_default();
    if let (Some(built), Some(out)) = (&built, &args.out) {
        new_station::write(built, out)?;
    }
    if args.json {
        output::json(&document(args, &robot, built.as_ref(), &plan))?;
    } else if args.explain {
        output::line(&explained(&robot, built.as_ref(), &plan))?;
    } else if let (Some(built), Some(out)) = (&built, &args.out) {
        output::line(&made(&robot, built, &plan, out))?;
    }
    Ok(if robot.robot.num_dofs() > 0 { ExitCode::SUCCESS } else { ExitCode::from(NOT_OK) })
}

/// Bad input, as with every command.
const NOT_OK: u8 = 2;

/// Streams and patches that the arguments describe.
fn skin(args: &NewArgs) -> Result<(Vec<NewStream>, Vec<NewPatch>), Error> {
    let mut skin = match &args.patches_file {
        Some(path) => SkinConfig::from_toml(&path.display().to_string(), &read_text(path, MAX_TEXT_BYTES)?)?,
        None => SkinConfig { streams: Vec::new(), patches: Vec::new() },
    };
    for text in &args.patches {
        let patch =
            text.parse().map_err(|problem| Error::Argument(format!("--patch {text:?}: {problem}")))?;
        skin.patches.push(patch);
    }
    let flags = [
        ("--stream", args.stream.is_some()),
        ("--kind", args.kind.is_some()),
        ("--rate-hz", args.rate_hz.is_some()),
        ("--unit", args.unit.is_some()),
        ("--axes", args.axes.is_some()),
        ("--reading", args.reading.is_some()),
        ("--normal-axis", args.normal_axis.is_some()),
        ("--raw-min", args.raw_min.is_some()),
        ("--raw-max", args.raw_max.is_some()),
        ("--on-threshold", args.on_threshold.is_some()),
        ("--off-threshold", args.off_threshold.is_some()),
    ];
    if let (Some(path), Some((flag, _)), false) =
        (&args.patches_file, flags.iter().find(|(_, given)| *given), skin.streams.is_empty())
    {
        return Err(Error::Argument(format!("{flag}, but {} has [[stream]]; say it there", path.display())));
    }
    if skin.streams.is_empty() {
        let mut stream = NewStream::pressure(args.stream.as_deref().unwrap_or(USUAL_STREAM));
        if let Some(Kind::Proximity) = args.kind {
            stream.kind = SensorKind::Proximity;
        }
        stream.rate_hz = args.rate_hz.unwrap_or(stream.rate_hz);
        stream.unit = args.unit.clone().unwrap_or(stream.unit);
        stream.axes = args.axes;
        stream.reading = args.reading.map(|reading| match reading {
            Reading::Norm => AxesReading::Norm,
            Reading::Normal => AxesReading::Normal,
        });
        stream.normal_axis.clone_from(&args.normal_axis);
        stream.raw_min = args.raw_min.unwrap_or(stream.raw_min);
        stream.raw_max = args.raw_max.unwrap_or(stream.raw_max);
        (stream.on_threshold, stream.off_threshold) = (args.on_threshold, args.off_threshold);
        skin.streams.push(stream);
    }
    Ok((skin.streams, skin.patches))
}

/// Patches that somebody at the terminal names.
fn asked(robot: &RobotFile) -> Result<Vec<NewPatch>, Error> {
    if io::stdin().is_terminal() {
        let failed = Error::io("ask", "the terminal");
        // Standard output stays free for the result.
        let patches =
            new_station::ask(&robot.report, &mut io::stdin().lock(), &mut io::stderr()).map_err(failed)?;
        if !patches.is_empty() {
            return Ok(patches);
        }
    }
    let names = |tip: bool| {
        let links = robot.report.links.iter().filter(|link| link.tip == tip);
        links.map(|link| format!("{:?}", link.link)).collect::<Vec<_>>().join(", ")
    };
    let first = robot.report.links.first().map_or("", |link| link.link.as_str());
    Err(Error::Argument(format!(
        "no patch of skin; say where it is, as in --patch tip={first}:4x3@20x15:+z, which is NAME=LINK:ROWSxCOLUMNS@LENGTHxWIDTH \
         in mm and the outward direction. Tips: {}; other links: {}",
        names(true),
        names(false)
    )))
}

/// The URDF's name as an id.
fn id_of(name: &str) -> String {
    let id: String =
        name.chars().map(|c| if c.is_ascii_alphanumeric() || c == '-' { c } else { '_' }).collect();
    if id.is_empty() { "station".to_owned() } else { id }
}

fn label_of(robot: &RobotFile) -> String {
    if robot.robot.name.is_empty() { robot.file.clone() } else { robot.robot.name.clone() }
}

fn document<'a>(
    args: &'a NewArgs,
    robot: &'a RobotFile,
    built: Option<&'a BuiltStation>,
    plan: &'a FirstPlan,
) -> Document<'a> {
    let warnings = robot.report.warnings.iter().chain(built.map_or(&[][..], placement_warnings));
    let warnings = warnings.chain(&plan.warnings);
    Document {
        station: built.map(|built| built.station.id.as_str()),
        dir: args.out.as_deref(),
        files: built.map(|built| built.files.keys().map(String::as_str).collect()).unwrap_or_default(),
        robot: &robot.report,
        patches: built.map_or(&[], |built| &built.patches),
        plan: plan.text.as_ref().map(|_| PlanDocument {
            file: PLAN_FILE,
            takes: plan.takes,
            duration_s: plan.duration_s,
            objects: &plan.objects,
        }),
        warnings: warnings.map(String::as_str).collect(),
    }
}

/// Warnings about patches: those about the URDF come first, and are the robot's too.
fn placement_warnings(built: &BuiltStation) -> &[String] {
    let about_patch = |warning: &String| warning.starts_with("patch ");
    let from = built.warnings.iter().position(about_patch).unwrap_or(built.warnings.len());
    &built.warnings[from..]
}

fn explained(robot: &RobotFile, built: Option<&BuiltStation>, plan: &FirstPlan) -> String {
    let report = &robot.report;
    let mut lines = vec![
        format!(
            "robot {:?} of {}; objects are placed in the frame of its root link {:?}",
            report.robot, robot.file, report.root
        ),
        format!("\n{:<24} {:<10} {:<24} {:<}", "joint", "kind", "range", "links"),
    ];
    lines.extend(report.joints.iter().map(joint_text));
    lines.push(format!(
        "\n{:<24} {:<4} {:>9} {:>7}  {}",
        "link", "", "collision", "visual", "box around it, mm"
    ));
    for link in &report.links {
        let size = link.size_m.map_or_else(
            || "-".to_owned(),
            |size| size.map(|side_m| format!("{:.1}", side_m * 1e3)).join(" x "),
        );
        let tip = if link.tip { "tip" } else { "" };
        lines.push(format!(
            "{:<24} {tip:<4} {:>9} {:>7}  {size}",
            link.link, link.collision_shapes, link.visual_shapes
        ));
    }
    if let Some(built) = built {
        lines.push(format!(
            "\n{:<24} {:<24} {:<26} {:<9} {}",
            "patch", "link", "middle in the link, mm", "faces", "channels"
        ));
        lines.extend(built.patches.iter().map(patch_text));
    }
    if plan.text.is_some() {
        lines.push(format!("\n{}", plan_text(plan)));
        lines.push(format!("\n{:<24} {:<32} {}", "object", "middle from the root, mm", "touched channels"));
        lines.extend(plan.objects.iter().map(|object| {
            let middle = object.position_m.map(|m| format!("{:.1}", m * 1e3)).join(", ");
            format!("{:<24} {middle:<32} {}", object.object, object.channels.join(", "))
        }));
    }
    lines.push(String::new());
    lines.extend(report.changes.iter().map(|change| format!("note: {change}")));
    let warnings = report.warnings.iter().chain(built.map_or(&[][..], placement_warnings));
    lines.extend(warnings.chain(&plan.warnings).map(|warning| format!("warning: {warning}")));
    lines.push("nothing was written".to_owned());
    lines.join("\n")
}

fn joint_text(joint: &JointReport) -> String {
    let range = match (joint.lower, joint.upper, joint.unit) {
        (_, _, "") => "-".to_owned(),
        (Some(lower), Some(upper), unit) => format!("{lower} to {upper} {unit}"),
        (_, _, unit) => format!("no limits, {unit}"),
    };
    let follows = joint.follows.as_ref().map_or_else(String::new, |follows| {
        format!("; follows {}, times {}, plus {}", follows.joint, follows.multiplier, follows.offset)
    });
    format!("{:<24} {:<10} {range:<24} {} -> {}{follows}", joint.joint, joint.kind, joint.parent, joint.child)
}

fn patch_text(patch: &PatchReport) -> String {
    let middle = patch.position_m.map(|m| format!("{:.1}", m * 1e3)).join(", ");
    let faces = ["x", "y", "z"].iter().zip(patch.outward).find(|(_, along)| *along != 0.0);
    let faces = faces
        .map_or_else(String::new, |(axis, along)| format!("{}{axis}", if along > 0.0 { '+' } else { '-' }));
    let channels = match &patch.channels[..] {
        [first, .., last] => format!("{first} to {last}"),
        [only] => only.clone(),
        [] => String::new(),
    };
    format!("{:<24} {:<24} {middle:<26} {faces:<9} {channels}", patch.patch, patch.link)
}

/// The plan in a sentence.
fn plan_text(plan: &FirstPlan) -> String {
    format!(
        "plan {PLAN_FILE}: {}, {:.0} min, {}",
        match plan.takes {
            1 => "1 take".to_owned(),
            takes => format!("{takes} takes"),
        },
        (plan.duration_s / 60.0).ceil(),
        plan.objects
            .iter()
            .map(|object| format!(
                "{:?} touches {}",
                object.object,
                counted(object.channels.len() as u64, "channel")
            ))
            .collect::<Vec<_>>()
            .join(", ")
    )
}

fn made(robot: &RobotFile, built: &BuiltStation, plan: &FirstPlan, out: &Path) -> String {
    let station = &built.station;
    let file = out.join(STATION_FILE);
    let mut lines: Vec<String> =
        robot.report.changes.iter().map(|change| format!("note: {change}")).collect();
    let warnings = built.warnings.iter().chain(&plan.warnings);
    lines.extend(warnings.map(|warning| format!("warning: {warning}")));
    lines.push(format!(
        "station {:?} is in {}: {}, {}, {}, {}",
        station.id,
        out.display(),
        counted(station.robot.num_dofs() as u64, "joint"),
        match station.layout.patches.len() {
            1 => "1 patch".to_owned(),
            patches => format!("{patches} patches"),
        },
        counted(station.layout.num_channels() as u64, "channel"),
        counted(station.objects.len() as u64, "object")
    ));
    if plan.text.is_some() {
        lines.push(plan_text(plan));
    }
    lines.push(format!("next: look at {}, which says how recordings are called, then", file.display()));
    lines.push(format!("  palpate import --csv RECORDINGS --station {} --explain", file.display()));
    lines.push(format!("  palpate import --csv RECORDINGS --station {} --out SESSION", file.display()));
    lines.push("  palpate session check SESSION".to_owned());
    lines.push("  palpate calibrate --session SESSION --out model.toml".to_owned());
    if plan.text.is_some() {
        lines.push("or let the hand record its plan: docs/hardware.md says how Palpate drives it, docs/plans.md what a plan is".to_owned());
    }
    lines.join("\n")
}
