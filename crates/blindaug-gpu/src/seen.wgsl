// Whether any part may be seen in a block of an eye. The shader that takes this in has the `camera` and the `blocks`.
fn is_seen(block: vec2<u32>, eye: u32) -> bool {
    var bits = 0u;
    for (var slab = 0u; slab < camera.slabs; slab++) {
        bits |= blocks[block_index(camera, block, eye * camera.slabs + slab)];
    }
    return (bits & VISIBLE) != 0u;
}
