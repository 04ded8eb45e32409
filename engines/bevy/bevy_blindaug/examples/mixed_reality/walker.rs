//! A walking figure as a binary glTF file that is written here: a skin of eleven joints over tubes, and one cycle of a walk as its animation.

use bevy::math::{Quat, Vec3};
use serde_json::{Value, json};
use std::f32::consts::TAU;

/// The way of the figure during one cycle of the walk, m: four times what a foot reaches forward.
pub const STRIDE: f32 = 0.46;
/// The duration of a cycle, s.
pub const CYCLE: f32 = 0.9;

/// The corners around a tube.
const SIDES: usize = 14;
/// The moments of the animation, the first and the last of which are alike.
const MOMENTS: usize = 17;

/// A joint: its parent, and its place in the figure at rest, m.
const JOINTS: [(Option<usize>, Vec3); 11] = [
    (None, Vec3::new(0.0, 0.32, 0.0)),       // 0 hips
    (Some(0), Vec3::new(0.0, 0.38, 0.0)),    // 1 chest
    (Some(1), Vec3::new(0.0, 0.53, 0.0)),    // 2 head
    (Some(0), Vec3::new(0.045, 0.31, 0.0)),  // 3 left thigh
    (Some(3), Vec3::new(0.045, 0.17, 0.0)),  // 4 left shin
    (Some(0), Vec3::new(-0.045, 0.31, 0.0)), // 5 right thigh
    (Some(5), Vec3::new(-0.045, 0.17, 0.0)), // 6 right shin
    (Some(1), Vec3::new(0.095, 0.49, 0.0)),  // 7 left upper arm
    (Some(7), Vec3::new(0.095, 0.38, 0.0)),  // 8 left forearm
    (Some(1), Vec3::new(-0.095, 0.49, 0.0)), // 9 right upper arm
    (Some(9), Vec3::new(-0.095, 0.38, 0.0)), // 10 right forearm
];

/// Triangles with their skin, of one colour.
#[derive(Default)]
struct Part {
    places: Vec<[f32; 3]>,
    normals: Vec<[f32; 3]>,
    joints: Vec<[u8; 4]>,
    weights: Vec<[f32; 4]>,
    corners: Vec<u16>,
}

impl Part {
    /// Adds a tube with round ends around an upright axis from `top` down to `bottom`, m. It follows joint `upper` at its top and `lower` at
    /// its bottom, and both around the height of the joint `lower`. `squash` is its depth over its width.
    fn tube(&mut self, top: Vec3, bottom: f32, radii: [f32; 2], [upper, lower]: [usize; 2], squash: f32) {
        let rings = 18;
        let begin = self.places.len();
        for ring in 0..=rings {
            // The ends are quarters of a circle, the rest is straight.
            let along = ring as f32 / rings as f32;
            let angle = (along - 0.5) * 0.5 * TAU;
            let (sin, cos) = angle.sin_cos();
            let radius = radii[0] + (radii[1] - radii[0]) * along;
            let middle = if sin < 0.0 { top.y - radii[0] } else { bottom + radii[1] };
            let y = middle - radius * sin;
            let width = radius * cos.max(0.0).powf(0.35);
            let bend = JOINTS[lower].1.y;
            let low = ((bend + 0.02 - y) / 0.04).clamp(0.0, 1.0);
            for side in 0..SIDES {
                let (s, c) = (TAU * side as f32 / SIDES as f32).sin_cos();
                self.places.push([top.x + width * c, y, top.z + squash * width * s]);
                let normal = Vec3::new(c * cos, -sin, s * cos / squash).normalize_or(Vec3::Y);
                self.normals.push(normal.to_array());
                self.joints.push([upper as u8, lower as u8, 0, 0]);
                self.weights.push(if upper == lower {
                    [1.0, 0.0, 0.0, 0.0]
                } else {
                    [1.0 - low, low, 0.0, 0.0]
                });
            }
        }
        for (ring, side) in (0..rings).flat_map(|ring| (0..SIDES).map(move |side| (ring, side))) {
            let at = |ring: usize, side: usize| (begin + ring * SIDES + side % SIDES) as u16;
            let [a, b, c, d] =
                [at(ring, side), at(ring, side + 1), at(ring + 1, side), at(ring + 1, side + 1)];
            self.corners.extend([a, b, c, b, d, c]);
        }
    }
}

