from copy import copy
from dataclasses import replace
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest
from jax.tree_util import Partial

from hiprl.control import imagined
from hiprl.control.gradient import GradientConfig, gradient_search, new_gradient, new_value
from hiprl.control.imagined import Chance, trials
from hiprl.control.plan import Follow
from hiprl.errors import InputError
from hiprl.rollout import roll_out
from hiprl.types import Dynamics, Prediction, Reward, stacked_size
from hiprl.world.linear import default_linear
from tests.control.known import M, known, quadratic, starts
from tests.data.samples import p, q

CONFIG = GradientConfig(
    chunks=2,
    updates=200,
    rollouts=16,
    steps=5,
    trial_steps=31,
    trial_starts=5,
    hidden=(16,),
    policy_rate=1e-2,
    value_rate=1e-2,
    gamma=0.9,
    entropy=1e-4,
)
TWO = np.array([0.3, -0.5])
NONE = jnp.asarray(0)


def traced(config, **settings):
    """The config with settings that only the compiled search gets to know, so that one is compiled for all."""
    config = copy(config)
    for name, value in settings.items():
        object.__setattr__(config, name, value)  # where `replace` would want a float
    return config


@pytest.fixture(scope="module")
def search():
    """One compiled search for all models, rewards and starts of the same shapes."""

    @jax.jit
    def compiled(f_tilde, reward, unit, places, state, key):
        settings = {"H": 1000, "setbacks": NONE, "key": key}
        return gradient_search(f_tilde, reward, unit, None, places, state, CONFIG, **settings)

    return compiled


def blank(size=q):
    return new_gradient(starts().scaler, size, CONFIG, key=jr.key(1))


def found(search, f_tilde, reward, *, unit=1.0, state=None, seed=2):
    state, report = search(f_tilde, reward, jnp.asarray(unit), starts(), state or blank(), jr.key(seed))
    assert report.finite
    return state, report


def modes(state, states):
    return np.asarray(jax.vmap(state.policy.mode)(states))


def test_one_action_is_best_everywhere(search):
    state, _ = found(search, known(), quadratic(R=np.eye(q), c=TWO))
    np.testing.assert_allclose(modes(state, starts().seen), np.broadcast_to(TWO, (211, q)), atol=0.06)


def test_the_best_action_depends_on_the_state(search):
    G = np.array([[0.5, 0.0, -0.3], [0.0, -0.6, 0.2]])
    state, _ = found(search, known(), quadratic(R=np.eye(q), G=G))
    best = np.asarray(starts().seen) @ G.T
    inside = (np.abs(best) < 0.8).all(1)
    error = (modes(state, starts().seen) - best)[inside]
    assert np.sqrt(np.mean(error**2)) < 0.25 * np.sqrt(np.mean(best[inside] ** 2))


def test_the_reward_comes_a_step_after_the_action(search):
    B = np.array([[1.0, 0.0], [0.0, 1.0], [0.0, 0.0]])
    state, _ = found(search, known(B=B), quadratic(Q=np.eye(p), d=[*TWO, 0.0]))
    assert np.sqrt(np.mean((modes(state, starts().seen) - TWO) ** 2)) < 0.1


def linear_search(search, **rest):
    """A search in the linear world, whose optimum is known."""
    task = default_linear()
    f_tilde = known(A=np.asarray(task.A), B=np.asarray(task.B), noise=float(task.noise_std))
    return task, *found(search, f_tilde, quadratic(Q=np.asarray(task.Q), R=np.asarray(task.R)), **rest)


def worth(task, actor, n=16):
    """Mean true return of an actor over n episodes of the task, the same for all actors."""

    @jax.jit
    def one(actor, key):
        first_key, roll_key = jr.split(key)
        return roll_out(task.f, actor, task.s_0(first_key), H=task.H, r=task.r, key=roll_key).true_return

    return np.mean([float(one(actor, key)) for key in jr.split(jr.key(5), n)])


def follow(state):
    return Follow(state.policy, q, explore=False)


@pytest.mark.slow
def test_a_linear_system_is_driven_within_three_percent_of_its_optimum():
    config = replace(CONFIG, gamma=0.99, chunks=4, steps=16, updates=400, value_rate=3e-3, entropy=1e-6)

    @jax.jit
    def longer(f_tilde, reward, unit, places, state, key):
        return gradient_search(f_tilde, reward, unit, None, places, state, config, H=1000, setbacks=NONE, key=key)

    task, state, _ = linear_search(longer, unit=0.02)
    task, state, _ = linear_search(longer, state=state, seed=3, unit=0.02)
    # the same episodes for both: what is left is the policy's own regret
    regret = worth(task, task.optimal_actor(), 64) - worth(task, follow(state), 64)
    assert regret < 0.03 * abs(task.optimal_return())
    assert task.expected_return(np.zeros((q, p))) < 2 * task.optimal_return()


