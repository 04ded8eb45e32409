//! Writes a small questionnaire and the orders of a few participants, for tools/check-study.sh; or analyses a CSV file of answers.
//!
//!     cargo run -p blindaug-research --example questionnaire -- DIR
//!     cargo run -p blindaug-research --example questionnaire -- DIR answers.csv
use blindaug::{Encoded, Raster};
use blindaug_io::{VideoWriter, write_png};
use blindaug_research::study::{Media, Stimulus, Task, analyse, order, questionnaire, read_answers};
use std::{collections::BTreeMap, error::Error, path::PathBuf};

const SEED: u64 = 5;

/// A picture in the colour of a scene, with a square of the brightness of a method that moves with time.
fn picture(scene: usize, method: usize, time: usize) -> Encoded {
    let hue = |c: usize| 0.3 + 0.4 * ((scene + c) % 3) as f32 / 2.0;
    Encoded(Raster::from_fn(256, 192, |x, y| {
        let inside = x.abs_diff(60 + 2 * time) < 30 && y.abs_diff(96) < 30;
        if inside { [0.1 + 0.2 * method as f32; 3] } else { [hue(0), hue(1), hue(2)] }
    }))
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let folder = PathBuf::from(arguments.next().ok_or("name a folder")?);
    if let Some(answers) = arguments.next() {
        let answers = read_answers(&[answers.into()])?;
        let analysis = analyse(&answers.all, "Ours", SEED);
        println!("{} answers, {} tasks, notes: {:?}", answers.all.len(), analysis.tasks.len(), answers.notes);
        return Ok(());
    }
    std::fs::create_dir_all(&folder)?;
    let mut stimuli = vec![];
    for scene in 0..4 {
        for (i, method) in ["Naive", "Ours", "real"].into_iter().enumerate() {
            let still = folder.join("still.png");
            write_png(&still, &picture(scene, i, 20))?;
            let mut add = |task, mime, file: &PathBuf| -> Result<(), Box<dyn Error>> {
                let media = Media { mime, bytes: std::fs::read(file)? };
                stimuli.push(Stimulus { task, scene: scene.to_string(), method: method.into(), media });
                Ok(())
            };
            add(Task::Identification, "image/png", &still)?;
            let clip = folder.join("clip.mp4");
            let mut video = VideoWriter::create(&clip, (256, 192), 25.0)?;
            for t in 0..25 {
                video.write(&picture(scene, i, t))?;
            }
            video.finish()?;
            add(Task::Consistency, "video/mp4", &clip)?;
        }
    }
    let orders: BTreeMap<&str, Vec<usize>> = ["p7", "Ann \u{e9}", "x\"y,z"]
        .map(|p| (p, Task::ALL.iter().flat_map(|task| order(&stimuli, SEED, p, *task)).collect()))
        .into();
    std::fs::write(folder.join("orders.json"), serde_json::to_string(&orders)?)?;
    std::fs::write(folder.join("questionnaire.html"), questionnaire("Real or virtual?", &stimuli, SEED))?;
    Ok(())
}
