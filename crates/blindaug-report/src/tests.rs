use super::*;
use blindaug::Raster;
use blindaug::fit::{BlurPoint, Shot, noise::NoisePoint};
use blindaug::model::{
    CameraTrack, Capture, Changes, CurveLevel, DefocusCurve, DefocusModel, DepthKind, Distortion, Estimate,
    ExposureFraction, Method, MotionBlurModel, NOISE_LEVELS, NoiseCurves, NoiseInterval, NoiseLevel,
    NoiseLines, NoiseModel, Reason, SharpeningModel, ThinLensInterval, TrackedCamera, Unknown,
    total_of_levels,
};
use blindaug::synth::noise::noise;
use blindaug::{Plane, Sample};

const SECTIONS: [&str; 6] = [
    "Depth of field: the lens",
    "Motion blur: the shutter",
    "Sharpening: the camera's processing",
    "Noise: the sensor",
    "Frames",
    "Notes",
];

fn noise_model() -> NoiseModel {
    let levels = std::array::from_fn(|l| {
        let s = 0.5f32.powi(l as i32);
        NoiseLevel { slope: [0.012 * s, 0.009 * s, 0.015 * s], intercept: [0.008 * s, 0.006 * s, 0.01 * s] }
    });
    let around = |v: [f32; 3]| v.map(|v| [0.85 * v, 1.15 * v]);
    let interval =
        levels.map(|l: NoiseLevel| NoiseInterval { slope: around(l.slope), intercept: around(l.intercept) });
    NoiseModel::Lines(NoiseLines {
        levels,
        interval: Some(interval),
        clip: 1.0,
        method: Method::Temporal,
        samples: 12_345,
    })
}

fn capture_of(width: usize, height: usize) -> Capture {
    Capture { width, height, fps: Some(30.0), frames_used: 5, pixel_aspect: 1.0 }
}

fn known_model(width: usize, height: usize) -> CameraModel {
    let mut m = CameraModel::unknown(capture_of(width, height), "");
    m.sharpening = Estimate::Known(SharpeningModel {
        amount: 0.7,
        radius_px: 1.0,
        interval: [0.5, 0.9],
        method: Method::Temporal,
        samples: 400,
    });
    m.noise = Estimate::Known(noise_model());
    m.motion_blur = Estimate::Known(MotionBlurModel {
        exposure: ExposureFraction(0.48),
        interval: [0.45, 0.51],
        method: Method::Spectral,
        samples: 2105,
        phase_degrees: None,
    });
    m.defocus = Estimate::Known(DefocusModel {
        curve: DefocusCurve::ThinLens {
            sigma_px_at_infinity: 3.5,
            focus_inverse_depth: 0.77,
            interval: Some(ThinLensInterval {
                sigma_px_at_infinity: [3.3, 3.7],
                focus_inverse_depth: [0.75, 0.79],
            }),
        },
        depth_kind: DepthKind::Metric,
        bokeh: Default::default(),
        method: Method::Spectral,
        samples: 2805,
        inverse_depth_seen: Some([0.1, 1.2]),
    });
    m
}

fn diagnostics(model: &CameraModel) -> Diagnostics {
    let jitter = |i: usize| ((i * 7919 % 101) as f32 / 50.0 - 1.0) * ((i * 104_729 % 97) as f32 / 97.0);
    Diagnostics {
        inverse_depth: None,
        notes: vec![
            "Exposure: the spectral estimate, since its interval is tighter <than> \"the other\" & so on"
                .into(),
        ],
        noise_points: (0..NOISE_LEVELS)
            .flat_map(|level| (1..15).map(move |i| (level, i)))
            .map(|(level, i)| {
                let y = i as f32 / 16.0;
                let sigma = noise_model().std(level, y).map(|s| s * (1.0 + 0.1 * jitter(i + 31 * level)));
                NoisePoint { level, y, sigma, samples: 40 }
            })
            .collect(),
        exposure_curve: (0..=50)
            .map(|i| [i as f32 / 50.0, -900.0 * (i as f32 / 50.0 - 0.48f32).powi(2)])
            .collect(),
        blur_points: (0..400)
            .map(|i| {
                let d = 0.1 + 1.1 * i as f32 / 400.0;
                let s = model.defocus.known().map_or(1.0, |m| m.sigma_px(d));
                BlurPoint {
                    inverse_depth: d,
                    sigma_px: (s + 0.5 * jitter(i)).max(0.0),
                    weight: (i % 10) as f32 / 9.0,
                }
            })
            .collect(),
        exposure_per_frame: vec![(0, 0.46), (1, 0.5), (2, 0.47), (3, 0.52), (4, 0.48)],
        shots: vec![],
    }
}

