"""Common style of all pictures: palette, axes, heading, and writing to a file."""

from __future__ import annotations

import io
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from textwrap import wrap
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.ticker import ScalarFormatter

from mbdkit.base.errors import MbdkitError
from mbdkit.base.files import replacing
from mbdkit.base.text import one_line, shown
from mbdkit_report.figures.palette import ALARM, FAINT, GRID, INK, PAPER
from mbdkit_report.plot.caption import Caption

DPI = 150
FORMATS = (".png", ".svg", ".pdf")
_LINE = 0.2  # inches of a heading line
_FILES: dict[Any, Any] = {
    "pdf.fonttype": 42,
    "svg.fonttype": "none",
    "svg.hashsalt": "mbdkit",
    "savefig.bbox": None,  # the size of the file is that of the figure
}
#: Metadata of image files: no dates, and a name by which `mbdkit study --overwrite` recognizes images of reports.
_METADATA: dict[str, dict[str, str | None]] = {
    "pdf": {"CreationDate": None},
    "png": {"Software": "mbdkit"},
    "svg": {"Date": None, "Creator": "mbdkit"},
}


def new_figure(caption: Caption, width: float = 7.2, height: float = 4.8, dpi: int = DPI) -> Figure:
    """Return an empty figure of `width` x `height` inches with a heading.

    Axes are placed below the heading. The figure has its own canvas, so that no global state of Matplotlib is used.
    """
    figure = Figure(figsize=(width, height), dpi=dpi, facecolor=PAPER, layout="constrained")
    FigureCanvasAgg(figure)
    room = heading(figure, caption)
    engine = figure.get_layout_engine()
    assert engine is not None
    engine.set(rect=(0.0, 0.0, 1.0, 1.0 - room / height), w_pad=0.12, h_pad=0.06)  # type: ignore[call-arg]
    return figure


def heading(figure: Figure, caption: Caption) -> float:
    """Write the heading into the top left corner of a figure and return its height in inches."""
    width, height = figure.get_size_inches()
    room = int(width / 0.069)  # characters of 8.5 points
    alarm = wrap(caption.alarm, int(0.88 * room), max_lines=3, placeholder=" ...")
    lines = [
        (_cut(caption.title, int(width / 0.099)), 11.0, "bold", INK),
        *((line, 8.5, "normal", FAINT) for line in wrap(caption.settings, room, max_lines=4, placeholder=" ...")),
        *((line, 8.5, "bold", ALARM) for line in alarm),
    ]
    for row, (text, size, weight, color) in enumerate(lines):
        label = figure.text(
            0.12 / width, 1.0 - (0.12 + row * _LINE) / height, text, size=size, weight=weight, color=color
        )
        label.set(va="top", ha="left", parse_math=False, in_layout=False)
    return 0.2 + len(lines) * _LINE


def _cut(text: str, length: int) -> str:
    return text if len(text) <= length else text[: length - 4].rstrip() + " ..."


def dress(axes: Axes, xlabel: str = "", ylabel: str = "") -> Axes:
    """Apply the common style and labels with units to `axes`, and return the axes."""
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set_color(FAINT)
    axes.set_facecolor(PAPER)
    axes.grid(True, color=GRID, linewidth=0.7)
    axes.set_axisbelow(True)
    axes.tick_params(colors=FAINT, labelcolor=INK, labelsize=8.5)
    axes.set_xlabel(xlabel, size=9, color=INK)
    axes.set_ylabel(ylabel, size=9, color=INK)
    return axes


def dress_plane(axes: Axes, xlim: tuple[float, float], ylim: tuple[float, float]) -> Axes:
    """Dress axes for a picture in the plane of motion with these limits, and return them."""
    axes.set_aspect("equal", adjustable="box")
    axes.set(xlim=xlim, ylim=ylim)
    return dress(axes, "x [m]", "y [m]")


def powers_of_ten(axes: Axes) -> None:
    """Factor a power of ten out of the y tick labels of `axes` if the values are large or small."""
    formatter = ScalarFormatter(useOffset=False, useMathText=True)
    formatter.set_powerlimits((-3, 4))
    axes.yaxis.set_major_formatter(formatter)
    axes.yaxis.get_offset_text().set(size=8.5, color=INK)


def legend(axes: Axes, handles: Sequence[Any], labels: Sequence[str], title: str | None = None) -> None:
    """Put a legend to the right of `axes`.

    Labels are not interpreted as mathematics, and a leading underscore does not hide them.
    """
    if not handles:
        return
    box = axes.legend(
        list(handles),
        [f" {label}" if label.startswith("_") else label for label in labels],
        loc="upper left",
        bbox_to_anchor=(1.01, 1.0),
        borderaxespad=0.0,
        frameon=False,
        fontsize=8.5,
        labelcolor=INK,
        title=title,
        title_fontsize=8.5,
        alignment="left",
        handlelength=2.6,
    )
    for text in box.get_texts():
        text.set_parse_math(False)


def save(figure: Figure, target: Path) -> None:
    """Write `figure` to `target` atomically, in the format of its suffix.

    Text remains text: PDF files contain the outlines of the fonts (Type 42, not Type 3), and SVG files their names. The
    same figure gives the same bytes, because PDF and SVG files have no date.
    """
    with replacing(target) as temporary:
        temporary.write_bytes(_image(figure, target.suffix[1:].lower()))


def png(figure: Figure) -> bytes:
    """Return `figure` as the bytes of a PNG file."""
    return _image(figure, "png")


def _image(figure: Figure, kind: str) -> bytes:
    content = io.BytesIO()  # Matplotlib's PDF writer would replace the error of a full disk by another error
    _escape(figure)
    with mpl.rc_context(_FILES):
        quietly(lambda: figure.savefig(content, format=kind, dpi=figure.dpi, metadata=_METADATA[kind]))
    return content.getvalue()


def _escape(figure: Figure) -> None:
    for text in figure.findobj(Text):
        assert isinstance(text, Text)
        if (escaped := shown(text.get_text(), lines=True)) != text.get_text():
            text.set_text(escaped)


def quietly(draw: Callable[[], object]) -> None:
    """Call `draw` without Matplotlib's warnings about missing glyphs, because a title may be in any script.

    Raises MbdkitError if Matplotlib is told to use LaTeX, which fails or is not installed.
    """
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph .* missing from")
        try:
            draw()
        except (RuntimeError, OSError) as error:
            if not mpl.rcParams["text.usetex"]:
                raise
            advice = "install LaTeX with dvipng, or set `text.usetex: False`, which is Matplotlib's default"
            raise MbdkitError(f"Matplotlib cannot draw text with LaTeX ({one_line(error)}); {advice}") from error
