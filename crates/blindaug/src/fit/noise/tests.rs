use super::choose::{LOWER_HALF, noise_share};
use super::collect::{Residual, UNUSABLE, cubic_gain, flaw};
use super::mismatch::without_mismatch;
use super::*;
use crate::strips::{Strip, rows_in_turn, strips};
use crate::{Encoded, Flow, LUMA, Raster, filter, luma, pyramid};

/// White normal noise (a sum of twelve uniforms), made without the project's own synthesis.
pub fn white(width: usize, height: usize, seed: u64) -> Raster<[f32; 3]> {
    Raster::from_fn(width, height, |x, y| {
        let at = |c: u64| {
            (0..12).map(|k| crate::fit::uniform(seed * 36 + 12 * c + k, (y * width + x) as u64)).sum::<f32>()
                - 6.0
        };
        [at(0), at(1), at(2)]
    })
}

fn noisy(width: usize, height: usize, seed: u64, sigma: f32) -> Encoded {
    let n = white(width, height, seed);
    Encoded(Raster::from_fn(width, height, |x, y| {
        let base = 0.2 + 0.5 * x as f32 / width as f32;
        n.at(x, y).map(|n| base + sigma * n)
    }))
}

/// The largest relative error over levels, luminances and channels against white noise of this std.
fn worst(e: &NoiseEvidence, sigma: f32) -> f32 {
    let fit = e.fit();
    let model = fit.model.known().expect("there is evidence");
    let mut worst = 0.0f32;
    for (level, white) in model.lines().levels.iter().zip(white_band_std()) {
        for y in [0.25, 0.45, 0.65] {
            worst = level.sigma(y).iter().map(|s| (s / (sigma * white) - 1.0).abs()).fold(worst, f32::max);
        }
    }
    worst
}

#[test]
fn strips_give_the_variances_of_the_whole_frame() {
    let size @ (w, h) = (150, 717);
    let frame = noisy(w, h, 3, 0.05);
    let values = |x, y| {
        let p = frame.0.at(x, y);
        [p[0], p[1], p[2], luma(p)]
    };
    let flaws = |x, y| if x < 20 && y % 300 < 9 { UNUSABLE } else { flaw(frame.0.at(x, y), [1.0; 3]) };
    let fraction = Some(|x: usize, y: usize| [(x % 7) as f32 / 7.0, (y % 11) as f32 / 11.0]);
    let residual = Residual { values, colour: |x, y| frame.0.at(x, y), flaws, fraction, pure: false };
    for method in [Method::Temporal, Method::Spatial] {
        let found = |strips: &mut dyn Iterator<Item = Strip>| {
            let mut evidence = NoiseEvidence::new(method);
            strips.for_each(|s| evidence.add_blocks_of(&s, w, &residual));
            assert!(evidence.levels.iter().all(|l| l.len() > 20));
            format!("{:?}", evidence.levels)
        };
        let whole = found(&mut [Strip { rows: 0..h, around: 0..h }].into_iter());
        for rows in [32, 160, 704] {
            assert!(found(&mut strips(size, rows * w)) == whole, "{rows} rows");
        }
        // Negative control: strips without the rows around them give other variances.
        let alone = |s: Strip| Strip { around: s.rows.clone(), rows: s.rows };
        assert!(found(&mut strips(size, 160 * w).map(alone)) != whole);
    }
}

#[test]
fn turns_together_give_the_variances_of_the_whole_frame() {
    const TURNS: usize = 3;
    let (w, h) = (150, 700);
    let [frame, next] = [5, 6].map(|seed| noisy(w, h, seed, 0.05));
    let flow = Flow::filled(w, h, [0.3, -1.2]);
    let found = |add: &dyn Fn(&mut NoiseEvidence)| {
        let mut evidence = NoiseEvidence::new(Method::Temporal);
        add(&mut evidence);
        assert!(evidence.levels.iter().all(|l| l.len() > 20));
        format!("{:?}", evidence.levels)
    };
    let whole = found(&|e| e.add_pair(&frame, &next, &flow).unwrap());
    let in_turns = found(&|e| {
        for i in 0..TURNS {
            e.add_pair_in_turn(&frame, &next, &flow, (i, TURNS)).unwrap();
        }
    });
    assert!(in_turns == whole);
    // Negative control: parts without what is around them.
    let in_parts = found(&|e| {
        let parts = (0..TURNS).map(|i| rows_in_turn(i, TURNS, h));
        parts.for_each(|rows| e.add_pair_rows(&frame, &next, &flow, rows).unwrap());
    });
    assert!(in_parts != whole);
}