/// A frame of flat parts and of edges, with noise.
fn frame(w: usize, h: usize) -> Encoded {
    let clean = clean_frame(w, h);
    let grain = noise(&noise_model(), &clean.0, 7, 7);
    Encoded(Raster::from_fn(w, h, |x, y| std::array::from_fn(|c| clean.0.at(x, y)[c] + grain.at(x, y)[c])))
}

fn clean_frame(w: usize, h: usize) -> Encoded {
    Encoded(Raster::from_fn(w, h, |x, y| {
        if x * 2 < w {
            [0.2 + 0.6 * (y * 3 / h.max(1)) as f32 / 2.0; 3]
        } else {
            [if (x / 9 + y / 9) % 2 == 0 { 0.3 } else { 0.7 }; 3]
        }
    }))
}

fn full_sample(w: usize, h: usize) -> Sample {
    Sample {
        number: 3,
        frame: frame(w, h),
        next: None,
        flow: Some(Raster::from_fn(w, h, |x, y| if x == 0 { [f32::NAN; 2] } else { [6.0, y as f32 / 40.0] })),
        inverse_depth: Some(Raster::from_fn(
            w,
            h,
            |x, y| if y == 0 { f32::NAN } else { 0.2 + x as f32 / w as f32 },
        )),
        clean: Some(clean_frame(w, h)),
    }
}

fn written(input: &ReportInput) -> String {
    page(input).unwrap()
}

/// HTML elements that have no end tag.
const VOID: [&str; 4] = ["meta", "img", "br", "link"];

/// The first error in the nesting of the tags, if there is one.
fn unbalanced(html: &str) -> Option<String> {
    let mut open = vec![];
    let mut rest = html;
    while let Some(at) = rest.find('<') {
        rest = &rest[at + 1..];
        // The reports' attributes hold no '>' that is not escaped.
        let Some(end) = rest.find('>') else { return Some("a tag without an end".into()) };
        let tag = &rest[..end];
        rest = &rest[end + 1..];
        let name: String =
            tag.trim_start_matches('/').chars().take_while(char::is_ascii_alphanumeric).collect();
        if tag.starts_with('!') || tag.ends_with('/') || VOID.contains(&name.as_str()) {
            continue;
        }
        if name.is_empty() {
            return Some(format!("'<{tag}>' is no tag"));
        }
        if !tag.starts_with('/') {
            open.push(name);
        } else if open.pop().as_ref() != Some(&name) {
            return Some(format!("</{name}> closes something else"));
        }
    }
    open.pop().map(|name| format!("<{name}> is not closed"))
}

fn check(html: &str) {
    check_page(html);
    for section in SECTIONS {
        assert!(html.contains(&format!("<h2>{section}</h2>")), "{section}");
    }
}

/// Checks that a page is well-formed, loads nothing from outside, and holds no number that is not finite.
fn check_page(html: &str) {
    assert_eq!(unbalanced(html), None);
    assert!(
        !html.contains("://") && !html.contains("<script") && !html.contains("<link"),
        "an outside resource"
    );
    for svg in html.split("<svg").skip(1) {
        let svg = svg.split("</svg>").next().unwrap();
        assert!(svg.contains("aria-label"));
        for value in svg.split('"').skip(1).step_by(2) {
            assert!(!value.split([' ', ',']).any(|v| ["NaN", "inf", "-inf"].contains(&v)), "{value}");
            // This number comes from saturated casts of values that are not finite.
            assert!(!value.contains("2147483"), "{value}");
        }
    }
    for img in html.split("<img").skip(1) {
        let img = &img[..img.find('>').unwrap()];
        assert!(
            img.contains("alt=\"")
                && !img.contains("alt=\"\"")
                && img.contains("src=\"data:image/png;base64,")
        );
    }
}

