//! Running one network on frames of any size.

use crate::manifest::{Channels, Input, Kind, Layout, Manifest, Order};
use crate::runtime::{Session, Tensor};
use crate::tiles::{Span, reflected, spans, weight};
use blindaug::fit::noise::NoiseEvidence;
use blindaug::model::DepthKind;
use blindaug::synth::noise::white_band_std;
use blindaug::{Encoded, Flow, Pixel, Plane, Raster, filter};
use blindaug_io::{Error, Result, memory, one_line, read_file};
use sha2::{Digest, Sha256};
use std::path::{Path, PathBuf};

/// The largest ONNX file that is read, bytes: the format itself ends at 2 GiB.
pub(crate) const MOST_BYTES: u64 = 1 << 31;

/// A network and its manifest.
pub struct Network {
    manifest: Manifest,
    path: PathBuf,
    session: Session,
    /// The names of the network's inputs, in order.
    inputs: Vec<String>,
}

impl Network {
    /// Opens the network of a manifest; the ONNX file lies beside the manifest.
    ///
    /// # Errors
    /// If the manifest or the ONNX file is missing or damaged, or they do not belong together.
    pub fn open(manifest: &Path) -> Result<Self> {
        let path = manifest;
        let manifest = Manifest::read(path)?;
        let file = path.with_file_name(&manifest.file);
        if !file.exists() {
            return Err(not_installed(&file, &manifest.name));
        }
        // The runtime makes a copy of the weights, so that they are in memory twice.
        let length = file.metadata().map_or(0, |m| m.len());
        memory::fits(&file, "the network", 2 * length)?;
        let onnx = read_file(&file, MOST_BYTES)?;
        Self::new(manifest, &file, onnx)
    }

    /// Makes a network of a manifest and the bytes of its ONNX file; `path` is for messages.
    ///
    /// # Errors
    /// If the bytes are damaged, or are not the network that the manifest describes.
    pub fn new(manifest: Manifest, path: &Path, onnx: Vec<u8>) -> Result<Self> {
        if let Some(wanted) = &manifest.sha256 {
            let found = sha256(&onnx);
            if !found.eq_ignore_ascii_case(wanted) {
                return Err(Error::new(
                    path,
                    format!(
                        "the file is not the one that the manifest of {} names (SHA-256 {}.., not {}..): install it again",
                        manifest.name,
                        &found[..12],
                        wanted.get(..12).unwrap_or(wanted)
                    ),
                ));
            }
        }
        let session = Session::new(path, onnx)?;
        let images = if manifest.input.layout == Layout::Inputs { manifest.input.frames.len() } else { 1 };
        let wanted = images + usize::from(manifest.input.noise.is_some());
        let names = session.inputs();
        if names.len() != wanted {
            return Err(Error::new(
                path,
                format!(
                    "the network takes {} inputs ({}) but its manifest speaks of {wanted}: this is another network",
                    names.len(),
                    one_line(&names.join(", "))
                ),
            ));
        }
        if let Some(noise) = &manifest.input.noise
            && !names.contains(&noise.input)
        {
            return Err(Error::new(
                path,
                format!(
                    "the network has no input {} (it has {})",
                    one_line(&noise.input),
                    one_line(&names.join(", "))
                ),
            ));
        }
        Ok(Self { manifest, path: path.into(), session, inputs: names })
    }

    /// The network's manifest.
    pub fn manifest(&self) -> &Manifest {
        &self.manifest
    }

