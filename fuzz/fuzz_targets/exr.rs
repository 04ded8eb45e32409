#![no_main]
use blindaug_fuzz::{check, file};
use blindaug_io::{
    DepthFormat, ExrHead, exr_contents, read_flow, read_inverse_depth, read_linear, read_virtual_layer,
};

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let path = file(bytes, "exr");
    check(exr_contents(path));
    check(ExrHead::read(path));
    check(read_linear(path));
    check(read_flow(path));
    check(read_inverse_depth(path, DepthFormat::default()));
    check(read_virtual_layer(path));
});
