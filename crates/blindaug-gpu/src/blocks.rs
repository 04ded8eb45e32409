//! The blocks of a frame, of which the passes skip those that are empty.

/// The side of a block, px.
pub(crate) const BLOCK: usize = 16;

/// The bit of a block in which a part of the layer is, or within 3 px of which it is.
pub(crate) const OCCUPIED: usize = 1;

/// The bit of a block for which that held in the frame before.
pub(crate) const OCCUPIED_BEFORE: usize = 2;

/// The bit of a block in which a part of the layer may be seen once it is blurred.
pub(crate) const VISIBLE: usize = 4;

/// The bit of a block in which the texture of the focused layer may hold something.
pub(crate) const FOCUSED: usize = 8;

/// The bit of a block all of whose pixels are covered by the layer, so that each has its own depth and motion.
pub(crate) const COVERED: usize = 16;

/// The bit of a block in which the sharpening changes something, so that its textures hold something there. All parts of an eye have one
/// such bit, that of the farthest part. It stays as it is in frames of cameras that do not sharpen, since the textures do, too.
pub(crate) const SHARPENED: usize = 32;

/// What the compositor found in a block of 16 x 16 px of a frame. It says which passes had work there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Block {
    /// The object is in the block, or within 3 px of it.
    pub occupied: bool,
    /// The blurred object may be seen in the block.
    pub visible: bool,
    /// The lens may blur what is seen in the block.
    pub focused: bool,
    /// Every pixel of the block has depth and motion of its own.
    pub covered: bool,
    /// What the object changes is sharpened in the block, for a camera that sharpens. The farthest part of an eye has this for all of them.
    pub sharpened: bool,
}

impl Block {
    /// The block with these bits.
    pub(crate) fn of_bits(bits: u32) -> Self {
        let has = |bit: usize| bits & bit as u32 != 0;
        Self {
            occupied: has(OCCUPIED),
            visible: has(VISIBLE),
            focused: has(FOCUSED),
            covered: has(COVERED),
            sharpened: has(SHARPENED),
        }
    }
}
