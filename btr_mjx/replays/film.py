"""Films of replays: frames with labels, and their files."""

import io
import subprocess
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from btr_mjx.errors import InputError
from btr_mjx.plotting import camera_for, render
from btr_mjx.replays.replay_records import Replay
from btr_mjx.runs import atomic_write, check_regular

FILM_SUFFIXES = (".gif", ".mp4")
"""Kinds of films."""

ASPECT = 4 / 3
"""Width over height of a picture."""

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
    replay: Replay,
    width: int = 480,
    slowness: float = 1.0,
    progress: Callable[[int], object] | None = None,
    overlay: bool = False,
) -> np.ndarray | None:
    """The frames of a film, (F, height, width, 3) uint8; None where nothing can be rendered, which a line says.

    `width` is that of a panel [pixels]; the label says how many times slower than reality the film plays. `progress` is
    called with the number of pictures done since the last call. With `overlay` the measured motion is drawn over the
    simulated ones of its row, both half transparent.
    """
    count, height = len(replay.times), picture_height(width)
    views = np.unique(np.linspace(0, count - 1, _VIEWS).astype(int))
    cameras = [camera_for([m.model for m in row], ASPECT, [m.qpos[views] for m in row]) for row in replay.rows]
    distance = max(camera.distance for camera in cameras)
    columns, rows = max(map(len, replay.rows)), []
    for row, camera in zip(replay.rows, cameras, strict=True):
        pictures = render([(m.model, m.qpos) for m in row], width, height, replace(camera, distance=distance), progress)
        if pictures is None:
            return None
        real = next((own for m, own in zip(row, pictures, strict=True) if m.measured), None)
        if overlay and real is not None:
            pictures = [(own // 2 + real // 2) if own is not real else own for own in pictures]
        empty = np.full((count, height, width, 3), 255, np.uint8)
        panels = [_below(_label(m.title, m.detail, m.number, width), own) for m, own in zip(row, pictures, strict=True)]
        panels += [_below(_label("", NOTHING, "", width), empty)] * (columns - len(row))
        rows.append(_joined(panels, axis=2))
    film = _joined(rows, axis=1)
    end, across = float(replay.times[-1]), film.shape[2]
    feet = np.stack([np.asarray(_foot(float(t), end, slowness, across)) for t in replay.times])
    film = np.concatenate([film, feet], axis=1)
    odd = [(0, size % 2) for size in film.shape[1:3]]  # MP4 needs even numbers
    return np.pad(film, [(0, 0), *odd, (0, 0)], constant_values=255)


def picture_height(width: int) -> int:
    """Height of a picture of this width [pixels]."""
    return round(width / ASPECT / 2) * 2


def write_film(path: Path, film: np.ndarray, rate: int, limit: int | None = None) -> int:
    """Save frames (F, height, width, 3) uint8 as .gif or .mp4; the size of the file [bytes].

    `rate` is in frames per second. A GIF of more bytes than the limit is made smaller, in pixels.

    Raises:
      OSError: the file cannot be written.
    """
    is_gif = path.suffix.lower() == ".gif"
    content = _gif(film, rate) if is_gif else _mp4(film, rate)
    while is_gif and limit is not None and len(content) > limit and film.shape[2] > 160:
        factor = max(0.5, min(0.92, 0.97 * (limit / len(content)) ** 0.5))
        size = (int(film.shape[2] * factor), int(film.shape[1] * factor))
        # Not a sharper filter: its ringing costs more bytes than the smaller size saves.
        film = np.stack([np.asarray(Image.fromarray(frame).resize(size, Image.Resampling.BOX)) for frame in film])
        content = _gif(film, rate)
    with atomic_write(path) as file:
        file.write(content)
    return len(content)


def _below(label: Image.Image, pictures: np.ndarray) -> np.ndarray:
    """Pictures (F, h, w, 3) under a label."""
    return np.concatenate([np.repeat(np.asarray(label)[None], len(pictures), axis=0), pictures], axis=1)


def _joined(parts: list[np.ndarray], axis: int) -> np.ndarray:
    """Parts of frames beside or below each other, with gaps."""
    shape = list(parts[0].shape)
    shape[axis] = GAP
    gap = np.full(shape, 255, np.uint8)
    return np.concatenate([part for one in parts for part in (gap, one)][1:], axis=axis)


def _label(title: str, detail: str, number: str, width: int) -> Image.Image:
    """What a panel shows: title and number, and below them the detail; what is too long is cut."""
    picture = Image.new("RGB", (width, LABEL), PAPER)
    draw = ImageDraw.Draw(picture)
    large, small = (ImageFont.load_default(size) for size in ((14, 12) if width >= 300 else (12, 10)))
    draw.text((4, 4), title, INK, large)
    draw.text((4, 22), detail, SOFT, small)
    left = width - 8 - draw.textlength(number, large)
    draw.rectangle((left - 4, 0, width, 21), PAPER)
    draw.text((left, 4), number, INK, large)
    return picture


def _foot(time: float, end: float, slowness: float, width: int) -> Image.Image:
    """The line below the panels: time, and how far the film is."""
    picture = Image.new("RGB", (width, FOOT), PAPER)
    draw = ImageDraw.Draw(picture)
    words = f"t = {time:.2f} s"
    if abs(slowness - 1) > 0.05:
        words += f"   {slowness:.2g} times slower" if slowness > 1 else f"   {1 / slowness:.2g} times faster"
    draw.text((4, 6), words, INK, ImageFont.load_default(12))
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


def _mp4(film: np.ndarray, rate: int) -> bytes:
    """An H.264 film that browsers play."""
    import imageio_ffmpeg

    # Not imageio_ffmpeg's own writer: it forks this process by Python, which may hang once JAX has started threads.
    given = (
        "-f",
        "rawvideo",
        "-pix_fmt",
        "rgb24",
        "-s",
        f"{film.shape[2]}x{film.shape[1]}",
        "-r",
        str(rate),
        "-i",
        "-",
    )
    with tempfile.TemporaryDirectory(prefix="btr_mjx-") as folder:
        file = Path(folder, "film.mp4")
        made = ("-loglevel", "error", "-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", "25", str(file))
        subprocess.run([imageio_ffmpeg.get_ffmpeg_exe(), *given, *made], input=film.tobytes(), check=True)
        check_regular(file, 2**32)
        return file.read_bytes()
