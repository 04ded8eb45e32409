//! The contents of the window: the picture, and beside it the camera's parameters, frame times and controls.

use super::{DISTANCES, times::Times};
use blindaug::synth::defocus::Bokeh;
use blindaug_gpu::Quality;
use blindaug_pipeline::live::{Home, LiveEstimate};
use blindaug_report::words::{count, parameters};
use blindaug_stage::Look;
use egui::{
    CentralPanel, Color32, ComboBox, CursorIcon, Frame, Grid, Panel, Rect, ScrollArea, Sense, Slider,
    TextureId, Ui, pos2, scroll_area::ScrollAreaOutput, vec2,
};
use std::{
    ops::RangeInclusive,
    time::{Duration, Instant},
};

/// The weight of the old value in the running means of the frame times, 0 to 1.
const KEPT: f32 = 0.9;
/// The least width of a column of names or values, points: that of the longest name, so that a table has room for it at once.
const COLUMN: f32 = 104.0;

/// The space between the rows of the panel, points: a little less than usual, so that all of them fit a small screen.
const SPACING: f32 = 2.0;

/// The settings that can be changed in the window.
#[derive(Clone, Debug)]
pub struct Controls {
    /// The look of the picture.
    pub look: Look,
    /// The range of the object's longest side, m.
    pub sizes: RangeInclusive<f32>,
    /// The place of the object until a plane is found. If it changes, the object is placed anew.
    pub home: Home,
    /// Whether the frame stands still.
    pub paused: bool,
}

/// The button that was clicked.
#[derive(Clone, Copy, Debug)]
pub enum Action {
    /// Start to record, or stop.
    Record,
}