#[test]
fn the_checks_find_what_is_wrong() {
    assert_eq!(unbalanced("<!DOCTYPE html><p>a<br><b>c</b></p><line x=\"1\"/>"), None);
    for bad in ["<p>", "<p><b></p></b>", "</p>", "a < b", "<p"] {
        assert!(unbalanced(bad).is_some(), "{bad}");
    }
}

#[test]
fn a_full_report_has_every_part() {
    let model = known_model(200, 150);
    let diagnostics = diagnostics(&model);
    let html = written(&ReportInput {
        title: "<clip> & \"co\"".into(),
        model: &model,
        diagnostics: &diagnostics,
        samples: vec![full_sample(200, 150)],
        comparison: vec![TruthRow {
            name: "Exposure".into(),
            estimated: "0.48".into(),
            truth: "0.50".into(),
        }],
        pictures: vec![Picture { title: "Composite".into(), image: frame(80, 60) }],
        numbers: vec![],
        provenance: None,
    });
    check(&html);
    for part in [
        "&lt;clip&gt; &amp; &quot;co&quot;",
        "173°",
        "162 to 184°",
        "16.0 ms (1/63 s)",
        "15.0 to 17.0 ms",
        "1.30 m",
        "from 1.14 to 1.52 m",
        "14.0 px across",
        "2\u{202f}105 image tiles",
        "Amount 0.700",
        "95 % interval",
        "Estimated beside true values",
        "Composite",
        "Re-synthesised",
        "left real, right synthetic",
        "Motion to the next frame",
        "Depth: dark is far",
        "&lt;than&gt;",
    ] {
        assert!(html.contains(part), "{part}");
    }
    assert_eq!(html.matches("<svg").count(), 4);
    assert!(!html.contains("Unknown"));
}

#[test]
fn each_shot_has_its_own_exposure() {
    let model = known_model(200, 150);
    let exposures = |shots| {
        let diagnostics = Diagnostics { shots, ..diagnostics(&model) };
        let html = written(&ReportInput {
            title: String::new(),
            model: &model,
            diagnostics: &diagnostics,
            samples: vec![],
            comparison: vec![],
            pictures: vec![],
            numbers: vec![],
            provenance: None,
        });
        check(&html);
        let plot = html.split("<svg").find(|svg| svg.contains("Exposure of each")).unwrap();
        (bands_and_dashes(plot)[0], html.contains("what each shot says alone"))
    };
    let shot = |frames, known: bool| Shot {
        frames,
        motion_blur: if known {
            model.motion_blur.clone()
        } else {
            Estimate::unknown(Reason::NoMotion, "still")
        },
    };
    assert_eq!(exposures(vec![]), (1, false));
    assert_eq!(exposures(vec![shot(0..2, true), shot(2..4, true), shot(4..5, false)]), (2, true));
}

#[test]
fn what_is_unknown_is_said() {
    let model = CameraModel::unknown(Capture { fps: None, ..capture_of(8, 8) }, "nothing <moves>");
    let diagnostics = Diagnostics::default();
    let input = |samples| ReportInput {
        title: String::new(),
        model: &model,
        diagnostics: &diagnostics,
        samples,
        comparison: vec![],
        pictures: vec![],
        numbers: vec![],
        provenance: None,
    };
    let html = written(&input(vec![]));
    check(&html);
    assert_eq!(html.matches("nothing &lt;moves&gt;").count(), 4);
    assert_eq!(html.matches("<svg").count(), 0);
    assert!(html.contains("No frames were kept"));
    let html = written(&input(vec![full_sample(120, 120)]));
    check(&html);
    assert!(html.contains("without defocus, motion blur, noise"));
}

