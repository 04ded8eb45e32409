//! Decoding any video and encoding H.264 with the `ffmpeg` program, through pipes.

use crate::{
    Error, Result,
    error::one_line,
    files::has_extension,
    limits::check_size,
    partial::{PartialFile, remove_leftovers},
    video_head::{INTERLACED, VideoHead, uneven},
    yuv::{Colour, YuvFormat, YuvFrame},
};
use blindaug::{
    Encoded, Transfer, byte_from_encoded,
    colour_space::{ColourSpace, Primaries},
    model::PIXEL_ASPECTS,
    word_from_encoded,
};
use std::{
    ffi::{OsStr, OsString},
    io::{BufRead, BufReader, Read, Write},
    path::{Path, PathBuf},
    process::{Child, ChildStdin, ChildStdout, Command, ExitStatus, Stdio},
    thread::JoinHandle,
};

/// The environment variable that names the ffmpeg program; with `none`, ffmpeg is never used.
const VARIABLE: &str = "BLINDAUG_FFMPEG";

/// The containers that are read: those that hold their pictures themselves. Others (playlists, scripts, lists of files, SVG) name
/// further files or addresses, or are programs, and a video must not open those without the user's knowledge.
const CONTAINERS: &str = "mov,matroska,webm,avi,mpegts,mpeg,mpegvideo,mxf,flv,live_flv,asf,ogg,nut,yuv4mpegpipe,gif,apng,dv,gxf,ivf,\
    h261,h263,h264,hevc,vvc,av1,obu,m4v,mjpeg,rm,swf,wtv,vc1,dnxhd,cine,r3d,lxf,nsv,nuv,dirac,cavsvideo,avs2,avs3,dhav,\
    mp3,wav,w64,flac,aac,ac3,aiff,caf,amr,\
    webp_pipe,dpx_pipe,jpegxl_pipe,jpegxl_anim,j2k_pipe,jpegls_pipe,psd_pipe,qoi_pipe,sgi_pipe,exr_pipe,hdr_pipe,png_pipe,jpeg_pipe,\
    tiff_pipe,bmp_pipe,pam_pipe,pbm_pipe,pgm_pipe,ppm_pipe,pfm_pipe,phm_pipe,dds_pipe,sunrast_pipe,pcx_pipe";

/// The ffmpeg program, if there is one.
pub(crate) fn find() -> Option<OsString> {
    let program = std::env::var_os(VARIABLE).unwrap_or_else(|| "ffmpeg".into());
    if program == "none" {
        return None;
    }
    let run = Command::new(&program).arg("-version").stdin(Stdio::null()).output();
    run.is_ok_and(|o| o.status.success()).then_some(program)
}

/// A command that Ctrl-C in a terminal does not reach, so that this program decides when the command ends.
fn command(program: &OsStr) -> Command {
    let mut command = Command::new(program);
    #[cfg(unix)]
    std::os::unix::process::CommandExt::process_group(&mut command, 0);
    command
}

/// One input of ffmpeg, and how it is decoded.
#[derive(Debug)]
pub(crate) struct Ffmpeg {
    program: OsString,
    /// The options that name the input.
    input: Vec<OsString>,
    /// Whether the input is a camera, which may send damaged frames and has no last frame.
    is_camera: bool,
    /// The pixel format that is asked for: the video's own if possible, so that ffmpeg converts nothing.
    pixels: Pixels,
    format: YuvFormat,
    /// The option by which ffmpeg gives each frame once, whatever its time; older versions have another name for it.
    each_frame_once: [&'static str; 2],
}

impl Ffmpeg {
    /// Opens a video file, and asks ffmpeg for its properties.
    pub(crate) fn open(program: OsString, path: &Path) -> Result<(Self, VideoHead)> {
        Self::open_input(program, path, file_input(path), false)
    }

    /// Opens a camera, and asks ffmpeg for its properties; errors name the camera by `path`.
    pub(crate) fn open_camera(program: OsString, path: &Path, name: &str) -> Result<(Self, VideoHead)> {
        Self::open_input(program, path, camera_input(name, std::env::consts::OS), true)
    }

    fn open_input(
        program: OsString,
        path: &Path,
        input: Vec<OsString>,
        is_camera: bool,
    ) -> Result<(Self, VideoHead)> {
        let output = Command::new(&program)
            .args(["-nostdin", "-hide_banner"])
            .args(&input)
            .stdin(Stdio::null())
            .output()
            .map_err(|e| Error::new(path, format!("ffmpeg cannot be started ({e})")))?;
        // Without an output ffmpeg always "fails", after it has described its input.
        let text = String::from_utf8_lossy(&output.stderr);
        let Some(VideoStream { size: (width, height), pixels, head }) = VideoStream::parse(&text) else {
            return Err(Error::new(path, why_no_video(&text)));
        };
        let size = check_size(path, width, height)?;
        let format = YuvFormat { size, chroma_shift: pixels.chroma_shift, bits: pixels.bits };
        let mut ffmpeg =
            Self { program, input, is_camera, pixels, format, each_frame_once: ["-fps_mode", "passthrough"] };
        let mut head = head;
        if !is_camera {
            head.notes.extend(uneven(&ffmpeg.times()));
        }
        if let Err(e) = ffmpeg.frames(path).and_then(|mut f| f.next_frame())
            && e.sentence().contains("Option not found")
        {
            ffmpeg.each_frame_once = ["-vsync", "0"];
        }
        Ok((ffmpeg, head))
    }

