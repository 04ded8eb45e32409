//! Frames that hosts get are those of the library.

use crate::{
    clip::*,
    host::{CLEARED, Clip, Held, Host, Lies, PROGRESS, Set, Value, images_held, locked, texts},
};
use blindaug::{
    CameraModel, Encoded, Raster, Transfer,
    model::{DepthKind, Estimate, ExposureFraction, MotionBlurModel, SceneScale, TrackedCamera},
};
use blindaug_pipeline::{Footage, MemoryClip, Silent, estimate};
use openfx::sys::{generic::core::*, image_effect_v1::image_effect::*};
use std::{ffi::CStr, fs, path::Path, sync::atomic::Ordering};
use tempfile::TempDir;

pub const FLOAT: &CStr = kOfxBitDepthFloat;

pub fn text(path: &Path) -> Held {
    Held::Text(std::ffi::CString::new(path.to_str().unwrap()).unwrap())
}

/// A host with the clip in linear light as floats, and a camera file in the folder.
pub fn ready(model: &CameraModel) -> (Host, TempDir) {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("camera.json");
    fs::write(&file, model.to_json()).unwrap();
    let host = Host::new(SIZE);
    host.connect(c"Source", host_clip(FLOAT, false, |i| i.layer.clone()));
    host.connect(c"Depth", host_clip(FLOAT, false, |i| i.depth.clone()));
    host.connect(c"Motion", host_clip(FLOAT, false, |i| i.motion.clone()));
    host.connect(c"Plate", host_clip(FLOAT, false, |i| i.plate.clone()));
    host.connect(c"Output", output(WHOLE, FLOAT, false));
    host.set(c"camera", text(&file));
    (host, folder)
}

fn rendered(host: &Host, time: f64) -> Values {
    let status = host.render(time, FULL, WHOLE);
    assert_eq!(status, kOfxStatOK, "{:?}", host.said());
    values(&host.written(), SIZE, FLOAT)
}

fn reference<'a>(inputs: &'a Inputs, model: &'a CameraModel, number: u64) -> Reference<'a> {
    Reference { inputs, model, number, seed: 0, unclipped: true }
}

/// The largest difference of floats, at most 1 if they are the same.
fn apart_float(got: &Values, want: &Values) -> f32 {
    apart(got, want, FLOAT)
}

#[test]
fn every_frame_is_the_library_s_in_every_kind_of_values() {
    let model = camera(0.5);
    let (host, _folder) = ready(&model);
    for (depth, srgb) in [
        (kOfxBitDepthFloat, false),
        (kOfxBitDepthHalf, false),
        (kOfxBitDepthFloat, true),
        (kOfxBitDepthShort, true),
        (kOfxBitDepthByte, true),
    ] {
        for from_top in [false, true] {
            let plate = move |i: &Inputs| {
                if srgb { encoded(&i.plate.map(|p| p.map(|v| v.min(1.0)))) } else { i.plate.clone() }
            };
            // An encoded layer is encoded before it is premultiplied.
            let layer = move |i: &Inputs| {
                let opaque = |p: [f32; 4]| p.map(|v| if p[3] > 0.0 { v / p[3] } else { 0.0 });
                let over = |[r, g, b, a]: [f32; 4]| {
                    let [r, g, b, _] = opaque([r, g, b, a]).map(|v| a * Transfer::Srgb.encode(v));
                    [r, g, b, a]
                };
                if srgb { i.layer.map(over) } else { i.layer.clone() }
            };
            host.set(c"colour", Held::Integer(srgb.into()));
            host.connect(c"Source", host_clip(depth, from_top, layer));
            host.connect(c"Plate", host_clip(depth, from_top, plate));
            host.connect(c"Output", output(WHOLE, depth, from_top));
            for number in 1..=FRAMES {
                assert_eq!(host.render(number as f64, FULL, WHOLE), kOfxStatOK, "{:?}", host.said());
                let got = values(&host.written(), SIZE, depth);
                // The library gets what is left of the values in the host.
                let given = inputs(number);
                let [layer, plate] = [layer(given), plate(given)].map(|v| kept(&v, depth));
                let light = |[r, g, b, a]: [f32; 4]| {
                    let over = if a > 0.0 { a } else { 1.0 };
                    let [r, g, b] = [r, g, b].map(|v| over * Transfer::Srgb.decode(v / over));
                    [r, g, b, a]
                };
                let given = match srgb {
                    true => Inputs { layer: layer.map(light), plate: plate.map(light), ..given.clone() },
                    false => Inputs { layer, plate, ..given.clone() },
                };
                let want = |model: &CameraModel, seed: u64| {
                    let made = Reference { inputs: &given, model, number, seed, unclipped: !srgb };
                    if srgb { made.encoded() } else { made.light() }
                };
                let same = apart(&got, &want(&model, 0), depth);
                println!(
                    "{depth:?} srgb {srgb} from the top {from_top} frame {number}: {same:.3} of what is allowed"
                );
                assert!(same <= 1.0, "{same}");
                // Negative controls: another seed, and another camera.
                let others = [want(&model, 1), want(&camera(0.9), 0)].map(|w| apart(&got, &w, depth));
                assert!(others.iter().all(|o| *o > 10.0), "{others:?}");
                assert!(!got.data().iter().any(|p| p[3] != 1.0));
            }
        }
    }
}

