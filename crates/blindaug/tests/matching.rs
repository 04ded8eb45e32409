//! Footage of one camera, matched to another, has the blur and the noise of the other camera, and never less than it had.

use blindaug::matching::Matching;
use blindaug::model::{
    BlurSpace, Capture, DefocusModel, Estimate, ExposureFraction, MotionBlurModel, NOISE_LEVELS, NoiseLevel,
    NoiseModel,
};
use blindaug::synth::{defocus::Bokeh, noise};
use blindaug::{CameraModel, Encoded, Flow, Plane, Raster, Transfer, filter, pyramid};

const W: usize = 256;
const H: usize = 192;

/// A camera whose noise is white, with this std at black and at white.
fn camera(exposure: f32, sigma_at_infinity: f32, std: [f32; 2]) -> CameraModel {
    let mut model = CameraModel::unknown(
        Capture { width: W, height: H, fps: None, frames_used: 1, pixel_aspect: 1.0 },
        "not needed",
    );
    model.blur_space = BlurSpace::Encoded;
    model.motion_blur = Estimate::Known(MotionBlurModel::given(ExposureFraction(exposure)));
    model.defocus = Estimate::Known(DefocusModel::given_lens(sigma_at_infinity, 1.0));
    let levels = noise::white_band_std()
        .map(|s| NoiseLevel { intercept: [s * std[0]; 3], slope: [s * (std[1] - std[0]); 3] });
    model.noise = Estimate::Known(NoiseModel::given(levels, 1.0));
    model
}

fn matched(
    frame: &Encoded,
    [from, to]: [&CameraModel; 2],
    depth: f32,
    flow: [f32; 2],
    seed: Option<u64>,
) -> Encoded {
    let matching = Matching::new(from, to, W, Bokeh::Gaussian).unwrap();
    let (depth, flow) = (Plane::filled(W, H, depth), Flow::filled(W, H, flow));
    matching.apply(frame, 7, Some(&depth), Some(&flow), seed).unwrap()
}

fn noisy(content: &Raster<[f32; 3]>, model: &CameraModel) -> Encoded {
    let noise = noise::noise(model.noise.known().unwrap(), content, 99, 1);
    Encoded(Raster::from_fn(W, H, |x, y| {
        let (v, n) = (content.at(x, y), noise.at(x, y));
        std::array::from_fn(|c| v[c] + n[c])
    }))
}

/// The std of each level of the difference of two pictures, over the std of white noise of std 1.
fn stds(a: &Raster<[f32; 3]>, b: &Raster<[f32; 3]>) -> [f32; NOISE_LEVELS] {
    let difference = Raster::from_fn(W, H, |x, y| [a.at(x, y)[1] - b.at(x, y)[1]; 3]);
    let (bands, _) = pyramid::laplacian(&difference, NOISE_LEVELS);
    std::array::from_fn(|l| {
        let (w, h) = bands[l].size();
        let inside = (h / 8..h * 7 / 8).flat_map(|y| (w / 8..w * 7 / 8).map(move |x| (x, y)));
        let squares: Vec<f32> = inside.map(|(x, y)| bands[l].at(x, y)[1].powi(2)).collect();
        (squares.iter().sum::<f32>() / squares.len() as f32).sqrt() / noise::white_band_std()[l]
    })
}

#[test]
fn noise_is_lifted_to_that_of_the_other_camera_also_where_blur_has_weakened_it() {
    let content = Raster::filled(W, H, [0.5; 3]);
    let to = camera(0.6, 2.0, [0.02, 0.04]);
    // The std is 0.03 at 0.5. The blur of the first case is none, of the second a streak, of the third a lens's.
    for (from, depth, flow) in [
        (camera(0.6, 2.0, [0.02, 0.02]), 1.0, [9.0, 0.0]),
        (camera(0.2, 2.0, [0.02, 0.02]), 1.0, [9.0, 4.0]),
        (camera(0.6, 0.5, [0.028, 0.028]), 0.0, [0.0; 2]),
    ] {
        let frame = noisy(&content, &from);
        let out = matched(&frame, [&from, &to], depth, flow, Some(3));
        let found = stds(&out.0, &content);
        for (level, std) in found.into_iter().enumerate() {
            // What is added in one level leaks into the next, and the coarsest level has few pixels.
            let tolerance = [0.05, 0.05, 0.15, 0.15][level];
            assert!((std / 0.03 - 1.0).abs() < tolerance, "{level}: {std}, all {found:?}");
        }
        // Negative control: before, it had less.
        assert!(stds(&frame.0, &content)[0] < 0.029);
    }
}

