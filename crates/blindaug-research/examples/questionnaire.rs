//! What `tools/check-study.sh` needs: `questionnaire DIR` writes a small questionnaire and the orders of some participants into a folder,
//! `questionnaire FILE.csv` reads exported answers again and prints them as JSON.

use blindaug::{Encoded, Raster};
use blindaug_io::{write_atomically, write_png};
use blindaug_research::study::{
    Media, MediaFormat, REAL, Stimulus, Task, order, questionnaire, read_answers,
};
use serde_json::json;
use std::{collections::BTreeMap, error::Error, path::Path, process::Command};

const SEED: u64 = u64::MAX - 7;

fn main() -> Result<(), Box<dyn Error>> {
    let path = std::env::args_os().nth(1).ok_or("usage: questionnaire DIR, or questionnaire FILE.csv")?;
    let path = Path::new(&path);
    if path.is_file() { print_answers(path) } else { make(path) }
}

fn print_answers(path: &Path) -> Result<(), Box<dyn Error>> {
    let answers = read_answers(&[path.into()])?;
    let rows = answers.all.iter().map(|a| json!([a.participant, a.task.name(), a.scene, a.method, a.yes]));
    println!("{}", json!({ "rows": rows.collect::<Vec<_>>(), "notes": answers.notes }));
    Ok(())
}

fn make(folder: &Path) -> Result<(), Box<dyn Error>> {
    std::fs::create_dir_all(folder)?;
    let mut stimuli = vec![];
    for task in Task::ALL {
        for scene in 0..3 {
            for (i, method) in ["Ours", "Naive, \"pasted\"", REAL].into_iter().enumerate() {
                let media = media(folder, task, 3 * scene + i)?;
                stimuli.push(Stimulus {
                    task,
                    scene: format!("scene {scene}"),
                    method: method.into(),
                    media,
                });
            }
        }
    }
    // A clip that no browser can play.
    let media = Media { format: MediaFormat::Webm, bytes: b"no video".into() };
    stimuli.push(Stimulus { task: Task::Consistency, scene: "broken".into(), method: "Ours".into(), media });
    let title = "Real or virtual? <b>A study</b> & its kit";
    let page = questionnaire(title, &stimuli, SEED);
    write_atomically(folder.join("questionnaire.html"), |p| std::fs::write(p, &page))?;
    let mut orders = BTreeMap::new();
    for participant in ["p7", "Zo\u{eb}, \"\u{1f993}\" '", "'=cmd|' /C calc'!A0"] {
        orders.insert(participant, order(&stimuli, SEED, participant));
    }
    write_atomically(folder.join("orders.json"), |p| std::fs::write(p, json!(orders).to_string()))?;
    Ok(())
}

/// A picture of 900 x 600 px, of which each differs; for clips a short video of it, where ffmpeg can be run.
fn media(folder: &Path, task: Task, number: usize) -> Result<Media, Box<dyn Error>> {
    let (width, height) = if number.is_multiple_of(2) { (900, 600) } else { (600, 800) };
    let png = folder.join("stimulus.png");
    let picture = Raster::from_fn(width, height, |x, y| {
        let (u, v) = (x as f32 / width as f32, y as f32 / height as f32);
        let ball = (x as f32 - 300.0).hypot(y as f32 - 300.0) < 30.0 + 25.0 * number as f32;
        let checks = if (x / 30 + y / 30).is_multiple_of(2) { 0.08 } else { 0.0 };
        if ball {
            [0.85, 0.45, 0.2 + 0.08 * number as f32]
        } else {
            [0.3 + 0.4 * u + checks, 0.5 + checks, 0.7 - 0.3 * v]
        }
    });
    write_png(&png, &Encoded(picture))?;
    let webm = folder.join("stimulus.webm");
    let coded = task == Task::Consistency
        && Command::new("ffmpeg")
            .args(["-v", "error", "-y", "-loop", "1", "-t", "0.5", "-r", "10", "-i"])
            .arg(&png)
            .args([
                "-vf",
                "scroll=h=0.02",
                "-c:v",
                "libvpx",
                "-deadline",
                "realtime",
                "-b:v",
                "1M",
                "-pix_fmt",
                "yuv420p",
            ])
            .arg(&webm)
            .status()
            .is_ok_and(|s| s.success());
    let (format, file) = if coded { (MediaFormat::Webm, webm) } else { (MediaFormat::Png, png) };
    Ok(Media { format, bytes: std::fs::read(file)? })
}