#[test]
fn where_nothing_changes_the_plate_passes_bit_by_bit() {
    let (host, _folder) = ready(&camera(0.5));
    let got = rendered(&host, 1.0);
    let plate = &inputs(1).plate;
    let same = got.data().iter().zip(plate.data()).filter(|(a, b)| a == b).count();
    // The ball and its blur are seen in a bit more than half of the frame.
    let share = same as f32 / got.data().len() as f32;
    assert!((0.3..0.7).contains(&share), "{share}");
    // A frame without a layer is the plate.
    host.connect(c"Source", Clip::new(REGION, |_| None));
    assert_eq!(&rendered(&host, 1.0), plate);
}

#[test]
fn the_layer_over_the_plate_is_the_composite() {
    let model = camera(0.5);
    let (host, _folder) = ready(&model);
    let composite = rendered(&host, 2.0);
    host.set(c"output", Held::Integer(1));
    let layer = rendered(&host, 2.0);
    assert_eq!(apart_float(&layer, &reference(inputs(2), &model, 2).layer()), 0.0);
    let plate = &inputs(2).plate;
    let over = |layer: &Values| {
        Raster::from_fn(SIZE.0, SIZE.1, |x, y| {
            let ([r, g, b, a], f) = (layer.at(x, y), plate.at(x, y));
            [r + (1.0 - a) * f[0], g + (1.0 - a) * f[1], b + (1.0 - a) * f[2], 1.0]
        })
    };
    let worst = |a: &Values, b: &Values| {
        let pairs = a.data().as_flattened().iter().zip(b.data().as_flattened());
        pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
    };
    assert!(worst(&over(&layer), &composite) < 1e-5, "{}", worst(&over(&layer), &composite));
    // Negative control: without noise it is another picture.
    host.set(c"noise", Held::Integer(0));
    assert!(worst(&over(&rendered(&host, 2.0)), &composite) > 0.01);
    // Without a plate, black is taken for it, and the layer is made whatever is asked for.
    host.set(c"noise", Held::Integer(1));
    host.connect(c"Plate", Clip::new(REGION, |_| None));
    let black = Inputs { plate: inputs(2).plate.map(|_| [0.0; 4]), ..inputs(2).clone() };
    for output in [0, 1] {
        host.set(c"output", Held::Integer(output));
        assert_eq!(apart_float(&rendered(&host, 2.0), &reference(&black, &model, 2).layer()), 0.0);
    }
}

