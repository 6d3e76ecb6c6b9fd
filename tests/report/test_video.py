from __future__ import annotations

import io
import sys
from pathlib import Path

import av
import numpy as np
import pytest
from PIL import Image

from hiprl.data.film import Film
from hiprl.errors import InputError
from hiprl.report.video import video_file, write_video


def film(n: int, size: tuple[int, int]) -> Film:
    """Pictures that get brighter."""
    pictures = []
    for i in range(n):
        buffer = io.BytesIO()
        Image.new("RGB", size, (10 * i, 10 * i, 10 * i)).save(buffer, "JPEG", quality=95)
        pictures.append(buffer.getvalue())
    return Film(pictures=pictures)


@pytest.mark.parametrize(("dt", "rate", "shown"), [(0.05, 20, range(21)), (0.008, 62.5, range(0, 21, 2))])
def test_a_video_shows_the_pictures_in_their_time(tmp_path: Path, dt: float, rate: float, shown: range):
    path = tmp_path / "walk.mp4"
    write_video(path, film(21, (151, 100)), dt)
    with av.open(str(path)) as video:
        stream = video.streams.video[0]
        found = [float(np.mean(frame.to_ndarray(format="rgb24"))) for frame in video.decode(stream)]
        assert float(stream.average_rate) == pytest.approx(rate) and (stream.width, stream.height) == (150, 100)
    assert stream.codec_context.pix_fmt == "yuv420p"  # which every player knows
    np.testing.assert_allclose(found, [10 * i for i in shown], atol=3)


def test_a_folder_that_is_not_there_is_said(tmp_path: Path):
    with pytest.raises(InputError, match=r"cannot write .*walk.mp4.*Name a file"):
        write_video(tmp_path / "none" / "walk.mp4", film(3, (20, 20)), 0.1)


def test_a_missing_encoder_is_said(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(InputError, match=r"not installed.*extra.*pip install 'hiprl\[video\]'"):
        video_file("walk.mp4")


def test_only_mp4_is_written():
    with pytest.raises(InputError, match=r"walk\.gif.*only MP4.*--video walk\.mp4"):
        video_file("walk.gif")
