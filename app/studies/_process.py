"""Other programs that a study measures or starts, each in a process of its own."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
from collections.abc import Sequence
from typing import Any

PATIENCE = 900  # [s] that another process may take


def output_of(command: Sequence[str]) -> str:
    """What a process printed, its complaints if it failed."""
    try:
        # os.environ lacks the marks that this process's MPI has left in the C environment and that mpirun dislikes
        done = subprocess.run(
            command, env=dict(os.environ), stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=PATIENCE
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        return str(error)
    return done.stdout if done.returncode == 0 else done.stdout + done.stderr


def report_of(command: Sequence[str]) -> tuple[dict[str, Any] | None, str]:
    """The JSON on a process's last line, or None and that line."""
    lines = output_of(command).splitlines()
    try:
        return dict(json.loads(lines[-1])), ""
    except (IndexError, ValueError, TypeError):
        return None, lines[-1] if lines else "it said nothing"


def limited(command: Sequence[str], timeout: float) -> tuple[int | None, str]:
    """Exit code of a process, None if it took longer than `timeout` [s], and what it printed.

    Whatever it started ends with it, as it does where this process is interrupted.
    """
    environment = {"OMP_NUM_THREADS": "1", **os.environ}
    pipes = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
    process = subprocess.Popen(command, env=environment, text=True, start_new_session=True, **pipes)  # type: ignore
    try:
        said, _ = process.communicate(timeout=timeout)
        return process.returncode, said
    except subprocess.TimeoutExpired:
        return None, ""
    finally:
        if process.poll() is None:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
