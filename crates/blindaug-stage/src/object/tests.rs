//! Tests of [`super`].

use super::*;
use image::ImageFormat;
use std::io::Cursor;
use std::path::Path;

#[test]
fn the_built_in_object_starts_again_without_a_jump_and_is_brought_to_unit_size() {
    let object = Object::built_in();
    let apart = |a: f32, b: f32| {
        let difference =
            |(a, b): (&Mat4, &Mat4)| (*a - *b).to_cols_array().iter().map(|v| v.abs()).fold(0.0, f32::max);
        object.joints(a).iter().zip(&object.joints(b)).map(difference).fold(0.0, f32::max)
    };
    assert!(apart(0.0, 3.9999) < 1e-3 && apart(0.0, 4.0) < 1e-6 && apart(0.5, 1.0) > 0.1);
    let unit = object.standing().0;
    let corners = object.vertices.iter().map(|v| unit.transform_point3(v.position.into()));
    assert!(corners.fold(0.0f32, |m, p| m.max(p.abs().max_element())) < 2.0);
}

/// A triangle that a joint moves 1 m to the right within 2 s.
fn file() -> Vec<u8> {
    let mut binary = Vec::new();
    let mut views = Vec::new();
    let mut add = |bytes: &[u8]| {
        views.push(format!(r#"{{"buffer":0,"byteOffset":{},"byteLength":{}}}"#, binary.len(), bytes.len()));
        binary.extend_from_slice(bytes);
    };
    let floats = |values: &[f32]| bytemuck::cast_slice::<_, u8>(values).to_vec();
    add(&floats(&[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0]));
    add(&floats(&[0.0, 2.0]));
    add(&floats(&[0.0, 0.0, 0.0, 1.0, 0.0, 0.0]));
    add(&[0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0]);
    add(&floats(&[1.0, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0]));
    let json = format!(
        r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0,1]}}],
        "nodes":[{{"mesh":0,"skin":0}},{{"children":[2]}},{{}}],
        "skins":[{{"joints":[1,2]}}],
        "materials":[{{"pbrMetallicRoughness":{{"baseColorFactor":[0.5,0.25,0.125,1],"metallicFactor":0}}}}],
        "meshes":[{{"primitives":[{{"attributes":{{"POSITION":0,"JOINTS_0":3,"WEIGHTS_0":4}},"material":0}}]}}],
        "animations":[{{"samplers":[{{"input":1,"output":2}}],"channels":[{{"sampler":0,"target":{{"node":2,"path":"translation"}}}}]}}],
        "buffers":[{{"byteLength":{}}}],"bufferViews":[{}],
        "accessors":[{{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3","min":[0,0,0],"max":[1,1,0]}},
        {{"bufferView":1,"componentType":5126,"count":2,"type":"SCALAR","min":[0],"max":[2]}},
        {{"bufferView":2,"componentType":5126,"count":2,"type":"VEC3"}},
        {{"bufferView":3,"componentType":5121,"count":3,"type":"VEC4"}},
        {{"bufferView":4,"componentType":5126,"count":3,"type":"VEC4"}}]}}"#,
        binary.len(),
        views.join(",")
    );
    let mut json = json.into_bytes();
    json.resize(json.len().next_multiple_of(4), b' ');
    let length = |n: usize| (n as u32).to_le_bytes();
    let mut file = b"glTF\x02\0\0\0".to_vec();
    file.extend(length(12 + 8 + json.len() + 8 + binary.len()));
    for (kind, chunk) in [(b"JSON", json), (b"BIN\0", binary)] {
        file.extend(length(chunk.len()));
        file.extend(kind);
        file.extend(chunk);
    }
    file
}

#[test]
fn a_skin_in_a_file_moves_as_it_says() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("skin.glb");
    std::fs::write(&path, file()).unwrap();
    let object = Object::load(&path).unwrap();
    assert_eq!((object.parts.len(), object.indices.len(), object.notes.len()), (1, 3, 0));
    assert_eq!(object.parts[0].material.base_color, [0.5, 0.25, 0.125, 1.0]);
    // Both joints have half of the weight, and the second one moves.
    let vertex = object.vertices[1];
    assert_eq!((vertex.joints, vertex.weights), ([0, 1, 0, 0], [0.5, 0.5, 0.0, 0.0]));
    assert_eq!(vertex.normal, [0.0, 0.0, 1.0]);
    for (seconds, x) in [(0.0, 0.0), (0.5, 0.25), (1.5, 0.75), (2.5, 0.25)] {
        let [joints, _] = object.moving(seconds, 0.04);
        assert_eq!((joints[0].w_axis.x, joints[1].w_axis.x), (0.0, x));
    }
    // The jump back at the end does not count as motion.
    let fps = 24.7;
    for frame in 0..200 {
        let [now, next] = object.moving(f64::from(frame) / fps, fps.recip());
        let speed = f64::from(next[1].w_axis.x - now[1].w_axis.x) * fps;
        assert!((speed - 0.5).abs() < 1e-4, "frame {frame}: {speed} m/s");
    }
}

