//! The uniforms of single passes.

use crate::layout::wgsl_struct;

/// The side of the tile of noise, px.
pub const TILE: usize = 256;

wgsl_struct! {
    /// The numbers of a pass of the unsharp mask.
    pub(crate) struct MaskPass {
        /// The radius of the Gaussian's kernel, px.
        pub(crate) radius: u32,
        /// The amount of the mask.
        pub(crate) amount: f32,
        /// The weight of the source in a step of the iteration.
        pub(crate) of_source: f32,
        /// The weight of the blurred source.
        pub(crate) of_blurred: f32,
        /// The weight of the first step's result.
        pub(crate) of_first: f32,
    }
}

wgsl_struct! {
    /// A pyramid level, as the passes that make the tile of noise read it.
    pub(crate) struct TileLevel {
        /// The pixels along a side of the source.
        pub(crate) side: u32,
        /// The least local std that the source is divided by, so that windows with hardly any noise are not amplified.
        pub(crate) floor: f32,
        /// The factor that makes the std of the result 1: a normal number over its own window's std has a std slightly below 1.
        pub(crate) gain: f32,
        /// The lower half of the seed.
        pub(crate) seed: u32,
        /// The upper half of the seed.
        pub(crate) seed_high: u32,
    }
}
