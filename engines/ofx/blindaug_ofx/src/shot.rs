//! One frame: what blindaug makes of a layer, a plate and a camera.

use blindaug::{
    CameraModel, Encoded, Flow, Linear, Plane, Premultiplied, Raster, Transfer,
    composite::{CompositeOptions, Plate, VirtualLayer, composite, distorted_layer},
    model::{CameraTrack, Estimate, Reason, SceneScale, inverse_of_metric},
};
use blindaug_pipeline::{
    ByHand, Error,
    composite::{in_metres, naive, sized_to},
};

/// What is made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Product {
    /// The layer over the plate.
    #[default]
    Composite,
    /// What the composite adds to the plate, premultiplied, with its noise.
    Layer,
}

/// How values encode light.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Colour {
    /// They are proportional to light; values above 1 are kept.
    #[default]
    Linear,
    /// They are display-encoded, in [0, 1].
    Srgb,
}

/// The values of the parameters at a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Settings {
    /// What is made.
    pub product: Product,
    /// How the values of layer, plate and output encode light.
    pub colour: Colour,
    /// Whether vertical motion counts up rather than down.
    pub motion_up: bool,
    /// The parts of the camera that are set; the blur in px of a frame of full size.
    pub by_hand: ByHand,
    /// Whether the noise is left out.
    pub no_noise: bool,
    /// The seed of the noise.
    pub seed: u64,
    /// The relation of relative inverse depth to metres.
    pub scale: Option<SceneScale>,
    /// Frames that are added to the host's frame number.
    pub frame_offset: i64,
}

impl Settings {
    /// The number of the footage's frame at a time of the host, in frames.
    pub fn frame_number(&self, time: f64) -> u64 {
        (time.round() as i64).saturating_add(self.frame_offset).max(0) as u64
    }
}

/// What a frame is made from. All images have one size, which is that of the frame, and rows from the top.
pub struct Shot<'a> {
    /// The width and the height of the frame, px.
    pub size: (usize, usize),
    /// The px of this frame per px of a frame of full size, across and down: 1, or less in a proxy.
    pub proxy: [f32; 2],
    /// The width of a pixel over its height, if it is known.
    pub pixel_aspect: Option<f32>,
    /// The number of the footage's frame.
    pub number: u64,
    /// The rendered object, premultiplied R, G, B and A; `None`: there is nothing.
    pub layer: Option<Raster<[f32; 4]>>,
    /// Its depth, m, in the first channel.
    pub depth: Option<Raster<[f32; 4]>>,
    /// Its motion to the next frame, px of a frame of full size, in the first two channels.
    pub motion: Option<Raster<[f32; 4]>>,
    /// The frame.
    pub plate: Option<Raster<[f32; 4]>>,
    /// The camera and its name in messages; `None`: only what is set by hand is applied.
    pub camera: Option<(&'a CameraTrack, &'a str)>,
    /// The parameters.
    pub settings: Settings,
}

impl Shot<'_> {
    /// Makes the frame: premultiplied R, G, B and A, encoded as the inputs.
    ///
    /// # Errors
    /// One sentence without a full stop that says what does not fit.
    pub fn make(self) -> Result<Raster<[f32; 4]>, String> {
        let camera = self.fitted()?;
        let Self { size: (width, height), number, settings, .. } = self;
        let linear = settings.colour == Colour::Linear;
        // The layer of a frame without a plate is made over black, and is no composite.
        let over = self.plate.as_ref().filter(|_| settings.product == Product::Composite);
        if over.is_none() && !linear {
            return Err(
                "a layer is merged in linear light: set Colour to Scene-linear, or connect the plate \
                        and set Output to Composite"
                    .into(),
            );
        }
        // Light is worked on in the encoding in which the camera has its noise; encoded values are taken to be in it.
        let t = camera.transfer;
        let frame = match &self.plate {
            Some(plate) => Encoded(
                plate.map(|[r, g, b, _]| if linear { [r, g, b].map(|v| t.encode(v)) } else { [r, g, b] }),
            ),
            None => Encoded(Raster::filled(width, height, [0.0; 3])),
        };
        let layer = match self.layer {
            Some(color) => VirtualLayer {
                color: match linear {
                    true => Premultiplied::from_render(&color),
                    false => Premultiplied::from_render(&Premultiplied::from_encoded(&color, t).0),
                },
                inverse_depth: self.depth.map(|z| -> Plane { z.map(|z| inverse_of_metric(z[0])) }),
                flow: self.motion.map(|motion| -> Flow {
                    let down = if settings.motion_up { -1.0 } else { 1.0 };
                    motion.map(|[u, v, ..]| [self.proxy[0] * u, self.proxy[1] * down * v])
                }),
            },
            None => VirtualLayer {
                color: Premultiplied(Raster::filled(width, height, [0.0; 4])),
                inverse_depth: None,
                flow: None,
            },
        };
        let plate = Plate::new(&frame, number);
        let Settings { no_noise, seed, .. } = settings;
        let options = CompositeOptions { no_noise, seed, unclipped: linear, ..CompositeOptions::default() };
        let Some(over) = over else {
            let made = distorted_layer(&plate, &layer, &camera, &options).map_err(|e| e.to_string())?;
            return Ok(Raster::from_fn(width, height, |x, y| {
                let ([r, g, b, a], n) = (made.color.0.at(x, y), made.noise.at(x, y));
                [r + n[0], g + n[1], b + n[2], a]
            }));
        };
        let made = composite(&plate, &layer, &camera, &options).map_err(|e| e.to_string())?;
        let light: Option<Linear> = linear.then(|| made.to_linear(t));
        Ok(Raster::from_fn(width, height, |x, y| {
            let [r, g, b] = match &light {
                // Where nothing changes, the plate's own values pass, not their way to display-encoded ones and back.
                _ if made.0.at(x, y).map(f32::to_bits) == frame.0.at(x, y).map(f32::to_bits) => {
                    let [r, g, b, _] = over.at(x, y);
                    [r, g, b]
                }
                Some(light) => light.0.at(x, y),
                None => made.0.at(x, y),
            };
            [r, g, b, 1.0]
        }))
    }

    /// The camera of this frame at this size, with what is set by hand.
    fn fitted(&self) -> Result<CameraModel, String> {
        let Self { size: (width, height), number, proxy, pixel_aspect, settings, .. } = self;
        // A camera is that of the frame of full size.
        let [across, down] = proxy.map(f64::from);
        let full = ((*width as f64 / across).round() as usize, (*height as f64 / down).round() as usize);
        let (mut model, name) = match self.camera {
            Some((track, name)) => (sized_to(&track.at(*number), full, *pixel_aspect), name),
            None => (naive(self.size, Transfer::Srgb), "the camera"),
        };
        if let Some(scale) = settings.scale {
            model = model.to_metric(scale);
        }
        let by_hand =
            ByHand { blur_px: settings.by_hand.blur_px.map(|px| proxy[0] * px), ..settings.by_hand };
        let mut model =
            by_hand.applied(model.scaled_to(*width, *height)).map_err(|e| format!("{name}: {e}"))?;
        if self.depth.is_none() {
            // A lens acts on depth; one whose unit is not known must not stop a frame that has none.
            model.defocus = Estimate::unknown(Reason::NoDepth, "there is no depth");
        }
        let track = in_metres(model.into(), name, None).map_err(|e| match e {
            Error::NoSceneScale { .. } => format!("{e}: set the scene's scale, or focus and blur"),
            e => e.to_string(),
        })?;
        Ok(track.at(*number).into_owned())
    }
}