    /// The times at which the first frames are shown, s, ascending; empty if they are unknown. Nothing is decoded.
    fn times(&self) -> Vec<f64> {
        const FRAMES: &str = "300";
        let output = Command::new(&self.program)
            .args(["-nostdin", "-hide_banner", "-loglevel", "error"])
            .args(&self.input)
            .args(["-map", "0:v:0", "-c", "copy", "-frames:v", FRAMES, "-f", "framecrc", "-"])
            .stdin(Stdio::null())
            .stderr(Stdio::null())
            .output();
        output.map_or_else(|_| Vec::new(), |o| times_of(&String::from_utf8_lossy(&o.stdout)))
    }

    /// The bits of the video's own values.
    pub(crate) fn own_bits(&self) -> u32 {
        self.pixels.own_bits
    }

    /// Starts to decode at the first frame.
    pub(crate) fn frames(&self, path: &Path) -> Result<FfmpegFrames> {
        let (width, height) = self.format.size;
        let mut command = command(&self.program);
        command
            .args(["-nostdin", "-hide_banner", "-nostats", "-loglevel", "error", "-noautorotate"])
            .args((!self.is_camera).then_some("-xerror"))
            .args(&self.input)
            .args(["-map", "0:v:0"]);
        let pixels = &self.pixels.name;
        // The filter converts the frames; `-s` beside it would convert them a second time, and to other ranges.
        let to_size = if self.pixels.converted {
            let scale = "flags=accurate_rnd:out_color_matrix=bt709:out_range=full";
            ["-vf".into(), format!("scale={width}:{height}:{scale},format={pixels}")]
        } else {
            ["-s".into(), format!("{width}x{height}")]
        };
        let mut child = command
            .args(to_size)
            .args(self.each_frame_once)
            .args(["-f", "rawvideo", "-pix_fmt", pixels, "-"])
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .map_err(|e| Error::new(path, format!("ffmpeg cannot be started ({e})")))?;
        let (Some(stdout), Some(stderr)) = (child.stdout.take(), child.stderr.take()) else {
            return Err(Error::new(path, "ffmpeg has no output"));
        };
        Ok(FfmpegFrames {
            path: path.into(),
            is_camera: self.is_camera,
            format: self.format,
            program: Running { child, words: Some(listen(stderr)) },
            frames: stdout,
            decoded: 0,
        })
    }
}

/// A running ffmpeg program, which is killed when this is dropped.
struct Running {
    child: Child,
    /// The thread that collects the program's messages.
    words: Option<JoinHandle<String>>,
}

impl Running {
    /// Waits until the program ends; returns whether it succeeded, and its messages.
    fn wait(&mut self) -> (bool, String) {
        let status = self.child.wait();
        let mut words = self.words.take().and_then(|w| w.join().ok()).unwrap_or_default();
        // A program that was stopped by a signal has no message of its own.
        if let (true, Ok(status)) = (words.trim().is_empty(), &status) {
            words = ended_by(*status).into();
        }
        (status.is_ok_and(|s| s.success()), words)
    }
}

/// The reason why a program was stopped by a signal; empty if it is not known.
fn ended_by(status: ExitStatus) -> &'static str {
    #[cfg(unix)]
    if let Some(signal) = std::os::unix::process::ExitStatusExt::signal(&status) {
        // These are the signals' numbers on Linux, macOS and the BSDs.
        return match signal {
            25 => "the file would be larger than files may be here (ulimit -f)",
            9 => "it was killed; memory may have been short",
            _ => "it was stopped by a signal",
        };
    }
    let _ = status;
    ""
}