#[test]
fn a_part_of_a_frame_is_a_part_of_the_frame() {
    let (host, _folder) = ready(&camera(0.5));
    let whole = rendered(&host, 3.0);
    let (window, bounds) = ([30, 20, 61, 50], [24, 10, 70, 60]);
    host.connect(c"Output", output(bounds, FLOAT, true));
    assert_eq!(host.render(3.0, FULL, window), kOfxStatOK);
    let size = ((bounds[2] - bounds[0]) as usize, (bounds[3] - bounds[1]) as usize);
    let part = values(&host.written(), size, FLOAT);
    let mut inside = 0;
    for (y, row) in part.data().chunks_exact(size.0).enumerate() {
        for (x, got) in row.iter().enumerate() {
            // The place in the frame, from the lower left.
            let (i, j) = (bounds[0] + x as i32, bounds[3] - 1 - y as i32);
            let rendered = (window[0]..window[2]).contains(&i) && (window[1]..window[3]).contains(&j);
            let want = match rendered {
                true => whole.at(i as usize, SIZE.1 - 1 - j as usize),
                // What is not asked for stays as the host gave it.
                false => [0.25; 4],
            };
            assert_eq!(*got, want, "{i} {j}");
            inside += usize::from(rendered);
        }
    }
    assert_eq!(inside, 31 * 30);
}

#[test]
fn images_may_be_smaller_than_the_frame_and_frames_anywhere() {
    let model = camera(0.5);
    let (host, _folder) = ready(&model);
    let whole = rendered(&host, 2.0);
    // The layer, as renderers crop it: what is cropped is empty. Everything is 100 px right of the origin and 7 px below it.
    let [dx, dy] = [100, -7];
    let moved = |pick: fn(&Inputs) -> &Values| {
        Clip::new([100.0, -7.0, 196.0, 65.0], move |_| {
            Some(picture_at(pick(inputs(2)), [dx, dy], (FLOAT, kOfxImageComponentRGBA), false))
        })
    };
    let empty = |x: usize, y: usize| inputs(2).layer.at(x, y) == [0.0; 4];
    let (w, h) = SIZE;
    let x1 = (0..w).find(|&x| (0..h).any(|y| !empty(x, y))).unwrap();
    let x2 = 1 + (0..w).rfind(|&x| (0..h).any(|y| !empty(x, y))).unwrap();
    let y1 = (0..h).find(|&y| (0..w).any(|x| !empty(x, y))).unwrap();
    let y2 = 1 + (0..h).rfind(|&y| (0..w).any(|x| !empty(x, y))).unwrap();
    assert!(x1 > 0 && y1 > 0 && x2 < w && y2 < h);
    for depth in [c"Depth", c"Source"] {
        let pick: fn(&Inputs) -> &Values = if depth == c"Depth" { |i| &i.depth } else { |i| &i.layer };
        host.connect(
            depth,
            Clip::new([0.0; 4], move |_| {
                let part = Raster::from_fn(x2 - x1, y2 - y1, |x, y| pick(inputs(2)).at(x1 + x, y1 + y));
                let at = [dx + x1 as i32, dy + (h - y2) as i32];
                Some(picture_at(&part, at, (FLOAT, kOfxImageComponentRGBA), true))
            }),
        );
    }
    host.connect(c"Motion", moved(|i| &i.motion));
    host.connect(c"Plate", moved(|i| &i.plate));
    let there = [dx, dy, dx + w as i32, dy + h as i32];
    host.connect(c"Output", output(there, FLOAT, false));
    assert_eq!(host.render(2.0, FULL, there), kOfxStatOK, "{:?}", host.said());
    assert_eq!(values(&host.written(), SIZE, FLOAT), whole);
    // The host is told where the frame is, and that all of it is needed.
    let arguments = Host::arguments(2.0, FULL, there);
    let replies = Set::default();
    let action = kOfxImageEffectActionGetRegionOfDefinition;
    assert_eq!(host.call(action, Some(&arguments), Some(&replies)), kOfxStatOK);
    let region = |set: &Set, name: &CStr| match set.get(name) {
        Some(Value::Doubles(v)) => v,
        other => panic!("{other:?}"),
    };
    assert_eq!(region(&replies, kOfxImageEffectPropRegionOfDefinition), [100.0, -7.0, 196.0, 65.0]);
    arguments.put(kOfxImageEffectPropRegionOfInterest, Value::Doubles(vec![110.0, 0.0, 120.0, 9.0]));
    let action = kOfxImageEffectActionGetRegionsOfInterest;
    assert_eq!(host.call(action, Some(&arguments), Some(&replies)), kOfxStatOK);
    for name in [c"OfxImageClipPropRoI_Source", c"OfxImageClipPropRoI_Depth", c"OfxImageClipPropRoI_Plate"] {
        assert_eq!(region(&replies, name), [100.0, -7.0, 196.0, 65.0]);
    }
    let replies = Set::default();
    let action = kOfxImageEffectActionGetClipPreferences;
    assert_eq!(host.call(action, None, Some(&replies)), kOfxStatOK);
    assert!(matches!(replies.get(kOfxImageEffectFrameVarying), Some(Value::Ints(v)) if v == [1]));
    assert_eq!(host.call(kOfxImageEffectActionIsIdentity, None, None), kOfxStatReplyDefault);
}

