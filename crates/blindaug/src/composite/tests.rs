//! Tests of [`super`].

use super::*;
use crate::Transfer;
use crate::model::{
    BlurSpace, Capture, DefocusModel, DepthKind, Estimate, ExposureFraction, MotionBlurModel, NoiseLevel,
};

const W: usize = 160;
const H: usize = 120;

fn camera() -> CameraModel {
    let capture = Capture { width: W, height: H, fps: None, frames_used: 1, pixel_aspect: 1.0 };
    let mut model = CameraModel::unknown(capture, "not needed");
    model.motion_blur = Estimate::Known(MotionBlurModel::given(ExposureFraction(0.5)));
    // The lens is sharp at 1 m, and its blur at infinity has a std of 3 px.
    model.defocus = Estimate::Known(DefocusModel::given_lens(3.0, 1.0));
    model
}

fn with_noise(mut model: CameraModel, slope: f32, intercept: f32, clip: f32) -> CameraModel {
    let levels =
        noise::white_band_std().map(|s| NoiseLevel { slope: [slope * s; 3], intercept: [intercept * s; 3] });
    model.noise = Estimate::Known(NoiseModel::given(levels, clip));
    model
}

fn background() -> Encoded {
    Encoded(Raster::from_fn(W, H, |x, y| [0.2 + 0.1 * ((x / 5) % 2) as f32, 0.3, 0.1 + 0.004 * y as f32]))
}

/// A square of one colour from (50, 40) to (99, 79).
fn square(colour: [f32; 3], alpha: f32, inverse_depth: f32, flow: [f32; 2]) -> VirtualLayer {
    let inside = |x: usize, y: usize| (50..100).contains(&x) && (40..80).contains(&y);
    let [r, g, b] = colour.map(|v| v * alpha);
    VirtualLayer {
        color: Premultiplied(Raster::from_fn(
            W,
            H,
            |x, y| {
                if inside(x, y) { [r, g, b, alpha] } else { [0.0; 4] }
            },
        )),
        inverse_depth: Some(Plane::from_fn(W, H, |x, y| if inside(x, y) { inverse_depth } else { f32::NAN })),
        flow: Some(Flow::filled(W, H, flow)),
    }
}

fn plate(frame: &Encoded) -> Plate<'_> {
    Plate::new(frame, 7)
}

fn close(a: [f32; 3], b: [f32; 3], tolerance: f32) -> bool {
    a.iter().zip(b).all(|(a, b)| (a - b).abs() < tolerance)
}

const GREY: [f32; 3] = [0.214_041_14; 3]; // encoded: 0.5

#[test]
fn without_blur_and_noise_it_is_plain_over() {
    let frame = background();
    let layer = square([0.5, 0.2, 0.1], 0.25, 1.0, [0.0; 2]);
    let naive = CompositeOptions { naive: true, ..CompositeOptions::default() };
    let model = with_noise(camera(), 0.1, 0.1, 1.0);
    let out = composite(&plate(&frame), &layer, &model, &naive).unwrap();
    // The camera's blur changes nothing on an object in focus and at rest.
    let silent = CompositeOptions { no_noise: true, ..CompositeOptions::default() };
    assert!(out == composite(&plate(&frame), &layer, &model, &silent).unwrap());
    let t = Transfer::Srgb;
    let (f, l) = (frame.0.at(70, 60), layer.color.0.at(70, 60));
    let want = std::array::from_fn(|c| t.encode(l[c] + 0.75 * t.decode(f[c])));
    assert!(close(out.0.at(70, 60), want, 1e-5));
    assert_eq!(out.0.at(49, 60), frame.0.at(49, 60));
}

#[test]
fn light_without_alpha_is_added_whether_blurred_or_not() {
    let frame = background();
    let mut layer = square([0.3, 0.2, 0.1], 1.0, 1.0, [0.0; 2]);
    let bare = layer.color.0.map(|[r, g, b, _]| [r, g, b, 0.0]);
    // Negative control: where alpha is 0 there is no layer.
    layer.color = Premultiplied(bare.clone());
    let options = CompositeOptions { no_noise: true, ..CompositeOptions::default() };
    assert_eq!(composite(&plate(&frame), &layer, &camera(), &options).unwrap(), frame);
    layer.color = Premultiplied::from_render(&bare);
    assert!((layer.color.share_of_light_alone() - 50.0 * 40.0 / (W * H) as f32).abs() < 1e-6);
    let added = |flow: [f32; 2]| {
        let layer = VirtualLayer { flow: Some(Flow::filled(W, H, flow)), ..layer.clone() };
        let out = composite(&plate(&frame), &layer, &camera(), &options).unwrap();
        let light = |image: &Encoded| image.to_linear(Transfer::Srgb);
        let (with, without) = (light(&out), light(&frame));
        with.0.data().iter().zip(without.0.data()).map(|(a, b)| a[0] - b[0]).sum::<f32>()
    };
    let whole = 0.3 * 50.0 * 40.0;
    assert!((added([0.0; 2]) / whole - 1.0).abs() < 0.01 && (added([20.0, 0.0]) / whole - 1.0).abs() < 0.01);
}