    /// The name of the runtime that runs the network.
    pub fn runtime(&self) -> &'static str {
        self.session.runtime()
    }

    /// The frame without the distortion that the network removes; `frames` are those that the manifest lists.
    ///
    /// # Errors
    /// If the network fails, or gives no image of this size or values that are no numbers.
    pub fn image(&self, frames: &[&Encoded]) -> Result<Encoded> {
        let values = self.values(frames)?;
        let own = self.manifest.input.frames.iter().position(|f| *f == 0).unwrap_or(0);
        let frame = &frames[own].0;
        let residual = self.manifest.output.kind == Kind::Residual;
        let channels = self.manifest.input.channels;
        let needed = if channels == Channels::Luma { 1 } else { 3 };
        self.check_channels(&values, needed)?;
        let image = Raster::from_fn(frame.width(), frame.height(), |x, y| {
            let (pixel, of) = (frame.at(x, y), |c: usize| values[c].at(x, y));
            let new: [f32; 3] = match channels {
                Channels::Rgb => [of(0), of(1), of(2)],
                Channels::Bgr => [of(2), of(1), of(0)],
                Channels::Luma if residual => [of(0); 3],
                Channels::Luma => pixel.map(|v| v + of(0) - blindaug::luma(pixel)),
            };
            std::array::from_fn(|c| (new[c] + if residual { pixel[c] } else { 0.0 }).clamp(0.0, 1.0))
        });
        Ok(Encoded(image))
    }

    /// Flow from the first of two frames to the second, px.
    ///
    /// # Errors
    /// The same as [`Network::image`].
    pub fn flow(&self, frames: &[&Encoded]) -> Result<Flow> {
        let values = self.values(frames)?;
        self.check_channels(&values, 2)?;
        let (w, h) = frames[0].0.size();
        // The network's flow is in px of its input, which may be a resampled frame.
        let [sw, sh] = self.manifest.input.size.unwrap_or([w, h]);
        let scale = [w as f32 / sw as f32, h as f32 / sh as f32].map(|s| s * self.manifest.output.scale);
        Ok(Raster::from_fn(w, h, |x, y| [0, 1].map(|c| scale[c] * values[c].at(x, y))))
    }

    /// Inverse depth, 1/m or relative, and which of the two. Relative inverse depth is as the network gives it: of any range, but of
    /// the same for all frames of a clip.
    ///
    /// # Errors
    /// The same as [`Network::image`].
    pub fn inverse_depth(&self, frames: &[&Encoded]) -> Result<(Plane, DepthKind)> {
        let mut values = self.values(frames)?;
        self.check_channels(&values, 1)?;
        let depth = values.swap_remove(0);
        if self.manifest.output.kind == Kind::Depth {
            return Ok((depth.map(|z| if z > 0.0 { z.recip() } else { f32::NAN }), DepthKind::Metric));
        }
        Ok((depth, DepthKind::Relative))
    }

    fn error(&self, sentence: String) -> Error {
        Error::new(&self.path, sentence)
    }

    fn check_channels(&self, values: &[Plane], wanted: usize) -> Result<()> {
        if values.len() == wanted {
            return Ok(());
        }
        let (name, found) = (&self.manifest.name, values.len());
        Err(self.error(format!(
            "{name} gives {found} channels where {wanted} are needed: the file is not the network of its manifest"
        )))
    }

    /// The network's output for whole frames: a plane per channel, as large as the frames.
    fn values(&self, frames: &[&Encoded]) -> Result<Vec<Plane>> {
        let input = &self.manifest.input;
        let given = frames.len();
        let Some(first) = frames.first().filter(|_| given == input.frames.len()) else {
            return Err(
                self.error(format!("{given} frames were given to a network of {}", input.frames.len()))
            );
        };
        let (w, h) = first.0.size();
        if w == 0 || h == 0 || frames.iter().any(|f| f.0.size() != (w, h)) {
            return Err(self.error("the frames must have pixels, and one size".into()));
        }
        let noise = input.noise.as_ref().map(|_| noise_std(first));
        let tile = self.tile_side(input.size.map_or((w, h), |[w, h]| (w, h)))?;
        if let Some([sw, sh]) = input.size {
            let small: Vec<Encoded> = frames.iter().map(|f| Encoded(resampled(&f.0, sw, sh))).collect();
            let whole = [sw, sh].map(|len| Span { start: 0, len });
            let values = self.tile(&small.iter().collect::<Vec<_>>(), whole, noise)?;
            return Ok(values.iter().map(|v| resampled(v, w, h)).collect());
        }
        let overlap = input.overlap.min(tile / 2);
        let (columns, rows) = (spans(w, tile, overlap), spans(h, tile, overlap));
        let mut sums: Vec<Plane> = vec![];
        let mut weights = Plane::filled(w, h, 0.0);
        for &row in &rows {
            for &column in &columns {
                let values = self.tile(frames, [column, row], noise)?;
                if sums.is_empty() {
                    sums = vec![Plane::filled(w, h, 0.0); values.len()];
                }
                for y in 0..row.len {
                    let of_row = weight(row, y, h, overlap);
                    for x in 0..column.len {
                        let weight = of_row * weight(column, x, w, overlap);
                        let i = (row.start + y) * w + column.start + x;
                        weights.data_mut()[i] += weight;
                        for (sum, v) in sums.iter_mut().zip(&values) {
                            sum.data_mut()[i] += weight * v.at(x, y);
                        }
                    }
                }
            }
        }
        for sum in &mut sums {
            sum.data_mut().iter_mut().zip(weights.data()).for_each(|(v, w)| *v /= w);
        }
        Ok(sums)
    }

    /// The side of tiles, px, for images of this size, px: that of the manifest, or less if memory is short.
    fn tile_side(&self, (w, h): (usize, usize)) -> Result<usize> {
        let Input { tile, multiple, memory, .. } = self.manifest.input;
        let mut side = tile.unwrap_or(w.max(h));
        let Some(memory) = memory else { return Ok(side) };
        let free = memory::free();
        let needed = |side: usize| (side.min(w) * side.min(h)).saturating_mul(memory) as u64;
        while needed(side) > free {
            let smaller = side / 2 / multiple * multiple;
            if tile.is_none() || smaller < 64.max(2 * self.manifest.input.overlap) {
                return Err(self.error(format!(
                    "{} needs {} MB of memory for {w} x {h} px and {} MB are free within the budget: close other programs, raise the budget, or use smaller frames",
                    self.manifest.name,
                    needed(side) >> 20,
                    free >> 20
                )));
            }
            side = smaller;
        }
        Ok(side)
    }

    /// The network's output for a part of the frames, given by its columns and rows.
    fn tile(
        &self,
        frames: &[&Encoded],
        [columns, rows]: [Span; 2],
        noise: Option<f32>,
    ) -> Result<Vec<Plane>> {
        let Input { layout, multiple, .. } = self.manifest.input;
        let (pw, ph) = (columns.len.next_multiple_of(multiple), rows.len.next_multiple_of(multiple));
        let planes: Vec<f32> = frames.iter().flat_map(|f| self.planes(f, columns, rows, (pw, ph))).collect();
        let of_frame = planes.len() / frames.len();
        let channels = of_frame / (pw * ph);
        let shape = |front: &[usize]| match self.manifest.input.order {
            Order::Nchw => [front, &[ph, pw]].concat(),
            Order::Nhwc => [&front[..front.len() - 1], &[ph, pw], &front[front.len() - 1..]].concat(),
        };
        let ordered = |planar: Vec<f32>, channels: usize| match self.manifest.input.order {
            Order::Nchw => planar,
            Order::Nhwc => interleaved(&planar, channels),
        };
        let t = frames.len();
        let images: Vec<Tensor> = match layout {
            Layout::Channels => {
                vec![Tensor { shape: shape(&[1, channels * t]), data: ordered(planes, channels * t) }]
            }
            Layout::Sequence => {
                let data = planes.chunks(of_frame).flat_map(|f| ordered(f.to_vec(), channels)).collect();
                vec![Tensor { shape: shape(&[1, t, channels]), data }]
            }
            Layout::Inputs => planes
                .chunks(of_frame)
                .map(|f| Tensor { shape: shape(&[1, channels]), data: ordered(f.to_vec(), channels) })
                .collect(),
        };
        let mut images = images.into_iter();
        let inputs = self
            .inputs
            .iter()
            .filter_map(|name| match (&self.manifest.input.noise, noise) {
                (Some(input), Some(std)) if input.input == *name => Some(Tensor {
                    data: vec![input.scale * std; input.shape.iter().product()],
                    shape: input.shape.clone(),
                }),
                _ => images.next(),
            })
            .collect();
        let output = self.session.run(inputs, self.manifest.output.index)?;
        if output.data.iter().any(|v| !v.is_finite()) {
            return Err(self.error(format!(
                "{} gives values that are no numbers: its file may be damaged; install or export it again",
                self.manifest.name
            )));
        }
        self.planes_of(output, (pw, ph), (columns.len, rows.len))
    }

    /// The channels of a part of a frame, padded, and in the range of values that the network takes.
    fn planes(&self, frame: &Encoded, columns: Span, rows: Span, (pw, ph): (usize, usize)) -> Vec<f32> {
        let Input { channels, mean, std, .. } = self.manifest.input;
        let mut planes = vec![];
        let order: &[usize] = match channels {
            Channels::Rgb => &[0, 1, 2],
            Channels::Bgr => &[2, 1, 0],
            Channels::Luma => &[0],
        };
        for (k, &c) in order.iter().enumerate() {
            for y in 0..ph {
                let row = frame.0.row(rows.start + reflected(y, rows.len));
                planes.extend((0..pw).map(|x| {
                    let pixel = row[columns.start + reflected(x, columns.len)];
                    let v = if channels == Channels::Luma { blindaug::luma(pixel) } else { pixel[c] };
                    (v - mean[k]) / std[k]
                }));
            }
        }
        planes
    }

    /// The channels of an output, without padding and in the frame's range of values.
    fn planes_of(
        &self,
        output: Tensor,
        padded: (usize, usize),
        (w, h): (usize, usize),
    ) -> Result<Vec<Plane>> {
        let (pw, ph) = padded;
        let wrong = || {
            self.error(format!(
                "{} gives {:?} for {pw} x {ph} px: the file is not the network of its manifest",
                self.manifest.name, output.shape
            ))
        };
        // Leading axes are removed: of a sequence, the manifest's frame is taken; other axes have length 1.
        let mut shape = output.shape.as_slice();
        let mut data = output.data.as_slice();
        while shape.len() > 3
            || (shape.len() == 3 && shape[0] == 1 && self.manifest.input.order == Order::Nhwc)
        {
            let of_one = data.len() / shape[0].max(1);
            let at = if shape[0] == 1 { 0 } else { self.manifest.output.frame };
            data = data.get(at * of_one..(at + 1) * of_one).ok_or_else(wrong)?;
            shape = &shape[1..];
        }
        let planar;
        let (channels, data) = match (self.manifest.input.order, shape) {
            (_, [rows, columns]) if (*columns, *rows) == padded => (1, data),
            (Order::Nchw, [channels, rows, columns]) if (*columns, *rows) == padded => (*channels, data),
            (Order::Nhwc, [rows, columns, channels]) if (*columns, *rows) == padded => {
                planar = interleaved(data, pw * ph);
                (*channels, planar.as_slice())
            }
            _ => return Err(wrong()),
        };
        // By default an image is scaled back from the input's range of values, and a residual by its std.
        let image = self.manifest.output.kind == Kind::Image;
        let Input { mean, std, .. } = self.manifest.input;
        let (mean, std) = match (self.manifest.output.mean, self.manifest.output.std) {
            (None, None) if image => (mean, std),
            (None, None) if self.manifest.output.kind == Kind::Residual => ([0.0; 3], std),
            (m, s) => (m.unwrap_or([0.0; 3]), s.unwrap_or([1.0; 3])),
        };
        let plane = |c: usize| {
            let of_channel = &data[c * pw * ph..];
            let (mean, std) = (mean[c.min(2)], std[c.min(2)]);
            Plane::from_fn(w, h, |x, y| of_channel[y * pw + x] * std + mean)
        };
        Ok((0..channels).map(plane).collect())
    }
}