#[test]
fn nothing_is_ever_taken_away() {
    let content = Raster::from_fn(W, H, |x, y| [0.3 + 0.2 * ((x / 3 + y / 5) % 2) as f32; 3]);
    let (more, less) = (camera(0.8, 3.0, [0.03, 0.05]), camera(0.3, 1.0, [0.01, 0.02]));
    let frame = noisy(&content, &more);
    assert!(matched(&frame, [&more, &less], 0.0, [9.0, 3.0], Some(3)) == frame);
    assert!(matched(&frame, [&more, &more], 0.0, [9.0, 3.0], Some(3)) == frame);
    // Negative control: the other way round, much is added.
    assert!(matched(&frame, [&less, &more], 0.0, [9.0, 3.0], Some(3)) != frame);
    let matching = Matching::new(&more, &less, W, Bokeh::Gaussian).unwrap();
    let depth = Plane::from_fn(W, H, |x, _| if x < W / 2 { 0.0 } else { 1.0 });
    let left = matching.too_blurred(&depth);
    assert!((left.share - 0.5).abs() < 0.01 && (left.sigma_px - 8f32.sqrt()).abs() < 1e-3, "{left:?}");
    assert_eq!(Matching::new(&less, &more, W, Bokeh::Gaussian).unwrap().too_blurred(&depth).share, 0.0);
}

#[test]
fn the_blur_that_is_added_makes_that_of_the_other_camera() {
    let sharp = Raster::from_fn(W, H, |x, y| {
        [0.5 + 0.2 * ((x * 37 + y * 91) % 17) as f32 / 17.0 + 0.2 * ((x / 9 + y / 7) % 2) as f32; 3]
    });
    let (from, to) = (camera(0.5, 1.0, [0.0; 2]), camera(0.5, 2.5, [0.0; 2]));
    let [by_from, by_to] = [1.0, 2.5].map(|sigma| filter::gaussian_blur(&sharp, sigma));
    let out = matched(&Encoded(by_from.clone()), [&from, &to], 0.0, [0.0; 2], None);
    let worst = |a: &Raster<[f32; 3]>, b: &Raster<[f32; 3]>| {
        (10..H - 10)
            .flat_map(|y| (10..W - 10).map(move |x| (x, y)))
            .map(|(x, y)| (a.at(x, y)[0] - b.at(x, y)[0]).abs())
            .fold(0.0, f32::max)
    };
    assert!(worst(&out.0, &by_to) < 2e-3 && worst(&by_from, &by_to) > 0.05, "{}", worst(&out.0, &by_to));
    // What is in focus for both, and what does not move, stays.
    assert!(matched(&Encoded(by_from.clone()), [&from, &to], 1.0, [0.0; 2], None).0 == by_from);
}

#[test]
fn depth_of_another_size_and_models_over_other_encodings_are_refused() {
    let (from, mut to) = (camera(0.5, 0.0, [0.0; 2]), camera(0.5, 0.0, [0.01, 0.01]));
    let frame = Encoded(Raster::filled(W, H, [0.5; 3]));
    let matching = Matching::new(&from, &to, W, Bokeh::Gaussian).unwrap();
    let small = Plane::filled(W / 2, H, 1.0);
    let said = matching.apply(&frame, 1, Some(&small), None, Some(0)).unwrap_err().to_string();
    assert!(said.contains("bring both to one size"), "{said}");
    to.transfer = Transfer::SLog3;
    let said = Matching::new(&from, &to, W, Bokeh::Gaussian).err().expect("an error").to_string();
    assert!(said.contains("one encoding"), "{said}");
}
