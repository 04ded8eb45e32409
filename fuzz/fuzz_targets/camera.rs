#![no_main]
use blindaug_fuzz::{check, file, use_camera};

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    if let Some(model) = check(blindaug_io::read_camera(file(bytes, "json"))) {
        use_camera(&model);
    }
});
