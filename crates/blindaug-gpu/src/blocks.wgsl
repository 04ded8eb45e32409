// Finds the blocks in which the blurred layer may be seen, and lists those whose focused layer is to be computed.

@group(0) @binding(0) var<uniform> camera: Camera;
@group(0) @binding(1) var<storage, read> numbers: array<u32>;
@group(0) @binding(2) var<storage, read_write> blocks: array<u32>;
// For each block of each part, whether the part occupies a block within reach in the same row.
@group(0) @binding(3) var<storage, read_write> near: array<u32>;
// The number of listed blocks, and then the blocks: the index of each and its bits. The blocks of a part are listed for the pass `defocus`, with
// LISTED_TO_BLUR if something may be seen there and LISTED_AS_COVERED. After that pass, those of an eye are listed for the sharpening, with
// LISTED_TO_SHARPEN or LISTED_TO_CLEAR.
@group(0) @binding(4) var<storage, read_write> list: array<atomic<u32>>;
// The workgroups along each axis that the list takes.
@group(0) @binding(5) var<storage, read_write> dispatch: array<atomic<u32>>;
// For each eye, the numbers of an indirect draw of the tiles in which any part may be seen: vertices, tiles, the first vertex and the first
// tile. An eye's first vertex tells the vertex shader which eye it is.
@group(0) @binding(6) var<storage, read_write> draws: array<atomic<u32>>;
// For each eye, the blocks that are drawn, as many as the frame has at most.
@group(0) @binding(7) var<storage, read_write> tiles: array<u32>;

// Adds a block to the list, for this many workgroups.
fn add_to_list(listed: u32, workgroups: u32) {
    let place = atomicAdd(&list[0], 1u);
    atomicStore(&list[place + 1u], listed);
    atomicMax(&dispatch[0], min(place + 1u, LIST_ROW));
    atomicMax(&dispatch[1], place / LIST_ROW + 1u);
    atomicMax(&dispatch[2], workgroups);
}

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
    var bits = (before & (OCCUPIED | OCCUPIED_BEFORE | COVERED | SHARPENED)) | select(0u, VISIBLE, seen);
    if camera.defocuses == 0u {
        bits |= before & FOCUSED;
    } else if blurs || (before & FOCUSED) != 0u {
        // Where nothing is seen any more, the pass writes zeros.
        bits |= select(0u, FOCUSED, blurs);
        let covered = select(0u, LISTED_AS_COVERED, (before & COVERED) != 0u);
        add_to_list(index | select(0u, LISTED_TO_BLUR, blurs) | covered, 4u);
    }
    blocks[index] = bits;
}

// Begins the draw of an eye's tiles, and draws a block of the eye if it is seen.
fn draw_tile(block: vec2<u32>, eye: u32, seen: bool) {
    let all = blocks_of(camera);
    if block.x + block.y == 0u {
        atomicStore(&draws[4u * eye], TILE_VERTICES);
        atomicStore(&draws[4u * eye + 2u], TILE_VERTICES * eye);
    }
    if seen {
        let place = atomicAdd(&draws[4u * eye + 1u], 1u);
        tiles[eye * all.x * all.y + place] = block.y * all.x + block.x;
    }
}

// Lists the blocks of each eye in which any of its parts may be seen.
@compute @workgroup_size(8, 8)
fn list_tiles(@builtin(global_invocation_id) id: vec3<u32>) {
    if all(id.xy < blocks_of(camera)) {
        draw_tile(id.xy, id.z, is_seen(id.xy, id.z));
    }
}

// Finds for each block of each eye whether anything is seen within the mask's reach in the same row.
@compute @workgroup_size(8, 8)
fn seen_in_row(@builtin(global_invocation_id) id: vec3<u32>) {
    let all = blocks_of(camera);
    if any(id.xy >= all) {
        return;
    }
    let n = camera.sharpening_blocks;
    var found = false;
    for (var x = id.x - min(n, id.x); x <= min(id.x + n, all.x - 1u); x++) {
        found = found || is_seen(vec2(x, id.y), id.z);
    }
    near[block_index(camera, id.xy, id.z)] = u32(found);
}

// Lists the blocks of each eye that the sharpening works on: those within the mask's reach of what is seen, those within its reach above
// and below these, whose rows are read, and those that are to be cleared.
@compute @workgroup_size(8, 8)
fn list_sharpened(@builtin(global_invocation_id) id: vec3<u32>) {
    let all = blocks_of(camera);
    if any(id.xy >= all) {
        return;
    }
    let n = camera.sharpening_blocks;
    var changes = false;
    var is_read = false;
    for (var y = id.y - min(2u * n, id.y); y <= min(id.y + 2u * n, all.y - 1u); y++) {
        let seen = near[block_index(camera, vec2(id.x, y), id.z)] != 0u;
        is_read = is_read || seen;
        changes = changes || (seen && max(y, id.y) - min(y, id.y) <= n);
    }
    let index = block_index(camera, id.xy, id.z * camera.slabs);
    let before = blocks[index];
    blocks[index] = (before & ~SHARPENED) | select(0u, SHARPENED, changes);
    let own = block_index(camera, id.xy, id.z);
    if changes {
        add_to_list(own | LISTED_TO_SHARPEN, 1u);
    } else if (before & SHARPENED) != 0u {
        add_to_list(own | LISTED_TO_CLEAR, 1u);
    } else if is_read {
        add_to_list(own, 1u);
    }
    draw_tile(id.xy, id.z, changes);
}
