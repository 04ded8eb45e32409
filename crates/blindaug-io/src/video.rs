//! Videos: decoded by the `ffmpeg` program where there is one (any format), else by the built-in decoder (H.264 in MP4), if it is built in.

#[cfg(feature = "openh264")]
use crate::mp4::{Mp4, Mp4Frames};
use crate::{
    Error, Result, ffmpeg,
    ffmpeg::Ffmpeg,
    video_head::VideoHead,
    yuv::{YuvFrame, turned},
};
use blindaug::{Encoded, colour_space::ColourSpace};
use std::path::{Path, PathBuf};

/// A video whose head has been read.
#[derive(Debug)]
pub(crate) struct Video {
    path: PathBuf,
    decoder: Decoder,
    size: (usize, usize),
    head: VideoHead,
}

#[derive(Debug)]
enum Decoder {
    Ffmpeg(Ffmpeg),
    #[cfg(feature = "openh264")]
    BuiltIn(Mp4),
}

impl Video {
    /// Opens a video with the `ffmpeg` program, or with the built-in decoder if there is none.
    pub(crate) fn open(path: &Path) -> Result<Self> {
        match ffmpeg::find() {
            Some(program) => Self::open_with_ffmpeg(path, program),
            None => Self::open_built_in(path),
        }
    }

    pub(crate) fn open_with_ffmpeg(path: &Path, program: std::ffi::OsString) -> Result<Self> {
        let (ffmpeg, head) = Ffmpeg::open(program, path)?;
        Self::with_first_frame(path, Decoder::Ffmpeg(ffmpeg), head)
    }

    /// Opens a camera with the `ffmpeg` program; errors name the camera by `path`.
    pub(crate) fn open_camera(path: &Path, name: &str) -> Result<Self> {
        let Some(program) = ffmpeg::find() else {
            return Err(Error::new(
                path,
                "a camera is read by the ffmpeg program, and there is none: install it",
            ));
        };
        let (ffmpeg, head) = Ffmpeg::open_camera(program, path, name)?;
        Self::with_first_frame(path, Decoder::Ffmpeg(ffmpeg), head)
    }

    /// Says that there is nothing to decode it with, which the first bytes of a file that is no video do not change.
    #[cfg(not(feature = "openh264"))]
    pub(crate) fn open_built_in(path: &Path) -> Result<Self> {
        crate::open_file(path)?;
        let what = "not an image, and videos are read by the ffmpeg program alone, since this program was built without a decoder";
        Err(Error::new(path, format!("{what}: install ffmpeg, or give the frames as a folder of images")))
    }

    #[cfg(feature = "openh264")]
    pub(crate) fn open_built_in(path: &Path) -> Result<Self> {
        let (mp4, head) = Mp4::open(path)?;
        Self::with_first_frame(path, Decoder::BuiltIn(mp4), head)
    }

    /// Decodes the first frame, so that a video that cannot be decoded fails when it is opened.
    fn with_first_frame(path: &Path, decoder: Decoder, head: VideoHead) -> Result<Self> {
        let mut video = Self { path: path.into(), decoder, size: (0, 0), head };
        let Some(first) = video.frames()?.next_frame()? else {
            return Err(Error::new(path, "the video has no frames"));
        };
        video.size = video.encoded(&first).0.size();
        Ok(video)
    }

    /// The decoded frame as RGB, turned upright.
    pub(crate) fn encoded(&self, frame: &YuvFrame) -> Encoded {
        turned(frame.to_encoded(self.head.colour), self.head.quarter_turns)
    }

    /// The bits of a value.
    pub(crate) fn bits(&self) -> u32 {
        match &self.decoder {
            Decoder::Ffmpeg(f) => f.own_bits(),
            #[cfg(feature = "openh264")]
            Decoder::BuiltIn(_) => 8,
        }
    }

    /// The colour space of the frames, as the head says.
    pub(crate) fn space(&self) -> ColourSpace {
        self.head.space
    }

    pub(crate) fn size(&self) -> (usize, usize) {
        self.size
    }

    pub(crate) fn fps(&self) -> Option<f64> {
        self.head.fps
    }

    pub(crate) fn len_hint(&self) -> Option<usize> {
        self.head.frames
    }

    /// The width of a pixel of the upright picture over its height, if the video's head tells it.
    pub(crate) fn pixel_aspect(&self) -> Option<f32> {
        let lies = self.head.quarter_turns % 2 == 1;
        self.head.pixel_aspect.map(|aspect| if lies { aspect.recip() } else { aspect })
    }