impl Drop for Running {
    fn drop(&mut self) {
        // The program may have ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Collects a program's messages in a thread, so that the program never waits for its pipe; their length is limited.
fn listen(stderr: impl Read + Send + 'static) -> JoinHandle<String> {
    std::thread::spawn(move || {
        const KEPT: usize = 1 << 14;
        let mut text = String::new();
        let mut lines = BufReader::new(stderr);
        let mut line = Vec::new();
        // A single line is at most `KEPT` bytes long, too.
        while let Ok(n) = (&mut lines).take(KEPT as u64).read_until(b'\n', &mut line) {
            if n == 0 {
                break;
            }
            if text.len() < KEPT {
                text.push_str(&String::from_utf8_lossy(&line));
            }
            line.clear();
        }
        text
    })
}

/// The reason why ffmpeg found no video in its input, from its messages.
fn why_no_video(text: &str) -> String {
    let has = |what: &str| {
        text.lines().any(|l| l.trim_start().starts_with("Stream #") && l.contains(&format!(": {what}: ")))
    };
    if has("Audio") && !has("Video") {
        return "there is no video in this file, only sound; give a video".into();
    }
    if text.contains("not on whitelist") || text.contains("Not on whitelist") {
        return "this kind of file is no video, or names other files or addresses (a playlist, a script): give a video or an image"
            .into();
    }
    format!(
        "not an image, a video or a camera that can be read, or a damaged one (ffmpeg: {})",
        last_words(text)
    )
}

/// The times in the output of `-f framecrc`, s, ascending; none if frames are without one, as B-frames in AVI are. The output has
/// `#tb 0: 1/12800`, then lines of stream, dts, pts, duration, size and checksum.
fn times_of(framecrc: &str) -> Vec<f64> {
    let unit = framecrc.lines().find_map(|l| {
        let (num, den) = l.strip_prefix("#tb 0:")?.trim().split_once('/')?;
        Some(num.parse::<f64>().ok()? / den.parse::<f64>().ok()?)
    });
    let Some(unit) = unit.filter(|u| u.is_finite()) else { return Vec::new() };
    let pts = framecrc
        .lines()
        .filter(|l| !l.starts_with('#'))
        .filter_map(|l| l.split(',').nth(2)?.trim().parse::<i64>().ok());
    // FFmpeg's AV_NOPTS_VALUE.
    let known = |t: i64| (t != i64::MIN).then_some(t as f64 * unit);
    let mut times: Vec<f64> = pts.map(known).collect::<Option<_>>().unwrap_or_default();
    times.sort_by(f64::total_cmp);
    times
}

/// The last line of ffmpeg's messages.
fn last_words(text: &str) -> String {
    let line = text.lines().map(str::trim).rfind(|l| !l.is_empty()).unwrap_or("it said nothing");
    // The file's name is cut off, because the error has it already.
    one_line(if line.starts_with("file:") { line.rsplit(": ").next().unwrap_or(line) } else { line })
}

/// A file name in a form that ffmpeg takes neither for an option nor for another protocol.
fn file_url(path: &Path) -> OsString {
    let mut url = OsString::from("file:");
    url.push(path);
    url
}

/// The options that name a file as input.
fn file_input(path: &Path) -> Vec<OsString> {
    let options = ["-protocol_whitelist", "file", "-format_whitelist", CONTAINERS, "-i"];
    options.iter().map(OsString::from).chain([file_url(path)]).collect()
}

/// The options that name a camera as input on an operating system; `name` is a number, or a name as ffmpeg lists it.
fn camera_input(name: &str, system: &str) -> Vec<OsString> {
    let numbered = name.parse::<u32>().is_ok();
    let input: &[&str] = match system {
        "macos" => &["-f", "avfoundation", "-framerate", "30", "-i", name],
        "windows" => &["-f", "dshow", "-i", &format!("video={name}")],
        _ if numbered => &["-f", "v4l2", "-i", &format!("/dev/video{name}")],
        _ => &["-f", "v4l2", "-i", name],
    };
    input.iter().map(OsString::from).collect()
}

/// A reader of the frames that ffmpeg decodes.
pub(crate) struct FfmpegFrames {
    path: PathBuf,
    is_camera: bool,
    format: YuvFormat,
    program: Running,
    frames: ChildStdout,
    decoded: usize,
}

impl FfmpegFrames {
    /// The next frame; `None` at the end.
    pub(crate) fn next_frame(&mut self) -> Result<Option<YuvFrame>> {
        let bytes = self.format.bytes();
        let mut data = Vec::with_capacity(bytes);
        (&mut self.frames)
            .take(bytes as u64)
            .read_to_end(&mut data)
            .map_err(|e| Error::cannot_read(&self.path, &e))?;
        if data.len() == bytes {
            self.decoded += 1;
            return Ok(Some(YuvFrame { format: self.format, data }));
        }
        let whole = data.is_empty();
        self.end()?;
        if whole { Ok(None) } else { Err(Error::new(&self.path, "ffmpeg ended in the middle of a frame")) }
    }

    /// Checks, once ffmpeg gives no more frames, that the video ended without damage; a camera must not end at all.
    fn end(&mut self) -> Result<()> {
        let (success, words) = self.program.wait();
        if self.is_camera {
            let why = last_words(&words);
            return Err(Error::new(
                &self.path,
                format!(
                    "the camera stopped giving frames (ffmpeg: {why}); check that it is connected and that no other program uses it"
                ),
            ));
        }
        let repair = "try to repair it with ffmpeg -i IN -c:v libx264 -crf 12 OUT.mp4, or use only the frames before the damage";
        if !success {
            let (next, why) = (self.decoded + 1, last_words(&words));
            let what = match self.decoded {
                0 => format!("the video cannot be decoded (ffmpeg: {why})"),
                _ => format!("the video is damaged or cut short at frame {next} (ffmpeg: {why}); {repair}"),
            };
            return Err(Error::new(&self.path, what));
        }
        // Frames that ffmpeg repaired are not what the camera recorded, so damage is an error even if ffmpeg succeeds.
        let damage = ["error while decoding", "corrupt", "partial file", "Invalid NAL", "ended prematurely"];
        match words.lines().find(|l| damage.iter().any(|d| l.contains(d))) {
            Some(line) => Err(Error::new(
                &self.path,
                format!("the video is damaged or cut short (ffmpeg: {}); {repair}", one_line(line)),
            )),
            None => Ok(()),
        }
    }
}

/// A pixel format of ffmpeg.
#[derive(Clone, Debug, PartialEq)]
struct Pixels {
    name: String,
    chroma_shift: (u32, u32),
    bits: u32,
    /// The bits of the video's own values.
    own_bits: u32,
    /// Whether the video has another pixel format, so that ffmpeg converts.
    converted: bool,
}

impl Pixels {
    /// The planar YCbCr format to ask for if the video has the pixel format `name`.
    fn new(name: &str) -> Self {
        let own = match name {
            "nv12" => "yuv420p",
            "p010le" | "p010be" => "yuv420p10le",
            name => name,
        };
        let converted = Self {
            name: "yuv444p16le".into(),
            chroma_shift: (0, 0),
            bits: 16,
            own_bits: bits_of_others(name),
            converted: true,
        };
        let Some(rest) = own.strip_prefix("yuvj").or(own.strip_prefix("yuv")) else { return converted };
        let Some((sampling, depth)) = rest.split_once('p') else { return converted };
        let chroma_shift = match sampling {
            "420" => (1, 1),
            "422" => (1, 0),
            "444" => (0, 0),
            _ => return converted,
        };
        let digits = depth.trim_end_matches("le").trim_end_matches("be");
        match (digits, digits.parse()) {
            ("", _) => Self { name: own.into(), chroma_shift, bits: 8, own_bits: 8, converted: false },
            (_, Ok(bits @ 9..=16)) => {
                Self { name: own.replace("be", "le"), chroma_shift, bits, own_bits: bits, converted: false }
            }
            _ => converted,
        }
    }
}

/// The bits of a value of a pixel format other than planar YCbCr without alpha, such as `gbrp12le`, `yuva444p12le` or `rgb48le`; at most 16.
fn bits_of_others(name: &str) -> u32 {
    let name = name.trim_end_matches("le").trim_end_matches("be").trim_end_matches("msb");
    match name {
        "rgb48" | "bgr48" | "rgba64" | "bgra64" | "p016" | "p216" | "p416" | "y216" | "xv48" | "ayuv64"
        | "rgb96" | "rgba128" => return 16,
        "p012" | "p212" | "p412" | "y212" | "xv36" => return 12,
        "x2rgb10" | "x2bgr10" | "p210" | "p410" | "y210" | "v30x" | "xv30" | "nv20" => return 10,
        _ if name.ends_with("f16") || name.ends_with("f32") => return 16,
        _ => {}
    }
    let letters = name.trim_end_matches(|c: char| c.is_ascii_digit());
    let is_depth = ["p", "gray", "ya", "xyz"].iter().any(|end| letters.ends_with(end));
    let bits = name[letters.len()..].parse().ok().filter(|bits| is_depth && (9..=32).contains(bits));
    bits.map_or(8, |bits: u32| bits.min(16))
}

/// The properties of an input's first video stream, as ffmpeg prints them.
struct VideoStream {
    size: (u64, u64),
    pixels: Pixels,
    head: VideoHead,
}

impl VideoStream {
    /// Reads a line like
    /// `Stream #0:0(und): Video: h264 (High) (avc1 / 0x31), yuv420p(tv, bt709), 640x272 [SAR 1:1], 404 kb/s, 25 fps, 25 tbr`.
    fn parse(text: &str) -> Option<Self> {
        let mut lines = text.lines().skip_while(|l| {
            !l.trim_start().starts_with("Stream #") || !l.contains(": Video: ") || l.contains("attached pic")
        });
        let fields = split_outside_brackets(lines.next()?.split_once(": Video: ")?.1);
        let size = fields.iter().find_map(|f| size_of(f))?;
        let pixel_aspect = fields.iter().find_map(|f| pixel_aspect_of(f));
        let fps = fields.iter().find_map(|f| f.strip_suffix(" fps")).and_then(|f| f.trim().parse().ok());
        let fps = fps.filter(|f: &f64| f.is_finite() && *f > 0.0).map(exact_fps);
        let frames = fps.and_then(|fps| Some((duration(text)? * fps).round() as usize)).filter(|&n| n > 0);
        let (name, colour) = fields.get(1)?.split_once('(').unwrap_or((fields[1], ""));
        let pixels = Pixels::new(name);
        // The colour is given as "bt709", or as "matrix/primaries/curve" where these differ.
        let words: Vec<&str> = colour.trim_end_matches(')').split(',').map(str::trim).collect();
        let matrix = words.iter().find_map(|w| match w.split('/').next().unwrap_or("") {
            "bt709" => Some(1),
            "fcc" => Some(4),
            "bt470bg" => Some(5),
            "smpte170m" => Some(6),
            "smpte240m" => Some(7),
            "bt2020nc" => Some(9),
            "bt2020c" => Some(10),
            _ => None,
        });
        let space = space_of(&words);
        let colour = if pixels.converted {
            Colour::new(1, 0, true, false)
        } else {
            let full_range = words.contains(&"pc") || name.starts_with("yuvj");
            let centred = ["mjpeg", "mpeg1video"].iter().any(|c| fields[0].starts_with(c));
            Colour::new(matrix.unwrap_or(2), size.1 as usize, full_range, centred)
        };
        // A rotation is a line before the next stream, like `displaymatrix: rotation of -90.00 degrees`, counter-clockwise.
        let rotation = lines
            .take_while(|l| !l.trim_start().starts_with("Stream #"))
            .find_map(|l| l.split_once("rotation of ")?.1.split_whitespace().next()?.parse::<f64>().ok());
        let quarter_turns = rotation.map_or(0, |degrees| (-degrees / 90.0).round().rem_euclid(4.0) as u8);
        let mut notes = Vec::new();
        // Interlaced video is described as "top first" or "bottom coded first (swapped)".
        if words.iter().any(|w| w.contains(" first")) {
            notes.push(INTERLACED.into());
        }
        Some(Self {
            size,
            pixels,
            head: VideoHead { fps, frames, colour, space, quarter_turns, pixel_aspect, notes },
        })
    }
}

/// The colour space that ffmpeg's words tell: `matrix/primaries/curve`, or one word for all three.
fn space_of(words: &[&str]) -> ColourSpace {
    let told = words.iter().find_map(|w| {
        let parts: Vec<&str> = w.split('/').collect();
        (parts.len() == 3).then(|| (parts[1], parts[2]))
    });
    let Some((primaries, curve)) = told else { return ColourSpace::SRGB };
    let primaries = match primaries {
        "bt2020" => Primaries::REC2020,
        "smpte432" | "smpte431" => Primaries::P3,
        _ => Primaries::REC709,
    };
    let transfer = match curve {
        "smpte2084" => Transfer::Pq,
        "arib-std-b67" => Transfer::Hlg,
        "linear" => Transfer::Linear,
        // Displays of computers show the curve of Rec. 709 as their own.
        _ => Transfer::Srgb,
    };
    ColourSpace { primaries, transfer }
}

/// The parts of the text between commas that are outside brackets.
fn split_outside_brackets(text: &str) -> Vec<&str> {
    let mut depth = 0;
    let comma = |c: char| {
        depth += i32::from(c == '(' || c == '[') - i32::from(c == ')' || c == ']');
        c == ',' && depth == 0
    };
    text.split(comma).map(str::trim).collect()
}

/// The size, px, in a field like `640x272 [SAR 1:1 DAR 40:17]`.
fn size_of(field: &str) -> Option<(u64, u64)> {
    let (w, h) = field.split_whitespace().next()?.split_once('x')?;
    Some((w.parse().ok()?, h.parse().ok()?))
}

/// The width of a pixel over its height in a field like `1440x1080 [SAR 4:3 DAR 16:9]`.
fn pixel_aspect_of(field: &str) -> Option<f32> {
    let (w, h) = field.split_once("SAR ")?.1.split([' ', ']']).next()?.split_once(':')?;
    let aspect = w.parse::<f32>().ok()? / h.parse::<f32>().ok()?;
    Some(aspect).filter(|aspect| PIXEL_ASPECTS.contains(aspect))
}

/// The duration, s, in a text like `Duration: 00:00:10.00, start: ...`.
fn duration(text: &str) -> Option<f64> {
    let clock = text.split_once("Duration: ")?.1.split(',').next()?;
    clock.split(':').try_fold(0.0, |sum, part| Some(60.0 * sum + part.trim().parse::<f64>().ok()?))
}

/// The exact frame rate of NTSC video for the one that ffmpeg rounds: 30000/1001 for 29.97.
fn exact_fps(fps: f64) -> f64 {
    let ntsc = fps.ceil() * 1000.0 / 1001.0;
    if (fps - ntsc).abs() < 0.006 { ntsc } else { fps }
}

/// The shape of a video's frames, and how many there are per second.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VideoShape {
    /// Width and height of every frame, px.
    pub size: (usize, usize),
    /// Frames per second, > 0.
    pub fps: f64,
    /// The width of a pixel over its height, as the picture is shown, > 0.
    pub pixel_aspect: f32,
}

impl VideoShape {
    /// Frames of this size whose pixels are square.
    pub fn square(size: (usize, usize), fps: f64) -> Self {
        Self { size, fps, pixel_aspect: 1.0 }
    }
}

/// A writer of a video by ffmpeg (4:2:0, constant quality). The file gets its name in [`VideoWriter::finish`].
pub struct VideoWriter {
    file: PartialFile,
    size: (usize, usize),
    program: Running,
    /// Whether values are written in 16 bits.
    deep: bool,
    /// The pipe to ffmpeg; `None` after a failure or once everything is written.
    frames: Option<ChildStdin>,
    row: Vec<u8>,
}

/// How a video is coded. All ways keep chroma at half the resolution.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum VideoCoding {
    /// H.264 with a constant rate factor of x264: 0 (nothing is lost) to 51 (the worst).
    H264 {
        /// The constant rate factor.
        crf: u8,
    },
    /// HEVC of 10 bits with a constant rate factor of x265: 0 to 51 (the worst).
    Hevc10 {
        /// The constant rate factor.
        crf: u8,
    },
    /// Motion JPEG, each frame by itself as webcams do, with ffmpeg's quantiser scale: 2 (the best) to 31 (the worst).
    Mjpeg {
        /// The quantiser scale.
        scale: u8,
    },
}

