//! Tests of relative inverse depth from the flow of a known camera in front of a known scene.

use blindaug::{
    Flow, Plane, Raster,
    analysis::{
        depth::{Parallax, ParallaxTracker, RelativeDepth, inverse_depth_from_flow},
        flow::FlowPair,
    },
};

const SIZE: (usize, usize) = (160, 120);
const FOCAL_LENGTH: f64 = 1.2 * SIZE.0 as f64;

/// The inverse depth at a pixel of a scene with a floor, a wall, and three boxes in front of the wall.
fn scene(x: usize, y: usize) -> f64 {
    let (fx, fy) = (x as f64 / SIZE.0 as f64, y as f64 / SIZE.1 as f64);
    let wall = 0.2 + 0.03 * fx;
    let floor = 0.2 + 1.3 * (fy - 0.5);
    let boxes = [(0.1, 0.3, 0.3, 0.6, 0.7), (0.45, 0.6, 0.2, 0.7, 0.5), (0.75, 0.95, 0.5, 0.8, 0.9)];
    boxes
        .iter()
        .filter(|(x0, x1, y0, y1, _)| (*x0..*x1).contains(&fx) && (*y0..*y1).contains(&fy))
        .map(|b| b.4)
        .fold(wall.max(floor), f64::max)
}

/// The point `p` turned by `r`, axis times angle (Rodrigues).
fn turned(p: [f64; 3], r: [f64; 3]) -> [f64; 3] {
    let angle = (r[0] * r[0] + r[1] * r[1] + r[2] * r[2]).sqrt().max(1e-12);
    let k = r.map(|v| v / angle);
    let cross = [k[1] * p[2] - k[2] * p[1], k[2] * p[0] - k[0] * p[2], k[0] * p[1] - k[1] * p[0]];
    let along = (k[0] * p[0] + k[1] * p[1] + k[2] * p[2]) * (1.0 - angle.cos());
    std::array::from_fn(|i| p[i] * angle.cos() + cross[i] * angle.sin() + k[i] * along)
}

/// The flow of a camera that moves by `t` and turns by `r` between the frames, with flow noise of std `noise` px, which is smooth over
/// some px like that of real flow.
fn seen(t: [f64; 3], r: [f64; 3], noise: f64) -> Flow {
    let (w, h) = SIZE;
    let at = |x: usize, y: usize, seed: usize| {
        // The noise is a sum of waves of random directions, which is about normal, and smooth.
        (0..40)
            .map(|i| {
                let q = (i * 7919 + seed * 104_729) as f64;
                let (angle, length) = (q * 1.618, 9.0 + 30.0 * (q * 0.7548).fract());
                ((x as f64 * angle.cos() + y as f64 * angle.sin()) * std::f64::consts::TAU / length + q * 2.4)
                    .sin()
            })
            .sum::<f64>()
            / 20f64.sqrt()
    };
    Flow::from_fn(w, h, |x, y| {
        let d = scene(x, y);
        let (cx, cy) = (0.5 * (w as f64 - 1.0), 0.5 * (h as f64 - 1.0));
        let (px, py) = ((x as f64 - cx) / FOCAL_LENGTH, (y as f64 - cy) / FOCAL_LENGTH);
        let p = turned([px - d * t[0], py - d * t[1], 1.0 - d * t[2]], r.map(|v| -v));
        [
            (FOCAL_LENGTH * (p[0] / p[2] - px) + noise * at(x, y, 1)) as f32,
            (FOCAL_LENGTH * (p[1] / p[2] - py) + noise * at(x, y, 2)) as f32,
        ]
    })
}

fn everything_seen() -> Raster<bool> {
    Raster::filled(SIZE.0, SIZE.1, false)
}

fn known(flow: &Flow) -> RelativeDepth {
    match inverse_depth_from_flow(flow, &everything_seen()).unwrap() {
        Parallax::Known(depth) => depth,
        Parallax::Unknown(why) => panic!("unknown: {why}"),
    }
}

fn reason(flow: &Flow) -> String {
    match inverse_depth_from_flow(flow, &everything_seen()).unwrap() {
        Parallax::Known(depth) => panic!("known: {depth:?}"),
        Parallax::Unknown(why) => why.sentence,
    }
}

