//! The window: the picture with a line to drag, the camera's parameters, and controls.

use super::{
    SIZES, Scene,
    panel::{self, Action, Controls, Shown},
    spectra::Spectra,
    times::Times,
};
use blindaug::{Encoded, colour_space::ColourSpace, fit::track::TileObserver};
use blindaug_cli::console::{self, Failure, Result, failure, note};
use blindaug_gpu::Gpu;
use blindaug_io::{VideoShape, VideoWriter};
use blindaug_pipeline::live::{Home, LiveEstimate, LiveEstimator, LiveFrame, Pace, Player};
use blindaug_report::words::count;
use blindaug_stage::{Look, Stage};
use std::{
    path::PathBuf,
    sync::{
        Arc, Mutex,
        atomic::{AtomicBool, Ordering},
        mpsc::{Receiver, Sender, SyncSender, TrySendError, channel, sync_channel},
    },
    thread::JoinHandle,
    time::{Duration, Instant},
};
use winit::{
    application::ApplicationHandler,
    dpi::{LogicalSize, PhysicalSize},
    event::WindowEvent,
    event_loop::{ActiveEventLoop, ControlFlow, EventLoop, EventLoopProxy, OwnedDisplayHandle},
    window::{Window, WindowId},
};

/// The width of the panel beside the picture, points.
pub const PANEL: f32 = 320.0;
/// The width of the picture at first, points.
const PICTURE: f64 = 940.0;
/// The height of the window at first, points: the panel fits into it, and with a title and a bar of the desktop it fits a screen of 1280 x 800.
pub const HEIGHT: f64 = 720.0;
/// The most frames that wait to be recorded.
const QUEUE: usize = 4;
/// The time between checks for Ctrl-C.
const WAKE: Duration = Duration::from_millis(100);

/// The event of a new frame or estimate.
#[derive(Debug)]
struct News;

/// Tells the window that there is something new, but only once until the window has looked. Otherwise, where drawing is slower than the
/// frames come, the window would never get to anything else.
#[derive(Clone)]
struct Bell {
    window: EventLoopProxy<News>,
    rung: Arc<AtomicBool>,
}

impl Bell {
    /// Notifies the window, and returns whether there still is one.
    fn ring(&self) -> bool {
        self.rung.swap(true, Ordering::AcqRel) || self.window.send_event(News).is_ok()
    }
}

/// Opens the window and runs until it is closed.
pub fn run(scene: Scene, look: Look) -> Result<()> {
    let events = EventLoop::<News>::with_user_event().build().map_err(|e| no_window(&e))?;
    let [smallest, largest] = [SIZES.start(), SIZES.end()].map(|share| (share * scene.seen()) as f32);
    let sizes = smallest..=largest;
    let scene = Arc::new(scene);
    let bell = Bell { window: events.create_proxy(), rung: Arc::default() };
    // A camera has its own pace, whatever frame rate it names.
    let pace = if scene.is_camera() { Pace::AsTheyCome } else { Pace::FramesPerSecond(scene.pace()) };
    let of_player = bell.clone();
    let player = Player::start(scene.source.clone(), pace, move || of_player.ring());
    let worker = Worker::start(&scene, bell.clone());
    let mut app = App {
        display: events.owned_display_handle(),
        controls: Controls { look, sizes, home: scene.home, paused: false },
        scene,
        bell,
        has_news: false,
        player,
        was_paused: false,
        worker,
        window: None,
        graphics: None,
        pending: None,
        shown: Shown::default(),
        shot: None,
        estimate: None,
        recording: None,
        recovering: false,
        result: Ok(()),
    };
    let ran = events.run_app(&mut app).map_err(|e| no_window(&e));
    // Whatever happened, the recording is kept.
    let recorded = app.stop_recording();
    if app.shown.skipped > 0 {
        note(format_args!("{}", app.shown.skips()));
    }
    ran?;
    app.result.and(recorded)
}

fn no_window(e: &dyn std::fmt::Display) -> Failure {
    let why = without_place(&e.to_string());
    Failure(format!("no window can be opened ({why}); add --headless --frames N -o OUT to do without"))
}

/// The reason why the system refused something, in one line, without the place in winit's source code.
fn without_place(why: &str) -> String {
    let rest = why.strip_prefix("os error at ").and_then(|rest| rest.split_once(": "));
    rest.map_or(why, |(_, rest)| rest).replace('\n', " ")
}

/// An estimate and the time that it took.
struct Timed {
    estimate: LiveEstimate,
    time: Duration,
}

