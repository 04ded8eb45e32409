//! Analysis on the rendered clips, whose flow and depth are known. `--nocapture` prints what is measured.

use blindaug::{Flow, Plane, Raster, analysis::flow};
use blindaug_io::{DepthFormat, read_flow, read_frame, read_inverse_depth};
use std::path::PathBuf;

/// The clips' folder, if it is there.
fn clips() -> Option<PathBuf> {
    let shared = std::env::var("BLINDAUG_SHARED")
        .unwrap_or_else(|_| concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared").to_string());
    let clips = PathBuf::from(shared).join("data/clips");
    if clips.is_dir() {
        return Some(clips);
    }
    eprintln!(
        "NOT TESTED: no clips in {} (set BLINDAUG_SHARED to the folder that holds data/clips)",
        clips.display()
    );
    None
}

/// True flow and inverse depth (1/m) of frame `t`, and the pixels that are seen in frame `t` + 1.
fn truth(clip: &std::path::Path, t: usize) -> (Flow, Plane, Raster<bool>) {
    let exr = |t: usize| clip.join(format!("clean/{t:04}.exr"));
    let flow = read_flow(exr(t)).unwrap();
    let [d, next] = [t, t + 1].map(|t| read_inverse_depth(exr(t), DepthFormat::default()).unwrap());
    let (w, h) = flow.size();
    let seen = Raster::from_fn(w, h, |x, y| {
        let [u, v] = flow.at(x, y);
        let (tx, ty) = (x as f32 + u, y as f32 + v);
        let inside = tx >= 0.0 && ty >= 0.0 && tx <= w as f32 - 1.0 && ty <= h as f32 - 1.0;
        inside && next.bilinear(tx, ty) < 1.05 * d.at(x, y)
    });
    (flow, d, seen)
}

/// Endpoint errors, px, of the pixels that are seen in both frames, in ascending order.
fn endpoint_errors(flow: &Flow, truth: &Flow, seen: &Raster<bool>) -> Vec<f32> {
    let pairs = flow.data().iter().zip(truth.data()).zip(seen.data());
    let mut errors: Vec<f32> =
        pairs.filter(|(_, seen)| **seen).map(|((f, t), _)| (f[0] - t[0]).hypot(f[1] - t[1])).collect();
    errors.sort_by(f32::total_cmp);
    errors
}

fn mean(values: &[f32]) -> f32 {
    values.iter().sum::<f32>() / values.len() as f32
}

#[test]
fn flow_of_clean_noisy_and_blurred_frames() {
    let Some(clips) = clips() else { return };
    println!("clip   frames       mean EPE, px  median  hidden pixels found  flagged");
    // Bounds on the mean endpoint error. OpenCV's DIS (medium preset) has 0.21 to 0.26 px on the clean frames, 0.43 to 0.46 on full_without.
    for (clip, frames, bound) in [
        ("table1", "clean", 0.21),
        ("table1", "mb_0.90", 0.31),
        ("table1", "full_without", 0.43),
        ("shelf3", "clean", 0.23),
        ("shelf3", "mb_0.90", 0.34),
        ("shelf3", "full_without", 0.46),
    ] {
        let dir = clips.join(clip);
        let (truth, _, seen) = truth(&dir, 2);
        let luma = |t| read_frame(dir.join(format!("{frames}/{t:04}.png"))).unwrap().luma();
        let pair = flow::flow_with_occlusion(&luma(2), &luma(3)).unwrap();
        let errors = endpoint_errors(&pair.forward, &truth, &seen);
        let (mean, median) = (mean(&errors), errors[errors.len() / 2]);
        let hidden = seen.data().iter().filter(|s| !**s).count();
        let found = pair.occluded.data().iter().zip(seen.data()).filter(|(o, s)| **o && !**s).count();
        println!(
            "{clip} {frames:12} {mean:13.3} {median:7.3} {:20.2} {:8.3}",
            found as f32 / hidden as f32,
            1.0 - pair.confirmed()
        );
        assert!(mean < bound, "{clip} {frames}: {mean} px");
        assert!(median < 0.25, "{clip} {frames}: median {median} px");
        assert!(found * 2 > hidden, "{clip} {frames}: {found} of {hidden} hidden pixels are flagged");
        let wrong = pair.forward.map(|[u, v]| [v, u]);
        assert!(self::mean(&endpoint_errors(&wrong, &truth, &seen)) > 2.0, "the comparison sees nothing");
    }
}