/// The median and the 90th percentile of the relative error of `d` against the scene, after the best scale (the median ratio).
fn error(d: &Plane) -> (f64, f64) {
    let mut pairs = Vec::new();
    for y in 0..SIZE.1 {
        for x in 0..SIZE.0 {
            if d.at(x, y).is_finite() {
                pairs.push((f64::from(d.at(x, y)), scene(x, y)));
            }
        }
    }
    assert!(pairs.len() > SIZE.0 * SIZE.1 / 2, "only {} pixels are known", pairs.len());
    let mut ratios: Vec<f64> = pairs.iter().map(|(d, t)| t / d).collect();
    ratios.sort_by(f64::total_cmp);
    let ratio = ratios[ratios.len() / 2];
    let mut errors: Vec<f64> = pairs.iter().map(|(d, t)| (ratio * d - t).abs() / t).collect();
    errors.sort_by(f64::total_cmp);
    (errors[errors.len() / 2], errors[errors.len() * 9 / 10])
}

const MOTIONS: [([f64; 3], [f64; 3]); 4] = [
    ([0.10, 0.0, 0.0], [0.0; 3]),
    ([-0.08, 0.02, 0.06], [0.004, -0.02, 0.01]),
    ([0.01, -0.11, 0.03], [0.03, 0.01, -0.02]),
    ([0.03, 0.02, -0.25], [0.01, 0.02, 0.0]),
];

#[test]
fn depth_and_motion_of_a_moving_camera() {
    for (t, r) in MOTIONS {
        let exact = known(&seen(t, r, 0.0));
        let (median, most) = error(&exact.inverse_depth);
        assert!(median < 0.02 && most < 0.05, "{t:?}, {r:?}: {median}, {most}");
        let length = (t[0] * t[0] + t[1] * t[1] + t[2] * t[2]).sqrt();
        for i in 0..3 {
            assert!(
                (f64::from(exact.translation[i]) - t[i] / length).abs() < 0.05,
                "{:?}",
                exact.translation
            );
            assert!((f64::from(exact.rotation[i]) - r[i]).abs() < 0.003, "{:?}", exact.rotation);
        }
        let values = exact.inverse_depth.data().iter().filter(|d| d.is_finite());
        assert!(values.clone().all(|d| (0.0..=1.0).contains(d)));
        let top = values.clone().filter(|d| **d >= 1.0).count() as f64 / values.count() as f64;
        // The nearest box fills 6 % of the picture.
        assert!((0.01..0.09).contains(&top), "{top} of the map is at its limit");

        let (median, most) = error(&known(&seen(t, r, 0.1)).inverse_depth);
        assert!(median < 0.06 && most < 0.2, "{t:?}, {r:?} with noise: {median}, {most}");
    }
}

#[test]
fn the_error_sees_a_wrong_depth() {
    let d = known(&seen(MOTIONS[1].0, MOTIONS[1].1, 0.0)).inverse_depth;
    let upside_down = Plane::from_fn(SIZE.0, SIZE.1, |x, y| d.at(x, SIZE.1 - 1 - y));
    assert!(error(&upside_down).0 > 0.2);
    assert!(error(&d.map(|d| 1.2 - d)).0 > 0.2);
}

#[test]
fn a_camera_that_only_turns_tells_no_depth() {
    for (r, noise) in [([0.0, 0.03, 0.0], 0.0), ([0.02, -0.01, 0.03], 0.05), ([0.01, 0.02, -0.01], 0.3)] {
        let why = reason(&seen([0.0; 3], r, noise));
        assert!(why.contains("turn"), "{why}");
    }
    // The camera also moves while it turns, but by far less than the flow can tell.
    let why = reason(&seen([0.004, 0.0, 0.0], [0.0, 0.03, 0.0], 0.1));
    assert!(why.contains("turn"), "{why}");
}

#[test]
fn nothing_moves() {
    assert!(
        reason(&Flow::filled(SIZE.0, SIZE.1, [0.0; 2])).contains("less than a tenth of the picture moves")
    );
    assert!(reason(&seen([0.0; 3], [0.0; 3], 0.03)).contains("less than a tenth of the picture moves"));
}

