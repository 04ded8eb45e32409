//! The constants that shaders and Rust share, written as WGSL from Rust's, so that no number stands twice. What a shader alone needs (the
//! size of its workgroups, say) stays in the shader.
//!
//! By hand, since it is twenty lines: crates that make bindings (`wgsl_bindgen`, `encase`) go the other way, from shaders to Rust, or lay out
//! structs at run time.

use blindaug::LUMA;
use blindaug::fit::{motion_blur, spectral, spectral::numbers as fit};
use std::fmt::Write;

/// A Rust number as WGSL writes it.
pub(crate) trait Wgsl {
    fn wgsl(&self) -> String;
}

impl Wgsl for f32 {
    fn wgsl(&self) -> String {
        format!("{self:?}")
    }
}

impl Wgsl for usize {
    fn wgsl(&self) -> String {
        format!("{self}u")
    }
}

impl<const N: usize> Wgsl for [f32; N] {
    fn wgsl(&self) -> String {
        format!("vec{N}f({})", self.map(|v| v.wgsl()).join(", "))
    }
}

/// The constants' declarations, a line each.
pub(crate) fn constants(constants: &[(&str, &dyn Wgsl)]) -> String {
    let mut text = String::new();
    for (name, value) in constants {
        // Writing to a String cannot fail.
        let _ = writeln!(text, "const {name} = {};", value.wgsl());
    }
    text
}

/// What every shader that knows colours shares.
pub(crate) fn colours() -> String {
    constants(&[("LUMA", &LUMA)])
}

/// What the compositor's shaders share.
pub(crate) fn compositor() -> String {
    use crate::composite::{DISK_ROWS, DISK_STEP, DISKS, GAUSSIAN_MOST, GAUSSIANS, OCTAVES};
    constants(&[
        ("COARSEST", &(OCTAVES - 1)),
        ("GAUSSIANS", &GAUSSIANS),
        ("GAUSSIAN_MOST", &GAUSSIAN_MOST),
        ("DISKS", &DISKS),
        ("DISK_STEP", &DISK_STEP),
        ("DISK_ROWS", &DISK_ROWS),
        ("NOISE_TILE", &crate::noise::TILE),
    ])
}

/// What the fit of the exposure to clean frames shares.
pub(crate) fn motion_blur_fit() -> String {
    use crate::fit::motion_blur::CURVE;
    constants(&[("STEPS", &motion_blur::STEPS), ("CURVE", &CURVE), ("BLOCK", &motion_blur::BLOCK)])
}

/// What the kernels of the blind fits share.
pub(crate) fn blind_fits() -> String {
    use crate::fit::spectral::{GAINS, HEAD};
    constants(&[
        ("TILE", &spectral::TILE),
        ("LEVELS", &spectral::LEVELS),
        ("COLUMNS", &spectral::COLUMNS),
        ("EXPOSURE_TILES", &spectral::EXPOSURE_TILES),
        ("LENS_TILES_PER_BLOCK", &spectral::LENS_TILES_PER_BLOCK),
        ("BLOCK_COUNT", &spectral::BLOCK_COUNT),
        ("MIN_SPEED", &fit::SPEEDS.start),
        ("MAX_SPEED", &fit::SPEEDS.end),
        ("SAMPLES", &fit::SAMPLES),
        ("EXPOSURES", &spectral::EXPOSURES),
        ("SIGMAS", &spectral::SIGMAS),
        ("TILE_SIGMAS", &spectral::TILE_SIGMAS),
        ("HEAD", &HEAD),
        ("GAINS", &GAINS),
        ("TEMPER", &fit::TEMPER),
        ("MIN_CONTRAST", &fit::MIN_CONTRAST),
        ("MIDDLE", &fit::MIDDLE),
        ("ALPHA", &fit::ALPHA.0),
        ("ALPHA_STD", &fit::ALPHA.1),
        ("ALPHAS", &fit::ALPHAS),
        ("SHUTTER_FLOOR", &fit::SHUTTER_FLOOR),
        ("LEAK", &fit::LEAK),
        ("MAX_LAMBDA", &fit::MAX_LAMBDA),
        ("STREAK_STEP", &fit::STREAK_STEP),
        ("EXPOSURE_STEP", &fit::EXPOSURE_STEP),
        ("STREAK_ERROR", &fit::STREAK_ERROR),
        ("CLIP", &fit::CLIP),
        ("INFORMATIVE", &fit::INFORMATIVE),
        ("CORRELATED", &fit::CORRELATED),
        ("AMPLITUDE_PRECISION", &fit::AMPLITUDE_PRECISION),
        ("DIRECTION", &fit::DIRECTION),
        ("EXPOSURE_NOISE_ERROR", &fit::EXPOSURE_NOISE_ERROR.as_array()),
        ("LENS_NOISE_ERROR", &fit::LENS_NOISE_ERROR.as_array()),
        ("PIXEL_RESPONSE", &fit::PIXEL_RESPONSE),
        ("LARGER_BLUR", &fit::LARGER_BLUR),
    ])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_written_as_wgsl_reads_them() {
        let text = constants(&[("A", &0.1f32), ("B", &3usize), ("C", &[1.0f32, 2.5])]);
        assert_eq!(text, "const A = 0.1;\nconst B = 3u;\nconst C = vec2f(1.0, 2.5);\n");
    }

    #[test]
    fn no_shader_declares_a_constant_that_the_prelude_has() {
        let preludes = [colours(), compositor(), motion_blur_fit(), blind_fits()].concat();
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
}