/// Reorders planes into interleaved pixels of `channels` values. With the number of pixels as `channels` it reorders them back.
fn interleaved(planar: &[f32], channels: usize) -> Vec<f32> {
    let n = planar.len() / channels.max(1);
    (0..n).flat_map(|i| (0..channels).map(move |c| planar[c * n + i])).collect()
}

/// The noise std of a frame at its mean luminance, averaged over the channels; the noise is taken to be white.
fn noise_std(frame: &Encoded) -> f32 {
    let luma = frame.luma();
    let mean = luma.data().iter().sum::<f32>() / luma.data().len() as f32;
    let fit = NoiseEvidence::of_frame(frame).fit();
    let finest = fit.model.known().map_or([0.0; 3], |m| m.std(0, mean));
    finest.iter().sum::<f32>() / 3.0 / white_band_std()[0]
}

/// An image in another size, px. If the image shrinks, detail that the new pixels cannot show is blurred away before.
fn resampled<P: Pixel>(image: &Raster<P>, w: usize, h: usize) -> Raster<P> {
    let scale = [image.width() as f32 / w as f32, image.height() as f32 / h as f32];
    let shrinks = scale[0].max(scale[1]);
    // The variance is that of a box as wide as a new pixel, less that of an old pixel; a box of width w has the std 0.29 w.
    let smooth = if shrinks > 1.0 {
        &filter::gaussian_blur(image, 0.29 * (shrinks * shrinks - 1.0).sqrt())
    } else {
        image
    };
    Raster::from_fn(w, h, |x, y| {
        smooth.bilinear((x as f32 + 0.5) * scale[0] - 0.5, (y as f32 + 0.5) * scale[1] - 0.5)
    })
}

/// The SHA-256 sum, in hexadecimal.
pub fn sha256(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().map(|b| format!("{b:02x}")).collect()
}

/// The error of a network whose file is missing.
pub(crate) fn not_installed(file: &Path, name: &str) -> Error {
    Error::new(
        file,
        format!(
            "the network {name} is not installed: there is no such file (`blindaug models install {name}` says how to get it)"
        ),
    )
}