def test_a_search_improves_on_where_it_began(search):
    task, state, _ = linear_search(search)
    assert worth(task, follow(state)) > worth(task, follow(blank()))


def test_the_imagined_return_is_that_of_a_plain_rollout(search):
    task = default_linear()
    f_tilde = known(A=np.asarray(task.A), B=np.asarray(task.B))  # without noise
    reward = quadratic(Q=np.asarray(task.Q), R=np.asarray(task.R))
    one_start = eqx.tree_at(
        lambda places: places.first, starts(), jnp.broadcast_to(jnp.array([0.5, -0.3, 0.2]), (11, p))
    )
    state, report = search(f_tilde, reward, jnp.asarray(1.0), one_start, blank(), jr.key(3))
    s, total = np.array([0.5, -0.3, 0.2]), 0.0
    for _ in range(CONFIG.trial_steps):
        a = np.asarray(state.policy.mode(jnp.asarray(s, jnp.float32)), float)
        total += float(reward(jnp.asarray(s, jnp.float32), jnp.asarray(a, jnp.float32)))
        s = np.asarray(task.A, float) @ s + np.asarray(task.B, float) @ a
    assert float(report.imagined) == pytest.approx(total, rel=1e-3)
    assert float(report.worst) == pytest.approx(total, rel=1e-3)


def test_the_judges_unit_changes_no_behaviour(search):
    G = np.array([[0.5, 0.0, -0.3], [0.0, -0.6, 0.2]])
    one, _ = found(search, known(), quadratic(R=np.eye(q), G=G))
    other, _ = found(search, known(), quadratic(R=1000 * np.eye(q), G=G), unit=1000.0)
    np.testing.assert_allclose(modes(other, starts().seen), modes(one, starts().seen), atol=0.1)


def test_the_same_key_finds_the_same_policy(search):
    one, other, third = (found(search, known(), quadratic(R=np.eye(q), c=TWO), seed=seed)[0] for seed in (7, 7, 8))
    assert all((x == y).all() for x, y in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True))
    assert any((x != y).any() for x, y in zip(jax.tree.leaves(one), jax.tree.leaves(third), strict=True))


@pytest.fixture(scope="module")
def short_search():
    """One compiled search of few updates, of any learning rate and after any setbacks."""
    config, reward = replace(CONFIG, updates=20), quadratic(R=np.eye(q), c=TWO)

    @jax.jit
    def compiled(state, rate, setbacks):
        settings = {"config": traced(config, policy_rate=rate), "H": 1000, "setbacks": setbacks, "key": jr.key(2)}
        return gradient_search(known(), reward, jnp.asarray(1.0), None, starts(), state, **settings)

    return compiled


def test_a_search_goes_less_far_from_where_others_went_wrong(short_search):
    whole, half, quarter, none = (
        modes(short_search(blank(), 1e-3, jnp.asarray(setbacks))[0], starts().seen) for setbacks in (0, 1, 2, 40)
    )
    assert (whole != half).any()  # two chunks, then one, and no less
    np.testing.assert_array_equal(half, quarter)
    np.testing.assert_array_equal(half, none)


def test_where_a_search_begins_is_not_executed_again(short_search):
    good, report = short_search(blank(), 1e-3, NONE)
    other, worse = short_search(good, 1.0, NONE)
    assert (modes(other, starts().seen) != modes(good, starts().seen)).any()
    assert float(worse.worst) < float(report.worst)


class One(Reward):
    """Each step is worth the same."""

    def __call__(self, s, a):
        return jnp.ones(())


@partial(jax.jit, static_argnames=("ends", "settling"))
def still(f_tilde, reward, ends, state, raised, offset_rate, going_on, *, settling):
    """A search whose policy does not move, and whose value begins so high."""
    config = replace(CONFIG, chunks=1, updates=1, policy_rate=0.0, settling=settling)
    config = traced(config, offset_rate=offset_rate, going_on=going_on)
    with pytest.MonkeyPatch.context() as patch:  # as the search is traced
        begins = lambda *args, **rest: new_value(*args, **rest).raised(raised)
        patch.setattr("hiprl.control.gradient.new_value", begins)
        more = {"H": 1000, "setbacks": NONE, "key": jr.key(2)}
        return gradient_search(f_tilde, reward, jnp.asarray(1.0), ends, starts(), state, config, **more)[0]


def value_after(
    *, ends=None, state=None, f_tilde=None, reward=None, settling, raised=0.0, offset_rate=0.1, going_on=0.5
):
    """V, in its own unit, of a search whose policy does not move; where nothing else is said, a step is worth 1."""
    places = f_tilde or known(), reward or One(), ends, state or blank()
    found = still(*places, raised, offset_rate, going_on, settling=settling)
    return np.asarray(jax.vmap(found.value)(starts().seen)) * (1 - CONFIG.gamma)


