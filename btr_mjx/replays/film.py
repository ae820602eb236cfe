"""Films of replays: frames with labels, and their files."""

import io
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import matplotlib
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from btr_mjx.errors import InputError
from btr_mjx.plotting import Camera, camera_for, render_motion, sketch, style
from btr_mjx.replays.motion import Replay, ReplayedMotion
from btr_mjx.runs import atomic_write, check_regular

FILM_SUFFIXES = (".gif", ".mp4")
"""Kinds of films."""

ASPECT = 4 / 3
"""Width over height of a panel."""

LABEL, FOOT, GAP = 40, 26, 6
"""Height of a panel's label and of the line with the time, and the space between panels [pixels]."""

INK, SOFT, PAPER, LINE = "#111111", "#666666", "#ffffff", "#d0d0d0"
"""Colours of a film's labels."""

COLOURS = 64
"""Colours of a GIF."""

NOTHING = "no recording of this trial"
"""What the panel of a trial in reality says where nothing of it can be shown."""

_VIEWS = 10
"""Poses of a motion that its camera is fitted to."""


@dataclass(frozen=True)
class _Layout:
    """Sizes of a film [pixels]."""

    columns: int
    rows: int
    width: int

    @property
    def height(self) -> int:
        """Height of a panel."""
        return round(self.width / ASPECT / 2) * 2

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the film, even as MP4 needs them."""
        across = self.columns * self.width + (self.columns - 1) * GAP
        down = self.rows * (self.height + LABEL) + (self.rows - 1) * GAP + FOOT
        return across + across % 2, down + down % 2

    def corner(self, row: int, column: int) -> tuple[int, int]:
        """Upper left corner of a panel's label."""
        return column * (self.width + GAP), row * (self.height + LABEL + GAP)


def check_film(path: Path) -> None:
    """Check that a film of this name can be written.

    Raises:
      InputError: another kind of film, or MP4 without the package that writes it.
    """
    if path.suffix.lower() not in FILM_SUFFIXES:
        raise InputError(f"--out {path}: expected a name that ends in {' or '.join(FILM_SUFFIXES)}")
    if path.suffix.lower() == ".mp4":
        try:
            import imageio_ffmpeg  # noqa: F401
        except ImportError:
            raise InputError(
                f"--out {path}: MP4 needs the package imageio-ffmpeg (pip install 'btr-mjx[video]'); or write a .gif"
            ) from None


def draw_film(
    replay: Replay, width: int = 480, slowness: float = 1.0, progress: Callable[[int], object] | None = None
) -> np.ndarray:
    """The frames of a film.

    Args:
      replay: what is shown.
      width: of a panel [pixels].
      slowness: how many times slower than reality the film plays, for its label.
      progress: called with the number of frames of panels done since the last call.

    Returns:
      (F, height, width, 3) uint8.
    """
    layout = _Layout(max(map(len, replay.rows)), len(replay.rows), width)
    paper = Image.new("RGB", layout.size, PAPER)
    film = np.repeat(np.asarray(paper)[None], len(replay.times), axis=0)
    for r, (row, camera) in enumerate(zip(replay.rows, _cameras(replay), strict=True)):
        for c, motion in enumerate(row):
            left, top = layout.corner(r, c)
            label = np.asarray(_label(motion, layout.width))
            film[:, top : top + LABEL, left : left + layout.width] = label
            panel = _frames(motion, layout, camera, progress)
            top += LABEL
            film[:, top : top + layout.height, left : left + layout.width] = panel
        for c in range(len(row), layout.columns):
            left, top = layout.corner(r, c)
            film[:, top : top + LABEL, left : left + layout.width] = np.asarray(_title(NOTHING, layout.width))
    for frame, time in zip(film, replay.times, strict=True):
        frame[-FOOT:] = np.asarray(_foot(float(time), float(replay.times[-1]), slowness, layout.size[0]))
    return film


def write_film(path: Path, film: np.ndarray, rate: int, limit: int | None = None) -> int:
    """Save a film.

    Args:
      path: the file, .gif or .mp4.
      film: (F, height, width, 3) uint8.
      rate: frames per second.
      limit: of a GIF: largest number of bytes; a film that is larger is made smaller, in pixels.

    Returns:
      The size of the file [bytes].

    Raises:
      OSError: the file cannot be written.
    """
    content = _mp4(film, rate, path) if path.suffix.lower() == ".mp4" else _gif(film, rate)
    while path.suffix.lower() == ".gif" and limit is not None and len(content) > limit and film.shape[2] > 160:
        factor = max(0.5, min(0.92, 0.97 * (limit / len(content)) ** 0.5))
        size = (int(film.shape[2] * factor), int(film.shape[1] * factor))
        # Not a sharper filter: its ringing costs more bytes than the smaller size saves.
        film = np.stack([np.asarray(Image.fromarray(frame).resize(size, Image.Resampling.BOX)) for frame in film])
        content = _gif(film, rate)
    with atomic_write(path) as file:
        file.write(content)
    return len(content)


