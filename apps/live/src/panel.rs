//! What is in the window: the picture, and beside it the camera's parameters, frame times and controls.

use super::{
    DISTANCES,
    stage::{Look, Times},
};
use blindaug::synth::defocus::Bokeh;
use blindaug_gpu::Quality;
use blindaug_pipeline::live::{Home, LiveEstimate};
use blindaug_report::words::parameters;
use egui::{
    CentralPanel, Color32, ComboBox, CursorIcon, Frame, Grid, Panel, Rect, ScrollArea, Sense, Slider,
    TextureId, Ui, pos2, vec2,
};
use std::{
    ops::RangeInclusive,
    time::{Duration, Instant},
};

/// How much of the mean frame times is kept from frame to frame.
const KEPT: f32 = 0.9;
/// Width of a column of names or values at least, in points: the longest name's, for a table that has just got it.
const COLUMN: f32 = 104.0;

/// What can be changed in the window.
#[derive(Clone, Debug)]
pub struct Controls {
    /// How the picture is made.
    pub look: Look,
    /// What the object's longest side may be, m.
    pub sizes: RangeInclusive<f32>,
    /// Where the object stands until a plane is found; another place starts anew.
    pub home: Home,
    /// Whether the frame stands still.
    pub paused: bool,
}

/// What was clicked.
#[derive(Clone, Copy, Debug)]
pub enum Action {
    /// Start to record, or stop.
    Record,
}

/// What the panel tells.
#[derive(Default)]
pub struct Shown {
    /// Whether the picture is recorded.
    pub recording: bool,
    /// What happened last, in a sentence.
    pub message: String,
    number: u64,
    on_plane: bool,
    /// Name and value, or why it is unknown.
    parameters: Vec<(&'static str, String)>,
    /// Name and mean, ms.
    times: [(&'static str, f32); 4],
    last: Option<Instant>,
}

impl Shown {
    /// Takes what belongs to a picture; `new`: of another frame than the last one.
    pub fn add(&mut self, number: u64, estimate: &LiveEstimate, time: Duration, times: Times, new: bool) {
        self.number = number;
        self.on_plane = estimate.placed.on_plane;
        self.parameters = parameters(&estimate.tracked.camera);
        // How long the picture stood still is no time between frames.
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

/// Shows everything, with a panel of this width, in points.
pub fn show(
    ui: &mut Ui,
    width: f32,
    picture: (TextureId, (usize, usize)),
    shown: &Shown,
    controls: &mut Controls,
) -> Option<Action> {
    let mut action = None;
    Panel::right("panel").exact_size(width).resizable(false).show(ui, |ui| {
        ScrollArea::vertical().show(ui, |ui| action = beside(ui, shown, controls));
    });
    CentralPanel::default().frame(Frame::NONE).show(ui, |ui| view(ui, picture, &mut controls.look.split));
    action
}

/// The picture, as large as fits; the line follows the pointer that drags.
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
    ui.heading("Object");
    ui.label(if shown.on_plane { "on a plane that is tracked" } else { "fixed in view: no plane was found" });
    ui.add(Slider::new(&mut look.size, sizes.clone()).logarithmic(true).text("longest side, m"));
    ui.add(Slider::new(&mut home.distance, DISTANCES).logarithmic(true).text("distance, m"));
    ui.add(Slider::new(&mut home.at.x, 0.0..=1.0).text("across"));
    ui.add(Slider::new(&mut home.at.y, 0.0..=1.0).text("down"));
    ui.separator();
    ui.heading("Composite");
    ComboBox::from_label("bokeh").selected_text(lower(look.options.bokeh)).show_ui(ui, |ui| {
        for bokeh in [Bokeh::Gaussian, Bokeh::Disk] {
            ui.selectable_value(&mut look.options.bokeh, bokeh, lower(bokeh));
        }
    });
    ComboBox::from_label("quality").selected_text(lower(look.quality)).show_ui(ui, |ui| {
        for quality in [Quality::High, Quality::Medium, Quality::Low] {
            ui.selectable_value(&mut look.quality, quality, lower(quality));
        }
    });
    ui.checkbox(&mut look.options.no_noise, "leave the noise out");
    ui.checkbox(paused, format!("pause at frame {}", shown.number));
    let clicked = ui.button(if shown.recording { "Stop recording" } else { "Record" }).clicked();
    if !shown.message.is_empty() {
        ui.add(egui::Label::new(&shown.message).wrap());
    }
    ui.separator();
    // Below the controls, which so stay where they are whatever is told.
    ui.heading("Camera");
    Grid::new("parameters").num_columns(2).min_col_width(COLUMN).striped(true).show(ui, |ui| {
        for (name, value) in &shown.parameters {
            ui.label(*name);
            ui.add(egui::Label::new(value).wrap());
            ui.end_row();
        }
    });
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
    clicked.then_some(Action::Record)
}

/// A value's name.
fn lower(value: impl std::fmt::Debug) -> String {
    format!("{value:?}").to_lowercase()
}
