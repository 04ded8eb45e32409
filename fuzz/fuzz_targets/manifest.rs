#![no_main]
use blindaug_fuzz::{check, file};

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    check(blindaug_nets::Manifest::read(file(bytes, "toml")));
});
