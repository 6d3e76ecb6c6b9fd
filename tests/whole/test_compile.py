import logging
from dataclasses import replace

import jax
import pytest

from hiprl.control.search import search
from hiprl.feedback.judges import exact
from hiprl.session import RunSpec, carry_on, start
from hiprl.world.build import world_from
from tests.whole.tasks import TINY


@pytest.mark.slow
def test_nothing_compiles_after_the_second_searched_episode(store, caplog):
    # capacities of its own, so that no other test has compiled anything of this run
    config = replace(TINY, comparisons=9)
    world = world_from("linear")
    run_id = start(store, world, RunSpec(seed=3, config=config, judge="exact", eval_episodes=2))
    compiled, searches = [], []

    def watch(facts):
        new = [record.getMessage() for record in caplog.records if record.getMessage().startswith("Compiling ")]
        compiled.append((facts["k"], new))
        searches.append(search._cache_size())
        caplog.clear()

    with caplog.at_level(logging.WARNING, logger="jax"), jax.log_compiles(True):
        carry_on(store, run_id, world, exact, watch=watch)
    assert any(new for k, new in compiled if k <= config.warm_up)  # the count counts
    second = config.warm_up + 1
    assert {k: [line[:120] for line in new] for k, new in compiled if k > second and new} == {}
    assert searches[-1] == searches[second - 1]