impl VideoCoding {
    fn is_deep(self) -> bool {
        matches!(self, Self::Hevc10 { .. })
    }

    fn arguments(self) -> Vec<String> {
        let words = match self {
            Self::H264 { crf } => format!("-c:v libx264 -crf {crf} -pix_fmt yuv420p -color_range tv"),
            Self::Hevc10 { crf } => format!(
                "-c:v libx265 -crf {crf} -pix_fmt yuv420p10le -color_range tv -tag:v hvc1 -x265-params log-level=error"
            ),
            Self::Mjpeg { scale } => format!("-c:v mjpeg -q:v {scale} -pix_fmt yuvj420p -color_range pc"),
        };
        words.split(' ').map(String::from).collect()
    }
}

impl VideoWriter {
    /// Whether a path has the extension of a video that can be written.
    pub fn is_video(path: impl AsRef<Path>) -> bool {
        has_extension(path.as_ref(), &["mp4", "m4v", "mov", "mkv", "avi"])
    }

    /// Whether there is a program that writes videos.
    pub fn is_available() -> bool {
        find().is_some()
    }

    /// Starts a video of frames of this size, px. An odd width or height grows by a copy of the edge pixels, since 4:2:0 has only even
    /// sides.
    ///
    /// # Errors
    /// If there is no ffmpeg program, or the frame rate is no positive number.
    pub fn create(path: impl AsRef<Path>, size: (usize, usize), fps: f64) -> Result<Self> {
        Self::create_in(path, VideoShape::square(size, fps), (ColourSpace::SRGB, 8))
    }

