//! Hosts that lie, and files that are broken: an error and one sentence, never a crash.

use crate::{
    clip::*,
    frames::{FLOAT, ready, text},
    host::{Clip, Held, Host, Lies, Value, texts},
};
use openfx::sys::{generic::core::*, image_effect_v1::image_effect::*};
use std::{ffi::CStr, fs};

/// Renders a frame, which must fail with one sentence that says this.
fn fails(host: &Host, says: &str) {
    assert_eq!(host.render(1.0, FULL, WHOLE), kOfxStatFailed, "{says}");
    let said = host.said().expect(says);
    assert!(said.starts_with("blindaug: ") && said.contains(says) && !said.contains('\n'), "{said}");
}

fn works(host: &Host) {
    assert_eq!(host.render(1.0, FULL, WHOLE), kOfxStatOK, "{:?}", host.said());
    assert_eq!(host.said(), None);
}

#[test]
fn hosts_without_the_needed_suites_are_refused() {
    for suite in [c"OfxPropertySuite", c"OfxImageEffectSuite", c"OfxParameterSuite"] {
        let (host, status) = Host::load(Lies { missing_suites: vec![suite], ..Lies::default() });
        assert_eq!(status, kOfxStatErrMissingHostFeature);
        // Whoever goes on nevertheless gets no further.
        assert_eq!(host.call(kOfxActionDescribe, None, None), kOfxStatErrMissingHostFeature);
    }
    // Without the suites of messages and of progress it loads.
    let missing_suites = vec![c"OfxMessageSuite", c"OfxProgressSuite"];
    let (_host, status) = Host::load(Lies { missing_suites, ..Lies::default() });
    assert_eq!(status, kOfxStatOK);
}

#[test]
fn suites_without_functions_are_refused_where_they_are_needed() {
    for suite in [c"OfxPropertySuite", c"OfxImageEffectSuite", c"OfxParameterSuite"] {
        let (_host, status) = Host::load(Lies { empty_suites: vec![suite], ..Lies::default() });
        assert_eq!(status, kOfxStatErrMissingHostFeature);
    }
    let empty_suites = vec![c"OfxMessageSuite", c"OfxProgressSuite"];
    let (host, status) = Host::load(Lies { empty_suites, ..Lies::default() });
    assert_eq!(status, kOfxStatOK);
    // The sentence of a failure goes to standard error then.
    let arguments = Host::arguments(1.0, FULL, WHOLE);
    assert_eq!(host.call(kOfxImageEffectActionRender, Some(&arguments), None), kOfxStatFailed);
    assert_eq!(host.said(), None);
}

#[test]
fn null_handles_are_errors() {
    let host = Host::new(SIZE);
    for action in [kOfxActionDescribe, kOfxImageEffectActionRender, kOfxActionInstanceChanged] {
        assert_eq!(host.call_without(action), kOfxStatErrBadHandle);
    }
    // Actions without arguments and without room for replies.
    for action in [
        kOfxImageEffectActionRender,
        kOfxActionInstanceChanged,
        kOfxImageEffectActionGetRegionOfDefinition,
        kOfxImageEffectActionGetRegionsOfInterest,
        kOfxImageEffectActionGetClipPreferences,
    ] {
        assert_eq!(host.call(action, None, None), kOfxStatErrBadHandle);
    }
    assert_eq!(host.call(c"OfxActionOfTheFuture", None, None), kOfxStatReplyDefault);
    // An instance may be forgotten twice.
    assert_eq!(host.call(kOfxActionDestroyInstance, None, None), kOfxStatOK);
    assert_eq!(host.call(kOfxActionDestroyInstance, None, None), kOfxStatOK);
}

