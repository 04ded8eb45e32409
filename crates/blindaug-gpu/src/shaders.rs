//! The compositor's shaders. WGSL that browsers take too: no subgroups, no half floats, no formats of particular devices.

use crate::prelude::{colours, compositor};
use std::sync::LazyLock;

/// Joins a shader of the compositor: the prelude, what all shaders share, and its own text.
macro_rules! shader {
    ($($file:literal),+) => {
        LazyLock::new(|| {
            let shared = [include_str!("shared.wgsl"), include_str!("common.wgsl")];
            [colours(), compositor(), shared.concat(), [$(include_str!($file)),+].concat()].concat()
        })
    };
}

pub(crate) static EXTENSION: LazyLock<String> = shader!("extension.wgsl");
pub(crate) static DEFOCUS: LazyLock<String> = shader!("defocus.wgsl");
pub(crate) static NOISE_TILE: LazyLock<String> = shader!("noise_tile.wgsl");
pub(crate) static SHARPENING: LazyLock<String> = shader!("sharpening.wgsl");
pub(crate) static COMPOSITE: LazyLock<String> =
    shader!("motion_blur.wgsl", "noise.wgsl", "composite.wgsl", "sharpened.wgsl");

#[cfg(test)]
#[path = "../tests/common/wgsl.rs"]
mod wgsl;

#[cfg(test)]
mod tests {
    use super::wgsl::problem;
    use super::*;
    use crate::fit;

    #[test]
    fn every_shader_is_valid_for_every_device() {
        let texts: [&str; 10] = [
            &EXTENSION,
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
        // Every file is in the list.
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
        assert_eq!(found, 17);
        // Wrong shaders are found out.
        assert!(problem("fn f() -> f32 { return 1u; }").is_some());
        assert!(problem("enable f16; fn f(x: f16) -> f16 { return x; }").is_some());
    }
}
