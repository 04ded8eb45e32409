//! An animated object in live footage: what `blindaug live` and the page in the browser share above the estimation
//! ([`blindaug_pipeline::live`]).
//!
//! | module | from | to |
//! |---|---|---|
//! | [`object`] | glTF | triangles, materials and an animation |
//! | [`light`] | a frame | the light on the object |
//! | [`render`] | the object, its poses and the light | its colour, inverse depth and velocity in a frame |
//! | [`compositor`] | that layer, a frame and a camera | the object pasted on, and as the camera would have filmed it |
//! | [`stage`] | a frame and what is estimated of it | both composites on one graphics device, and the picture of the two under a split line |

#[cfg(feature = "files")]
mod beside;
pub mod compositor;
pub mod light;
pub mod object;
pub mod render;
pub mod stage;

pub use light::Light;
pub use object::Object;
pub use stage::{Look, Stage};

#[cfg(test)]
#[path = "../../blindaug-gpu/tests/common/wgsl.rs"]
mod wgsl;

#[cfg(test)]
mod tests {
    use super::wgsl::problem;

    #[test]
    fn every_shader_is_valid_for_every_device() {
        // Each shader is a module of its own.
        for shader in [include_str!("render/object.wgsl"), include_str!("split.wgsl")] {
            assert_eq!(problem(shader), None);
        }
        // Wrong shaders must fail.
        assert!(problem("fn f() -> f32 { return 1u; }").is_some());
        assert!(problem("enable f16; fn f(x: f16) -> f16 { return x; }").is_some());
    }
}
