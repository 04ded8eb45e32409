//! The experiments of `blindaug reproduce`, one module each: cases, measurements, findings.

mod baselines;
mod cameras;
mod halves;
mod qualitative;
mod runtime;
mod settings;

use crate::run::{Findings, Run};
use crate::validation::{self, Job};
use blindaug_io::Result;
use blindaug_pipeline::Networks;
use blindaug_scenes::measure::Given;
use std::path::PathBuf;

/// An experiment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Experiment {
    /// Scenes with the object pasted, with our composite, and with the object really there.
    Qualitative,
    /// Recovered against true parameters, over levels of exposure, noise, focus and aperture.
    Settings,
    /// The model of each of four cameras on the footage of each.
    Cameras,
    /// Our composites beside those of the baselines.
    Baselines,
    /// The paper's validation.
    Validation,
    /// How long everything takes.
    Runtime,
}

impl Experiment {
    /// All experiments, in the order of the paper.
    pub const ALL: [Self; 6] =
        [Self::Qualitative, Self::Settings, Self::Cameras, Self::Baselines, Self::Validation, Self::Runtime];

    /// The name on the command line, and that of the experiment's folder.
    pub fn name(self) -> &'static str {
        match self {
            Self::Qualitative => qualitative::NAME,
            Self::Settings => settings::NAME,
            Self::Cameras => cameras::NAME,
            Self::Baselines => baselines::NAME,
            Self::Validation => validation::NAME,
            Self::Runtime => runtime::NAME,
        }
    }

    /// What the experiment shows, in a few words.
    pub fn about(self) -> &'static str {
        match self {
            Self::Qualitative => "pictures and videos: the object pasted, composited by us, and really there",
            Self::Settings => {
                "exposure, noise, focus and aperture at three levels each: recovered against true"
            }
            Self::Cameras => "the model of each of four cameras on the footage of each: the own one must win",
            Self::Baselines => {
                "our composites beside those of five other methods, against the object really there"
            }
            Self::Validation => "the paper's validation: 10 exposures, 5 lenses, 10 noises",
            Self::Runtime => "how long the fits, an estimate and a composite take",
        }
    }

    /// The duration on two cores of a server of 2023, minutes.
    pub fn minutes(self, quick: bool) -> f64 {
        match (self, quick) {
            (Self::Qualitative, true) => 1.5,
            (Self::Qualitative, false) => 20.0,
            (Self::Settings, true) => 0.5,
            (Self::Settings, false) => 30.0,
            (Self::Cameras, true) => 2.0,
            (Self::Cameras, false) => 20.0,
            (Self::Baselines, true) => 2.0,
            (Self::Baselines, false) => 20.0,
            (Self::Validation, true) => 1.0,
            (Self::Validation, false) => 180.0,
            (Self::Runtime, true) => 0.3,
            (Self::Runtime, false) => 1.0,
        }
    }

    /// Runs the experiment, or what is left of it. `footage` are real clips, each of another camera, for [`Experiment::Cameras`].
    ///
    /// # Errors
    /// If a file cannot be read or written.
    pub fn run(
        self,
        run: &Run,
        quick: bool,
        footage: &[PathBuf],
        networks: &mut Networks,
    ) -> Result<Findings> {
        match self {
            Self::Qualitative => qualitative::run(run, quick),
            Self::Settings => settings::run(run, quick),
            Self::Cameras => cameras::run(run, quick, footage),
            Self::Baselines => baselines::run(run, quick, networks),
            Self::Validation => {
                let job = Job {
                    scenes: 10,
                    frames: 10,
                    quick,
                    coded: vec![],
                    paper_alone: true,
                    given: vec![Given::Everything, Given::Nothing, Given::NothingByNetworks],
                    clips: vec![],
                    networks: vec![networks.names()],
                };
                Ok(validation::findings(&validation::run(run, &job, networks)?))
            }
            Self::Runtime => runtime::run(run, quick),
        }
    }
}