    /// Starts a video as [`VideoWriter::create`] does, of frames of this shape and colour space in so many bits: 8 (H.264), or 10 (HEVC). PQ,
    /// HLG and the primaries of Rec. 2020 are told in the video's head; videos of all other spaces say that they are Rec. 709, since heads have
    /// no words for them.
    ///
    /// # Errors
    /// The same as [`VideoWriter::create`], or if there are other bits.
    pub fn create_in(
        path: impl AsRef<Path>,
        shape: VideoShape,
        (space, bits): (ColourSpace, u8),
    ) -> Result<Self> {
        let path = path.as_ref();
        let coding = match bits {
            8 => Self::FINE,
            10 => VideoCoding::Hevc10 { crf: 12 },
            _ => {
                return Err(Error::new(
                    path,
                    format!("videos are written in 8 or 10 bits per value, not {bits}"),
                ));
            }
        };
        Self::create_with(find(), path, shape, (coding, space))
    }

    /// Starts a video as [`VideoWriter::create`] does, but coded like this.
    ///
    /// # Errors
    /// The same as [`VideoWriter::create`].
    pub fn create_coded(
        path: impl AsRef<Path>,
        size: (usize, usize),
        fps: f64,
        coding: VideoCoding,
    ) -> Result<Self> {
        let shape = VideoShape::square(size, fps);
        Self::create_with(find(), path.as_ref(), shape, (coding, ColourSpace::SRGB))
    }