@pytest.mark.parametrize("ends", [None, Partial(lambda s, a, s_next: s[0] > 0)])
def test_a_value_that_is_off_everywhere_is_mended_before_the_policy_moves(ends):
    """As where rewards have a mean: zero, at which it begins, is far off then."""
    after = partial(value_after, ends=ends, raised=30.0, settling=40)
    slowly, soon = after(offset_rate=0.0), after()
    begun = new_value(starts().scaler, CONFIG, key=jr.key(4)).raised(jnp.asarray(30.0))
    before = np.asarray(jax.vmap(begun)(starts().seen)) * (1 - CONFIG.gamma)
    truth = np.ones(len(soon)) if ends is None else np.where(starts().seen[:, 0] > 0, 1 - CONFIG.gamma, 1.0)
    off_by = lambda value: np.mean(np.abs(value - truth))
    assert off_by(before) > 1.5
    assert off_by(soon) < min(0.25, 0.5 * off_by(slowly))


def test_what_an_earlier_search_believed_of_values_does_not_matter():
    """It is of another model and another r̂, and may have run away."""
    believed = eqx.tree_at(lambda state: state.value, blank(), blank().value.raised(jnp.asarray(1e6)))
    np.testing.assert_array_equal(value_after(state=believed, settling=40), value_after(settling=40))


class Far(Reward):
    """1 a step, far from all that was seen."""

    def __call__(self, s, a):
        return jnp.where(jnp.abs(s[0]) > 8, 1.0, 0.0)


def test_the_value_holds_where_rollouts_lead_and_not_only_where_they_begin():
    """States grow by 1.3 a step: five are not enough to come from what was seen to where the reward is."""
    grows = known(A=1.3 * np.eye(p))
    after = lambda share: value_after(f_tilde=grows, reward=Far(), settling=300, going_on=share)
    assert np.abs(after(0.0)).mean() > 2  # each step is worth 1 at most: V has run away
    # half of the rollouts go on, and so lead from |s_0| = 0.5 to 8 in eleven steps, and stay: 0.9^11 = 0.31
    assert 0.1 < after(0.5).mean() < 0.6


@pytest.mark.parametrize(("H", "gamma"), [(31, 0.99), (200, 0.99), (320, 0.99375), (400, 0.995), (10_000, 0.995)])
def test_long_episodes_are_looked_further_into(H, gamma):
    assert GradientConfig().discount(H) == pytest.approx(gamma)
    assert CONFIG.discount(H) == CONFIG.gamma


@pytest.mark.parametrize("settings", [{"gamma": 1.0}, {"gamma": -0.1}, {"updates": 0}, {"trial_starts": 0}])
def test_impossible_settings_are_told(settings):
    (setting,) = settings.items()
    with pytest.raises(InputError, match="got {} = {} for the search".format(*setting)):
        GradientConfig(**settings)


def test_scalers_are_not_trained(search):
    state, _ = found(search, known(), quadratic(R=np.eye(q), c=TWO))
    np.testing.assert_array_equal(state.policy.inputs.mean, starts().scaler.mean)
    np.testing.assert_array_equal(state.value.inputs.std, starts().scaler.std)
    assert float(state.value.scale) == pytest.approx(1.0 / (1 - CONFIG.gamma))


def test_rewards_that_are_not_finite_are_said_to_be(search):
    _, report = search(known(), quadratic(c=[jnp.nan, 0], R=np.eye(q)), jnp.asarray(1.0), starts(), blank(), jr.key(2))
    assert not report.finite


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["eta_policy", "eta_sign"])
def test_hope_makes_a_reward_out_of_reach_look_near(mode):
    # nothing that is done moves the state, but the model is not sure of that: only η leads to where the reward is
    reward = quadratic(Q=np.eye(p), d=[0.8, 0.8, 0.8])

    @jax.jit
    def run(f_tilde, state):
        return gradient_search(
            f_tilde,
            reward,
            jnp.asarray(1.0),
            None,
            starts(),
            state,
            CONFIG,
            H=1000,
            setbacks=NONE,
            key=jr.key(2),
        )

    values = {}
    for name in ("greedy", mode):
        f_tilde = known(A=0.5 * np.eye(p), sigma=0.5, mode=name)
        size = q + f_tilde.eta_size
        state, report = run(f_tilde, new_gradient(starts().scaler, size, CONFIG, key=jr.key(1)))
        assert report.finite
        values[name] = float(jnp.mean(jax.vmap(state.value)(starts().seen)))
        if name == "eta_policy":
            assert modes(state, starts().seen)[:, q:].mean() > 0.5  # η pulls the state up, to the reward
    assert values[mode] > values["greedy"] + 1


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["eta_policy", "eta_sign", "bonus", "greedy"])
def test_an_optimist_keeps_what_it_hopes_most_of(mode):
    # to act costs, and leads to the reward only if the model errs: in every member the first iterate is best
    f_tilde = known(A=0.5 * np.eye(p), doubt=0.4, mode=mode)
    reward = quadratic(Q=np.eye(p), R=0.05 * np.eye(q), d=[0.8, 0.8, 0.8])
    config = replace(CONFIG, updates=40)  # too few to arrive
    begun = new_gradient(starts().scaler, q + f_tilde.eta_size, config, key=jr.key(1))

    @jax.jit
    def search(setbacks):
        more = {"H": 1000, "setbacks": setbacks, "key": jr.key(2)}
        return gradient_search(f_tilde, reward, jnp.asarray(1.0), None, starts(), begun, config, **more)

    (whole, report), (half, first) = search(jnp.asarray(0)), search(jnp.asarray(1))
    size = lambda state: np.abs(modes(state, starts().seen)[:, :q]).mean()
    if mode == "greedy":
        assert size(whole) < 0.1
    else:
        assert size(whole) > size(half) > 0.1 and report.worst < first.worst


