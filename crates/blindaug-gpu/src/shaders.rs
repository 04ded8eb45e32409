//! The compositor's shaders. They are WGSL that browsers accept too: no subgroups, no half floats, no formats of particular devices.

use crate::blocks::{BLOCK, COVERED, FOCUSED, OCCUPIED, OCCUPIED_BEFORE, SHARPENED, VISIBLE};
use crate::camera::Camera;
use crate::layout::{Layout, structs};
use crate::passes::{MENDED, PART_NUMBERS};
use crate::prelude::{colours, constants};
use crate::quality::{
    CONTINUED, DISK_ROWS, DISK_STEP, DISKS, DefocusQuality, GAUSSIAN_MOST, GAUSSIANS, OCTAVES, STEP_OF_STD,
};
use crate::uniforms::{MaskPass, TILE, TileLevel};
use blindaug::model::{NOISE_KNOTS, NOISE_LEVELS};
use blindaug::synth;
use std::sync::LazyLock;

/// The structs of the compositor's shaders.
const STRUCTS: [Layout; 4] = [Camera::LAYOUT, DefocusQuality::LAYOUT, MaskPass::LAYOUT, TileLevel::LAYOUT];

/// The WGSL declarations that the compositor's shaders share.
fn compositor() -> String {
    let constants = constants(&[
        ("NOISE_LEVELS", &NOISE_LEVELS),
        ("NOISE_KNOTS", &NOISE_KNOTS),
        ("MAX_SIGMA_PX", &synth::defocus::MAX_SIGMA_PX),
        ("SEEN", &synth::SEEN),
        ("OPAQUE", &synth::OPAQUE),
        ("COARSEST", &(OCTAVES - 1)),
        ("BLOCK", &BLOCK),
        ("OCCUPIED", &OCCUPIED),
        ("OCCUPIED_BEFORE", &OCCUPIED_BEFORE),
        ("VISIBLE", &VISIBLE),
        ("FOCUSED", &FOCUSED),
        ("COVERED", &COVERED),
        ("SHARPENED", &SHARPENED),
        ("PART_NUMBERS", &PART_NUMBERS),
        ("MENDED", &MENDED),
        ("CONTINUED", &CONTINUED),
        ("GAUSSIANS", &GAUSSIANS),
        ("GAUSSIAN_MOST", &GAUSSIAN_MOST),
        ("DISKS", &DISKS),
        ("DISK_STEP", &DISK_STEP),
        ("DISK_ROWS", &DISK_ROWS),
        ("NOISE_TILE", &TILE),
        ("STEP_OF_STD", &STEP_OF_STD),
    ]);
    constants + &structs(&STRUCTS)
}

/// Joins a shader of the compositor: the prelude, the files that all shaders share, and the shader's own text.
macro_rules! shader {
    ($($file:literal),+) => {
        LazyLock::new(|| {
            let shared = [include_str!("shared.wgsl"), include_str!("common.wgsl")];
            [colours(), compositor(), shared.concat(), [$(include_str!($file)),+].concat()].concat()
        })
    };
}

pub(crate) static EXTENSION: LazyLock<String> = shader!("continued.wgsl", "extension.wgsl");
pub(crate) static BLOCKS: LazyLock<String> = shader!("seen.wgsl", "blocks.wgsl");
pub(crate) static DEFOCUS: LazyLock<String> = shader!("continued.wgsl", "defocus.wgsl");
pub(crate) static NOISE_TILE: LazyLock<String> = shader!("noise_tile.wgsl");
pub(crate) static SHARPENING: LazyLock<String> = shader!("sharpening.wgsl");
pub(crate) static COMPOSITE: LazyLock<String> = shader!(
    "continued.wgsl",
    "motion_blur.wgsl",
    "noise.wgsl",
    "seen.wgsl",
    "composite.wgsl",
    "sharpened.wgsl"
);

#[cfg(test)]
#[path = "../tests/common/wgsl.rs"]
mod wgsl;

#[cfg(test)]
mod tests {
    use super::wgsl::problem;
    use super::*;
    use crate::fit;
    use crate::layout::tests::{as_naga_has_them, as_rust_has_them};

    #[test]
    fn every_shader_is_valid_for_every_device() {
        let texts: [&str; 11] = [
            &EXTENSION,
            &BLOCKS,
            &DEFOCUS,
            &NOISE_TILE,
            &SHARPENING,
            &COMPOSITE,
            &fit::defocus::SOURCE,
            &fit::motion_blur::SOURCE,
            &fit::spectral::TILES,
            &fit::spectral::EXPOSURE,
            &fit::spectral::LENS,
        ];
        for text in texts {
            assert_eq!(problem(text), None);
        }
        // Every .wgsl file is in the list.
        let mut found = 0;
        for folder in ["/src", "/src/fit", "/src/fit/spectral"] {
            for file in std::fs::read_dir(format!("{}{folder}", env!("CARGO_MANIFEST_DIR"))).unwrap() {
                let path = file.unwrap().path();
                if path.extension().is_some_and(|e| e == "wgsl") {
                    let text = std::fs::read_to_string(&path).unwrap();
                    assert!(texts.iter().any(|t| t.contains(&text)), "{} is in no list", path.display());
                    found += 1;
                }
            }
        }
        assert_eq!(found, 20);
        // Wrong shaders are found out.
        assert!(problem("fn f() -> f32 { return 1u; }").is_some());
        assert!(problem("enable f16; fn f(x: f16) -> f16 { return x; }").is_some());
    }

    #[test]
    fn no_shader_declares_a_constant_that_the_prelude_has() {
        let preludes = [
            colours(),
            compositor(),
            fit::motion_blur::shared(),
            fit::defocus::shared(),
            fit::spectral::shared(),
        ]
        .concat();
        let names = |text: &str| -> Vec<String> {
            let names = text.lines().filter_map(|l| l.strip_prefix("const "));
            names.filter_map(|l| Some(l.split([' ', ':', '=']).next()?.to_owned())).collect()
        };
        let shared = names(&preludes);
        assert!(shared.len() > 40);
        let mut own = vec![];
        for folder in ["/src", "/src/fit", "/src/fit/spectral"] {
            for file in std::fs::read_dir(format!("{}{folder}", env!("CARGO_MANIFEST_DIR"))).unwrap() {
                let path = file.unwrap().path();
                if path.extension().is_some_and(|e| e == "wgsl") {
                    own.extend(names(&std::fs::read_to_string(&path).unwrap()));
                }
            }
        }
        assert!(own.iter().any(|n| n == "THREADS"), "constants of a shader's own are found");
        let twice: Vec<_> = own.iter().filter(|n| shared.contains(n)).collect();
        assert!(twice.is_empty(), "{twice:?}");
    }

    #[test]
    fn rust_and_naga_lay_out_every_struct_alike() {
        let mut compared = 0;
        for layouts in
            [&STRUCTS[..], &fit::motion_blur::STRUCTS, &fit::defocus::STRUCTS, &fit::spectral::STRUCTS]
        {
            assert_eq!(as_naga_has_them(&structs(layouts)), as_rust_has_them(layouts));
            compared += layouts.len();
        }
        assert_eq!(compared, 9);
    }
}
