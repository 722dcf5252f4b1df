"""Pictures of the frames of a run, each drawn once: files, settings they remember, progress, a film."""

from __future__ import annotations

import hashlib
import json
import shutil
import subprocess
import time as clock
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .errors import InputError
from .progress import on_terminal
from .results import OutputError, atomic

if TYPE_CHECKING:
    from numpy.typing import NDArray

FILM = "film.mp4"
SETTINGS = "Extremal"  # the entry of a picture's file that says how it was drawn
# Draws a frame, and tells which part of it is done.
Draw = Callable[[float, Path, Callable[[float], None]], "NDArray[Any]"]


def picture_name(index: int) -> str:
    """Return the file of a frame's picture."""
    return f"frame_{index:05d}.png"


def draw_all(
    draw: Draw, frames: Mapping[int, tuple[float, Path]], settings: Mapping[str, Any], folder: Path
) -> tuple[int, int]:
    """Draw the pictures that are not there yet, or were drawn with other settings or from another frame.

    Parameters
    ----------
    draw : callable
        Takes a frame's time [s], its file, and a function to tell which part of the picture is done; returns colours
        (height, width, 3).
    frames : mapping
        Number of a frame to its time [s] and file.
    settings : mapping
        What the pictures depend on besides the frames.

    Returns
    -------
    (int, int)
        How many were drawn, and how many were there.
    """
    folder.mkdir(parents=True, exist_ok=True)
    marks = {index: _mark(path, settings) for index, (_, path) in frames.items()}
    missing = [index for index in frames if _mark_of(folder / picture_name(index)) != marks[index]]
    with _Bar(len(missing)) as bar:
        for index in missing:
            _save(folder / picture_name(index), draw(*frames[index], bar.part), marks[index])
            bar.next(picture_name(index))
    return len(missing), len(frames) - len(missing)


def _mark(frame: Path, settings: Mapping[str, Any]) -> str:
    """What a picture is known by: a digest of how it is drawn and of the frame."""
    try:
        content = frame.read_bytes()
    except OSError as error:
        raise InputError(f"{frame}: cannot be read: {error.strerror}") from None
    words = json.dumps(settings, sort_keys=True, default=str).encode()
    return hashlib.sha256(words + hashlib.sha256(content).digest()).hexdigest()


def _mark_of(picture: Path) -> str | None:
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(picture) as image:
            found = image.info.get(SETTINGS)
            return found if isinstance(found, str) else None
    except (OSError, UnidentifiedImageError, ValueError, SyntaxError):
        return None  # none there, or damaged


def _save(path: Path, colours: NDArray[Any], mark: str) -> None:
    from matplotlib import image

    with atomic(path) as partial:
        image.imsave(partial, colours, format="png", metadata={SETTINGS: mark})


class _Bar:
    """Progress with the time left: a bar on a terminal, a line a picture otherwise."""

    def __init__(self, count: int) -> None:
        self.count, self.done = count, 0
        self.begin = clock.monotonic()
        self.bar: Any = None

    def __enter__(self) -> _Bar:
        if self.count and on_terminal():
            from rich.progress import Progress

            self.bar = Progress()
            self.task = self.bar.add_task("pictures", total=self.count)
            self.bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self.bar is not None:
            self.bar.stop()

    def part(self, share: float) -> None:
        """Tell that a share of the present picture is done."""
        if self.bar is not None:
            self.bar.update(self.task, completed=self.done + share)

    def next(self, name: str) -> None:
        """Tell that a picture is done."""
        self.done += 1
        seconds = clock.monotonic() - self.begin
        if self.bar is not None:
            self.bar.update(self.task, completed=self.done)
        else:
            left = seconds / self.done * (self.count - self.done)
            print(f"{name}  {self.done} of {self.count}  {seconds:.0f} s, {left:.0f} s left", flush=True)


def film(pictures: Sequence[Path], rate: float) -> Path | None:
    """Make a film of pictures of one size beside them; None where there is no ffmpeg.

    Parameters
    ----------
    rate : float
        Pictures a second.

    Raises
    ------
    OutputError
        If ffmpeg cannot make it.
    """
    program = ffmpeg()
    if program is None:
        return None
    path = pictures[0].parent / FILM
    # H.264 wants even sizes
    even = ["-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2", "-c:v", "libx264", "-pix_fmt", "yuv420p"]
    source = ["-f", "image2pipe", "-c:v", "png", "-framerate", f"{rate:g}", "-i", "-"]
    with atomic(path) as partial:
        words = [program, "-y", "-loglevel", "error", *source, *even, "-f", "mp4", str(partial)]
        done = subprocess.run(words, input=b"".join(picture.read_bytes() for picture in pictures), capture_output=True)
        if done.returncode:
            reason = (done.stderr.decode(errors="replace").strip().splitlines() or ["no reason given"])[-1]
            raise OutputError(f"{path}: ffmpeg did not make it: {reason}")
    return path


def ffmpeg() -> str | None:
    """Return the program, on the PATH or that of imageio-ffmpeg; None where there is none."""
    found = shutil.which("ffmpeg")
    if found is None:
        try:
            import imageio_ffmpeg

            found = imageio_ffmpeg.get_ffmpeg_exe()
        except (ImportError, RuntimeError):
            return None
    return found