class Torn(Dynamics):
    """Two members: the action moves the state as far up as down. On average, nowhere."""

    sign: jax.Array

    def predict(self, s, a):
        return Prediction(self.sign * jnp.append(a, 0.0), jnp.zeros_like(s), jnp.zeros_like(s))

    def members(self):
        return Torn(jnp.array([1.0, -1.0]))


@pytest.mark.parametrize("doubt", [2.0, 1.0])
def test_what_gains_only_where_members_lie_near_is_not_kept(monkeypatch, doubt):
    # each action costs what it moves: 0.4 is best in each member, 0.2 where they lie twice as far from their mean
    monkeypatch.setattr(imagined, "DOUBT", doubt)
    f_tilde = replace(known(mode="thompson"), dynamics=Torn(jnp.zeros(())))
    reward = quadratic(Q=np.eye(p), R=np.eye(q), c=np.full(q, 0.8))
    config = replace(CONFIG, updates=10)  # too few to arrive at first

    @jax.jit
    def search(setbacks):
        more = {"H": 1000, "setbacks": setbacks, "key": jr.key(2)}
        return gradient_search(f_tilde, reward, jnp.asarray(1.0), None, starts(), blank(), config, **more)

    half, whole = (np.abs(modes(search(jnp.asarray(n))[0], starts().seen)).mean() for n in (1, 0))
    assert whole == half if doubt == 2 else whole > half + 0.05


def test_trials_in_the_model_itself_hope():
    f_tilde = known(A=0.5 * np.eye(p), sigma=0.5, mode="eta_sign")
    chance = Chance.draw(jnp.ones((1, p)), M=M, n=1, steps=3, key=jr.key(0))
    more = {"axis": None, "value": jnp.sum}
    returns = trials(f_tilde, blank().policy, quadratic(Q=np.eye(p)), None, chance, **more)
    np.testing.assert_allclose(returns, -p * (1 + 1 + 1), rtol=1e-3)  # 1 becomes 0.5 + 0.5


def test_trials_in_the_model_itself_earn_the_bonus():
    f_tilde = known(sigma=0.5, mode="bonus")
    chance = Chance.draw(jnp.ones((1, p)), M=M, n=1, steps=3, key=jr.key(0))
    returns = trials(f_tilde, blank().policy, quadratic(), None, chance, axis=None)
    np.testing.assert_allclose(returns, 3 * 0.5, rtol=1e-3)


def test_trials_are_in_the_members_and_know_no_hope(search):
    f_tilde = known(A=0.5 * np.eye(p), sigma=0.5, mode="eta_sign")
    worlds = f_tilde.in_each_member()
    chance = Chance.draw(jnp.ones((1, p)), M=stacked_size(worlds), n=1, steps=3, key=jr.key(0))
    returns = trials(worlds, blank().policy, quadratic(Q=np.eye(p)), None, chance)
    np.testing.assert_allclose(returns, -p * (1 + 0.25 + 0.0625), rtol=1e-3)


def test_few_coordinates_get_smaller_networks_unless_the_config_says_otherwise():
    state = new_gradient(starts().scaler, q, GradientConfig(), key=jr.key(1))
    assert [b.shape[0] for b in state.policy.net.biases[:-1]] == [64, 64]
    assert [b.shape[0] for b in state.value.net.biases[:-1]] == [64, 64]
    assert GradientConfig().layers(9) == (128, 128) and GradientConfig(hidden=(7,)).layers(9) == (7,)
