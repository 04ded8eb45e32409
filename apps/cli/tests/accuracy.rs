//! The rendered clips' table as a test, with generous bounds: `cargo bench -p blindaug-cli --bench accuracy` prints it.

mod clips;

use clips::{Given, Truth};

fn mean_errors(given: Given) -> Option<(f32, f32)> {
    let folder = clips::folder()?;
    let (mut exposures, mut deltas) = (vec![], vec![]);
    for name in clips::names(&folder) {
        let clip = folder.join(name);
        for prefix in ["mb_", "dof_"] {
            for condition in clips::conditions(&clip, prefix) {
                let (truth, e) = (Truth::of(&clip, &condition), clips::estimate(&clip, &condition, given));
                assert!(clips::noise_error(&e, &truth).is_some_and(|v| v[0] < 0.8), "noise of {condition}");
                if prefix == "mb_" {
                    let (exposure, _) = clips::exposure(&e).expect("the camera moves");
                    exposures.push((exposure - truth.exposure).abs());
                } else {
                    deltas.push(clips::delta_error(&clip, &e, &truth).expect("depth is given").0);
                }
            }
        }
    }
    let mean = |v: &[f32]| v.iter().sum::<f32>() / v.len() as f32;
    println!("lambda {:.4}, delta {:.4} px", mean(&exposures), mean(&deltas));
    Some((mean(&exposures), mean(&deltas)))
}

#[test]
fn blind_estimates_are_near_the_truth() {
    let given = Given { flow: true, depth: true, ..Given::default() };
    if let Some((exposure, delta)) = mean_errors(given) {
        assert!(exposure < 0.06 && delta < 0.3, "{exposure} {delta}");
    }
}

#[test]
fn estimates_from_clean_frames_are_nearer() {
    let given = Given { flow: true, depth: true, clean: true, ..Given::default() };
    if let Some((exposure, delta)) = mean_errors(given) {
        assert!(exposure < 0.03 && delta < 0.15, "{exposure} {delta}");
    }
}

#[test]
fn the_estimated_camera_beats_the_naive_composite() {
    let Some(folder) = clips::folder() else { return };
    for name in ["table1", "shelf3"] {
        let clip = folder.join(name);
        let blind = clips::estimate(&clip, "full_without", Given { depth: true, ..Given::default() }).model;
        let truth = clips::true_model(&blind, &Truth::of(&clip, "full_without"));
        let of = |model, naive| clips::composite_psnr(&clip, "full", model, naive);
        let (naive, estimated, oracle) = (of(&blind, true), of(&blind, false), of(&truth, false));
        println!("{name}: naive {naive:.1}, estimated {estimated:.1}, true {oracle:.1} dB");
        assert!(estimated > naive + 5.0 && oracle > 38.0, "{name}: {naive} {estimated} {oracle}");
    }
}

#[test]
fn the_quadratic_follows_the_lens_where_it_was_seen() {
    let Some(folder) = clips::folder() else { return };
    let clip = folder.join("table1");
    let given = Given { depth: true, clean: true, quadratic: true, ..Given::default() };
    let e = clips::estimate(&clip, "dof_a", given);
    let (error, mean) = clips::delta_error(&clip, &e, &Truth::of(&clip, "dof_a")).expect("depth is given");
    println!("{error} of {mean} px");
    assert!(error < 0.5 * mean, "{error} of {mean}");
}