#[test]
fn a_scene_that_moves_tells_no_depth() {
    // The picture is made of cells that move in different directions.
    let stripes = Flow::from_fn(SIZE.0, SIZE.1, |x, y| {
        let k = (x / 20 + 8 * (y / 20)) as f32;
        [6.0 * (k * 2.4).cos(), 6.0 * (k * 3.9).sin()]
    });
    let why = reason(&stripes);
    assert!(why.contains("scene moves"), "{why}");
    // The camera is fixed, and cars move on the lower half of the picture.
    let cars =
        Flow::from_fn(SIZE.0, SIZE.1, |x, y| if y < 50 { [0.02, 0.0] } else { [5.0 + (x / 40) as f32, 0.1] });
    let why = reason(&cars);
    assert!(why.contains("stands still"), "{why}");
}

#[test]
fn what_moves_by_itself_is_unknown_and_the_rest_stays_right() {
    let (t, r) = MOTIONS[0];
    let mut flow = seen(t, r, 0.03);
    let mover = |x: usize, y: usize| (50..90).contains(&x) && (20..60).contains(&y);
    for y in 0..SIZE.1 {
        for x in 0..SIZE.0 {
            if mover(x, y) {
                // The object moves across the epipolar lines, which are horizontal.
                flow.row_mut(y)[x][1] += 3.0;
            }
        }
    }
    let depth = known(&flow);
    let (mut inside, mut outside) = ((0, 0), (0, 0));
    for y in 0..SIZE.1 {
        for x in 0..SIZE.0 {
            let count = if mover(x, y) { &mut inside } else { &mut outside };
            count.0 += usize::from(depth.inverse_depth.at(x, y).is_nan());
            count.1 += 1;
        }
    }
    assert!(inside.0 * 100 > inside.1 * 99, "{inside:?} unknown of those that move");
    assert!(outside.0 * 100 < outside.1 * 2, "{outside:?} unknown of the others");
    let (median, most) = error(&depth.inverse_depth);
    assert!(median < 0.03 && most < 0.1, "{median}, {most}");
}

#[test]
fn occluded_and_unknown_flow_is_left_out() {
    let mut flow = seen(MOTIONS[1].0, MOTIONS[1].1, 0.0);
    flow.row_mut(7)[9] = [f32::NAN, 0.0];
    flow.row_mut(8)[9] = [f32::INFINITY, 0.0];
    let mut occluded = everything_seen();
    occluded.row_mut(30).fill(true);
    let Parallax::Known(depth) = inverse_depth_from_flow(&flow, &occluded).unwrap() else {
        panic!("unknown")
    };
    assert!(depth.inverse_depth.row(30).iter().all(|d| d.is_nan()));
    assert!(depth.inverse_depth.at(9, 7).is_nan() && depth.inverse_depth.at(9, 8).is_nan());
    assert!(depth.inverse_depth.at(9, 9).is_finite());
    let hidden = Raster::from_fn(SIZE.0, SIZE.1, |x, _| x % 4 > 0);
    let Parallax::Unknown(why) = inverse_depth_from_flow(&flow, &hidden).unwrap() else { panic!("known") };
    assert!(why.sentence.contains("found again"), "{why}");
}

#[test]
fn bad_input_is_no_accident() {
    let flow = |w, h| Flow::from_fn(w, h, |x, y| [(x % 7) as f32, (y % 5) as f32]);
    assert!(inverse_depth_from_flow(&flow(20, 10), &Raster::filled(10, 20, false)).is_err());
    assert!(inverse_depth_from_flow(&flow(0, 0), &Raster::filled(0, 0, false)).is_err());
    for (w, h) in [(1, 1), (3, 500), (8, 8)] {
        assert!(inverse_depth_from_flow(&flow(w, h), &Raster::filled(w, h, false)).is_ok());
    }
    for value in [f32::NAN, f32::INFINITY, f32::MAX, 1e20] {
        let odd =
            Flow::from_fn(40, 30, |x, y| if (x + y) % 3 == 0 { [value, -value] } else { [x as f32, 1.0] });
        assert!(inverse_depth_from_flow(&odd, &Raster::filled(40, 30, false)).is_ok());
    }
}