/// The data that the panel shows.
#[derive(Default)]
pub struct Shown {
    /// Whether the picture is recorded.
    pub recording: bool,
    /// A sentence about the last event.
    pub message: String,
    /// A sentence about what is slow here, if anything is.
    pub slow: Option<String>,
    /// A sentence about the shape of out-of-focus points, if it is not the camera's.
    pub rounded: Option<String>,
    /// The number of frames that came, but were not shown, since drawing or estimating took longer.
    pub skipped: u64,
    number: u64,
    on_plane: bool,
    /// The name and the value of each parameter, or the reason why it is unknown.
    parameters: Vec<(&'static str, String)>,
    /// The name and the running mean of each time, ms.
    times: [(&'static str, f32); 4],
    last: Option<Instant>,
}

impl Shown {
    /// Takes the data of a picture. `new`: the picture is of another frame than the last one.
    pub fn add(&mut self, number: u64, estimate: &LiveEstimate, time: Duration, times: Times, new: bool) {
        // The frames that a camera films while the picture stands still are not skipped.
        if new && self.last.is_some() {
            self.skipped += number.saturating_sub(self.number + 1);
        }
        self.number = number;
        self.on_plane = estimate.placed.on_plane;
        self.parameters = parameters(&estimate.tracked.camera);
        // The time for which the picture stood still does not count as time between frames.
        let last = if new { self.last.replace(Instant::now()) } else { self.last.take() };
        if !new {
            return;
        }
        let fresh = [
            ("estimate", Some(time)),
            ("render", Some(times.render)),
            ("composite", Some(times.composite)),
            ("between frames", last.map(|last| last.elapsed())),
        ];
        for ((shown, mean), (name, time)) in self.times.iter_mut().zip(fresh) {
            *shown = name;
            let Some(time) = time else { continue };
            let ms = 1e3 * time.as_secs_f32();
            *mean = if *mean > 0.0 { KEPT * *mean + (1.0 - KEPT) * ms } else { ms };
        }
    }
}

impl Shown {
    /// A sentence about the frames that were skipped, without a full stop.
    pub fn skips(&self) -> String {
        match self.skipped {
            0 => "no frame was skipped".into(),
            skipped => {
                let share = 100.0 * skipped as f64 / self.number.max(1) as f64;
                format!(
                    "{skipped} of {} ({share:.0} %) skipped, since they came too fast",
                    count(self.number, "frame")
                )
            }
        }
    }
}

/// Shows the picture and a panel of this width, points.
pub fn show(
    ui: &mut Ui,
    width: f32,
    picture: (TextureId, (usize, usize)),
    shown: &Shown,
    controls: &mut Controls,
) -> Option<Action> {
    let action = panel(ui, width, shown, controls).inner;
    CentralPanel::default().frame(Frame::NONE).show(ui, |ui| view(ui, picture, &mut controls.look.split));
    action
}

/// Shows the panel, which can be scrolled where the window is too low for it.
fn panel(
    ui: &mut Ui,
    width: f32,
    shown: &Shown,
    controls: &mut Controls,
) -> ScrollAreaOutput<Option<Action>> {
    let panel = Panel::right("panel").exact_size(width).resizable(false);
    panel.show(ui, |ui| ScrollArea::vertical().show(ui, |ui| beside(ui, shown, controls))).inner
}

/// Shows the picture, as large as fits. The line follows a pointer that is dragged.
fn view(ui: &mut Ui, (texture, (w, h)): (TextureId, (usize, usize)), split: &mut f32) {
    let room = ui.available_rect_before_wrap();
    let size = vec2(w as f32, h as f32);
    let scale = (room.size() / size).min_elem();
    let rect = Rect::from_center_size(room.center(), scale * size);
    let response = ui.interact(rect, ui.scope_id().with("picture"), Sense::click_and_drag());
    if let (Some(at), true) = (response.interact_pointer_pos(), rect.width() > 0.0) {
        *split = ((at.x - rect.left()) / rect.width()).clamp(0.0, 1.0);
    }
    response.on_hover_cursor(CursorIcon::ResizeHorizontal);
    ui.painter().image(texture, rect, Rect::from_min_max(pos2(0.0, 0.0), pos2(1.0, 1.0)), Color32::WHITE);
}

fn beside(ui: &mut Ui, shown: &Shown, controls: &mut Controls) -> Option<Action> {
    let Controls { look, sizes, home, paused } = controls;
    ui.spacing_mut().item_spacing.y = SPACING;
    ui.heading("Object");
    ui.label(if shown.on_plane { "on a plane that is tracked" } else { "fixed in view: no plane was found" });
    ui.add(Slider::new(&mut look.size, sizes.clone()).logarithmic(true).text("longest side, m"));
    ui.add(Slider::new(&mut home.distance, DISTANCES).logarithmic(true).text("distance, m"));
    ui.add(Slider::new(&mut home.at.x, 0.0..=1.0).text("across"));
    ui.add(Slider::new(&mut home.at.y, 0.0..=1.0).text("down"));
    ui.separator();
    ui.heading("Composite");
    let shape = look.options.bokeh.unwrap_or_default();
    ComboBox::from_label("bokeh").selected_text(lower(shape)).show_ui(ui, |ui| {
        for bokeh in [Bokeh::Gaussian, Bokeh::Disk] {
            ui.selectable_value(&mut look.options.bokeh, Some(bokeh), lower(bokeh));
        }
    });
    // The processor has one quality, that of the reference.
    ui.add_enabled_ui(shown.slow.is_none(), |ui| {
        ComboBox::from_label("quality").selected_text(lower(look.quality)).show_ui(ui, |ui| {
            for quality in [Quality::High, Quality::Medium, Quality::Low] {
                ui.selectable_value(&mut look.quality, quality, lower(quality));
            }
        });
    });
    ui.checkbox(&mut look.options.no_noise, "leave the noise out");
    ui.checkbox(paused, format!("pause at frame {}", shown.number));
    let clicked = ui.button(if shown.recording { "Stop recording" } else { "Record" }).clicked();
    if !shown.message.is_empty() {
        ui.add(egui::Label::new(&shown.message).wrap());
    }
    ui.separator();
    // The parameters stand below the controls, so that the controls do not move when a text gets longer.
    ui.heading("Camera");
    // Rows of their own, not a table: a table has the heights that its rows had in the picture before.
    for (name, value) in &shown.parameters {
        ui.horizontal_top(|ui| {
            ui.allocate_ui(vec2(COLUMN, 0.0), |ui| {
                ui.set_min_width(COLUMN);
                ui.label(*name);
            });
            // The reason why something is unknown may be long.
            let value = egui::RichText::new(value);
            let value = if value.text().starts_with("unknown") { value.small() } else { value };
            ui.add(egui::Label::new(value).wrap());
        });
    }
    ui.small("Intervals are 95 %; noise is the std of R, G, B at luminance 0.5.");
    ui.separator();
    ui.heading("Frame times");
    Grid::new("times").num_columns(2).min_col_width(COLUMN).striped(true).show(ui, |ui| {
        for (name, ms) in &shown.times {
            ui.label(*name);
            ui.label(format!("{ms:.1} ms"));
            ui.end_row();
        }
    });
    ui.add(egui::Label::new(shown.skips()).wrap());
    for sentence in [&shown.slow, &shown.rounded].into_iter().flatten() {
        ui.add(egui::Label::new(egui::RichText::new(sentence).color(ui.visuals().warn_fg_color)).wrap());
    }
    clicked.then_some(Action::Record)
}

/// The name of a value, in lower case.
fn lower(value: impl std::fmt::Debug) -> String {
    format!("{value:?}").to_lowercase()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::window::{HEIGHT, PANEL};
    use blindaug::{
        composite::CompositeOptions,
        model::{
            DefocusModel, DepthKind, Estimate, ExposureFraction, Method, MotionBlurModel, NoiseLevel,
            NoiseModel, Reason, SharpeningModel,
        },
    };
    use blindaug_pipeline::live::{LiveEstimator, LiveFrame, Pinhole};
    use glam::DVec2;
    use std::sync::Arc;

    fn controls() -> Controls {
        let options = CompositeOptions::default();
        Controls {
            look: Look { split: 0.5, size: 1.0, options, quality: Quality::High },
            sizes: 0.1..=10.0,
            home: Home { at: DVec2::new(0.5, 0.75), distance: 2.0 },
            paused: false,
        }
    }

    /// An estimate of which everything is known, with intervals, or nothing.
    fn estimate(known: bool) -> LiveEstimate {
        let size = (64, 48);
        let frame = Arc::new(blindaug::Encoded(blindaug::Raster::filled(size.0, size.1, [0.4; 3])));
        let shot = LiveFrame { number: 1, lap: 0, frame, next: None, previous: None };
        let home = controls().home;
        let mut estimate =
            LiveEstimator::new(Pinhole::new(size, 50.0), home, None).push(&shot, home, None).unwrap();
        let camera = &mut estimate.tracked.camera;
        if known {
            camera.motion_blur = Estimate::Known(MotionBlurModel {
                exposure: ExposureFraction(0.482),
                interval: [0.45, 0.51],
                method: Method::Spectral,
                samples: 210,
                phase_degrees: None,
            });
            let mut lens = DefocusModel::given_lens(4.31, 0.167);
            lens.depth_kind = DepthKind::Relative;
            camera.defocus = Estimate::Known(lens);
            let level = NoiseLevel { slope: [0.012, 0.01, 0.018], intercept: [0.01; 3] };
            camera.noise = Estimate::Known(NoiseModel::given([level; 4], 0.98));
            camera.sharpening = Estimate::Known(SharpeningModel::given(0.82, 1.31));
        } else {
            // The longest reason there is.
            camera.defocus = Estimate::unknown(
                Reason::NoDepth,
                "no depth was given, and parallax gives none: 0.44 px of parallax are too little beside 0.09 px of contradiction in \
                 the flow (the camera hardly does more than turn, or the scene moves)",
            );
        }
        estimate
    }

    /// The height of what stands in the panel, and that of the room for it, points.
    fn heights(window: [f32; 2], shown: &Shown) -> [f32; 2] {
        let mut found = [0.0; 2];
        let context = egui::Context::default();
        // The second time, the sizes of texts are known.
        for _ in 0..2 {
            let screen = Rect::from_min_size(pos2(0.0, 0.0), window.into());
            let input = egui::RawInput { screen_rect: Some(screen), ..Default::default() };
            let mut output = context.run_ui(input, |ui| {
                let output = panel(ui, PANEL, shown, &mut controls());
                found = [output.content_size.y, output.inner_rect.height()];
            });
            // Nothing is drawn.
            output.textures_delta.clear();
        }
        found
    }

    #[test]
    fn the_panel_fits_a_small_screen_whatever_is_known() {
        for known in [true, false] {
            let mut shown = Shown {
                slow: Some(
                    "there is no graphics card here, only llvmpipe (LLVM 15.0.6, 256 bits): the processor composites the object, and \
                     estimates"
                        .into(),
                ),
                message: "recording to blindaug-live-1.mp4".into(),
                ..Default::default()
            };
            shown.add(1, &estimate(known), Duration::from_millis(512), Times::default(), true);
            shown.add(4, &estimate(known), Duration::from_millis(512), Times::default(), true);
            let [height, room] = heights([1280.0, HEIGHT as f32], &shown);
            let [needed, _] = heights([1280.0, 2000.0], &shown);
            println!("known: {known}: {height} of {room} points, {needed} in a high window");
            assert!(height <= room, "{height} of {room} points");
            // Negative control: half of the window is too low.
            let [height, room] = heights([1280.0, 0.5 * HEIGHT as f32], &shown);
            assert!(height > room);
        }
    }

    #[test]
    fn frames_that_were_not_shown_are_counted_but_for_those_of_a_pause() {
        let mut shown = Shown::default();
        let estimate = estimate(false);
        let mut add = |number, new| shown.add(number, &estimate, Duration::ZERO, Times::default(), new);
        for (number, new) in [(5, true), (6, true), (9, true), (9, false), (40, true), (41, true)] {
            add(number, new);
        }
        assert_eq!(shown.skipped, 2);
        assert_eq!(shown.skips(), "2 of 41 frames (5 %) skipped, since they came too fast");
    }
}