    /// The default coding, at which hardly any difference can be seen.
    const FINE: VideoCoding = VideoCoding::H264 { crf: 12 };

    fn create_with(
        program: Option<OsString>,
        path: &Path,
        VideoShape { size, fps, pixel_aspect }: VideoShape,
        (coding, space): (VideoCoding, ColourSpace),
    ) -> Result<Self> {
        if !(fps.is_finite() && fps > 0.0) {
            return Err(Error::new(path, format!("a video needs a positive frame rate, not {fps}")));
        }
        check_size(path, size.0 as u64, size.1 as u64)?;
        let Some(program) = program else {
            return Err(Error::new(
                path,
                "no ffmpeg program found: give a folder as output, or install ffmpeg",
            ));
        };
        let file = PartialFile::beside(path)?;
        let wide = space.primaries == Primaries::REC2020;
        let [matrix, colorspace, primaries] =
            if wide { ["bt2020", "bt2020nc", "bt2020"] } else { ["bt709"; 3] };
        let curve = match space.transfer {
            Transfer::Pq => "smpte2084",
            Transfer::Hlg => "arib-std-b67",
            _ => "bt709",
        };
        let even = |n: usize| n + n % 2;
        let mut child = command(&program)
            .args(["-nostdin", "-hide_banner", "-nostats", "-loglevel", "error", "-y"])
            // Without -xerror, ffmpeg 5 reports success if the disk is full at the end of the file.
            .arg("-xerror")
            .args(["-f", "rawvideo", "-pix_fmt", if coding.is_deep() { "rgb48le" } else { "rgb24" }, "-s"])
            .arg(format!("{}x{}", even(size.0), even(size.1)))
            .arg("-r")
            .arg(fps.to_string())
            .args([
                "-i",
                "-",
                "-vf",
                &format!(
                    "scale=flags=bicubic+accurate_rnd+full_chroma_int:out_color_matrix={matrix},setsar={pixel_aspect}:max=1000"
                ),
            ])
            .args(coding.arguments())
            .args(["-colorspace", colorspace, "-color_primaries", primaries, "-color_trc", curve])
            .args(["-movflags", "+faststart"])
            .arg(file_url(file.path()))
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .map_err(|e| Error::new(path, format!("ffmpeg cannot be started ({e})")))?;
        let (Some(stdin), Some(stderr)) = (child.stdin.take(), child.stderr.take()) else {
            return Err(Error::new(path, "ffmpeg has no input"));
        };
        let program = Running { child, words: Some(listen(stderr)) };
        let deep = coding.is_deep();
        Ok(Self { file, size, program, frames: Some(stdin), deep, row: Vec::new() })
    }

    /// Appends a frame.
    ///
    /// # Errors
    /// If the frame has another size, or ffmpeg fails (because of a full disk, say).
    pub fn write(&mut self, frame: &Encoded) -> Result<()> {
        let path = self.file.target();
        let (width, height) = frame.0.size();
        if (width, height) != self.size {
            let (w, h) = self.size;
            return Err(Error::new(
                path,
                format!("a frame is {width} x {height} pixels, the video {w} x {h}"),
            ));
        }
        let Some(pipe) = &mut self.frames else {
            return Err(Error::new(path, "the video has been finished or has failed"));
        };
        let mut written = Ok(());
        for y in 0..height + height % 2 {
            self.row.clear();
            let pixels = frame.0.row(y.min(height - 1));
            let values = pixels.iter().flatten();
            if self.deep {
                self.row.extend(values.flat_map(|&v| word_from_encoded(v).to_le_bytes()));
            } else {
                self.row.extend(values.map(|&v| byte_from_encoded(v)));
            }
            if width % 2 == 1 {
                let pixel = self.row.len() / width;
                self.row.extend_from_within(pixel * (width - 1)..);
            }
            written = written.and_then(|()| pipe.write_all(&self.row));
        }
        written.map_err(|e| {
            self.frames = None;
            let (_, words) = self.program.wait();
            let why = if words.is_empty() { e.to_string() } else { last_words(&words) };
            Error::new(self.file.target(), format!("the video cannot be written (ffmpeg: {why})"))
        })
    }

    /// Completes the video and gives it its name.
    ///
    /// # Errors
    /// If ffmpeg or the renaming fails.
    pub fn finish(mut self) -> Result<()> {
        self.frames = None;
        let (success, words) = self.program.wait();
        if !success {
            let why = last_words(&words);
            return Err(Error::new(
                self.file.target(),
                format!("the video cannot be written (ffmpeg: {why})"),
            ));
        }
        let target = self.file.target().to_path_buf();
        self.file.complete()?;
        // The ffmpeg program of a killed run may have made its file only after this run had begun.
        remove_leftovers(&target);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(stream: &str) -> VideoStream {
        VideoStream::parse(&format!("  Duration: 00:01:10.50, start: 0.0\n  Stream #0:0: Video: {stream}\n"))
            .unwrap()
    }

    #[cfg(unix)]
    #[test]
    fn a_full_disk_is_told_and_nothing_is_left() {
        let Some(ffmpeg) = find() else {
            eprintln!("NOT TESTED: there is no ffmpeg program");
            return;
        };
        let dir = tempfile::tempdir().unwrap();
        const SIZE: usize = 128;
        // Writes a video with the size of files limited to `limit`, in units of half a KiB.
        let written = |limit: &str, name: &str| {
            let program = dir.path().join("ffmpeg.sh");
            // Another process writes the script, because a program that this process has open for writing could not be started.
            let script = format!(
                "cat > \"$0\" <<'END'\n#!/bin/sh\ntrap '' XFSZ\nulimit -f {limit}\nexec '{}' \"$@\"\nEND\nchmod +x \"$0\"",
                ffmpeg.display()
            );
            let made =
                Command::new("sh").args(["-c".as_ref(), script.as_ref(), program.as_os_str()]).status();
            assert!(made.unwrap().success());
            let path = dir.path().join(name);
            let mut writer = VideoWriter::create_with(
                Some(program.into()),
                &path,
                VideoShape::square((SIZE, SIZE), 25.0),
                (VideoWriter::FINE, ColourSpace::SRGB),
            )?;
            let value = |x, y| ((x * 73_856_093) ^ (y * 19_349_663)) as f32 % 251.0 / 251.0;
            let frame = blindaug::Raster::from_fn(SIZE, SIZE, |x: usize, y: usize| [value(x, y); 3]);
            (0..4).try_for_each(|_| writer.write(&Encoded(frame.clone())))?;
            writer.finish()
        };
        for name in ["a.mp4", "a.mkv", "a.avi"] {
            let e = written("8", name).unwrap_err().to_string();
            assert!(e.contains("cannot be written (ffmpeg: ") && e.contains("too large"), "{e}");
        }
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1);
        written("unlimited", "a.mp4").unwrap();
        assert!(dir.path().join("a.mp4").metadata().unwrap().len() > 10_000);
    }

