"""A model that is known, and a reward that is known, in which the best policy can be worked out by hand."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hiprl.control.imagined import Starts
from hiprl.hallucinated import Hallucinated
from hiprl.models.network import Scaler
from hiprl.types import Dynamics, Prediction, Reward
from tests.data.samples import p, q

M = 2


class Known(Dynamics):
    """s′ = A s + B a, with noise of this size and as unsure as it is told to be."""

    A: Float[Array, "p p"]
    B: Float[Array, "p q"]
    noise: Float[Array, " p"]
    sigma: Float[Array, " p"]
    doubt: Float[Array, ""]
    """What σ grows by for an action of size 1."""

    def predict(self, s, a):
        return Prediction(self.A @ s + self.B @ a, self.sigma + self.doubt * jnp.sum(a**2), self.noise)

    def members(self):
        """M times the mean."""
        sure = Known(self.A, self.B, self.noise, jnp.zeros_like(self.sigma), jnp.zeros_like(self.doubt))
        return jax.tree.map(lambda x: jnp.broadcast_to(x, (M, *x.shape)), sure)


class Quadratic(Reward):
    """r = -(s - d)ᵀQ(s - d) - (a - G s - c)ᵀR(a - G s - c)."""

    Q: Float[Array, "p p"]
    R: Float[Array, "q q"]
    G: Float[Array, "q p"]
    c: Float[Array, " q"]
    d: Float[Array, " p"]

    def __call__(self, s, a):
        miss, off = a - self.G @ s - self.c, s - self.d
        return -(off @ self.Q @ off) - miss @ self.R @ miss


def known(*, A=None, B=None, noise=0.0, sigma=0.0, doubt=0.0, mode="greedy", beta=1.0, reach=9.0):
    """The hallucinated model around such a dynamics."""
    A, B = np.zeros((p, p)) if A is None else A, np.zeros((p, q)) if B is None else B
    full = lambda x: jnp.full(p, x, jnp.float32)
    return Hallucinated(
        dynamics=Known(*(jnp.asarray(x, jnp.float32) for x in (A, B)), full(noise), full(sigma), jnp.float32(doubt)),
        beta=full(beta),
        bonus=jnp.ones(()),
        step_scale=full(1.0),
        low=full(-reach),
        high=full(reach),
        mode=mode,
    )


def quadratic(*, Q=None, R=None, G=None, c=None, d=None):
    """The reward with zeros for what is not given."""
    shapes = {"Q": (p, p), "R": (q, q), "G": (q, p), "c": (q,), "d": (p,)}
    given = {"Q": Q, "R": R, "G": G, "c": c, "d": d}
    return Quadratic(**{n: jnp.asarray(np.zeros(shapes[n]) if x is None else x, jnp.float32) for n, x in given.items()})


def starts(seed=5, *, spread=0.6, n=211):
    """States around zero, in which rollouts begin."""
    seen = jnp.asarray(np.random.default_rng(seed).normal(0, spread, (n, p)), jnp.float32)
    return Starts(seen, seen[:11], Scaler(jnp.zeros(p), jnp.full(p, spread, jnp.float32)))