#[test]
fn lower_half_constants() {
    let mut e = NoiseEvidence::new(Method::Temporal);
    for seed in 0..4 {
        e.add_pair(
            &noisy(512, 512, seed, 0.02),
            &noisy(512, 512, seed + 10, 0.02),
            &Flow::filled(512, 512, [0.0; 2]),
        )
        .unwrap();
    }
    for (level, constant) in LOWER_HALF.into_iter().enumerate() {
        let mut v: Vec<f32> = e.levels[level].iter().map(|v| v.variance[3]).collect();
        v.sort_by(f32::total_cmp);
        let mean = |v: &[f32]| v.iter().sum::<f32>() / v.len() as f32;
        let ratio = mean(&v[..v.len() / 2]) / mean(&v);
        println!("{level} {ratio}");
        assert!((ratio - constant).abs() < 0.02, "level {level}: {ratio}");
    }
}

#[test]
fn a_still_pair_gives_the_noise_back() {
    let mut e = NoiseEvidence::new(Method::Temporal);
    for seed in 0..2 {
        let still = Flow::filled(512, 512, [0.0; 2]);
        e.add_pair(&noisy(512, 512, seed, 0.02), &noisy(512, 512, seed + 10, 0.02), &still).unwrap();
    }
    assert!(worst(&e, 0.02) < 0.12, "{}", worst(&e, 0.02));
    // Negative control: the measure sees noise that is a fifth too strong.
    assert!(worst(&e, 0.02 / 1.2) > 0.15);
}

#[test]
fn flat_parts_are_chosen_in_each_frame() {
    // A coder has left half of the noise in every second frame.
    let stds = [0.02, 0.01, 0.02, 0.01];
    let measured = |ranked: bool| {
        let mut all = NoiseEvidence::of_flat_parts(Method::Spatial);
        for (seed, std) in (0..).zip(stds) {
            let mut own = NoiseEvidence::of_flat_parts(Method::Spatial);
            own.add_single(&noisy(256, 256, seed, std));
            if ranked {
                own.rank();
            }
            all.merge(&own);
        }
        all.fit().model.known().unwrap().std(0, 0.45)[1] / white_band_std()[0]
    };
    let all = (stds.iter().map(|s| s * s).sum::<f32>() / stds.len() as f32).sqrt();
    assert!((measured(true) / all - 1.0).abs() < 0.15, "{} for {all}", measured(true));
    // Negative control: over all frames, the flattest parts are those of the frames with least noise.
    assert!(measured(false) < 0.75 * all, "{} for {all}", measured(false));
}

#[test]
fn what_is_the_same_in_two_frames_was_copied() {
    let copied = |share: f32| {
        let (frame, other) = (noisy(256, 256, 1, 0.02), noisy(256, 256, 2, 0.02));
        let next = Raster::from_fn(256, 256, |x, y| {
            if (y as f32) < 256.0 * share { frame.0.at(x, y) } else { other.0.at(x, y) }
        });
        let mut evidence = NoiseEvidence::new(Method::Temporal);
        evidence.add_pair(&frame, &Encoded(next), &Flow::filled(256, 256, [0.0; 2])).unwrap();
        evidence.is_copied()
    };
    // Where next to nothing differs, that is no sample of the picture.
    assert!(copied(0.5) && copied(0.9) && !copied(0.1) && !copied(0.0) && !copied(0.97));
    // A border of one colour is no copy.
    let with_border = |seed| {
        let picture = noisy(256, 256, seed, 0.02);
        Encoded(Raster::from_fn(256, 256, |x, y| if y < 128 { [0.5; 3] } else { picture.0.at(x, y) }))
    };
    let mut evidence = NoiseEvidence::new(Method::Temporal);
    evidence.add_pair(&with_border(1), &with_border(2), &Flow::filled(256, 256, [0.0; 2])).unwrap();
    assert!(!evidence.is_copied());
}

#[test]
fn light_that_changes_is_no_noise() {
    // The frames have texture of all sizes, and their exposure grows from frame to frame.
    let wave = |x: usize, y: usize, f: f32| (f * x as f32).sin() * (1.1 * f * y as f32).sin();
    let worst_of = |light: &(dyn Fn(usize) -> f32 + Sync)| {
        let mut e = NoiseEvidence::new(Method::Temporal);
        for seed in 0..2 {
            let lit = |seed: u64, k: &(dyn Fn(usize) -> f32 + Sync)| {
                let n = noisy(512, 512, seed, 0.01);
                Encoded(Raster::from_fn(512, 512, |x, y| {
                    let texture: f32 = [0.9, 0.4, 0.2, 0.1].map(|f| 0.03 * wave(x, y, f)).iter().sum();
                    n.0.at(x, y).map(|v| (v + texture + 0.055) * k(x) - 0.055)
                }))
            };
            let still = Flow::filled(512, 512, [0.0; 2]);
            e.add_pair(&lit(seed, &|_| 1.0), &lit(seed + 10, light), &still).unwrap();
        }
        worst(&e, 0.01)
    };
    assert!(worst_of(&|_| 1.06) < 0.2, "{}", worst_of(&|_| 1.06));
    // Negative control: a brightness that changes from left to right is not undone.
    let sideways = |x: usize| 1.0 + 0.12 * (x as f32 / 40.0).sin();
    assert!(worst_of(&sideways) > 0.5, "{}", worst_of(&sideways));
}

