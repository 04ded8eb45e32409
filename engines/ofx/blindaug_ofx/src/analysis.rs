//! The camera, estimated from the frames of the plate at the host.

use crate::{
    effect::{self, Failure},
    host::{Clip, Effect, Image, Pixels},
    pixels,
    shot::Colour,
};
use blindaug::{CameraModel, Encoded, Frame, Raster, Transfer, finite_light};
use blindaug_pipeline::{Error, Footage, Observer, Result, estimate, footage};
use openfx::sys::image_effect_v1::image_effect::*;
use std::cell::Cell;

/// The most frames of a clip that are looked at; anything larger is taken for a mistake of the host.
const MOST_FRAMES: f64 = 1e6;

/// The plate as a clip. Its frames are fetched in the thread that goes through them, which is the one of the host's action.
struct Plate {
    clip: Clip,
    /// The time of the first frame, and how many there are.
    first: f64,
    frames: usize,
    /// The place of a frame.
    frame: Pixels,
    pixel_aspect: Option<f32>,
    fps: Option<f64>,
    colour: Colour,
}

impl Plate {
    /// The frame of this number, from 1 on.
    fn frame(&self, number: u64) -> std::result::Result<Frame, Failure> {
        let time = self.first + (number - 1) as f64;
        let image = self.clip.image(time, effect::PLATE_NAME)?.ok_or_else(|| {
            Failure::Sentence(format!("the host has no frame {time} of the plate, though it is in its range"))
        })?;
        check_full_size(&image)?;
        let pixels = pixels::raster(&image, self.frame, [0.0, 0.0, 0.0, 1.0])?;
        let encode = |v: f32| match self.colour {
            Colour::Linear => Transfer::Srgb.encode(v),
            Colour::Srgb => v,
        };
        // As when a file is read.
        let value = |v: f32| encode(finite_light(v, 0.0));
        let image: Raster<[f32; 3]> = pixels.map(|[r, g, b, _]| [r, g, b].map(value));
        Ok(Frame { number, image: Encoded(image) })
    }
}

/// Fails for an image of a proxy: it has less noise than the footage.
fn check_full_size(image: &Image) -> std::result::Result<(), Failure> {
    let scale = |i| image.properties().double(kOfxImageEffectPropRenderScale, i).unwrap_or(1.0);
    if (scale(0) - 1.0).abs() > 1e-6 || (scale(1) - 1.0).abs() > 1e-6 {
        return Err(Failure::Sentence(
            "the host gives the plate at a reduced size, which has another noise: switch proxies off and analyse again"
                .into(),
        ));
    }
    Ok(())
}

impl footage::Clip for Plate {
    fn name(&self) -> String {
        "the plate".into()
    }

    fn size(&self) -> (usize, usize) {
        (self.frame.width(), self.frame.height())
    }

    fn pixel_aspect(&self) -> Option<f32> {
        self.pixel_aspect
    }

    fn fps(&self) -> Option<f64> {
        self.fps
    }

    fn len_hint(&self) -> Option<usize> {
        Some(self.frames)
    }

    fn frames_if<'a>(&'a self, wanted: Box<dyn Fn(u64) -> bool + Send + 'a>) -> footage::Frames<'a> {
        let of_frame = move |number| {
            self.frame(number).map_err(|failure| Error::Frame {
                clip: footage::Clip::name(self),
                number,
                error: blindaug::Error::new(failure.sentence()),
            })
        };
        Box::new((1..=self.frames as u64).filter(move |&number| wanted(number)).map(of_frame))
    }
}

/// Shows how far the estimation has come.
struct Progress<'a> {
    effect: &'a Effect,
    frames: usize,
    done: Cell<usize>,
    cancelled: Cell<bool>,
}

impl Observer for Progress<'_> {
    fn step(&self) {
        self.done.set(self.done.get() + 1);
        if !self.effect.progress(self.done.get() as f64 / self.frames.max(1) as f64) {
            self.cancelled.set(true);
        }
    }

    fn stops(&self) -> bool {
        self.cancelled.get()
    }
}

/// Estimates the camera from all frames of the plate; `None` if the person at the host cancels.
///
/// # Errors
/// If the plate cannot be used.
pub fn estimated(effect: &Effect, colour: Colour) -> std::result::Result<Option<CameraModel>, Failure> {
    let sentence = |s: &str| Failure::Sentence(s.into());
    let clip = effect::connected(effect, effect::PLATE)
        .ok_or_else(|| sentence("connect the plate before it is analysed"))?;
    let range = |i| clip.properties().double(kOfxImageEffectPropFrameRange, i);
    let (Some(first), Some(last)) = (range(0), range(1)) else {
        return Err(sentence("the host does not say which frames the plate has"));
    };
    let frames = (last - first).round() + 1.0;
    if !(1.0..=MOST_FRAMES).contains(&frames) {
        return Err(Failure::Sentence(format!(
            "the plate's frames are {first} to {last}, which cannot be analysed: give it a first and a last frame"
        )));
    }
    let region = effect::FrameRegion::of(effect, first)?;
    let (frame, pixel_aspect) = (region.pixels([1.0; 2])?, region.pixel_aspect());
    let fps = clip.properties().double(kOfxImageEffectPropFrameRate, 0).filter(|fps| *fps > 0.0);
    let frames = frames as usize;
    let plate = Plate { clip, first, frames, frame, pixel_aspect, fps, colour };
    let progress = Progress { effect, frames, done: Cell::new(0), cancelled: Cell::new(false) };
    effect.progress_begin(c"Analysing the plate");
    let fitted: Result<_> = estimate::estimate(&Footage::new(plate), estimate::Job::default(), &progress);
    effect.progress_end();
    match progress.cancelled.get() {
        true => Ok(None),
        false => fitted.map(|f| Some(f.estimation.model)).map_err(|e| Failure::Sentence(e.to_string())),
    }
}
