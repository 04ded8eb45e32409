//! Tests of optical flow on textures that are warped in a known way.

use blindaug::{
    Flow, Plane, Raster,
    analysis::flow::{FlowEstimator, FlowPair, flow, flow_with_occlusion, motion_at_frame},
};

/// A uniform number in [0, 1) as a hash of two integers.
fn random(a: u64, b: u64) -> f64 {
    let mut z = a.wrapping_mul(0x9e37_79b9_7f4a_7c15).wrapping_add(b.wrapping_mul(0xbf58_476d_1ce4_e5b9));
    z = (z ^ (z >> 30)).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
}

/// A texture in about [0, 1] that is known at every point: waves from 5 to 150 px long, the long ones stronger.
struct Texture(Vec<[f64; 4]>);

impl Texture {
    fn new(seed: u64) -> Self {
        Self(
            (0..40)
                .map(|i| {
                    let length = 5.0 * 30f64.powf(random(seed, 3 * i));
                    let angle = std::f64::consts::TAU * random(seed, 3 * i + 1);
                    let k = std::f64::consts::TAU / length;
                    let phase = std::f64::consts::TAU * random(seed, 3 * i + 2);
                    [k * angle.cos(), k * angle.sin(), phase, 0.012 * length.powf(0.4)]
                })
                .collect(),
        )
    }

    fn at(&self, [x, y]: [f64; 2]) -> f32 {
        0.5 + self.0.iter().map(|[kx, ky, phase, a]| a * (kx * x + ky * y + phase).sin()).sum::<f64>() as f32
    }
}

/// The image `p` with added normal noise (Box & Muller) of std `std`.
fn noisy(p: &Plane, std: f32, seed: u64) -> Plane {
    let w = p.width();
    Plane::from_fn(w, p.height(), |x, y| {
        let i = (y * w + x) as u64;
        let radius = (-2.0 * (1.0 - random(seed, 2 * i)).ln()).sqrt();
        p.at(x, y) + std * (radius * (std::f64::consts::TAU * random(seed, 2 * i + 1)).cos()) as f32
    })
}

/// Two images of a texture that moves by x -> A x + t, and the flow between them.
fn affine(size: (usize, usize), a: [[f64; 2]; 2], t: [f64; 2], noise: f32) -> (Plane, Plane, Flow) {
    let texture = Texture::new(7);
    let centre = [size.0 as f64 / 2.0, size.1 as f64 / 2.0];
    let det = a[0][0] * a[1][1] - a[0][1] * a[1][0];
    let from = Plane::from_fn(size.0, size.1, |x, y| texture.at([x as f64, y as f64]));
    let to = Plane::from_fn(size.0, size.1, |x, y| {
        let (x, y) = (x as f64 - centre[0] - t[0], y as f64 - centre[1] - t[1]);
        texture.at([
            (a[1][1] * x - a[0][1] * y) / det + centre[0],
            (a[0][0] * y - a[1][0] * x) / det + centre[1],
        ])
    });
    let truth = Flow::from_fn(size.0, size.1, |x, y| {
        let (x, y) = (x as f64 - centre[0], y as f64 - centre[1]);
        [0, 1].map(|i| (a[i][0] * x + a[i][1] * y + t[i] - [x, y][i]) as f32)
    });
    (noisy(&from, noise, 1), noisy(&to, noise, 2), truth)
}

/// The mean endpoint error, px, of the pixels whose true match is at least `margin` px inside the frame.
fn endpoint_error(flow: &Flow, truth: &Flow, margin: f32) -> f32 {
    assert_eq!(flow.size(), truth.size());
    let (w, h) = flow.size();
    let (mut sum, mut count) = (0.0, 0);
    for y in 0..h {
        for x in 0..w {
            let ([u, v], [tu, tv]) = (flow.at(x, y), truth.at(x, y));
            let (ex, ey) = (x as f32 + tu, y as f32 + tv);
            if ex >= margin && ey >= margin && ex <= w as f32 - 1.0 - margin && ey <= h as f32 - 1.0 - margin
            {
                sum += (u - tu).hypot(v - tv);
                count += 1;
            }
        }
    }
    assert!(count > w * h / 4, "only {count} pixels are seen twice");
    sum / count as f32
}

const IDENTITY: [[f64; 2]; 2] = [[1.0, 0.0], [0.0, 1.0]];

