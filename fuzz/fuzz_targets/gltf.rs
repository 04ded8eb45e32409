#![no_main]
//! The reader of objects belongs to a crate that draws; here it is compiled alone, without a graphics device.
#![allow(dead_code, missing_docs)]

use blindaug_fuzz::{check, file};

#[path = "../../crates/blindaug-stage/src/beside.rs"]
mod beside;
#[path = "../../crates/blindaug-stage/src/object.rs"]
mod object;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    if let Some(object) = check(object::Object::load(file(bytes, "glb"))) {
        let [now, next] = object.moving(0.3, 0.04);
        assert_eq!(now.len(), next.len());
        object.standing();
    }
});