#[test]
fn an_object_that_grows_out_of_a_point_has_the_size_that_it_grows_to() {
    let mut object = Object::square(Material::default());
    let still = object.standing().0;
    object.duration = 2.0;
    object.channels.push(Channel {
        node: 0,
        property: Property::Scale,
        interpolation: Interpolation::Linear,
        times: vec![0.0, 2.0],
        values: vec![Vec4::ZERO, Vec4::splat(3.0)],
    });
    assert_eq!((still.x_axis.x, object.standing().0.x_axis.x), (1.0, 1.0 / 3.0));
    // An object that always is a point has no size.
    object.channels[0].values[1] = Vec4::ZERO;
    assert_eq!(object.standing().0, Mat4::IDENTITY);
}

#[test]
fn damaged_files_end_in_a_sentence() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("hurt.glb");
    let whole = file();
    let load = |bytes: &[u8]| {
        std::fs::write(&path, bytes).unwrap();
        let object = Object::load(&path);
        if let Err(e) = &object {
            let e = e.to_string();
            assert!(e.contains("hurt.glb: ") && !e.contains('\n'), "{e}");
        }
        object
    };
    for i in 0..40 {
        assert!(load(&whole[..whole.len() * i / 40]).is_err());
    }
    // The last number is a weight.
    for number in [f32::NAN, f32::INFINITY] {
        let hurt = [&whole[..whole.len() - 4], &number.to_le_bytes()].concat();
        assert!(load(&hurt).unwrap_err().to_string().contains("not numbers"));
    }
    // Whatever is damaged, an object that is loaded can be drawn.
    let mut random = 1u32;
    let mut next = |n: usize| {
        random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (random >> 8) as usize % n
    };
    for _ in 0..300 {
        let mut hurt = whole.clone();
        hurt[next(whole.len())] = b"0123456789,[]{}\xff"[next(16)];
        if let Ok(object) = load(&hurt) {
            let joints = object.moving(0.7, 0.1)[1].len() as u32;
            assert!(object.indices.iter().all(|&i| (i as usize) < object.vertices.len()));
            assert!(object.parts.iter().all(|p| p.first_joint < joints && !p.indices.is_empty()));
            object.standing();
        }
    }
}

/// The number of corners of a file with this text, or the sentence of the error.
fn said(folder: &Path, text: &str) -> String {
    let path = folder.join("said.gltf");
    std::fs::write(&path, text).unwrap();
    match Object::load(&path) {
        Ok(object) => format!("{} corners", object.indices.len()),
        Err(e) => {
            let e = e.to_string();
            assert!(e.contains("said.gltf: ") && !e.contains(char::is_control), "{e}");
            e
        }
    }
}