#[test]
fn noise_that_the_channels_share_is_given_back_too() {
    // Grey noise is like the noise that chroma at half the resolution leaves.
    let grey = |seed: u64| Encoded(noisy(512, 512, seed, 0.02).0.map(|p| [p[1]; 3]));
    let mut e = NoiseEvidence::new(Method::Temporal);
    for seed in 0..2 {
        e.add_pair(&grey(seed), &grey(seed + 10), &Flow::filled(512, 512, [0.0; 2])).unwrap();
    }
    assert!(worst(&e, 0.02) < 0.12, "{}", worst(&e, 0.02));
    let common = |e: &NoiseEvidence, c: usize| {
        let sum = |f: &dyn Fn(&LocalVariance) -> f32| e.levels[3].iter().map(f).sum::<f32>();
        sum(&|b| b.with_luma[c]).powi(2) / (sum(&|b| b.variance[c]) * sum(&|b| b.variance[3]))
    };
    assert!((0..3).all(|c| common(&e, c) > 0.99));
    // Negative control: the correlation of independent channels with luma is their share of luma.
    let mut e = NoiseEvidence::new(Method::Temporal);
    let (a, b) = (noisy(512, 512, 0, 0.02), noisy(512, 512, 10, 0.02));
    e.add_pair(&a, &b, &Flow::filled(512, 512, [0.0; 2])).unwrap();
    for (c, share) in [0.2, 0.77, 0.03].into_iter().enumerate() {
        assert!((common(&e, c) - share).abs() < 0.1, "{c}: {}", common(&e, c));
    }
}

#[test]
fn a_coarse_level_keeps_its_noise_where_the_finest_has_none() {
    let bin = |index: usize, variance: f32| Bin {
        index,
        y: index as f32 / 16.0,
        variance: [variance; 4],
        squared_correlation: [0.0; 3],
        values: 100.0,
        blocks: 10,
    };
    let expected = |finest: f32, coarse: f32| {
        let bins = [bin(3, coarse), bin(4, coarse)];
        by_spectrum(&bins, &[bin(3, finest), bin(4, finest), bin(9, finest)])
    };
    for finest in [0.0, 1e-5] {
        for b in expected(finest, 4e-6) {
            assert!((b.variance[1] / 4e-6 - 1.0).abs() < 1e-3, "{b:?}");
        }
    }
    assert_eq!(expected(1e-5, 4e-6).len(), 3);
}

#[test]
fn the_smoothing_of_the_taps_is_accounted_for() {
    // A ramp moves by half a pixel: the flow is exact, and the taps take most of the second frame's finest noise.
    let mut e = NoiseEvidence::new(Method::Temporal);
    let half = Flow::filled(512, 512, [0.5, 0.5]);
    for seed in 0..3 {
        e.add_pair(&noisy(512, 512, seed, 0.03), &noisy(512, 512, seed + 10, 0.03), &half).unwrap();
    }
    assert!(worst(&e, 0.03) < 0.15, "{}", worst(&e, 0.03));
    let gain = |f: f32| cubic_gain(f, f, 0);
    assert!(gain(0.5) < 0.6 && (gain(0.0) - 1.0).abs() < 1e-4, "{}", gain(0.5));
}

/// A picture with texture that fades towards the top, blurred along x by a streak of this length, px, and moved by `shift` px, with noise.
fn streaked(streak: f32, shift: [f32; 2], seed: u64) -> Encoded {
    const TAPS: usize = 16;
    let (w, h) = (384, 256);
    let texture = filter::gaussian_blur(&white(w + 32, h + 32, 77), 2.0);
    let noise = white(w, h, seed);
    let fading = |y: usize| 1.5 * (y as f32 / h as f32).powi(2);
    Encoded(Raster::from_fn(w, h, |x, y| {
        let mut sum = [0.0; 3];
        for i in 0..TAPS {
            let along = streak * ((i as f32 + 0.5) / TAPS as f32 - 0.5);
            // All channels have the same texture.
            let v = texture.cubic(x as f32 + 16.0 - shift[0] + along, y as f32 + 16.0 - shift[1])[1];
            sum = sum.map(|s| s + fading(y) * v / TAPS as f32);
        }
        std::array::from_fn(|c| 0.5 + sum[c] + 0.01 * noise.at(x, y)[c])
    }))
}

