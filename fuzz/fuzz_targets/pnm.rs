#![no_main]
libfuzzer_sys::fuzz_target!(|bytes: &[u8]| blindaug_fuzz::image(bytes, "pnm"));