/// The text of a file with a triangle and a texture, whose data these URIs name.
fn text(buffer: &str, texture: &str) -> String {
    format!(
        r#"{{"asset":{{"version":"2.0"}},"scenes":[{{"nodes":[0]}}],"nodes":[{{"mesh":0}}],
        "meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}},"material":0}}]}}],
        "materials":[{{"pbrMetallicRoughness":{{"baseColorTexture":{{"index":0}}}}}}],
        "textures":[{{"source":0}}],"images":[{{"uri":"{texture}"}}],
        "buffers":[{{"byteLength":36,"uri":"{buffer}"}}],"bufferViews":[{{"buffer":0,"byteLength":36}}],
        "accessors":[{{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3","min":[0,0,0],"max":[1,1,0]}}]}}"#
    )
}

#[test]
fn only_files_beside_the_object_and_below_are_opened() {
    let outside = tempfile::tempdir().unwrap();
    let folder = outside.path().join("object");
    std::fs::create_dir_all(folder.join("in it")).unwrap();
    let corners: Vec<u8> = bytemuck::cast_slice(&[0f32, 0., 0., 1., 0., 0., 0., 1., 0.]).to_vec();
    let mut picture = Cursor::new(Vec::new());
    image::RgbImage::from_pixel(2, 1, image::Rgb([9, 8, 7]))
        .write_to(&mut picture, ImageFormat::Png)
        .unwrap();
    let picture = picture.into_inner();
    for folder in [outside.path(), &folder, &folder.join("in it")] {
        std::fs::write(folder.join("corners.bin"), &corners).unwrap();
        std::fs::write(folder.join("a picture.png"), &picture).unwrap();
    }
    use base64::{Engine, engine::general_purpose::STANDARD};
    let data = |bytes: &[u8]| format!("data:;base64,{}", STANDARD.encode(bytes));
    for buffer in ["corners.bin", "./corners.bin", "in%20it/corners.bin", &data(&corners)] {
        for texture in ["a%20picture.png", "in it/a%20picture.png", &data(&picture)] {
            assert_eq!(said(&folder, &text(buffer, texture)), "3 corners", "{buffer} {texture}");
        }
    }
    let absolute = outside.path().join("corners.bin");
    let absolute = absolute.to_str().unwrap();
    let away = ["../corners.bin", "in it/../corners.bin", "%2e%2e/corners.bin", "..%2fcorners.bin", absolute];
    let schemes = [format!("file://{absolute}"), format!("file:{absolute}"), "file%3Acorners.bin".into()];
    for uri in away.into_iter().chain(schemes.iter().map(String::as_str)) {
        let e = said(&folder, &text(uri, "a%20picture.png"));
        assert!(e.contains("buffer") && e.contains("beside the file or below"), "{e}");
        let e = said(&folder, &text("corners.bin", uri));
        assert!(e.contains("texture") && e.contains("beside the file or below"), "{e}");
    }
    let many = format!("{}.bin", "x".repeat(10_000));
    for (uri, sentence) in [
        (r"none\u001b[31m\n.bin", r"none\u{1b}[31m .bin is not there"),
        ("%zz.bin", "is no URI"),
        (&many, " .. "),
        ("in it", "this is a folder"),
        ("data:;base64,A", "is damaged"),
        ("data:,abc", "not in Base64"),
        ("a%20picture.png%00", "cannot be read"),
    ] {
        let e = said(&folder, &text(uri, "a%20picture.png"));
        assert!(e.contains(sentence) && e.len() < 800, "{e}");
    }
    // One file is not a picture, and one picture is larger than any graphics card takes.
    let e = said(&folder, &text("corners.bin", "corners.bin"));
    assert!(e.contains("neither PNG nor JPEG"), "{e}");
    let mut large = picture.clone();
    large[16..20].copy_from_slice(&60_000u32.to_be_bytes());
    let e = said(&folder, &text("corners.bin", &data(&large)));
    assert!(e.contains("texture"), "{e}");
}

#[cfg(unix)]
#[test]
fn links_that_lead_away_and_pipes_are_not_opened() {
    use std::os::unix::fs::symlink;
    let outside = tempfile::tempdir().unwrap();
    let folder = outside.path().join("object");
    std::fs::create_dir(&folder).unwrap();
    let away = outside.path().join("corners.bin");
    std::fs::write(&away, [0; 36]).unwrap();
    std::fs::write(folder.join("own.bin"), [0; 36]).unwrap();
    symlink(&away, folder.join("away.bin")).unwrap();
    symlink("own.bin", folder.join("inside.bin")).unwrap();
    symlink(outside.path(), folder.join("up")).unwrap();
    let none = |uri: &str| said(&folder, &text(uri, "none.png"));
    assert!(none("inside.bin").contains("none.png is not there"), "{}", none("inside.bin"));
    for uri in ["away.bin", "up/corners.bin"] {
        assert!(none(uri).contains("is a link to a place"), "{}", none(uri));
    }
    let made = std::process::Command::new("mkfifo").arg(folder.join("pipe")).status();
    if made.is_ok_and(|s| s.success()) {
        assert!(none("pipe").contains("a pipe or a device"), "{}", none("pipe"));
        let e = Object::load(&folder.join("pipe")).unwrap_err().to_string();
        assert!(e.contains("pipe: ") && e.contains("a pipe or a device"), "{e}");
    }
}

#[test]
fn files_that_fuzzing_found_end_in_a_sentence() {
    let folder = tempfile::tempdir().unwrap();
    let found = concat!(env!("CARGO_MANIFEST_DIR"), "/../../fuzz/regressions/gltf");
    for entry in std::fs::read_dir(found).unwrap() {
        let bytes = std::fs::read(entry.unwrap().path()).unwrap();
        let path = folder.path().join("found.glb");
        std::fs::write(&path, bytes).unwrap();
        if let Ok(object) = Object::load(&path) {
            object.moving(0.3, 0.04);
            object.standing();
        }
    }
}

#[test]
fn values_that_are_not_in_the_file_are_not_read() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("corners.bin"), [0; 60]).unwrap();
    let of = |view: &str, count: u64, sparse: &str, stride: &str| {
        format!(
            r#"{{"asset":{{"version":"2.0"}},"scenes":[{{"nodes":[0]}}],"nodes":[{{"mesh":0}}],
            "meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}}}}]}}],
            "buffers":[{{"byteLength":60,"uri":"corners.bin"}}],
            "bufferViews":[{{"buffer":0,"byteLength":60{stride}}}],
            "accessors":[{{{view}"componentType":5126,"count":{count},"type":"VEC3","min":[0,0,0],"max":[1,1,0]{sparse}}}]}}"#
        )
    };
    let sparse = |count: u64| {
        format!(
            r#","sparse":{{"count":{count},"indices":{{"bufferView":0,"componentType":5121}},"values":{{"bufferView":0}}}}"#
        )
    };
    let load = |text: &str| said(folder.path(), text);
    let view = r#""bufferView":0,"#;
    assert_eq!(load(&of(view, 3, "", "")), "3 corners");
    assert_eq!(load(&of(view, 3, &sparse(3), "")), "3 corners");
    assert_eq!(load(&of("", 6, &sparse(3), "")), "6 corners");
    for count in [6, 3_000_000_000, u64::MAX] {
        assert!(load(&of(view, count, "", "")).contains("file is damaged") || count > 6);
        assert!(!load(&of(view, count, "", "")).contains("corners"));
        assert!(!load(&of(view, 5, &sparse(count), "")).contains("corners"));
    }
    for count in [5_000, 3_000_000_000, u64::MAX] {
        assert!(!load(&of("", count, &sparse(1), "")).contains("corners"), "{count}");
    }
    // Values that overlap one another are refused.
    assert!(!load(&of(view, 3, "", r#","byteStride":4"#)).contains("corners"));
    assert!(!load(&of(view, 3, "", r#","byteStride":0"#)).contains("corners"));
    let e = load(&of(r#""bufferView":0,"byteOffset":18446744073709551615,"#, 3, "", ""));
    assert!(!e.contains("corners"), "{e}");
}

/// An object of `nodes` nodes with a triangle each, the first of which has all others as children.
fn family(nodes: usize) -> String {
    let children = (1..nodes).map(|i| i.to_string()).collect::<Vec<_>>().join(",");
    let others = r#",{"mesh":0}"#.repeat(nodes - 1);
    text("corners.bin", "none.png")
        .replace(r#","material":0"#, "")
        .replace(r#"[{"mesh":0}]"#, &format!(r#"[{{"mesh":0,"children":[{children}]}}{others}]"#))
}

#[test]
fn many_nodes_and_triangles_that_are_drawn_again_and_again() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("corners.bin"), [0; 36]).unwrap();
    assert_eq!(said(folder.path(), &family(300_000)), "900000 corners");
    // The triangles are drawn at once; where two materials take turns, they cannot be.
    let object = Object::load(&folder.path().join("said.gltf")).unwrap();
    assert_eq!((object.parts.len(), object.joint_count()), (1, 300_000));
    assert_eq!(object.vertices[899_999].joints, [299_999; 4]);
    let turns = r#"{"attributes":{"POSITION":0}},{"attributes":{"POSITION":0},"material":0}"#;
    let turns = family(10_000).replace(r#"{"attributes":{"POSITION":0}}"#, turns);
    let turns = turns.replace(r#""baseColorTexture":{"index":0}"#, r#""metallicFactor":0"#);
    assert!(said(folder.path(), &turns).contains("too many parts"));
    // A mesh of many parts in each of many nodes takes too much memory.
    let part = r#"{"attributes":{"POSITION":0},"mode":0}"#;
    let many = family(30_000)
        .replace(r#"{"attributes":{"POSITION":0}}"#, &format!("{part}{}", format!(",{part}").repeat(9_999)));
    assert!(said(folder.path(), &many).contains("more than 2 GB"));
}

#[test]
fn values_are_interpolated_as_gltf_says() {
    let channel = |interpolation, values: &[f32]| Channel {
        node: 0,
        property: Property::Translation,
        interpolation,
        times: vec![1.0, 3.0],
        values: values.iter().map(|&v| Vec4::splat(v)).collect(),
    };
    let at = |c: &Channel, times: [f32; 4]| times.map(|t| c.at(t).x);
    assert_eq!(at(&channel(Interpolation::Linear, &[2.0, 4.0]), [0.0, 1.0, 1.5, 9.0]), [2.0, 2.0, 2.5, 4.0]);
    assert_eq!(at(&channel(Interpolation::Step, &[2.0, 4.0]), [0.0, 1.0, 2.9, 3.0]), [2.0, 2.0, 2.0, 4.0]);
    // A straight line, as a spline with tangents of its slope.
    let spline = channel(Interpolation::CubicSpline, &[1.0, 2.0, 1.0, 1.0, 4.0, 1.0]);
    assert_eq!(at(&spline, [0.0, 1.5, 2.0, 3.5]), [2.0, 2.5, 3.0, 4.0]);
}
