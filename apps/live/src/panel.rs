//! The contents of the window: the picture, and beside it the camera's parameters, frame times and controls.

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

/// The weight of the old value in the running means of the frame times, 0 to 1.
const KEPT: f32 = 0.9;
/// The least width of a column of names or values, points: that of the longest name, so that a table has room for it at once.
const COLUMN: f32 = 104.0;

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

/// Shows the picture and a panel of this width, points.
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
    // The parameters stand below the controls, so that the controls do not move when a text gets longer.
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

/// The name of a value, in lower case.
fn lower(value: impl std::fmt::Debug) -> String {
    format!("{value:?}").to_lowercase()
}