#[test]
fn frames_that_are_blurred_differently_and_matched_badly_give_their_noise_back() {
    let (first, second) = (streaked(2.0, [0.0; 2], 1), streaked(5.0, [3.4, 1.7], 2));
    let mut e = NoiseEvidence::new(Method::Temporal);
    // The flow is wrong by 0.15 px.
    let flow = Flow::filled(384, 256, [3.55, 1.6]);
    e.add_pair(&first, &second, &flow).unwrap();
    // Negative control: beside the difference of the frames the noise is small.
    let difference =
        |x: usize, y: usize| luma(first.0.at(x, y)) - luma(second.0.cubic(x as f32 + 3.55, y as f32 + 1.6));
    let power = |f: &dyn Fn(usize, usize) -> f32| {
        let values = (20..220).flat_map(|y| (20..340).map(move |x| (x, y)));
        values.clone().map(|(x, y)| f(x, y).powi(2)).sum::<f32>() / values.count() as f32
    };
    let of_noise = 2.0 * 1e-4 * LUMA.iter().map(|w| w * w).sum::<f32>();
    assert!(power(&difference) > 2.0 * of_noise, "{} {of_noise}", power(&difference));
    let fit = e.fit();
    let curves = fit.model.known().and_then(NoiseModel::curves).expect("there is evidence").clone();
    for (level, white) in curves.levels[..2].iter().zip(white_band_std()) {
        let std = level.std([0.5; 3]).map(|s| s / (0.01 * white));
        assert!(std.iter().all(|s| (0.9..1.1).contains(s)), "{std:?}");
        assert!(level.correlation().iter().all(|r| r.abs() < 0.15), "{:?}", level.correlation());
    }
    assert_eq!(fit.luma.unwrap().coding_error, 0.0);
}

#[test]
fn noise_by_itself_is_no_difference_in_blur() {
    let (w, h) = (256, 256);
    let (first, second) = (white(w, h, 1), white(w, h, 2));
    let with = |v: [f32; 3]| [v[0], v[1], v[2], 0.0];
    let flaws = Raster::filled(w, h, 0u8);
    for fraction in [[0.0f32, 0.0], [0.5, 0.0], [0.5, 0.5], [0.25, 0.75]] {
        let difference = Raster::from_fn(w, h, |x, y| {
            let b = second.cubic(x as f32 + fraction[0], y as f32 + fraction[1]);
            let a = first.at(x, y);
            with(std::array::from_fn(|c| a[c] - b[c]))
        });
        let power = |r: &Raster<[f32; 4]>| r.data().iter().map(|v| v[0] * v[0]).sum::<f32>();
        let share = |told: [f32; 2]| {
            let left = without_mismatch(difference.clone(), first.map(with), &flaws, |_, _| told);
            power(&left) / power(&difference)
        };
        assert!((0.985..1.0).contains(&share(fraction)), "{fraction:?} {}", share(fraction));
        // Negative control: derivatives of the mean of both frames.
        assert!(fraction == [0.0; 2] || share([0.0; 2]) < 0.97, "{}", share([0.0; 2]));
    }
}

#[test]
fn what_moves_otherwise_is_left_out_though_it_is_smooth() {
    // Half of the rows have texture that stays the same; soft light flickers over the other rows.
    let wave = |x: usize, y: usize, f: f32| (f * x as f32).sin() * (1.1 * f * y as f32).sin();
    let mut e = NoiseEvidence::new(Method::Temporal);
    for seed in 0..2 {
        let frame = |seed: u64, light: f32| {
            let still = noisy(512, 512, seed, 0.01);
            Encoded(Raster::from_fn(512, 512, |x, y| {
                let more = if y % 256 < 128 { 0.03 * wave(x, y, 0.3) } else { light * wave(x, y, 0.2) };
                still.0.at(x, y).map(|v| v + more)
            }))
        };
        let still = Flow::filled(512, 512, [0.0; 2]);
        e.add_pair(&frame(seed, 0.0), &frame(seed + 10, 0.02), &still).unwrap();
    }
    assert!(worst(&e, 0.01) < 0.25, "{}", worst(&e, 0.01));
}