/// The parts of the figure with their colours, linear R, G, B.
fn parts() -> [([f32; 3], Part); 3] {
    let [mut skin, mut shirt, mut trousers] = [Part::default(), Part::default(), Part::default()];
    skin.tube(Vec3::new(0.0, 0.65, 0.0), 0.53, [0.055, 0.045], [2, 2], 1.0);
    skin.tube(Vec3::new(0.0, 0.56, 0.0), 0.48, [0.025, 0.03], [2, 1], 1.0);
    shirt.tube(Vec3::new(0.0, 0.53, 0.0), 0.29, [0.085, 0.07], [1, 0], 0.65);
    for (side, thigh, arm) in [(1.0, 3, 7), (-1.0, 5, 9)] {
        trousers.tube(Vec3::new(0.045 * side, 0.35, 0.0), 0.03, [0.045, 0.03], [thigh, thigh + 1], 1.0);
        // The foot follows the shin.
        skin.tube(Vec3::new(0.045 * side, 0.05, 0.02), 0.0, [0.03, 0.028], [thigh + 1; 2], 1.8);
        shirt.tube(Vec3::new(0.095 * side, 0.515, 0.0), 0.36, [0.032, 0.025], [arm, arm + 1], 1.0);
        skin.tube(Vec3::new(0.095 * side, 0.37, 0.0), 0.24, [0.022, 0.026], [arm + 1; 2], 1.0);
    }
    [([0.62, 0.34, 0.22], skin), ([0.55, 0.05, 0.04], shirt), ([0.03, 0.06, 0.16], trousers)]
}

/// The turn of a joint at a moment of the walk, 0 to 1.
fn turn(joint: usize, moment: f32) -> Quat {
    let swing = |phase: f32| (TAU * (moment + phase)).sin();
    match joint {
        1 => Quat::from_rotation_y(0.12 * swing(0.0)) * Quat::from_rotation_x(0.06),
        2 => Quat::from_rotation_y(-0.1 * swing(0.0)),
        // A thigh that points forward has a negative angle; the knee bends while the leg comes forward.
        3 => Quat::from_rotation_x(-0.42 * swing(0.0)),
        4 => Quat::from_rotation_x(0.12 + 0.65 * swing(0.25).max(0.0)),
        5 => Quat::from_rotation_x(-0.42 * swing(0.5)),
        6 => Quat::from_rotation_x(0.12 + 0.65 * swing(0.75).max(0.0)),
        7 => Quat::from_rotation_x(-0.4 * swing(0.5)) * Quat::from_rotation_z(0.1),
        9 => Quat::from_rotation_x(-0.4 * swing(0.0)) * Quat::from_rotation_z(-0.1),
        8 | 10 => Quat::from_rotation_x(-0.4),
        _ => Quat::IDENTITY,
    }
}

/// The buffer of the file, and what the JSON part says of its pieces.
#[derive(Default)]
struct Pieces {
    bytes: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
}

impl Pieces {
    /// Adds a piece of `count` elements, and returns its number. `more` is what else is said of it.
    fn add(&mut self, bytes: Vec<u8>, component: u32, kind: &str, count: usize, more: Value) -> usize {
        self.views.push(json!({ "buffer": 0, "byteOffset": self.bytes.len(), "byteLength": bytes.len() }));
        let mut accessor = json!({ "bufferView": self.views.len() - 1, "componentType": component, "count": count, "type": kind });
        if let (Value::Object(to), Value::Object(more)) = (&mut accessor, more) {
            to.extend(more);
        }
        self.accessors.push(accessor);
        self.bytes.extend(bytes);
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        self.accessors.len() - 1
    }

    fn floats<const N: usize>(&mut self, values: &[[f32; N]], kind: &str, more: Value) -> usize {
        let bytes = values.as_flattened().iter().flat_map(|v| v.to_le_bytes()).collect();
        self.add(bytes, FLOAT, kind, values.len(), more)
    }
}

/// The numbers of glTF's component types.
const BYTE: u32 = 5121;
const SHORT: u32 = 5123;
const FLOAT: u32 = 5126;