#[test]
fn the_frame_is_untouched_bit_by_bit_where_nothing_virtual_is_seen() {
    let frame = background();
    let model = with_noise(camera(), 0.05, 0.02, 1.0);
    for bokeh in [Bokeh::Gaussian, Bokeh::Disk] {
        let options = CompositeOptions { bokeh: Some(bokeh), ..CompositeOptions::default() };
        // The object is blurred by 3 px of defocus and 12 px of motion.
        let out = composite(&plate(&frame), &square(GREY, 1.0, 2.0, [24.0, 0.0]), &model, &options).unwrap();
        for y in 0..H {
            for x in 0..W {
                if !(50 - 22..100 + 22).contains(&x) || !(40 - 16..80 + 16).contains(&y) {
                    assert_eq!(out.0.at(x, y), frame.0.at(x, y), "{x} {y}");
                }
            }
        }
        assert_ne!(out.0.at(46, 60), frame.0.at(46, 60));
    }
    let empty = square(GREY, 0.0, 2.0, [24.0, 0.0]);
    assert!(composite(&plate(&frame), &empty, &model, &CompositeOptions::default()).unwrap() == frame);
}

#[test]
fn the_lens_s_shape_and_the_shutter_s_phase_act_on_the_object_as_on_a_whole_picture() {
    let frame = Encoded(Raster::filled(W, H, [0.0; 3]));
    let composited = |model: &CameraModel| {
        let layer = square([0.5; 3], 1.0, 3.0, [24.0, 0.0]);
        let out = composite(&plate(&frame), &layer, model, &CompositeOptions::default()).unwrap();
        out.to_linear(Transfer::Srgb).0
    };
    let middle = |light: &Raster<[f32; 3]>| {
        let sum = |g: &dyn Fn(usize, usize) -> f32| -> f32 {
            (0..W * H).map(|i| light.data()[i][1] * g(i % W, i / W)).sum()
        };
        let all = sum(&|_, _| 1.0);
        [sum(&|x, _| x as f32) / all, sum(&|_, y| y as f32) / all]
    };
    let [x, y] = middle(&composited(&camera()));
    assert!((x - 74.5).abs() < 0.1 && (y - 59.5).abs() < 0.1, "{x} {y}");
    // A shutter of 180 degrees that opens at the frame's time shows the object a quarter of its motion later.
    let mut later = camera();
    if let Estimate::Known(m) = &mut later.motion_blur {
        m.phase_degrees = Some(0.0);
    }
    let [later, _] = middle(&composited(&later));
    assert!((later - x - 6.0).abs() < 0.15, "{later} {x}");
    // The composite looks at a part of the frame; the cat's eye depends on the place in the whole of it.
    let mut cut = camera();
    if let Estimate::Known(lens) = &mut cut.defocus {
        lens.bokeh = crate::model::Aperture { cats_eye: 1.0, ..Bokeh::Disk.into() };
    }
    let blur = Blur::new(&cut, W, None).unwrap();
    let layer = square([0.5; 3], 1.0, 3.0, [24.0, 0.0]);
    let whole = blur.of_layer(&layer.color.0, layer.inverse_depth.as_ref(), layer.flow.as_ref()).unwrap();
    let error = |light: &Raster<[f32; 3]>| {
        light.data().iter().zip(whole.data()).map(|(a, b)| (a[1] - b[1]).abs()).fold(0.0, f32::max)
    };
    assert!(error(&composited(&cut)) < 2e-3, "{}", error(&composited(&cut)));
    let disk = CompositeOptions { bokeh: Some(Bokeh::Disk), ..CompositeOptions::default() };
    let round = composite(&plate(&frame), &layer, &camera(), &disk).unwrap().to_linear(Transfer::Srgb).0;
    assert!(error(&round) > 0.02, "{}", error(&round));
}

#[test]
fn the_silhouette_is_blurred_beyond_itself_and_mixes_light() {
    let frame = Encoded(Raster::filled(W, H, [0.0; 3]));
    let out = composite(
        &plate(&frame),
        &square([1.0; 3], 1.0, 1.0, [24.0, 0.0]),
        &camera(),
        &CompositeOptions::default(),
    );
    let light = out.unwrap().to_linear(Transfer::Srgb).0;
    // The edge is a ramp of light over 12 px, centred at x = 49.5.
    for (x, want) in [(42, 0.0), (46, 2.5 / 12.0), (49, 5.5 / 12.0), (50, 6.5 / 12.0), (57, 1.0)] {
        assert!((light.at(x, 60)[0] - want).abs() < 0.02, "{x}: {:?}", light.at(x, 60));
    }
    // On request, encoded values are mixed instead of light.
    let mut model = camera();
    model.blur_space = BlurSpace::Encoded;
    let out = composite(
        &plate(&frame),
        &square([1.0; 3], 1.0, 1.0, [24.0, 0.0]),
        &model,
        &CompositeOptions::default(),
    );
    assert!((out.unwrap().0.at(49, 60)[0] - 5.5 / 12.0).abs() < 0.02);
}