#[test]
fn leaves_in_the_wind_before_a_still_camera_are_no_noise() {
    // In a part of the picture texture moves to and fro by up to 1.2 px, differently from place to place; the flow says that all is still.
    let texture = white(512, 512, 99).map(|v| [v[0]; 3]);
    let texture = filter::gaussian_blur(&texture, 0.7);
    let worst_of = |leaves: usize, sway: f32| {
        let mut e = NoiseEvidence::new(Method::Temporal);
        for seed in 0..3 {
            let frame = |seed: u64| {
                let still = noisy(512, 512, seed, 0.01);
                Encoded(Raster::from_fn(512, 512, |x, y| {
                    let phase = seed as f32 * 1.7;
                    let [dx, dy] =
                        [(x as f32 * 0.05 + phase).sin(), (y as f32 * 0.06 - phase).cos()].map(|v| sway * v);
                    let more = if y < leaves { 0.12 } else { 0.0 };
                    let t =
                        texture.cubic((x as f32 + dx).clamp(0.0, 511.0), (y as f32 + dy).clamp(0.0, 511.0));
                    still.0.at(x, y).map(|v| v + more * t[0])
                }))
            };
            let still = Flow::filled(512, 512, [0.0; 2]);
            e.add_pair(&frame(seed), &frame(seed + 10), &still).unwrap();
        }
        (e.is_pure(), worst(&e, 0.01))
    };
    for leaves in [200, 300] {
        let (pure, worst) = worst_of(leaves, 1.2);
        assert!(!pure && worst < 0.35, "{leaves}: {pure} {worst}");
    }
    // Where the same texture stands still, all blocks count.
    let (pure, worst) = worst_of(300, 0.0);
    assert!(pure && worst < 0.12, "{worst}");
}

#[test]
fn a_mismatch_is_subtracted_as_far_as_it_is_seen_and_noise_is_not() {
    let block = |variance: f32, coarser: f32| LocalVariance {
        y: 0.5,
        variance: [variance; 4],
        coarser,
        count: 16.0,
        ..LocalVariance::default()
    };
    let falls = (white_band_std()[2] / white_band_std()[1]).powi(2);
    // The blocks have noise of variance 1 and a mismatch of half the variance that it has in the coarser band.
    let mismatched: Vec<_> = (20..60).map(|m| block(1.0 + 0.5 * m as f32, falls + m as f32)).collect();
    let share = noise_share(1, 2.0, falls + 2.0, &mismatched.iter().collect::<Vec<_>>());
    assert!((share - 0.5).abs() < 0.1, "{share}");
    let noise: Vec<_> = (0..60).map(|i| block(1.0, falls * (0.5 + i as f32 / 60.0))).collect();
    assert_eq!(noise_share(1, 1.0, 0.5 * falls, &noise.iter().collect::<Vec<_>>()), 1.0);
}

#[test]
fn coarse_noise_is_not_taken_for_a_mismatch() {
    let levels = [0.01, 0.02, 0.03, 0.03];
    let white = white_band_std();
    let levels =
        std::array::from_fn(|l| NoiseLevel { slope: [0.0; 3], intercept: [levels[l] * white[l]; 3] });
    let model = NoiseModel::given(levels, 1.0);
    let clean = noisy(512, 512, 0, 0.0);
    let noise = |i: u64| crate::synth::noise::noise(&model, &clean.0, 5, i);
    let frame = |i: u64| {
        let noise = noise(i);
        Encoded(Raster::from_fn(512, 512, |x, y| {
            let (v, n) = (clean.0.at(x, y), noise.at(x, y));
            std::array::from_fn(|c| v[c] + n[c])
        }))
    };
    let mut e = NoiseEvidence::new(Method::Temporal);
    for i in 0..3 {
        e.add_pair(&frame(2 * i), &frame(2 * i + 1), &Flow::filled(512, 512, [0.0; 2])).unwrap();
    }
    let found = e.fit().model;
    // The levels of the synthesis overlap, so the truth is the power of the synthesised noise in each band.
    let (bands, _) = pyramid::laplacian(&noise(0), NOISE_LEVELS);
    for (found, band) in found.known().expect("there is evidence").lines().levels.iter().zip(&bands) {
        let power = band.data().iter().map(|v| v[1] * v[1]).sum::<f32>() / band.data().len() as f32;
        let ratio = found.sigma(0.45)[1] / power.sqrt();
        assert!((ratio - 1.0).abs() < 0.15, "{ratio}");
    }
}

/// A picture of all luminances, in three hues.
fn colourful() -> Encoded {
    Encoded(Raster::from_fn(512, 384, |x, y| {
        let v = 0.15 + 0.7 * x as f32 / 512.0;
        let hue = [[1.0, 0.9, 0.4], [0.4, 1.0, 0.6], [0.5, 0.5, 1.0]][y / 128];
        hue.map(|h| h * v)
    }))
}