#[test]
fn the_middle_of_what_fits_and_shared_noise_are_told() {
    let mut model = known_model(64, 48);
    model.motion_blur =
        Estimate::Unknown(Unknown::new(Reason::Uncertain, "too little moves").with_fits([0.2, 0.7]));
    // G and B have R's noise.
    let level = CurveLevel { mixing: [[1.0, 0.0, 0.0]; 3], ..CurveLevel::default() };
    model.noise = Estimate::Known(NoiseModel::Curves(Box::new(NoiseCurves {
        lines: noise_model().lines().clone(),
        levels: [level; NOISE_LEVELS],
        temporal_correlation: 0.25,
    })));
    let page_of = |model: &CameraModel| {
        let diagnostics = Diagnostics::default();
        let title = String::new();
        written(&ReportInput {
            title,
            model,
            diagnostics: &diagnostics,
            samples: vec![],
            comparison: vec![],
            pictures: vec![],
            numbers: vec![],
            provenance: None,
        })
    };
    let told = ["the exposures that fit, 0.450 of the frame interval", "with the frame before is 0.250"];
    let html = page_of(&model);
    check(&html);
    assert!(told.iter().all(|t| html.contains(t)), "{html}");
    let words = words::words(&model, &[]);
    assert!(words.contains("1.00 of R and G") && words.contains("frame before: 0.25"), "{words}");
    // Negative control: neither is told where it is not known.
    model.motion_blur = Estimate::unknown(Reason::Uncertain, "too little moves");
    model.noise = Estimate::Known(noise_model());
    let html = page_of(&model);
    assert!(!told.iter().any(|t| html.contains(t)), "{html}");
}

#[test]
fn odd_frames_and_numbers_give_a_report() {
    let nan = f32::NAN;
    for (w, h) in [(0, 0), (1, 1), (1, 300), (47, 48), (300, 7)] {
        let model = known_model(w.max(1), h.max(1));
        let mut odd = full_sample(w, h);
        odd.clean = None;
        let mut mismatched = full_sample(w, h);
        mismatched.flow = Some(Raster::filled(w + 1, h, [1.0; 2]));
        let mut not_finite = full_sample(w, h);
        not_finite.frame = Encoded(Raster::filled(w, h, [nan; 3]));
        not_finite.flow = Some(Raster::filled(w, h, [f32::INFINITY, nan]));
        not_finite.inverse_depth = Some(Plane::filled(w, h, nan));
        let diagnostics = Diagnostics {
            noise_points: vec![NoisePoint { level: 9, y: nan, sigma: [f32::INFINITY; 3], samples: 0 }; 3],
            exposure_curve: vec![[nan, 0.0], [0.2, f32::NEG_INFINITY], [0.5, 0.0]],
            blur_points: vec![
                BlurPoint { inverse_depth: nan, sigma_px: 1.0, weight: 1.0 },
                BlurPoint { inverse_depth: 0.5, sigma_px: f32::INFINITY, weight: nan },
                BlurPoint { inverse_depth: -0.5, sigma_px: 1e30, weight: 1e-30 },
            ],
            exposure_per_frame: vec![(0, nan), (1, 7.0), (usize::MAX, -1.0)],
            shots: vec![
                Shot { frames: 0..0, motion_blur: Estimate::unknown(Reason::Other, "<b>") },
                Shot {
                    frames: 5..usize::MAX,
                    motion_blur: Estimate::Known(MotionBlurModel::given(ExposureFraction(nan))),
                },
            ],
            ..Diagnostics::default()
        };
        let html = written(&ReportInput {
            title: "odd".into(),
            model: &model,
            diagnostics: &diagnostics,
            samples: vec![full_sample(w, h), odd, mismatched, not_finite],
            comparison: vec![],
            pictures: vec![Picture { title: "none".into(), image: Encoded(Raster::filled(w, h, [nan; 3])) }],
            numbers: vec![],
            provenance: None,
        });
        check(&html);
    }
}

