//! Frames read at their pace by a thread of their own.

use super::frames::{LiveFrame, Loop};
use crate::{Error, Result, footage::Clip};
use std::{
    sync::{
        Arc, Condvar, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant},
};

/// The pace at which a [`Player`] reads frames.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Pace {
    /// This many frames per second, as of a clip; a frame that nobody took is replaced by the next one.
    FramesPerSecond(f64),
    /// As the frames come, as of a camera; a frame that nobody took is replaced by the next one.
    AsTheyCome,
    /// A frame is read when the one before was taken, so that none is left out.
    EveryFrame,
}

/// The frame that is to be shown next.
#[derive(Default)]
struct Slot {
    newest: Option<Result<LiveFrame>>,
    paused: bool,
    /// Whether the player is gone.
    closed: bool,
}

#[derive(Default)]
struct Shared {
    slot: Mutex<Slot>,
    changed: Condvar,
    ended: AtomicBool,
}

impl Shared {
    fn slot(&self) -> MutexGuard<'_, Slot> {
        self.slot.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Reads the frames of a clip in a thread of its own, again and again, and keeps the newest. The thread ends when the player is dropped.
pub struct Player {
    shared: Arc<Shared>,
}

impl Player {
    /// Starts to read a clip. `tell` is called in the thread whenever there is something new, and in a clip that stands still at the
    /// clip's pace; if it returns `false`, reading ends.
    pub fn start<C: Clip + Send + 'static>(
        clip: Arc<C>,
        pace: Pace,
        tell: impl Fn() -> bool + Send + 'static,
    ) -> Self {
        let shared = Arc::new(Shared::default());
        let of_thread = shared.clone();
        std::thread::spawn(move || {
            // Nobody waits for a thread that has ended, even by a panic.
            let _ended = Ended(&of_thread);
            read(&*clip, pace, &of_thread, &tell);
        });
        Self { shared }
    }

    /// The newest frame, if nobody took it yet; the last one is an error if the clip cannot be read on.
    ///
    /// # Errors
    /// If a frame cannot be read, or there is none.
    pub fn newest(&self) -> Result<Option<LiveFrame>> {
        let newest = self.shared.slot().newest.take();
        self.shared.changed.notify_all();
        newest.transpose()
    }

    /// Waits for the next frame; `None` if reading has ended.
    ///
    /// # Errors
    /// If a frame cannot be read, or there is none.
    pub fn next_frame(&self) -> Result<Option<LiveFrame>> {
        let mut slot = self.shared.slot();
        while slot.newest.is_none() && !self.shared.ended.load(Ordering::Acquire) {
            let waited = self.shared.changed.wait_timeout(slot, Duration::from_millis(50));
            slot = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
        let newest = slot.newest.take();
        self.shared.changed.notify_all();
        newest.transpose()
    }

    /// Whether the frame stands still. A clip waits, of a camera the frames in between are left out.
    pub fn set_paused(&self, paused: bool) {
        self.shared.slot().paused = paused;
        self.shared.changed.notify_all();
    }
}

impl Drop for Player {
    fn drop(&mut self) {
        self.shared.slot().closed = true;
        self.shared.changed.notify_all();
    }
}

/// Says, when it is dropped, that reading has ended.
struct Ended<'a>(&'a Shared);

impl Drop for Ended<'_> {
    fn drop(&mut self) {
        self.0.ended.store(true, Ordering::Release);
    }
}