/// Estimates from frames in a thread, one frame at a time.
struct Worker {
    /// The channel to the thread, which takes a frame only while the thread waits for one.
    shots: SyncSender<(LiveFrame, Home)>,
    estimates: Receiver<Result<Timed>>,
    /// What looks at tiles on a device that was opened, until the thread takes it.
    spectra: Arc<Mutex<Option<Spectra>>>,
    /// The home of the frame that the thread took last.
    home: Home,
}

impl Worker {
    fn start(scene: &Arc<Scene>, bell: Bell) -> Self {
        let (shots, given) = sync_channel::<(LiveFrame, Home)>(0);
        let (made, estimates): (Sender<Result<Timed>>, _) = channel();
        let (scene, first) = (scene.clone(), scene.home);
        let spectra = Arc::<Mutex<Option<Spectra>>>::default();
        let opened = spectra.clone();
        std::thread::spawn(move || {
            let mut estimation = LiveEstimator::new(scene.camera, scene.home, scene.fps);
            let mut spectra = None;
            for (shot, home) in given {
                if let Some(new) = opened.lock().ok().and_then(|mut o| o.take()) {
                    spectra = Some(new);
                }
                let start = Instant::now();
                let observer = spectra.as_mut().filter(|s| s.works()).map(|s| s as &mut dyn TileObserver);
                let estimate =
                    estimation.push(&shot, home, observer).map_err(|e| failure(scene.source.path(), e));
                let timed = estimate.map(|estimate| Timed { estimate, time: start.elapsed() });
                if made.send(timed).is_err() || !bell.ring() {
                    return;
                }
            }
        });
        Self { shots, estimates, spectra, home: first }
    }

    /// Estimates with the device of a stage from the next frame on, if that is faster.
    fn use_device(&self, stage: &Stage, size: (usize, usize)) {
        if let Ok(mut spectra) = self.spectra.lock() {
            *spectra = Spectra::of(stage, size);
        }
    }

    /// Gives the thread a frame if it waits for one.
    fn offer(&mut self, shot: &LiveFrame, home: Home) -> Result<()> {
        match self.shots.try_send((shot.clone(), home)) {
            Ok(()) => self.home = home,
            Err(TrySendError::Full(_)) => {}
            Err(TrySendError::Disconnected(_)) => return Err(Failure("the estimation has ended".into())),
        }
        Ok(())
    }
}

/// Writes pictures to a video.
struct Recording {
    path: PathBuf,
    pictures: SyncSender<Encoded>,
    writer: JoinHandle<Result<()>>,
    /// The number of the frame that was recorded last; 0: the next frame follows without a gap.
    number: u64,
}

impl Recording {
    /// Begins to write under the first free name in the working directory.
    fn start(scene: &Scene) -> Result<Self> {
        let name = |i: u32| PathBuf::from(format!("blindaug-live-{i}.mp4"));
        let path = (1..).map(name).find(|p| !p.exists()).unwrap_or_else(|| name(0));
        let pixel_aspect = scene.source.pixel_aspect().unwrap_or(1.0);
        let shape = VideoShape { size: scene.source.size(), fps: scene.pace(), pixel_aspect };
        let mut video = VideoWriter::create_in(&path, shape, (ColourSpace::SRGB, 8))?;
        let name = path.clone();
        let (pictures, given) = sync_channel::<Encoded>(QUEUE);
        let writer = std::thread::spawn(move || {
            let mut written = 0;
            for picture in given {
                video.write(&picture)?;
                written += 1;
            }
            video.finish()?;
            note(format_args!("{}: {} written", name.display(), count(written, "frame")));
            Ok(())
        });
        Ok(Self { path, pictures, writer, number: 0 })
    }

    /// Adds a picture, more than once where frames before it were not shown, so that the video keeps its pace.
    fn write(&mut self, number: u64, picture: &Encoded) {
        let times = if self.number == 0 { 1 } else { number.saturating_sub(self.number) };
        for _ in 0..times {
            // If the writer has failed, `finish` returns its error.
            let _ = self.pictures.send(picture.clone());
        }
        self.number = number;
    }

    fn finish(self) -> Result<PathBuf> {
        drop(self.pictures);
        match self.writer.join() {
            Ok(result) => result.map(|()| self.path),
            Err(_) => Err(failure(&self.path, "the video cannot be written")),
        }
    }
}