#[test]
fn an_image_has_no_flow_to_itself() {
    let (a, _, _) = affine((120, 90), IDENTITY, [0.0; 2], 0.05);
    let pair = flow_with_occlusion(&a, &a).unwrap();
    assert!(pair.forward.data().iter().flatten().all(|v| v.abs() < 0.01));
    assert_eq!(pair.confirmed(), 1.0);
    assert!(pair.residual.data().iter().all(|r| r.abs() < 0.01));
}

#[test]
fn translation_below_a_pixel() {
    for (noise, bound) in [(0.0, 0.03), (0.05, 0.15)] {
        let (a, b, truth) = affine((160, 120), IDENTITY, [0.37, -0.61], noise);
        let error = endpoint_error(&flow(&a, &b).unwrap(), &truth, 2.0);
        assert!(error < bound, "noise {noise}: {error} px");
    }
}

#[test]
fn translation_by_a_fifth_of_the_width() {
    for t in [[40.0, 0.0], [-31.3, 22.7]] {
        let (a, b, truth) = affine((200, 160), IDENTITY, t, 0.03);
        let error = endpoint_error(&flow(&a, &b).unwrap(), &truth, 4.0);
        assert!(error < 0.2, "{t:?}: {error} px");
    }
}

#[test]
fn rotation_and_zoom() {
    let (sin, cos) = 0.06f64.sin_cos();
    let a = [[1.04 * cos, -1.04 * sin], [1.04 * sin, 1.04 * cos]];
    let (a, b, truth) = affine((200, 150), a, [3.0, -2.0], 0.02);
    let error = endpoint_error(&flow(&a, &b).unwrap(), &truth, 4.0);
    assert!(error < 0.12, "{error} px");
}

#[test]
fn light_that_changes_is_no_motion() {
    let size = (192, 144);
    let (from, to, truth) = affine(size, [[1.0, 0.0], [0.0, 1.0]], [2.3, -1.6], 0.01);
    let error = |light: &(dyn Fn(f32) -> f32 + Sync), down: bool| {
        let lit = Plane::from_fn(size.0, size.1, |x, y| {
            let along = if down { y as f32 / size.1 as f32 } else { x as f32 / size.0 as f32 };
            ((to.at(x, y) + 0.055) * light(along).powf(1.0 / 2.4) - 0.055).min(1.0)
        });
        endpoint_error(&flow(&from, &lit).unwrap(), &truth, 8.0)
    };
    let flicker = |y: f32| 1.0 + 0.25 * (9.0 * y).sin();
    let steady = error(&|_| 1.0, true);
    assert!(error(&|_| 1.15, true) < 1.3 * steady, "{} {steady}", error(&|_| 1.15, true));
    assert!(error(&flicker, true) < 1.5 * steady, "{} {steady}", error(&flicker, true));
    // Negative control: a flicker from left to right, which no rolling shutter causes, is not undone.
    assert!(error(&flicker, false) > 2.0 * steady, "{} {steady}", error(&flicker, false));
}

#[test]
fn endpoint_error_sees_a_wrong_flow() {
    let (_, _, truth) = affine((60, 50), IDENTITY, [2.0, 1.0], 0.0);
    assert_eq!(endpoint_error(&truth, &truth, 2.0), 0.0);
    assert!(endpoint_error(&truth.map(|[u, v]| [-u, -v]), &truth, 2.0) > 4.0);
    assert!(endpoint_error(&truth.map(|[u, v]| [v, u]), &truth, 2.0) > 1.0);
}