/// Reads until an error, or until nobody wants any more.
fn read(clip: &dyn Clip, pace: Pace, shared: &Shared, tell: &dyn Fn() -> bool) {
    let mut frames = Loop::new(clip);
    let mut due = Instant::now();
    loop {
        let shot = frames.next_frame().and_then(|shot| match shot {
            Some(shot) => Ok(shot),
            None => {
                let error = blindaug::Error::new("there are no frames in it");
                Err(Error::Clip { clip: clip.name(), error })
            }
        });
        let ended = shot.is_err();
        let mut slot = shared.slot();
        match pace {
            Pace::FramesPerSecond(fps) => {
                let period = Duration::from_secs_f64(fps.recip());
                while !ended && !slot.closed && (slot.paused || Instant::now() < due) {
                    // A clip that stands still keeps its pace, since controls may act on the frame that is shown.
                    let wait =
                        if slot.paused { period } else { due.saturating_duration_since(Instant::now()) };
                    let waited = shared.changed.wait_timeout(slot, wait);
                    let (after, ended) = waited.unwrap_or_else(PoisonError::into_inner);
                    slot = after;
                    if slot.paused && ended.timed_out() {
                        drop(slot);
                        if !tell() {
                            return;
                        }
                        slot = shared.slot();
                    }
                }
                due = Instant::now().max(due + period);
            }
            Pace::EveryFrame => {
                while slot.newest.is_some() && !slot.closed {
                    slot = shared.changed.wait(slot).unwrap_or_else(PoisonError::into_inner);
                }
            }
            Pace::AsTheyCome => {}
        }
        if slot.closed {
            return;
        }
        if ended || !(slot.paused && pace == Pace::AsTheyCome) {
            slot.newest = Some(shot);
        }
        drop(slot);
        shared.changed.notify_all();
        if !tell() || ended {
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::MemoryClip;
    use blindaug::{Encoded, Raster};

    fn clip() -> Arc<MemoryClip> {
        let frame = |i: u8| Encoded(Raster::filled(4, 4, [f32::from(i) / 255.0; 3]));
        Arc::new(MemoryClip { frames: (1..=3).map(frame).collect(), fps: None })
    }

    #[test]
    fn no_frame_is_left_out_where_every_frame_is_wanted() {
        let player = Player::start(clip(), Pace::EveryFrame, || true);
        let numbers: Vec<u64> =
            (0..7).map(|_| player.next_frame().unwrap().expect("a clip has no end").number).collect();
        assert_eq!(numbers, [1, 2, 3, 4, 5, 6, 7]);
    }

    #[test]
    fn a_clip_keeps_its_pace_and_leaves_out_what_nobody_took() {
        let player = Player::start(clip(), Pace::FramesPerSecond(100.0), || true);
        let first = player.next_frame().unwrap().unwrap().number;
        let start = Instant::now();
        std::thread::sleep(Duration::from_millis(300));
        let later = player.next_frame().unwrap().unwrap().number;
        let most = 2.0 + 100.0 * start.elapsed().as_secs_f64();
        assert!(later > first + 3 && ((later - first) as f64) < most, "{first} {later}");
    }

    #[test]
    fn a_clip_stands_still_while_it_is_paused() {
        let player = Player::start(clip(), Pace::FramesPerSecond(200.0), || true);
        player.next_frame().unwrap().unwrap();
        player.set_paused(true);
        // The frame that was read already may still come.
        std::thread::sleep(Duration::from_millis(100));
        let _ = player.newest().unwrap();
        std::thread::sleep(Duration::from_millis(100));
        assert!(player.newest().unwrap().is_none());
        player.set_paused(false);
        assert!(player.next_frame().unwrap().is_some());
    }

    #[test]
    fn a_clip_without_frames_is_an_error_and_then_an_end() {
        let player = Player::start(Arc::new(MemoryClip::default()), Pace::EveryFrame, || true);
        assert!(player.next_frame().unwrap_err().to_string().contains("there are no frames"));
        assert!(player.next_frame().unwrap().is_none());
    }

    #[test]
    fn the_thread_ends_with_its_player() {
        let alive = Arc::new(());
        let kept = alive.clone();
        let player = Player::start(clip(), Pace::EveryFrame, move || Arc::strong_count(&kept) > 0);
        player.next_frame().unwrap();
        assert_eq!(Arc::strong_count(&alive), 2);
        drop(player);
        let start = Instant::now();
        while Arc::strong_count(&alive) > 1 && start.elapsed() < Duration::from_secs(5) {
            std::thread::sleep(Duration::from_millis(5));
        }
        assert_eq!(Arc::strong_count(&alive), 1);
    }
}