    pub(crate) fn notes(&self) -> &[String] {
        &self.head.notes
    }

    /// Starts to decode at the first frame.
    pub(crate) fn frames(&self) -> Result<VideoFrames> {
        Ok(match &self.decoder {
            Decoder::Ffmpeg(f) => VideoFrames::Ffmpeg(f.frames(&self.path)?),
            #[cfg(feature = "openh264")]
            Decoder::BuiltIn(m) => VideoFrames::BuiltIn(Box::new(m.frames(&self.path)?)),
        })
    }
}

/// A video that is being decoded.
pub(crate) enum VideoFrames {
    Ffmpeg(ffmpeg::FfmpegFrames),
    #[cfg(feature = "openh264")]
    BuiltIn(Box<Mp4Frames>),
}

impl VideoFrames {
    /// The next frame, or `None` at the end.
    pub(crate) fn next_frame(&mut self) -> Result<Option<YuvFrame>> {
        match self {
            Self::Ffmpeg(f) => f.next_frame(),
            #[cfg(feature = "openh264")]
            Self::BuiltIn(m) => m.next_frame(),
        }
    }
}

#[cfg(all(test, not(feature = "openh264")))]
mod tests_without_decoder {
    use super::*;

    #[test]
    fn a_video_without_any_decoder_is_one_sentence() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.mp4");
        std::fs::write(&path, b"\0\0\0\x18ftypmp42").unwrap();
        let e = Video::open_built_in(&path).unwrap_err().to_string();
        assert!(e.contains("a.mp4: ") && e.contains("install ffmpeg") && !e.contains('\n'), "{e}");
        // Negative control: a file that is not there is another error.
        let e = Video::open_built_in(&dir.path().join("b.mp4")).unwrap_err().to_string();
        assert!(e.contains("b.mp4: ") && !e.contains("install ffmpeg"), "{e}");
    }
}

#[cfg(all(test, feature = "openh264"))]
mod tests {
    use super::*;
    use crate::VideoWriter;
    use std::ffi::OsStr;
    use std::process::Command;

    fn bikes() -> Option<PathBuf> {
        let shared = std::env::var_os("BLINDAUG_SHARED").map_or_else(
            || PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared")),
            PathBuf::from,
        );
        let path = shared.join("data/video/bikes.mp4");
        if path.is_file() {
            return Some(path);
        }
        eprintln!("NOT TESTED: no video at {} (set BLINDAUG_SHARED)", path.display());
        None
    }

    fn program() -> Option<std::ffi::OsString> {
        let program = ffmpeg::find();
        if program.is_none() {
            eprintln!("NOT TESTED: there is no ffmpeg program");
        }
        program
    }

    /// The mean squared difference of two frames' luma.
    fn luma_error(a: &Encoded, b: &Encoded) -> f64 {
        assert_eq!(a.0.size(), b.0.size());
        let (a, b) = (a.luma(), b.luma());
        let sum: f64 = a.data().iter().zip(b.data()).map(|(a, b)| f64::from(a - b).powi(2)).sum();
        sum / a.data().len() as f64
    }

    fn psnr(error: f64) -> f64 {
        -10.0 * error.log10()
    }

    fn all_frames(video: &Video) -> Vec<Encoded> {
        let mut frames = video.frames().unwrap();
        std::iter::from_fn(|| frames.next_frame().unwrap().map(|f| video.encoded(&f))).collect()
    }

    /// Converts the input `from`, read with `options`, to the file `to`, written with `as_options`, by ffmpeg.
    fn convert(options: &[&str], from: impl AsRef<OsStr>, as_options: &[&str], to: &Path) {
        let run = Command::new(program().unwrap())
            .args(["-nostdin", "-v", "error", "-y"])
            .args(options)
            .arg("-i")
            .arg(from)
            .args(as_options)
            .arg(to)
            .output()
            .unwrap();
        assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
    }

    /// Encodes a clip of ffmpeg's test picture, at most a second long.
    fn encode(folder: &Path, name: &str, options: &[&str]) -> PathBuf {
        let path = folder.join(name);
        convert(&["-f", "lavfi"], "testsrc2=s=96x64:r=30000/1001:d=1", options, &path);
        path
    }

    /// The largest absolute difference of two frames over all pixels and channels.
    fn largest_difference(a: &Encoded, b: &Encoded) -> f32 {
        assert_eq!(a.0.size(), b.0.size());
        let pairs = a.0.data().as_flattened().iter().zip(b.0.data().as_flattened());
        pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
    }

