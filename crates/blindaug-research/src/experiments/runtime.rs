//! How long the fits, the whole estimate and the effects take on the machine at hand, beside what the paper reports.

#[cfg(feature = "gpu")]
mod graphics;

use crate::filming::Filming;
use crate::run::{Findings, Run};
use crate::statistics::mean;
use crate::table::{Cell, Table};
use blindaug::composite::{self, CompositeOptions, Plate, VirtualLayer};
use blindaug::fit::{
    Estimator, FrameObservation, defocus, motion_blur, noise::NoiseEvidence, track::Tracker,
};
use blindaug::model::Method;
use blindaug::{Encoded, Plane, Premultiplied, Raster, Transfer};
use blindaug_io::{Error, Result};
use blindaug_scenes::camera::{Camera, Setting, model};
use blindaug_scenes::scene::Scene;
use serde::{Deserialize, Serialize};
use std::{hint::black_box, time::Instant};

/// The name of the experiment's folder.
pub const NAME: &str = "runtime";

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Case {
    repetitions: usize,
}

/// The durations of one step, ms.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Timed {
    what: String,
    /// What the paper reports, in its own words.
    paper: String,
    ms: Vec<f64>,
}

/// Runs the experiment; `quick`: fewer repetitions.
///
/// # Errors
/// If a file cannot be written.
pub fn run(run: &Run, quick: bool) -> Result<Findings> {
    let case = Case { repetitions: if quick { 3 } else { 15 } };
    let seed = run.seed();
    let outcomes = run.cases(NAME, vec![("durations".into(), case)], |case| {
        timed(case, seed).map_err(|e| Error::new(NAME, e.to_string()))
    })?;
    let all: Vec<Timed> = outcomes.into_iter().flat_map(|o| o.1).collect();
    let rows = all.iter().map(|t| {
        let spread = mean(t.ms.iter().copied());
        vec![
            Cell::text(&t.what),
            Cell::spread(spread, 1),
            Cell::number(spread.map(|m| 1000.0 / m.mean), 1),
            Cell::text(&t.paper),
        ]
    });
    let table = Table {
        name: "durations".into(),
        caption: "Means over the repetitions with their standard deviation. The machines differ, so only the order of magnitude compares."
            .into(),
        head: ["step", "ms", "times a second", "the paper"].map(String::from).into(),
        rows: rows.collect(),
    };
    Ok(Findings {
        name: NAME.into(),
        title: "Runtime".into(),
        text: vec![
            "On the processor of this machine, with pictures in memory. The fits are those of the paper's OPTIMIZATION: one frame of 512 x \
             512 px with the clean frame, depth and flow given. Blind estimates are given frames alone."
                .into(),
            on_graphics_card(&all).into(),
        ],
        tables: vec![table],
        ..Findings::default()
    })
}

/// The beginning of the step on the graphics card.
const TWO_EYES: &str = "composite of two such eyes on";

/// A sentence on what the graphics card did.
fn on_graphics_card(all: &[Timed]) -> &'static str {
    if all.iter().any(|t| t.what.starts_with(TWO_EYES)) {
        "The last step is the graphics card's, of which the compositor's bench tells more (cargo bench -p blindaug-gpu)."
    } else if cfg!(feature = "gpu") {
        "There is no graphics card."
    } else {
        "The graphics card is not used: this program was built without the feature gpu."
    }
}

fn timed(case: &Case, seed: u64) -> blindaug::Result<Vec<Timed>> {
    const SIZE: (usize, usize) = (512, 512);
    let setting =
        Setting { exposure: 0.5, lens: Some((3.0, 1.6)), noise: 0.01, readout: 0.2, rolling_shutter: 0.0 };
    let frames = 6;
    let mut filming = Filming::new(Scene::new(seed, SIZE), frames);
    filming.film(Camera::Physics, setting, seed)?;
    let footage = &filming.footage;
    let (frame, clean) = (&footage.frames[1], &footage.clean[1]);
    let (flow, depth) = (&footage.flow[1], &footage.inverse_depth[1]);
    let (luma, sharp) = (frame.luma(), clean.luma());
    let weight = Plane::filled(SIZE.0, SIZE.1, 1.0 / 0.01f32.powi(2));
    let observations: Vec<FrameObservation> = FrameObservation::of_frames(&footage.frames).collect();
    let mut all = vec![];
    let mut time = |what: &str, paper: &str, step: &mut dyn FnMut()| {
        // The first repetition fills caches and is not counted.
        let ms = (0..=case.repetitions).map(|_| {
            let start = Instant::now();
            step();
            1000.0 * start.elapsed().as_secs_f64()
        });
        all.push(Timed { what: what.into(), paper: paper.into(), ms: ms.skip(1).collect() });
    };
    time("noise, clean frame given", "36.3 ms", &mut || {
        let mut evidence = NoiseEvidence::new(Method::Removal);
        black_box(evidence.add_denoised(frame, clean).map(|()| evidence.fit()).ok());
    });
    time("motion blur, clean frame and flow given", "235 ms", &mut || {
        black_box(motion_blur::fit_exposure(&luma, &weight, &sharp, flow));
    });
    time("defocus, clean frame and depth given", "895 ms", &mut || {
        black_box(defocus::fit_lens(&luma, &weight, &sharp, depth, None));
    });
    time(
        "whole estimate, blind, two frames with their flow and depth",
        "at most 1.5 s, without its networks",
        &mut || {
            let mut estimator = Estimator::new(Default::default());
            black_box(estimator.add(&observations[0]).and_then(|_| estimator.estimate()).ok());
        },
    );
    let mut tracker = Tracker::new(Default::default(), None);
    let mut next = 0;
    time("live estimate, one more frame", "not measured", &mut || {
        black_box(tracker.push(&observations[next % (frames as usize - 1)]).is_ok());
        next += 1;
    });
    // A frame of the paper's headset for one eye, with a square object of a fifth of the view.
    let (w, h) = (2064, 2208);
    let side = (0.2 * (w * h) as f32).sqrt() as usize;
    let inside = |x: usize, y: usize| x.abs_diff(w / 2) < side / 2 && y.abs_diff(h / 2) < side / 2;
    let large = Encoded(Raster::from_fn(w, h, |x, y| frame.0.at(x % SIZE.0, y % SIZE.1)));
    let linear = clean.to_linear(Transfer::Srgb);
    let layer = VirtualLayer {
        color: Premultiplied(Raster::from_fn(w, h, |x, y| match linear.0.at(x % SIZE.0, y % SIZE.1) {
            [r, g, b] if inside(x, y) => [r, g, b, 1.0],
            _ => [0.0; 4],
        })),
        inverse_depth: Some(Plane::from_fn(w, h, |x, y| if inside(x, y) { 1.0 } else { f32::NAN })),
        flow: Some(Raster::filled(w, h, [20.0, 4.0])),
    };
    let camera = model((w, h), &setting);
    let plate = Plate::new(&large, 0);
    time(
        "composite of 2064 x 2208 px, object of a fifth of the view",
        "22 ms for two eyes, on a headset's graphics card",
        &mut || {
            black_box(composite::composite(&plate, &layer, &camera, &CompositeOptions::default()).is_ok());
        },
    );
    #[cfg(feature = "gpu")]
    if let Some((card, ms)) = graphics::composite(&large, &layer, &camera, case.repetitions)? {
        all.push(Timed { what: format!("{TWO_EYES} {card}"), paper: "22 ms".into(), ms });
    }
    Ok(all)
}
