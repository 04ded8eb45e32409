//! The experiments of `blindaug reproduce`, one module each: cases, measurements, findings.

mod baselines;
mod cameras;
mod halves;
mod qualitative;
mod runtime;
mod settings;

use crate::run::{Findings, Run};
use crate::sceneries;
use crate::validation::{self, Job};
use blindaug_io::Result;
use blindaug_pipeline::Networks;
use blindaug_scenes::measure::Given;
use std::path::PathBuf;

/// How much of an experiment is done.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Scale {
    /// The number of scenes.
    pub(crate) scenes: u64,
    /// The number of frames of each scene.
    pub(crate) frames: u64,
    /// Width and height, px.
    pub(crate) size: (usize, usize),
}

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
            (Self::Qualitative, true) => 1.7,
            (Self::Qualitative, false) => 11.0,
            (Self::Settings, true) => 0.5,
            (Self::Settings, false) => 20.0,
            (Self::Cameras, true) => 1.3,
            (Self::Cameras, false) => 20.0,
            (Self::Baselines, true) => 1.6,
            (Self::Baselines, false) => 6.0,
            (Self::Validation, true) => 0.4,
            (Self::Validation, false) => 130.0,
            (Self::Runtime, true) => 0.4,
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
        let all = sceneries::COUNT as u64;
        let scale = |small: (u64, u64), full: (u64, u64)| {
            let (scenes, frames) = if quick { small } else { full };
            Scale { scenes, frames, size: if quick { (320, 240) } else { (512, 384) } }
        };
        match self {
            Self::Qualitative => qualitative::run(run, scale((all, 6), (all, 24))),
            Self::Settings => {
                let scale = scale((1, 4), (5, 8));
                settings::run(run, if quick { Scale { size: (256, 192), ..scale } } else { scale })
            }
            Self::Cameras => cameras::run(run, scale((2, 4), (6, 8)), footage),
            Self::Baselines => baselines::run(run, scale((all, 6), (all, 10)), networks),
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::run::Provenance;
    use crate::table::Cell;
    use blindaug_pipeline::Silent;

    const TINY: Scale = Scale { scenes: 1, frames: 2, size: (112, 84) };

    /// Runs an experiment in a folder of its own, and writes what it found.
    fn found(experiment: impl FnOnce(&Run) -> Result<Findings>) -> Findings {
        let folder = tempfile::tempdir().unwrap();
        let run = Run::new(folder.path(), Provenance::here(1), false, &Silent).unwrap();
        let findings = experiment(&run).unwrap();
        run.write("test", "Test", std::slice::from_ref(&findings)).unwrap();
        findings
    }

    /// The number in a cell, without its spread.
    fn number(cell: &Cell) -> f64 {
        match cell {
            Cell::Number(v, _) | Cell::Interval(v, ..) => *v,
            Cell::Spread(mean, _) => mean.mean,
            _ => f64::NAN,
        }
    }

    #[test]
    fn the_true_camera_beats_the_pasted_object() {
        let f = found(|run| baselines::run(run, TINY, &mut Networks::default()));
        let psnr = |method: &str| {
            let row = f.tables[0].rows.iter().find(|r| r[0] == Cell::text(method)).unwrap();
            number(&row[1])
        };
        assert!(psnr("True camera") > psnr("Naive") + 3.0, "{}", f.tables[0].text());
        assert!(psnr("Okumura++-like") > psnr("Naive"), "{}", f.tables[0].text());
    }

    #[test]
    fn pictures_of_a_scene_are_written() {
        let f = found(|run| qualitative::run(run, TINY));
        assert_eq!(f.pictures[0].files.len(), 3);
        assert!(number(&f.tables[0].rows[0][1]) < 40.0, "{}", f.tables[0].text());
    }

    #[test]
    fn stronger_noise_reads_stronger() {
        let f = found(|run| settings::run(run, TINY));
        let noise: Vec<f64> = f.tables[1]
            .rows
            .iter()
            .filter(|r| r[0] == Cell::text("noise std at mid-grey, of 1") && r[2] == Cell::text("nothing"))
            .map(|r| number(&r[4]))
            .collect();
        assert!(noise.len() == 3 && noise[0] < noise[1] && noise[1] < noise[2], "{}", f.tables[1].text());
    }
}
