"""What the entries of states and actions are called, where a MuJoCo model says so."""

from __future__ import annotations

from typing import Any, NamedTuple

FREE, BALL, SLIDE = 0, 1, 2  # MuJoCo's types of joints; 3 is a hinge
MOVES_A_JOINT = 0, 1  # MuJoCo's types of transmissions; others pull tendons, bodies and sites
AXES, TURNS = ("x", "y", "z"), ("qw", "qx", "qy", "qz")


class Names(NamedTuple):
    """A name for each entry."""

    state: tuple[str, ...]
    action: tuple[str, ...]


def numbered(p: int, q: int) -> Names:
    """Names where nothing better is known."""
    return Names(tuple(f"s[{i}]" for i in range(p)), tuple(f"a[{i}]" for i in range(q)))


def names_of(env: Any, p: int, q: int) -> Names:
    """Names of what an environment observes and takes.

    A MuJoCo model names its joints. Which of them an observation begins with is told by `observation_structure`
    (Gymnasium's own environments have it), or by its size where it is all positions and all velocities.
    """
    inner: Any = getattr(env, "unwrapped", env)
    plain = numbered(p, q)
    model: Any = getattr(inner, "model", None)
    try:
        positions, velocities = _joints(model)
        actuators = tuple(_actuator(model, i) for i in range(model.nu))
    except (AttributeError, TypeError, ValueError, IndexError):  # no model of MuJoCo's
        return plain
    shown = getattr(inner, "observation_structure", None)
    if not isinstance(shown, dict):
        shown = {"qpos": len(positions), "qvel": len(velocities)} if p == len(positions) + len(velocities) else {}
    skipped, n, m = (int(shown.get(part, 0)) for part in ("skipped_qpos", "qpos", "qvel"))
    first = (*positions[skipped : skipped + n], *velocities[:m])
    state = (*first, *plain.state[len(first) :]) if len(first) <= p else plain.state
    return Names(state, actuators if len(actuators) == q else plain.action)


def _joints(model: Any) -> tuple[list[str], list[str]]:
    """Names of the positions and of the velocities of a model."""
    positions, velocities = [], []
    for j in range(model.njnt):
        name, kind = model.joint(j).name or f"joint {j}", int(model.jnt_type[j])
        if kind in (FREE, BALL):
            along = AXES if kind == FREE else ()
            positions += [f"{name} {axis}" for axis in (*along, *TURNS)]
            velocities += [f"{name} velocity {axis}" for axis in along] + [f"{name} spin {axis}" for axis in AXES]
        else:
            positions.append(f"{name} {'position' if kind == SLIDE else 'angle'}")
            velocities.append(f"{name} {'velocity' if kind == SLIDE else 'spin'}")
    return positions, velocities


def _actuator(model: Any, i: int) -> str:
    """Its own name, or that of the joint that it moves."""
    moves = int(model.actuator_trntype[i]) in MOVES_A_JOINT
    name = model.actuator(i).name or (model.joint(int(model.actuator_trnid[i, 0])).name if moves else "")
    return f"{name} effort" if name else f"a[{i}]"
