"""Being asked to stop: SIGTERM, SIGINT (Ctrl-C) and SIGUSR1 end a run after the current step, all saved."""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Iterator
from dataclasses import dataclass
from types import FrameType

# mpirun answers a SIGTERM of its own by killing its ranks about a second later, but passes SIGUSR1 on:
# batch systems should send that one (Slurm: --signal=USR1@60).
SIGNALS = (signal.SIGTERM, signal.SIGINT, signal.SIGUSR1)


@dataclass
class StopRequest:
    """Which signal has asked this rank to stop: its number, or 0."""

    number: int = 0

    @staticmethod
    def name(number: int) -> str:
        """Return the name of a signal."""
        return signal.Signals(number).name


@contextlib.contextmanager
def stop_requests() -> Iterator[StopRequest]:
    """Note the stop signals instead of dying of them.

    PETSc's own handler, installed when PETSc was initialised, is replaced for the time of the context.
    A second Ctrl-C ends the program at once.
    """
    request = StopRequest()

    def note(number: int, frame: FrameType | None) -> None:
        request.number = number
        if number == signal.SIGINT:
            signal.signal(signal.SIGINT, signal.SIG_DFL)

    before = {number: signal.signal(number, note) for number in SIGNALS}
    try:
        yield request
    finally:
        for number, handler in before.items():
            # None: installed from C (PETSc), which Python can neither see nor put back
            signal.signal(number, signal.SIG_DFL if handler is None else handler)