/// Noise as a camera makes it: coarser than white, mostly shared by the channels, and stronger where the picture is red.
fn camera_noise(clean: &Encoded, seed: u64) -> Raster<[f32; 3]> {
    let (w, h) = clean.0.size();
    let own = white(w, h, seed);
    let coarse = filter::gaussian_blur(&white(w, h, seed + 1000), 1.2);
    Raster::from_fn(w, h, |x, y| {
        let (o, s, v) = (own.at(x, y), coarse.at(x, y), clean.0.at(x, y));
        let shared = 0.7 * o[1] + 2.0 * s[1];
        std::array::from_fn(|c| 0.01 * (0.5 + v[0]) * (shared + 0.3 * o[c] + 0.8 * s[c]))
    })
}

fn sum(clean: &Encoded, noise: &Raster<[f32; 3]>) -> Encoded {
    let (w, h) = clean.0.size();
    Encoded(Raster::from_fn(w, h, |x, y| {
        let (v, n) = (clean.0.at(x, y), noise.at(x, y));
        std::array::from_fn(|c| v[c] + n[c])
    }))
}

/// The std of G in six parts of each level, and the correlation of R and G in each level.
fn look(noise: &Raster<[f32; 3]>) -> ([[f32; 6]; NOISE_LEVELS], [f32; NOISE_LEVELS]) {
    let (bands, _) = pyramid::laplacian(noise, NOISE_LEVELS);
    let parts = |l: usize| {
        let (w, h) = (bands[l].width() / 2, bands[l].height() / 3);
        std::array::from_fn(|i| {
            let part = bands[l].crop(i % 2 * w, i / 2 * h, w, h);
            (part.data().iter().map(|v| v[1] * v[1]).sum::<f32>() / (w * h) as f32).sqrt()
        })
    };
    let correlation = |l: usize| {
        let sum = |a: usize, b: usize| bands[l].data().iter().map(|v| v[a] * v[b]).sum::<f32>();
        sum(0, 1) / (sum(0, 0) * sum(1, 1)).sqrt()
    };
    (std::array::from_fn(parts), std::array::from_fn(correlation))
}

#[test]
fn a_camera_s_noise_is_made_again_as_strong_as_coarse_and_as_grey() {
    let clean = colourful();
    let mut e = NoiseEvidence::new(Method::Removal);
    for seed in 0..3 {
        e.add_residual(&sum(&clean, &camera_noise(&clean, seed)), &clean, &clean).unwrap();
    }
    let found = e.fit().model;
    let model = found.known().expect("there is evidence");
    let (stds, correlations) = look(&camera_noise(&clean, 77));
    let off = |model: &NoiseModel| {
        let (got, shared) = look(&crate::synth::noise::noise(model, &clean.0, 3, 0));
        let ratio = |(got, want): (&f32, &f32)| (got / want - 1.0).abs();
        let worst = got.as_flattened().iter().zip(stds.as_flattened()).map(ratio).fold(0.0, f32::max);
        let apart = shared.iter().zip(&correlations).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        (worst, apart)
    };
    let (worst, apart) = off(model);
    assert!(worst < 0.2 && apart < 0.1, "{worst} {apart}");
    // Negative control: straight lines know neither colour nor what the channels share, and lose coarse noise.
    let (worst, apart) = off(&NoiseModel::Lines(model.lines().clone()));
    assert!(worst > 0.3 && apart > 0.4, "{worst} {apart}");
}

#[test]
fn noise_that_stays_for_some_frames_is_found_and_made_again() {
    let clean = colourful();
    let made = |correlation: f32| {
        let mut last = camera_noise(&clean, 100);
        let frames: Vec<Encoded> = (0..6)
            .map(|t| {
                let new = camera_noise(&clean, 101 + t);
                let mixed = |x, y| {
                    let (a, b): ([f32; 3], [f32; 3]) = (last.at(x, y), new.at(x, y));
                    std::array::from_fn(|c| {
                        correlation * a[c] + (1.0 - correlation * correlation).sqrt() * b[c]
                    })
                };
                last = Raster::from_fn(512, 384, mixed);
                sum(&clean, &last)
            })
            .collect();
        let mut e = NoiseEvidence::new(Method::Temporal);
        for pair in frames.windows(2) {
            e.add_pair(&pair[0], &pair[1], &Flow::filled(512, 384, [0.0; 2])).unwrap();
        }
        for three in frames.windows(3) {
            e.add_successive([&three[0], &three[1], &three[2]]);
        }
        e.fit().model.known().expect("there is evidence").clone()
    };
    let strong = |model: &NoiseModel| look(&crate::synth::noise::noise(model, &clean.0, 1, 5)).0[0][3];
    let shared = |model: &NoiseModel| {
        let [a, b] = [7, 8].map(|t| crate::synth::noise::noise(model, &clean.0, 1, t));
        let sum = |a: &Raster<[f32; 3]>, b: &Raster<[f32; 3]>| {
            a.data().iter().zip(b.data()).map(|(a, b)| a[1] * b[1]).sum::<f32>()
        };
        sum(&a, &b) / (sum(&a, &a) * sum(&b, &b)).sqrt()
    };
    let want = look(&camera_noise(&clean, 77)).0[0][3];
    let stays = made(0.6);
    assert!((stays.temporal_correlation() - 0.6).abs() < 0.08, "{}", stays.temporal_correlation());
    assert!((shared(&stays) - 0.6).abs() < 0.1, "{}", shared(&stays));
    assert!((strong(&stays) / want - 1.0).abs() < 0.15, "{} {want}", strong(&stays));
    // Negative control: the noise of independent frames is not found to stay.
    let boils = made(0.0);
    // The straight lines have the whole noise as well; a difference of frames that share it shows 0.63 of its std.
    let ratio = stays.std(0, 0.4)[1] / boils.std(0, 0.4)[1];
    assert!((ratio - 1.0).abs() < 0.1, "{ratio}");
    assert!(boils.temporal_correlation() < 0.1 && shared(&boils) < 0.1);
    assert!((strong(&boils) / want - 1.0).abs() < 0.15, "{} {want}", strong(&boils));
}

