//! Colour spaces beside OpenColorIO's numbers, which `tools/colour_reference.py` wrote.

use blindaug::{
    Encoded, Raster, Transfer,
    colour_space::{ColourSpace, Primaries, conversion, converted, doubts},
};

const REFERENCE: &str = include_str!("colour_reference.csv");

/// The largest difference from the reference's light in ACES2065-1, relative to the colour's brightest channel, if `space` stands for the
/// space of each name.
fn worst(space: impl Fn(&str) -> ColourSpace) -> (f32, String) {
    let mut worst = (0.0, String::new());
    for line in REFERENCE.lines().skip(1) {
        let (name, numbers) = line.split_once(',').unwrap();
        let n: Vec<f32> = numbers.split(',').map(|v| v.parse().unwrap()).collect();
        let space = space(name);
        let mut light = [n[0], n[1], n[2]].map(|v| space.transfer.decode(v));
        if let Some(matrix) = conversion(space.primaries, Primaries::AP0) {
            light = converted(&matrix, light);
        }
        let brightest = n[3..].iter().fold(0.0f32, |m, v| m.max(v.abs()));
        for (ours, theirs) in light.iter().zip(&n[3..]) {
            let error = (ours - theirs).abs() / brightest;
            if error > worst.0 {
                worst = (error, line.into());
            }
        }
    }
    worst
}

#[test]
fn every_space_agrees_with_open_color_io() {
    let named = |name: &str| name.parse::<ColourSpace>().unwrap();
    // Both compute in f32; the makers give their numbers with six digits.
    let (error, line) = worst(named);
    assert!(error < 1e-4, "{error} at {line}");
    // Every space that has a name is in the reference.
    for (name, ..) in ColourSpace::NAMED {
        assert!(REFERENCE.contains(&format!("\n{name},")), "{name}");
    }
    // Negative controls: another camera's curve, and other primaries.
    let other = |name: &str| ColourSpace { transfer: Transfer::Srgb, ..named(name) };
    assert!(worst(other).0 > 0.1);
    let other = |name: &str| ColourSpace { primaries: Primaries::REC709, ..named(name) };
    assert!(worst(other).0 > 0.1);
}

#[test]
fn conversions_go_back_and_white_stays_white() {
    let all: Vec<Primaries> = ColourSpace::NAMED.iter().map(|(_, s, _)| s.primaries).collect();
    for from in &all {
        for to in &all {
            let (Some(there), Some(back)) = (conversion(*from, *to), conversion(*to, *from)) else {
                assert_eq!(from.xy, to.xy);
                continue;
            };
            let light = [0.2, 0.7, 0.4];
            let again = converted(&back, converted(&there, light));
            assert!(again.iter().zip(light).all(|(a, b)| (a - b).abs() < 1e-5), "{from:?} {to:?}");
            let white = converted(&there, [1.0; 3]);
            assert!(white.iter().all(|v| (v - 1.0).abs() < 1e-5), "{from:?} {to:?}: {white:?}");
        }
    }
}

#[test]
fn names_are_read_as_people_write_them() {
    for (text, name) in
        [("S-Log3", "s-log3"), ("slog3", "s-log3"), ("Linear sRGB", "linear-srgb"), ("ACEScg", "acescg")]
    {
        assert_eq!(text.parse::<ColourSpace>().unwrap().name(), name);
    }
    let unknown = "redlogfilm".parse::<ColourSpace>().unwrap_err().to_string();
    assert!(unknown.contains("redlogfilm") && unknown.contains("log3g10"), "{unknown}");
}

#[test]
fn primaries_are_known_by_their_chromaticities() {
    // Roundings of a file: ACES AP1 as an EXR file has it, in f32.
    let ap1 = [[0.713, 0.293], [0.165, 0.83], [0.128, 0.044], [0.32168, 0.33767]];
    let rounded = ap1.map(|p| p.map(|v| f64::from(v as f32)));
    assert_eq!(Primaries::new(rounded).unwrap(), Primaries::AP1);
    let own = [[0.66, 0.33], [0.3, 0.62], [0.15, 0.05], [0.3127, 0.329]];
    assert_eq!(Primaries::new(own).unwrap().name(), None);
    let line = [[0.3, 0.3], [0.3, 0.3], [0.3, 0.3], [0.3127, 0.329]];
    for broken in [line, [[f64::NAN; 2]; 4], [[0.0; 2]; 4]] {
        assert!(Primaries::new(broken).unwrap_err().to_string().contains("chromaticities"));
    }
}

#[test]
fn a_wrong_colour_space_is_doubted() {
    let space = |name: &str| name.parse::<ColourSpace>().unwrap();
    // A scene of light from 0.002 to 3 times white, most of it around middle grey.
    let light = Raster::from_fn(200, 100, |x, y| {
        let stops = -6.5 + 8.0 * (x as f32 / 199.0) + 0.02 * y as f32;
        [0.18 * stops.exp2(); 3]
    });
    let coded = |of: Transfer| Encoded(light.map(|p| p.map(|v| of.encode(v).clamp(0.0, 1.0))));
    let doubt = |frame: Transfer, said: &str| {
        let said = space(said);
        // What is said to be light is encoded as sRGB when it is read.
        let read = ColourSpace { transfer: said.transfer.worked_on(), ..said };
        let frame = match said.transfer {
            Transfer::Linear => Encoded(coded(frame).0.map(|p| p.map(|v| read.transfer.encode(v)))),
            _ => coded(frame),
        };
        doubts(&read, &said, &frame)
    };
    let log = doubt(Transfer::SLog3, "acescg").expect("log is no light");
    assert!(log.contains("log footage") && log.contains("--colour-space"), "{log}");
    let display = doubt(Transfer::Srgb, "s-log3").expect("sRGB is no log");
    assert!(display.contains("s-log3"), "{display}");
    // Negative controls: what is said is true.
    for (transfer, name) in [
        (Transfer::SLog3, "s-log3"),
        (Transfer::LogC4, "logc4"),
        (Transfer::Linear, "linear-srgb"),
        (Transfer::Srgb, "srgb"),
        (Transfer::Pq, "pq"),
        (Transfer::Hlg, "hlg"),
    ] {
        assert_eq!(doubt(transfer, name), None, "{name}");
    }
}