#[test]
fn odd_models_give_a_report() {
    let base = known_model(64, 64);
    let lens = |curve, depth_kind| {
        let mut m = base.clone();
        m.defocus = Estimate::Known(DefocusModel {
            method: Method::Removal,
            samples: 1,
            ..DefocusModel::given(curve, depth_kind)
        });
        m
    };
    let thin = |s: f32, f: f32, interval| DefocusCurve::ThinLens {
        sigma_px_at_infinity: s,
        focus_inverse_depth: f,
        interval,
    };
    let quadratic = |a, b, c, range| DefocusCurve::Quadratic { a, b, c, inverse_depth_range: range };
    let wild = ThinLensInterval {
        sigma_px_at_infinity: [f32::NEG_INFINITY, f32::INFINITY],
        focus_inverse_depth: [-3.0, f32::NAN],
    };
    let wide = ThinLensInterval { sigma_px_at_infinity: [0.0, 9.0], focus_inverse_depth: [-0.1, 2.0] };
    let mut models = vec![
        (lens(thin(0.0, 0.5, None), DepthKind::Metric), "at every distance"),
        (lens(thin(0.4, 0.5, None), DepthKind::Metric), "from 0.889 m on"),
        (lens(thin(3.0, 1e-6, Some(wild)), DepthKind::Metric), "Blur at infinity"),
        (lens(thin(3.0, 0.5, Some(wide)), DepthKind::Relative), "relative inverse depth"),
        (lens(quadratic(4.0, -4.0, 1.0, [0.0, 1.0]), DepthKind::Relative), "0.147 to 0.853"),
        (lens(quadratic(0.0, 0.0, 0.0, [0.3, 0.3]), DepthKind::Metric), "No blur seen"),
        (lens(quadratic(0.0, 0.0, 5.0, [-1.0, 1e30]), DepthKind::Metric), "nowhere"),
    ];
    let mut wild = base.clone();
    wild.motion_blur = Estimate::Known(MotionBlurModel {
        exposure: ExposureFraction(0.0),
        interval: [0.0, f32::INFINITY],
        method: Method::Removal,
        samples: 0,
        phase_degrees: None,
    });
    let still = NoiseLevel::default();
    wild.noise = Estimate::Known(NoiseModel::given([still; NOISE_LEVELS], 0.9));
    models.push((wild, "clips at 229 of 255"));
    for (model, says) in models {
        let html = written(&ReportInput {
            title: "odd".into(),
            model: &model,
            diagnostics: &diagnostics(&base),
            samples: vec![full_sample(64, 64)],
            comparison: vec![],
            pictures: vec![],
            numbers: vec![],
            provenance: None,
        });
        check(&html);
        assert!(html.contains(says), "{says}");
    }
}

/// The plots and the page of the report of a track of 20 frames; `frame` may alter each frame's model and the changes that are noted in it.
fn tracked(frame: impl Fn(u64, &mut CameraModel, &mut Changes)) -> (Vec<String>, String) {
    let line = |number: u64| {
        let (mut camera, mut changed) = (known_model(200, 150), Changes::default());
        frame(number, &mut camera, &mut changed);
        TrackedCamera { frame: number, changed, camera }.to_json_line() + "\n"
    };
    let track = CameraTrack::from_json(&(1..=20).map(line).collect::<String>()).unwrap();
    let samples = vec![Sample { clean: None, ..full_sample(200, 150) }];
    let html =
        track_page(&TrackReportInput { title: "<clip>".into(), track: &track, samples, provenance: None })
            .unwrap();
    check_page(&html);
    let svgs = html.split("<svg").skip(1).map(|s| s.split("</svg>").next().unwrap().into());
    (svgs.collect(), html.clone())
}

/// The numbers of filled areas, such as intervals, and of strokes of dashed lines in a plot.
fn bands_and_dashes(svg: &str) -> [usize; 2] {
    let dash = |line: &&str| line.contains("polyline") && line.contains("opacity=\"0.7\" stroke=\"#333333\"");
    [svg.matches("<polygon").count(), svg.lines().filter(dash).count()]
}

#[test]
fn a_tracked_camera_is_shown_over_time_with_its_intervals_and_changes() {
    // The plots are those of blur at infinity, focus, exposure, the amount of sharpening, and noise in three channels.
    const BANDS: [usize; 5] = [1, 1, 1, 1, 3];
    let (steady, html) = tracked(|_, _, _| ());
    assert_eq!(steady.iter().map(|s| bands_and_dashes(s)).collect::<Vec<_>>(), BANDS.map(|b| [b, 0]));
    assert!(!html.contains("just before") && !html.contains("Unknown"));
    for part in ["&lt;clip&gt;", "173° shutter", "known in 20 of 20 frames", "left real, right synthetic"] {
        assert!(html.contains(part), "{part}");
    }

    let (jumped, html) = tracked(|number, camera, changed| {
        changed.set(Distortion::MotionBlur, number == 9);
        if let (5..9, Estimate::Known(m)) = (number, &mut camera.motion_blur) {
            m.interval = [0.2, 0.8];
        }
    });
    assert!(html.contains("A change just before frame 9."));
    let [bands, dashes] = bands_and_dashes(&jumped[2]);
    assert!(bands == 1 && dashes > 5, "{bands} {dashes}");
    assert_eq!((&jumped[..2], &jumped[3..]), (&steady[..2], &steady[3..]));
    assert_ne!(
        jumped[2].lines().find(|l| l.contains("<polygon")),
        steady[2].lines().find(|l| l.contains("<polygon"))
    );

    let (_, html) =
        tracked(|number, _, changed| changed.set(Distortion::Noise, [4, 7, 12].contains(&number)));
    assert!(html.contains("Changes just before frames 4, 7 and 12."));

    // What makes the last frame's numbers less sure stands above the headlines; what made earlier ones so no longer holds.
    let (_, html) = tracked(|number, camera, _| {
        camera.warnings = vec![if number < 20 { "few frames" } else { "compressed" }.into()];
    });
    let at = |part: &str| html.find(part).unwrap();
    assert!(at("Compressed.") < at("aria-label=\"In short\"") && !html.contains("Few frames"));
}