#[test]
fn unknown_parts_and_missing_evidence_are_left_out() {
    let frame = background();
    let plain = CompositeOptions { naive: true, ..CompositeOptions::default() };
    let moving = square(GREY, 1.0, 3.0, [24.0, 0.0]);
    let naive = composite(&plate(&frame), &moving, &camera(), &plain).unwrap();
    let nothing = CameraModel::unknown(camera().capture, "a wall");
    assert!(composite(&plate(&frame), &moving, &nothing, &CompositeOptions::default()).unwrap() == naive);
    let bare = VirtualLayer { inverse_depth: None, flow: None, ..moving };
    assert!(composite(&plate(&frame), &bare, &camera(), &CompositeOptions::default()).unwrap() == naive);
}

#[test]
fn real_things_in_front_hide_the_object_whether_it_was_cut_or_not() {
    let frame = background();
    // A post at 0.4 m is in front of the object at 1 m; a wall is at 4 m; the depth is unknown below y = 70.
    let real = Plane::from_fn(W, H, |x, y| match (x, y) {
        (_, 70..) => f32::NAN,
        (70..80, _) => 2.5,
        _ => 0.25,
    });
    let uncut = square(GREY, 1.0, 1.0, [0.0; 2]);
    let mut cut = uncut.clone();
    for y in 0..70 {
        cut.color.0.row_mut(y)[70..80].fill([0.0; 4]);
    }
    let with_depth = Plate { inverse_depth: Some(&real), ..plate(&frame) };
    let naive = CompositeOptions { naive: true, ..CompositeOptions::default() };
    for layer in [&uncut, &cut] {
        let out = composite(&with_depth, layer, &camera(), &naive).unwrap();
        assert_eq!(out.0.at(75, 60), frame.0.at(75, 60));
        assert!(close(out.0.at(60, 60), [0.5; 3], 1e-4) && close(out.0.at(90, 60), [0.5; 3], 1e-4));
    }
    assert!(close(composite(&with_depth, &uncut, &camera(), &naive).unwrap().0.at(75, 75), [0.5; 3], 1e-4));
}

#[test]
fn a_blurred_thing_in_front_mixes_with_the_object_instead_of_the_background() {
    // The true image: a white post, blurred, over a black wall; then over the grey object that fills the view behind it.
    let t = Transfer::Srgb;
    let sharp = Plane::from_fn(W, H, |x, _| if (70..90).contains(&x) { 1.0 } else { 0.0 });
    let blur = Blur::new(&camera(), W, Bokeh::Gaussian).unwrap();
    let post = blur.of(&sharp, Some(&Plane::filled(W, H, 2.5)), None).unwrap(); // 4.5 px
    let frame = Encoded(post.map(|a| [t.encode(a); 3]));
    let truth = Encoded(post.map(|a| [t.encode(a + (1.0 - a) * GREY[0]); 3]));
    let real = sharp.map(|a| if a > 0.0 { 2.5 } else { 0.1 });
    let layer = VirtualLayer {
        color: Premultiplied(Raster::from_fn(W, H, |x, _| {
            if sharp.at(x, 0) > 0.0 { [0.0; 4] } else { [GREY[0], GREY[0], GREY[0], 1.0] }
        })),
        inverse_depth: Some(Plane::filled(W, H, 1.0)),
        flow: None,
    };
    let plate = Plate { inverse_depth: Some(&real), ..plate(&frame) };
    let out = composite(&plate, &layer, &camera(), &CompositeOptions::default()).unwrap();
    let worst =
        |a: &Encoded| (40..120).map(|x| (a.0.at(x, 60)[0] - truth.0.at(x, 60)[0]).abs()).fold(0.0, f32::max);
    assert!(worst(&out) < 0.03, "{}", worst(&out));
    // Negative control: the plain over operation is clearly wrong.
    let naive = CompositeOptions { naive: true, ..CompositeOptions::default() };
    assert!(worst(&composite(&plate, &layer, &camera(), &naive).unwrap()) > 0.1);
}

