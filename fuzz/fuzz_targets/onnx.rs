#![no_main]
use blindaug_fuzz::check;
use blindaug_nets::runtime::Session;
use std::path::Path;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    if let Some(session) = check(Session::new(Path::new("input.onnx"), bytes.to_vec())) {
        session.inputs();
    }
});
