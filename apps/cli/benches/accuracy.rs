//! How far estimates and composites lie from the truth of the rendered clips: prints the tables of docs/accuracy.md.
//!
//!     cargo bench -p blindaug-cli --bench accuracy [-- all|blind|clean|noise|composite]

#[path = "../tests/clips/mod.rs"]
mod clips;

use clips::{Given, Truth};
use std::time::Instant;

fn main() {
    let what = std::env::args().skip(1).find(|a| !a.starts_with('-')).unwrap_or_else(|| "all".into());
    let Some(folder) = clips::folder() else { std::process::exit(1) };
    let names = clips::names(&folder);
    if what == "all" || what == "composite" {
        println!("\ncomposites against the truth, PSNR in dB over the object's area grown by 20 px");
        println!(
            "{:<10} {:<8} {:>8} {:>22} {:>12} {:>12}",
            "clip", "lens", "naive", "blind, depth given", "clean given", "true camera"
        );
        for name in &names {
            let clip = folder.join(name);
            for prefix in ["full", "full2"] {
                let condition = format!("{prefix}_without");
                if !clip.join(&condition).is_dir() || !clip.join("virtual").is_dir() {
                    continue;
                }
                let given = Given { depth: true, ..Given::default() };
                let blind = clips::estimate(&clip, &condition, given).model;
                let clean =
                    clips::estimate(&clip, &condition, Given { clean: true, flow: true, ..given }).model;
                let truth = clips::true_model(&blind, &Truth::of(&clip, &condition));
                let of = |model, naive| clips::composite_psnr(&clip, prefix, model, naive);
                println!(
                    "{name:<10} {prefix:<8} {:>8.1} {:>22.1} {:>12.1} {:>12.1}",
                    of(&blind, true),
                    of(&blind, false),
                    of(&clean, false),
                    of(&truth, false)
                );
            }
        }
    }
    for (title, given) in [
        ("blind, depth and flow given", Given { flow: true, depth: true, ..Given::default() }),
        ("blind, depth given", Given { depth: true, ..Given::default() }),
        ("clean, depth and flow given", Given { flow: true, depth: true, clean: true, ..Given::default() }),
    ] {
        if what != "all" && !title.starts_with(&what) {
            continue;
        }
        println!(
            "\n{title}\n{:<10} {:<14} {:>6} {:>6} {:>15} {:>18} {:>12} {:>14} {:>20} {:>6}",
            "clip",
            "condition",
            "true",
            "lambda",
            "95 %",
            "sigma_inf, focus m",
            "true",
            "delta error px",
            "noise err/level %",
            "s"
        );
        let (mut exposures, mut deltas) = (vec![], vec![]);
        for name in &names {
            let clip = folder.join(name);
            for prefix in ["mb_", "dof_", "full_without", "full2_without"] {
                for condition in clips::conditions(&clip, prefix) {
                    let truth = Truth::of(&clip, &condition);
                    let start = Instant::now();
                    let e = clips::estimate(&clip, &condition, given);
                    let seconds = start.elapsed().as_secs_f32();
                    let exposure = clips::exposure(&e);
                    let delta = clips::delta_error(&clip, &e, &truth);
                    if let (Some((l, _)), "mb_") = (exposure, prefix) {
                        exposures.push((l - truth.exposure).abs());
                    }
                    if let (Some((d, _)), "dof_") = (delta, prefix) {
                        deltas.push(d);
                    }
                    let text = |t: Option<String>| t.unwrap_or_else(|| "unknown".into());
                    println!(
                        "{name:<10} {condition:<14} {:>6.2} {:>6} {:>15} {:>18} {:>12} {:>14} {:>20} {seconds:>6.2}",
                        truth.exposure,
                        text(exposure.map(|(l, _)| format!("{l:.3}"))),
                        text(exposure.map(|(_, [a, b])| format!("[{a:.3}, {b:.3}]"))),
                        text(e.model.defocus.known().map(|m| match m.curve {
                            blindaug::model::DefocusCurve::ThinLens {
                                sigma_px_at_infinity,
                                focus_inverse_depth,
                                ..
                            } => format!("{sigma_px_at_infinity:.2}, {:.2}", 1.0 / focus_inverse_depth),
                            _ => "quadratic".into(),
                        })),
                        text(truth.lens.map(|(s, f)| format!("{s:.2}, {f:.2}"))),
                        text(delta.map(|(d, mean)| format!("{d:.3} of {mean:.2}"))),
                        text(
                            clips::noise_error(&e, &truth)
                                .map(|v| v.iter().map(|e| format!("{:.0} ", 100.0 * e)).collect())
                        ),
                    );
                }
            }
        }
        let mean = |v: &[f32]| v.iter().sum::<f32>() / v.len().max(1) as f32;
        println!(
            "mean abs error: lambda {:.4} over {} mb_* cases, delta {:.4} px over {} dof_* cases",
            mean(&exposures),
            exposures.len(),
            mean(&deltas),
            deltas.len()
        );
    }
}
