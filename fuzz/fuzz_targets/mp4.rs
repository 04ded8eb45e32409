#![no_main]
use blindaug_fuzz::{check, file};
use blindaug_io::{FrameRange, FrameSource};

libfuzzer_sys::fuzz_target!(
    // This target tests the built-in decoder, not the ffmpeg program.
    init: assert_eq!(std::env::var("BLINDAUG_FFMPEG").as_deref(), Ok("none"), "use tools/fuzz.sh"),
    |bytes: &[u8]| {
        let Some(source) = check(FrameSource::open(file(bytes, "mp4"), FrameRange::default())) else { return };
        let _ = (source.len_hint(), source.fps(), source.size());
        // The first frame was decoded when the file was opened.
        for frame in source.frames().take(3) {
            check(frame);
        }
    }
);