#[test]
fn images_that_cannot_be_are_errors() {
    let (host, _folder) = ready(&camera(0.5));
    works(&host);
    host.lies(Lies { null_image: true, ..Lies::default() });
    fails(&host, "is null");
    host.lies(Lies { image_status: Some(kOfxStatErrBadHandle), ..Lies::default() });
    fails(&host, "cannot be fetched");
    host.lies(Lies { image_status: Some(kOfxStatErrMemory), ..Lies::default() });
    assert_eq!(host.render(1.0, FULL, WHOLE), kOfxStatErrMemory);
    let ints = |v: &[i32]| Some(Value::Ints(v.to_vec()));
    let cases: [(&CStr, Option<Value>, &str); 14] = [
        (kOfxImagePropData, None, "has no pixels"),
        (kOfxImagePropData, Some(Value::Pointer(0)), "has no pixels"),
        (kOfxImagePropBounds, None, "has no bounds"),
        (kOfxImagePropBounds, ints(&[0, 0, 96]), "has no bounds"),
        (kOfxImagePropBounds, ints(&[96, 0, 0, 72]), "which are no picture"),
        (kOfxImagePropBounds, ints(&[i32::MIN, 0, i32::MAX, 72]), "which are no picture"),
        (kOfxImagePropRowBytes, None, "has no row bytes"),
        (kOfxImagePropRowBytes, ints(&[0]), "rows of 0 bytes"),
        (kOfxImagePropRowBytes, ints(&[-95]), "rows of -95 bytes"),
        (kOfxImagePropRowBytes, Some(Value::Doubles(vec![1e9])), "has no row bytes"),
        (kOfxImageEffectPropPixelDepth, None, "unknown kind"),
        (kOfxImageEffectPropPixelDepth, Some(texts(&[c"OfxBitDepthDouble"])), "OfxBitDepthDouble"),
        (kOfxImageEffectPropComponents, Some(texts(&[c"OfxImageComponentYUVA"])), "OfxImageComponentYUVA"),
        (kOfxImageEffectPropComponents, Some(texts(&[c"\xff"])), "unknown kind"),
    ];
    for (name, lie, says) in cases {
        host.lies(Lies { image: vec![(name, lie)], ..Lies::default() });
        fails(&host, says);
    }
    host.lies(Lies::default());
    works(&host);
}

#[test]
fn images_of_other_sizes_are_cut_or_filled_with_nothing() {
    let (host, _folder) = ready(&camera(0.5));
    for bounds in [[0, 0, 1, 1], [-500, -500, -400, -400], [-20, -30, 200, 300], [95, 71, 400, 72]] {
        for clip in [c"Source", c"Depth", c"Motion"] {
            host.connect(clip, output(bounds, FLOAT, true));
            works(&host);
        }
        host.connect(c"Output", output(bounds, FLOAT, false));
        works(&host);
    }
    // An empty image is one that is not there.
    host.lies(Lies {
        image: vec![(kOfxImagePropBounds, Some(Value::Ints(vec![5, 5, 5, 5])))],
        ..Lies::default()
    });
    fails(&host, "no image to render into");
}

#[test]
fn frames_of_no_size_and_values_of_no_meaning_are_errors() {
    let (host, _folder) = ready(&camera(0.5));
    for region in [[0.0; 4], [f64::NAN; 4], [-1e30, -1e30, 1e30, 1e30], [9.0, 9.0, 1.0, 1.0]] {
        // A plate without a usable region leaves the project's.
        let mut plate = host_clip(FLOAT, false, |i| i.plate.clone());
        plate.region = region;
        host.connect(c"Plate", plate);
        works(&host);
    }
    host.instance.properties.put(kOfxImageEffectPropProjectSize, Value::Doubles(vec![0.0; 2]));
    works(&host);
    host.connect(c"Source", Clip::new([0.0; 4], |_| None));
    fails(&host, "how large a frame is");
    host.connect(c"Source", Clip::new([0.0, 0.0, 60_000.0, 60_000.0], |_| None));
    fails(&host, "60000 x 60000 pixels is too large");
    let (host, _folder) = {
        drop(host);
        ready(&camera(0.5))
    };
    for scale in [[0.0; 2], [f64::NAN; 2], [-1.0; 2], [1e9; 2], [1.0, 1e-3]] {
        let status = host.render(1.0, scale, WHOLE);
        // A number that is none is taken for 1.
        assert_eq!(status == kOfxStatOK, scale[0].is_nan() || scale[1] == 1e-3, "{scale:?}");
        host.said();
    }
    // No part of the frame is nothing to do.
    for window in [[5, 5, 5, 5], [9, 9, 3, 3], [i32::MIN, 0, i32::MAX, 5]] {
        assert_eq!(host.render(1.0, FULL, window), kOfxStatOK);
    }
    assert_eq!(host.render(f64::INFINITY, FULL, WHOLE), kOfxStatFailed);
    assert!(host.said().unwrap().contains("which frame it wants"));
    host.connect(c"Depth", host_clip(kOfxBitDepthByte, false, |i| i.depth.clone()));
    fails(&host, "the depth has integer values");
    host.connect(c"Depth", host_clip(FLOAT, false, |i| i.depth.clone()));
    host.connect(c"Output", {
        Clip::new(REGION, |_| {
            let nothing = inputs(1).plate.map(|_| [0.0; 4]);
            Some(picture_at(&nothing, [0, 0], (FLOAT, kOfxImageComponentRGB), false))
        })
    });
    fails(&host, "the output has 3 channels");
    host.connect(c"Output", output(WHOLE, FLOAT, false));
    host.set(c"colour", Held::Integer(1));
    host.set(c"output", Held::Integer(1));
    fails(&host, "linear light");
    // A host that wants the frame no more gets none, and no error.
    host.set(c"colour", Held::Integer(0));
    host.lies(Lies { aborts: true, ..Lies::default() });
    works(&host);
    // Images full of what is no number are no harm.
    host.lies(Lies::default());
    for clip in [c"Source", c"Depth", c"Motion", c"Plate"] {
        host.connect(
            clip,
            host_clip(FLOAT, false, |i| i.layer.map(|_| [f32::NAN, f32::INFINITY, -1e30, f32::NAN])),
        );
    }
    works(&host);
}

