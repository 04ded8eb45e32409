// Finds the blocks in which the blurred layer may be seen, and lists those whose focused layer is to be computed.

@group(0) @binding(0) var<uniform> camera: Camera;
@group(0) @binding(1) var<storage, read> numbers: array<u32>;
@group(0) @binding(2) var<storage, read_write> blocks: array<u32>;
// For each block of each part, whether the part occupies a block within reach in the same row.
@group(0) @binding(3) var<storage, read_write> near: array<u32>;
// The number of listed blocks, and then the blocks: the index of each, LISTED_TO_BLUR if something may be seen there, and LISTED_AS_COVERED.
@group(0) @binding(4) var<storage, read_write> list: array<atomic<u32>>;
// The workgroups of the pass `defocus` along each axis.
@group(0) @binding(5) var<storage, read_write> dispatch: array<atomic<u32>>;
// For each eye, the numbers of an indirect draw of the tiles in which any part may be seen: vertices, tiles, the first vertex and the first
// tile. An eye's first vertex tells the vertex shader which eye it is.
@group(0) @binding(6) var<storage, read_write> draws: array<atomic<u32>>;
// For each eye, the blocks that are drawn, as many as the frame has at most.
@group(0) @binding(7) var<storage, read_write> tiles: array<u32>;

// Whether defocus changes a part: the lens blurs it, or it is continued under nearer parts.
fn is_defocused(part: u32) -> bool {
    var changed = numbers[number_of(part, LARGEST_STD)] != 0u;
    for (var nearer = part + 1u; nearer < end_of_eye(camera, part); nearer++) {
        changed = changed || numbers[number_of(nearer, LARGEST_ALPHA)] != 0u;
    }
    return changed;
}

// The range of blocks, first to last, along one axis, within which a part may be seen in a block. A part is also seen through the blurred
// edges of nearer parts, under which it is continued.
fn within_reach(part: u32, block: u32, all: u32) -> vec2<u32> {
    var through = 0.0;
    for (var nearer = part + 1u; nearer < end_of_eye(camera, part); nearer++) {
        through = max(through, bitcast<f32>(numbers[number_of(nearer, LARGEST_REACH)]));
    }
    let reach = bitcast<f32>(numbers[number_of(part, LARGEST_REACH)]) + through;
    let n = u32(min(ceil(reach / f32(BLOCK)), f32(all)));
    return vec2(block - min(n, block), min(block + n, all - 1u));
}

@compute @workgroup_size(8, 8)
fn near_in_row(@builtin(global_invocation_id) id: vec3<u32>) {
    let all = blocks_of(camera);
    if any(id.xy >= all) {
        return;
    }
    let range = within_reach(id.z, id.x, all.x);
    var found = 0u;
    for (var x = range.x; x <= range.y; x++) {
        found |= blocks[block_index(camera, vec2(x, id.y), id.z)];
    }
    near[block_index(camera, id.xy, id.z)] = found & OCCUPIED;
}

@compute @workgroup_size(8, 8)
fn list_blocks(@builtin(global_invocation_id) id: vec3<u32>) {
    let all = blocks_of(camera);
    if any(id.xy >= all) {
        return;
    }
    let range = within_reach(id.z, id.y, all.y);
    var found = 0u;
    for (var y = range.x; y <= range.y; y++) {
        found |= near[block_index(camera, vec2(id.x, y), id.z)];
    }
    let index = block_index(camera, id.xy, id.z);
    let before = blocks[index];
    let seen = found != 0u;
    let blurs = seen && is_defocused(id.z);
    var bits = (before & (OCCUPIED | OCCUPIED_BEFORE | COVERED)) | select(0u, VISIBLE, seen);
    if camera.defocuses == 0u {
        bits |= before & FOCUSED;
    } else if blurs || (before & FOCUSED) != 0u {
        // Where nothing is seen any more, the pass writes zeros.
        bits |= select(0u, FOCUSED, blurs);
        let place = atomicAdd(&list[0], 1u);
        atomicStore(&list[place + 1u], index | select(0u, LISTED_TO_BLUR, blurs) | select(0u, LISTED_AS_COVERED, (before & COVERED) != 0u));
        atomicMax(&dispatch[0], min(place + 1u, LIST_ROW));
        atomicMax(&dispatch[1], place / LIST_ROW + 1u);
        // Each block has four workgroups.
        atomicMax(&dispatch[2], 4u);
    }
    blocks[index] = bits;
}

// Lists the blocks of each eye in which any of its parts may be seen.
@compute @workgroup_size(8, 8)
fn list_tiles(@builtin(global_invocation_id) id: vec3<u32>) {
    let all = blocks_of(camera);
    if any(id.xy >= all) {
        return;
    }
    if id.x + id.y == 0u {
        atomicStore(&draws[4u * id.z], TILE_VERTICES);
        atomicStore(&draws[4u * id.z + 2u], TILE_VERTICES * id.z);
    }
    var bits = 0u;
    for (var slab = 0u; slab < camera.slabs; slab++) {
        bits |= blocks[block_index(camera, id.xy, id.z * camera.slabs + slab)];
    }
    if (bits & VISIBLE) != 0u {
        let place = atomicAdd(&draws[4u * id.z + 1u], 1u);
        tiles[id.z * all.x * all.y + place] = id.y * all.x + id.x;
    }
}
