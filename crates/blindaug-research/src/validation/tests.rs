use super::*;
use crate::run::Provenance;
use blindaug_io::VideoWriter;
use blindaug_pipeline::Silent;
use blindaug_scenes::measure::Lens;
use std::path::PathBuf;

/// The shared clips; `None`, with a message, if they are missing.
fn shared_clips() -> Option<PathBuf> {
    let shared = std::env::var_os("BLINDAUG_SHARED")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared"), PathBuf::from);
    let clips = shared.join("data/clips");
    if !clips.is_dir() {
        eprintln!("SKIPPED: no clips in {}; set BLINDAUG_SHARED to the shared folder", clips.display());
        return None;
    }
    Some(clips)
}

/// The measurements of the conditions whose names pass `which`, with this evidence given.
fn measured(given: Given, which: impl Fn(&str) -> bool) -> Option<Vec<(Truth, Measured)>> {
    let conditions = clips::conditions(&shared_clips()?).unwrap();
    Some(
        conditions
            .iter()
            .filter(|c| which(&c.name))
            .map(|c| {
                let footage = c.read().unwrap();
                (footage.truth, measure(&footage, given, &mut Networks::default(), &Silent).unwrap().0)
            })
            .collect(),
    )
}

fn mean_errors(given: Given) -> Option<(f32, f32)> {
    let all = measured(given, |name| name.starts_with("mb_") || name.starts_with("dof_"))?;
    assert!(all.iter().all(|(_, m)| m.noise[0] < 0.8), "noise");
    let exposures: Vec<f32> = all
        .iter()
        .filter(|(t, _)| t.exposure > 0.0)
        .map(|(t, m)| (m.exposure.expect("the camera moves").estimate - t.exposure).abs())
        .collect();
    let blurs: Vec<f32> = all
        .iter()
        .filter(|(t, _)| t.lens.is_some())
        .map(|(_, m)| m.lens.as_ref().expect("depth is given").error_px)
        .collect();
    assert!(exposures.len() > 3 && blurs.len() > 3);
    let mean = |v: &[f32]| v.iter().sum::<f32>() / v.len() as f32;
    let errors = (mean(&exposures), mean(&blurs));
    println!("lambda {:.4}, delta {:.4} px", errors.0, errors.1);
    Some(errors)
}

#[test]
fn blind_estimates_of_rendered_clips_are_near_the_truth() {
    if let Some((exposure, delta)) = mean_errors(Given::DepthAndFlow) {
        assert!(exposure < 0.06 && delta < 0.3, "{exposure} {delta}");
    }
}

#[test]
fn estimates_from_clean_frames_are_nearer() {
    if let Some((exposure, delta)) = mean_errors(Given::Everything) {
        assert!(exposure < 0.03 && delta < 0.15, "{exposure} {delta}");
    }
}

#[test]
fn the_estimated_camera_beats_the_naive_composite() {
    let Some(folder) = shared_clips() else { return };
    for condition in clips::conditions(&folder).unwrap().iter().filter(|c| c.name == "full_without") {
        let (_, estimation) =
            measure(&condition.read().unwrap(), Given::Depth, &mut Networks::default(), &Silent).unwrap();
        let f = condition.fidelity(&estimation.model).unwrap().expect("there is an object");
        println!("{}: {f:?}", condition.title());
        assert!(f.estimated > f.naive + 5.0 && f.oracle > 38.0, "{}: {f:?}", condition.title());
    }
}

#[test]
fn a_quick_run_finds_the_truth_and_goes_on_where_it_stopped() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let ffmpeg = VideoWriter::is_available();
    if !ffmpeg {
        eprintln!("SKIPPED: no ffmpeg program, so nothing goes through a video coder");
    }
    let job = Job {
        scenes: 1,
        frames: 4,
        quick: true,
        coded: if ffmpeg { vec![20] } else { vec![] },
        paper_alone: false,
        given: Given::ALL.into(),
        clips: vec![],
        networks: vec!["none".into()],
    };
    let measured = || {
        let provenance = Provenance { command: "test".into(), ..Provenance::here(0) };
        let this = Run::new(&out, provenance, false, &Silent).unwrap();
        let outcomes = run(&this, &job, &mut Networks::default()).unwrap();
        let page = this.write("validate", "Validation", &[findings(&outcomes)]).unwrap();
        (outcomes, std::fs::read_to_string(page).unwrap())
    };
    let (outcomes, html) = measured();
    assert_eq!(outcomes.len(), own_cases(&job, &[]).len());
    assert!(html.contains("physics") && html.contains("data:image/png"));
    assert_eq!(html.contains("H.264 crf 20"), ffmpeg);

    // With everything given, each parameter is found; without clean frames, none is far off.
    for o in &outcomes {
        let of = |given| o.measured.iter().find(|m| m.given == given).unwrap();
        if o.case.coded.is_some() {
            let blind = of(Given::DepthAndFlow);
            assert!(o.measured.len() == 3 && blind.noise_median.is_none(), "{}: {blind:?}", o.case.name);
            if o.truth.exposure > 0.0 {
                let error = blind.exposure.map(|e| (e.estimate - o.truth.exposure).abs());
                assert!(error.is_none_or(|e| e < 0.25), "{}: {blind:?}", o.case.name);
            }
            continue;
        }
        let (best, blind) = (of(Given::Everything), of(Given::DepthAndFlow));
        let error = |m: &Measured| m.exposure.map(|e| (e.estimate - o.truth.exposure).abs());
        if o.truth.exposure > 0.0 {
            // The linear taps of the synthesis blur by themselves, which counts where little moves, as here.
            assert!(error(best).unwrap() < 0.1, "{}: {best:?}", o.case.name);
            assert!(error(blind).is_none_or(|e| e < 0.25), "{}: {blind:?}", o.case.name);
        }
        if o.truth.lens.is_some() {
            let close = |l: &Lens, part: f32| l.error_px < part * l.mean_px + 0.1;
            assert!(close(best.lens.as_ref().unwrap(), 0.1), "{}: {best:?}", o.case.name);
            assert!(blind.lens.as_ref().is_none_or(|l| close(l, 0.4)), "{}: {blind:?}", o.case.name);
        }
        // For noise below two steps of 8 bit, the coarse levels are only an upper bound.
        if o.case.setting.is_some_and(|s| s.noise > 0.007) {
            assert!(blind.noise_median.is_some_and(|e| e < 0.35), "{}: {blind:?}", o.case.name);
        }
    }

    // A stored case is not measured again, and a missing one is.
    let path = |o: &Outcome| out.join(format!("{NAME}/cases/{}.json", o.case.name));
    let kept = std::fs::read_to_string(path(&outcomes[0])).unwrap();
    let mut stored: serde_json::Value = serde_json::from_str(&kept).unwrap();
    stored["outcome"]["measured"][0]["seconds"] = 12345.0.into();
    std::fs::write(path(&outcomes[0]), stored.to_string()).unwrap();
    std::fs::remove_file(path(&outcomes[1])).unwrap();
    let (again, _) = measured();
    assert_eq!(again[0].measured[0].seconds, 12345.0);
    assert!(path(&outcomes[1]).is_file());
    assert_eq!(again[1].measured[0].exposure, outcomes[1].measured[0].exposure);
}
