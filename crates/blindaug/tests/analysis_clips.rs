//! Tests of the analysis on rendered clips, whose flow and depth are known. `--nocapture` prints the measured errors.

use blindaug::{
    Flow, Plane, Raster,
    analysis::{
        depth::{Parallax, inverse_depth_from_flow},
        flow,
    },
};
use blindaug_io::{DepthFormat, read_flow, read_frame, read_inverse_depth};
use std::path::PathBuf;

/// The folder of the clips, if it exists.
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

/// The true flow and inverse depth (1/m) of frame `t`, and whether each pixel is seen in frame `t` + 1.
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

/// The endpoint errors, px, of the pixels that are seen in both frames, in ascending order.
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
    // The last number bounds the mean endpoint error, px. The error of OpenCV's DIS (medium preset) is 0.21 to 0.26 px on the clean
    // frames, and 0.43 to 0.46 px on full_without.
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

/// The correlation of two maps over the pixels known in both, and the median relative error of `d` against `truth` after the best
/// scale and offset (least squares).
fn agreement(d: &Plane, truth: &Plane) -> (f64, f64) {
    let pairs: Vec<[f64; 2]> = d
        .data()
        .iter()
        .zip(truth.data())
        .filter(|(d, t)| d.is_finite() && t.is_finite())
        .map(|(d, t)| [*d, *t].map(f64::from))
        .collect();
    let mean = [0, 1].map(|i| pairs.iter().map(|p| p[i]).sum::<f64>() / pairs.len() as f64);
    let moment = |i: usize, j: usize| pairs.iter().map(|p| (p[i] - mean[i]) * (p[j] - mean[j])).sum::<f64>();
    let scale = moment(0, 1) / moment(0, 0);
    let error = |[d, t]: &[f64; 2]| (mean[1] + scale * (d - mean[0]) - t).abs() / t;
    let mut errors: Vec<f64> = pairs.iter().map(error).collect();
    errors.sort_by(f64::total_cmp);
    (moment(0, 1) / (moment(0, 0) * moment(1, 1)).sqrt(), errors[errors.len() / 2])
}

#[test]
fn depth_from_the_true_flow_and_from_that_of_the_frames() {
    let Some(clips) = clips() else { return };
    println!(
        "clip   flow of        known  correlation  median error  parallax, px  residual, px  inliers  uncertainty"
    );
    for clip in ["table1", "shelf3"] {
        let dir = clips.join(clip);
        let (flow, inverse_depth, seen) = truth(&dir, 2);
        for (frames, correlation_bound, error_bound) in
            [(None, 0.98, 0.02), (Some("clean"), 0.98, 0.03), (Some("full_without"), 0.97, 0.05)]
        {
            let parallax = match frames {
                None => inverse_depth_from_flow(&flow, &seen.map(|seen| !seen)),
                Some(frames) => {
                    let luma = |t| read_frame(dir.join(format!("{frames}/{t:04}.png"))).unwrap().luma();
                    let pair = flow::flow_with_occlusion(&luma(2), &luma(3)).unwrap();
                    inverse_depth_from_flow(&pair.forward, &pair.occluded)
                }
            };
            let Parallax::Known(depth) = parallax.unwrap() else { panic!("{clip} {frames:?}: unknown") };
            let (correlation, error) = agreement(&depth.inverse_depth, &inverse_depth);
            let all = depth.inverse_depth.data().len();
            let known =
                depth.inverse_depth.data().iter().filter(|d| d.is_finite()).count() as f32 / all as f32;
            println!(
                "{clip} {:14} {known:5.2} {correlation:12.3} {error:13.3} {:13.2} {:13.3} {:8.2} {:12.3}",
                frames.unwrap_or("(truth)"),
                depth.parallax,
                depth.residual,
                depth.inliers,
                depth.uncertainty
            );
            assert!(known > 0.8, "{clip} {frames:?}: only {known} is known");
            assert!(correlation > correlation_bound, "{clip} {frames:?}: correlation {correlation}");
            assert!(error < error_bound, "{clip} {frames:?}: error {error}");
            let (w, h) = depth.inverse_depth.size();
            let upside_down = Plane::from_fn(w, h, |x, y| depth.inverse_depth.at(x, h - 1 - y));
            assert!(agreement(&upside_down, &inverse_depth).0 < 0.5, "the comparison sees nothing");
        }
    }
}
