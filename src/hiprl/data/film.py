"""What a person is shown of a trajectory: where each body was, or pictures."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class Film:
    """One look for each state of a trajectory, the first and the last included: one of the two."""

    poses: np.ndarray | None = None
    """(length + 1, bodies, 7): place x, y, z and turn w, x, y, z of each body in the world."""
    pictures: Sequence[bytes] | None = None
    """JPEG."""

    def cut(self, start: int, length: int | None) -> Film:
        """The looks of some steps, the state after the last one included."""
        part = slice(start, None if length is None else start + length + 1)
        if self.poses is not None:
            return Film(poses=self.poses[part])
        return Film(pictures=(self.pictures or ())[part])

    def to_bytes(self) -> bytes:
        """As the store keeps it."""
        buffer = io.BytesIO()
        if self.poses is not None:
            np.savez_compressed(buffer, poses=self.poses.astype(np.float32))
        else:
            pictures = self.pictures or ()
            ends = np.cumsum([len(picture) for picture in pictures], dtype=np.int64)
            np.savez(buffer, ends=ends, jpeg=np.frombuffer(b"".join(pictures), np.uint8))
        return buffer.getvalue()

    @classmethod
    def from_bytes(cls, data: bytes) -> Film:
        """What `to_bytes` was given."""
        with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
            if "poses" in arrays:
                return cls(poses=arrays["poses"])
            ends, jpeg = arrays["ends"].tolist(), arrays["jpeg"].tobytes()
        return cls(pictures=[jpeg[a:b] for a, b in zip([0, *ends[:-1]], ends, strict=True)])
