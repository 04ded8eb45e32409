/// What a job says while it runs, and how it is asked to stop: the only mouth and ear of this crate. Each method has a silent default.
pub trait Observer {
    /// A loop begins that does `what` ("estimating") to `total` things called `unit` ("frames"), if their number is known.
    fn begin(&self, what: &'static str, unit: &'static str, total: Option<usize>) {
        let _ = (what, unit, total);
    }

    /// One more of them is done.
    fn step(&self) {}

    /// The loop has ended, whether or not all was done.
    fn end(&self) {}

    /// Something that the user should know, one sentence without a full stop.
    fn note(&self, sentence: &str) {
        let _ = sentence;
    }

    /// Something was left out or may be wrong.
    fn warning(&self, sentence: &str) {
        let _ = sentence;
    }

    /// Whether the job is to stop after the frame in hand.
    fn stops(&self) -> bool {
        false
    }
}

/// An observer that says nothing and never stops a job.
#[derive(Clone, Copy, Debug, Default)]
pub struct Silent;

impl Observer for Silent {}

/// Ends a loop when it is dropped, also where an error leaves it.
pub(crate) struct Steps<'a>(&'a dyn Observer);

impl<'a> Steps<'a> {
    pub(crate) fn begin(observer: &'a dyn Observer, what: &'static str, total: Option<usize>) -> Self {
        observer.begin(what, "frames", total);
        Self(observer)
    }

    pub(crate) fn step(&self) {
        self.0.step();
    }
}

impl Drop for Steps<'_> {
    fn drop(&mut self) {
        self.0.end();
    }
}