#[test]
fn what_a_track_does_not_know_is_left_out_and_said() {
    let (plots, html) = tracked(|number, camera, _| {
        camera.noise = Estimate::unknown(Reason::Flat, "too <dark>");
        if number < 3 || number == 8 {
            camera.defocus = Estimate::unknown(Reason::Flat, format!("nothing near, {number}"));
        }
        if number != 5 {
            camera.motion_blur = Estimate::unknown(Reason::NoMotion, "nothing moves");
        }
    });
    // The lens is known in two stretches, the exposure in a single frame, sharpening throughout, the noise not at all.
    assert_eq!(
        plots.iter().map(|s| bands_and_dashes(s)).collect::<Vec<_>>(),
        [[2, 0], [2, 0], [1, 0], [1, 0]]
    );
    for part in [
        "Unknown in frames 1 to 2: </strong>nothing near, 2.",
        "Unknown in frame 8: </strong>nothing near, 8.",
        "Unknown in frames 6 to 20: </strong>nothing moves.",
        "Unknown in frames 1 to 20: </strong>too &lt;dark&gt;.",
        "known in 1 of 20 frames",
    ] {
        assert!(html.contains(part), "{part}");
    }
    assert!(!html.contains("nothing near, 1"));
    // Nor has it a caption.
    assert!(
        html.contains("The inverse depth that is in focus")
            && !html.contains("The std of the finest grain at")
    );
}

#[test]
fn large_noisy_frames_do_not_make_a_large_file() {
    let model = known_model(1920, 1080);
    let frame = frame(1920, 1080);
    let sample = || Sample {
        number: 1,
        frame: frame.clone(),
        next: None,
        flow: None,
        inverse_depth: None,
        clean: None,
    };
    let html = written(&ReportInput {
        title: "large".into(),
        model: &model,
        diagnostics: &Diagnostics::default(),
        samples: (0..4).map(|_| sample()).collect(),
        comparison: vec![],
        pictures: vec![Picture { title: "a".into(), image: frame.clone() }],
        numbers: vec![],
        provenance: None,
    });
    check(&html);
    assert!(html.len() < 6_000_000, "{}", html.len());
}

#[test]
fn the_noise_of_even_content_is_that_of_its_bands() {
    // White noise of std 0.02 has these bands, so all of them together have nearly its std.
    let band = blindaug::synth::noise::white_band_std();
    for std in total_of_levels(&std::array::from_fn(|level| [0.02 * band[level]; 3])) {
        assert!((std / 0.02 - 1.0).abs() < 0.03, "{std}");
    }
}

/// The report of a model alone.
fn alone(model: &CameraModel) -> String {
    written(&ReportInput::new("alone", model, &Diagnostics::default()))
}

/// The part of a page that shows the headlines.
fn headlines(html: &str) -> &str {
    let from = html.find("aria-label=\"In short\"").unwrap();
    &html[from..from + html[from..].find("</section>").unwrap()]
}

