#![no_main]
use blindaug_fuzz::{check, file, use_track};

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    if let Some(track) = check(blindaug_io::read_camera_track(file(bytes, "jsonl"))) {
        use_track(&track);
    }
});
