"""A film as an MP4 file that any player shows."""

from __future__ import annotations

import io
from fractions import Fraction
from pathlib import Path
from typing import Any

from hiprl.data.film import Film
from hiprl.errors import InputError

FASTEST = 60  # pictures a second: more are left out
QUALITY = "20"  # of x264, from 0 (no loss) to 51


def write_video(path: Path, film: Film, dt: float) -> None:
    """Writes pictures that are `dt` seconds apart.

    Raises:
        InputError: what encodes them is not installed, or the file cannot be written.
    """
    from PIL import Image

    av = encoder()
    images = [Image.open(io.BytesIO(one)).convert("RGB") for one in film.pictures or ()]
    every = max(1, round(1 / dt / FASTEST))
    try:
        with av.open(str(path), "w", format="mp4", options={"movflags": "+faststart"}) as video:
            stream = video.add_stream("libx264", rate=Fraction(1 / (dt * every)).limit_denominator(1000))
            stream.width, stream.height = (size // 2 * 2 for size in images[0].size)  # x264 wants them even
            stream.pix_fmt, stream.options = "yuv420p", {"crf": QUALITY}
            for image in images[::every]:
                even = image.crop((0, 0, stream.width, stream.height))
                video.mux(stream.encode(av.VideoFrame.from_image(even)))
            video.mux(stream.encode())
    except OSError as error:
        raise InputError(
            f"cannot write {path}: {error.strerror or error}. Name a file in a folder that takes it."
        ) from error


def video_file(name: str) -> Path:
    """Where a video is to be written; what is wrong with that is said before anything is executed.

    Raises:
        InputError: it is no MP4, or what encodes it is not installed.
    """
    path = Path(name).expanduser()
    if path.suffix.lower() != ".mp4":
        raise InputError(f"got the video {name}; only MP4 is written, by that ending. Say --video {path.stem}.mp4.")
    encoder()
    return path


def encoder() -> Any:
    """What encodes videos.

    Raises:
        InputError: it is not installed.
    """
    try:
        import av
    except ImportError as error:
        raise InputError(
            f"a video was asked for, and what encodes it is not installed ({error}); av is an extra of hiprl. "
            "Install it: pip install 'hiprl[video]', or write --html, which needs nothing."
        ) from error
    return av
