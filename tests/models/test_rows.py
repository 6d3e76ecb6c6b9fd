import jax.numpy as jnp
import jax.random as jr
import numpy as np
from hypothesis import given
from scipy import stats

from hiprl.models.rows import RowDraw
from tests.data.samples import seeds


@given(seeds)
def test_only_rows_that_the_mask_lets_through_are_drawn(seed):
    mask = np.random.default_rng(seed).random(29) < 0.3
    mask[seed % 29] = True
    rows = RowDraw.of(jnp.asarray(mask))(jr.key(seed), (7, 5))
    assert rows.shape == (7, 5) and mask[np.asarray(rows)].all()


def test_rows_are_drawn_uniformly():
    mask = np.zeros(31, bool)
    mask[[2, 3, 11, 12, 13, 29, 30]] = True
    rows = np.asarray(RowDraw.of(jnp.asarray(mask))(jr.key(7), (5000,)))
    seen = np.bincount(rows, minlength=31)[mask]
    left = stats.chi2.cdf(stats.chisquare(seen).statistic, len(seen) - 1)
    assert 1e-4 < left < 1 - 1e-4


def test_where_nothing_can_be_drawn_the_shape_still_holds():
    draw = RowDraw.of(jnp.zeros(13, bool))
    assert int(draw.count) == 0
    assert draw(jr.key(0), (3,)).shape == (3,)
