/// Receives the messages of a running job, and tells the job when to stop. The crate communicates in no other way. By default the methods
/// do nothing.
pub trait Observer {
    /// A loop begins that does `what` ("estimating") to `total` items called `unit` ("frames"). `None`: their number is unknown.
    fn begin(&self, what: &'static str, unit: &'static str, total: Option<usize>) {
        let _ = (what, unit, total);
    }

    /// One more item of the loop is done.
    fn step(&self) {}

    /// The loop has ended, whether or not all items were done.
    fn end(&self) {}

    /// A message that the user should know, one sentence without a full stop.
    fn note(&self, sentence: &str) {
        let _ = sentence;
    }

    /// A warning that something was left out or may be wrong, one sentence without a full stop.
    fn warning(&self, sentence: &str) {
        let _ = sentence;
    }

    /// Whether the job is to stop after the frame in hand.
    fn stops(&self) -> bool {
        false
    }
}

/// Warns an observer of what [`Clip::warning`](crate::Clip::warning) or [`Side::warning`](crate::Side::warning) say, if anything.
pub(crate) fn warn(observer: &dyn Observer, said: Option<String>) {
    if let Some(words) = said {
        observer.warning(&words);
    }
}

/// An observer that says nothing and never stops a job.
#[derive(Clone, Copy, Debug, Default)]
pub struct Silent;

impl Observer for Silent {}

/// A loop of which an observer is told; the observer hears that the loop has ended when this is dropped, also after an error.
pub struct Steps<'a>(&'a dyn Observer);

impl<'a> Steps<'a> {
    /// Begins a loop, as [`Observer::begin`] says.
    pub fn begin(
        observer: &'a dyn Observer,
        what: &'static str,
        unit: &'static str,
        total: Option<usize>,
    ) -> Self {
        observer.begin(what, unit, total);
        Self(observer)
    }

    /// One more item is done.
    pub fn step(&self) {
        self.0.step();
    }
}

impl Drop for Steps<'_> {
    fn drop(&mut self) {
        self.0.end();
    }
}
