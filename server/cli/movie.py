"""Movies of pictures: GIF and WebP by Pillow, MP4 and WebM by FFmpeg."""

import io
import os
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from PIL import Image

from isogi_core.errors import ViewError
from isogi_core.storage.atomic_file import write_whole
from server.errors import LibraryError

FRAMES = "frame-%05d.png"
"""The names of a film's pictures, numbered from 1."""

LOOPS: dict[str, dict[str, Any]] = {".gif": {"optimize": False}, ".webp": {"quality": 85, "method": 4}}
"""Movies that Pillow writes, and how."""

CODECS = {
    ".mp4": ("-c:v", "libx264", "-crf", "16", "-preset", "slow", "-movflags", "+faststart"),
    ".webm": ("-c:v", "libvpx-vp9", "-crf", "24", "-b:v", "0", "-row-mt", "1"),
}
"""Movies that FFmpeg writes: codec and quality."""

COLOURS = ["-vf", "scale=out_color_matrix=bt709:out_range=tv,format=yuv420p", "-colorspace", "bt709"]
COLOURS += ["-color_primaries", "bt709", "-color_trc", "iec61966-2-1", "-color_range", "tv"]
"""What players need to know of the pictures: sRGB, by the matrix of BT.709."""


def check_movie(output: Path, width: int, height: int) -> None:
    """Raise ViewError where the file's name is that of no movie, or its size not one's, and LibraryError."""
    suffix = output.suffix.lower()
    if suffix in CODECS:
        encoder(suffix)
        if width % 2 or height % 2:
            raise ViewError(f"A {suffix} needs even width and height, not {width} × {height}: change them.")
    elif suffix not in LOOPS:
        known = ", ".join((*LOOPS, *CODECS))
        raise ViewError(f"{output} names no kind of film: end it in {known}, or name a folder for pictures.")


def write_movie(output: Path, pictures: Sequence[Path], fps: float) -> None:
    """Write the pictures, files in their order, to a movie. Raises LibraryError, OSError."""
    suffix = output.suffix.lower()
    if suffix in LOOPS:
        first, *others = (Image.open(path) for path in pictures)
        data, frame = io.BytesIO(), round(1000.0 / fps)
        first.save(data, suffix[1:], save_all=True, append_images=others, duration=frame, loop=0, **LOOPS[suffix])
        write_whole(output, data.getvalue())
        return
    half = pictures[0].with_name(f"movie{suffix}")
    reading = ["-framerate", f"{fps:g}", "-i", str(pictures[0].with_name(FRAMES))]
    command = [encoder(suffix), "-y", "-loglevel", "error", *reading, *CODECS[suffix], *COLOURS, str(half)]
    done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False)
    if done.returncode:
        raise LibraryError(f"FFmpeg wrote no {suffix}: {done.stderr.strip() or done.returncode}.")
    os.replace(half, output)


def encoder(suffix: str) -> str:
    """The program FFmpeg. Raises LibraryError where it is missing."""
    try:
        import imageio_ffmpeg  # noqa: PLC0415

        return str(imageio_ffmpeg.get_ffmpeg_exe())
    except (ModuleNotFoundError, RuntimeError):
        raise LibraryError(f"A film in a {suffix} needs FFmpeg: pip install 'isogi[film]'.") from None
