"""The console script `egolane`, which Ctrl-C ends within seconds and in one line."""

from __future__ import annotations

import _thread
import atexit
import contextlib
import gc
import os
import signal
import socket
import sys
import threading
import time
from typing import Any

#: A command that was interrupted has this long to clean up behind itself.
SECONDS_TO_END = 4.0

_NOT_IN_TIME = "egolane: interrupted; what was at work did not end in time and was broken off\n"


def main() -> None:
    """Run the command `egolane`."""
    if "_EGOLANE_COMPLETE" in os.environ:
        # The shell asks what could follow.
        from egolane_pgm.cli.completion import import_lightly

        import_lightly()
    interruption = _Interruption()
    try:
        interruption.begin()
        from egolane_pgm.cli.main import egolane

        egolane(prog_name="egolane")
    except SystemExit as end:
        interruption.is_said = end.code == 130
        raise
    except BaseException:
        # An interruption may come out as another error, of a library that it met at work.
        if not interruption.has_begun:
            raise
        sys.stderr.write("egolane: interrupted; the same command begins anew\n")
        interruption.is_said = True
        sys.exit(130)


class _Interruption:
    """Ctrl-C from here on: raises KeyboardInterrupt once, and ends the process where that does
    not. Compilers and database drivers may be long at work outside of Python, or swallow it."""

    def __init__(self) -> None:
        self.has_begun = False
        self.is_said = False

    def begin(self) -> None:
        """Listen for Ctrl-C."""
        signal.signal(signal.SIGINT, self._raise)
        sys.unraisablehook = self._raise_again
        # What is registered first is called last, when everything else has cleaned up.
        atexit.register(self._end)
        # A signal writes to the socket at once, while its handler waits for the next line of
        # Python in the main thread.
        self._ours, self._theirs = socket.socketpair()
        self._theirs.setblocking(False)
        signal.set_wakeup_fd(self._theirs.fileno(), warn_on_full_buffer=False)
        threading.Thread(target=self._watch, daemon=True).start()

    def _raise(self, *_: Any) -> None:
        if not self.has_begun:
            self.has_begun = True
            raise KeyboardInterrupt

    def _raise_again(self, ignored: sys.UnraisableHookArgs) -> None:
        """Python ignores what is raised in a callback or while an object is removed."""
        if ignored.exc_type is KeyboardInterrupt:
            self.has_begun = False
            again = threading.Timer(0.1, _thread.interrupt_main)
            again.daemon = True
            again.start()
        else:
            sys.__unraisablehook__(ignored)

    def _end(self) -> None:
        """Python takes itself down while threads of libraries that were interrupted still run:
        one that then asks for Python ends the process in a crash."""
        if self.is_said:
            with contextlib.suppress(OSError):
                sys.stdout.flush()
            os._exit(130)
        # All is done and said: Ctrl-C has nothing to interrupt, and no object that Python has to
        # look for to remove it, which takes longer than some commands.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        gc.freeze()

    def _watch(self) -> None:
        while self._ours.recv(1) != bytes([signal.SIGINT]):
            pass
        time.sleep(SECONDS_TO_END)
        if not self.is_said:
            os.write(2, _NOT_IN_TIME.encode())
        os._exit(130)