#[test]
fn shadows_fall_on_the_frame_and_continue_under_the_soft_edge() {
    let t = Transfer::Srgb;
    let frame = Encoded(Raster::filled(W, H, [0.6; 3]));
    let layer = square(GREY, 1.0, 2.0, [0.0; 2]);
    // The renders differ by a shadow that halves the light right of x = 30; both are darker than the frame, which is halved all the same.
    let without = Linear(Raster::filled(W, H, [0.2; 3]));
    let with = Linear(Raster::from_fn(W, H, |x, y| match layer.color.0.at(x, y) {
        [r, g, b, a] if a > 0.0 => [r, g, b],
        _ if x >= 30 => [0.1; 3],
        _ => [0.2; 3],
    }));
    let plate = Plate { with_and_without: Some((&with, &without)), ..plate(&frame) };
    let out = composite(&plate, &layer, &camera(), &CompositeOptions::default()).unwrap();
    let shadow = 0.5 * t.decode(0.6);
    assert_eq!(out.0.at(10, 60), frame.0.at(10, 60));
    assert!(close(out.0.at(140, 60), [t.encode(shadow); 3], 1e-4));
    // The middle of the edge is half object, half shadowed frame.
    let edge = 0.5 * (t.decode(out.0.at(49, 60)[0]) + t.decode(out.0.at(50, 60)[0]));
    assert!((edge - 0.5 * (GREY[0] + shadow)).abs() < 0.01, "{edge}");
}

#[test]
fn light_that_the_object_adds_is_added_and_not_multiplied() {
    let frame = Encoded(Raster::filled(W, H, [0.3; 3]));
    let layer = square(GREY, 0.0, 2.0, [0.0; 2]);
    let without = Linear(Raster::filled(W, H, [0.1, 0.1, 0.1]));
    // The object reflects red onto the scene and takes away half of its blue.
    let with = Linear(Raster::from_fn(W, H, |x, _| if x < 80 { [0.3, 0.1, 0.05] } else { [0.1; 3] }));
    let plate = Plate { with_and_without: Some((&with, &without)), ..plate(&frame) };
    let out = composite(&plate, &layer, &camera(), &CompositeOptions::default()).unwrap();
    let light = Transfer::Srgb.decode(0.3);
    let want = [light + 0.2, light, 0.5 * light].map(|v| Transfer::Srgb.encode(v));
    assert!(close(out.0.at(20, 60), want, 1e-4), "{:?}", out.0.at(20, 60));
    assert_eq!(out.0.at(140, 60), frame.0.at(140, 60));
}

#[test]
fn a_shadow_has_the_noise_of_its_own_luminance() {
    // The floor is bright and noisy, and the noise falls with the luminance.
    let model = with_noise(camera(), 0.06, 0.002, 1.0);
    let t = Transfer::Srgb;
    let floor = |number: u64| {
        let clean = Raster::filled(W, H, [0.75; 3]);
        let Estimate::Known(m) = &model.noise else { panic!("the noise is known") };
        let grain = noise::noise(m, &clean, 5, number);
        Encoded(Raster::from_fn(W, H, |x, y| std::array::from_fn(|c| clean.at(x, y)[c] + grain.at(x, y)[c])))
    };
    let without = Linear(Raster::filled(W, H, [0.2; 3]));
    let with = Linear(Raster::from_fn(W, H, |x, _| if x > 30 { [0.2 * 0.05; 3] } else { [0.2; 3] }));
    let layer = square(GREY, 0.0, 2.0, [0.0; 2]);
    let dark = t.encode(0.05 * t.decode(0.75));
    let (mut ours, mut of_difference, mut count) = (0.0, 0.0, 0.0);
    for number in 0..6 {
        let frame = floor(number);
        let plate = Plate { number, with_and_without: Some((&with, &without)), ..plate(&frame) };
        let out = composite(&plate, &layer, &model, &CompositeOptions::default()).unwrap();
        for y in 20..100 {
            for x in 60..150 {
                ours += (out.0.at(x, y)[0] - dark).powi(2);
                // Negative control: the difference of the renders, scaled to the frame, leaves all the noise of the floor's light.
                let light = t.decode(frame.0.at(x, y)[0]) - 0.95 * t.decode(0.75);
                of_difference += (t.encode(light.max(0.0)) - dark).powi(2);
                count += 1.0;
            }
        }
    }
    let want = {
        let Estimate::Known(m) = &model.noise else { panic!("the noise is known") };
        let clean = Raster::filled(W, H, [dark; 3]);
        let grain = noise::noise(m, &clean, 9, 0);
        (grain.data().iter().map(|v| v[0] * v[0]).sum::<f32>() / grain.data().len() as f32).sqrt()
    };
    let [ours, of_difference] = [ours, of_difference].map(|v: f32| (v / count).sqrt());
    assert!(ours < 1.5 * want && ours > 0.8 * want, "{ours} {want}");
    assert!(of_difference > 4.0 * want, "{of_difference} {want}");
}

#[test]
fn an_object_of_unknown_depth_and_motion_is_not_blurred() {
    let frame = background();
    let bare = VirtualLayer { inverse_depth: None, flow: None, ..square(GREY, 1.0, 2.0, [24.0, 0.0]) };
    let unknown = VirtualLayer {
        inverse_depth: Some(Plane::filled(W, H, f32::NAN)),
        flow: Some(Flow::filled(W, H, [f32::NAN; 2])),
        ..bare.clone()
    };
    let made = |layer: &VirtualLayer| {
        composite(&plate(&frame), layer, &camera(), &CompositeOptions::default()).unwrap()
    };
    assert!(made(&unknown) == made(&bare));
    // Negative control: what is known is blurred.
    assert!(made(&square(GREY, 1.0, 2.0, [24.0, 0.0])) != made(&bare));
}

