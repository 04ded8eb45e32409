//! The textures that are composited.

use wgpu::Texture;

/// Depth as a texture of one channel, or a depth buffer. The inverse depth in 1/m is `scale * value + offset`, which holds for every
/// perspective projection: with reversed infinite depth, `scale` is 1 / near and `offset` 0.
#[derive(Clone, Copy, Debug)]
pub struct Depth<'a> {
    /// The values: any format of one float channel that can be loaded, NaN where depth is unknown. Half floats are enough for inverse depth.
    pub texture: &'a Texture,
    /// The inverse depth of a unit of the values, 1/m.
    pub scale: f32,
    /// The inverse depth where the value is 0, 1/m.
    pub offset: f32,
    /// The value of pixels in which nothing is, such as that to which a depth buffer is cleared. Colour and motion are not read there, which
    /// halves the cost of looking for the object. `None` if colours may be without depth, as those of transparent things often are.
    pub nothing: Option<f32>,
}

/// The motion of each pixel to the next frame.
#[derive(Clone, Copy, Debug)]
pub struct Velocity<'a> {
    /// The values: two float channels, NaN where motion is unknown.
    pub texture: &'a Texture,
    /// The motion of a unit of each channel, px per frame interval (x right, y down).
    pub scale: [f32; 2],
}

/// The textures that are composited, all of one size, with one array layer per eye.
#[derive(Clone, Copy, Debug)]
pub struct Inputs<'a> {
    /// The camera's frame: display-encoded values in a format that can be filtered and is not `Srgb` (which would decode them).
    pub frame: &'a Texture,
    /// The rendered object: premultiplied scene-linear R, G, B, A.
    pub color: &'a Texture,
    /// The object's depth. Without it, there is no defocus.
    pub depth: Option<Depth<'a>>,
    /// The object's motion. Without it, there is no motion blur.
    pub velocity: Option<Velocity<'a>>,
    /// Whether the layer's colours are zero where the compositor does not look at them: outside of [`crate::Frame::area`], and where its
    /// depth is [`Depth::nothing`]. Without an area and such a value, all colours are looked at, and this says nothing. Where blur acts on
    /// light, nothing is blurred apart, and the colours' format can be filtered, the compositor then needs no copy of them, unless a colour is
    /// not finite or an alpha is not between 0 and 1.
    pub cleared: bool,
    /// Whether parts of the object behind the focus, in focus and in front of it are blurred apart from each other, so that something sharp
    /// does not bleed into blurred surroundings ([`blindaug::synth::Blur::of_layer`]). This takes three times the memory, and the time of
    /// as many layers as the object has such parts.
    pub apart: bool,
}