/// Two images of a disk of one texture that moves by `disk` in front of another texture that moves by (-2, 1), the flow, and whether each
/// pixel is hidden in the second image.
fn two_motions(disk: [f64; 2], noise: f32) -> (Plane, Plane, Flow, Raster<bool>) {
    let (w, h, radius) = (200, 160, 34.0);
    let (front, back) = (Texture::new(3), Texture::new(4));
    let behind = [-2.0, 1.0];
    let in_disk = |p: [f64; 2], t: f64| (p[0] - 95.0 - t * disk[0]).hypot(p[1] - 80.0 - t * disk[1]) < radius;
    let frame = |t: f64| {
        Plane::from_fn(w, h, |x, y| {
            let p = [x as f64, y as f64];
            let (texture, motion) = if in_disk(p, t) { (&front, disk) } else { (&back, behind) };
            texture.at([p[0] - t * motion[0], p[1] - t * motion[1]])
        })
    };
    let truth = Flow::from_fn(w, h, |x, y| {
        (if in_disk([x as f64, y as f64], 0.0) { disk } else { behind }).map(|v| v as f32)
    });
    let hidden = Raster::from_fn(w, h, |x, y| {
        let p = [x as f64, y as f64];
        !in_disk(p, 0.0) && in_disk([p[0] + behind[0], p[1] + behind[1]], 1.0)
    });
    (noisy(&frame(0.0), noise, 1), noisy(&frame(1.0), noise, 2), truth, hidden)
}

#[test]
fn two_motions_and_what_the_nearer_one_hides() {
    for noise in [0.0, 0.03] {
        let (a, b, truth, hidden) = two_motions([7.0, -5.0], noise);
        let FlowPair { forward, occluded, .. } = flow_with_occlusion(&a, &b).unwrap();
        let mut errors: Vec<f32> = forward
            .data()
            .iter()
            .zip(truth.data())
            .zip(hidden.data())
            .filter(|(_, hidden)| !**hidden)
            .map(|((f, t), _)| (f[0] - t[0]).hypot(f[1] - t[1]))
            .collect();
        errors.sort_by(f32::total_cmp);
        let share = |px: f32| errors.partition_point(|&e| e <= px) as f32 / errors.len() as f32;
        assert!(errors[errors.len() / 2] < 0.1, "median {}", errors[errors.len() / 2]);
        assert!(share(1.0) > 0.93, "{} within a pixel", share(1.0));
        let count = |f: &dyn Fn(bool, bool) -> bool| {
            occluded.data().iter().zip(hidden.data()).filter(|(o, h)| f(**o, **h)).count() as f32
        };
        let (found, hidden, flagged) = (count(&|o, h| o && h), count(&|_, h| h), count(&|o, _| o));
        assert!(found > 0.8 * hidden, "{found} of {hidden} hidden pixels are flagged");
        assert!(flagged < 0.1 * (200 * 160) as f32, "{flagged} pixels are flagged");
    }
}

#[test]
fn a_cut_is_not_confirmed() {
    let (a, b, _) = affine((160, 120), IDENTITY, [3.0, 1.0], 0.02);
    let other = Texture::new(99);
    let c = Plane::from_fn(160, 120, |x, y| other.at([x as f64, y as f64]));
    let (same, cut) = (flow_with_occlusion(&a, &b).unwrap(), flow_with_occlusion(&a, &c).unwrap());
    assert!(same.confirmed() > 0.9, "{}", same.confirmed());
    assert!(cut.confirmed() < 0.5, "{}", cut.confirmed());
    let median = |p: &Plane| {
        let mut v: Vec<f32> = p.data().iter().copied().filter(|v| v.is_finite()).collect();
        v.sort_by(f32::total_cmp);
        v[v.len() / 2]
    };
    assert!(median(&cut.residual) > 2.0 * median(&same.residual));
}

#[test]
fn any_size_and_any_value_gives_a_finite_flow() {
    for (w, h) in [(1, 1), (1, 9), (2, 2), (3, 500), (500, 3), (8, 8), (9, 23), (25, 24), (67, 41)] {
        let odd = [0.0, 1.0, f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e30, -1e30, 0.5];
        let texture = Plane::from_fn(w, h, |x, y| random(x as u64, y as u64) as f32);
        let broken = Plane::from_fn(w, h, |x, y| odd[(x * 5 + y * 3) % odd.len()]);
        let flat = Plane::filled(w, h, 0.4);
        for (a, b) in [(&texture, &broken), (&broken, &texture), (&flat, &flat), (&texture, &flat)] {
            let pair = flow_with_occlusion(a, b).unwrap();
            for f in [&pair.forward, &pair.backward] {
                assert_eq!(f.size(), (w, h));
                assert!(f.data().iter().flatten().all(|v| v.is_finite()), "{w} x {h}");
            }
        }
        assert!(flow(&flat, &flat).unwrap().data().iter().flatten().all(|v| v.abs() < 1e-4));
    }
}

