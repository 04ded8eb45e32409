"""An estimate that runs in a thread of its own, which touches nothing of Blender's."""

import threading

import blindaug


class Cancelled(Exception):
    """The user has stopped the estimate."""


class Job:
    """An estimate; `camera` or `error`, a sentence, is there when it is not `running`, and neither of them if it was cancelled."""

    def __init__(self, footage):
        self.footage = footage
        self.done, self.total = 0, footage.last - footage.first + 1
        self.camera = None
        self.error = None
        self._cancel = threading.Event()
        self._thread = None

    def start(self):
        self._thread = threading.Thread(target=self.run, name="blindaug", daemon=True)
        self._thread.start()

    @property
    def running(self):
        return self._thread is not None and self._thread.is_alive()

    @property
    def cancelled(self):
        return self._cancel.is_set()

    def cancel(self):
        """Stops at the next frame."""
        self._cancel.set()

    def wait(self, seconds):
        if self._thread is not None:
            self._thread.join(seconds)

    def run(self, heard=lambda done, total: None):
        """Estimates in this thread; `heard` is called with the numbers of frames that are done and of all frames."""

        def progress(done, total):
            self.done, self.total = done, total or self.total
            heard(self.done, self.total)
            if self.cancelled:
                raise Cancelled

        footage = self.footage
        try:
            self.camera = blindaug.estimate(
                footage.path, frames=(footage.first, footage.last), fps=footage.fps, samples=True, progress=progress
            )
        except Cancelled:
            pass
        except Exception as error:
            self.error = str(error)
