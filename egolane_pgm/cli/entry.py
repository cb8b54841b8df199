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
from collections.abc import Callable
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
        if not interruption.has_come:
            raise
        sys.stderr.write("egolane: interrupted; the same command begins anew\n")
        interruption.is_said = True
        sys.exit(130)


class _CtrlC(KeyboardInterrupt):
    """Is removed while the command goes on where somebody swallowed it: Python in a callback or
    while it removes an object, a library in C++ that imports another one."""

    swallowed: Callable[[], None]

    def __del__(self) -> None:
        self.swallowed()


def _interrupt() -> None:
    main_thread = threading.main_thread().ident
    if hasattr(signal, "pthread_kill") and main_thread is not None:
        # It may be waiting for the system.
        signal.pthread_kill(main_thread, signal.SIGINT)
    else:
        _thread.interrupt_main()


class _Interruption:
    """Ctrl-C from here on: raises KeyboardInterrupt until somebody handles it, and ends the process
    where that does not. Compilers and database drivers may be long at work outside of Python."""

    def __init__(self) -> None:
        self.has_come = False
        # Raised, and not swallowed since.
        self.is_out = False
        self.is_said = False

    def begin(self) -> None:
        """Listen for Ctrl-C."""
        _CtrlC.swallowed = self._raise_again
        signal.signal(signal.SIGINT, self._raise)
        # What was interrupted in threads and pools of processes says much that helps nobody.
        sys.unraisablehook = lambda said: self.has_come or sys.__unraisablehook__(said)
        threading.excepthook = lambda said: self.has_come or threading.__excepthook__(said)
        # What is registered first is called last, when everything else has cleaned up.
        atexit.register(self._end)
        # A signal writes to the socket at once, while its handler waits for the next line of
        # Python in the main thread.
        self._ours, self._theirs = socket.socketpair()
        self._theirs.setblocking(False)
        signal.set_wakeup_fd(self._theirs.fileno(), warn_on_full_buffer=False)
        threading.Thread(target=self._watch, daemon=True).start()

    def _raise(self, *_: Any) -> None:
        if not self.is_out:
            self.has_come = self.is_out = True
            raise _CtrlC

    def _raise_again(self) -> None:
        if not self.is_said:
            self.is_out = False
            # Whoever swallowed it is at work for a moment more.
            again = threading.Timer(0.1, _interrupt)
            again.daemon = True
            again.start()

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
