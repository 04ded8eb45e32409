//! A check that WGSL is valid for every device.

use naga::valid::{Capabilities, ValidationFlags, Validator};

/// Says what is wrong with a shader, if anything is.
pub fn problem(source: &str) -> Option<String> {
    let module = match naga::front::wgsl::parse_str(source) {
        Ok(module) => module,
        Err(e) => return Some(e.emit_to_string(source)),
    };
    // The validator has no optional capabilities, so that every device can run what is valid.
    let mut validator = Validator::new(ValidationFlags::all(), Capabilities::empty());
    validator.validate(&module).err().map(|e| e.emit_to_string(source))
}