#[test]
fn parameters_that_are_missing_or_of_another_kind_are_errors() {
    let (host, _folder) = ready(&camera(0.5));
    for knob in &blindaug_ofx::knobs::KNOBS {
        use blindaug_ofx::knobs::Kind;
        if matches!(knob.kind, Kind::Button | Kind::Words | Kind::Hidden) {
            continue;
        }
        let needed = match knob.name.to_bytes() {
            // These are looked at only where a switch is on.
            b"shutter" | b"focus" | b"blur" | b"sceneScale" | b"sceneOffset" => continue,
            _ => knob.name,
        };
        host.lies(Lies { missing_parameter: Some(needed), ..Lies::default() });
        fails(&host, "the host has no parameter");
        // A text is given for a number, and a number for the text.
        let other = if matches!(knob.kind, Kind::File) { c"grain" } else { c"about" };
        host.lies(Lies { other_parameter: Some((needed, other)), ..Lies::default() });
        fails(&host, "the host has no parameter");
    }
    host.lies(Lies::default());
    for (name, value) in [
        (c"grain", Held::Number(-1.0)),
        (c"grain", Held::Number(f64::NAN)),
        (c"grain", Held::Number(1e300)),
        (c"seed", Held::Integer(-1)),
        (c"output", Held::Integer(2)),
        (c"colour", Held::Integer(-1)),
        (c"frameOffset", Held::Integer(i32::MIN)),
    ] {
        host.set(name, value);
        assert_eq!(host.render(1.0, FULL, WHOLE), kOfxStatFailed);
        assert!(host.said().is_some());
        let knob = blindaug_ofx::knobs::KNOBS.iter().find(|k| k.name == name).unwrap();
        host.set(
            name,
            match knob.kind {
                blindaug_ofx::knobs::Kind::Number { default, .. } => Held::Number(default),
                blindaug_ofx::knobs::Kind::Integer { default, .. } => Held::Integer(default),
                _ => Held::Integer(0),
            },
        );
        works(&host);
    }
}

#[test]
fn cameras_that_are_missing_or_broken_are_errors_that_name_the_file() {
    let (host, folder) = ready(&camera(0.5));
    let file = folder.path().join("other.json");
    host.set(c"camera", text(&file));
    fails(&host, "other.json: the camera file cannot be read");
    let good = camera(0.5).to_json();
    for (broken, says) in [
        (String::new(), "not a camera model"),
        ("{}".into(), "not a camera model"),
        (good[..good.len() / 2].to_owned(), "not a camera model"),
        (good.replace("\"exposure\": 0.5", "\"exposure\": 7"), "motion_blur.exposure"),
        (good.replacen("\"version\": 1", "\"version\": 2", 1), "version 2"),
        ("{\"frame\": 2}\n{\"frame\": 1}".into(), "line 1"),
    ] {
        assert_ne!(broken, good);
        fs::write(&file, broken).unwrap();
        fails(&host, says);
        // A person who chooses the file is told at once.
        assert_eq!(host.changed(c"camera"), kOfxStatFailed);
        assert!(host.said().unwrap().contains("other.json"));
        assert!(host.text(c"about").contains("No camera yet"));
    }
    fs::write(&file, [0xff, 0xfe, 0x00]).unwrap();
    fails(&host, "cannot be read");
    host.set(c"camera", text(folder.path()));
    fails(&host, "cannot be read");
    fs::write(&file, &good).unwrap();
    host.set(c"camera", text(&file));
    works(&host);
    // Without a camera, something must be set by hand.
    host.set(c"camera", Held::Text(c" ".into()));
    fails(&host, "there is no camera");
    host.set(c"analysed", Held::Text(c"{".into()));
    fails(&host, "the analysed camera: not a camera model");
    host.set(c"analysed", Held::Text(c"".into()));
    host.set(c"setShutter", Held::Integer(1));
    works(&host);
    host.set(c"grain", Held::Number(2.0));
    fails(&host, "cannot be scaled");
}