#[test]
fn a_matte_holds_the_object_out() {
    let frame = background();
    let layer = square([0.5, 0.2, 0.1], 1.0, 1.0, [0.0; 2]);
    // Left of the middle of the object something is in front of it, with an edge of 4 px.
    let matte = Plane::from_fn(W, H, |x, _| ((77.0 - x as f32) / 4.0).clamp(0.0, 1.0));
    let all = CompositeOptions::default();
    let open = composite(&plate(&frame), &layer, &camera(), &all).unwrap();
    let held = Plate { holdout: Some(&matte), ..plate(&frame) };
    let out = composite(&held, &layer, &camera(), &all).unwrap();
    assert_eq!(out.0.at(60, 60), frame.0.at(60, 60));
    assert_eq!(out.0.at(90, 60), open.0.at(90, 60));
    // Halfway, light is mixed half and half.
    let t = Transfer::Srgb;
    for c in 0..3 {
        let light = t.decode(out.0.at(75, 60)[c]);
        let half = 0.5 * (t.decode(frame.0.at(75, 60)[c]) + t.decode(open.0.at(75, 60)[c]));
        assert!((light - half).abs() < 1e-5, "{light} {half}");
    }
    // The layer for a compositing program says the same.
    let apart = distorted_layer(&held, &layer, &camera(), &all).unwrap();
    assert!((apart.holdout.at(75, 60) - 0.5).abs() < 1e-6 && apart.color.0.at(60, 60)[3] == 0.0);
    let small = Plane::filled(3, 3, 0.0);
    let e = composite(&Plate { holdout: Some(&small), ..held }, &layer, &camera(), &all).unwrap_err();
    assert!(e.to_string().contains("matte"), "{e}");
}

/// Std of the red channel over the middle of the square, around its value `clean` without noise.
fn noise_std(frame: impl Fn(u64) -> Encoded, layer: &VirtualLayer, model: &CameraModel, clean: f32) -> f32 {
    let (mut sum, mut count) = (0.0, 0.0);
    for number in 0..6 {
        let frame = frame(number);
        let plate = Plate { number, ..plate(&frame) };
        let out = composite(&plate, layer, model, &CompositeOptions::default()).unwrap();
        for y in 46..74 {
            for x in 56..94 {
                sum += (out.0.at(x, y)[0] - clean).powi(2);
                count += 1.0;
            }
        }
    }
    (sum / count as f32).sqrt()
}

/// The largest difference of two frames.
fn worst(a: &Encoded, b: &Encoded) -> f32 {
    let differences = a.0.data().iter().flatten().zip(b.0.data().iter().flatten());
    differences.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
}

#[test]
fn onto_a_sharpened_frame_it_is_the_sharpened_composite_onto_the_unsharpened_one() {
    let plain = camera();
    let sharpening = SharpeningModel::given(0.9, 1.2);
    let mut sharpening_camera = camera();
    sharpening_camera.sharpening = Estimate::Known(sharpening);
    let sharpened = |image: &Encoded| Encoded(sharpening::sharpen(&image.0, &sharpening));
    let frame = sharpened(&background());
    // Two layers in focus, and one blurred by 3 px of defocus and 6 px of motion.
    for (alpha, depth, flow) in [(1.0, 1.0, [0.0; 2]), (0.6, 1.0, [0.0; 2]), (0.8, 2.0, [12.0, 0.0])] {
        for blur_space in [BlurSpace::Linear, BlurSpace::Encoded] {
            let layer = square(GREY, alpha, depth, flow);
            let over = |frame: &Encoded, model: &CameraModel| {
                let mut model = model.clone();
                model.blur_space = blur_space;
                composite(&plate(frame), &layer, &model, &CompositeOptions::default()).unwrap()
            };
            let want = sharpened(&over(&background(), &plain));
            let out = over(&frame, &sharpening_camera);
            assert!(worst(&out, &want) < 1e-3, "alpha {alpha}: {}", worst(&out, &want));
            // Negative control: without the model's sharpening, the error is larger.
            assert!(worst(&over(&frame, &plain), &want) > 5.0 * worst(&out, &want));
            for y in 0..H {
                for x in 0..W {
                    if !(50 - 26..100 + 26).contains(&x) || !(40 - 23..80 + 23).contains(&y) {
                        assert_eq!(out.0.at(x, y), frame.0.at(x, y), "{x} {y}");
                    }
                }
            }
        }
    }
    let layer = square(GREY, 1.0, 1.0, [0.0; 2]);
    let naive = CompositeOptions { naive: true, ..CompositeOptions::default() };
    let [with, without] =
        [&sharpening_camera, &plain].map(|m| composite(&plate(&frame), &layer, m, &naive).unwrap());
    assert!(with == without);
}

