"""A tiny run in a process of its own, for tests that kill it: store, run and moment come from the command line."""

import sys

import jax

from hiprl.feedback.judges import exact
from hiprl.session import carry_on
from hiprl.store.store import open_store
from hiprl.world.build import world_from


def say(facts):
    sys.stdout.write(f"{facts['k']}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    # as in the tests' own process: the same programs from the same cache
    jax.config.update("jax_debug_key_reuse", True)
    jax.config.update("jax_numpy_rank_promotion", "raise")
    with open_store(sys.argv[1]) as store:
        carry_on(store, sys.argv[2], world_from("linear"), exact, watch=say)