/// The file: a binary glTF of version 2 with one scene, one skinned mesh and one animation.
pub fn glb() -> Vec<u8> {
    let mut pieces = Pieces::default();
    let (mut primitives, mut materials) = (vec![], vec![]);
    for (color, part) in parts() {
        let bound = |pick: fn(f32, f32) -> f32| {
            part.places
                .iter()
                .copied()
                .reduce(|a, b| std::array::from_fn(|i| pick(a[i], b[i])))
                .unwrap_or_default()
        };
        let bounds = json!({ "min": bound(f32::min), "max": bound(f32::max) });
        let corners = part.corners.iter().flat_map(|c| c.to_le_bytes()).collect();
        primitives.push(json!({
            "attributes": {
                "POSITION": pieces.floats(&part.places, "VEC3", bounds),
                "NORMAL": pieces.floats(&part.normals, "VEC3", json!({})),
                "JOINTS_0": pieces.add(part.joints.concat(), BYTE, "VEC4", part.joints.len(), json!({})),
                "WEIGHTS_0": pieces.floats(&part.weights, "VEC4", json!({})),
            },
            "indices": pieces.add(corners, SHORT, "SCALAR", part.corners.len(), json!({})),
            "material": materials.len(),
        }));
        let [r, g, b] = color;
        materials.push(json!({
            "pbrMetallicRoughness": { "baseColorFactor": [r, g, b, 1.0], "metallicFactor": 0.0, "roughnessFactor": 0.7 },
        }));
    }
    let inverse = JOINTS.map(|(_, at)| {
        let [x, y, z] = at.to_array();
        [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, -x, -y, -z, 1.0]
    });
    let inverse = pieces.floats(&inverse, "MAT4", json!({}));
    let moments: Vec<[f32; 1]> = (0..MOMENTS).map(|i| [CYCLE * i as f32 / (MOMENTS - 1) as f32]).collect();
    let times = pieces.floats(&moments, "SCALAR", json!({ "min": [0.0], "max": [CYCLE] }));
    let (mut samplers, mut channels) = (vec![], vec![]);
    for joint in 0..JOINTS.len() {
        let turns: Vec<_> =
            (0..MOMENTS).map(|i| turn(joint, i as f32 / (MOMENTS - 1) as f32).to_array()).collect();
        let output = pieces.floats(&turns, "VEC4", json!({}));
        channels.push(json!({ "sampler": samplers.len(), "target": { "node": joint, "path": "rotation" } }));
        samplers.push(json!({ "input": times, "output": output, "interpolation": "LINEAR" }));
    }
    // The hips rise twice in a cycle.
    let rises: Vec<_> = (0..MOMENTS)
        .map(|i| {
            let rise = 0.008 * (2.0 * TAU * i as f32 / (MOMENTS - 1) as f32).cos();
            (JOINTS[0].1 + Vec3::Y * rise).to_array()
        })
        .collect();
    let output = pieces.floats(&rises, "VEC3", json!({}));
    channels.push(json!({ "sampler": samplers.len(), "target": { "node": 0, "path": "translation" } }));
    samplers.push(json!({ "input": times, "output": output, "interpolation": "LINEAR" }));

    let mut nodes: Vec<Value> = (0..JOINTS.len())
        .map(|joint| {
            let (parent, at) = JOINTS[joint];
            let place = at - parent.map_or(Vec3::ZERO, |p| JOINTS[p].1);
            let children: Vec<usize> = (0..JOINTS.len()).filter(|&j| JOINTS[j].0 == Some(joint)).collect();
            let mut node = json!({ "name": format!("joint {joint}"), "translation": place.to_array() });
            if let (Value::Object(node), false) = (&mut node, children.is_empty()) {
                node.insert("children".into(), json!(children));
            }
            node
        })
        .collect();
    nodes.push(json!({ "name": "walker", "mesh": 0, "skin": 0 }));
    let text = json!({
        "asset": { "version": "2.0", "generator": "blindaug: mixed_reality" },
        "scene": 0,
        "scenes": [{ "nodes": [0, JOINTS.len()] }],
        "nodes": nodes,
        "meshes": [{ "primitives": primitives }],
        "materials": materials,
        "skins": [{ "joints": (0..JOINTS.len()).collect::<Vec<_>>(), "inverseBindMatrices": inverse }],
        "animations": [{ "name": "walk", "samplers": samplers, "channels": channels }],
        "buffers": [{ "byteLength": pieces.bytes.len() }],
        "bufferViews": pieces.views,
        "accessors": pieces.accessors,
    });
    let mut text = text.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    let chunk = |kind: &[u8; 4], bytes: Vec<u8>| {
        [&(bytes.len() as u32).to_le_bytes()[..], &kind[..], &bytes[..]].concat()
    };
    let chunks = [chunk(b"JSON", text), chunk(b"BIN\0", pieces.bytes)].concat();
    let length = (12 + chunks.len()) as u32;
    [&b"glTF"[..], &2u32.to_le_bytes()[..], &length.to_le_bytes()[..], &chunks[..]].concat()
}
