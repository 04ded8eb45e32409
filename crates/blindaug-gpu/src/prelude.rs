//! The constants that shaders and Rust share, written as WGSL from their Rust values, so that no number stands in two places. A constant
//! that only one shader needs (the size of its workgroups, say) stays in the shader.
//!
//! This is written by hand, since it takes twenty lines. Crates that make bindings (`wgsl_bindgen`, `encase`) go the other way, from
//! shaders to Rust, or lay out structs at run time.

use blindaug::LUMA;
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
        format!("vec{N}({})", self.map(|v| v.wgsl()).join(", "))
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

/// The WGSL declarations that all shaders with colours share.
pub(crate) fn colours() -> String {
    constants(&[("LUMA", &LUMA)])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_written_as_wgsl_reads_them() {
        let text = constants(&[("A", &0.1f32), ("B", &3usize), ("C", &[1.0f32, 2.5])]);
        assert_eq!(text, "const A = 0.1;\nconst B = 3u;\nconst C = vec2(1.0, 2.5);\n");
    }
}
