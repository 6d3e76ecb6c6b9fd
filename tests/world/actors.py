"""Actors for the tests of worlds."""

import jax.numpy as jnp
import jax.random as jr
from jaxtyping import Array, Float

from hiprl.types import Actor


class Uniform(Actor):
    """Draws each entry uniformly from [-limit, limit]."""

    limit: Float[Array, " q"]

    def act(self, s, *, key):
        return jr.uniform(key, self.limit.shape, minval=-self.limit, maxval=self.limit)


class Constant(Actor):
    """The same action in every state."""

    a: Float[Array, " q"]

    def act(self, s, *, key):
        return self.a


def uniform(q):
    return Uniform(jnp.ones(q))