/// Every second pixel of every second row.
fn reduced(values: &Values) -> Values {
    Raster::from_fn(values.width() / 2, values.height() / 2, |x, y| values.at(2 * x, 2 * y))
}

#[test]
fn in_a_proxy_lengths_in_px_are_shorter() {
    let model = camera(0.5);
    let (host, _folder) = ready(&model);
    let small = |pick: fn(&Inputs) -> &Values| {
        Clip::new(REGION, move |_| Some(picture(&reduced(pick(inputs(2))), FLOAT, false)))
    };
    host.connect(c"Source", small(|i| &i.layer));
    host.connect(c"Depth", small(|i| &i.depth));
    host.connect(c"Motion", small(|i| &i.motion));
    host.connect(c"Plate", small(|i| &i.plate));
    let (size, bounds) = ((SIZE.0 / 2, SIZE.1 / 2), [0, 0, SIZE.0 as i32 / 2, SIZE.1 as i32 / 2]);
    host.connect(c"Output", output(bounds, FLOAT, false));
    let given = |factor: f32| Inputs {
        layer: reduced(&inputs(2).layer),
        depth: reduced(&inputs(2).depth),
        motion: reduced(&inputs(2).motion).map(|m| m.map(|v| factor * v)),
        plate: reduced(&inputs(2).plate),
    };
    let made = |host: &Host| {
        assert_eq!(host.render(2.0, [0.5; 2], bounds), kOfxStatOK, "{:?}", host.said());
        values(&host.written(), size, FLOAT)
    };
    let scaled = model.scaled_to(size.0, size.1);
    let got = made(&host);
    assert!(apart_float(&got, &reference(&given(0.5), &scaled, 2).light()) <= 1.0);
    // Negative control: motion in px of the frame of full size.
    assert!(apart_float(&got, &reference(&given(1.0), &scaled, 2).light()) > 10.0);
    // The blur that is set is in px of full size, too: the camera's own is 2.5 px.
    host.set(c"setBlur", Held::Integer(1));
    host.set(c"blur", Held::Number(2.5));
    assert!(apart_float(&made(&host), &got) <= 1.0);
    host.set(c"blur", Held::Number(1.25));
    assert!(apart_float(&made(&host), &got) > 10.0);
}