#[test]
fn noise_ends_at_the_model_s_variance_at_any_alpha() {
    noise_ends_at_the_model_s_variance(with_noise(camera(), 0.04, 0.01, 1.0));
}

#[test]
fn sharpening_leaves_the_noise_as_it_is() {
    let mut model = with_noise(camera(), 0.04, 0.01, 1.0);
    model.sharpening = Estimate::Known(SharpeningModel::given(1.0, 1.0));
    noise_ends_at_the_model_s_variance(model);
}

fn noise_ends_at_the_model_s_variance(model: CameraModel) {
    let t = Transfer::Srgb;
    // A frame of 0.6 with the camera's own noise.
    let noisy = |number: u64| {
        let n = noise::noise(model.noise.known().unwrap(), &Raster::filled(W, H, [0.6; 3]), 99, number);
        Encoded(n.map(|n| n.map(|v| v + 0.6)))
    };
    for alpha in [0.1, 0.3, 0.5, 0.8, 1.0] {
        let clean = t.encode(alpha * GREY[0] + (1.0 - alpha) * t.decode(0.6));
        let layer = square(GREY, alpha, 1.0, [0.0; 2]);
        let (got, want) = (noise_std(noisy, &layer, &model, clean), 0.04 * clean + 0.01);
        assert!((got / want - 1.0).abs() < 0.05, "alpha {alpha}: {got}, want {want}");
        // Negative control: on a frame without noise of its own, the result has too little noise.
        let quiet = noise_std(|_| Encoded(Raster::filled(W, H, [0.6; 3])), &layer, &model, clean);
        assert!(alpha > 0.9 || quiet < 0.97 * want, "alpha {alpha}: {quiet}, want {want}");
    }
}

#[test]
fn nothing_is_noisy_or_brighter_past_the_clip() {
    let model = with_noise(camera(), 0.04, 0.01, 0.9);
    let frame = background();
    let bright = composite(
        &plate(&frame),
        &square([3.0; 3], 1.0, 1.0, [0.0; 2]),
        &model,
        &CompositeOptions::default(),
    );
    assert_eq!(bright.unwrap().0.at(70, 60), [0.9; 3]);
    let below = composite(
        &plate(&frame),
        &square([0.75; 3], 1.0, 1.0, [0.0; 2]),
        &model,
        &CompositeOptions::default(),
    );
    let below = below.unwrap();
    assert!(below.0.crop(55, 45, 40, 30).data().iter().flatten().all(|&v| (0.7..=0.9).contains(&v)));
    assert_ne!(below.0.at(70, 60), below.0.at(71, 60));
}

#[test]
fn the_layer_over_the_frame_is_the_composite() {
    let mut model = with_noise(camera(), 0.04, 0.01, 1.0);
    let frame = background();
    let real = Plane::from_fn(W, H, |x, _| if x < 65 { 2.0 } else { 0.1 });
    let layer = square(GREY, 0.8, 1.0, [9.0, 3.0]);
    for sharpening in [None, Some(SharpeningModel::given(0.6, 1.0))] {
        if let Some(mask) = sharpening {
            model.sharpening = Estimate::Known(mask);
        }
        for real in [None, Some(&real)] {
            let plate = Plate { inverse_depth: real, ..plate(&frame) };
            let options = CompositeOptions::default();
            let whole = composite(&plate, &layer, &model, &options).unwrap();
            let apart = distorted_layer(&plate, &layer, &model, &options).unwrap();
            let over = |with_noise: f32| {
                Linear(Raster::from_fn(W, H, |x, y| {
                    let (l, n) = (apart.color.0.at(x, y), apart.noise.at(x, y));
                    let f = frame.0.at(x, y).map(|v| Transfer::Srgb.decode(v));
                    std::array::from_fn(|c| l[c] + (1.0 - l[3]) * f[c] + with_noise * n[c])
                }))
                .to_encoded(Transfer::Srgb)
            };
            let worst = |a: &Encoded| {
                let pairs = a.0.data().iter().flatten().zip(whole.0.data().iter().flatten());
                pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
            };
            assert!(worst(&over(1.0)) < 1e-4, "{}", worst(&over(1.0)));
            // Negative control: without its noise it is another picture.
            assert!(worst(&over(0.0)) > 0.01);
            let held_out = apart.holdout.data().iter().any(|v| *v < 0.5);
            assert_eq!(held_out, real.is_some());
            // Inverse depth and flow are there wherever the object is seen, and nowhere else.
            let ends = |x: usize, y: usize| (apart.color.0.at(x, y)[3] > 0.0, apart.inverse_depth.at(x, y));
            assert!((0..H).flat_map(|y| (0..W).map(move |x| (x, y))).all(|(x, y)| {
                let (seen, d) = ends(x, y);
                seen == d.is_finite() && seen == (apart.flow.at(x, y) != [0.0; 2])
            }));
        }
    }
}