#[test]
fn a_few_pixels_that_are_not_numbers_do_no_harm_elsewhere() {
    let (mut a, b, truth) = affine((160, 120), IDENTITY, [2.4, 1.3], 0.02);
    for i in 0..20 {
        a.data_mut()[37 + 953 * i] = f32::NAN;
    }
    let error = endpoint_error(&flow(&a, &b).unwrap(), &truth, 2.0);
    assert!(error < 0.25, "{error} px");
}

#[test]
fn sizes_that_do_not_fit_are_refused() {
    let (a, b) = (Plane::filled(20, 10, 0.0), Plane::filled(10, 20, 0.0));
    let message = flow(&a, &b).unwrap_err().to_string();
    assert!(message.contains("20 x 10") && message.contains("10 x 20"), "{message}");
    assert!(flow_with_occlusion(&a, &b).is_err());
    for (w, h) in [(0, 0), (0, 4), (4, 0)] {
        let none = Plane::filled(w, h, 0.0);
        assert!(flow(&none, &none).is_err() && flow_with_occlusion(&none, &none).is_err());
    }
}

#[cfg(feature = "threads")]
#[test]
fn the_number_of_threads_does_not_matter() {
    let (a, b, _) = affine((203, 151), IDENTITY, [5.4, 1.3], 0.02);
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| flow(&a, &b).unwrap())
    };
    assert!(with(1) == with(3));
}

#[test]
fn an_estimator_that_is_used_again_gives_the_same() {
    let mut estimator = FlowEstimator::new();
    let (a, b, _) = affine((203, 151), IDENTITY, [5.4, 1.3], 0.02);
    let (c, d, _) = affine((90, 120), IDENTITY, [-2.0, 3.0], 0.02);
    for (a, b) in [(&a, &b), (&c, &d), (&a, &b), (&b, &a)] {
        assert!(estimator.flow(a, b).unwrap() == flow(a, b).unwrap());
    }
    assert!(estimator.flow(&a, &c).is_err());
    let (again, once) =
        (estimator.flow_with_occlusion(&c, &d).unwrap(), flow_with_occlusion(&c, &d).unwrap());
    assert!(again.backward == once.backward && again.occluded == once.occluded);
}

/// The camera's zoom speeds up: distances to the centre grow by the factor exp(s(t)) from time 0 to t.
#[test]
fn motion_at_a_frame_is_between_the_flows_to_it_and_from_it() {
    const N: usize = 120;
    let s = |t: f32| 0.05 * t + 0.02 * t * t;
    let from_centre = |x: usize, y: usize| [x as f32 - 60.0, y as f32 - 60.0];
    let way = |from: f32, to: f32| {
        let gain = (s(to) - s(from)).exp() - 1.0;
        Flow::from_fn(N, N, |x, y| from_centre(x, y).map(|v| gain * v))
    };
    let (to_next, mut from_previous) = (way(0.0, 1.0), way(-1.0, 0.0));
    from_previous.row_mut(30)[30] = [f32::NAN; 2];
    let motion = motion_at_frame(&to_next, &from_previous);
    let gain = s(0.5).exp() - s(-0.5).exp();
    for (x, y) in [(60, 60), (10, 100), (119, 0), (90, 65)] {
        let truth = from_centre(x, y).map(|v| gain * v);
        let off = |f: [f32; 2]| (f[0] - truth[0]).hypot(f[1] - truth[1]);
        assert!(off(motion.at(x, y)) < 0.02 * (1.0 + truth[0].hypot(truth[1])), "{:?}", motion.at(x, y));
        assert!(off(to_next.at(x, y)) >= 0.2 * truth[0].hypot(truth[1]), "{:?}", to_next.at(x, y));
    }
    // The pixel (29, 29) comes from (30, 30), whose flow is unknown, so the flow to the next frame counts alone.
    assert_eq!(motion.at(29, 29), to_next.at(29, 29));
    // In a zoom out, the pixels at the edge were not in view before.
    let shrinking = way(0.0, -1.0);
    let at_the_edge = motion_at_frame(&shrinking, &shrinking);
    assert_eq!(at_the_edge.at(0, 0), shrinking.at(0, 0));
    let unknown = motion_at_frame(&to_next.map(|_| [f32::NAN; 2]), &from_previous);
    assert!(unknown.data().iter().flatten().all(|v| v.is_nan()));
}
