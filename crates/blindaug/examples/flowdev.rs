use blindaug::{Plane, analysis::flow};
fn read(p: &str, w: usize, h: usize) -> Plane {
    let b = std::fs::read(p).unwrap();
    Plane::from_vec(w, h, b.chunks(4).map(|c| f32::from_le_bytes(c.try_into().unwrap())).collect()).unwrap()
}
fn main() {
    let d = "/tmp/fd/";
    let list = std::fs::read_to_string(std::env::var("PAIRS").unwrap_or(format!("{d}pairs.txt"))).unwrap();
    let pick = std::env::args().nth(1).unwrap_or_default();
    let reps: usize = std::env::args().nth(2).and_then(|s| s.parse().ok()).unwrap_or(1);
    let mut best = f64::MAX;
    for line in list.lines() {
        let f: Vec<&str> = line.split(' ').collect();
        if !f[0].contains(&pick) { continue; }
        let (w, h) = (f[1].parse().unwrap(), f[2].parse().unwrap());
        let (a, b) = (read(&format!("{d}{}.a", f[0]), w, h), read(&format!("{d}{}.b", f[0]), w, h));
        let mut out = None;
        for _ in 0..reps {
            let t = std::time::Instant::now();
            out = Some(flow::flow(&a, &b).unwrap());
            if w == 512 { best = best.min(t.elapsed().as_secs_f64() * 1e3); }
        }
        let bytes: Vec<u8> = out.unwrap().data().iter().flatten().flat_map(|v| v.to_le_bytes()).collect();
        std::fs::write(format!("{d}{}.out", f[0]), bytes).unwrap();
    }
    println!("best {best:.1} ms");
}