#[test]
fn knobs_set_parts_of_the_camera() {
    let model = camera(0.5);
    let (host, _folder) = ready(&model);
    let with = |change: &dyn Fn(&mut CameraModel), seed: u64| {
        let mut model = model.clone();
        change(&mut model);
        Reference { inputs: inputs(1), model: &model, number: 1, seed, unclipped: true }.light()
    };
    let plain = with(&|_| {}, 0);
    let set_exposure = |model: &mut CameraModel| {
        model.motion_blur = Estimate::Known(MotionBlurModel::given(ExposureFraction(1.0)));
    };
    let by_hand = |hand: blindaug_pipeline::ByHand| {
        move |model: &mut CameraModel| *model = hand.applied(model.clone()).unwrap()
    };
    use blindaug_pipeline::ByHand;
    let focus = by_hand(ByHand { focus_m: Some(5.0), ..ByHand::default() });
    let blur = by_hand(ByHand { blur_px: Some(0.5), ..ByHand::default() });
    let grain = by_hand(ByHand { grain: Some(2.0), ..ByHand::default() });
    type Change<'a> = &'a dyn Fn(&mut CameraModel);
    // A switch and its value, a number and its value, and what the library does, with which seed.
    type Case<'a> = (&'a CStr, i32, &'a CStr, f64, Change<'a>, u64);
    let cases: [Case; 5] = [
        (c"setShutter", 1, c"shutter", 360.0, &set_exposure, 0),
        (c"setFocus", 1, c"focus", 5.0, &focus, 0),
        (c"setBlur", 1, c"blur", 0.5, &blur, 0),
        (c"noise", 1, c"grain", 2.0, &grain, 0),
        (c"seed", 9, c"grain", 1.0, &|_| {}, 9),
    ];
    let default = |name: &CStr| if name == c"noise" { 1 } else { 0 };
    for (switch, on, knob, value, change, seed) in cases {
        host.set(knob, Held::Number(value));
        host.set(switch, Held::Integer(on));
        let got = rendered(&host, 1.0);
        assert!(apart_float(&got, &with(change, seed)) <= 1.0, "{switch:?}");
        // Negative control: the knob does something.
        assert!(apart_float(&got, &plain) > 10.0, "{switch:?}");
        host.set(switch, Held::Integer(default(switch)));
        if knob == c"grain" {
            host.set(c"grain", Held::Number(1.0));
        }
        assert!(apart_float(&rendered(&host, 1.0), &plain) <= 1.0, "{switch:?}");
    }
    // Motion that counts up.
    let up = |i: &Inputs| i.motion.map(|[u, v, ..]| [u, -v, 0.0, 0.0]);
    host.connect(c"Motion", host_clip(FLOAT, false, up));
    assert!(apart_float(&rendered(&host, 1.0), &plain) > 10.0);
    host.set(c"motionUp", Held::Integer(1));
    assert!(apart_float(&rendered(&host, 1.0), &plain) <= 1.0);
    // The time at the host, in frames, less the offset is the number of the footage's frame.
    host.set(c"motionUp", Held::Integer(0));
    host.set(c"frameOffset", Held::Integer(6));
    host.connect(c"Motion", host_clip(FLOAT, false, |i| i.motion.clone()));
    let seventh = reference(inputs(1), &model, 7).light();
    assert!(apart_float(&rendered(&host, 1.0), &seventh) <= 1.0);
}

#[test]
fn layers_that_are_not_premultiplied_and_clips_of_fewer_channels_are_taken() {
    let model = camera(0.5);
    let (host, _folder) = ready(&model);
    let want = rendered(&host, 1.0);
    host.connect(c"Source", {
        Clip::new(REGION, |_| {
            let straight = inputs(1).layer.map(|[r, g, b, a]| {
                let [r, g, b] = [r, g, b].map(|v| if a > 0.0 { v / a } else { 0.0 });
                [r, g, b, a]
            });
            let picture = picture(&straight, FLOAT, false);
            Some(crate::host::Picture { premultiplication: kOfxImageUnPreMultiplied, ..picture })
        })
    });
    let of = |pick: fn(&Inputs) -> &Values, components: &'static CStr| {
        Clip::new(REGION, move |_| Some(picture_at(pick(inputs(1)), [0, 0], (FLOAT, components), true)))
    };
    host.connect(c"Depth", of(|i| &i.depth, kOfxImageComponentAlpha));
    host.connect(c"Motion", of(|i| &i.motion, kOfxImageComponentRGB));
    host.connect(c"Plate", of(|i| &i.plate, kOfxImageComponentRGB));
    let worst = apart_float(&rendered(&host, 1.0), &want);
    // To divide by alpha and to multiply again costs a rounding, which noise and blur may enlarge.
    assert!(worst < 10.0, "{worst}");
}