#[test]
fn scene_linear_light_above_white_is_kept_if_asked_for() {
    let model = with_noise(camera(), 0.0, 0.001, 0.9);
    let frame = Encoded(Raster::filled(W, H, [1.8; 3]));
    let options = CompositeOptions { unclipped: true, ..CompositeOptions::default() };
    let made = |layer| composite(&plate(&frame), &layer, &model, &options).unwrap();
    let opaque = made(square([3.0; 3], 1.0, 1.0, [0.0; 2])).0.at(70, 60);
    let half = made(square([0.0; 3], 0.5, 1.0, [0.0; 2])).0.at(70, 60);
    let t = Transfer::Srgb;
    assert!((opaque[0] - t.encode(3.0)).abs() < 0.02, "{opaque:?}");
    assert!((half[0] - t.encode(0.5 * t.decode(1.8))).abs() < 0.02, "{half:?}");
}

/// A layer, cut out from (x, y) on.
fn cut(layer: &VirtualLayer, [x, y, w, h]: [usize; 4]) -> VirtualLayer {
    VirtualLayer {
        color: Premultiplied(layer.color.0.crop(x, y, w, h)),
        inverse_depth: layer.inverse_depth.as_ref().map(|d| d.crop(x, y, w, h)),
        flow: layer.flow.as_ref().map(|f| f.crop(x, y, w, h)),
    }
}

#[test]
fn a_layer_with_overscan_gives_in_the_frame_what_a_larger_picture_has_there() {
    // The frame begins in the middle of the square, which is striped, blurred by 3 px and moves by 4 px while the shutter is open.
    let overscan = Overscan { left: 75, top: 30, right: 9, bottom: 5 };
    let (w, h) = overscan.frame_size((W, H));
    let [x, y] = [overscan.left, overscan.top];
    let mut layer = square(GREY, 1.0, 2.0, [8.0, 5.0]);
    layer.color = Premultiplied(Raster::from_fn(W, H, |x, y| {
        let [r, g, b, a] = layer.color.0.at(x, y);
        let bright = if (x / 12 + y / 9) % 2 == 0 { 2.0 } else { 0.2 };
        [r * bright, g * bright, b, a]
    }));
    let whole_frame = background();
    let frame = Encoded(overscan.frame_of(&whole_frame.0));
    let large = camera();
    let mut small = large.clone();
    (small.capture.width, small.capture.height) = (w, h);
    let without_noise = CompositeOptions { no_noise: true, ..CompositeOptions::default() };
    for bokeh in
        [Bokeh::Gaussian, Bokeh::Disk, Bokeh::Polygon { blades: 5, roundness: 0.2, rotation_degrees: 20.0 }]
    {
        let options = CompositeOptions { bokeh: Some(bokeh), ..without_noise };
        let whole = composite(&plate(&whole_frame), &layer, &large, &options).unwrap();
        let whole = Encoded(overscan.frame_of(&whole.0));
        let with = Plate { overscan, ..plate(&frame) };
        let made = composite(&with, &layer, &small, &options).unwrap();
        assert!(worst(&made, &whole) < 2e-5, "{bokeh:?}: {}", worst(&made, &whole));
        // The layer apart has it all, and gives the same over the frame.
        let apart = distorted_layer(&with, &layer, &small, &options).unwrap();
        let large = distorted_layer(&plate(&whole_frame), &layer, &large, &options).unwrap();
        assert_eq!((apart.overscan, apart.color.0.size()), (overscan, (W, H)));
        assert_eq!(apart.color.0.map(|p| p[3]), large.color.0.map(|p| p[3]));
        let over = Linear(Raster::from_fn(w, h, |i, j| {
            let l = apart.color.0.at(i + x, j + y);
            let f = frame.0.at(i, j).map(|v| Transfer::Srgb.decode(v));
            std::array::from_fn(|c| l[c] + (1.0 - l[3]) * f[c])
        }));
        assert!(worst(&over.to_encoded(Transfer::Srgb), &whole) < 1e-4);
        // Negative control: without what lies beyond the frame the picture is another.
        let bare = composite(&plate(&frame), &cut(&layer, [x, y, w, h]), &small, &options).unwrap();
        assert!(worst(&bare, &whole) > 0.05, "bare, {bokeh:?}: {}", worst(&bare, &whole));
    }
    // With noise, both ways of making the frame still agree.
    let noisy = with_noise(small, 0.04, 0.01, 1.0);
    let with = Plate { overscan, ..plate(&frame) };
    let made = composite(&with, &layer, &noisy, &CompositeOptions::default()).unwrap();
    let apart = distorted_layer(&with, &layer, &noisy, &CompositeOptions::default()).unwrap();
    let over = Linear(Raster::from_fn(w, h, |i, j| {
        let (l, n) = (apart.color.0.at(i + x, j + y), apart.noise.at(i + x, j + y));
        let f = frame.0.at(i, j).map(|v| Transfer::Srgb.decode(v));
        std::array::from_fn(|c| l[c] + (1.0 - l[3]) * f[c] + n[c])
    }));
    assert!(worst(&over.to_encoded(Transfer::Srgb), &made) < 1e-4);
    let e = composite(&plate(&frame), &layer, &noisy, &without_noise).unwrap_err().to_string();
    assert!(e.contains("160 x 120") && e.contains("76 x 85"), "{e}");
}

