from dataclasses import replace

import numpy as np
import pytest

import hiprl
from hiprl.config import paper
from hiprl.control.plan import PlanConfig
from hiprl.hallucinated import OPTIMISM
from hiprl.models.reward_network import NetworkConfig
from tests.whole.tasks import TINY

SHORT = replace(TINY, comparisons=4)
PAPER = replace(
    paper("linear"),
    comparisons=4,
    warm_up=3,
    dynamics=TINY.dynamics,
    reward=NetworkConfig(members=2, steps=10),
    search=replace(paper("linear").search, total_timesteps=1000, trial_steps=10, trial_starts=2),
)
ARMS = {mode: replace(SHORT, optimism=mode) for mode in OPTIMISM} | {
    "sample": replace(SHORT, plan=PlanConfig(kind="sample")),
    "mpc": replace(SHORT, plan=PlanConfig(kind="mpc", proposals=7, elites=3, horizon=3), optimism="eta_policy"),
    "no restart": replace(SHORT, restart=False, kappa_decay=0.5),
    "network": replace(SHORT, reward=NetworkConfig(members=2, steps=10)),
    "paper": PAPER,
}


@pytest.mark.slow
@pytest.mark.parametrize("arm", ARMS)
def test_every_arm_learns_acts_and_can_be_loaded(arm, tmp_path):
    watched = []
    learned = hiprl.learn("linear", config=ARMS[arm], seed=1, store=tmp_path / "runs.db", watch=watched.append)
    assert learned.summary["comparisons"] == 4 and learned.summary["return_mean"] is not None
    assert all(facts["imagined"] is not None for facts in watched if facts["searched"])
    obs = np.array([0.5, -0.3, 0.2])
    again = hiprl.load(learned.summary["run"], store=tmp_path / "runs.db")
    np.testing.assert_array_equal(again.predict(obs)[0], learned.predict(obs)[0])