/// The flow of a camera that moves by `t` and turns by `r`, in both directions. The backward flow is that of the same pixels, which is
/// accurate enough for small motions.
fn pair(t: [f64; 3], r: [f64; 3], noise: f64) -> FlowPair {
    let forward = seen(t, r, noise);
    let backward = seen(t.map(|v| -v), r.map(|v| -v), noise);
    FlowPair { forward, backward, occluded: everything_seen(), residual: Plane::filled(SIZE.0, SIZE.1, 0.0) }
}

#[test]
fn the_tracker_keeps_the_scale_when_the_camera_slows_down_and_over_gaps() {
    let mut tracker = ParallaxTracker::new();
    // The scene stays the same, but the camera moves at another speed in each pair, and once not at all. The near parts are seen
    // in the first pair only, so that the other pairs by themselves would have another scale.
    let far = |x: usize, y: usize| scene(x, y) < 0.65;
    let median = |d: &Plane| {
        let mut v: Vec<f32> = (0..SIZE.1)
            .flat_map(|y| (0..SIZE.0).map(move |x| (x, y)))
            .filter(|&(x, y)| far(x, y))
            .map(|(x, y)| d.at(x, y))
            .filter(|d| d.is_finite())
            .collect();
        v.sort_by(f32::total_cmp);
        v[v.len() / 2]
    };
    let (mut tracked, mut alone) = (Vec::new(), Vec::new());
    for (k, step) in [0.16, 0.1, 0.14, 0.0, 0.12, -0.14].into_iter().enumerate() {
        let mut pair = pair([step, 0.0, 0.0], [0.0, 0.01, 0.0], 0.01);
        if k > 0 {
            pair.occluded = Raster::from_fn(SIZE.0, SIZE.1, |x, y| !far(x, y));
        }
        match tracker.push(&pair, 1).unwrap() {
            Parallax::Known(depth) => {
                assert!(depth.inverse_depth.data().iter().all(|d| d.is_nan() || (0.0..=1.0).contains(d)));
                tracked.push(median(&depth.inverse_depth));
                let Parallax::Known(depth) = inverse_depth_from_flow(&pair.forward, &pair.occluded).unwrap()
                else {
                    panic!("unknown")
                };
                alone.push(median(&depth.inverse_depth));
            }
            Parallax::Unknown(why) => assert!(step == 0.0, "{why}"),
        }
    }
    assert_eq!(tracked.len(), 5);
    assert_eq!(tracked[0], alone[0]);
    for k in 1..5 {
        assert!((tracked[k] / tracked[0] - 1.0).abs() < 0.15, "{tracked:?}");
        assert!(alone[k] / alone[0] > 1.25, "{alone:?}");
    }
}

#[test]
fn the_tracker_begins_anew_at_a_cut_and_at_another_size() {
    let mut tracker = ParallaxTracker::new();
    let good = pair([0.05, 0.0, 0.0], [0.0; 3], 0.01);
    let cut = FlowPair { occluded: Raster::filled(SIZE.0, SIZE.1, true), ..good.clone() };
    assert!(matches!(tracker.push(&good, 1).unwrap(), Parallax::Known(_)));
    assert!(matches!(tracker.push(&cut, 1).unwrap(), Parallax::Unknown(_)));
    let half = |r: &Flow| r.crop(0, 0, SIZE.0, SIZE.1 - 20);
    let smaller = FlowPair {
        forward: half(&good.forward),
        backward: half(&good.backward),
        occluded: good.occluded.crop(0, 0, SIZE.0, SIZE.1 - 20),
        residual: good.residual.crop(0, 0, SIZE.0, SIZE.1 - 20),
    };
    tracker.push(&good, 1).unwrap();
    // A new scale begins, so the 98th percentile of this map is 1 again.
    let Parallax::Known(depth) = tracker.push(&smaller, 1).unwrap() else { panic!("unknown") };
    let share = depth.inverse_depth.data().iter().filter(|d| **d >= 1.0).count() as f64;
    assert!(share > 0.005 * (SIZE.0 * (SIZE.1 - 20)) as f64, "{share}");
}