    #[test]
    fn the_built_in_decoder_reads_real_footage() {
        let Some(path) = bikes() else { return };
        let video = Video::open_built_in(&path).unwrap();
        assert_eq!((video.size(), video.fps(), video.len_hint()), ((640, 272), Some(25.0), Some(250)));
        let mut frames = video.frames().unwrap();
        let number = std::iter::from_fn(|| frames.next_frame().unwrap()).count();
        assert_eq!(number, 250);
    }

    #[test]
    fn both_decoders_agree_on_real_footage() {
        let (Some(path), Some(program)) = (bikes(), program()) else { return };
        let built_in = Video::open_built_in(&path).unwrap();
        let ffmpeg = Video::open_with_ffmpeg(&path, program).unwrap();
        assert_eq!(
            (built_in.size(), built_in.fps(), built_in.len_hint()),
            (ffmpeg.size(), ffmpeg.fps(), ffmpeg.len_hint())
        );
        let (mut a, mut b) = (built_in.frames().unwrap(), ffmpeg.frames().unwrap());
        let mut number = 0;
        let mut worst = f64::INFINITY;
        let mut last: Option<Encoded> = None;
        while let Some(frame) = a.next_frame().unwrap() {
            number += 1;
            let frame = built_in.encoded(&frame);
            let other = ffmpeg.encoded(&b.next_frame().unwrap().unwrap());
            worst = worst.min(psnr(luma_error(&frame, &other)));
            // Negative control: the previous frame is another picture.
            if number == 20 {
                assert!(psnr(luma_error(&frame, last.as_ref().unwrap())) < 40.0);
            }
            last = Some(frame);
        }
        assert!(b.next_frame().unwrap().is_none());
        assert_eq!(number, 250);
        assert!(worst > 45.0, "worst frame: {worst:.1} dB");
        eprintln!("worst frame: {worst:.1} dB");
    }

    #[test]
    fn colour_order_and_rotation_agree_with_ffmpeg() {
        let Some(program) = program() else { return };
        let dir = tempfile::tempdir().unwrap();
        let h264 = ["-c:v", "libx264", "-crf", "4", "-pix_fmt", "yuv420p", "-bf", "3", "-b_strategy", "0"];
        let full = [&h264[..], &["-color_range", "pc", "-vf", "scale=out_range=pc"]].concat();
        let rec_709 = [&h264[..], &["-colorspace", "bt709", "-vf", "scale=out_color_matrix=bt709"]].concat();
        let hd = [&h264[..], &["-vf", "scale=1280:720:out_color_matrix=bt709", "-frames:v", "3"]].concat();
        let plain = encode(dir.path(), "plain.mp4", &h264);
        let turned = ["90", "180", "270"].map(|turn| {
            let path = dir.path().join(format!("turned{turn}.mp4"));
            convert(&[], &plain, &["-c", "copy", "-metadata:s:v:0", &format!("rotate={turn}")], &path);
            path
        });
        // The first frame must match what ffmpeg shows. Only luma is compared, because ffmpeg's chroma is coarser than ours.
        for path in [&plain].into_iter().chain(&turned) {
            let still = dir.path().join("still.png");
            convert(&[], path, &["-frames:v", "1"], &still);
            let shown = crate::read_frame(&still).unwrap();
            let frame = all_frames(&Video::open_built_in(path).unwrap()).swap_remove(0);
            let psnr = psnr(luma_error(&frame, &shown));
            assert!(psnr > 30.0, "{}: {psnr:.1} dB", path.display());
        }
        let mut clips = vec![
            plain,
            encode(dir.path(), "full.mp4", &full),
            encode(dir.path(), "709.mp4", &rec_709),
            encode(dir.path(), "hd.mp4", &hd),
        ];
        clips.extend(turned);
        // A clip trimmed as phones do it: the frames before the start are in the file, but are not shown.
        let trimmed = dir.path().join("trimmed.mp4");
        convert(&["-ss", "0.3", "-t", "0.4"], &clips[0], &["-c", "copy"], &trimmed);
        clips.push(trimmed);
        for path in clips {
            let built_in = all_frames(&Video::open_built_in(&path).unwrap());
            let video = Video::open_with_ffmpeg(&path, program.clone()).unwrap();
            let ffmpeg = all_frames(&video);
            assert!((video.fps().unwrap() - 30000.0 / 1001.0).abs() < 1e-6);
            assert_eq!(built_in.len(), ffmpeg.len(), "{}", path.display());
            assert_eq!((10..20).contains(&ffmpeg.len()), path.ends_with("trimmed.mp4"));
            for (i, (a, b)) in built_in.iter().zip(&ffmpeg).enumerate() {
                let largest = largest_difference(a, b);
                assert!(largest < 0.01, "{} frame {}: {largest}", path.display(), i + 1);
            }
            // Negative control: frames of different times differ.
            assert!(ffmpeg.len() < 10 || psnr(luma_error(&built_in[0], &ffmpeg[9])) < 30.0);
        }
    }