/// The reason why the window does not go on.
enum Trouble {
    /// The surface failed, and another one may help.
    Surface(&'static str),
    Other(Failure),
}

impl From<Failure> for Trouble {
    fn from(failure: Failure) -> Self {
        Self::Other(failure)
    }
}

/// The objects that belong to a device and a surface.
struct Graphics {
    window: Arc<Window>,
    surface: wgpu::Surface<'static>,
    config: wgpu::SurfaceConfiguration,
    stage: Stage,
    context: egui::Context,
    input: egui_winit::State,
    renderer: egui_wgpu::Renderer,
    picture: egui::TextureId,
}

impl Graphics {
    fn new(display: &OwnedDisplayHandle, window: &Arc<Window>, scene: &Scene) -> Result<Self> {
        let wrong = |e: &dyn std::fmt::Display| Failure(e.to_string().replace('\n', " "));
        let descriptor =
            wgpu::InstanceDescriptor::new_with_display_handle_from_env(Box::new(display.clone()));
        let instance = Gpu::instance(descriptor);
        // If there is no device at all, that is the reason.
        let why = |e: wgpu::CreateSurfaceError| Gpu::new().err().map_or_else(|| wrong(&e), |e| wrong(&e));
        let surface = instance.create_surface(window.clone()).map_err(why)?;
        let (gpu, adapter) = Gpu::for_surface(&instance, &surface).map_err(|e| wrong(&e))?;
        let PhysicalSize { width, height } = window.inner_size();
        let Some(mut config) = surface.get_default_config(&adapter, width.max(1), height.max(1)) else {
            return Err(Failure("the graphics device cannot draw in this window".into()));
        };
        // The picture's values and the controls' colours are display-encoded already.
        let formats = surface.get_capabilities(&adapter).formats;
        config.format = formats.into_iter().find(|f| !f.is_srgb()).unwrap_or(config.format);
        surface.configure(&gpu.device, &config);
        let mut renderer = egui_wgpu::Renderer::new(&gpu.device, config.format, Default::default());
        let stage = scene.stage_on(gpu)?;
        let device = &stage.gpu().device;
        let picture = renderer.register_native_texture(device, stage.picture(), wgpu::FilterMode::Linear);
        let context = egui::Context::default();
        let largest = device.limits().max_texture_dimension_2d as usize;
        let scale = Some(window.scale_factor() as f32);
        let input = egui_winit::State::new(
            context.clone(),
            egui::ViewportId::ROOT,
            window,
            scale,
            None,
            Some(largest),
        );
        Ok(Self { window: window.clone(), surface, config, stage, context, input, renderer, picture })
    }

    fn resize(&mut self, size: PhysicalSize<u32>) {
        // A minimised window has no pixels.
        (self.config.width, self.config.height) = (size.width.max(1), size.height.max(1));
        self.surface.configure(&self.stage.gpu().device, &self.config);
    }

    /// Draws the window, and returns the button that was clicked. `None`, too, if there is no surface to draw on just now.
    fn draw(
        &mut self,
        scene: &Scene,
        shown: &Shown,
        controls: &mut Controls,
    ) -> std::result::Result<Option<Action>, Trouble> {
        use wgpu::CurrentSurfaceTexture as Current;
        let mut outdated = false;
        let target = match self.surface.get_current_texture() {
            Current::Success(target) => target,
            Current::Suboptimal(target) => {
                outdated = true;
                target
            }
            Current::Outdated => {
                self.resize(self.window.inner_size());
                self.window.request_redraw();
                return Ok(None);
            }
            Current::Timeout | Current::Occluded => return Ok(None),
            Current::Lost | Current::Validation => {
                return Err(Trouble::Surface("the window's surface was lost"));
            }
        };
        let mut action = None;
        let input = self.input.take_egui_input(&self.window);
        let picture = (self.picture, scene.source.size());
        let mut output =
            self.context.run_ui(input, |ui| action = panel::show(ui, PANEL, picture, shown, controls));
        self.input.handle_platform_output(&self.window, output.platform_output);
        if output.viewport_output.values().any(|v| v.repaint_delay.is_zero()) {
            self.window.request_redraw();
        }
        let triangles = self.context.tessellate(output.shapes, output.pixels_per_point);
        let screen = egui_wgpu::ScreenDescriptor {
            size_in_pixels: [self.config.width, self.config.height],
            pixels_per_point: output.pixels_per_point,
        };
        let Gpu { device, queue, .. } = self.stage.gpu();
        for (id, deltas) in output.textures_delta.set.drain() {
            for delta in &deltas {
                self.renderer.update_texture(device, queue, id, delta);
            }
        }
        let mut encoder = device.create_command_encoder(&Default::default());
        let mut commands = self.renderer.update_buffers(device, queue, &mut encoder, &triangles, &screen);
        let view = target.texture.create_view(&Default::default());
        let pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("window"),
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view: &view,
                depth_slice: None,
                resolve_target: None,
                ops: wgpu::Operations {
                    load: wgpu::LoadOp::Clear(wgpu::Color::BLACK),
                    store: wgpu::StoreOp::Store,
                },
            })],
            ..Default::default()
        });
        self.renderer.render(&mut pass.forget_lifetime(), &triangles, &screen);
        commands.push(encoder.finish());
        queue.submit(commands);
        queue.present(target);
        for id in output.textures_delta.free.drain() {
            self.renderer.free_texture(&id);
        }
        if outdated {
            self.resize(self.window.inner_size());
        }
        self.stage.check().map_err(|e| Failure(e.to_string()))?;
        Ok(action)
    }
}