    #[test]
    fn ffmpeg_s_description_is_understood() {
        let s = parse(
            "h264 (High) (avc1 / 0x31637661), yuv420p(progressive), 640x272 [SAR 1:1 DAR 40:17], 404 kb/s, 25 fps, 25 tbr, 12800 tbn (default)",
        );
        assert_eq!((s.size, s.head.fps, s.head.frames), ((640, 272), Some(25.0), Some(1763)));
        assert_eq!(s.head.pixel_aspect, Some(1.0));
        assert_eq!(s.head.colour, Colour::new(6, 272, false, false));
        assert_eq!(s.pixels.name, "yuv420p");
        let s = parse(
            "hevc (Main 10) (hvc1 / 0x31637668), yuv420p10le(tv, bt2020nc/bt2020/arib-std-b67), 1920x1080, 29.97 fps, 29.97 tbr",
        );
        assert!(s.pixels.bits == 10 && s.head.space == "hlg".parse().unwrap(), "{:?}", s.head.space);
        assert_eq!(s.head.colour, Colour::new(9, 0, false, false));
        assert!((s.head.fps.unwrap() - 30000.0 / 1001.0).abs() < 1e-9);
        let s = parse("h264 (Main), yuv420p(tv, progressive), 1280x720, 23.98 fps, 23.98 tbr");
        assert_eq!(s.head.colour, Colour::new(1, 0, false, false));
        assert!((s.head.fps.unwrap() - 24000.0 / 1001.0).abs() < 1e-9);
        let s = parse(
            "h264 (Main), yuv420p(tv, unknown/bt709/bt709), 640x480, 60 fps\n    displaymatrix: rotation of -90.00 degrees",
        );
        assert_eq!(s.head.colour, Colour::new(6, 0, false, false));
        assert_eq!((s.head.quarter_turns, s.head.fps), (1, Some(60.0)));
        let s =
            parse("h264 (High), yuv420p(tv, bt709, top first), 1440x1080 [SAR 4:3 DAR 16:9], 25 fps, 25 tbr");
        assert!(s.head.notes == [INTERLACED] && s.size == (1440, 1080));
        assert_eq!(s.head.pixel_aspect, Some(4.0 / 3.0));
        let s = parse("dvvideo, yuv420p(bottom coded first (swapped)), 720x576, 25 fps, 25 tbr");
        assert!(s.head.notes == [INTERLACED] && s.pixels.name == "yuv420p");
        assert_eq!(s.head.pixel_aspect, None);
        // A pixel without an extent says nothing.
        let s = parse("h264 (Main), yuv420p, 640x480 [SAR 0:1 DAR 0:1], 25 fps");
        assert_eq!(s.head.pixel_aspect, None);
        let s = parse("mjpeg (Baseline), yuvj422p(pc, bt470bg/unknown/unknown), 64x64, 1k tbn");
        assert_eq!((s.head.colour, s.pixels.chroma_shift), (Colour::new(5, 0, true, true), (1, 0)));
        assert_eq!((s.head.fps, s.head.frames), (None, None));
        let s = parse("rawvideo (RGB[24] / 0x18424752), rgb24, 1920x1080, 24 fps");
        assert!(s.pixels.converted && s.pixels.name == "yuv444p16le");
        assert!(VideoStream::parse("  Stream #0:1: Audio: aac, 44100 Hz").is_none());
        assert!(
            VideoStream::parse("  Stream #0:1: Video: png, rgb24, 9x9, 90k tbr (attached pic)").is_none()
        );
    }

    #[test]
    fn why_there_is_no_video_is_said() {
        let sound = why_no_video(
            "Input #0, mp3, from 'a'\n  Stream #0:0: Audio: mp3, 44100 Hz\nAt least one output file must be specified",
        );
        assert!(sound.starts_with("there is no video in this file, only sound"), "{sound}");
        let list = why_no_video("[hls @ 0x55] Format not on whitelist 'mov,avi'\nfile:a: Invalid argument");
        assert!(list.contains("a playlist"), "{list}");
        assert!(why_no_video("file:a: Invalid data").ends_with("(ffmpeg: Invalid data)"));
    }

