"""Films an environment: by where a MuJoCo model's bodies are, for which no graphics card is needed, or in pictures."""

from __future__ import annotations

import base64
import io
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from hiprl.data.film import Film
from hiprl.errors import InputError
from hiprl.world.words import said

GEOMS = {0: "plane", 2: "sphere", 3: "capsule", 4: "ellipsoid", 5: "cylinder", 6: "box", 7: "mesh"}  # MuJoCo's numbers
HIDDEN_GROUP = 3  # geoms of this group and above are for collisions, and not drawn
SMALL = ((240, 60), (240, 35), (160, 35), (160, 15))  # (width, quality of a JPEG) for a page: the first that fits
FITS = 2048  # bytes of one picture, so that two clips of 50 steps stay under 300 kB
LARGE = ((1280, 95),)  # for a video
FRAME = (640, 480)  # in which MuJoCo draws: what its models provide for
SHADOW, REFLECTION = 0, 2  # MuJoCo's numbers for what takes most of the time where there is no graphics card


class Camera(ABC):
    """Looks at an environment after its reset and after each step."""

    scene: dict[str, Any]
    """What its films play in, as plain values."""

    @abstractmethod
    def look(self) -> Any:
        """What is to be seen now."""

    @abstractmethod
    def film(self, looks: list[Any]) -> Film:
        """The looks of an episode together."""

    def reads(self, s: np.ndarray) -> bool:
        """Whether it can tell from the observation `s`, which is the newest one, what it looks at."""
        return False

    def film_of(self, states: np.ndarray) -> Film | None:
        """A film of observations (n, p) that nobody saw; None if it does not read them."""
        return None


class Layout(NamedTuple):
    """Where the joints of a MuJoCo model stand in an observation: places and then velocities, at its beginning."""

    left_out: int
    """First places that it leaves out: those along which all is the same."""
    places: int
    velocities: int

    @classmethod
    def of(cls, inner: Any) -> Layout | None:
        """What an environment of Gymnasium's says of its own; None where it says nothing, or not of all joints."""
        told = getattr(inner, "observation_structure", None)
        if not isinstance(told, dict) or not {"qpos", "qvel"} <= told.keys():
            return None
        layout = cls(int(told.get("skipped_qpos", 0)), int(told["qpos"]), int(told["qvel"]))
        whole = layout.left_out + layout.places == inner.model.nq and layout.velocities == inner.model.nv
        return layout if whole else None


class Bodies(Camera):
    """The bodies of a MuJoCo model: a page draws them, so that nothing needs to be rendered here."""

    def __init__(self, model: Any, data: Any, dt: float, layout: Layout | None = None):
        import mujoco  # only here: other worlds run where it cannot be loaded

        self._mujoco: Any = mujoco  # it comes without types
        self._model, self._data, self._own = model, data, self._mujoco.MjData(model)
        self._layout, self._dt = layout, dt
        self.scene = {"kind": "mujoco", "dt": dt, "bodies": int(model.nbody), **_geoms(model)}

    def look(self) -> np.ndarray:
        # The simulation's own poses are those before its last step in time, and are not ours to renew.
        own = self._own
        own.mocap_pos[:], own.mocap_quat[:] = self._data.mocap_pos, self._data.mocap_quat
        return self._poses(self._data.qpos)

    def _poses(self, places: np.ndarray) -> np.ndarray:
        """Of all bodies, with the joints at these places."""
        own = self._own
        own.qpos[:] = places
        self._mujoco.mj_kinematics(self._model, own)
        return np.concatenate([own.xpos, own.xquat], axis=1).astype(np.float32)

    def film(self, looks: list[Any]) -> Film:
        return Film(poses=np.stack(looks))

    def reads(self, s: np.ndarray) -> bool:
        if self._layout is None:
            return False
        skip, n, m = self._layout
        joints = np.concatenate([self._data.qpos[skip:], self._data.qvel])
        return len(s) >= n + m and np.allclose(s[: n + m], joints, atol=1e-4)

    def film_of(self, states: np.ndarray) -> Film | None:
        if self._layout is None:
            return None
        skip, n, _ = self._layout
        moved = self._dt * np.cumsum(states[:-1, n : n + skip], axis=0, dtype=np.float64)
        left_out = self._model.qpos0[:skip] + np.concatenate([np.zeros((1, skip)), moved])
        return Film(poses=np.stack([self._poses(places) for places in np.hstack([left_out, states[:, :n]])]))