#[test]
fn headlines_have_intervals_and_a_focus_outside_of_what_was_seen_is_no_number() {
    let model = known_model(200, 150);
    let html = alone(&model);
    for part in [
        "173° shutter",
        "162 to 184° (95 %)",
        "Focus at 1.30 m",
        "1.27 to 1.33 m (95 %)",
        "0.500 to 0.900 (95 %)",
    ] {
        assert!(headlines(&html).contains(part), "{part}");
    }
    assert_eq!(headlines(&html).matches("class=\"interval\"").count(), 4);
    let lens = |s: f32, low: f32, f: f32| {
        let mut m = model.clone();
        let interval =
            Some(ThinLensInterval { sigma_px_at_infinity: [low, s + 0.3], focus_inverse_depth: [f, f] });
        let curve = DefocusCurve::ThinLens { sigma_px_at_infinity: s, focus_inverse_depth: f, interval };
        let known = DefocusModel::given(curve, DepthKind::Metric);
        m.defocus = Estimate::Known(DefocusModel { inverse_depth_seen: Some([0.1, 1.25]), ..known });
        m
    };
    for (model, says) in [
        (lens(3.0, 2.0, 5.0), "Focus nearer than all that is seen"),
        (lens(3.0, 2.0, 0.05), "Focus beyond all that is seen"),
        (lens(1e-6, 0.0, 0.5), "Sharp: blur below 0.300 px"),
    ] {
        let html = alone(&model);
        assert!(headlines(&html).contains(says), "{says}");
        assert!(!headlines(&html).contains("Focus at"), "{says}");
        assert!(words::words(&model, &[]).contains(if model.defocus.known().unwrap().sigma_px(0.0) < 1.0 {
            "below 0.30 px"
        } else {
            "that is seen"
        }));
    }
}

#[test]
fn warnings_stand_above_the_headlines() {
    let mut model = known_model(64, 64);
    assert!(!alone(&model).contains("Before you rely on this"));
    model.warnings = vec!["the footage was <compressed>".into()];
    let html = alone(&model);
    check(&html);
    let at = |part: &str| html.find(part).unwrap();
    assert!(at("The footage was &lt;compressed&gt;.") < at("aria-label=\"In short\""));
}

#[test]
fn plots_tell_their_values_under_the_pointer() {
    let model = known_model(64, 64);
    let diagnostics = diagnostics(&model);
    let html = written(&ReportInput::new("hover", &model, &diagnostics));
    check(&html);
    assert_eq!(html.matches("<circle").count(), html.matches("<title>").count() - 1);
    for part in
        ["<title>exposure 48 %: 0 nats</title>", "<title>frame 2: 50 %</title>", "px by itself</title>"]
    {
        let told: Vec<&str> = html.split("<title>").skip(1).filter_map(|t| t.split('<').next()).collect();
        assert!(html.contains(part), "{part}: {told:?}");
    }
}

/// A frame of cloth and the next one, moved by 3 px, each with its own noise.
fn cloth(noise_of: &NoiseModel) -> Sample {
    let (w, h) = (220, 160);
    let weave = |x: f32, y: f32| 0.5 + 0.12 * (1.9 * x).sin() * (1.7 * y).cos();
    let picture = |t: usize| {
        let clean = Raster::from_fn(w, h, |x, y| [weave((x as f32) - 3.0 * t as f32, y as f32); 3]);
        let grain = noise(noise_of, &clean, 7, t as u64);
        Encoded(Raster::from_fn(w, h, |x, y| std::array::from_fn(|c| clean.at(x, y)[c] + grain.at(x, y)[c])))
    };
    Sample {
        number: 0,
        frame: picture(0),
        next: Some(picture(1)),
        flow: Some(Raster::filled(w, h, [3.0, 0.0])),
        inverse_depth: None,
        clean: None,
    }
}

#[test]
fn real_noise_is_compared_along_the_motion_so_that_cloth_is_no_noise() {
    let camera = known_model(220, 160);
    let track = CameraTrack::from(camera);
    let ratio = |sample: Sample| {
        let patches = pictures::noise_patches(&[sample], &track);
        let p = patches.first().expect("the frame is large enough");
        (p.temporal, p.sigma[0] / p.sigma[1], p.test.told_apart())
    };
    let (temporal, strength, told) = ratio(cloth(&noise_model()));
    assert!(temporal && (strength - 1.0).abs() < 0.12 && !told, "{strength}");
    // Negative controls: cloth in a single frame is far stronger than noise, and other noise is told from the model's.
    let (temporal, strength, told) = ratio(Sample { next: None, ..cloth(&noise_model()) });
    assert!(!temporal && strength > 2.0 && told, "{strength}");
    let weak = NoiseModel::given([NoiseLevel { slope: [0.0; 3], intercept: [0.004; 3] }; NOISE_LEVELS], 1.0);
    assert!(ratio(cloth(&weak)).2);
}