    #[test]
    fn video_that_holds_rgb_keeps_its_colours() {
        let Some(program) = program() else { return };
        let dir = tempfile::tempdir().unwrap();
        for (name, pixels) in [("rgb.mkv", "bgr0"), ("grey.mkv", "gray")] {
            let clip = encode(dir.path(), name, &["-c:v", "ffv1", "-pix_fmt", pixels, "-frames:v", "3"]);
            convert(&[], &clip, &[], &dir.path().join("%d.png"));
            let frames = all_frames(&Video::open_with_ffmpeg(&clip, program.clone()).unwrap());
            let still = |i: usize| crate::read_frame(dir.path().join(format!("{i}.png"))).unwrap();
            for (i, frame) in frames.iter().enumerate() {
                // ffmpeg expands the 8-bit value 255 to 65280, not to 65535, and rounds in its matrix.
                let error = largest_difference(frame, &still(i + 1));
                assert!(error < 0.006, "{name} frame {}: {error}", i + 1);
            }
            assert_eq!(frames.len(), 3);
            assert!(largest_difference(&frames[0], &still(3)) > 0.1, "{name}: another time is not the same");
        }
    }

    #[cfg(unix)]
    #[test]
    fn an_older_ffmpeg_will_do() {
        use std::os::unix::fs::PermissionsExt;
        let Some(program) = program() else { return };
        let dir = tempfile::tempdir().unwrap();
        let clip = encode(dir.path(), "a.mp4", &["-c:v", "libx264", "-frames:v", "3"]);
        // This script stands in for ffmpeg 4, which does not know the option fps_mode and says so.
        let script = format!(
            "#!/bin/sh\ncase \"$*\" in *fps_mode*) echo \"Unrecognized option 'fps_mode'.\" >&2\n\
             echo 'Error splitting the argument list: Option not found' >&2; exit 1;; esac\nexec '{}' \"$@\"\n",
            program.to_str().unwrap()
        );
        let old = dir.path().join("old");
        std::fs::write(&old, script).unwrap();
        std::fs::set_permissions(&old, PermissionsExt::from_mode(0o755)).unwrap();
        let video = Video::open_with_ffmpeg(&clip, old.into()).unwrap();
        assert_eq!(all_frames(&video).len(), 3);
    }