#[test]
fn the_paper_s_windows_give_the_noise_back() {
    let mut e = NoiseEvidence::new(Method::Removal);
    let clean = noisy(512, 512, 0, 0.0);
    for seed in 0..3 {
        e.add_denoised(&noisy(512, 512, seed, 0.02), &clean).unwrap();
    }
    assert!(worst(&e, 0.02) < 0.12, "{}", worst(&e, 0.02));
}

#[test]
fn a_small_single_frame_has_the_noise_of_all_levels_and_its_channels_what_they_share() {
    // All channels are the same, as after a camera has removed the noise of colour.
    let std = 0.02;
    for (w, h, levels_with_blocks) in [(96, 96, 2), (128, 128, 4)] {
        let noise = white(w, h, 5);
        let grey = Encoded(noise.map(|n| [0.5 + std * n[1]; 3]));
        let mut e = NoiseEvidence::new(Method::Spatial);
        e.add_single(&grey);
        let found = (0..NOISE_LEVELS).filter(|&l| !e.bins(l, [1.0; 3], false).is_empty()).count();
        assert!(found >= levels_with_blocks, "{found}");
        let fit = e.fit();
        let Estimate::Known(NoiseModel::Curves(curves)) = fit.model else {
            panic!("{w} x {h}: no curves, {found} levels")
        };
        let luma = fit.luma.expect("it is known");
        for (l, white) in white_band_std().into_iter().enumerate() {
            let of_lines = curves.lines.levels[l].sigma(0.5)[1] / (std * white);
            let of_luma = luma.levels[l].intercept + 0.5 * luma.levels[l].slope;
            assert!((0.5..1.5).contains(&of_lines), "level {l}: {of_lines} of the noise");
            assert!((0.5..1.5).contains(&(of_luma / (std * white))), "level {l}: {of_luma}");
        }
        let [a, b] = [0, 1].map(|c| curves.levels[0].mixing[c]);
        let product = |a: [f32; 3], b: [f32; 3]| (0..3).map(|k| a[k] * b[k]).sum::<f32>();
        let shared = product(a, b) / (product(a, a) * product(b, b)).sqrt();
        assert!(shared > 0.9, "the channels share {shared}");
    }
}

#[test]
fn a_flat_single_frame_gives_the_noise_back() {
    let mut e = NoiseEvidence::new(Method::Spatial);
    (0..4).for_each(|seed| e.add_single(&noisy(512, 512, seed, 0.02)));
    assert!(worst(&e, 0.02) < 0.12, "{}", worst(&e, 0.02));
}

#[test]
fn single_frames_say_that_their_flattest_parts_may_not_show_the_noise() {
    let spread = |method: Method, frame: &Encoded, next: &Encoded| {
        let mut e = NoiseEvidence::new(method);
        match method {
            Method::Spatial => e.add_single(frame),
            _ => e.add_pair(frame, next, &Flow::filled(512, 384, [0.0; 2])).unwrap(),
        }
        e.fit().shared_spread()
    };
    let white = [1, 2].map(|seed| noisy(512, 384, seed, 0.02));
    // Interpolation makes neighbouring pixels alike.
    let interpolated = |seed: u64| filter::gaussian_blur(&self::white(512, 384, seed), 0.9);
    let camera = [1, 2].map(|seed| Encoded(interpolated(seed).map(|n| n.map(|n| 0.5 + 0.04 * n))));
    let single = [&white, &camera].map(|[a, b]| spread(Method::Spatial, a, b));
    assert!((single[0] - 0.2).abs() < 0.05 && (single[1] - 0.4).abs() < 0.05, "{single:?}");
    // Between frames there is no texture.
    assert_eq!([&white, &camera].map(|[a, b]| spread(Method::Temporal, a, b)), [0.0; 2]);
    // Little noise may be what a coder left.
    let weak = noisy(512, 384, 1, 0.0015);
    assert!(spread(Method::Spatial, &weak, &weak) > 0.25);
}

