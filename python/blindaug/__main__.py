"""The command line ``blindaug``: the code of the program of that name, in this process."""

import signal
import sys

from ._blindaug import run


def main() -> None:
    """Runs the command line of ``sys.argv``, and ends the process with its exit status."""
    # Ctrl-C is the command line's: Python's own handler would raise KeyboardInterrupt after it.
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    sys.exit(run(["blindaug", *sys.argv[1:]]))


if __name__ == "__main__":
    main()
