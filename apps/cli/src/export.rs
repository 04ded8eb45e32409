//! `blindaug export`: the camera as settings of other people's tools.

use crate::composite::scene_scale;
use crate::console::{self, Failure, Progress, Result, failure, note, print};
use blindaug::export::{Camera, Content, Export as Exported, File, Target, View};
use blindaug::model::{DepthKind, SceneScale};
use blindaug_io::{Inputs, has_extension, read_camera_track, same_file, write_atomically, write_texture};
use blindaug_report::words::count;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use std::path::{Path, PathBuf};

/// Write the camera as settings of another tool: an engine, a compositor, an encoder
#[derive(clap::Args)]
#[command(after_help = "Example: blindaug export camera.json --to blender -o blindaug_camera.py")]
pub struct Export {
    /// The camera model, as written by estimate
    #[arg(value_name = "camera.json", required_unless_present = "list")]
    camera: Option<PathBuf>,
    /// The tool; `all` writes a folder for each into the folder -o
    #[arg(long, value_name = "TARGET", required_unless_present = "list", value_parser = targets())]
    to: Option<To>,
    /// The file to write, or a folder; textures that it needs are written beside it [default: standard output]
    #[arg(short, long, value_name = "FILE", required_if_eq("to", "all"))]
    output: Option<PathBuf>,
    /// Vertical field of view of the tool's camera, degrees from 1 to 170 [default: the tool's own camera's where its script can ask, else 40]
    #[arg(long, value_name = "DEGREES", value_parser = |t: &str| crate::arguments::within(t, 1.0..=170.0))]
    fov: Option<f64>,
    /// Width and height of the tool's pictures, px [default: the footage's]
    #[arg(long, value_name = "WxH", value_parser = size)]
    size: Option<(usize, usize)>,
    /// Relates a model in relative inverse depth d to metres: d = S / Z + O
    #[arg(long, value_name = "S[,O]", value_parser = scene_scale)]
    scene_scale: Option<SceneScale>,
    /// Say what each target can and cannot do
    #[arg(long)]
    list: bool,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum To {
    One(Target),
    All,
}

fn targets() -> impl TypedValueParser<Value = To> {
    let names = Target::ALL.iter().map(|t| t.name()).chain(["all"]);
    PossibleValuesParser::new(names)
        .map(|name| Target::ALL.iter().find(|t| t.name() == name).map_or(To::All, |t| To::One(*t)))
}

fn size(text: &str) -> std::result::Result<(usize, usize), String> {
    let number = |t: &str| t.trim().parse::<usize>().ok().filter(|n| (1..=65_536).contains(n));
    match text.split_once('x').map(|(w, h)| (number(w), number(h))) {
        Some((Some(w), Some(h))) => Ok((w, h)),
        _ => Err("give width and height in px, as in 1920x1080".into()),
    }
}

/// Runs `export`.
pub fn run(args: &Export) -> Result<()> {
    let (Some(path), Some(to)) = (&args.camera, args.to) else { return print(&list()) };
    let inputs = Inputs::of([path]);
    if let Some(output) = &args.output {
        inputs.check_output(output)?;
    }
    let mut track = read_camera_track(path)?;
    if track.frames().len() > 1 {
        return Err(failure(
            path,
            "it holds a model for each frame, but tools take one camera: give a model that was estimated without --track",
        ));
    }
    if let Some(scale) = args.scene_scale {
        track = track.to_metric(scale);
    }
    let model = track.at(0);
    let view = View { size: args.size, fov_y_degrees: args.fov.map(|fov| fov as f32) };
    let camera = Camera::new(&model, &view).map_err(|e| Failure(e.to_string()))?;
    if model.defocus.known().is_some_and(|lens| lens.depth_kind == DepthKind::Relative) {
        note(
            "note: --scene-scale S[,O] says how the model's relative inverse depth relates to metres; or estimate again with --at X,Y=METRES",
        );
    }
    match (to, &args.output) {
        (To::One(target), None) => print_one(&target.export(&camera)),
        (To::One(target), Some(output)) => write_one(&target.export(&camera), output, &inputs),
        (To::All, Some(folder)) => write_all(&camera, folder, &inputs),
        (To::All, None) => Err(Failure("--to all needs -o DIR, a folder to write to".into())),
    }
}

/// The abilities of all targets, as `--list` prints them.
fn list() -> String {
    let entry = |target: &Target| {
        let a = target.abilities();
        format!(
            "{target}\n  tool            {}\n  motion blur     {}\n  depth of field  {}\n  its shape       {}\n  grain           {}\n  checked         {}\n",
            a.tool, a.motion_blur, a.defocus, a.bokeh, a.grain, a.checked
        )
    };
    let entries: Vec<String> = Target::ALL.iter().map(entry).collect();
    entries.join("\n")
        + "\nDaVinci Resolve and Fusion are left out: how their grain and lens nodes relate to px and std is not documented; take texture.\n"
}

fn say_lost(prefix: &str, export: &Exported) {
    for sentence in &export.lost {
        note(format_args!("{prefix}{sentence}"));
    }
}

fn print_one(export: &Exported) -> Result<()> {
    say_lost("note: ", export);
    let names: Vec<&str> = export.files[1..].iter().map(|f| f.name.as_str()).collect();
    if !names.is_empty() {
        note(format_args!("note: with -o FILE {} is written beside it", names.join(", ")));
    }
    match &export.files[0].content {
        Content::Text(text) => print(text),
        Content::Texture(_) => Ok(()),
    }
}

fn write_one(export: &Exported, output: &Path, inputs: &Inputs) -> Result<()> {
    let [first, others @ ..] = &export.files[..] else { return Ok(()) };
    let (folder, target) = if output.is_dir() {
        (output, output.join(&first.name))
    } else {
        (output.parent().unwrap_or(Path::new("")), output.to_path_buf())
    };
    let beside: Vec<PathBuf> = others.iter().map(|file| folder.join(&file.name)).collect();
    if let Some(name) = beside.iter().find(|b| same_file(b, &target)) {
        return Err(failure(name, "a texture of this name is written beside it; give another name"));
    }
    console::check_outputs(inputs, [&target].into_iter().chain(&beside).map(PathBuf::as_path))?;
    let own = Path::new(&first.name).extension().and_then(|e| e.to_str()).unwrap_or_default();
    if target.extension().is_some() && !has_extension(&target, &[own]) {
        return Err(failure(
            &target,
            format_args!("this target is written as {own}: give a name that ends in .{own}, or a folder"),
        ));
    }
    // The first file refers to the others, so these are written before it.
    for (file, path) in others.iter().zip(&beside) {
        write(file, path)?;
    }
    write(first, &target)?;
    say_lost("note: ", export);
    note(format_args!("wrote {} and {} beside it", target.display(), count(others.len() as u64, "file")));
    Ok(())
}

fn write_all(camera: &Camera, folder: &Path, inputs: &Inputs) -> Result<()> {
    let mut progress = Progress::counting("exporting", "tools", Some(Target::ALL.len()));
    for target in Target::ALL {
        if console::interrupted() {
            return Err(failure(folder, format_args!("stopped before {target}; run it again for the rest")));
        }
        let export = target.export(camera);
        let folder = folder.join(target.name());
        blindaug_io::make_folder(&folder)?;
        let paths: Vec<PathBuf> = export.files.iter().map(|file| folder.join(&file.name)).collect();
        console::check_outputs(inputs, paths.iter().map(PathBuf::as_path))?;
        for (file, path) in export.files.iter().zip(&paths).rev() {
            write(file, path)?;
        }
        say_lost(&format!("{target}: "), &export);
        progress.step();
    }
    drop(progress);
    note(format_args!("wrote {} folders into {}", Target::ALL.len(), folder.display()));
    Ok(())
}

fn write(file: &File, path: &Path) -> Result<()> {
    match &file.content {
        Content::Text(text) => Ok(write_atomically(path, |partial| std::fs::write(partial, text))?),
        Content::Texture(texture) => Ok(write_texture(path, texture)?),
    }
}