struct App {
    display: OwnedDisplayHandle,
    scene: Arc<Scene>,
    controls: Controls,
    bell: Bell,
    has_news: bool,
    player: Player,
    was_paused: bool,
    worker: Worker,
    window: Option<Arc<Window>>,
    graphics: Option<Graphics>,
    /// The newest frame, while its estimate is waited for.
    pending: Option<LiveFrame>,
    /// The frame in the picture.
    shot: Option<LiveFrame>,
    estimate: Option<Timed>,
    shown: Shown,
    recording: Option<Recording>,
    /// Whether nothing has been drawn since the graphics were made anew.
    recovering: bool,
    result: Result<()>,
}

impl App {
    /// Draws and estimates on a device from now on, and says what is slow about it.
    fn begin_on(&mut self, graphics: Graphics) {
        self.worker.use_device(&graphics.stage, self.scene.source.size());
        let slow = graphics.stage.slow();
        if let (Some(sentence), false) = (&slow, self.recovering) {
            note(format_args!("{sentence}"));
        }
        self.shown.slow = slow;
        self.graphics = Some(graphics);
    }

    /// Takes new frames and estimates, and makes the picture. A frame is shown when it has been estimated or when the next one
    /// is there, whatever comes first.
    fn follow(&mut self) -> Result<()> {
        let mut due = None;
        let Controls { home, paused, .. } = self.controls;
        if let Some(shot) = self.player.newest()? {
            self.worker.offer(&shot, home)?;
            due = self.pending.replace(shot);
        } else if let (Some(shot), true) = (self.pending.as_ref().or(self.shot.as_ref()), paused)
            && home != self.worker.home
        {
            // The object is moved in the frame that stands still.
            self.worker.offer(shot, home)?;
        }
        while let Ok(estimate) = self.worker.estimates.try_recv() {
            self.estimate = Some(estimate?);
        }
        let estimated = self.estimate.as_ref().map_or(0, |e| e.estimate.tracked.frame);
        if self.pending.as_ref().is_some_and(|p| p.number <= estimated) {
            due = self.pending.take();
        }
        let new = due.is_some();
        self.shot = due.or(self.shot.take());
        // The controls still act while the picture is paused.
        if new || self.controls.paused {
            self.make_picture(new)?;
        }
        Ok(())
    }

    fn make_picture(&mut self, new: bool) -> Result<()> {
        let (Some(shot), Some(Timed { estimate, time }), Some(graphics)) =
            (&self.shot, &self.estimate, &self.graphics)
        else {
            return Ok(());
        };
        let of_device = |e: blindaug::Error| Failure(e.to_string());
        let times =
            Times::of_drawing(&graphics.stage, shot, estimate, &self.controls.look).map_err(of_device)?;
        self.shown.add(shot.number, estimate, *time, times, new);
        let rounded = graphics.stage.rounded(&estimate.camera, &self.controls.look);
        if let (Some(sentence), true) = (&rounded, self.shown.rounded != rounded) {
            note(format_args!("{sentence}"));
        }
        self.shown.rounded = rounded;
        if let (Some(recording), true) = (&mut self.recording, new) {
            recording.write(shot.number, &graphics.stage.read().map_err(of_device)?);
        }
        Ok(())
    }

