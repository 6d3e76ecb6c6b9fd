import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from hiprl.control.ppo import PPOConfig, advantages, new_ppo, ppo_search
from hiprl.errors import InputError
from tests.control.known import known, quadratic, starts
from tests.data.samples import p, q

CONFIG = PPOConfig(
    hidden=(16,),
    learning_rate=3e-3,
    n_steps=512,
    rollouts=32,
    batch_size=128,
    n_epochs=5,
    gamma=0.9,
    gae_lambda=0.9,
    clip_range=0.2,
    total_timesteps=90 * 512,
    max_grad_norm=0.5,
    trial_steps=31,
    trial_starts=5,
)
TWO = np.array([0.3, -0.5])
H = 7


def compiled(config=CONFIG, ends=None):
    """One search for all models and rewards of the same shapes."""
    return jax.jit(lambda f, r, places, state, key: ppo_search(f, r, ends, places, state, config, H=H, key=key))


@pytest.fixture(scope="module")
def search():
    return compiled()


def found(search, f_tilde, reward, *, config=CONFIG, size=q, seed=2):
    blank = new_ppo(starts().scaler, size, config, key=jr.key(1))
    state, report = search(f_tilde, reward, starts(), blank, jr.key(seed))
    assert report.finite
    return state, report


def modes(state, states):
    return np.asarray(jax.vmap(state.policy.mode)(states))


def test_advantages_are_those_of_a_plain_loop():
    rng = np.random.default_rng(3)
    delta, fresh, rate = rng.normal(size=(11, 3)), rng.random((11, 3)) < 0.3, 0.83
    expected = np.zeros((11, 3))
    for n in range(3):
        for t in range(11):
            for i in range(t, 11):
                expected[t, n] += rate ** (i - t) * delta[i, n]
                if fresh[i, n]:
                    break
    ours = advantages(jnp.asarray(delta, jnp.float32), jnp.asarray(fresh), rate)
    np.testing.assert_allclose(ours, expected, rtol=1e-5, atol=1e-6)


def test_rollouts_share_the_steps_evenly():
    with pytest.raises(InputError, match=r"500 steps .* 32 rollouts; .* evenly. Take a multiple of 32 steps"):
        PPOConfig(n_steps=500, rollouts=32)


@pytest.mark.slow
def test_one_action_is_best_everywhere(search):
    state, _ = found(search, known(), quadratic(R=np.eye(q), c=TWO))
    np.testing.assert_allclose(modes(state, starts().first).mean(0), TWO, atol=0.1)


@pytest.mark.slow
def test_the_reward_comes_a_step_after_the_action(search):
    B = np.array([[1.0, 0.0], [0.0, 1.0], [0.0, 0.0]])
    state, _ = found(search, known(B=B), quadratic(Q=np.eye(p), d=[*TWO, 0.0]))
    np.testing.assert_allclose(modes(state, starts().first).mean(0), TWO, atol=0.15)


@pytest.mark.slow
def test_the_policy_learns_to_use_its_hallucinated_control():
    goal = np.array([0.4, -0.4, 0.2])
    f_tilde = known(A=np.eye(p), sigma=0.3, mode="eta_policy")
    state, _ = found(compiled(), f_tilde, quadratic(Q=np.eye(p), d=goal), size=q + p)
    eta = modes(state, starts().first - starts().first)[:, q:].mean(0)  # at the origin
    assert (np.sign(eta) == np.sign(goal)).all() and (np.abs(eta) > 0.2).all()


@pytest.mark.slow
def test_it_stays_alive_where_living_pays():
    """An action above 0.2 ends the episode, and each step is worth 1 less a price on actions below it."""
    search = compiled(ends=lambda s, a, s_next: a[0] > 0.2)

    class Living(type(quadratic())):
        def __call__(self, s, a):
            return 1.0 + 0.3 * a[0]

    reward = Living(**vars(quadratic()))
    state, _ = found(search, known(A=np.eye(p)), reward)
    first = modes(state, starts().first)[:, 0]
    assert (first < 0.2).all()
    careless, _ = found(compiled(), known(A=np.eye(p)), reward)
    assert (modes(careless, starts().first)[:, 0] > 0.5).all()


@pytest.mark.slow
def test_rollouts_that_the_members_cannot_share_evenly_are_searched_in_too():
    rollouts = 31
    config = PPOConfig(
        hidden=(4,),
        n_steps=2 * rollouts,
        rollouts=rollouts,
        batch_size=16,
        n_epochs=1,
        total_timesteps=2 * rollouts,
        trial_steps=3,
        trial_starts=2,
    )
    f_tilde = known(A=np.eye(p), noise=0.1, mode="thompson")  # of two members
    found(compiled(config), f_tilde, quadratic(R=np.eye(q)), config=config)
