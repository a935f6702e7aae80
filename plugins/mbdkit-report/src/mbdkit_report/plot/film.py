"""A run as an animated GIF or MP4 video. The background is drawn once, the mechanism in every frame."""

from __future__ import annotations

import subprocess
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.animation import FFMpegWriter
from matplotlib.backends.backend_agg import FigureCanvasAgg
from numpy.typing import NDArray
from PIL import Image

from mbdkit.base.errors import SpecError
from mbdkit_report.figures.beam_curves import largest_moment
from mbdkit_report.figures.curves import evenly
from mbdkit_report.figures.palette import ALARM, INK, PALETTE, PAPER, SPRING, body_colors, trace_colors
from mbdkit_report.figures.pose import BENDING_SHADES, PoseArtists
from mbdkit_report.figures.scene import Scene, scene
from mbdkit_report.plot.caption import caption
from mbdkit_report.plot.style import dress_plane, new_figure, quietly

if TYPE_CHECKING:
    from mbdkit.archive.run import Run

RATE = 25  #: Frames per second.
_LENGTH = {"shortest": 2.0, "longest": 16.0}  # seconds
_MOST = 401
_WIDTH = 6.4  # inches, at 100 dpi
_TAIL = 1.5  # length of the visible paths, in seconds of the video
_STILL = 1.0  # duration of the last frame, in seconds
_COLORS = 96


class Film:
    """Draws the frames of a scene on one canvas.

    Parameters
    ----------
    run
        The run, for the heading.
    shown
        Poses, paths and times of the frames.
    """

    def __init__(self, run: Run, shown: Scene):
        self.scene = shown
        (x0, x1), (y0, y1) = shown.xlim, shown.ylim
        room = 1.2 if shown.moments is None else 1.8  # inches for labels, and the scale of bending moments
        height = float(np.clip((_WIDTH - 0.8) * (y1 - y0) / (x1 - x0), 2.2, 5.6)) + room
        figure = new_figure(caption(run), _WIDTH, round(height * 50) / 50, dpi=100)
        axes = dress_plane(figure.add_subplot(), (x0, x1), (y0, y1))
        axes.set_title(shown.pace, size=8.5, color=INK, loc="left")
        self._clock = axes.set_title(" ", size=8.5, color=INK, loc="right", family="monospace")
        self._tails = [
            axes.plot([], [], color=color, linewidth=1.3, alpha=0.7, zorder=2.5)[0]
            for color in trace_colors(shown.drawing, shown.traces)
        ]
        size, most = max(x1 - x0, y1 - y0), largest_moment(shown.moments)
        colors = body_colors(shown.drawing)
        self._pose = PoseArtists(axes, shown.drawing, colors, size, largest_moment=most, tags=shown.tags)
        self._pose.show_scale(axes)
        self._moving = [*self._tails, *self._pose.artists, self._clock]
        for artist in self._moving:
            artist.set_animated(True)
        assert isinstance(figure.canvas, FigureCanvasAgg)
        self._canvas, self._axes = figure.canvas, axes
        quietly(self._canvas.draw)
        self._still = self._canvas.copy_from_bbox(figure.bbox)  # type: ignore[no-untyped-call]

    def __len__(self) -> int:
        return len(self.scene.time)

    def picture(self, frame: int) -> NDArray[np.uint8]:
        """Return one frame as red, green and blue, shape (height, width, 3)."""
        shown, time = self.scene, self.scene.time[frame]
        moments = None if shown.moments is None else shown.moments[frame]
        self._pose.move(shown.drawing.world(shown.poses[frame]), moments)
        first, last = np.searchsorted(shown.path_time, [time - _TAIL * shown.speed, time], side="right")
        for number, tail in enumerate(self._tails):
            tail.set_data(shown.paths[first:last, number].T)
        self._clock.set_text(f"t = {time:.{int(np.clip(np.ceil(-np.log10(shown.speed / RATE)), 0, 9))}f} s")
        self._canvas.restore_region(self._still)  # type: ignore[no-untyped-call]
        for artist in self._moving:
            self._axes.draw_artist(artist)
        return np.array(self._canvas.buffer_rgba())[..., :3]  # type: ignore[no-untyped-call]


def write_gif(run: Run, target: Path) -> None:
    """Write a run as an animated GIF that repeats endlessly."""
    film = Film(run, scene(run, rate=RATE, most=_MOST, **_LENGTH))
    shades = BENDING_SHADES if film.scene.moments is not None else ()
    palette = _palette([film.picture(frame) for frame in evenly(len(film), 4)], shades)
    frames = map(Image.fromarray, map(film.picture, range(len(film))))
    pictures = (frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames)
    durations = [1000 // RATE] * (len(film) - 1) + [int(1000 * _STILL)]
    next(pictures).save(
        target, format="GIF", save_all=True, append_images=pictures, duration=durations, loop=0, disposal=1
    )


def _palette(samples: list[NDArray[np.uint8]], shades: Sequence[str]) -> Image.Image:
    """Return an image whose palette contains the colours of the lines and the most frequent other colours of some
    frames. The GIF shows these colours exactly.
    """
    own = np.array([list(bytes.fromhex(color[1:])) for color in (PAPER, INK, SPRING, ALARM, *PALETTE, *shades)])
    pixels = np.concatenate([sample.reshape(-1, 3) for sample in samples])
    colors, counts = np.unique(pixels, axis=0, return_counts=True)
    # Pillow's search for colours is coarse: it would replace the colour of a line by a similar one.
    apart = np.abs(colors[:, None, :].astype(int) - own).max(axis=2).min(axis=1) > 8
    common = colors[apart][np.argsort(-counts[apart], kind="stable")[:_COLORS]]
    image = Image.new("P", (1, 1))
    image.putpalette(np.concatenate([own, common]).reshape(-1).tolist())
    return image


def write_mp4(run: Run, target: Path) -> None:
    """Write a run as an MP4 video, encoded by ffmpeg.

    Raises
    ------
    SpecError
        If ffmpeg is not found, or fails.
    """
    if not FFMpegWriter.isAvailable():
        raise SpecError(
            "an .mp4 file needs the program ffmpeg, which is not installed; install it, or write .gif or .html instead"
        )
    film = Film(run, scene(run, rate=RATE, most=_MOST, **_LENGTH))
    first = film.picture(0)
    command = [FFMpegWriter.bin_path(), "-y", "-loglevel", "error", "-f", "rawvideo", "-pixel_format", "rgb24"]
    command += ["-video_size", f"{first.shape[1]}x{first.shape[0]}", "-framerate", str(RATE), "-i", "-"]
    command += ["-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2", "-pix_fmt", "yuv420p", "-movflags", "+faststart"]
    with subprocess.Popen([*command, str(target)], stdin=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdin is not None
        with suppress(BrokenPipeError):  # ffmpeg has ended, and says why
            for frame in range(len(film)):
                process.stdin.write(film.picture(frame).tobytes())
        _, complaint = process.communicate()
    if process.returncode:
        raise SpecError(f"ffmpeg could not make the .mp4 file: {complaint.decode(errors='replace').strip()}")
