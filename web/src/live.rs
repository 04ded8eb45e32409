//! An object in live footage: estimated, drawn and composited frame by frame.

use crate::{
    failure::of,
    frames::{frame, rgba},
    screen::Screen,
};
use blindaug::{
    Encoded, Flow, Plane, Premultiplied, Raster,
    composite::{CompositeOptions, Plate, VirtualLayer, composite},
    model::{Bokeh, TrackedCamera},
};
use blindaug_gpu::Quality;
use blindaug_pipeline::live::{Home, LiveEstimate, LiveEstimator, LiveFrame, Pinhole};
use blindaug_stage::{
    Look, Object, Stage,
    render::{Moment, View, drawn},
};
use glam::DVec2;
use std::{collections::BTreeMap, sync::Arc};
use wasm_bindgen::prelude::*;

/// The frames per second of an animation in footage that does not say its own.
const USUAL_FPS: f64 = 30.0;
/// The number of frames that are kept: one, and its neighbours.
const KEPT: usize = 3;

/// Estimates a camera and the place of an object frame by frame, and puts the object into the frames.
#[wasm_bindgen]
pub struct Live {
    camera: Pinhole,
    fps: Option<f64>,
    home: Home,
    look: Look,
    object: Object,
    view: View,
    estimator: LiveEstimator,
    frames: BTreeMap<u32, Arc<Encoded>>,
    last: Option<(LiveFrame, LiveEstimate)>,
    drawing: Option<(Screen, Stage)>,
}

#[wasm_bindgen]
impl Live {
    /// A built-in object in frames of one size, px, from a camera with a vertical field of view of `fov` degrees.
    #[wasm_bindgen(constructor)]
    pub fn new(width: usize, height: usize, fov: f64, fps: Option<f64>) -> Live {
        let camera = Pinhole::new((width, height), fov);
        let home = Home { at: DVec2::new(0.5, 0.75), distance: 2.0 };
        let object = Object::built_in();
        let options = CompositeOptions::default();
        let size = (0.5 * camera.seen_height(home.distance)) as f32;
        Live {
            view: View::new(&object, camera),
            estimator: LiveEstimator::new(camera, home, fps),
            look: Look { split: 0.5, size, options, quality: Quality::High },
            camera,
            fps,
            home,
            object,
            frames: BTreeMap::new(),
            last: None,
            drawing: None,
        }
    }

    /// The object of a .glb file, or the built-in one; gives sentences about how it was read.
    ///
    /// # Errors
    /// If the file is damaged, refers to other files, or holds more than the device takes.
    #[wasm_bindgen(js_name = setObject)]
    pub fn set_object(&mut self, glb: Option<Vec<u8>>) -> Result<Vec<String>, JsError> {
        let alone = |_: &str, _| Err("is not in the file: save it as one .glb".into());
        let object = match glb {
            Some(bytes) => Object::from_bytes(&bytes, &alone).map_err(of)?,
            None => Object::built_in(),
        };
        if let Some((screen, _)) = &self.drawing {
            let stage = self.stage(screen, &object)?;
            self.drawing = self.drawing.take().map(|(screen, _)| (screen, stage));
        }
        self.view = View::new(&object, self.camera);
        self.object = object;
        Ok(self.object.notes.clone())
    }

    /// Draws on this screen from now on, until the device fails.
    ///
    /// # Errors
    /// If the device cannot hold the object or the frames.
    #[wasm_bindgen(js_name = setScreen)]
    pub fn set_screen(&mut self, screen: Screen) -> Result<(), JsError> {
        screen.configure(self.camera.size);
        let stage = self.stage(&screen, &self.object)?;
        self.drawing = Some((screen, stage));
        Ok(())
    }

    /// Draws by the processor from now on.
    #[wasm_bindgen(js_name = leaveScreen)]
    pub fn leave_screen(&mut self) {
        self.drawing = None;
    }

    /// Takes the device away, as a driver that crashes does: to test what follows.
    #[wasm_bindgen(js_name = loseDevice)]
    pub fn lose_device(&self) {
        if let Some((screen, _)) = &self.drawing {
            screen.gpu.device.destroy();
        }
    }

    /// The object's longest side as a share of the height that is seen at its distance, its first place in shares of width and height, and its
    /// first distance in m; whether noise is left out, and whether out-of-focus points are disks instead of what the lens shows.
    #[wasm_bindgen(js_name = setLook)]
    pub fn set_look(&mut self, size: f64, x: f64, y: f64, distance: f64, no_noise: bool, disk: bool) {
        self.home = Home { at: DVec2::new(x, y), distance };
        self.look.size = (size * self.camera.seen_height(distance)) as f32;
        self.look.options.no_noise = no_noise;
        self.look.options.bokeh = disk.then_some(Bokeh::Disk);
    }

    /// Whether a frame of this number is kept.
    pub fn has(&self, number: u32) -> bool {
        self.frames.contains_key(&number)
    }

    /// Keeps a frame, bytes R, G, B, A.
    ///
    /// # Errors
    /// If there are not as many bytes.
    pub fn add(&mut self, number: u32, rgba: &[u8]) -> Result<(), JsError> {
        self.frames.insert(number, Arc::new(frame(self.camera.size, rgba)?));
        while self.frames.len() > KEPT {
            self.frames.pop_first();
        }
        Ok(())
    }