def _cameras(replay: Replay) -> list[Camera]:
    """A camera for each row, all at the same distance."""
    cameras = []
    for row in replay.rows:
        views = np.unique(np.linspace(0, len(replay.times) - 1, _VIEWS).astype(int))
        models = [motion.model for motion in row]
        cameras.append(camera_for(models, ASPECT, poses=[motion.qpos[views] for motion in row]))
    distance = max(camera.distance for camera in cameras)
    return [replace(camera, distance=distance) for camera in cameras]


def _frames(
    motion: ReplayedMotion, layout: _Layout, camera: Camera, progress: Callable[[int], object] | None
) -> np.ndarray:
    """Pictures (F, height, width, 3) of a motion."""
    rendered = render_motion(motion.model, motion.qpos, layout.width, layout.height, camera, progress)
    if rendered is not None:
        return rendered
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    frames = []
    with style(), matplotlib.rc_context({"figure.constrained_layout.use": False}):
        for qpos in motion.qpos:
            figure = Figure(figsize=(layout.width / 100, layout.height / 100), dpi=100)
            canvas = FigureCanvasAgg(figure)
            sketch(figure.add_axes((0, 0, 1, 1)), motion.model, camera, ASPECT, qpos)
            canvas.draw()
            frames.append(np.asarray(canvas.buffer_rgba())[..., :3].copy())
            if progress is not None:
                progress(1)
    return np.stack(frames)


@lru_cache(maxsize=8)
def _font(size: int, bold: bool = False) -> ImageFont.FreeTypeFont:
    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    return ImageFont.truetype(str(Path(matplotlib.get_data_path(), "fonts", "ttf", name)), size)


def _title(text: str, width: int) -> Image.Image:
    """The label of an empty panel."""
    picture = Image.new("RGB", (width, LABEL), PAPER)
    size = 12 if width >= 300 else 10
    ImageDraw.Draw(picture).text((4, 6), _fitting(text, width - 8, size), SOFT, _font(size))
    return picture


def _label(motion: ReplayedMotion, width: int) -> Image.Image:
    """What a panel shows: title and number, and below them the detail."""
    picture = Image.new("RGB", (width, LABEL), PAPER)
    draw = ImageDraw.Draw(picture)
    large, small = (14, 12) if width >= 300 else (12, 10)
    draw.text((width - 4, 4), motion.number, INK, _font(large, bold=True), anchor="ra")
    room = width - 16 - draw.textlength(motion.number, _font(large, bold=True))
    draw.text((4, 4), _fitting(motion.title, room, large, bold=True), INK, _font(large, bold=True))
    draw.text((4, 22), _fitting(motion.detail, width - 8, small), SOFT, _font(small))
    return picture


def _fitting(text: str, room: float, size: int, bold: bool = False) -> str:
    """A text, cut where it is wider than there is room [pixels]."""
    if _font(size, bold).getlength(text) <= room:
        return text
    while text and _font(size, bold).getlength(text + "…") > room:
        text = text[:-1]
    return text + "…"


def _foot(time: float, end: float, slowness: float, width: int) -> Image.Image:
    """The line below the panels: time, and how far the film is."""
    picture = Image.new("RGB", (width, FOOT), PAPER)
    draw = ImageDraw.Draw(picture)
    words = f"t = {time:.2f} s"
    if abs(slowness - 1) > 0.05:
        words += f"   {slowness:.2g} times slower" if slowness > 1 else f"   {1 / slowness:.2g} times faster"
    draw.text((4, 6), words, INK, _font(12))
    first = 190
    if width > first + 60:
        draw.line((first, 13, width - 6, 13), LINE, 3)
        draw.line((first, 13, first + (width - 6 - first) * time / end, 13), INK, 3)
    return picture


def _gif(film: np.ndarray, rate: int) -> bytes:
    """A GIF with one palette for all frames, without dithering, so that what stands still costs nothing."""
    chosen = film[np.unique(np.linspace(0, len(film) - 1, 6).astype(int))]
    palette = Image.fromarray(np.concatenate(chosen)).quantize(COLOURS, method=Image.Quantize.MEDIANCUT)
    frames = [Image.fromarray(frame).quantize(palette=palette, dither=Image.Dither.NONE) for frame in film]
    content = io.BytesIO()
    # Of the last frame a moment longer: it shows how far each robot came.
    durations = [round(100 / rate) * 10] * (len(frames) - 1) + [1000]
    frames[0].save(
        content, "GIF", save_all=True, append_images=frames[1:], duration=durations, loop=0, optimize=False, disposal=1
    )
    return content.getvalue()


def _mp4(film: np.ndarray, rate: int, path: Path) -> bytes:
    """An H.264 film that browsers play."""
    import tempfile

    import imageio_ffmpeg

    with tempfile.TemporaryDirectory(prefix="btr_mjx-") as folder:
        file = Path(folder, "film.mp4")
        size = (film.shape[2], film.shape[1])
        writer = imageio_ffmpeg.write_frames(str(file), size, fps=rate, macro_block_size=2, ffmpeg_log_level="error")
        writer.send(None)
        for frame in film:
            writer.send(np.ascontiguousarray(frame))
        writer.close()
        check_regular(file, 2**32)
        return file.read_bytes()
