import numpy as np
import pytest

from hiprl.models.quality import predicted
from hiprl.models.reward import AdditiveConfig, estimate_additive_reward
from tests.models.test_answers import H as STEPS_OF_T
from tests.models.test_answers import answered, linear_set


@pytest.mark.slow
def test_ratings_are_predicted_too():
    T = linear_set(21, [STEPS_OF_T] * 12, H=STEPS_OF_T, capacity=17)
    reward = estimate_additive_reward(answered(T, ["number"], m=2), T, AdditiveConfig(smooth=(0.01,)), steps=16)
    held = predicted(answered(T, ["rating"], n=20, seed=7, m=2), T, reward)
    right = np.asarray(held.right)
    assert np.isfinite(right).sum() >= 8
    assert np.nanmean(right) > 0.9