class Pictures(Camera):
    """What the environment itself draws, or MuJoCo does."""

    def __init__(self, draw: Callable[[], Any], dt: float, *, sizes: tuple[tuple[int, int], ...] = SMALL):
        self._draw, self._sizes = draw, sizes
        self.scene = {"kind": "frames", "dt": dt}

    def look(self) -> bytes:
        from PIL import Image

        whole = Image.fromarray(np.asarray(self._draw(), np.uint8))
        jpeg = b""
        for width, quality in self._sizes:
            height = max(1, round(whole.height * width / whole.width))
            image = whole if whole.width <= width else whole.resize((width, height))
            buffer = io.BytesIO()
            image.save(buffer, "JPEG", quality=quality)
            jpeg = buffer.getvalue()
            if len(jpeg) <= FITS:
                break
        return jpeg

    def film(self, looks: list[Any]) -> Film:
        return Film(pictures=looks)


def camera_of(env: Any, *, drawn: bool = False) -> Camera | None:
    """A camera for this environment; None if there is nothing to be seen of it.

    Args:
        env: the environment.
        drawn: whether pictures are wanted, for a video, also of bodies that a page could draw.

    Raises:
        InputError: MuJoCo's bodies are to be drawn here, and nothing here can do it.
    """
    inner = env.unwrapped
    dt = float(getattr(inner, "dt", 0.0) or 1 / (env.metadata.get("render_fps") or 20))
    sizes = LARGE if drawn else SMALL
    model, data = getattr(inner, "model", None), getattr(inner, "data", None)
    if hasattr(model, "geom_type") and hasattr(data, "xquat"):
        return Pictures(_drawing(inner), dt, sizes=sizes) if drawn else Bodies(model, data, dt, Layout.of(inner))
    return Pictures(env.render, dt, sizes=sizes) if getattr(env, "render_mode", None) == "rgb_array" else None


def _drawing(inner: Any) -> Callable[[], np.ndarray]:
    """Draws the bodies of an environment with OpenGL, seen from where it is seen usually."""
    import mujoco
    from gymnasium.envs.mujoco.mujoco_rendering import MujocoRenderer

    mj: Any = mujoco  # it comes without types
    usual = getattr(inner, "mujoco_renderer", None)
    follows = mj.mj_name2id(inner.model, mj.mjtObj.mjOBJ_CAMERA, "track") >= 0
    try:
        renderer = MujocoRenderer(
            inner.model,
            inner.data,
            default_cam_config=getattr(usual, "default_cam_config", None),
            width=FRAME[0],
            height=FRAME[1],
            camera_name="track" if follows else None,
        )
        renderer.render("rgb_array")
    except Exception as error:
        raise InputError(
            f"cannot draw the bodies here ({said(error)}); a video is drawn with OpenGL, a page of `--html` without. "
            "On a machine without a screen install EGL (on Debian: apt-get install libegl1 libgl1-mesa-dri libopengl0) "
            "and write MUJOCO_GL=egl before the command, or leave --video out."
        ) from error
    flags = renderer._get_viewer("rgb_array").scn.flags
    flags[SHADOW] = flags[REFLECTION] = 0
    return lambda: np.asarray(renderer.render("rgb_array"))


def _geoms(model: Any) -> dict[str, Any]:
    """The visible shapes of a model, and the meshes they are made of."""
    geoms, used = [], {}
    for i in range(model.ngeom):
        kind = GEOMS.get(int(model.geom_type[i]))
        rgba = _colour(model, i)
        if kind is None or rgba[3] == 0 or int(model.geom_group[i]) >= HIDDEN_GROUP:
            continue
        geom = {
            "body": int(model.geom_bodyid[i]),
            "type": kind,
            "size": model.geom_size[i].round(5).tolist(),
            "pos": model.geom_pos[i].round(5).tolist(),
            "quat": model.geom_quat[i].round(6).tolist(),
            "rgba": rgba,
        }
        if kind == "mesh":
            geom["mesh"] = used.setdefault(int(model.geom_dataid[i]), len(used))
        geoms.append(geom)
    return {"geoms": geoms, "meshes": [_mesh(model, mesh) for mesh in used]}


def _colour(model: Any, i: int) -> list[float]:
    """A geom's own colour, or that of its material."""
    material = int(model.geom_matid[i])
    rgba = model.mat_rgba[material] if material >= 0 else model.geom_rgba[i]
    return [round(float(x), 3) for x in rgba]


def _mesh(model: Any, i: int) -> dict[str, str]:
    at, n = int(model.mesh_vertadr[i]), int(model.mesh_vertnum[i])
    first, m = int(model.mesh_faceadr[i]), int(model.mesh_facenum[i])
    told = lambda array, dtype: base64.b64encode(np.ascontiguousarray(array, dtype).tobytes()).decode()
    return {
        "vertices": told(model.mesh_vert[at : at + n], np.float32),
        "faces": told(model.mesh_face[first : first + m], np.uint32),
    }