#[test]
fn overscan_without_anything_in_it_changes_nothing() {
    // The cat's eye depends on the place in the frame, which is not that in the layer.
    let frame = background();
    let mut model = camera();
    if let Estimate::Known(lens) = &mut model.defocus {
        lens.bokeh = crate::model::Aperture { cats_eye: 1.0, ..Bokeh::Disk.into() };
    }
    let layer = square(GREY, 1.0, 2.0, [9.0, 3.0]);
    let overscan = Overscan { left: 33, top: 21, right: 2, bottom: 0 };
    let mut large = Raster::filled(W + 35, H + 21, [0.0; 4]);
    overscan.put_frame(&layer.color.0, &mut large);
    let around = VirtualLayer {
        color: Premultiplied(large),
        inverse_depth: layer.inverse_depth.as_ref().map(|d| overscan.continued(d)),
        flow: layer.flow.as_ref().map(|f| overscan.continued(f)),
    };
    let options = CompositeOptions::default();
    let plain = composite(&plate(&frame), &layer, &model, &options).unwrap();
    let same = composite(&Plate { overscan, ..plate(&frame) }, &around, &model, &options).unwrap();
    assert!(worst(&same, &plain) < 2e-5, "{}", worst(&same, &plain));
    // Negative control: at another place of the frame the cut is another.
    let mut uncut = model.clone();
    if let Estimate::Known(lens) = &mut uncut.defocus {
        lens.bokeh.cats_eye = 0.0;
    }
    let uncut = composite(&plate(&frame), &layer, &uncut, &options).unwrap();
    assert!(worst(&uncut, &plain) > 1e-3, "{}", worst(&uncut, &plain));
}

#[test]
fn what_does_not_fit_together_is_an_error_that_says_so() {
    let frame = background();
    let layer = square(GREY, 1.0, 1.0, [0.0; 2]);
    let fails = |plate: &Plate, layer: &VirtualLayer, model: &CameraModel, says: &str| {
        let e = composite(plate, layer, model, &CompositeOptions::default()).unwrap_err().to_string();
        assert!(e.contains(says), "{e}");
    };
    let small = Plane::filled(3, 3, 1.0);
    fails(
        &Plate { inverse_depth: Some(&small), ..plate(&frame) },
        &layer,
        &camera(),
        "the real depth has 3 x 3",
    );
    let other = VirtualLayer { flow: Some(Flow::filled(2, 2, [0.0; 2])), ..layer.clone() };
    fails(&plate(&frame), &other, &camera(), "flow has 2 x 2");
    fails(&plate(&frame), &layer, &camera().scaled_to(2 * W, 2 * H), "320");
    let mut relative = camera();
    if let Estimate::Known(d) = &mut relative.defocus {
        d.depth_kind = DepthKind::Relative;
    }
    fails(&plate(&frame), &layer, &relative, "relative inverse depth");
}

#[test]
fn broken_values_do_not_spread() {
    let frame = background();
    let mut layer = square(GREY, 1.0, 2.0, [9.0, 3.0]);
    layer.color.0.row_mut(60)[70] = [f32::NAN, 0.0, f32::INFINITY, 1.0];
    if let (Some(d), Some(f)) = (&mut layer.inverse_depth, &mut layer.flow) {
        d.row_mut(61)[71] = f32::INFINITY;
        f.row_mut(62)[72] = [f32::NAN, f32::INFINITY];
    }
    let real = Plane::from_fn(W, H, |x, y| [f32::NAN, f32::INFINITY, -1.0, 0.0, 5.0][(x + y) % 5]);
    let flow = Flow::filled(W, H, [f32::NAN, 1.0]);
    let with = Linear(Raster::from_fn(W, H, |x, y| [if (x + y) % 7 == 0 { f32::NAN } else { 0.3 }; 3]));
    let without = Linear(Raster::filled(W, H, [0.4; 3]));
    let model = with_noise(camera(), 0.04, 0.01, 1.0);
    let plate = Plate {
        inverse_depth: Some(&real),
        flow: Some(&flow),
        with_and_without: Some((&with, &without)),
        ..plate(&frame)
    };
    let out = composite(&plate, &layer, &model, &CompositeOptions::default()).unwrap();
    assert!(out.0.data().iter().flatten().all(|v| (0.0..=1.0).contains(v)));
}