    /// Estimates from a frame that is kept, and from its neighbours in time where they are kept too; gives the camera as a JSON line. `lap` is the
    /// number of times that a clip had started again.
    ///
    /// # Errors
    /// If the frame is not kept.
    pub fn estimate(&mut self, number: u32, lap: u32) -> Result<String, JsError> {
        let kept = |number: Option<u32>| number.and_then(|n| self.frames.get(&n)).cloned();
        let Some(frame) = kept(Some(number)) else { return Err(JsError::new("there is no such frame")) };
        let shot = LiveFrame {
            number: number.into(),
            lap: lap.into(),
            frame,
            next: kept(number.checked_add(1)),
            previous: kept(number.checked_sub(1)),
        };
        let estimate = self.estimator.push(&shot, self.home, None).map_err(of)?;
        let json = estimate.tracked.to_json_line();
        self.last = Some((shot, estimate));
        Ok(json)
    }

    /// Whether the object stands on a plane that is tracked, rather than fixed in view.
    #[wasm_bindgen(getter, js_name = onPlane)]
    pub fn on_plane(&self) -> bool {
        self.last.as_ref().is_some_and(|(_, estimate)| estimate.placed.on_plane)
    }

    /// The camera as it is applied, with its lens over depth in metres, as a JSON line.
    pub fn applied(&self) -> Option<String> {
        self.last.as_ref().map(|(_, LiveEstimate { tracked, camera, .. })| {
            TrackedCamera { camera: camera.clone(), ..tracked.clone() }.to_json_line()
        })
    }

    /// Draws the frame that was estimated last with the object pasted on, and below it with the object as the camera would have filmed it: on the
    /// screen, or if there is none as bytes R, G, B, A.
    ///
    /// # Errors
    /// If the device failed; then another screen is needed, or none.
    pub fn draw(&self) -> Result<Option<Vec<u8>>, JsError> {
        let (Some((shot, estimate)), Some((screen, stage))) = (&self.last, &self.drawing) else {
            return self.reference().map(Some);
        };
        stage.draw(shot, estimate, &self.look).map_err(of)?;
        screen.show(stage.composites()).map_err(of)?;
        Ok(None)
    }

    /// What [`Live::draw`] shows, by the processor, as bytes R, G, B, A.
    ///
    /// # Errors
    /// If nothing was estimated yet.
    pub fn reference(&self) -> Result<Vec<u8>, JsError> {
        let Some((shot, estimate)) = &self.last else { return Err(JsError::new("there is no frame yet")) };
        let moment = Moment::of(shot, estimate, self.look.size, self.pace());
        let layer = drawn(&self.object, &self.view, &moment);
        let plate = Plate::new(&shot.frame, shot.number);
        let pasted = CompositeOptions { naive: true, ..self.look.options };
        let mut bytes = Vec::with_capacity(8 * self.camera.size.0 * self.camera.size.1);
        for options in [pasted, self.look.options] {
            let made = composite(&plate, &layer, &estimate.camera, &options).map_err(of)?;
            bytes.extend(rgba(&made));
        }
        Ok(bytes)
    }

    /// The frame that was estimated last with a layer of the page's own renderer in place of the object: premultiplied scene-linear R, G, B, A,
    /// inverse depth in 1/m (0: nothing), and motion in px to the next frame (x right, y down), row by row from the top. Gives bytes R, G, B, A.
    ///
    /// # Errors
    /// If nothing was estimated yet, or the arrays do not fit the frame.
    pub fn composite(
        &self,
        color: &[f32],
        inverse_depth: Option<Vec<f32>>,
        flow: Option<Vec<f32>>,
    ) -> Result<Vec<u8>, JsError> {
        let Some((shot, estimate)) = &self.last else { return Err(JsError::new("there is no frame yet")) };
        let layer = layer(self.camera.size, color, inverse_depth, flow)?;
        let plate = Plate::new(&shot.frame, shot.number);
        let made = composite(&plate, &layer, &estimate.camera, &self.look.options).map_err(of)?;
        Ok(rgba(&made).collect())
    }
}

impl Live {
    /// The frames per second of the animation.
    fn pace(&self) -> f64 {
        self.fps.unwrap_or(USUAL_FPS)
    }

    fn stage(&self, screen: &Screen, object: &Object) -> Result<Stage, JsError> {
        Stage::new(screen.gpu.clone(), object.clone(), self.camera, self.pace()).map_err(of)
    }
}

/// A layer from arrays.
fn layer(
    (width, height): (usize, usize),
    color: &[f32],
    inverse_depth: Option<Vec<f32>>,
    flow: Option<Vec<f32>>,
) -> Result<VirtualLayer, JsError> {
    let fits = |name: &str, length: usize, channels: usize| {
        let wanted = channels * width * height;
        if length == wanted {
            return Ok(());
        }
        Err(JsError::new(&format!("{name} of the layer has {length} numbers instead of {wanted}")))
    };
    fits("the colour", color.len(), 4)?;
    inverse_depth.as_ref().map_or(Ok(()), |d| fits("the inverse depth", d.len(), 1))?;
    flow.as_ref().map_or(Ok(()), |f| fits("the motion", f.len(), 2))?;
    let raster = |values: &[f32]| {
        Raster::from_fn(width, height, |x, y| std::array::from_fn(|c| values[4 * (y * width + x) + c]))
    };
    let known = |d: f32| if d > 0.0 { d } else { f32::NAN };
    Ok(VirtualLayer {
        color: Premultiplied::from_render(&raster(color)),
        inverse_depth: inverse_depth.map(|d| Plane::from_fn(width, height, |x, y| known(d[y * width + x]))),
        flow: flow.map(|f| {
            Flow::from_fn(width, height, |x, y| {
                let i = 2 * (y * width + x);
                [f[i], f[i + 1]]
            })
        }),
    })
}