    fn redraw(&mut self) -> std::result::Result<(), Trouble> {
        let Some(graphics) = &mut self.graphics else { return Ok(()) };
        let action = graphics.draw(&self.scene, &self.shown, &mut self.controls)?;
        self.recovering = false;
        let was_paused = std::mem::replace(&mut self.was_paused, self.controls.paused);
        self.player.set_paused(self.controls.paused);
        if let (Some(recording), true) = (&mut self.recording, was_paused || self.controls.paused) {
            // The frames that a camera filmed during the pause are not a gap to fill.
            recording.number = 0;
        }
        match action {
            Some(Action::Record) if self.recording.is_some() => {
                if let Err(Failure(sentence)) = self.stop_recording() {
                    self.shown.message = sentence;
                }
            }
            Some(Action::Record) => match Recording::start(&self.scene) {
                Ok(recording) => {
                    self.shown.message = format!("recording to {}", recording.path.display());
                    self.recording = Some(recording);
                }
                Err(Failure(sentence)) => self.shown.message = sentence,
            },
            None => {}
        }
        self.shown.recording = self.recording.is_some();
        Ok(())
    }

    /// Completes the recording, if there is one.
    fn stop_recording(&mut self) -> Result<()> {
        if let Some(recording) = self.recording.take() {
            self.shown.message = format!("written: {}", recording.finish()?.display());
        }
        Ok(())
    }

    /// Closes the window after a failure, unless new graphics may help.
    fn settle(&mut self, events: &ActiveEventLoop, result: std::result::Result<(), Trouble>) {
        let on_surface = matches!(result, Err(Trouble::Surface(_)));
        let e = match result {
            Ok(()) => return,
            Err(Trouble::Surface(sentence)) => Failure(sentence.into()),
            Err(Trouble::Other(e)) => e,
        };
        let on_device = on_surface || self.graphics.as_ref().is_some_and(|g| g.stage.check().is_err());
        if let (Some(window), true, false) = (self.window.clone(), on_device, self.recovering) {
            note(format_args!("{}; starting again on a new one", e.0));
            // The old surface must be gone before the window gets another.
            self.graphics = None;
            self.recovering = true;
            match Graphics::new(&self.display, &window, &self.scene) {
                Ok(graphics) => {
                    self.begin_on(graphics);
                    window.request_redraw();
                    return;
                }
                Err(e) => self.result = Err(e),
            }
        } else {
            self.result = Err(e);
        }
        events.exit();
    }
}

impl ApplicationHandler<News> for App {
    fn resumed(&mut self, events: &ActiveEventLoop) {
        if self.window.is_some() {
            return;
        }
        let size = LogicalSize::new(PICTURE + f64::from(PANEL), HEIGHT);
        let attributes = Window::default_attributes().with_title("blindaug live").with_inner_size(size);
        let made = events.create_window(attributes).map_err(|e| no_window(&e));
        let made = made.map(Arc::new).and_then(|window| {
            self.begin_on(Graphics::new(&self.display, &window, &self.scene)?);
            Ok(window)
        });
        match made {
            Ok(window) => self.window = Some(window),
            Err(e) => self.settle(events, Err(e.into())),
        }
    }

    fn user_event(&mut self, _: &ActiveEventLoop, _: News) {
        self.has_news = true;
    }

    fn about_to_wait(&mut self, events: &ActiveEventLoop) {
        if console::interrupted() {
            return events.exit();
        }
        // Ctrl-C does not wake the event loop.
        events.set_control_flow(ControlFlow::WaitUntil(Instant::now() + WAKE));
        // Here the window has handled its events, however fast the news come.
        if !std::mem::take(&mut self.has_news) {
            return;
        }
        self.bell.rung.store(false, Ordering::Release);
        let result = self.follow();
        self.settle(events, result.map_err(Trouble::from));
        if let Some(window) = &self.window {
            window.request_redraw();
        }
    }

    fn window_event(&mut self, events: &ActiveEventLoop, _: WindowId, event: WindowEvent) {
        let Some(graphics) = &mut self.graphics else { return };
        if graphics.input.on_window_event(&graphics.window, &event).repaint {
            graphics.window.request_redraw();
        }
        match event {
            WindowEvent::CloseRequested => events.exit(),
            WindowEvent::Resized(size) => graphics.resize(size),
            WindowEvent::RedrawRequested => {
                let result = self.redraw();
                self.settle(events, result);
            }
            _ => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn why_there_is_no_window_names_no_source_file() {
        let said = "os error at /home/me/winit-0.30/src/linux/mod.rs:788: Failed to open it:\nno server";
        assert_eq!(without_place(said), "Failed to open it: no server");
        assert_eq!(without_place("neither this: nor that"), "neither this: nor that");
    }
}
