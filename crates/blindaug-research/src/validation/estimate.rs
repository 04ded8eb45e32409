//! Runs an estimator on footage of known truth.

use blindaug::fit::{Estimation, Estimator, EstimatorOptions, Evidence, Family, FrameObservation};
use blindaug::model::DepthKind;
use blindaug::{Encoded, Result};
use blindaug_pipeline::{Networks, Observer, Operators};
use blindaug_scenes::measure::{self, Footage, Given, Measured};
use std::time::Instant;

/// The number of frames that removal looks at where nothing is clean: it takes six to eight times as long as the spectra, and its errors are
/// the same in each frame.
const REMOVAL_FRAMES: usize = 4;

/// The kinds of evidence that can be given with these networks, or without any.
pub fn given_with(networks: &Networks) -> Vec<Given> {
    let any = !networks.is_empty();
    Given::ALL.into_iter().filter(|g| any || !g.by_networks()).collect()
}

/// Estimates the camera of footage and compares it with the truth.
///
/// # Errors
/// Sound footage gives no error.
pub fn measure(
    footage: &Footage,
    given: Given,
    networks: &mut Networks,
    observer: &dyn Observer,
) -> Result<(Measured, Estimation)> {
    let start = Instant::now();
    let estimation = estimate(footage, given, networks, observer)?;
    let seconds = start.elapsed().as_secs_f32();
    Ok((measure::measure(footage, given, &estimation, seconds), estimation))
}

fn estimate(
    footage: &Footage,
    given: Given,
    networks: &mut Networks,
    observer: &dyn Observer,
) -> Result<Estimation> {
    let everything = given == Given::Everything;
    let by_networks = given.by_networks();
    let by_removal = everything || by_networks || given == Given::DepthAndFlowByRemoval;
    let slow = by_networks || given == Given::DepthAndFlowByRemoval;
    let used = if slow { footage.frames.len().min(REMOVAL_FRAMES) } else { footage.frames.len() };
    let numbered: Vec<(u64, &Encoded)> = (0..).zip(&footage.frames).collect();
    networks.clear();
    let mut estimator = Estimator::new(EstimatorOptions {
        family: if by_removal { Family::Removal } else { Family::Spectral },
        ..EstimatorOptions::default()
    })
    .expecting(used);
    let several = footage.frames.len() > 1;
    for (i, observation) in FrameObservation::of_frames(&footage.frames).enumerate().take(used) {
        // The motion in a single frame is unknown.
        let flow = (several && given <= Given::DepthAndFlowByNetworks).then(|| &footage.flow[i]);
        let depth = (given <= Given::Depth).then(|| (&footage.inverse_depth[i], DepthKind::Metric));
        let given = Evidence {
            flow,
            inverse_depth: depth,
            clean: everything.then(|| &footage.clean[i]),
            ..Evidence::default()
        };
        let evidence = if by_networks { networks.evidence(&numbered, i, given, observer) } else { given };
        estimator.add(&FrameObservation { evidence, ..observation })?;
    }
    estimator.estimate()
}