#[test]
fn too_few_blocks_of_one_brightness_do_not_tell_a_noise_of_zero() {
    // A steep ramp of twelve blocks, no four of which are about as bright.
    let n = white(64, 48, 5);
    let ramp =
        Encoded(Raster::from_fn(64, 48, |x, y| n.at(x, y).map(|n| 0.1 + 0.8 * x as f32 / 64.0 + 0.01 * n)));
    let mut e = NoiseEvidence::new(Method::Spatial);
    e.add_single(&ramp);
    let fit = e.fit();
    let std = fit.model.known().map(|m| m.std(0, 0.5));
    assert_eq!(fit.luma.is_some(), std.is_some());
    assert!(std.is_none_or(|s| s.iter().all(|&s| s > 0.0)), "{std:?}");
}

#[test]
fn light_above_white_shows_its_noise_up_to_where_it_ends() {
    const STD: f32 = 0.012;
    // A sensor that ends at 2.4, 2 and 1.6, in a tenth of the frame.
    const ENDS: [f32; 3] = [2.4, 2.0, 1.6];
    let frame = |seed: u64, brightest: f32| {
        let noise = white(256, 256, seed);
        Encoded(Raster::from_fn(256, 256, |x, y| {
            let base = if x < 26 { 3.0 } else { brightest * (0.4 + 0.6 * y as f32 / 256.0) };
            let n = noise.at(x, y);
            std::array::from_fn(|c| (base + STD * n[c]).min(ENDS[c]))
        }))
    };
    let flow = Flow::filled(256, 256, [1.0, 0.0]);
    let evidence = |brightest: f32| {
        let mut e = NoiseEvidence::new(Method::Temporal);
        e.add_pair(&frame(1, brightest), &frame(2, brightest), &flow).unwrap();
        e
    };
    let e = evidence(1.5);
    assert_eq!(e.white, ENDS);
    let fit = e.fit();
    let model = fit.model.known().expect("there is evidence");
    assert_eq!(model.clip(), ENDS[0]);
    for y in [0.7, 1.0, 1.3] {
        let std = model.total_std_over([y; 3]);
        assert!(std.iter().all(|s| (s / STD - 1.0).abs() < 0.1), "at {y}: {std:?}");
    }
    // Negative control: of the part below white alone, which ends at 1, what is brighter would be clipped.
    let cut = |image: Encoded| Encoded(image.0.map(|p| p.map(|v| v.min(1.0))));
    let mut e = NoiseEvidence::new(Method::Temporal);
    e.add_pair(&cut(frame(1, 1.5)), &cut(frame(2, 1.5)), &flow).unwrap();
    assert_eq!((e.white, e.clip_level()), ([1.0; 3], 1.0));
    // Nor does a plate go beyond white that ends at 1, and whose filter overshoots, though a card that was added is brighter.
    let ends_at_one = cut(frame(1, 1.5)).0;
    let overshooting = Encoded(Raster::from_fn(256, 256, |x, y| {
        let v = ends_at_one.at(x, y);
        let ringing = if (x + y) % 9 == 0 { 1.035 } else { 1.0 };
        if y > 240 { [1.6; 3] } else { v.map(|v| if v == 1.0 { v * ringing } else { v }) }
    }));
    let mut e = NoiseEvidence::new(Method::Spatial);
    e.add_single(&overshooting);
    assert_eq!(e.white, [1.0; 3]);
    // A few lamps are no footage that goes beyond white.
    let mut lamps = noisy(256, 256, 3, STD);
    lamps.0.data_mut()[..200].fill([50.0; 3]);
    let mut e = NoiseEvidence::new(Method::Spatial);
    e.add_single(&lamps);
    assert_eq!(e.white, [1.0; 3]);
}

#[test]
fn saturated_frames_give_no_noise_but_the_clip_level() {
    let mut e = NoiseEvidence::new(Method::Spatial);
    e.add_single(&Encoded(Raster::filled(128, 128, [1.0; 3])));
    assert!(e.fit().model.why_unknown().is_some());
    let mut e = NoiseEvidence::new(Method::Spatial);
    let clipped = noisy(256, 256, 3, 0.05).0.map(|p| p.map(|v| v.min(0.6)));
    e.add_single(&Encoded(clipped));
    assert!((e.clip_level() - 0.6).abs() < 0.01, "{}", e.clip_level());
}