    #[test]
    fn frames_that_are_not_evenly_spaced_are_told() {
        let times = |pts: &[u32]| {
            let lines = pts.iter().map(|t| format!("0, {t}, {t}, 33, 1000, 0x1234\n"));
            times_of(&format!("#software: x\n#tb 0: 1/1000\n{}", lines.collect::<String>()))
        };
        // These are 30 frames per second, in whole ms and in the order of decoding.
        assert_eq!(uneven(&times(&[0, 100, 67, 33, 133, 167])), None);
        let note = uneven(&times(&[0, 33, 67, 133, 167])).unwrap();
        assert!(note.contains("33 to 66 ms") && note.contains("42 ms"), "{note}");
        assert_eq!(uneven(&times_of("garbage")), None);
        // Frames without a time, as in AVI with B-frames.
        let without = "#tb 0: 1/30\n0, 0, -9223372036854775808, 1, 9, 0x1\n0, 1, 1, 1, 9, 0x1\n";
        assert!(
            times_of(without).is_empty()
                && times_of(&without.replace("-9223372036854775808", "0")).len() == 2
        );
        assert_eq!(uneven(&times(&[0])), None);
    }

    #[test]
    fn a_playlist_opens_no_other_file() {
        let Some(ffmpeg) = find() else {
            eprintln!("NOT TESTED: there is no ffmpeg program");
            return;
        };
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        let made = Command::new(&ffmpeg)
            .args(["-v", "error", "-f", "lavfi", "-i", "testsrc2=s=64x48:d=1"])
            .arg(at("real.ts"))
            .status();
        assert!(made.unwrap().success());
        assert!(Ffmpeg::open(ffmpeg.clone(), &at("real.ts")).is_ok());
        let list = "#EXTM3U\n#EXT-X-TARGETDURATION:1\n#EXTINF:1,\nreal.ts\n#EXT-X-ENDLIST\n";
        for (name, text) in
            [("a.m3u8", list), ("a.mp4", list), ("a.ffconcat", "ffconcat version 1.0\nfile real.ts\n")]
        {
            std::fs::write(at(name), text).unwrap();
            let e = Ffmpeg::open(ffmpeg.clone(), &at(name)).err().unwrap().to_string();
            assert!(e.contains("a playlist"), "{name}: {e}");
        }
    }

    #[test]
    fn a_video_cannot_be_written_without_ffmpeg() {
        let create = |program: Option<&str>, fps| {
            let path = std::env::temp_dir().join("blindaug_not_written.mp4");
            VideoWriter::create_with(
                program.map(Into::into),
                &path,
                VideoShape::square((4, 4), fps),
                (VideoWriter::FINE, ColourSpace::SRGB),
            )
            .err()
            .unwrap()
            .to_string()
        };
        assert!(create(None, 25.0).contains("give a folder as output, or install ffmpeg"));
        assert!(create(Some("/no/such/program"), 25.0).contains("cannot be started"));
        assert!(create(Some("ffmpeg"), f64::NAN).contains("frame rate"));
        assert!(
            VideoWriter::is_video("a.MP4")
                && !VideoWriter::is_video("folder.d")
                && !VideoWriter::is_video("mp4")
        );
    }

    #[test]
    fn a_camera_that_stops_is_said_to() {
        let Some(program) = find() else {
            eprintln!("NOT TESTED: there is no ffmpeg");
            return;
        };
        let frames = |is_camera| {
            let input = ["-f", "lavfi", "-i", "testsrc=duration=0.2:size=64x48:rate=10"].map(OsString::from);
            let path = Path::new("camera:0");
            let (ffmpeg, _) = Ffmpeg::open_input(program.clone(), path, input.into(), is_camera).unwrap();
            let mut frames = ffmpeg.frames(path).unwrap();
            assert!((0..2).all(|_| frames.next_frame().unwrap().is_some()));
            frames.next_frame()
        };
        let e = frames(true).err().unwrap().to_string();
        assert!(e.starts_with("camera:0: the camera stopped giving frames") && !e.contains('\n'), "{e}");
        // An input that is no camera may end.
        assert!(frames(false).unwrap().is_none());
    }

    #[test]
    fn cameras_are_called_what_the_system_calls_them() {
        let last = |name, system| camera_input(name, system).pop().unwrap();
        assert_eq!(last("0", "linux"), "/dev/video0");
        assert_eq!(last("/dev/v4l/by-id/x", "linux"), "/dev/v4l/by-id/x");
        assert_eq!(last("0", "macos"), "0");
        assert_eq!(last("USB Video", "windows"), "video=USB Video");
    }

    #[test]
    fn pixel_formats_are_kept_where_possible() {
        for (name, asked, bits) in [
            ("yuv422p10be", "yuv422p10le", 10),
            ("p010le", "yuv420p10le", 10),
            ("nv12", "yuv420p", 8),
            ("yuvj420p", "yuvj420p", 8),
            ("yuv444p", "yuv444p", 8),
            ("yuva420p", "yuv444p16le", 16),
            ("yuv440p", "yuv444p16le", 16),
            ("gray", "yuv444p16le", 16),
            ("", "yuv444p16le", 16),
        ] {
            let p = Pixels::new(name);
            assert_eq!((p.name.as_str(), p.bits), (asked, bits), "{name}");
        }
        // The bits of the video's own values, by which those of what is written are chosen.
        for (name, bits) in [
            ("yuv422p10le", 10),
            ("yuv420p", 8),
            ("yuva444p12le", 12),
            ("gbrp10le", 10),
            ("gbrap16be", 16),
            ("gbrpf32le", 16),
            ("rgb48le", 16),
            ("rgb24", 8),
            ("bgr0", 8),
            ("gbrp", 8),
            ("gray12le", 12),
            ("gray32le", 16),
            ("gbrp10msbbe", 10),
            ("gray", 8),
            ("nv16", 8),
            ("pal8", 8),
            ("yuv411p", 8),
            ("x2rgb10le", 10),
            ("", 8),
        ] {
            assert_eq!(Pixels::new(name).own_bits, bits, "{name}");
        }
    }
}