#[test]
fn a_camera_for_each_frame_and_one_that_changes_on_disk() {
    let (host, folder) = ready(&camera(0.5));
    let file = folder.path().join("track.jsonl");
    let line = |(frame, exposure)| {
        TrackedCamera { frame, changed: Default::default(), camera: camera(exposure) }.to_json_line()
    };
    fs::write(&file, [(1, 0.2), (3, 0.8)].map(line).join("\n")).unwrap();
    host.set(c"camera", text(&file));
    for (number, exposure) in [(1, 0.2), (2, 0.5), (3, 0.8), (4, 0.8)] {
        let got = rendered(&host, number as f64);
        let off = |exposure| apart_float(&got, &reference(inputs(number), &camera(exposure), number).light());
        // Interpolation rounds.
        assert!(off(exposure) < 10.0, "{number}: {}", off(exposure));
        assert!(off(1.0 - exposure + 0.1) > 30.0, "{number}");
    }
    // The description is a table; the file's change is noticed.
    assert_eq!(host.changed(c"camera"), kOfxStatOK);
    assert!(host.text(c"about").contains("tracked over 2 frames"), "{}", host.text(c"about"));
    fs::write(&file, camera(0.75).to_json()).unwrap();
    assert!(apart_float(&rendered(&host, 1.0), &reference(inputs(1), &camera(0.75), 1).light()) <= 1.0);
    assert_eq!(host.changed(c"camera"), kOfxStatOK);
    assert!(host.text(c"about").contains("270 degrees"), "{}", host.text(c"about"));
}

#[test]
fn a_lens_without_metres_needs_the_scene_s_scale_only_where_there_is_depth() {
    let mut model = camera(0.5);
    if let Estimate::Known(lens) = &mut model.defocus {
        lens.depth_kind = DepthKind::Relative;
    }
    let (host, _folder) = ready(&model);
    assert_eq!(host.render(1.0, FULL, WHOLE), kOfxStatFailed);
    let said = host.said().unwrap();
    assert!(said.contains("camera.json") && said.contains("scene's scale"), "{said}");
    host.set(c"setSceneScale", Held::Integer(1));
    host.set(c"sceneScale", Held::Number(0.8));
    host.set(c"sceneOffset", Held::Number(0.05));
    let metric = model.clone().to_metric(SceneScale { scale: 0.8, offset: 0.05 });
    // What failed before is taken off the node.
    let cleared = CLEARED.load(Ordering::Relaxed);
    assert!(apart_float(&rendered(&host, 1.0), &reference(inputs(1), &metric, 1).light()) <= 1.0);
    assert_eq!(CLEARED.load(Ordering::Relaxed), cleared + 1);
    // Focus and blur by hand need no scale.
    host.set(c"setSceneScale", Held::Integer(0));
    host.set(c"setFocus", Held::Integer(1));
    assert_eq!(host.render(1.0, FULL, WHOLE), kOfxStatFailed);
    assert!(host.said().unwrap().contains("only together"));
    host.set(c"setBlur", Held::Integer(1));
    rendered(&host, 1.0);
    // Nor does a layer without depth, which no lens can blur.
    host.set(c"setFocus", Held::Integer(0));
    host.set(c"setBlur", Held::Integer(0));
    host.connect(c"Depth", Clip::new(REGION, |_| None));
    rendered(&host, 1.0);
}

#[test]
fn two_threads_render_two_frames() {
    let (host, _folder) = ready(&camera(0.5));
    let alone = [1, 2, 3, 4].map(|t| rendered(&host, f64::from(t)));
    // Each thread has an output of its own: the host gives all of them the same instance.
    let main = unsafe { &*blindaug_ofx::OfxGetPlugin(0) }.mainEntry.unwrap();
    let instance = (&*host.instance as *const crate::host::Effect).addr();
    std::thread::scope(|scope| {
        for _ in 0..2 {
            scope.spawn(move || {
                for round in 0..8 {
                    let arguments = Host::arguments(f64::from(1 + round % 4), FULL, WHOLE);
                    let handle = (&arguments as *const Set).cast_mut().cast();
                    let action = kOfxImageEffectActionRender.as_ptr();
                    let instance = std::ptr::with_exposed_provenance(instance);
                    assert_eq!(unsafe { main(action, instance, handle, std::ptr::null_mut()) }, kOfxStatOK);
                }
            });
        }
    });
    assert_eq!(images_held(), 0);
    let last = values(&host.written(), SIZE, FLOAT);
    assert!(alone.contains(&last));
    assert!(host.said().is_none());
}