    #[test]
    fn what_is_written_is_read_again() {
        let Some(program) = program() else { return };
        let dir = tempfile::tempdir().unwrap();
        // An odd width or height grows by one pixel.
        for (size, read_size, name) in [((64, 48), (64, 48), "a.mp4"), ((63, 47), (64, 48), "odd.mkv")] {
            let path = dir.path().join(name);
            let frame = |t: usize| {
                Encoded(blindaug::Raster::from_fn(size.0, size.1, move |x, y| {
                    [0.2 + 0.01 * (x + t) as f32, 0.3 + 0.01 * y as f32, 0.5]
                }))
            };
            let mut writer = VideoWriter::create(&path, size, 30000.0 / 1001.0).unwrap();
            for t in 0..5 {
                writer.write(&frame(t)).unwrap();
            }
            assert!(!path.exists());
            assert!(writer.write(&Encoded(blindaug::Raster::filled(8, 8, [0.0; 3]))).is_err());
            writer.finish().unwrap();
            let video = Video::open_with_ffmpeg(&path, program.clone()).unwrap();
            assert_eq!((video.size(), video.len_hint()), (read_size, Some(5)));
            assert!((video.fps().unwrap() - 30000.0 / 1001.0).abs() < 1e-3);
            let frames = all_frames(&video);
            assert_eq!(frames.len(), 5);
            for (t, read) in frames.iter().enumerate() {
                let read = Encoded(read.0.crop(0, 0, size.0, size.1));
                assert!(psnr(luma_error(&read, &frame(t))) > 45.0, "{name} frame {t}");
            }
            assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1);
            std::fs::remove_file(path).unwrap();
        }
        // A writer that is dropped unfinished leaves no file behind.
        let path = dir.path().join("b.mp4");
        let mut writer = VideoWriter::create(&path, (16, 16), 25.0).unwrap();
        writer.write(&Encoded(blindaug::Raster::filled(16, 16, [0.5; 3]))).unwrap();
        drop(writer);
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);
        let e = VideoWriter::create(dir.path().join("no/where.mp4"), (16, 16), 25.0).err().unwrap();
        assert!(e.to_string().contains("no folder"), "{e}");
        // An encoder that cannot start leads to an error, not to a hang.
        let mut writer = VideoWriter::create(dir.path().join("c.mp4"), (2, 2), 1e-30).unwrap();
        let written = writer.write(&Encoded(blindaug::Raster::filled(2, 2, [0.5; 3])));
        assert!(written.and_then(|()| writer.finish()).is_err());
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);
    }

    /// The number of decoded frames, counted up to 10, or the first error.
    fn first_frames(video: Result<Video>) -> Result<usize> {
        let mut frames = video?.frames()?;
        for number in 0..10 {
            if frames.next_frame()?.is_none() {
                return Ok(number);
            }
        }
        Ok(10)
    }

    #[test]
    fn damaged_videos_end_in_a_sentence() {
        let Some(original) = bikes() else { return };
        let bytes = std::fs::read(&original).unwrap();
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("hurt.mp4");
        let program = program();
        let check = |bytes: &[u8], with_ffmpeg: bool, must_fail: bool| {
            std::fs::write(&path, bytes).unwrap();
            let built_in = first_frames(Video::open_built_in(&path));
            let ffmpeg = program
                .clone()
                .filter(|_| with_ffmpeg)
                .map(|p| first_frames(Video::open_with_ffmpeg(&path, p)));
            for result in [Some(built_in), ffmpeg].into_iter().flatten() {
                match result {
                    Err(e) => {
                        let e = e.to_string();
                        assert!(e.contains("hurt.mp4: ") && !e.contains('\n'), "{e}");
                    }
                    Ok(_) => assert!(!must_fail),
                }
            }
        };
        // The index is at the end of this file, so that any cut loses it.
        for i in 0..40 {
            check(&bytes[..bytes.len() * i / 40], i % 10 == 1, true);
        }
        let index = bytes.len() - 3700..bytes.len();
        let mut random = 1u32;
        let mut next = |range: std::ops::Range<usize>| {
            random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            range.start + (random >> 8) as usize % range.len()
        };
        for i in 0..40 {
            let mut hurt = bytes.clone();
            let at = next(if i % 2 == 0 { index.clone() } else { 48..30_000 });
            hurt[at] ^= next(1..256) as u8;
            check(&hurt, i % 20 == 0, false);
        }
        // A file damaged in the middle gives the frames before the damage, then an error.
        let mut hurt = bytes.clone();
        hurt[300_000..300_400].iter_mut().for_each(|b| *b ^= 0x5a);
        std::fs::write(&path, &hurt).unwrap();
        let mut hurt = vec![Video::open_built_in(&path)];
        if let Some(program) = program {
            hurt.push(Video::open_with_ffmpeg(&path, program.clone()));
            // Cut files: MP4 with its index at the start, which the built-in parser refuses at once, and Matroska without an index.
            for name in ["mp4", "mkv"] {
                let [whole, cut] = ["whole", "cut"].map(|n| dir.path().join(n).with_extension(name));
                let run = Command::new(&program)
                    .args(["-nostdin", "-v", "error", "-i"])
                    .args([original.as_os_str(), "-c".as_ref(), "copy".as_ref()])
                    .args(["-movflags".as_ref(), "+faststart".as_ref(), whole.as_os_str()])
                    .status();
                assert!(run.unwrap().success());
                std::fs::write(&cut, &std::fs::read(whole).unwrap()[..300_000]).unwrap();
                if name == "mp4" {
                    let e = Video::open_built_in(&cut).unwrap_err().to_string();
                    assert!(e.contains("damaged or cut short"), "{e}");
                }
                hurt.push(Video::open_with_ffmpeg(&cut, program.clone()));
            }
        }
        for video in hurt {
            let mut frames = video.unwrap().frames().unwrap();
            let mut count = 0;
            let e = loop {
                match frames.next_frame() {
                    Ok(Some(_)) => count += 1,
                    Ok(None) => panic!("{count} frames without an error"),
                    Err(e) => break e,
                }
            };
            assert!(count > 100 && e.to_string().contains("damaged"), "{count} frames, {e}");
            eprintln!("{count} frames, then: {e}");
        }
    }
}