#[test]
fn the_plate_is_analysed_as_the_pipeline_does_it() {
    let (host, _folder) = ready(&camera(0.5));
    let clean = |number| inputs(number).plate.map(|p| p.map(|v| v / 1.6));
    let plates: Vec<Values> = (1..=FRAMES).map(|n| noisy(&clean(n), &camera(0.5), n)).collect();
    host.connect(c"Plate", {
        let plates = plates.clone();
        Clip::new(REGION, move |t| plates.get((t as usize).wrapping_sub(1)).map(|p| picture(p, FLOAT, true)))
    });
    let frames = plates
        .iter()
        .map(|p| Encoded(p.map(|[r, g, b, _]| [r, g, b].map(|v| Transfer::Srgb.encode(v)))))
        .collect();
    let footage = Footage::new(MemoryClip { frames, fps: Some(25.0) });
    let want = estimate::estimate(&footage, estimate::Job::default(), &Silent).unwrap().estimation.model;
    let want = as_kept(&want);

    // A person who cancels keeps the camera that there is.
    let before = host.text(c"camera");
    host.lies(Lies { cancels_after: Some(2), ..Lies::default() });
    assert_eq!(host.changed(c"analyse"), kOfxStatOK);
    assert_eq!((host.text(c"camera"), host.text(c"analysed")), (before, String::new()));
    assert_eq!(locked(&PROGRESS).len(), 2);
    host.lies(Lies::default());

    assert_eq!(host.changed(c"analyse"), kOfxStatOK, "{:?}", host.said());
    assert_eq!(*locked(&PROGRESS), [0.25, 0.5, 0.75, 1.0]);
    let kept = CameraModel::from_json(&host.text(c"analysed")).unwrap();
    assert_eq!(kept, want);
    assert!(kept.noise.known().is_some());
    assert!(host.text(c"camera").is_empty() && host.text(c"about").contains("96 x 72"));
    // It is what frames are made with, and the lens, whose depth has no unit, must not stop those without depth.
    host.connect(c"Depth", Clip::new(REGION, |_| None));
    let given =
        Inputs { plate: plates[0].clone(), depth: inputs(1).depth.map(|_| [1e10; 4]), ..inputs(1).clone() };
    let mut without_lens = want.clone();
    without_lens.defocus = Estimate::unknown(blindaug::model::Reason::NoDepth, "");
    let made = rendered(&host, 1.0);
    assert!(apart_float(&made, &reference(&given, &without_lens, 1).light()) <= 1.0);
    // Negative control: the camera that the file had is another one.
    assert!(apart_float(&made, &reference(&given, &camera(0.5), 1).light()) > 10.0);

    // What cannot be analysed is told.
    let frame = picture(&plates[0], FLOAT, false);
    let gap = Clip::new(REGION, move |t| (t != 3.0).then(|| frame.clone()));
    host.connect(c"Plate", gap);
    assert_eq!(host.changed(c"analyse"), kOfxStatFailed);
    assert!(host.said().unwrap().contains("frame 3"));
    host.lies(Lies {
        image: vec![(kOfxImageEffectPropRenderScale, Some(Value::Doubles(vec![0.5; 2])))],
        ..Lies::default()
    });
    assert_eq!(host.changed(c"analyse"), kOfxStatFailed);
    assert!(host.said().unwrap().contains("proxies"));
    host.lies(Lies::default());
    let endless = Clip::new(REGION, |_| None);
    endless.properties.put(kOfxImageEffectPropFrameRange, Value::Doubles(vec![-2e9, 2e9]));
    host.connect(c"Plate", endless);
    assert_eq!(host.changed(c"analyse"), kOfxStatFailed);
    assert!(host.said().unwrap().contains("first and a last frame"));
    let unconnected = Clip::new(REGION, |_| None);
    unconnected.properties.put(kOfxImageClipPropConnected, Value::Ints(vec![0]));
    host.connect(c"Plate", unconnected);
    assert_eq!(host.changed(c"analyse"), kOfxStatFailed);
    assert!(host.said().unwrap().contains("connect the plate"));
    // What the plugin itself changes is no reason to do anything.
    let arguments = Host::arguments(1.0, FULL, WHOLE)
        .with(kOfxPropName, texts(&[c"analyse"]))
        .with(kOfxPropChangeReason, texts(&[kOfxChangePluginEdited]));
    assert_eq!(host.call(kOfxActionInstanceChanged, Some(&arguments), None), kOfxStatReplyDefault);
}
